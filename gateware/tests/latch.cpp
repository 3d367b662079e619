// The latch compared with a description of it: arms, edges, both at once, and a wide counter that
// takes 1 to 17 clocks.
#include "Vlatch.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vlatch> b("latch", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    struct Source { bool arm, level, seen_low, flag; } index{}, probe{};
    unsigned pending = 0, shown = 0;  // clocks left
    uint64_t captures = 0, refused = 0, together = 0, armed_high = 0;

    for (uint64_t clock = 0; clock < 5000000; clock++) {
        const unsigned often = clock / 10000 % 2 ? 3 : 30;
        for (Source *s : {&index, &probe}) {
            const bool was = s->arm;
            if (r.one_in(often * 4)) s->arm = !s->arm;
            if (r.one_in(often)) s->level = !s->level;
            armed_high += s->arm && !was && s->level;
        }
        c.arm_index = index.arm, c.arm_probe = probe.arm, c.index = index.level, c.probe = probe.level, c.pending = pending > 0;
        b.settle();

        // An edge is a level that was low while armed and is high now; an edge in the clock of the
        // arming does not count.
        const bool index_edge = index.arm && index.seen_low && index.level, probe_edge = probe.arm && probe.seen_low && probe.level;
        const bool free = !index.flag && !probe.flag && !pending;
        const bool capture = free && (index_edge || probe_edge);
        CHECK(b, c.capture == capture, "capture %d, expected %d", c.capture, capture);
        captures += capture, together += free && index_edge && probe_edge;
        refused += !free && (index_edge || probe_edge);
        const bool was_index = index.flag, was_probe = probe.flag, was_pending = pending > 0;
        index.flag = index.arm && (index.flag || (free && index_edge));
        probe.flag = probe.arm && (probe.flag || (free && probe_edge));
        index.seen_low = index.arm && !index.level, probe.seen_low = probe.arm && !probe.level;
        if (pending) pending--;
        if (capture) pending = 1 + r.below(17);
        b.edge();

        CHECK(b, c.index_latched == (index.arm && was_index && !was_pending), "index_latched %d", c.index_latched);
        CHECK(b, c.probe_latched == (probe.arm && was_probe && !was_pending), "probe_latched %d", c.probe_latched);
        shown += c.index_latched || c.probe_latched;
    }
    CHECK(b, shown && captures > 1000 && together && armed_high, "the stimulus is too tame");
    return b.pass("%llu captures, %llu by both at once, %llu edges refused, %llu armed at a high level", (unsigned long long)captures,
                  (unsigned long long)together, (unsigned long long)refused, (unsigned long long)armed_high);
}
