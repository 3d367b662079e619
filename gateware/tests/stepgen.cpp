// The stepgen at its pins: four timings, one pulse per step of position, the ramp to the last bit.
//
// The checker sees STEP and DIR as a drive does and keeps its own clocks. It knows the ramp only as
// `velocity += clamp(target - velocity, -accel, +accel)`.
#include "Vstepgen.h"
#include "bench.h"

using B = Bench<Vstepgen>;

struct Settings {
    uint32_t steplen, stepspace, dirsetup, dirhold, stop_accel;
    bool step_invert, dir_invert;
};

struct Checker {
    B &b;
    Settings s{1, 1, 0, 0, 0, false, false};
    // The ramp, as documented.
    int64_t velocity = 0;  // s32.24
    int64_t target = 0;
    uint32_t limit = 0;
    bool halted = true, fresh = false;
    // The pins, as a drive sees them. Far in the past: nothing restricts the first edge.
    bool step = false, dir = false;
    uint64_t high = 0, low = 1u << 30, since_dir = 1u << 30;
    int64_t position = 1ll << 31, emitted = 0;
    uint64_t pulses = 0, reversals = 0, waits = 0, waiting = 0, halting = 0;
    bool cut = false;

    explicit Checker(B &b) : b(b) {}

    int64_t ramped() const {
        __int128 d = (__int128(target) << 24) - velocity, a = limit;
        if (limit && d > a) d = a;
        if (limit && d < -a) d = -a;
        return velocity + int64_t(d);
    }

    void clock() {
        auto &c = *b.core;
        b.settle();
        const bool gate = c.gate, halt = c.stop || !gate, take = c.commit && !halt;
        const int64_t v = velocity >> 24;
        CHECK(b, int32_t(c.velocity_now) == int32_t(v), "velocity is %d, the ramp says %lld", int32_t(c.velocity_now), (long long)v);
        const bool waited = c.waits;
        // A pulse may start if the drive has had its times; the core may not be slower than that either.
        const bool allowed = !step && low >= s.stepspace && since_dir >= s.dirsetup && dir == (v < 0);
        const bool turn = gate && !step && low >= s.dirhold && ((v < 0 && !dir) || (v > 0 && dir));
        const int64_t next = int64_t(uint64_t(position) + uint64_t(v));
        const bool due = (next >> 32) != (position >> 32);
        CHECK(b, waited == (gate && due && !allowed), "a pulse %s; due %d, allowed %d, low %llu of %u, since dir %llu of %u",
              waited ? "waits without reason" : "does not wait", due, allowed, (unsigned long long)low, s.stepspace, (unsigned long long)since_dir, s.dirsetup);

        // The ramp.
        const bool pause = take || fresh || (halt && !halted);
        const int64_t velocity_next = !gate ? 0 : pause ? velocity : ramped();
        fresh = take || (halt && !halted);
        halted = halt;
        if (halt) target = 0, limit = s.stop_accel;
        else if (take) target = c.enable ? int32_t(c.velocity) : 0, limit = c.enable ? c.accel : s.stop_accel;
        velocity = velocity_next;

        b.edge();

        // The pins after the edge.
        const bool step_now = c.step ^ s.step_invert, dir_now = c.dir ^ s.dir_invert;
        if (dir_now != dir) {
            CHECK(b, turn, "DIR moved without need or too early: STEP %d, low for %llu of %u", step, (unsigned long long)low, s.dirhold);
            CHECK(b, !step_now, "DIR moved together with STEP");
            since_dir = 0;
            reversals++;
        } else CHECK(b, !turn, "DIR did not move promptly");
        if (step_now && !step) {
            CHECK(b, gate, "STEP rose with the gate closed");
            CHECK(b, low >= s.stepspace, "stepspace %llu of %u", (unsigned long long)low, s.stepspace);
            CHECK(b, since_dir >= s.dirsetup, "dirsetup %llu of %u", (unsigned long long)since_dir, s.dirsetup);
            pulses++;
            emitted += dir_now ? -1 : 1;
            high = 0;
        }
        if (!step_now && step) {
            CHECK(b, high >= s.steplen || !gate, "steplen %llu of %u", (unsigned long long)high, s.steplen);
            low = 0;
        }
        if (step_now && step) CHECK(b, high < s.steplen, "STEP longer than steplen %u", s.steplen);
        if (!gate) CHECK(b, !step_now, "STEP active with the gate closed");
        step = step_now, dir = dir_now;
        high += step, low += !step, since_dir++;

        // Position: what was emitted, and in between exactly the sum of the velocities.
        const int64_t now = int64_t(c.position);
        CHECK(b, int32_t(now >> 32) == int32_t(emitted), "position says %d pulses, the pins had %lld", int32_t(now >> 32), (long long)emitted);
        CHECK(b, now == (!gate || waited ? position : next), "position %016llx, expected %016llx", (long long)now, (long long)(waited ? position : next));
        position = now;
        waits += waited;
        waiting = waited ? waiting + 1 : 0;
        CHECK(b, waiting <= uint64_t(s.steplen) + s.stepspace + s.dirsetup + s.dirhold + 4 || reversals, "a pulse never comes");

        halting = halt && gate ? halting + 1 : 0;
        if (c.stopped) CHECK(b, halt && velocity == 0 && !step, "stopped, but velocity %lld, STEP %d", (long long)velocity, step);
        const bool rests = halting > 4 && velocity == 0 && !step;
        quiet = rests ? quiet + 1 : 0;
        CHECK(b, quiet < 3 || c.stopped, "at rest but not stopped");
    }
    uint64_t quiet = 0;
};

static int32_t any_velocity(Random &r) {
    static const int32_t edges[] = {0, 1, -1, INT32_MAX, -INT32_MAX, 2, -2, 1 << 30, -(1 << 30), 0x55555555, -0x55555555};
    if (r.one_in(3)) return edges[r.below(sizeof edges / sizeof *edges)];
    const int32_t v = int32_t(r.up_to_bits(r.one_in(4) ? 31 : 31));
    return r.one_in(2) ? v : -v;
}

static uint32_t fast_velocity(Random &r) { return 0x7FFFFFFF >> r.below(6); }

static Settings any_settings(Random &r) {
    const unsigned bits = r.one_in(3) ? 1 : r.one_in(2) ? 4 : r.one_in(20) ? 12 : 7;
    const uint32_t len = r.up_to_bits(bits), space = r.up_to_bits(bits);
    return {len, space, uint32_t(r.up_to_bits(bits + 1)), uint32_t(r.up_to_bits(bits + 1)),
            r.one_in(4) ? 0 : uint32_t(r.up_to_bits(32)), r.one_in(2), r.one_in(2)};
}

static void apply(Checker &k, const Settings &s) {
    auto &c = *k.b.core;
    k.s = s;
    c.steplen = s.steplen, c.stepspace = s.stepspace, c.dirsetup = s.dirsetup, c.dirhold = s.dirhold;
    c.stop_accel = s.stop_accel, c.step_invert = s.step_invert, c.dir_invert = s.dir_invert;
    // 0 is read as 1: with that the checker's ">=" says exactly what the pins do.
    k.s.steplen += !s.steplen, k.s.stepspace += !s.stepspace;
}

// Close the gate, let the old times pass, change the settings, open it again.
static void reconfigure(Checker &k, const Settings &s) {
    auto &c = *k.b.core;
    const Settings old = k.s;
    c.gate = 0, c.commit = 0;
    k.clock();
    for (uint32_t i = 0; i < old.stepspace + old.dirhold + old.dirsetup + 2; i++) k.clock();
    // Turning a pin over is no edge to a drive that is off: forget the level, keep the times.
    apply(k, s);
    k.b.edge();
    k.low = k.since_dir = 1u << 30;
    c.stop = 0;
    k.clock();
    c.gate = 1;
}

int main(int argc, char **argv) {
    B b("stepgen", argc, argv);
    Random &r = b.random;
    Checker k(b);
    auto &c = *b.core;
    c.gate = c.stop = c.commit = c.enable = 0;
    apply(k, k.s);
    const uint64_t wanted = argc > 2 ? strtoull(argv[2], nullptr, 0) : 2000000;

    for (unsigned round = 0; k.pulses < wanted || round < 400; round++) {
        reconfigure(k, any_settings(r));
        const unsigned style = r.below(4);
        const uint64_t commits = 20 + r.below(60);
        for (uint64_t n = 0; n < commits; n++) {
            c.commit = 1;
            c.enable = !r.one_in(12);
            switch (style) {
            case 0:  // anything
                c.velocity = any_velocity(r), c.accel = r.one_in(3) ? 0 : uint32_t(r.up_to_bits(32));
                break;
            case 1:  // full rate and back, with and without a ramp
                c.velocity = n & 1 ? fast_velocity(r) : -fast_velocity(r), c.accel = r.one_in(2) ? 0 : 0xFFFFFFFF >> r.below(8);
                break;
            case 2:  // hard on the pulse engine, one way
                c.velocity = fast_velocity(r), c.accel = 0;
                break;
            default:  // around zero, slow ramps
                c.velocity = int32_t(r.below(7)) - 3, c.accel = uint32_t(r.up_to_bits(26));
            }
            k.clock();
            c.commit = 0;
            for (uint64_t i = r.one_in(5) ? r.below(4) : r.below(400); i; i--) {
                if (r.one_in(3000)) {  // a soft stop, sometimes waited for, sometimes cut by the gate
                    c.stop = 1;
                    for (uint64_t j = r.below(600); j; j--) k.clock();
                    if (r.one_in(2)) {
                        c.gate = 0;
                        k.clock();
                        k.clock();
                        c.gate = 1;
                    }
                    c.stop = 0;
                }
                if (r.one_in(2000)) {  // the gate, in any phase
                    c.gate = 0;
                    for (uint64_t j = 1 + r.below(6); j; j--) k.clock();
                    c.gate = 1;
                }
                k.clock();
            }
        }
    }
    // The widest times, once: no counter may be shorter than its register.
    for (unsigned wide = 0; wide < 4; wide++) {
        Settings s{1, 1, 0, 0, 0, false, false};
        (wide == 0 ? s.steplen : wide == 1 ? s.stepspace : wide == 2 ? s.dirsetup : s.dirhold) = wide < 2 ? 0xFFFF : 0x12345;
        reconfigure(k, s);
        const uint64_t before = k.pulses;
        for (unsigned n = 0; n < 8; n++) {
            c.commit = 1, c.enable = 1, c.accel = 0, c.velocity = n & 2 ? -0x7FFFFFFF : 0x7FFFFFFF;
            k.clock();
            c.commit = 0;
            for (unsigned i = 0; i < 60000; i++) k.clock();
        }
        CHECK(b, k.pulses > before, "no pulse at the widest time %u", wide);
    }
    return b.pass("%llu pulses at the pins = position, %llu reversals, %llu clocks waited", (unsigned long long)k.pulses,
                  (unsigned long long)k.reversals, (unsigned long long)k.waits);
}
