// The PWM at its pins: only whole periods, with any write at any time, in every kind.
#include "Vpwm.h"
#include "bench.h"

enum { PWM_DIR, UP_DOWN, PDM };

struct Pwm : Bench<Vpwm> {
    Random &r = random;
    Vpwm &c = *core;
    uint64_t periods = 0, updates = 0;

    // The reference: the waiting command, the current period with its progress, and the accumulated
    // fraction.
    uint32_t next_width = 0, width = 0, period = 0, at = 0, owed = 0;
    bool next_dir = false, direction = false, silent = true, extra = false, bit = false;
    unsigned kind = 0;
    bool pulse_was = false, dir_was = false;  // the pins follow one clock later
    unsigned kind_was = 0;

    Pwm(int argc, char **argv) : Bench("pwm", argc, argv) {}

    void begin_period(bool gate) {
        periods++;
        const uint32_t fraction = next_width & 255, density = next_width >> 8 & 0xFFFF;
        const uint32_t low = (owed & 255) + fraction;
        extra = low > 255 && c.dither;
        const uint32_t high = (owed >> 8) + density + extra;
        bit = high > 0xFFFF || next_width >> 24;
        owed = gate ? (high & 0xFFFF) << 8 | (low & 255) : 0;
        width = next_width >> 8, period = c.period, kind = c.kind, direction = gate && next_dir, silent = !gate, at = 0;
    }
    void clock() {
        settle();
        const bool gate = c.gate;
        const bool pulse = !silent && (kind == PDM ? bit : period && at < width + extra);
        // The pins after this edge: from the state one clock ago, through the current gate.
        const bool up_down = kind_was == UP_DOWN;
        bool plus = gate && pulse_was && !(up_down && dir_was), minus = gate && (up_down ? pulse_was && dir_was : dir_was);
        CHECK(*this, !(up_down && plus && minus), "the reference is wrong");
        plus ^= c.invert, minus ^= c.invert && up_down;
        const bool out = c.swap ? minus : plus, dir = c.swap ? plus : minus;
        pulse_was = gate && pulse, dir_was = gate && direction, kind_was = kind;
        if (!gate || at + 1 >= period) begin_period(gate);
        else at++;
        if (!gate) next_width = 0, next_dir = false;
        else if (c.commit) next_width = c.enable ? c.width : 0, next_dir = c.direction;
        edge();
        CHECK(*this, c.out == out && c.dir == dir, "pins %d%d, expected %d%d; clock %u of %u, width %u, kind %u, swap %d, invert %d", c.out, c.dir, out, dir, at, period, width, kind, c.swap, c.invert);
    }
    void run(uint64_t n) { while (n--) clock(); }
    bool active(bool backwards) const {  // from the pins: the expected one, before polarity
        const bool on_dir = (c.kind == UP_DOWN && backwards) != c.swap;
        return (on_dir ? c.dir : c.out) != c.invert;
    }
    // Counts active clocks and rising edges over `count` periods, from the pins alone.
    void measure(uint32_t p, unsigned count, bool backwards, uint64_t want, int64_t rises) {
        run(2 * p + 6);
        while (at != 0) clock();
        uint64_t was_active = 0;
        int64_t rose = 0;
        bool was = active(backwards);
        for (uint64_t i = 0; i < uint64_t(count) * p; i++) {
            clock();
            const bool is = active(backwards);
            was_active += is, rose += is && !was, was = is;
            if (c.kind == UP_DOWN) CHECK(*this, !((c.out ^ c.invert) && (c.dir ^ c.invert)), "both pins active");
        }
        CHECK(*this, was_active == want, "%llu clocks active in %u periods of %u, expected %llu (width %u)", (unsigned long long)was_active, count, p, (unsigned long long)want, c.width);
        CHECK(*this, rises < 0 || rose == rises, "%lld rising edges, expected %lld", (long long)rose, (long long)rises);
    }
    void quiet(unsigned clocks) {
        for (unsigned i = 0; i < clocks; i++) {
            clock();
            CHECK(*this, (c.swap ? c.dir : c.out) == c.invert && (c.swap ? c.out : c.dir) == (c.invert && c.kind == UP_DOWN), "a pin is live with nothing committed");
        }
    }
    void shut(unsigned clocks) {
        c.gate = 0, c.commit = 0;
        run(clocks);
    }
    void command(uint32_t w) {
        c.width = w, c.commit = 1, c.enable = 1, c.direction = r.one_in(2);
        clock();
        c.commit = 0;
    }

    void powers_up() {
        c.gate = c.commit = c.enable = c.direction = c.invert = c.swap = c.dither = c.kind = 0;
        c.width = c.period = 0;
        clock();
    }
    void silent_until_a_commit() {
        shut(1);
        c.invert = r.one_in(2), c.swap = r.one_in(2), c.kind = r.below(4), c.dither = r.one_in(2);
        c.period = r.one_in(12) ? r.below(3) : 1 + r.up_to_bits(9);
        shut(3);
        c.gate = 1;
        quiet(3 + r.below(2 * c.period + 1));
    }
    // Constant commands: duty 0 %, 100 %, one clock, a clock around the period, the widest, and
    // random ones, all with fractions.
    void a_width_is_kept(bool long_enough) {
        const uint32_t p = c.period;
        const uint32_t widths[] = {0, p, 1, p ? p - 1 : 0, p + 1, 0x1FFFFF, uint32_t(r.below(p + 1))};
        const uint32_t w = widths[r.below(7)], f = r.one_in(3) ? 0 : r.below(256);
        command(w << 8 | f);
        const bool backwards = c.direction;
        if (p && c.dither && f && long_enough) {  // the fraction, exactly
            const uint64_t exact = w >= p ? 256ull * p : 256ull * w + f;
            measure(p, 256, backwards, exact, -1);
        } else if (p && !(c.dither && f)) {
            const uint32_t duty = w < p ? w : p;
            measure(p, 5, backwards, 5ull * duty, duty && duty < p ? 5 : 0);
        }
        // Off is one commit and at most one period away.
        c.commit = 1, c.enable = 0;
        clock();
        c.commit = 0;
        if (p) measure(p, 3, backwards, 0, 0);
    }
    // Of 65536 bits exactly so many.
    void a_density_is_kept() {
        c.period = r.below(4);
        const uint32_t step = c.period ? c.period : 1, d = r.one_in(4) ? 0x10000 : r.one_in(4) ? 0 : r.below(0x10000);
        shut(2);
        c.gate = 1, c.dither = 0;
        clock();
        command(d << 8 | r.below(256));
        measure(step, 65536, false, uint64_t(d) * step, -1);
    }
    // Widths, periods, kinds, directions, enables and the gate at any time.
    void anything_at_any_time(uint32_t p) {
        for (unsigned i = 0; i < 2000; i++) {
            c.commit = r.one_in(9);
            if (c.commit) {
                c.width = r.one_in(5) ? 0 : r.one_in(4) ? r.up_to_bits(29) : r.below((uint64_t(p) + 2) << 8);
                c.enable = !r.one_in(8), c.direction = r.one_in(2), updates++;
            }
            if (r.one_in(300)) c.period = r.one_in(20) ? 0 : 1 + r.up_to_bits(8);
            if (r.one_in(500)) c.kind = r.below(4), c.dither = r.one_in(2);
            if (r.one_in(700)) c.swap = r.one_in(2), c.invert = r.one_in(2);
            c.gate = !r.one_in(700);
            clock();
            if (r.one_in(2)) c.gate = 1;
        }
    }
    void the_widest_period() {
        shut(2);
        c.kind = c.dither = c.swap = c.invert = 0;
        c.period = 0x1FFFFF;
        shut(2);
        c.gate = 1;
        clock();
        command(0x100001u << 8);
        run(3u * 0x1FFFFF);
    }
};

int main(int argc, char **argv) {
    Pwm p(argc, argv);
    p.powers_up();
    for (unsigned round = 0; round < 1200; round++) {
        p.silent_until_a_commit();
        const uint32_t period = p.c.period;
        if (p.c.kind != PDM) p.a_width_is_kept(round % 8 == 0);
        else if (round % 64 == 2) p.a_density_is_kept();
        p.anything_at_any_time(period);
    }
    p.the_widest_period();
    return p.pass("%llu periods, %llu updates", (unsigned long long)p.periods, (unsigned long long)p.updates);
}
