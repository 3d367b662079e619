// The encoder with a shaft and with pulse trains: every mode, edges as close as the filter allows,
// glitches one clock too short, lines that change together, an index with mask and polarity, and
// pins without a relation to the clock.
#include "Vencoder.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vencoder> b("encoder", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    static const int gray[4] = {0, 1, 3, 2};  // bit 0 is A: A leads counts up
    int64_t total = 0;                        // the wide counter's total
    uint64_t moves = 0, illegal = 0, edges = 0, glitches = 0, indices = 0, lies = 0;
    const unsigned phase = r.below(16);

    auto small = [](unsigned v) { return int(v) - (v & 16 ? 32 : 0); };
    auto count = [&] { return total + small(c.delta); };
    auto clock = [&] {
        c.visit = b.clocks % 16 == phase;
        b.settle();
        const int before = small(c.delta);
        const bool moved = c.moved, visit = c.visit;
        illegal += c.illegal, moves += moved;
        CHECK(b, !(c.moved && c.illegal), "a guess at an illegal transition");
        if (visit) total += before;
        b.edge();
        const int change = small(c.delta) - (visit ? 0 : before);
        CHECK(b, change == 0 ? !moved : moved && (change == 1 || change == -1), "moved %d, but delta changes by %d", moved, change);
        CHECK(b, small(c.delta) <= 9 && small(c.delta) >= -9, "delta %d", small(c.delta));
    };
    auto wait = [&](uint64_t n) { while (n--) clock(); };
    auto put = [&](int state) { c.a = state & 1, c.b = state >> 1 & 1; };

    // Power-up with the pins at any level: a level is not an edge.
    const int rest = r.below(4);
    put(rest);
    c.index = c.mask = 0, c.mode = 0, c.filter = r.one_in(2) ? 0 : r.below(256);
    wait(300);
    CHECK(b, count() == 0 && moves == 0 && illegal == 0, "counts at power-up");

    int state = rest;  // of the pins: bit 0 A, bit 1 B
    for (unsigned round = 0; round < 4000; round++) {
        const unsigned mode = r.below(8), filter = r.one_in(3) ? 0 : r.one_in(20) ? 255 : r.below(32), settled = filter + 8;
        const bool index_invert = r.one_in(2), masked = r.one_in(2), mask_invert = r.one_in(2);
        // The mode changes B for a counter, and a wider filter has to be counted up to.
        c.filter = filter, c.mode = mode | index_invert << 4 | masked << 5 | mask_invert << 6 | r.below(2) << 7 | r.below(2) << 3;
        c.index = index_invert, c.mask = !mask_invert;
        wait(300 + settled);
        int64_t expected = count();
        uint64_t wrong = illegal;

        auto model = [&](int to) {  // the count for an accepted change from `state` to `to`
            const bool a = to & 1, bb = to >> 1, a_was = state & 1, b_was = state >> 1, a_edge = a != a_was, b_edge = bb != b_was;
            if (mode < 3) {
                if (a_edge && b_edge) return wrong++, 0;
                const int direction = a != b_was ? 1 : -1;
                if (mode == 0) return a_edge || b_edge ? direction : 0;
                if (mode == 1) return a_edge ? direction : 0;
                return a_edge && !bb ? direction : 0;
            }
            const int rise_a = a && !a_was, rise_b = bb && !b_was;
            if (mode == 3) return rise_a;
            if (mode == 5 || mode == 7) return rise_a - rise_b;
            return rise_a ? bb ? -1 : 1 : 0;
        };
        auto go = [&](int to) {
            expected += model(to), edges++;
            state = to;
            put(to);
        };

        const bool quadrature = mode < 3;
        int at = 0;
        while (gray[at] != state) at++;
        for (unsigned move = 0; move < 12; move++) {
            const int direction = r.one_in(2) ? 1 : -1;
            for (uint64_t steps = r.below(20); steps; steps--) {
                if (quadrature) at += direction, go(gray[at & 3]);
                else go(r.below(4));
                // the shortest a pair may last and still count
                wait(filter + 2 + (r.one_in(4) ? r.below(5) : 0));
            }
            if (r.one_in(3)) {  // one clock too short, on any lines
                wait(settled);
                const uint64_t before = moves, errors = illegal;
                const int lines = 1 + r.below(15);
                // A counter's B may have any level.
                auto flip = [&] { c.a ^= lines & 1, c.b ^= lines >> 1 & 1, c.index ^= lines >> 2 & 1, c.mask ^= lines >> 3 & 1; };
                flip(), wait(filter + 1), flip();
                for (unsigned n = 0; n < settled; n++) {
                    clock();
                    CHECK(b, !c.index_level, "a glitch of %u clocks is an index", filter + 1);
                }
                CHECK(b, moves == before && illegal == errors, "a glitch of %u clocks counted through a filter of %u", filter + 1, filter);
                glitches++;
            }
            if (quadrature && r.one_in(6)) {  // both lines at once: reported, not counted
                wait(settled);
                at += 2, go(gray[at & 3]);
                wait(filter + 2);
                lies++;
            }
        }
        wait(settled);
        CHECK(b, count() == expected, "mode %u, filter %u: count %lld, expected %lld", mode, filter, (long long)count(), (long long)expected);
        CHECK(b, illegal == wrong, "mode %u: %llu illegal, expected %llu", mode, (unsigned long long)illegal, (unsigned long long)wrong);

        // A counter with a B that changes at every clock.
        if (mode == 3) {
            for (unsigned n = 0; n < 5; n++) {
                c.a = 0;
                for (unsigned k = 0; k < filter + 3; k++) c.b ^= 1, clock();
                expected += 1, c.a = 1;
                for (unsigned k = 0; k < filter + 3; k++) c.b ^= 1, clock();
            }
            wait(settled);
            CHECK(b, count() == expected, "a counter hears its B");
            state |= 1;
        }

        // The index, after polarity and mask, rises with the count of the edge it came with.
        CHECK(b, !c.index_level, "an index out of nothing");
        const bool allowed = !masked || r.one_in(2);
        c.mask = masked ? allowed != mask_invert : r.below(2);
        wait(settled);
        expected = count();
        at = 0;
        while (gray[at] != state) at++;
        const int direction = r.one_in(2) ? 1 : -1;
        if (quadrature) at += direction, go(gray[at & 3]);
        c.index = !index_invert;
        bool rose = false;
        for (unsigned n = 0; n < settled; n++) {
            const bool was = c.index_level;
            clock();
            if (c.index_level && !was) {
                CHECK(b, count() == expected, "at the index the count is %lld, expected %lld", (long long)count(), (long long)expected);
                rose = true;
            }
        }
        CHECK(b, rose == allowed && c.index_level == allowed, "index level %d, mask %d", c.index_level, allowed);
        if (masked && allowed) {  // the mask hides it again
            c.mask ^= 1;
            wait(settled);
            CHECK(b, !c.index_level, "an index through the mask");
        }
        c.index = index_invert;
        wait(settled);
        CHECK(b, !c.index_level, "the index stays");
        indices += rose;
    }

    // A shaft without a relation to the clock: transitions filter + 3 clocks apart in real time,
    // each pin seen up to a clock late.
    uint64_t free_edges = 0;
    for (unsigned round = 0; round < 300; round++) {
        const unsigned filter = r.one_in(2) ? 0 : r.below(20);
        const double period = filter + 3 + (r.one_in(2) ? 0 : r.below(1000) / 200.0);
        c.mode = 0, c.filter = filter;
        wait(300);
        int at = 0;
        while (gray[at] != state) at++;
        int64_t expected = count();
        const uint64_t before = illegal;
        double due = double(b.clocks) + 1 + r.below(1000) / 1000.0;
        int direction = 1;
        for (unsigned step = 0; step < 400; step++) {
            if (r.one_in(50)) direction = -direction;
            const double seen = due + r.below(1000) / 1000.0;  // the metastable flip-flop
            while (double(b.clocks) < seen) clock();
            at += direction, expected += direction, state = gray[at & 3], free_edges++;
            put(state);
            due += period;
        }
        wait(filter + 8);
        CHECK(b, count() == expected && illegal == before, "at f_clk / %.3f, filter %u: count %lld, expected %lld, %llu illegal", period, filter,
              (long long)count(), (long long)expected, (unsigned long long)(illegal - before));
    }
    return b.pass("%llu edges, %llu glitches, %llu illegal, %llu indices, %llu asynchronous edges", (unsigned long long)edges, (unsigned long long)glitches,
                  (unsigned long long)lies, (unsigned long long)indices, (unsigned long long)free_edges);
}
