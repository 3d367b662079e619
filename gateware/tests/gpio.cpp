// Inputs, e-stop inputs and outputs at their pins: debounced to the visit, latched, and safe
// whenever the gate is closed.
#include "Vgpio.h"
#include "bench.h"

// The board run.sh builds the core for: inputs 0 and 11 trigger high, 31 low.
static const uint32_t MASK = 0x80000801, LEVEL = 0x00000801;
static const unsigned STOPS[] = {0, 11, 31};

struct Pins : Bench<Vgpio> {
    Random &r = random;
    Vgpio &c = *core;
    uint64_t flips = 0, trips = 0, shut = 0;

    // The reference.
    uint32_t meta = MASK & ~LEVEL, raw = meta, in = 0, latched = 0, held = 0;
    unsigned pin = 0;
    uint16_t limit[32] = {}, left[32] = {};
    bool estop = false, live = false;

    Pins(int argc, char **argv) : Bench("gpio", argc, argv) {}

    void clock() {
        settle();
        // Outputs: the safe level unless something was committed since the gate opened.
        const uint32_t pins = (c.gate && live ? held : c.safe) ^ c.invert;
        if (c.commit) held = c.value;
        live = c.gate && (live || c.commit);
        shut += !c.gate;
        // E-stop, from the synchronised level.
        const uint32_t active = ~(raw ^ LEVEL) & MASK;
        estop = active != 0;
        latched = active | (c.clear ? 0 : latched);
        // One visit.
        if ((raw ^ in) >> pin & 1) {
            if (left[pin]) left[pin]--;
            else in ^= 1u << pin, left[pin] = limit[pin], flips++;
        } else left[pin] = limit[pin];
        pin = (pin + 1) % 32;
        if (c.debounce_we) limit[c.debounce_pin] = c.debounce_limit;
        raw = meta, meta = c.in_pins;
        edge();
        CHECK(*this, c.out_pins == pins, "outputs %08x, expected %08x", c.out_pins, pins);
        CHECK(*this, c.raw == raw, "raw %08x, expected %08x", c.raw, raw);
        CHECK(*this, c.in == in, "in %08x, expected %08x", c.in, in);
        CHECK(*this, c.estop == estop, "estop %d, expected %d", c.estop, estop);
        CHECK(*this, c.estop_latched == latched, "latched %08x, expected %08x", c.estop_latched, latched);
    }
    void run(uint64_t n) { while (n--) clock(); }
    void set_limit(unsigned n, uint32_t value) {
        c.debounce_we = 1, c.debounce_pin = n, c.debounce_limit = value;
        clock();
        c.debounce_we = 0;
    }
    void clear(unsigned clocks) { c.clear = 1, run(clocks), c.clear = 0; }
    void release() { c.in_pins = (c.in_pins & ~MASK) | (MASK & ~LEVEL); }

    void powers_up_without_an_estop() {
        c.gate = c.commit = c.debounce_we = c.clear = 0;
        c.value = 0x5A5A5A5A, c.safe = 0xA5A50000, c.invert = 0x0F0F0F0F, c.in_pins = 0;
        release();
        run(40);
        CHECK(*this, !c.estop && !c.estop_latched, "an e-stop at power-up with every input released");
    }
    // From the pin alone: limit 0 follows within 33 + 2 clocks; limit L never lets 32 * L clocks
    // through and always 32 * (L + 1).
    void a_limit_is_kept() {
        const unsigned n = r.below(32);
        const uint32_t l = r.one_in(3) ? 0 : r.one_in(2) ? 1 : r.up_to_bits(8);
        set_limit(n, l);
        run(40 + r.below(64));
        const bool was = c.in >> n & 1;
        if (l) {
            c.in_pins ^= 1u << n;
            run(32 * l);
            c.in_pins ^= 1u << n;
            for (unsigned i = 0; i < 40; i++) {
                clock();
                CHECK(*this, (c.in >> n & 1) == was, "input %u: %u clocks passed a limit of %u", n, 32 * l, l);
            }
        }
        c.in_pins ^= 1u << n;
        uint64_t took = 0;
        for (; (c.in >> n & 1) == was; took++) {
            clock();
            CHECK(*this, took <= 32 * (l + 1) + 2, "input %u: limit %u takes more than %u clocks", n, l, 32 * (l + 1) + 2);
        }
        CHECK(*this, took > 32 * l, "input %u: limit %u takes only %llu clocks", n, l, (unsigned long long)took);
    }
    void the_longest_limit_is_65535_visits() {
        set_limit(7, 0xFFFF);
        run(40);
        const bool was = c.in >> 7 & 1;
        c.in_pins ^= 1u << 7;
        run(32ull * 65535);
        CHECK(*this, (c.in >> 7 & 1) == was, "limit 65535 is shorter than 65535 visits");
        run(36);
        CHECK(*this, (c.in >> 7 & 1) != was, "limit 65535 is longer than 65536 visits");
        set_limit(7, 0);
        run(64);
    }
    // From the pin to the gate's input in three clocks, with any debounce limit, gate open or not;
    // latched until cleared, and a clear is ignored while it is active. Other inputs never trip it.
    void every_estop_latches() {
        for (unsigned n = 0; n < 32; n++) set_limit(n, 0xFFFF);
        release();
        c.gate = 0;
        run(4);
        clear(1);
        for (unsigned round = 0; round < 2000; round++) an_estop(STOPS[r.below(3)]);
    }
    void an_estop(unsigned n) {
        c.gate = r.one_in(2);
        c.in_pins ^= r.next() & ~uint64_t(MASK);
        run(5);
        CHECK(*this, !c.estop && !c.estop_latched, "another input trips the e-stop");
        c.in_pins ^= 1u << n;
        run(3);
        CHECK(*this, c.estop && c.estop_latched == 1u << n, "input %u: e-stop %d, latched %08x after three clocks", n, c.estop, c.estop_latched);
        clear(3);
        CHECK(*this, c.estop_latched == 1u << n, "input %u: cleared while active", n);
        release();
        run(3 + r.below(5));
        CHECK(*this, !c.estop && c.estop_latched == 1u << n, "input %u: its latch fell by itself", n);
        clear(1);
        CHECK(*this, !c.estop_latched, "input %u: does not clear", n);
        trips++;
    }
    void anything_at_any_time() {
        for (unsigned n = 0; n < 32; n++) set_limit(n, r.one_in(3) ? 0 : r.below(4));
        for (unsigned i = 0; i < 8000000; i++) {
            if (r.one_in(20)) c.in_pins ^= 1u << r.below(32);
            if (r.one_in(5000)) c.in_pins = r.next();
            c.debounce_we = r.one_in(400), c.debounce_pin = r.below(32), c.debounce_limit = r.one_in(50) ? 0xFFFF : r.up_to_bits(4);
            c.clear = r.one_in(60), c.commit = r.one_in(12);
            if (r.one_in(4)) c.value = r.next();
            if (r.one_in(300)) c.safe = r.next(), c.invert = r.next();
            if (r.one_in(90)) c.gate = !c.gate;
            clock();
        }
    }
};

int main(int argc, char **argv) {
    Pins p(argc, argv);
    p.powers_up_without_an_estop();
    for (unsigned round = 0; round < 600; round++) p.a_limit_is_kept();
    p.the_longest_limit_is_65535_visits();
    p.every_estop_latches();
    p.anything_at_any_time();
    return p.pass("%llu debounced changes, %llu e-stops, gate closed for %llu clocks", (unsigned long long)p.flips, (unsigned long long)p.trips, (unsigned long long)p.shut);
}
