// The LED: eight patterns that differ in the number and the length of their flashes.
#include "Vled.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vled> b("led", argc, argv);
    auto &c = *b.core;
    // run.sh builds it this short; on a board it is about a second
    const uint64_t round = 1ull << 14;
    const struct { unsigned blinks; uint64_t lit; } want[8] = {{0, 0}, {0, round}, {1, round / 2}, {4, round / 2},
                                                              {2, round / 4}, {3, round * 3 / 8}, {2, round / 8}, {16, round / 2}};
    for (unsigned pattern = 0; pattern < 8; pattern++) {
        c.pattern = pattern;
        b.edge();
        uint64_t lit = 0;
        unsigned blinks = 0;
        bool was = c.lit;
        for (uint64_t i = 0; i < round; i++) {
            b.edge();
            lit += c.lit, blinks += c.lit && !was, was = c.lit;
        }
        CHECK(b, lit == want[pattern].lit && blinks == want[pattern].blinks, "pattern %u: %u blinks, %llu clocks lit", pattern, blinks, (unsigned long long)lit);
    }
    return b.pass("8 patterns");
}
