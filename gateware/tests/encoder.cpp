// The encoder against a shaft: a quadrature source that bounces, glitches, reverses and passes its index.
#include "Vencoder.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vencoder> b("encoder", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    static const int gray[4] = {0, 1, 3, 2};  // bit 0 is A: A leads counts up
    uint32_t now = 0xFFFFF000;                // the wall clock's low word wraps early
    int64_t position = 0;
    uint64_t edges = 0, indices = 0, glitches = 0, illegal = 0;
    uint32_t last_count = 0, last_time = 0;

    auto clock = [&] {
        c.now = now;
        b.edge();
        if (c.count != last_count) {
            CHECK(b, c.edge_time == now, "edge time %08x, expected %08x", c.edge_time, now);
            last_time = now, last_count = c.count;
        } else CHECK(b, c.edge_time == last_time, "edge time moved without an edge");
        now++;
    };
    auto put = [&](int state, bool index) { c.a = gray[state & 3] & 1, c.b = gray[state & 3] >> 1, c.index = index; };
    auto wait = [&](uint64_t n) { while (n--) clock(); };

    c.arm = 0, c.filter = 0;
    put(0, false);
    wait(20);
    CHECK(b, c.count == 0 && c.errors == 0, "counts at rest");

    for (unsigned round = 0; round < 3000; round++) {
        c.filter = r.one_in(4) ? 0 : r.one_in(8) ? 255 : r.below(32);
        const unsigned settled = c.filter + 6;  // two flip-flops, the filter, the counter, and one to spare
        wait(settled);
        for (unsigned move = 0; move < 60; move++) {
            const int direction = r.one_in(2) ? 1 : -1;
            for (uint64_t steps = r.below(12); steps; steps--) {
                position += direction;
                edges++;
                put(position, false);
                wait(c.filter + 1);  // the shortest a level may last and still count
            }
            if (c.filter && r.one_in(3)) {  // a glitch one clock too short, on any line
                wait(settled);
                const int line = r.below(3);
                const uint32_t before = c.count, moved = c.edge_time;
                const uint16_t errors = c.errors;
                (line == 0 ? c.a : line == 1 ? c.b : c.index) ^= 1;
                wait(c.filter);
                (line == 0 ? c.a : line == 1 ? c.b : c.index) ^= 1;
                wait(settled);
                CHECK(b, c.count == before && c.edge_time == moved && c.errors == errors, "a glitch of %u clocks counted through a filter of %u", c.filter, c.filter);
                glitches++;
            }
        }
        wait(settled);
        CHECK(b, int32_t(c.count) == int32_t(position), "count %d, the shaft is at %lld", int32_t(c.count), (long long)position);

        // The index: armed latches once, unarmed never.
        const bool armed = r.one_in(2);
        c.arm = armed;
        wait(2);
        const uint32_t latch_before = c.latch;
        put(position, true);
        wait(settled);
        CHECK(b, c.latched == armed, "latched %d, armed %d", c.latched, armed);
        CHECK(b, int32_t(c.latch) == int32_t(armed ? position : latch_before), "latched %d", int32_t(c.latch));
        put(position, false);
        wait(settled);
        put(++position, true);
        wait(settled);
        CHECK(b, !armed || int32_t(c.latch) == int32_t(position - 1), "a second index moved the latch");
        put(position, false);
        c.arm = 0;
        wait(settled);
        CHECK(b, !c.latched, "the flag outlives its arm bit");
        indices += armed;

        if (r.one_in(4)) {  // both lines at once: counted as an error, not as a move
            const uint16_t before = c.errors;
            put(position + 2, false);
            wait(settled);
            CHECK(b, uint16_t(c.errors - before) == 1 && int32_t(c.count) == int32_t(position), "an illegal transition moved the count");
            put(position, false);
            wait(settled);
            illegal += 2;
            CHECK(b, c.errors == uint16_t(illegal), "errors %u, expected %u", c.errors, unsigned(uint16_t(illegal)));
        }
    }
    return b.pass("%llu edges, %llu indices, %llu glitches, %llu illegal", (unsigned long long)edges, (unsigned long long)indices,
                  (unsigned long long)glitches, (unsigned long long)illegal);
}
