// The shared counts compared with a 64-bit position per channel: strobes, captures and clears at
// any clock, channels at full speed. Every channel starts at 0 and moves both ways, so that all
// bits of a total change at once again and again.
#include "Vwide_counter.h"
#include "bench.h"
#include <array>

int main(int argc, char **argv) {
    Bench<Vwide_counter> b("wide_counter", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    static const int N = 16, LATE = 18;  // clocks until a sample or a latched word is valid
    int64_t position[N] = {}, sampled[N] = {}, latched[N] = {};
    int delta[N] = {}, bias[N], rest[N] = {};
    unsigned since_sample = LATE, quiet[N], speed = 2;
    uint64_t strobes = 0, doubles = 0, captures = 0, clears = 0, events = 0;
    for (int n = 0; n < N; n++) quiet[n] = LATE;
    uint32_t clear = 0;

    for (uint64_t clock = 0; clock < 3000000; clock++) {
        if (clock % 5000 == 0) {
            speed = 2 + r.below(clock % 10000 ? 40 : 2);
            clear = r.next() & 0xFFFF;
            for (int n = 0; n < N; n++) bias[n] = r.one_in(3) ? 0 : r.one_in(2) ? 1 : -1;
        }
        std::array<uint8_t, 10> packed{};
        for (int n = 0; n < N; n++)
            for (int i = 0; i < 5; i++) packed[(5 * n + i) / 8] |= (delta[n] >> i & 1) << (5 * n + i) % 8;
        for (int w = 0; w < 3; w++) c.delta[w] = packed[4 * w] | packed[4 * w + 1] << 8 | (w == 2 ? 0 : packed[4 * w + 2] << 16 | packed[4 * w + 3] << 24);
        // Alone, in bursts closer than a rotation, and long apart.
        c.sample = r.one_in(clock / 20000 % 2 ? 9 : 60);
        c.clear = clear;
        c.capture = 0;
        for (int n = 0; n < N; n++)
            if (!(c.pending >> n & 1) && r.one_in(25)) c.capture |= 1 << n;
        b.settle();

        int turn = -1;
        for (int n = 0; n < N; n++)
            if (c.turn >> n & 1) {
                CHECK(b, turn < 0, "two visits at once");
                turn = n;
            }
        CHECK(b, turn == int(clock % 16), "the rotation stumbles");
        CHECK(b, c.visit == (c.turn | (c.capture & c.clear)), "visit %04x", c.visit);
        if (c.sample) {
            doubles += since_sample < LATE;
            strobes++, since_sample = 0;
            for (int n = 0; n < N; n++) sampled[n] = position[n];
        }
        for (int n = 0; n < N; n++) {
            int move = 0;
            if (rest[n]) rest[n]--;
            else if (r.one_in(speed - 1)) {
                move = bias[n] ? bias[n] : r.one_in(2) ? 1 : -1;
                rest[n] = 1;  // half the clock is the fastest
                events++;
            }
            if (c.capture >> n & 1) {
                latched[n] = position[n], quiet[n] = 0, captures++;
                if (clear >> n & 1) position[n] = 0, clears++;
            }
            position[n] += move;
            delta[n] = (c.visit >> n & 1 ? 0 : delta[n]) + move;
        }
        b.edge();
        since_sample++;
        for (int n = 0; n < N; n++) quiet[n]++;

        for (int n = 0; n < N; n++) {
            if (clock % 7 && n != int(clock % N)) continue;
            c.addr = n;
            b.settle();
            CHECK(b, since_sample < LATE || c.sampled == uint32_t(sampled[n]), "channel %d sampled %08x, expected %08x, %u clocks after the strobe", n, c.sampled, uint32_t(sampled[n]), since_sample);
            CHECK(b, quiet[n] < LATE || c.latched == uint32_t(latched[n]), "channel %d latched %08x, expected %08x, %u clocks after the capture", n, c.latched, uint32_t(latched[n]), quiet[n]);
            CHECK(b, quiet[n] < LATE - 1 || !(c.pending >> n & 1), "channel %d is still pending after %u clocks", n, quiet[n]);
            CHECK(b, quiet[n] > 1 || c.pending >> n & 1, "channel %d is not pending", n);
        }
    }
    return b.pass("%llu strobes (%llu within 18 clocks), %llu captures, %llu clears, %llu counts", (unsigned long long)strobes, (unsigned long long)doubles,
                  (unsigned long long)captures, (unsigned long long)clears, (unsigned long long)events);
}
