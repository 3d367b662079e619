// The banks: every register of the map and the core it belongs to, over the CSR bus, for one board.
#include "Vcores.h"
#include "bench.h"
#include <algorithm>
#include <fstream>
#include <map>
#include <string>
#include <vector>

using B = Bench<Vcores>;

#ifndef MAP
#error "run.sh says where cores.map is"
#endif

struct Register {
    uint32_t at;
    std::string access;
    uint32_t mask;  // the bits it has
};

struct Bus {
    B &b;
    std::map<std::string, Register> map;
    uint64_t now = 0;  // the wall clock, counted here
    std::vector<int64_t> pulses = std::vector<int64_t>(16);
    uint32_t step_was = 0, widest_step = 0;
    std::vector<uint64_t> first_rise = std::vector<uint64_t>(16);

    explicit Bus(B &b) : b(b) {
        std::ifstream file(MAP);
        auto hex = [](const std::string &text) { return uint32_t(strtoul(text.c_str(), nullptr, 16)); };
        std::string name, at, access, mask;
        while (file >> name >> at >> access >> mask) map[name] = {hex(at), access, hex(mask)};
    }
    uint32_t flash = 0;  // the flash's model: every bit comes back 32 clocks later
    bool sck_was = false;
    // What is at the pads is not what drives them, and must not matter to it: any levels at any
    // time.
    uint32_t step_pads = 0, pwm_pads = 0;  // a bit per pin
    uint64_t out_pads = 0;
    bool still = false;
    void pads() {
        auto &c = *b.core;
        c.step_seen = b.random.next() & step_pads, c.dir_seen = b.random.next() & step_pads;
        c.step_n_seen = b.random.next() & step_pads, c.dir_n_seen = b.random.next() & step_pads;
        c.pwm_seen = b.random.next() & pwm_pads, c.pwm_dir_seen = b.random.next() & pwm_pads;
        c.outputs_seen = (b.random.next() | uint64_t(b.random.next()) << 32) & out_pads;
    }
    std::vector<uint32_t> beats = {0};  // of the PHY's clock, in so many clocks
    void clock() {
        if (!still && b.random.one_in(8)) pads();
        b.core->eth_beat = b.random.one_in(2);
        beats.push_back(beats.back() + b.core->eth_beat);
        b.edge();
        now++;
        if (b.core->spi_clk && !sck_was) flash = flash << 1 | b.core->spi_mosi;
        if (!b.core->spi_clk && sck_was) b.core->spi_miso = flash >> 31;
        CHECK(b, b.core->spi_clk == sck_was || !b.core->spi_cs_n, "SCK moves while CS is high");
        sck_was = b.core->spi_clk;
        CHECK(b, b.core->step_n == uint32_t(~b.core->step & widest_step) && b.core->dir_n == uint32_t(~b.core->dir & widest_step), "a differential copy is no copy");
        const uint32_t rises = b.core->step & ~step_was;
        step_was = b.core->step;
        for (unsigned n = 0; n < 16; n++)
            if (rises >> n & 1) {
                pulses[n] += b.core->dir >> n & 1 ? -1 : 1;
                if (!first_rise[n]) first_rise[n] = now;
            }
    }
    void run(uint64_t n) { while (n--) clock(); }
    uint32_t at(const std::string &name) {
        CHECK(b, map.count(name), "no register %s", name.c_str());
        return map[name].at;
    }
    // The same timing as the bridge: address and write in one clock; the address of a read a clock
    // ahead.
    void write(const std::string &name, uint32_t value) {
        b.core->adr = at(name), b.core->dat_w = value, b.core->we = 1;
        clock();
        b.core->we = 0, b.core->adr = b.random.next();
        clock();
    }
    uint32_t peek(uint32_t address) {
        b.core->coming = address;
        clock();
        b.core->coming = b.random.next();
        clock();
        return b.core->dat_r;
    }
    uint32_t read(const std::string &name) { return peek(at(name)); }
    uint64_t read64(const std::string &name) { return read(name + "_lo") | uint64_t(read(name + "_hi")) << 32; }
    void expect(const std::string &name, uint32_t value) {
        const uint32_t is = read(name);
        CHECK(b, is == value, "%s reads %08x, expected %08x", name.c_str(), is, value);
    }
};

static std::string nth(const char *kind, unsigned n, const char *reg) { return kind + std::to_string(n) + reg; }

// So many bits.
static uint64_t lowest(unsigned count) { return count < 64 ? (1ull << count) - 1 : ~0ull; }

struct Tests : Bus {
    Vcores &c = *b.core;
    Random &r = b.random;
    unsigned steps = 0, encoders = 0, pwms = 0, ins = 0, outs = 0;
    uint64_t estops = 0, trigger = 0, free_inputs = 0;  // inputs, a bit each
    std::map<std::string, uint32_t> wrote;
    unsigned absent = 0;

    explicit Tests(B &b) : Bus(b) {}

    // No e-stop is active.
    void drive(uint64_t levels) { c.inputs = (levels & free_inputs) | (estops & ~trigger); }
    bool present(const std::string &name) {
        for (auto [kind, n] : {std::pair{"stepgen", steps}, {"encoder", encoders}, {"pwm", pwms}})
            for (auto prefix : {std::string(kind), std::string("command.") + kind, std::string("status.") + kind})
                if (name.rfind(prefix, 0) == 0 && isdigit(name[prefix.size()])) return unsigned(atoi(name.c_str() + prefix.size())) < n;
        if (name.rfind("debounce.in", 0) == 0) return unsigned(atoi(name.c_str() + 11)) < ins;
        if (name == "command.gpio_out_high" || name == "gpio_high.safe" || name == "gpio_high.invert_out") return outs > 32;
        if (name.rfind("segments.", 0) == 0) return (read("ident.features") & 1) != 0;
        return true;
    }
    // Sampled words of one clock, valid when the wide counters have visited all channels.
    void sample() {
        write("timebase.strobe", 2);
        run(18);
    }
    // Arm bits of the four kinds of latch; a channel has one latch, for its index and for the
    // probe.
    void arm(uint32_t enc_index, uint32_t enc_probe, uint32_t step_index, uint32_t step_probe) {
        write("command.enables", enc_index << 16 | 0xffff);
        write("command.arms", enc_probe << 16 | step_index);
        write("command.probe_arms", step_probe);
        write("timebase.strobe", 1);
        run(40);
        sample();
    }
    void flags(uint32_t enc_index, uint32_t enc_probe, uint32_t step_index, uint32_t step_probe) {
        const uint32_t is[4] = {read("status.flags0") & 0xffff, read("status.flags1") >> 16, read("status.flags1") & 0xffff, read("status.flags2") & 0xffff};
        CHECK(b, is[0] == enc_index && is[1] == enc_probe && is[2] == step_index && is[3] == step_probe, "flags %x %x %x %x", is[0], is[1], is[2], is[3]);
    }

    void powers_up() {
        c.we = c.rst = c.ext_reset = c.inputs = c.enc_a = c.enc_b = c.enc_i = c.enc_mask = c.step_index = 0;
        c.frame_done = c.frame_slot = c.frame_pending = c.pending_slot = 0;
        c.abi = 0x12345678;
        c.spi_miso = c.factory = c.eth_beat = 0;
        c.step_seen = c.dir_seen = c.step_n_seen = c.dir_n_seen = c.pwm_seen = c.pwm_dir_seen = c.outputs_seen = 0;
        b.settle();
        widest_step = c.step | c.step_n;  // a bit per channel
        run(40);
    }
    void says_what_it_is() {
        expect("ident.magic", 0x46436e43);
        expect("ident.abi", 0x12345678);
        const uint32_t counts = read("ident.channels0"), pins = read("ident.channels1"), hz = read("ident.sys_clk_hz");
        steps = counts & 255, encoders = counts >> 8 & 255, pwms = counts >> 16 & 255, ins = pins & 255, outs = pins >> 8 & 255;
        CHECK(b, hz >= 10000000 && steps && encoders && pwms && ins && outs, "an empty board");
        CHECK(b, widest_step == (1u << steps) - 1, "%u step generators, pins %x", steps, widest_step);
        step_pads = (1u << steps) - 1, pwm_pads = (1u << pwms) - 1, out_pads = lowest(outs);
        estops = read("gpio.estop_mask"), trigger = read("gpio.estop_level");
        CHECK(b, estops && !(trigger & ~estops) && estops >> (std::min(ins, 32u) - 1) == 1, "e-stop inputs %llx, level %llx", (unsigned long long)estops, (unsigned long long)trigger);
        free_inputs = lowest(ins) & ~estops;
        drive(0);
    }
    // Absent channels read 0 and ignore writes; present ones read back what was written.
    void every_register_reads_back() {
        for (auto &[name, reg] : map) {
            if (reg.access == "ro" || name == "watchdog.control" || name == "timebase.strobe" || name == "flash.data") continue;
            const uint32_t value = r.next();
            write(name, value);
            if (reg.access == "rw" && present(name)) wrote[name] = value;
        }
        for (auto &[name, value] : wrote) {
            uint32_t mask = map[name].mask;
            if (name == "gpio.safe" || name == "gpio.invert_out" || name == "command.gpio_out" || name == "segments.mask") mask = uint32_t(lowest(outs));
            if (name == "gpio_high.safe" || name == "gpio_high.invert_out" || name == "command.gpio_out_high") mask = uint32_t(lowest(outs) >> 32);
            const uint32_t is = read(name);
            CHECK(b, (is & mask) == (value & mask), "%s reads %08x, wrote %08x", name.c_str(), is, value);
        }
        for (auto &[name, reg] : map)
            if (reg.access == "wo" || !present(name)) expect(name, 0), absent++;
        for (unsigned n = 0; n < 4000; n++) {  // addresses between the registers do not answer
            const uint32_t address = r.below(1 << 16);
            bool known = address < 8 * 512;  // LiteX's
            for (auto &[name, reg] : map) known |= reg.at == address;
            if (!known) CHECK(b, peek(address) == 0, "something at word %x", address);
        }
        CHECK(b, !c.gate, "writing settings opened the gate");
    }
    // For all tests below.
    void quiet_settings() {
        for (auto &[name, value] : wrote) write(name, 0);
        for (unsigned n = 0; n < pwms; n++) write(nth("pwm", n, ".period"), 100);
        write("watchdog.timeout", 0xFFFFFFFF);
        write("watchdog.grace", 1000);
        write("watchdog.control", 0x434c5231);
    }
    // It catches the clock of the write, always the same number of clocks after it
    // began.
    void a_snapshot_is_of_its_clock() {
        auto snapshot = [&] {
            const uint64_t began = now;
            write("timebase.snapshot", 0);
            run(r.below(100));
            const uint64_t caught = read64("timebase.now");
            CHECK(b, caught < beats.size(), "the wall clock is ahead");
            expect("timebase.eth_beats", beats[caught]);  // of the same clock
            return caught - began;
        };
        const uint64_t offset = snapshot();
        for (unsigned n = 0; n < 20; n++) CHECK(b, snapshot() == offset, "the snapshot is not of the clock it was asked in");
    }
    // As they are and two clocks late; what drives them stands at rest.
    void the_pads_read_as_they_are() {
        expect("ident.features", (read("ident.features") & 1) | 2);
        still = true;
        for (unsigned round = 0; round < 200; round++) {
            auto all = [&] {
                return std::vector<uint32_t>{c.step_seen | uint32_t(c.dir_seen) << 16, c.step_n_seen | uint32_t(c.dir_n_seen) << 16, c.pwm_seen | uint32_t(c.pwm_dir_seen) << 16, uint32_t(c.outputs_seen), uint32_t(c.outputs_seen >> 32)};
            };
            static const char *const names[] = {"pads.step", "pads.step_n", "pads.pwm", "pads.outputs", "pads.outputs_high"};
            pads();
            run(2);
            const auto old = all();
            for (unsigned n = 0; n < 5; n++) expect(names[n], old[n]);
            const unsigned n = r.below(5);
            pads();
            expect(names[n], old[n]);
            expect(names[n], all()[n]);
        }
        still = false;
    }
    // Turning pins over looked like pulses: count from here.
    void count_from_here() {
        pulses.assign(16, 0);
        first_rise.assign(16, 0);
    }
    // An unknown key does nothing, ARM opens.
    void only_its_key_arms() {
        write("watchdog.control", 0x41524d30);
        CHECK(b, !c.gate, "any word arms");
        write("watchdog.control", 0x41524d31);
        CHECK(b, c.gate, "does not arm");
        expect("watchdog.status", 0x21);
    }
    // A staged command changes nothing; the strobe starts every channel on one clock, and samples
    // on the same.
    void all_start_on_one_clock() {
        for (unsigned n = 0; n < steps; n++) {
            write(nth("command.stepgen", n, "_velocity"), 0x04000000);
            write(nth("command.stepgen", n, "_accel"), 0);
            CHECK(b, c.step == 0, "moves before the strobe");
        }
        for (unsigned n = 0; n < pwms; n++) write(nth("command.pwm", n, "_width"), 0x40000000 | 100 << 8);
        write("command.gpio_out", 0x5a5a5a5a);
        write("command.gpio_out_high", 0x1234567a);
        write("command.enables", 0x0000ffff);
        run(300);
        CHECK(b, c.step == 0 && c.pwm == 0 && c.outputs == 0, "moves before the strobe");
        write("timebase.strobe", 3);
        run(1000);
        for (unsigned n = 0; n < steps; n++)
            CHECK(b, first_rise[n] && first_rise[n] == first_rise[0], "channels 0 and %u start at %llu and %llu", n, (unsigned long long)first_rise[0], (unsigned long long)first_rise[n]);
        CHECK(b, c.pwm == (1u << pwms) - 1, "pwm %x", c.pwm);
        CHECK(b, c.outputs == (0x1234567a5a5a5a5a & lowest(outs)), "outputs %llx", (unsigned long long)c.outputs);
        expect("gpio.out_now", uint32_t(c.outputs));
        expect("gpio_high.out_now", uint32_t(c.outputs >> 32));
    }
    // All words of it; coherent with the pins; reading changes nothing.
    void a_sample_is_of_one_clock() {
        for (unsigned round = 0; round < 200; round++) {
            for (unsigned n = 0; n < steps; n++) write(nth("command.stepgen", n, "_velocity"), r.one_in(6) ? 0x80000000 : uint32_t(r.next()));
            run(r.below(300));
            drive(r.next() | uint64_t(r.next()) << 32);
            run(40);  // a debouncer with limit 0 takes 35 clocks
            const auto at_strobe = pulses;
            c.adr = at("timebase.strobe"), c.dat_w = round & 1 ? 3 : 2, c.we = 1;
            clock();
            const auto one_later = pulses;
            c.we = 0;
            run(18);  // until the wide counters have visited all channels
            const uint64_t when = read64("status.sample");
            run(r.below(50));
            CHECK(b, when == read64("status.sample"), "reading changed the sample");
            expect("status.gpio_in", uint32_t(c.inputs));
            expect("status.gpio_in_high", uint32_t(c.inputs >> 32));
            for (unsigned n = 0; n < steps; n++) {
                const int32_t hi = read(nth("status.stepgen", n, "_position_hi")), v = read(nth("status.stepgen", n, "_velocity"));
                CHECK(b, hi == at_strobe[n] || hi == one_later[n], "stepgen %u: sample %d, pins %lld", n, hi, (long long)one_later[n]);
                CHECK(b, v != INT32_MIN, "stepgen %u runs at -2^31", n);
            }
        }
    }
    // Constant velocities, a different one for each channel: every channel's words are its own and
    // of the strobe's clock, from 18 clocks after it on, in any order of reading.
    void every_channel_moves_its_own_way() {
        unsigned moved = 0;
        for (unsigned round = 0; round < 60; round++) {
            uint64_t position[2][16], when[2];
            std::vector<int32_t> velocity(steps);
            for (unsigned n = 0; n < steps; n++) write(nth("command.stepgen", n, "_velocity"), velocity[n] = int32_t(r.next()) >> 8);
            write("timebase.strobe", 1);
            run(50 + r.below(50));
            for (unsigned s = 0; s < 2; s++) {
                write("timebase.strobe", 2);  // and one clock more
                run(17);
                for (unsigned begin = r.below(steps), i = 0; i < steps; i++) {
                    const unsigned n = (begin + i) % steps;
                    position[s][n] = read(nth("status.stepgen", n, "_position_lo"));
                    expect(nth("status.stepgen", n, "_velocity"), velocity[n]);
                    position[s][n] |= uint64_t(read(nth("status.stepgen", n, "_position_hi"))) << 32;
                }
                when[s] = read64("status.sample");
                run(r.below(3000));
            }
            const uint32_t limited = read("status.flags0") >> 16;
            for (unsigned n = 0; n < steps; n++) {
                if (limited >> n & 1) continue;  // a reversal: the pulse waited for its direction
                const int64_t way = position[1][n] - position[0][n], expected = velocity[n] * int64_t(when[1] - when[0]);
                CHECK(b, way == expected, "stepgen %u: moves %lld in %lld clocks at %d", n, (long long)way, (long long)(when[1] - when[0]), velocity[n]);
                moved++;
            }
        }
        CHECK(b, moved > 30 * steps, "only %u of %u ways checked", moved, 60 * steps);
    }
    // A velocity above what the timing allows: one channel reports it, until it has obeyed for a
    // whole sample.
    void a_velocity_too_high_is_reported() {
        for (unsigned n = 0; n < steps; n++) write(nth("command.stepgen", n, "_velocity"), n ? 0 : 0x7fffffff);
        write("stepgen0.steplen", 50);
        write("timebase.strobe", 3);
        run(300);
        write("timebase.strobe", 2);
        CHECK(b, read("status.flags0") >> 16 == 1, "limited flags %x", read("status.flags0"));
        write("stepgen0.steplen", 1);
        write("command.stepgen0_velocity", 1000);
        write("timebase.strobe", 1);
        run(300);
        write("timebase.strobe", 2);
        write("timebase.strobe", 2);
        CHECK(b, read("status.flags0") >> 16 == 0, "limited flags %x", read("status.flags0"));
    }
    // To the clock.
    void a_timed_commit_comes_at_its_time() {
        for (unsigned round = 0; round < 50; round++) {
            write("command.gpio_out", 0);
            write("command.gpio_out_high", 0);
            write("timebase.strobe", 1);
            write("command.gpio_out", ~0u);
            write("timebase.snapshot", 0);
            const uint64_t base = read64("timebase.now"), here = now;
            const uint64_t target = base + 60 + r.below(200);
            write("timebase.commit_at_lo", uint32_t(target));
            write("timebase.commit_at_hi", target >> 32);
            write("timebase.strobe", 4);
            expect("timebase.status", 1);
            uint64_t n = 0;
            for (; !c.outputs; n++) {
                clock();
                CHECK(b, n < 1000, "a timed commit never comes");
            }
            static int64_t lag = INT64_MIN;  // from the commit clock to the pins: the same every time
            const int64_t is = int64_t(now - here) - int64_t(target - base);
            if (lag == INT64_MIN) lag = is;
            CHECK(b, is == lag, "a timed commit is %lld clocks off", (long long)(is - lag));
            expect("timebase.status", 0);
        }
    }
    // A few edges, an index, an illegal edge.
    void encoders_count_and_latch() {
        for (unsigned n = 0; n < encoders; n++) {
            static const int gray[4] = {0, 1, 3, 2};
            const unsigned edges = 5 + n;
            arm(1u << n, 0, 0, 0);
            for (unsigned e = 1; e <= edges; e++) {
                c.enc_a = (c.enc_a & ~(1u << n)) | (gray[e & 3] & 1) << n, c.enc_b = (c.enc_b & ~(1u << n)) | (gray[e & 3] >> 1) << n;
                run(8);
                if (e == 3) c.enc_i |= 1u << n;
                run(8);
            }
            run(40);
            sample();
            expect(nth("status.encoder", n, "_count"), edges);
            expect(nth("status.encoder", n, "_latch"), 3);
            flags(1u << n, 0, 0, 0);
            const uint32_t edge = read(nth("status.encoder", n, "_edge"));
            CHECK(b, edge >> 24 == 0 && (read("status.sample_lo") - edge & 0xffffff) < 100, "edge word %x, sample at %x", edge, read("status.sample_lo"));
            c.enc_a ^= 1u << n, c.enc_b ^= 1u << n;
            run(40);
            sample();
            CHECK(b, read(nth("status.encoder", n, "_edge")) >> 24 == 1 && read("status.flags2") >> 16 == 1u << n, "an illegal edge is not told");
            sample();
            CHECK(b, read("status.flags2") >> 16 == 0, "an illegal edge is told twice");
            arm(0, 0, 0, 0);
            flags(0, 0, 0, 0);
        }
    }
    // Modes reach the core: the counter, the polarity of the index, its mask, and clear on index.
    void modes_reach_the_encoders() {
        for (unsigned n = 0; n < encoders; n++) {
            write(nth("encoder", n, ".mode"), 3 | 1 << 4 | 1 << 5 | 1 << 7);
            run(40);
            arm(1u << n, 0, 0, 0);
            const uint32_t from = read(nth("status.encoder", n, "_count"));
            auto turn = [&](unsigned edges) {
                while (edges--) c.enc_a &= ~(1u << n), run(8), c.enc_a |= 1u << n, run(8);
            };
            turn(2);
            c.enc_i &= ~(1u << n), run(8), c.enc_i |= 1u << n, run(40);
            flags(0, 0, 0, 0);
            c.enc_mask |= 1u << n;
            run(40);
            c.enc_i &= ~(1u << n), run(8), turn(3), run(40);
            sample();
            expect(nth("status.encoder", n, "_latch"), from + 2);
            expect(nth("status.encoder", n, "_count"), 3);
            flags(1u << n, 0, 0, 0);
            c.enc_i |= 1u << n, c.enc_mask &= ~(1u << n);
            arm(0, 0, 0, 0);
            write(nth("encoder", n, ".mode"), 0);
        }
    }
    // The probe is one input for all channels, each with its own arm bit; then the index pins of
    // the step generators.
    void probe_and_index_latch() {
        for (unsigned round = 0; round < 4; round++) {
            unsigned input;
            do input = r.below(ins); while (!(free_inputs >> input & 1) || input / 32 != (ins > 32 ? round % 2 : 0));
            const unsigned low = r.below(2);
            drive(low ? ~0ull : 0);
            write("gpio.probe", input | 1 << 8 | low << 9);
            run(40);
            const uint32_t chosen_e = r.next() & ((1u << encoders) - 1), chosen_s = r.next() & ((1u << steps) - 1);
            for (unsigned n = 0; n < steps; n++) write(nth("command.stepgen", n, "_velocity"), 0);
            arm(0, chosen_e, 0, chosen_s);
            flags(0, 0, 0, 0);
            drive(low ? ~(1ull << input) : 1ull << input);
            run(40);
            sample();
            flags(0, chosen_e, 0, chosen_s);
            for (unsigned n = 0; n < encoders; n++)
                if (chosen_e >> n & 1) expect(nth("status.encoder", n, "_latch"), read(nth("status.encoder", n, "_count")));
            for (unsigned n = 0; n < steps; n++)
                if (chosen_s >> n & 1) expect(nth("status.stepgen", n, "_latch"), read(nth("status.stepgen", n, "_position_hi")));
            arm(0, 0, 0, 0);
            flags(0, 0, 0, 0);
            write("gpio.probe", 0);

            const unsigned n = r.below(steps), invert = r.below(2);
            write(nth("stepgen", n, ".mode"), invert << 4);
            c.step_index = invert << n;
            run(4);
            arm(0, 0, (1u << steps) - 1, 0);
            c.step_index ^= 1u << n;
            run(40);
            sample();
            flags(0, 0, 1u << n, 0);
            expect(nth("status.stepgen", n, "_latch"), read(nth("status.stepgen", n, "_position_hi")));
            c.step_index = 0;
            write(nth("stepgen", n, ".mode"), 0);
            run(4);
            arm(0, 0, 0, 0);
        }
    }
    // All inputs, a bit each, in their two registers.
    void levels(const std::string &name, uint64_t value) {
        expect("gpio." + name, uint32_t(value));
        expect("gpio_high." + name, uint32_t(value >> 32));
    }
    // Of its debouncer, an input's own limit, and only its own.
    void each_input_has_its_limit() {
        for (unsigned n = 0; n < ins; n++) {
            if (estops >> n & 1) continue;
            drive(0);
            run(80);
            write("debounce.in" + std::to_string(n), 3);
            run(40);  // the limit is taken at the next visit
            drive(~0ull);
            run(80);
            levels("in_now", (free_inputs & ~(1ull << n)) | (estops & ~trigger));
            levels("raw_now", c.inputs);
            run(80);
            levels("in_now", c.inputs);
            write("debounce.in" + std::to_string(n), 0);
        }
    }
    // Each frame keeps its own time, also when it has to queue.
    void each_frame_has_its_arrival() {
        constexpr unsigned SLOTS = 4;
        uint64_t done[SLOTS];
        for (unsigned slot = 0; slot < SLOTS; slot++) {
            c.frame_done = 1, c.frame_slot = slot;
            clock();
            done[slot] = now;
            c.frame_done = 0, c.frame_pending = 1;
            run(20 + r.below(100));
        }
        const uint64_t first = read64("timebase.arrival");
        uint64_t last = first;
        for (unsigned slot = 1; slot < SLOTS; slot++) {
            c.pending_slot = slot;
            run(3);
            last = read64("timebase.arrival");
            CHECK(b, last - first == done[slot] - done[0], "slot %u: arrivals %llu clocks apart, expected %llu", slot, (unsigned long long)(last - first), (unsigned long long)(done[slot] - done[0]));
        }
        c.frame_pending = 0, c.pending_slot = 0;
        run(3);
        CHECK(b, read64("timebase.arrival") == last, "an arrival is forgotten with its frame");
    }
    // No transfer without select; 32 bits there and back; shorter ones
    // right-aligned.
    void the_flash_is_at_its_wires() {
        auto transfer = [&](uint32_t word, unsigned bits) {
            write("flash.length", bits);
            write("flash.data", word);
            expect("flash.status", 1);
            run(4 * (bits ? bits : 32));
            expect("flash.status", 0);
            return read("flash.data");
        };
        write("flash.length", 32);
        write("flash.data", 0xffffffff);
        run(200);
        CHECK(b, flash == 0 && c.spi_cs_n, "a transfer while not selected");
        write("flash.control", 1);
        run(8);
        CHECK(b, !c.spi_cs_n, "not selected");
        const uint32_t there = r.next();
        transfer(there, 32);
        CHECK(b, flash == there, "sent %08x, arrives %08x", there, flash);
        CHECK(b, transfer(0x9f000000, 8) == there >> 24, "the first byte back");
        CHECK(b, transfer(0, 0) == (there << 8 | 0x9f), "three bytes back, and the one behind them");
        write("flash.control", 0);
        run(4);
        CHECK(b, c.spi_cs_n, "selected for ever");
        c.factory = 1;
        run(4);
        expect("flash.status", 2);
        c.factory = 0;
    }
    // The watchdog's registers, and their values behind STOP.
    void stop_makes_everything_safe() {
        write("watchdog.token", 7);
        expect("watchdog.last_token", 7);
        CHECK(b, read("watchdog.remaining") > 0xFFFFFF00, "not fed");
        write("gpio.safe", 0x0f);
        write("gpio.invert_out", 0x03);
        write("gpio_high.safe", 0x0f);
        write("gpio_high.invert_out", 0x03);
        write("watchdog.control", 0x53544f50);
        run(3);
        CHECK(b, !c.gate && !c.step && !c.pwm && c.outputs == (0x0c0000000cull & lowest(outs)), "STOP: gate %d step %x pwm %x out %llx", c.gate, c.step, c.pwm, (unsigned long long)c.outputs);
        expect("watchdog.status", 0);
        expect("watchdog.last_close", 3);
        c.ext_reset = 1;
        run(4);
        expect("watchdog.status", 0x18);
        c.ext_reset = 0;
        run(4);
        write("watchdog.control", 0x434c5231);
        write("watchdog.control", 0x41524d31);
        expect("watchdog.status", 0x21);
    }
    // The gate in 4 clocks, latched by name, no way back while it is active.
    void every_estop_closes_the_gate() {
        for (unsigned n = 0; n < ins; n++) {
            if (!(estops >> n & 1)) continue;
            c.inputs ^= 1ull << n;
            run(4);
            CHECK(b, !c.gate, "e-stop input %u does not close the gate", n);
            write("watchdog.control", 0x434c5231);
            write("watchdog.control", 0x41524d31);
            expect("watchdog.status", 0xc0);
            expect("watchdog.last_close", 5);
            drive(0);
            run(8);
            expect("watchdog.status", 0x40);
            write("timebase.strobe", 2);
            expect("status.estop", 1u << n);
            write("watchdog.control", 0x41524d31);
            CHECK(b, !c.gate, "arms with an e-stop latched");
            write("watchdog.control", 0x434c5231);
            write("timebase.strobe", 2);
            expect("status.estop", 0);
            write("watchdog.control", 0x41524d31);
            expect("watchdog.status", 0x21);
        }
    }
};

int main(int argc, char **argv) {
    B b("cores", argc, argv);
    Tests t(b);
    t.powers_up();
    t.says_what_it_is();
    t.every_register_reads_back();
    t.quiet_settings();
    t.a_snapshot_is_of_its_clock();
    t.the_pads_read_as_they_are();
    t.count_from_here();
    t.only_its_key_arms();
    t.all_start_on_one_clock();
    t.a_sample_is_of_one_clock();
    t.every_channel_moves_its_own_way();
    t.a_velocity_too_high_is_reported();
    t.a_timed_commit_comes_at_its_time();
    t.encoders_count_and_latch();
    t.modes_reach_the_encoders();
    t.probe_and_index_latch();
    t.each_input_has_its_limit();
    t.each_frame_has_its_arrival();
    t.the_flash_is_at_its_wires();
    t.stop_makes_everything_safe();
    t.every_estop_closes_the_gate();
    return b.pass("%zu registers, %zu read back, %u absent or write-only; %u+%u+%u channels", t.map.size(), t.wrote.size(), t.absent, t.steps, t.encoders, t.pwms);
}
