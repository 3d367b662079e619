// The stepgen at its pins, in its three kinds: the timings, one pulse per step of position, the
// ramp to the last bit.
//
// Two models observe the core. The drive model sees only the pins, decodes the pulses like a
// motor's drive and has its own clocks. The reference model computes when a pulse may start at the
// earliest, and expects it then: the core may be neither early nor late. It knows the ramp only as
// `velocity += clamp(target - velocity, -accel, +accel)`. The bench acts as the wide counter: it
// visits every 16 clocks, or sooner, and adds `delta` up.
#include <algorithm>

#include "Vstepgen.h"
#include "bench.h"

using B = Bench<Vstepgen>;
static constexpr uint64_t LONG_AGO = 1u << 30;

struct Settings {
    uint32_t steplen = 1, stepspace = 1, dirsetup = 0, dirhold = 0, stop_accel = 0;
    bool step_invert = false, dir_invert = false;
    unsigned kind = 0;
};

// The drive's view. `one` and `two` are the pins without their inversion.
struct Drive {
    B &b;
    bool one = false, two = false;
    uint64_t high = 0, low = LONG_AGO, since_dir = LONG_AGO, since_edge = LONG_AGO;
    int last = 0;           // direction of the last pulse, 0: none yet
    bool changed = false;   // direction changed since that pulse
    int64_t counted = 0;
    uint64_t pulses = 0, reversals = 0;

    explicit Drive(B &b) : b(b) {}

    // The drive is off while settings change: it discards levels, and its times are over.
    void reset(bool one_, bool two_) {
        one = one_, two = two_;
        low = since_dir = since_edge = LONG_AGO;
        last = 0;
    }

    void pulse(int sign) {
        pulses++, counted += sign;
        reversals += last == -sign;
        last = sign;
    }

    // After every clock; `gate` as it was at the edge.
    void clock(const Settings &s, bool gate, bool one_now, bool two_now) {
        const uint64_t steplen = std::max(1u, s.steplen), stepspace = std::max(1u, s.stepspace);
        const uint64_t turning = uint64_t(std::max(1u, s.dirhold)) + std::max(1u, s.dirsetup);
        if (s.kind == 2) {
            if (one_now != one || two_now != two) {
                CHECK(b, (one_now != one) != (two_now != two), "both quadrature lines changed at once");
                CHECK(b, gate, "a quadrature line changed with the gate closed");
                const int sign = (one_now != one) == (one == two) ? 1 : -1;  // A leads B: forwards
                CHECK(b, since_edge >= steplen + stepspace, "quadrature edges %llu apart, not %llu", (unsigned long long)since_edge, (unsigned long long)(steplen + stepspace));
                CHECK(b, sign != -last || since_edge >= steplen + turning, "reversal after %llu of %llu", (unsigned long long)since_edge, (unsigned long long)(steplen + turning));
                pulse(sign);
                since_edge = 0;
            }
            since_edge++;
        } else if (s.kind == 1) {
            CHECK(b, !(one_now && two_now), "up and down at once");
            const bool was = one || two, is = one_now || two_now;
            CHECK(b, !was || !is || one == one_now, "the pulse changed lines");
            if (is && !was) {
                const int sign = one_now ? 1 : -1;
                CHECK(b, low >= stepspace, "stepspace %llu of %llu", (unsigned long long)low, (unsigned long long)stepspace);
                CHECK(b, sign != -last || low >= turning, "reversal after %llu of %llu", (unsigned long long)low, (unsigned long long)turning);
                pulse(sign);
            }
            level(s, gate, was, is);
        } else {
            if (two_now != two) {
                CHECK(b, gate, "DIR moved with the gate closed");
                CHECK(b, !one && !one_now, "DIR moved during a pulse");
                CHECK(b, low >= std::max(1u, s.dirhold) || changed, "dirhold %llu of %u", (unsigned long long)low, s.dirhold);
                since_dir = 0;
                changed = true;
            }
            if (one_now && !one) {
                CHECK(b, low >= stepspace, "stepspace %llu of %llu", (unsigned long long)low, (unsigned long long)stepspace);
                CHECK(b, since_dir >= std::max(1u, s.dirsetup), "dirsetup %llu of %u", (unsigned long long)since_dir, s.dirsetup);
                pulse(two_now ? -1 : 1);
                changed = false;
            }
            level(s, gate, one, one_now);
            since_dir++;
        }
        one = one_now, two = two_now;
    }

    void level(const Settings &s, bool gate, bool was, bool is) {
        if (is && !was) {
            CHECK(b, gate, "a pulse rose with the gate closed");
            high = 0;
        }
        if (was && !is) {
            CHECK(b, high >= std::max(1u, s.steplen) || !gate, "steplen %llu of %u", (unsigned long long)high, s.steplen);
            low = 0;
        }
        CHECK(b, gate || !is, "a pulse with the gate closed");
        high += is, low += !is;
    }
};

struct Checker {
    B &b;
    Settings s;
    Drive drive{b};
    // The ramp, as documented.
    int64_t velocity = 0;  // s32.24
    int64_t target = 0;
    uint32_t limit = 0;
    bool halted = true, fresh = false, braking = true;
    unsigned standing = 0;  // in how many of 16 clocks path time stands
    uint64_t stood = 0;
    // The reference model.
    bool pulse = false, reverse = false, a = false, bb = false;
    uint64_t high = 0, low = LONG_AGO, since_dir = LONG_AGO;
    int64_t position = 1ll << 31;
    uint64_t waits = 0, waiting = 0, halting = 0, quiet = 0;
    // The wide counter.
    int32_t total = 0;
    unsigned since_visit = 0;
    int least = 0, most = 0;

    explicit Checker(B &b) : b(b) {}

    int64_t ramped() const {
        __int128 d = (__int128(target) << 24) - velocity, a = limit;
        if (limit && d > a) d = a;
        if (limit && d < -a) d = -a;
        return velocity + int64_t(d);
    }

    static int delta(const Vstepgen &c) { return c.delta & 16 ? int(c.delta) - 32 : c.delta; }

    void clock() {
        auto &c = *b.core;
        since_visit++;
        c.visit = since_visit >= 16 || b.random.one_in(64);
        c.advance = b.random.below(16) >= standing;
        b.settle();
        const bool advance = c.advance;
        stood += !advance;
        const uint64_t steplen = std::max(1u, s.steplen), stepspace = std::max(1u, s.stepspace);
        const uint64_t dirsetup = std::max(1u, s.dirsetup), dirhold = std::max(1u, s.dirhold);
        const bool gate = c.gate, halt = c.stop || !gate, take = c.commit && advance && !halt;
        const int64_t v = velocity >> 24;
        CHECK(b, int32_t(c.velocity_now) == int32_t(v), "velocity is %d, the ramp says %lld", int32_t(c.velocity_now), (long long)v);
        const bool allowed = !pulse && low >= stepspace && since_dir >= dirsetup && reverse == (v < 0);
        const bool turn = gate && !pulse && low >= dirhold && ((v < 0 && !reverse) || (v > 0 && reverse));
        const int64_t next = int64_t(uint64_t(position) + uint64_t(v));
        const bool due = (next >> 32) != (position >> 32);
        const bool waited = c.waits;
        CHECK(b, waited == (gate && due && !allowed), "a pulse %s; due %d, allowed %d, low %llu of %u, since dir %llu of %u",
              waited ? "waits without reason" : "does not wait", due, allowed, (unsigned long long)low, s.stepspace, (unsigned long long)since_dir, s.dirsetup);
        if (c.visit) {
            total = int32_t(uint32_t(total) + uint32_t(delta(c)));
            least = std::min(least, delta(c)), most = std::max(most, delta(c));
            since_visit = 0;
        }

        // The ramp.
        const bool pause = take || fresh || (halt && !halted);
        const bool ramps = advance || braking;
        const int64_t velocity_next = !gate ? 0 : pause || !ramps ? velocity : ramped();
        fresh = take || (halt && !halted) || (fresh && !ramps);
        if (halt || take) braking = halt || !c.enable;
        halted = halt;
        if (halt) target = 0, limit = s.stop_accel;
        else if (take) target = c.enable ? int32_t(c.velocity) : 0, limit = c.enable ? c.accel : s.stop_accel;
        velocity = velocity_next;

        // The reference model.
        const bool start = gate && due && allowed && advance;
        const bool end = pulse && (high >= steplen || (!gate && s.kind != 2));
        if (start) (a == bb) != reverse ? a = !a : bb = !bb;
        if (turn) reverse = !reverse, since_dir = 0;
        if (start) pulse = true, high = 0;
        if (end) pulse = false, low = 0;
        high += pulse, low += !pulse, since_dir++;

        b.edge();

        const bool one = c.step ^ s.step_invert, two = c.dir ^ s.dir_invert;
        drive.clock(s, gate, one, two);
        const bool one_due = s.kind == 2 ? a : s.kind == 1 ? pulse && !reverse : pulse;
        const bool two_due = s.kind == 2 ? bb : s.kind == 1 ? pulse && reverse : reverse;
        CHECK(b, one == one_due && two == two_due, "kind %u: STEP %d DIR %d, promptly would be %d %d", s.kind, one, two, one_due, two_due);

        // Position: the drive's count, and in between exactly the sum of the velocities.
        const int32_t pulses = int32_t(uint32_t(total) + uint32_t(delta(c)));
        const int64_t now = int64_t(uint64_t(uint32_t(pulses)) << 32 | c.fraction);
        CHECK(b, pulses == int32_t(drive.counted), "position says %d pulses, the pins had %lld", pulses, (long long)drive.counted);
        const int64_t expected = !gate || waited || !advance ? position : next;
        CHECK(b, now == expected, "position %016llx, expected %016llx", (long long)now, (long long)expected);
        position = now;
        waits += waited;
        waiting = waited ? waiting + 1 : 0;
        CHECK(b, waiting <= steplen + stepspace + dirsetup + dirhold + 4, "a pulse never comes");

        halting = halt && gate ? halting + 1 : 0;
        if (c.stopped) CHECK(b, halt && velocity == 0 && !pulse, "stopped, but velocity %lld, pulse %d", (long long)velocity, pulse);
        const bool rests = halting > 4 && velocity == 0 && !pulse;
        quiet = rests ? quiet + 1 : 0;
        CHECK(b, quiet < 3 || c.stopped, "at rest but not stopped");
    }

    void clocks(uint64_t n) {
        while (n--) clock();
    }

    void commit(int32_t velocity, uint32_t accel, bool enable = true) {
        auto &c = *b.core;
        c.commit = 1, c.enable = enable, c.velocity = uint32_t(velocity), c.accel = accel;
        do clock(); while (!c.advance && standing < 16);
        c.commit = 0;
    }

    // Close the gate, let the old times pass, change the settings, open it again.
    void reconfigure(const Settings &to) {
        auto &c = *b.core;
        c.gate = 0, c.commit = 0;
        clocks(s.steplen + s.stepspace + s.dirhold + s.dirsetup + 4);
        c.steplen = to.steplen, c.stepspace = to.stepspace, c.dirsetup = to.dirsetup, c.dirhold = to.dirhold;
        c.stop_accel = to.stop_accel, c.step_invert = to.step_invert, c.dir_invert = to.dir_invert, c.kind = to.kind;
        s = to;
        c.visit = 0;
        b.edge();
        since_visit++;
        drive.reset(c.step ^ s.step_invert, c.dir ^ s.dir_invert);
        low = since_dir = LONG_AGO;
        CHECK(b, (s.kind == 2 || !drive.one) && (s.kind != 1 || !drive.two), "a pin is not at its inactive level behind a closed gate");
        c.stop = 0;
        clock();
        c.gate = 1;
    }
};

static int32_t any_velocity(Random &r) {
    static const int32_t edges[] = {0, 1, -1, INT32_MAX, -INT32_MAX, INT32_MIN, 2, -2, 1 << 30, -(1 << 30), 0x55555555, -0x55555555};
    if (r.one_in(3)) return edges[r.below(sizeof edges / sizeof *edges)];
    const int32_t v = int32_t(r.up_to_bits(31));
    return r.one_in(2) ? v : -v;
}

static int32_t fast_velocity(Random &r) { return 0x7FFFFFFF >> r.below(6); }

static Settings any_settings(Random &r, unsigned round) {
    const unsigned bits = r.one_in(3) ? 1 : r.one_in(2) ? 4 : r.one_in(20) ? 12 : 7;
    Settings s;
    s.steplen = r.up_to_bits(bits), s.stepspace = r.up_to_bits(bits);
    s.dirsetup = r.up_to_bits(bits + 1), s.dirhold = r.up_to_bits(bits + 1);
    s.stop_accel = r.one_in(4) ? 0 : uint32_t(r.up_to_bits(32));
    s.step_invert = r.one_in(2), s.dir_invert = r.one_in(2);
    s.kind = round % 4;
    return s;
}

static void random_rounds(Checker &k, uint64_t wanted) {
    Random &r = k.b.random;
    auto &c = *k.b.core;
    for (unsigned round = 0; k.drive.pulses < wanted || round < 400; round++) {
        k.reconfigure(any_settings(r, round));
        k.standing = r.one_in(3) ? r.below(17) : 0;  // includes path time that never passes
        const unsigned style = r.below(4);
        const uint64_t commits = 20 + r.below(60);
        for (uint64_t n = 0; n < commits; n++) {
            const bool enable = !r.one_in(12);
            switch (style) {
            case 0:  // anything
                k.commit(any_velocity(r), r.one_in(3) ? 0 : uint32_t(r.up_to_bits(32)), enable);
                break;
            case 1:  // full rate and back, with and without a ramp
                k.commit(n & 1 ? fast_velocity(r) : -fast_velocity(r), r.one_in(2) ? 0 : 0xFFFFFFFF >> r.below(8), enable);
                break;
            case 2:  // fast pulses in one direction
                k.commit(fast_velocity(r), 0, enable);
                break;
            default:  // around zero, slow ramps
                k.commit(int32_t(r.below(7)) - 3, uint32_t(r.up_to_bits(26)), enable);
            }
            for (uint64_t i = r.one_in(5) ? r.below(4) : r.below(400); i; i--) {
                // a soft stop, sometimes waited for, sometimes cut by the gate
                if (r.one_in(3000)) {
                    c.stop = 1;
                    k.clocks(r.below(600));
                    if (r.one_in(2)) {
                        c.gate = 0;
                        k.clocks(2);
                        c.gate = 1;
                    }
                    c.stop = 0;
                }
                if (r.one_in(2000)) {  // the gate, in any phase
                    c.gate = 0;
                    k.clocks(1 + r.below(6));
                    c.gate = 1;
                }
                k.clock();
            }
        }
    }
}

// The fastest: as many pulses as the times allow, to the clock, both ways, in every kind.
static void full_rate(Checker &k) {
    // 20, 25, 30: 500 ns at 40, 50, 60 MHz, so that 1 MHz comes out exactly
    for (const uint32_t half : {1u, 20u, 25u, 30u})
        for (unsigned kind = 0; kind < 3; kind++)
            for (const int32_t velocity : {INT32_MAX, INT32_MIN}) {
                Settings s;
                s.steplen = s.stepspace = half, s.kind = kind;
                k.reconfigure(s);
                k.commit(velocity, 0);
                k.clocks(16 * half);
                const int64_t before = k.drive.counted;
                const uint64_t n = 1000;
                k.clocks(2 * half * n);
                CHECK(k.b, std::llabs(k.drive.counted - before) == int64_t(n), "kind %u: %lld pulses in %llu clocks at %u/%u", kind,
                      (long long)(k.drive.counted - before), (unsigned long long)(2 * half * n), half, half);
            }
    CHECK(k.b, k.least == -8 && k.most == 8, "16 clocks at full rate: delta %d to %d, not -8 to 8", k.least, k.most);
}

// 1 MHz asked for at 500/500 ns: it fits without a single wait. 40, 50, 60 MHz.
static void a_megahertz(Checker &k) {
    for (const uint32_t mhz : {40u, 50u, 60u}) {
        Settings s;
        s.steplen = s.stepspace = mhz / 2;
        k.reconfigure(s);
        k.commit(int32_t((uint64_t(1) << 32) / mhz), 0);
        k.clocks(4 * mhz);
        const int64_t before = k.drive.counted;
        const uint64_t waits = k.waits;
        k.clocks(10000 * mhz);
        CHECK(k.b, std::llabs(k.drive.counted - before - 10000) <= 1, "1 MHz at %u MHz: %lld pulses in 10 ms", mhz, (long long)(k.drive.counted - before));
        CHECK(k.b, k.waits == waits, "1 MHz at %u MHz: %llu clocks waited", mhz, (unsigned long long)(k.waits - waits));
    }
}

// enable = 0 reaches the core: it comes to rest, and neither time nor a stop nor a gate starts it
// again, only a commit with enable.
static void enable_reaches_the_core(Checker &k) {
    auto &c = *k.b.core;
    for (unsigned kind = 0; kind < 3; kind++) {
        Settings s;
        s.kind = kind, s.stop_accel = 0xFFFFFFFF;
        k.reconfigure(s);
        k.commit(1 << 22, 0);
        k.clocks(2000);
        CHECK(k.b, k.velocity >> 24 == 1 << 22, "does not run");
        k.commit(1 << 22, 0, false);
        k.clocks(20000);  // 2^22 at 256 a clock, and some
        const int64_t rest = k.drive.counted;
        CHECK(k.b, k.velocity == 0, "disabled, and still at %lld", (long long)(k.velocity >> 24));
        k.commit(1 << 22, 0, false);
        k.clocks(2000);
        c.stop = 1;
        k.clocks(20);
        CHECK(k.b, c.stopped, "not stopped");
        k.commit(1 << 22, 0);  // ignored while stopping
        c.stop = 0;
        k.clocks(2000);
        c.gate = 0;
        k.commit(1 << 22, 0);  // ignored behind a closed gate
        k.clocks(3);
        c.gate = 1;
        k.clocks(2000);
        CHECK(k.b, k.drive.counted == rest, "moved without a command");
        k.commit(1 << 22, 0);
        k.clocks(2000);
        CHECK(k.b, k.drive.counted != rest, "does not run again");
    }
}

// The gate closes in every clock of a pulse, and opens again as soon as it can.
static void gate_in_mid_pulse(Checker &k) {
    auto &c = *k.b.core;
    for (unsigned kind = 0; kind < 3; kind++)
        for (unsigned phase = 0; phase < 40; phase++) {
            Settings s;
            s.steplen = 9, s.stepspace = 7, s.dirsetup = 11, s.dirhold = 5, s.kind = kind;
            k.reconfigure(s);
            k.commit(phase & 1 ? INT32_MAX : -INT32_MAX, 0);
            k.clocks(40 + phase);
            c.gate = 0;
            k.clock();
            c.gate = 1;
            k.commit(phase & 2 ? INT32_MAX : -INT32_MAX, 0);
            k.clocks(100);
        }
}

// The widest times, once: no counter may be shorter than its register.
static void widest_times(Checker &k) {
    for (unsigned wide = 0; wide < 4; wide++) {
        Settings s;
        (wide == 0 ? s.steplen : wide == 1 ? s.stepspace : wide == 2 ? s.dirsetup : s.dirhold) = wide < 2 ? 0x1FFF : 0xFFFF;
        k.reconfigure(s);
        const uint64_t before = k.drive.pulses;
        for (unsigned n = 0; n < 8; n++) {
            k.commit(n & 2 ? -INT32_MAX : INT32_MAX, 0);
            k.clocks(50000);
        }
        CHECK(k.b, k.drive.pulses > before, "no pulse at the widest time %u", wide);
    }
}

int main(int argc, char **argv) {
    B b("stepgen", argc, argv);
    Checker k(b);
    auto &c = *b.core;
    c.gate = c.stop = c.commit = c.enable = 0;
    c.steplen = c.stepspace = 1;
    full_rate(k);
    a_megahertz(k);
    enable_reaches_the_core(k);
    gate_in_mid_pulse(k);
    widest_times(k);
    random_rounds(k, argc > 2 ? strtoull(argv[2], nullptr, 0) : 2000000);
    return b.pass("%llu pulses at the pins = position, %llu reversals, %llu clocks waited, time stood in %llu", (unsigned long long)k.drive.pulses,
                  (unsigned long long)k.drive.reversals, (unsigned long long)k.waits,
                  (unsigned long long)k.stood);
}
