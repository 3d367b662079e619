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
    uint32_t token = 1;
    bool was_step = false, was_gate = false, live = false;
    int64_t pulses = 0;
    Board(int argc, char **argv) : b("safety", argc, argv) {}
    Vsafety &c() { return *b.core; }

    void clock() {
        auto &v = c();
        b.settle();
        const bool gate_before = v.gate;
        if (!gate_before) live = false;
        const bool commit = v.commit;
        b.edge();
        if (v.step && !was_step) {
            CHECK(b, gate_before, "STEP rose with the gate closed");
            pulses += v.dir ? -1 : 1;
        }
        was_step = v.step;
        CHECK(b, int32_t(v.position >> 32) == int32_t(pulses), "position %d, pins %lld", int32_t(v.position >> 32), (long long)pulses);
        if (!gate_before) {
            CHECK(b, !v.step && !v.pwm_out, "an output is live with the gate closed");
            CHECK(b, v.out_pins == uint8_t(v.out_safe ^ 0x0f), "outputs %02x are not safe (%02x)", v.out_pins, v.out_safe ^ 0x0f);
            CHECK(b, int32_t(v.velocity_now) == 0, "velocity with the gate closed");
        } else if (!live) CHECK(b, v.out_pins == uint8_t(v.out_safe ^ 0x0f), "outputs live before the first commit");
        live |= commit && gate_before;
        open_clocks += v.gate;
    }
    void run(uint64_t n) { while (n--) clock(); }
    void pulse(CData &input) {
        input = 1;
        clock();
        input = 0;
    }
    void feed(uint32_t value) {
        c().token = value;
        pulse(c().token_we);
    }
    void expect(bool condition, const char *what) { CHECK(b, condition, "%s", what); }
    bool arm() {
        pulse(c().arm);
        b.settle();
        return c().gate;
    }
    void closed_by(Close why) { CHECK(b, c().last_close == why, "closed by %u, says %u", why, c().last_close); }
    void command(int32_t velocity, uint32_t accel) {
        c().velocity = velocity, c().accel = accel;
        pulse(c().commit);
    }
    void recover() {
        c().pin = 0, c().estop_pins = RELEASED;
        run(6);
        pulse(c().clear);
        run(2);
        expect(!c().bitten && !c().reset_latched && !c().estop_latched && !c().estop_inputs, "cleared, but still latched");
    }
};

int main(int argc, char **argv) {
    Board k(argc, argv);
    auto &c = k.c();
    auto &r = k.b.random;
    c.rst = c.token_we = c.arm = c.soft_stop = c.shut = c.clear = c.commit = c.kind = 0, c.pin = 1, c.estop_pins = RELEASED;
    c.timeout = 200, c.grace = 100, c.steplen = 2, c.out_safe = 0xA5, c.out_value = 0x5A, c.stop_accel = 0;

    // Powered, without a host: asleep, no bite, and arming refused while the pin is high.
    k.run(1000);
    k.expect(!c.gate && !c.bitten && c.reset_latched, "power-up with the reset pin high");
    k.closed_by(NEVER);
    k.expect(!k.arm(), "armed with the reset pin high");
    c.pin = 0;
    k.run(4);
    k.expect(!k.arm(), "armed with a reset latched");
    c.pin = 1;
    k.run(4);
    k.pulse(c.clear);
    k.run(2);
    k.expect(c.reset_latched, "cleared while the pin was high");
    k.recover();
    // An e-stop input that is active at power-up is an e-stop, and a clear does not help.
    for (uint32_t pins : {RELEASED ^ 1, RELEASED ^ 2}) {
        c.estop_pins = pins;
        k.run(6);
        k.pulse(c.clear);
        k.run(2);
        k.expect(c.estop_latched && c.estop_inputs == (pins ^ RELEASED), "cleared with an e-stop input active");
        k.expect(!k.arm(), "armed with an e-stop input active");
        c.estop_pins = RELEASED;
        k.run(6);
        k.expect(!k.arm(), "armed with an e-stop latched");
        k.recover();
    }
    k.closed_by(NEVER);

    for (unsigned round = 0; round < 20000; round++) {
        c.timeout = 20 + r.below(300), c.grace = 1 + r.below(400);
        c.stop_accel = r.one_in(4) ? 0 : 0x1000000u * (1 + r.below(255));
        c.steplen = 1 + r.below(4), c.out_safe = r.next(), c.out_value = r.next();
        k.run(6);
        k.expect(k.arm(), "does not arm");
        k.expect(c.armed && c.remaining == c.timeout, "asleep although armed");
        k.command(int32_t(r.next()), r.one_in(2) ? 0 : 0xFFFFFFFF);
        const uint32_t bites = c.bites;

        for (unsigned n = 0; n < 4; n++) {  // fed in time it does not bite, with any margin
            k.run(r.below(c.timeout));
            k.feed(++k.token);
            k.expect(c.gate && c.remaining == c.timeout, "a fed watchdog does not start again");
        }
        switch (r.below(8)) {
        // silence, or a repeated token: the bite comes exactly timeout clocks after the last new
        // one
        case 0: {
            const bool repeat = r.one_in(2);
            uint64_t clocks = 0;
            for (; !c.bitten; clocks++) {
                if (repeat && r.one_in(5)) k.feed(k.token);
                else k.clock();
                k.expect(clocks < 1000, "never bites");
            }
            k.expect(clocks == c.timeout + 1, "bites at the wrong clock");
            k.best_bite = clocks < k.best_bite ? clocks : k.best_bite, k.worst_bite = clocks > k.worst_bite ? clocks : k.worst_bite;
            k.expect(c.stopping && !c.armed && c.bites == bites + 1, "a bite starts a soft stop");
            k.feed(++k.token);
            k.expect(c.bitten, "a token cleared a bite");
            uint64_t stop = 1;
            int64_t speed = llabs(int64_t(int32_t(c.velocity_now)));
            for (; c.gate; stop++) {
                if (r.one_in(20)) k.feed(++k.token);
                else if (r.one_in(20)) k.pulse(c.arm);
                else if (r.one_in(20)) k.command(0x40000000, 0);
                else k.clock();
                const int64_t now = llabs(int64_t(int32_t(c.velocity_now)));
                k.expect(now <= speed, "faster during a soft stop");
                speed = now;
                k.expect(stop <= c.grace + 3, "the gate outlives its grace");
            }
            k.grace_cut += stop > c.grace;
            k.closed_by(BITE);
            k.run(5);
            k.expect(!k.arm() && c.bitten, "armed while bitten");
            k.bites++;
            break;
        }
        case 1:
        case 2: {  // the external reset: gate and pins, from the pin, in any phase
            c.pin = 1;
            uint64_t clocks = 0, pins = 0;
            for (; c.gate; clocks++) k.clock(), k.expect(clocks < 10, "ignores the external reset");
            pins = clocks;
            for (; c.step || c.pwm_out || c.out_pins != uint8_t(c.out_safe ^ 0x0f); pins++) k.clock(), k.expect(pins < 10, "an output survives");
            k.worst_reset = clocks > k.worst_reset ? clocks : k.worst_reset, k.worst_pins = pins > k.worst_pins ? pins : k.worst_pins;
            if (r.one_in(2)) c.pin = 0;
            k.run(6);
            k.expect(!k.arm() && c.reset_latched && !c.bitten, "armed after an external reset");
            k.closed_by(EXT_RESET);
            k.resets++;
            break;
        }
        case 6:
        // an e-stop input, however short once it has been seen: gate and pins, from the pin
        case 7: {
            c.estop_pins = RELEASED ^ (1 + r.below(3));
            const uint32_t which = c.estop_pins ^ RELEASED;
            uint64_t clocks = 0, pins = 0;
            for (; c.gate; clocks++) k.clock(), k.expect(clocks < 10, "ignores an e-stop input");
            pins = clocks;
            for (; c.step || c.pwm_out || c.out_pins != uint8_t(c.out_safe ^ 0x0f); pins++) k.clock(), k.expect(pins < 10, "an output survives");
            k.worst_reset = clocks > k.worst_reset ? clocks : k.worst_reset, k.worst_pins = pins > k.worst_pins ? pins : k.worst_pins;
            if (r.one_in(2)) c.estop_pins = RELEASED;
            k.run(6);
            // a reset of the system does not clear an e-stop
            if (r.one_in(2)) k.pulse(c.rst), k.run(2);
            k.expect(!k.arm() && c.estop_latched && c.estop_inputs == which && !c.bitten, "armed after an e-stop");
            k.closed_by(E_STOP);
            k.estops++;
            break;
        }
        case 3:  // close now
            k.pulse(c.shut);
            k.b.settle();
            k.expect(!c.gate, "does not close");
            k.run(3);
            k.expect(!c.bitten, "closing is no bite");
            k.closed_by(STOP_KEY);
            break;
        case 4: {  // soft stop on request: no bite
            k.pulse(c.soft_stop);
            unsigned n = 0;
            for (; c.gate; n++) k.clock(), k.expect(n <= c.grace + 3, "the gate outlives its grace");
            k.run(2);
            k.expect(!c.bitten && !c.armed, "a soft stop on request is no bite");
            k.closed_by(SOFT_STOP);
            break;
        }
        default:  // a reset of the system
            k.pulse(c.rst);
            k.b.settle();
            k.expect(!c.gate, "the gate survives a reset of the system");
            k.run(1);
            k.closed_by(SYSTEM_RESET);
        }
        const int64_t position = c.position;
        k.run(r.below(20));
        k.expect(int64_t(c.position) == position, "the position moved with the gate closed");
        k.recover();
    }
    CHECK(k.b, k.worst_reset <= 4 && k.worst_pins <= 4, "a stop pin takes %llu clocks to the gate, %llu to the pins", (unsigned long long)k.worst_reset, (unsigned long long)k.worst_pins);
    return k.b.pass("%llu bites, timeout + 1 clocks each, %llu ended by grace; %llu external resets and %llu e-stops, gate in %llu, pins in %llu clocks",
                    (unsigned long long)k.bites, (unsigned long long)k.grace_cut, (unsigned long long)k.resets, (unsigned long long)k.estops, (unsigned long long)k.worst_reset, (unsigned long long)k.worst_pins);
}
