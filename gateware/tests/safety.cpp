// The fault table's gateware rows, at the pins, with no CPU anywhere: bite, repeat, external reset,
// gate, recovery.
#include "Vsafety.h"
#include "bench.h"

using B = Bench<Vsafety>;

constexpr uint32_t RELEASED = 2;  // e-stop pin 0 triggers high, pin 1 low
enum Close { NEVER, BITE, EXT_RESET, STOP_KEY, SOFT_STOP, E_STOP, SYSTEM_RESET };

struct Board {
    B b;
    uint64_t open_clocks = 0, bites = 0, resets = 0, estops = 0, worst_reset = 0, worst_pins = 0, best_bite = ~0ull, worst_bite = 0, grace_cut = 0;
    uint32_t token = 1, bites_before = 0;
    bool was_step = false, was_gate = false, live = false;
    int64_t pulses = 0;
    Board(int argc, char **argv) : b("safety", argc, argv) {}
    Vsafety &c = *b.core;
    Random &r = b.random;

    void clock() {
        b.settle();
        const bool gate_before = c.gate;
        if (!gate_before) live = false;
        const bool commit = c.commit;
        b.edge();
        if (c.step && !was_step) {
            CHECK(b, gate_before, "STEP rose with the gate closed");
            pulses += c.dir ? -1 : 1;
        }
        was_step = c.step;
        CHECK(b, int32_t(c.position >> 32) == int32_t(pulses), "position %d, pins %lld", int32_t(c.position >> 32), (long long)pulses);
        if (!gate_before) {
            CHECK(b, !c.step && !c.pwm_out, "an output is live with the gate closed");
            CHECK(b, c.out_pins == uint8_t(c.out_safe ^ 0x0f), "outputs %02x are not safe (%02x)", c.out_pins, c.out_safe ^ 0x0f);
            CHECK(b, int32_t(c.velocity_now) == 0, "velocity with the gate closed");
        } else if (!live) CHECK(b, c.out_pins == uint8_t(c.out_safe ^ 0x0f), "outputs live before the first commit");
        live |= commit && gate_before;
        open_clocks += c.gate;
    }
    void run(uint64_t n) { while (n--) clock(); }
    void pulse(CData &input) {
        input = 1;
        clock();
        input = 0;
    }
    void feed(uint32_t value) {
        c.token = value;
        pulse(c.token_we);
    }
    void expect(bool condition, const char *what) { CHECK(b, condition, "%s", what); }
    bool arm() {
        pulse(c.arm);
        b.settle();
        return c.gate;
    }
    void closed_by(Close why) { CHECK(b, c.last_close == why, "closed by %u, says %u", why, c.last_close); }
    void command(int32_t velocity, uint32_t accel) {
        c.velocity = velocity, c.accel = accel;
        pulse(c.commit);
    }
    void recover() {
        c.pin = 0, c.estop_pins = RELEASED;
        run(6);
        pulse(c.clear);
        run(2);
        expect(!c.bitten && !c.reset_latched && !c.estop_latched && !c.estop_inputs, "cleared, but still latched");
    }

    void settings() {
        c.rst = c.token_we = c.arm = c.soft_stop = c.shut = c.clear = c.commit = c.kind = 0, c.pin = 1, c.estop_pins = RELEASED;
        c.timeout = 200, c.grace = 100, c.steplen = 2, c.out_safe = 0xA5, c.out_value = 0x5A, c.stop_accel = 0;
    }
    // Powered, without a host: no bite, and arming refused while the pin is high.
    void asleep_at_power_up() {
        run(1000);
        expect(!c.gate && !c.bitten && c.reset_latched, "power-up with the reset pin high");
        closed_by(NEVER);
        expect(!arm(), "armed with the reset pin high");
        c.pin = 0;
        run(4);
        expect(!arm(), "armed with a reset latched");
        c.pin = 1;
        run(4);
        pulse(c.clear);
        run(2);
        expect(c.reset_latched, "cleared while the pin was high");
        recover();
    }
    // An e-stop input that is active at power-up is an e-stop, and a clear does not help.
    void an_estop_at_power_up() {
        for (uint32_t pins : {RELEASED ^ 1, RELEASED ^ 2}) {
            c.estop_pins = pins;
            run(6);
            pulse(c.clear);
            run(2);
            expect(c.estop_latched && c.estop_inputs == (pins ^ RELEASED), "cleared with an e-stop input active");
            expect(!arm(), "armed with an e-stop input active");
            c.estop_pins = RELEASED;
            run(6);
            expect(!arm(), "armed with an e-stop latched");
            recover();
        }
        closed_by(NEVER);
    }
    void arms_and_is_fed() {
        c.timeout = 20 + r.below(300), c.grace = 1 + r.below(400);
        c.stop_accel = r.one_in(4) ? 0 : 0x1000000u * (1 + r.below(255));
        c.steplen = 1 + r.below(4), c.out_safe = r.next(), c.out_value = r.next();
        run(6);
        expect(arm(), "does not arm");
        expect(c.armed && c.remaining == c.timeout, "asleep although armed");
        command(int32_t(r.next()), r.one_in(2) ? 0 : 0xFFFFFFFF);
        bites_before = c.bites;
        for (unsigned n = 0; n < 4; n++) {  // fed in time it does not bite, with any margin
            run(r.below(c.timeout));
            feed(++token);
            expect(c.gate && c.remaining == c.timeout, "a fed watchdog does not start again");
        }
    }
    // Silence, or a repeated token: the bite comes exactly timeout clocks after the last new one.
    void bites_at_its_time() {
        const bool repeat = r.one_in(2);
        uint64_t clocks = 0;
        for (; !c.bitten; clocks++) {
            if (repeat && r.one_in(5)) feed(token);
            else clock();
            expect(clocks < 1000, "never bites");
        }
        expect(clocks == c.timeout + 1, "bites at the wrong clock");
        best_bite = clocks < best_bite ? clocks : best_bite, worst_bite = clocks > worst_bite ? clocks : worst_bite;
        expect(c.stopping && !c.armed && c.bites == bites_before + 1, "a bite starts a soft stop");
        feed(++token);
        expect(c.bitten, "a token cleared a bite");
        nothing_stops_the_stop();
        closed_by(BITE);
        run(5);
        expect(!arm() && c.bitten, "armed while bitten");
        bites++;
    }
    void nothing_stops_the_stop() {
        uint64_t stop = 1;
        int64_t speed = llabs(int64_t(int32_t(c.velocity_now)));
        for (; c.gate; stop++) {
            if (r.one_in(20)) feed(++token);
            else if (r.one_in(20)) pulse(c.arm);
            else if (r.one_in(20)) command(0x40000000, 0);
            else clock();
            const int64_t now = llabs(int64_t(int32_t(c.velocity_now)));
            expect(now <= speed, "faster during a soft stop");
            speed = now;
            expect(stop <= c.grace + 3, "the gate outlives its grace");
        }
        grace_cut += stop > c.grace;
    }
    // Gate and pins, from a pin that stops, in any phase.
    void closes_in_time(const char *ignored) {
        uint64_t clocks = 0, pins = 0;
        for (; c.gate; clocks++) clock(), expect(clocks < 10, ignored);
        pins = clocks;
        for (; c.step || c.pwm_out || c.out_pins != uint8_t(c.out_safe ^ 0x0f); pins++) clock(), expect(pins < 10, "an output survives");
        worst_reset = clocks > worst_reset ? clocks : worst_reset, worst_pins = pins > worst_pins ? pins : worst_pins;
    }
    void external_reset() {
        c.pin = 1;
        closes_in_time("ignores the external reset");
        if (r.one_in(2)) c.pin = 0;
        run(6);
        expect(!arm() && c.reset_latched && !c.bitten, "armed after an external reset");
        closed_by(EXT_RESET);
        resets++;
    }
    // However short once it has been seen.
    void estop() {
        c.estop_pins = RELEASED ^ (1 + r.below(3));
        const uint32_t which = c.estop_pins ^ RELEASED;
        closes_in_time("ignores an e-stop input");
        if (r.one_in(2)) c.estop_pins = RELEASED;
        run(6);
        // a reset of the system does not clear an e-stop
        if (r.one_in(2)) pulse(c.rst), run(2);
        expect(!arm() && c.estop_latched && c.estop_inputs == which && !c.bitten, "armed after an e-stop");
        closed_by(E_STOP);
        estops++;
    }
    void closes_now() {
        pulse(c.shut);
        b.settle();
        expect(!c.gate, "does not close");
        run(3);
        expect(!c.bitten, "closing is no bite");
        closed_by(STOP_KEY);
    }
    void stops_softly() {
        pulse(c.soft_stop);
        unsigned n = 0;
        for (; c.gate; n++) clock(), expect(n <= c.grace + 3, "the gate outlives its grace");
        run(2);
        expect(!c.bitten && !c.armed, "a soft stop on request is no bite");
        closed_by(SOFT_STOP);
    }
    void system_reset() {
        pulse(c.rst);
        b.settle();
        expect(!c.gate, "the gate survives a reset of the system");
        run(1);
        closed_by(SYSTEM_RESET);
    }
    void closes_somehow() {
        switch (r.below(8)) {
        case 0: return bites_at_its_time();
        case 1:
        case 2: return external_reset();
        case 3: return closes_now();
        case 4: return stops_softly();
        case 6:
        case 7: return estop();
        default: return system_reset();
        }
    }
    void stands_until_it_recovers() {
        const int64_t position = c.position;
        run(r.below(20));
        expect(int64_t(c.position) == position, "the position moved with the gate closed");
        recover();
    }
};

int main(int argc, char **argv) {
    Board k(argc, argv);
    k.settings();
    k.asleep_at_power_up();
    k.an_estop_at_power_up();
    for (unsigned round = 0; round < 20000; round++) {
        k.arms_and_is_fed();
        k.closes_somehow();
        k.stands_until_it_recovers();
    }
    CHECK(k.b, k.worst_reset <= 4 && k.worst_pins <= 4, "a stop pin takes %llu clocks to the gate, %llu to the pins", (unsigned long long)k.worst_reset, (unsigned long long)k.worst_pins);
    return k.b.pass("%llu bites, timeout + 1 clocks each, %llu ended by grace; %llu external resets and %llu e-stops, gate in %llu, pins in %llu clocks",
                    (unsigned long long)k.bites, (unsigned long long)k.grace_cut, (unsigned long long)k.resets, (unsigned long long)k.estops, (unsigned long long)k.worst_reset, (unsigned long long)k.worst_pins);
}
