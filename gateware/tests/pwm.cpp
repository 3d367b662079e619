// The PWM at its pin: whole periods only, whatever is written whenever.
#include "Vpwm.h"
#include "bench.h"
#include <vector>

int main(int argc, char **argv) {
    Bench<Vpwm> b("pwm", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    uint64_t periods = 0, updates = 0;

    // The reference: what this period is, how far it has come, what the next will be.
    uint32_t next_width = 0, width = 0, period = 0, at = 0;
    auto clock = [&] {
        b.settle();
        const bool gate = c.gate;
        const bool level = gate && period && at < width;
        const bool last = at + 1 >= period;
        const uint32_t committed = next_width;
        if (!gate || (c.commit && !c.enable)) next_width = 0;
        else if (c.commit) next_width = c.width;
        if (!gate || last) at = 0, width = gate ? committed : 0, period = c.period, periods++;
        else at++;
        b.edge();
        CHECK(b, (c.out ^ c.invert) == level, "out %d, expected %d at clock %u of %u, width %u", c.out ^ c.invert, level, at, period, width);
    };
    auto measure = [&](uint32_t want_period, uint32_t want_width) {  // from the pin alone
        for (uint32_t i = 0; i < 2 * want_period + 4; i++) clock();
        uint64_t active = 0;
        unsigned rises = 0;
        bool was = c.out ^ c.invert;
        for (uint32_t i = 0; i < 5 * want_period; i++) {
            clock();
            const bool is = c.out ^ c.invert;
            active += is, rises += is && !was, was = is;
        }
        const uint32_t w = want_width < want_period ? want_width : want_period;
        CHECK(b, active == 5ull * w, "duty %llu of %u, expected %u", (unsigned long long)active, 5 * want_period, 5 * w);
        CHECK(b, rises == (w && w < want_period ? 5u : 0u), "%u rising edges in 5 periods", rises);
    };

    c.gate = c.commit = c.enable = c.direction = c.invert = 0;
    c.width = c.period = 0;
    clock();
    for (unsigned round = 0; round < 1500; round++) {
        c.gate = 0;
        clock();
        c.invert = r.one_in(2);
        c.period = r.one_in(12) ? r.below(3) : 1 + r.up_to_bits(9);
        clock();
        CHECK(b, (c.out ^ c.invert) == 0, "active with the gate closed");
        c.gate = 1;
        for (unsigned i = 0; i < 3; i++) {
            clock();
            CHECK(b, (c.out ^ c.invert) == 0, "active before the first commit");
        }
        // Steady: duty 0 %, 100 %, one clock, all but one, and anything.
        const uint32_t p = c.period;
        const uint32_t widths[] = {0, p, 1, p ? p - 1 : 0, 0xFFFFFF, uint32_t(r.below(p + 1))};
        c.width = widths[r.below(6)];
        c.commit = 1, c.enable = 1, c.direction = r.one_in(2);
        clock();
        CHECK(b, c.dir == c.direction, "direction not taken");
        c.commit = 0;
        if (p) measure(p, c.width);
        // Wild: widths, periods, enables and the gate at any moment.
        for (unsigned i = 0; i < 2000; i++) {
            c.commit = r.one_in(9);
            if (c.commit) c.width = r.one_in(5) ? 0 : r.below(p + 2), c.enable = !r.one_in(8), updates++;
            if (r.one_in(300)) c.period = 1 + r.up_to_bits(8);
            c.gate = !r.one_in(700);
            clock();
            c.gate = 1;
        }
        c.commit = 0;
    }
    // The widest period.
    c.gate = 0;
    clock();
    c.period = 0xFFFFFF, c.width = 0x800001, c.gate = 1;
    clock();
    c.commit = 1, c.enable = 1;
    clock();
    c.commit = 0;
    for (uint32_t i = 0; i < 2u * 0xFFFFFF; i++) clock();
    return b.pass("%llu periods, %llu updates", (unsigned long long)periods, (unsigned long long)updates);
}
