// The banks: every register of the map against the cores it belongs to, over the CSR bus, for one board.
#include "Vcores.h"
#include "bench.h"
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
};

struct Bus {
    B &b;
    std::map<std::string, Register> map;
    uint64_t now = 0;  // the wall clock, counted here
    std::vector<int64_t> pulses = std::vector<int64_t>(16);
    uint32_t step_was = 0;
    std::vector<uint64_t> first_rise = std::vector<uint64_t>(16);

    explicit Bus(B &b) : b(b) {
        std::ifstream file(MAP);
        std::string name, at, access;
        while (file >> name >> at >> access) map[name] = {uint32_t(strtoul(at.c_str(), nullptr, 16)), access};
    }
    void clock() {
        b.edge();
        now++;
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
    // As LiteX's bridge does it: address and write in one clock, read data in the next.
    void write(const std::string &name, uint32_t value) {
        b.core->adr = at(name), b.core->dat_w = value, b.core->we = 1;
        clock();
        b.core->we = 0, b.core->adr = b.random.next();
        clock();
    }
    uint32_t peek(uint32_t address) {
        b.core->adr = address;
        clock();
        const uint32_t value = b.core->dat_r;
        b.core->adr = b.random.next();
        clock();
        return value;
    }
    uint32_t read(const std::string &name) { return peek(at(name)); }
    uint64_t read64(const std::string &name) { return read(name + "_lo") | uint64_t(read(name + "_hi")) << 32; }
    void expect(const std::string &name, uint32_t value) {
        const uint32_t is = read(name);
        CHECK(b, is == value, "%s reads %08x, expected %08x", name.c_str(), is, value);
    }
};

static std::string nth(const char *kind, unsigned n, const char *reg) { return kind + std::to_string(n) + reg; }

int main(int argc, char **argv) {
    B b("cores", argc, argv);
    Bus k(b);
    auto &c = *b.core;
    auto &r = b.random;
    c.we = c.rst = c.ext_reset = c.inputs = c.enc_a = c.enc_b = c.enc_i = 0;
    c.frame_done = c.frame_slot = c.frame_pending = c.pending_slot = 0;
    c.abi = 0x12345678;
    k.run(8);

    // Who it is.
    k.expect("ident.magic", 0x46436e43);
    k.expect("ident.abi", 0x12345678);
    const uint32_t counts = k.read("ident.channels0"), pins = k.read("ident.channels1"), hz = k.read("ident.sys_clk_hz");
    const unsigned steps = counts & 255, encoders = counts >> 8 & 255, pwms = counts >> 16 & 255, ins = pins & 255, outs = pins >> 8 & 255;
    CHECK(b, hz >= 10000000 && steps && encoders && pwms && ins && outs, "an empty board");

    // Every register: absent channels read 0 and ignore writes; present ones read back what was written.
    auto present = [&](const std::string &name) {
        for (auto [kind, n] : {std::pair{"stepgen", steps}, {"encoder", encoders}, {"pwm", pwms}})
            for (auto prefix : {std::string(kind), std::string("command.") + kind, std::string("status.") + kind})
                if (name.rfind(prefix, 0) == 0 && isdigit(name[prefix.size()])) return unsigned(atoi(name.c_str() + prefix.size())) < n;
        return true;
    };
    std::map<std::string, uint32_t> wrote;
    unsigned absent = 0;
    for (auto &[name, reg] : k.map) {
        if (reg.access == "ro" || name == "watchdog.control" || name == "timebase.strobe") continue;
        const uint32_t value = r.next();
        k.write(name, value);
        if (reg.access == "rw" && present(name)) wrote[name] = value;
    }
    for (auto &[name, value] : wrote) {
        const uint32_t mask = name == "led.pattern" ? 7 : name.rfind("gpio.", 0) == 0 ? uint32_t((1ull << outs) - 1) : ~0u;
        k.expect(name, value & mask);
    }
    for (auto &[name, reg] : k.map)
        if (reg.access == "wo" || !present(name)) k.expect(name, 0), absent++;
    for (unsigned n = 0; n < 4000; n++) {  // nothing answers between the registers
        const uint32_t address = r.below(1 << 16);
        bool known = address < 8 * 512;
        for (auto &[name, reg] : k.map) known |= reg.at == address;
        if (!known) CHECK(b, k.peek(address) == 0, "something at word %x", address);
    }
    CHECK(b, !c.gate, "writing settings opened the gate");

    // Quiet settings for everything that follows.
    for (auto &[name, value] : wrote) k.write(name, 0);
    for (unsigned n = 0; n < pwms; n++) k.write(nth("pwm", n, ".period"), 100);
    k.write("watchdog.timeout", 0xFFFFFFFF);
    k.write("watchdog.grace", 1000);
    k.write("watchdog.control", 0x434c5231);

    // Time: the snapshot catches the clock of the write, always the same number of clocks after it began.
    auto snapshot = [&] {
        const uint64_t began = k.now;
        k.write("timebase.snapshot", 0);
        k.run(r.below(100));
        return k.read64("timebase.now") - began;
    };
    const uint64_t offset = snapshot();
    for (unsigned n = 0; n < 20; n++) CHECK(b, snapshot() == offset, "the snapshot is not of the clock it was asked in");

    // Turning pins over looked like pulses: count from here.
    k.pulses.assign(16, 0);
    k.first_rise.assign(16, 0);

    // Gate: an unknown key does nothing, ARM opens.
    k.write("watchdog.control", 0x41524d30);
    CHECK(b, !c.gate, "any word arms");
    k.write("watchdog.control", 0x41524d31);
    CHECK(b, c.gate, "does not arm");
    k.expect("watchdog.status", 0x21);

    // A staged command changes nothing; the strobe starts every channel on one clock, and samples on the same.
    for (unsigned n = 0; n < steps; n++) {
        k.write(nth("command.stepgen", n, "_velocity"), 0x04000000);
        k.write(nth("command.stepgen", n, "_accel"), 0);
        CHECK(b, c.step == 0, "moves before the strobe");
    }
    for (unsigned n = 0; n < pwms; n++) k.write(nth("command.pwm", n, "_width"), 0x40000000 | 100);
    k.write("command.gpio_out", 0x5a5a5a5a);
    k.write("command.enables", 0x0000ffff);
    k.run(300);
    CHECK(b, c.step == 0 && c.pwm == 0 && c.outputs == 0, "moves before the strobe");
    k.write("timebase.strobe", 3);
    k.run(1000);
    for (unsigned n = 0; n < steps; n++)
        CHECK(b, k.first_rise[n] && k.first_rise[n] == k.first_rise[0], "channels 0 and %u start at %llu and %llu", n, (unsigned long long)k.first_rise[0], (unsigned long long)k.first_rise[n]);
    CHECK(b, c.pwm == (1u << pwms) - 1, "pwm %x", c.pwm);
    CHECK(b, c.outputs == (0x5a5a5a5a & ((1ull << outs) - 1)), "outputs %x", c.outputs);
    k.expect("gpio.out_now", c.outputs);

    // The sample: one clock, all words; coherent with the pins; reading changes nothing.
    for (unsigned round = 0; round < 200; round++) {
        for (unsigned n = 0; n < steps; n++) k.write(nth("command.stepgen", n, "_velocity"), r.one_in(6) ? 0x80000000 : uint32_t(r.next()));
        k.run(r.below(300));
        c.inputs = r.next() & ((1ull << ins) - 1);
        k.run(4);
        const auto at_strobe = k.pulses;
        c.adr = k.at("timebase.strobe"), c.dat_w = round & 1 ? 3 : 2, c.we = 1;
        k.clock();
        const auto one_later = k.pulses;
        c.we = 0;
        k.clock();
        const uint64_t when = k.read64("status.sample");
        k.run(r.below(50));
        CHECK(b, when == k.read64("status.sample"), "reading changed the sample");
        k.expect("status.gpio_in", c.inputs);
        for (unsigned n = 0; n < steps; n++) {
            const int32_t hi = k.read(nth("status.stepgen", n, "_position_hi")), v = k.read(nth("status.stepgen", n, "_velocity"));
            CHECK(b, hi == at_strobe[n] || hi == one_later[n], "stepgen %u: sample %d, pins %lld", n, hi, (long long)one_later[n]);
            CHECK(b, v != INT32_MIN, "stepgen %u runs at -2^31", n);
        }
    }
    // Asked for more than the timing allows: one channel says so, until it has obeyed for a whole sample.
    for (unsigned n = 0; n < steps; n++) k.write(nth("command.stepgen", n, "_velocity"), n ? 0 : 0x7fffffff);
    k.write("stepgen0.steplen", 50);
    k.write("timebase.strobe", 3);
    k.run(300);
    k.write("timebase.strobe", 2);
    CHECK(b, k.read("status.flags") >> 16 == 1, "limited flags %x", k.read("status.flags"));
    k.write("stepgen0.steplen", 1);
    k.write("command.stepgen0_velocity", 1000);
    k.write("timebase.strobe", 1);
    k.run(300);
    k.write("timebase.strobe", 2);
    k.write("timebase.strobe", 2);
    CHECK(b, k.read("status.flags") >> 16 == 0, "limited flags %x", k.read("status.flags"));

    // A commit at its time, to the clock.
    for (unsigned round = 0; round < 50; round++) {
        k.write("command.gpio_out", 0);
        k.write("timebase.strobe", 1);
        k.write("command.gpio_out", ~0u);
        k.write("timebase.snapshot", 0);
        const uint64_t base = k.read64("timebase.now"), here = k.now;
        const uint64_t target = base + 60 + r.below(200);
        k.write("timebase.commit_at_lo", uint32_t(target));
        k.write("timebase.commit_at_hi", target >> 32);
        k.write("timebase.strobe", 4);
        k.expect("timebase.status", 1);
        uint64_t n = 0;
        for (; !c.outputs; n++) {
            k.clock();
            CHECK(b, n < 1000, "a timed commit never comes");
        }
        static int64_t lag = INT64_MIN;  // from the commit clock to the pins: the same every time
        const int64_t is = int64_t(k.now - here) - int64_t(target - base);
        if (lag == INT64_MIN) lag = is;
        CHECK(b, is == lag, "a timed commit is %lld clocks off", (long long)(is - lag));
        k.expect("timebase.status", 0);
    }

    // Encoders: a few edges, an index.
    for (unsigned n = 0; n < encoders; n++) {
        static const int gray[4] = {0, 1, 3, 2};
        const unsigned edges = 5 + n;
        k.write("command.enables", 0xffff | 1u << (16 + n));
        k.write("timebase.strobe", 1);
        for (unsigned e = 1; e <= edges; e++) {
            c.enc_a = (c.enc_a & ~(1u << n)) | (gray[e & 3] & 1) << n, c.enc_b = (c.enc_b & ~(1u << n)) | (gray[e & 3] >> 1) << n;
            k.run(8);
            if (e == 3) c.enc_i |= 1u << n;
            k.run(8);
        }
        k.write("timebase.strobe", 2);
        k.expect(nth("status.encoder", n, "_count"), edges);
        k.expect(nth("status.encoder", n, "_latch"), 3);
        CHECK(b, (k.read("status.flags") & 0xffff) == 1u << n, "index flags %x", k.read("status.flags"));
        CHECK(b, uint32_t(k.read("status.sample_lo") - k.read(nth("status.encoder", n, "_edge_time"))) < 100, "edge time");
        c.enc_a ^= 1u << n, c.enc_b ^= 1u << n;
        k.run(8);
        k.expect(nth("encoder", n, ".errors"), 1);
        k.write("command.enables", 0xffff);
        k.write("timebase.strobe", 1);
        k.run(4);
        k.write("timebase.strobe", 2);
        CHECK(b, !(k.read("status.flags") & 0xffff), "an index flag outlives its arm bit");
    }

    // Arrivals: each frame keeps its own time, also when it has to queue.
    uint64_t done[2];
    for (unsigned slot = 0; slot < 2; slot++) {
        c.frame_done = 1, c.frame_slot = slot;
        k.clock();
        done[slot] = k.now;
        c.frame_done = 0, c.frame_pending = 1;
        k.run(20 + r.below(100));
    }
    const uint64_t first = k.read64("timebase.arrival");
    c.pending_slot = 1;
    k.run(3);
    const uint64_t second = k.read64("timebase.arrival");
    c.frame_pending = 0, c.pending_slot = 0;
    k.run(3);
    CHECK(b, second - first == done[1] - done[0], "arrivals %llu clocks apart, expected %llu", (unsigned long long)(second - first), (unsigned long long)(done[1] - done[0]));
    CHECK(b, k.read64("timebase.arrival") == second, "an arrival is forgotten with its frame");

    // The watchdog's registers, and what STOP leaves behind.
    k.write("watchdog.token", 7);
    k.expect("watchdog.last_token", 7);
    CHECK(b, k.read("watchdog.remaining") > 0xFFFFFF00, "not fed");
    k.write("gpio.safe", 0x0f);
    k.write("gpio.invert_out", 0x03);
    k.write("watchdog.control", 0x53544f50);
    k.run(3);
    CHECK(b, !c.gate && !c.step && !c.pwm && c.outputs == 0x0c, "STOP: gate %d step %x pwm %x out %x", c.gate, c.step, c.pwm, c.outputs);
    k.expect("watchdog.status", 0);
    c.ext_reset = 1;
    k.run(4);
    k.expect("watchdog.status", 0x18);
    return b.pass("%zu registers, %zu read back, %u absent or write-only; %u+%u+%u channels", k.map.size(), wrote.size(), absent, steps, encoders, pwms);
}
