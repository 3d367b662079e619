// The edge words compared with a time and a count per channel: moves and illegal edges at any
// clock, strobes alone and in bursts.
#include "Vedges.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vedges> b("edges", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    static const int N = 16, LATE = 18;
    uint32_t time[N] = {}, sampled[N] = {};
    uint8_t errors[N] = {};
    bool wrong[N] = {};
    unsigned since_sample = 1000, last_turn = 0;
    bool sampling = false;
    uint64_t strobes = 0, moves = 0, lies = 0;
    // its low word wraps early, with any phase of the rotation
    uint32_t now = 0xFFFE00 + r.below(512);

    for (uint64_t clock = 0; clock < 3000000; clock++) {
        const unsigned rate = clock / 4096 % 3 == 0 ? 2 : clock / 4096 % 3 == 1 ? 11 : 150;
        const int turn = clock % 16;
        c.turn = 1 << turn;
        c.sampling = sampling;
        c.now = now & 0xFFFFFF;
        c.sample = r.one_in(clock / 20000 % 2 ? 9 : 60);
        if (c.sample) {
            strobes++, since_sample = 0;
            for (int n = 0; n < N; n++) sampled[n] = (uint32_t)uint8_t(errors[n] + wrong[n]) << 24 | time[n];
        }
        c.moved = 0, c.illegal = 0;
        for (int n = 0; n < N; n++) {
            const bool moved = r.one_in(rate), lied = !moved && r.one_in(rate * 3);
            if (n == turn) errors[n] += wrong[n], wrong[n] = false;
            if (moved) c.moved |= 1 << n, time[n] = now & 0xFFFFFF, moves++;
            if (lied) c.illegal |= 1 << n, wrong[n] = true, lies++;  // once per rotation
        }
        // As wide_counter.sv: the rotation after the strobe is sampled.
        const unsigned next_last = c.sample ? turn : last_turn;
        const bool next = c.sample || (sampling && turn != int(last_turn));
        b.edge();
        last_turn = next_last, sampling = next;
        now++, since_sample++;
        c.addr = r.below(N);
        b.settle();
        CHECK(b, since_sample < LATE || c.sampled == sampled[c.addr], "channel %d sampled %08x, expected %08x", c.addr, c.sampled, sampled[c.addr]);
    }
    return b.pass("%llu strobes, %llu edges, %llu illegal", (unsigned long long)strobes, (unsigned long long)moves, (unsigned long long)lies);
}
