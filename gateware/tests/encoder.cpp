// The encoder with a shaft and with pulse trains: every mode, edges as close as the filter allows,
// glitches one clock too short, lines that change together, an index with mask and polarity, and
// pins without a relation to the clock.
#include "Vencoder.h"
#include "bench.h"

static const int gray[4] = {0, 1, 3, 2};  // bit 0 is A: A leads counts up

static int small(unsigned v) { return int(v) - (v & 16 ? 32 : 0); }

struct Shaft : Bench<Vencoder> {
    Random &r = random;
    Vencoder &c = *core;
    int64_t total = 0;  // the wide counter's total
    uint64_t moves = 0, illegal = 0, edges = 0, glitches = 0, indices = 0, lies = 0, free_edges = 0;
    const unsigned phase = r.below(16);

    int state = 0;  // of the pins: bit 0 A, bit 1 B
    int at = 0;     // of the shaft
    int64_t expected = 0;
    uint64_t wrong = 0;
    // What the core is set to, in this round.
    unsigned mode = 0, filter = 0, settled = 0;
    bool index_invert = false, masked = false, mask_invert = false;

    Shaft(int argc, char **argv) : Bench("encoder", argc, argv) {}

    int64_t count() const { return total + small(c.delta); }
    bool quadrature() const { return mode < 3; }
    void clock() {
        c.visit = clocks % 16 == phase;
        settle();
        const int before = small(c.delta);
        const bool moved = c.moved, visit = c.visit;
        illegal += c.illegal, moves += moved;
        CHECK(*this, !(c.moved && c.illegal), "a guess at an illegal transition");
        if (visit) total += before;
        edge();
        const int change = small(c.delta) - (visit ? 0 : before);
        CHECK(*this, change == 0 ? !moved : moved && (change == 1 || change == -1), "moved %d, but delta changes by %d", moved, change);
        CHECK(*this, small(c.delta) <= 9 && small(c.delta) >= -9, "delta %d", small(c.delta));
    }
    void wait(uint64_t n) { while (n--) clock(); }
    void put(int to) { c.a = to & 1, c.b = to >> 1 & 1; }
    void find_the_shaft() {
        at = 0;
        while (gray[at] != state) at++;
    }

    // The count for an accepted change from `state` to `to`.
    int model(int to) {
        const bool a = to & 1, b = to >> 1, a_was = state & 1, b_was = state >> 1, a_edge = a != a_was, b_edge = b != b_was;
        if (quadrature()) {
            if (a_edge && b_edge) return wrong++, 0;
            const int direction = a != b_was ? 1 : -1;
            if (mode == 0) return a_edge || b_edge ? direction : 0;
            if (mode == 1) return a_edge ? direction : 0;
            return a_edge && !b ? direction : 0;
        }
        const int rise_a = a && !a_was, rise_b = b && !b_was;
        if (mode == 3) return rise_a;
        if (mode == 5 || mode == 7) return rise_a - rise_b;
        return rise_a ? b ? -1 : 1 : 0;
    }
    void go(int to) {
        expected += model(to), edges++;
        state = to;
        put(to);
    }
    void turn(int steps) { at += steps, go(gray[at & 3]); }

    // Power-up with the pins at any level: a level is not an edge.
    void a_level_is_not_an_edge() {
        put(state = r.below(4));
        c.index = c.mask = 0, c.mode = 0, c.filter = r.one_in(2) ? 0 : r.below(256);
        wait(300);
        CHECK(*this, count() == 0 && moves == 0 && illegal == 0, "counts at power-up");
    }
    void set_up() {
        mode = r.below(8), filter = r.one_in(3) ? 0 : r.one_in(20) ? 255 : r.below(32), settled = filter + 8;
        index_invert = r.one_in(2), masked = r.one_in(2), mask_invert = r.one_in(2);
        // The mode changes B for a counter, and a wider filter has to be counted up to.
        c.filter = filter, c.mode = mode | index_invert << 4 | masked << 5 | mask_invert << 6 | r.below(2) << 7 | r.below(2) << 3;
        c.index = index_invert, c.mask = !mask_invert;
        wait(300 + settled);
        expected = count(), wrong = illegal;
    }
    // One clock too short, on any lines.
    void a_glitch_is_nothing() {
        wait(settled);
        const uint64_t before = moves, errors = illegal;
        const int lines = 1 + r.below(15);
        // A counter's B may have any level.
        auto flip = [&] { c.a ^= lines & 1, c.b ^= lines >> 1 & 1, c.index ^= lines >> 2 & 1, c.mask ^= lines >> 3 & 1; };
        flip(), wait(filter + 1), flip();
        for (unsigned n = 0; n < settled; n++) {
            clock();
            CHECK(*this, !c.index_level, "a glitch of %u clocks is an index", filter + 1);
        }
        CHECK(*this, moves == before && illegal == errors, "a glitch of %u clocks counted through a filter of %u", filter + 1, filter);
        glitches++;
    }
    void every_edge_counts() {
        find_the_shaft();
        for (unsigned move = 0; move < 12; move++) {
            const int direction = r.one_in(2) ? 1 : -1;
            for (uint64_t steps = r.below(20); steps; steps--) {
                if (quadrature()) turn(direction);
                else go(r.below(4));
                // the shortest a pair may last and still count
                wait(filter + 2 + (r.one_in(4) ? r.below(5) : 0));
            }
            if (r.one_in(3)) a_glitch_is_nothing();
            if (quadrature() && r.one_in(6)) {  // both lines at once: reported, not counted
                wait(settled);
                turn(2);
                wait(filter + 2);
                lies++;
            }
        }
        wait(settled);
        CHECK(*this, count() == expected, "mode %u, filter %u: count %lld, expected %lld", mode, filter, (long long)count(), (long long)expected);
        CHECK(*this, illegal == wrong, "mode %u: %llu illegal, expected %llu", mode, (unsigned long long)illegal, (unsigned long long)wrong);
    }
    // With a B that changes at every clock.
    void a_counter_ignores_its_b() {
        for (unsigned n = 0; n < 5; n++) {
            c.a = 0;
            for (unsigned k = 0; k < filter + 3; k++) c.b ^= 1, clock();
            expected += 1, c.a = 1;
            for (unsigned k = 0; k < filter + 3; k++) c.b ^= 1, clock();
        }
        wait(settled);
        CHECK(*this, count() == expected, "a counter hears its B");
        state |= 1;
    }
    // The index, after polarity and mask, rises with the count of the edge it came with.
    void the_index_comes_with_its_count() {
        CHECK(*this, !c.index_level, "an index out of nothing");
        const bool allowed = !masked || r.one_in(2);
        c.mask = masked ? allowed != mask_invert : r.below(2);
        wait(settled);
        expected = count();
        find_the_shaft();
        const int direction = r.one_in(2) ? 1 : -1;
        if (quadrature()) turn(direction);
        c.index = !index_invert;
        bool rose = false;
        for (unsigned n = 0; n < settled; n++) {
            const bool was = c.index_level;
            clock();
            if (c.index_level && !was) {
                CHECK(*this, count() == expected, "at the index the count is %lld, expected %lld", (long long)count(), (long long)expected);
                rose = true;
            }
        }
        CHECK(*this, rose == allowed && c.index_level == allowed, "index level %d, mask %d", c.index_level, allowed);
        if (masked && allowed) {  // the mask hides it again
            c.mask ^= 1;
            wait(settled);
            CHECK(*this, !c.index_level, "an index through the mask");
        }
        c.index = index_invert;
        wait(settled);
        CHECK(*this, !c.index_level, "the index stays");
        indices += rose;
    }
    // A shaft without a relation to the clock: transitions filter + 3 clocks apart in real time,
    // each pin seen up to a clock late.
    void a_shaft_has_its_own_time() {
        const unsigned filter = r.one_in(2) ? 0 : r.below(20);
        const double period = filter + 3 + (r.one_in(2) ? 0 : r.below(1000) / 200.0);
        c.mode = 0, c.filter = filter;
        wait(300);
        find_the_shaft();
        expected = count();
        const uint64_t before = illegal;
        double due = double(clocks) + 1 + r.below(1000) / 1000.0;
        int direction = 1;
        for (unsigned step = 0; step < 400; step++) {
            if (r.one_in(50)) direction = -direction;
            const double seen = due + r.below(1000) / 1000.0;  // the metastable flip-flop
            while (double(clocks) < seen) clock();
            at += direction, expected += direction, state = gray[at & 3], free_edges++;
            put(state);
            due += period;
        }
        wait(filter + 8);
        CHECK(*this, count() == expected && illegal == before, "at f_clk / %.3f, filter %u: count %lld, expected %lld, %llu illegal", period, filter,
              (long long)count(), (long long)expected, (unsigned long long)(illegal - before));
    }
};

int main(int argc, char **argv) {
    Shaft s(argc, argv);
    s.a_level_is_not_an_edge();
    for (unsigned round = 0; round < 4000; round++) {
        s.set_up();
        s.every_edge_counts();
        if (s.mode == 3) s.a_counter_ignores_its_b();
        s.the_index_comes_with_its_count();
    }
    for (unsigned round = 0; round < 300; round++) s.a_shaft_has_its_own_time();
    return s.pass("%llu edges, %llu glitches, %llu illegal, %llu indices, %llu asynchronous edges", (unsigned long long)s.edges, (unsigned long long)s.glitches,
                  (unsigned long long)s.lies, (unsigned long long)s.indices, (unsigned long long)s.free_edges);
}
