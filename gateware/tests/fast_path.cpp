// The fast path on a whole board without a CPU: GMII bytes with preamble and FCS in and out, and
// the bench writes over the CPU's bus what firmware would write. Each answer's words are compared
// with the registers, each staged word with the frame. Behind everything that must not be executed
// the good frame comes, which must be.
//   gateware/tests/run.sh fast_path [SEED [FRAMES]]    FRAMES: random frames, 3000
#include <algorithm>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "Vfast_path.h"
#include "bench.h"

using Bytes = std::vector<uint8_t>;
using Words = std::vector<uint32_t>;

// Picoseconds. 60 MHz; the board's own frequency is that of its cores, which do not know it.
static const uint64_t SYS = 16667, ETH = 8000;
// Clocks from the last byte of a command to the first of its answer: preamble, as seen at the pins.
static const unsigned TURNAROUND = 17;
// From there to the commit.
static const unsigned COMMIT = 8;

static const uint8_t OURS[6] = {0x12, 0xe2, 0xd5, 0, 0, 1}, THEIRS[6] = {2, 0xfc, 0, 0, 2, 1};
static const uint32_t OUR_IP = 0xc0a80232, THEIR_IP = 0xc0a80201, OUR_PORT = 1234, THEIR_PORT = 40000;
static const uint32_t ARM = 0x41524d31, STOP = 0x53544f50, CLEAR = 0x434c5231, TOKEN = 0xabcd1234;
static const uint32_t RX_SLOTS = 4, TX_SLOT = 0x80002000, OTHER_TX_SLOT = 0x80002800;
static const uint32_t EXECUTED = 1, OUT = 2, SENDING = 4, ARMED = 0x21, BITTEN = 4;

static uint32_t crc32(const Bytes &bytes) {
    uint32_t c = ~0u;
    for (uint8_t b : bytes) {
        c ^= b;
        for (int i = 0; i < 8; i++) c = c & 1 ? c >> 1 ^ 0xEDB88320 : c >> 1;
    }
    return ~c;
}
static uint32_t fold(uint64_t sum) {
    while (sum >> 16) sum = (sum & 0xffff) + (sum >> 16);
    return sum;
}
static uint32_t sum16(const Words &words) {
    uint64_t sum = 0;
    for (uint32_t w : words) sum += (w >> 16) + (w & 0xffff);
    return fold(sum);
}
static void be16(Bytes &b, uint32_t v) { b.push_back(v >> 8), b.push_back(v); }
static void be32(Bytes &b, uint32_t v) { be16(b, v >> 16), be16(b, v); }
static uint32_t word_at(const Bytes &b, size_t at) { return (uint32_t)b[at] << 24 | b[at + 1] << 16 | b[at + 2] << 8 | b[at + 3]; }
static Bytes with_fcs(Bytes f) {
    uint32_t crc = crc32(f);
    for (int i = 0; i < 4; i++) f.push_back(crc >> 8 * i);
    return f;
}

// What may be odd about a frame.
struct Odd {
    uint32_t id = 7, tos = 0, fragment = 0x4000;
    bool no_sum = false, bad_sum = false, bad_ip_sum = false, bad_fcs = false;
    int cut = 0, more = 0;
};

struct Board {
    uint64_t seed, frames;
    Random random;
    Vfast_path *pins = new Vfast_path;
    std::map<std::string, uint32_t> registers;
    clock_t began = clock();
    uint64_t now = 0, clocks = 0, next_sys = 5000, next_eth = 5000;
    bool eth_stands = false;
    uint64_t byte = ETH;  // on the wire
    // Bytes on their way to the board, and whether they are valid; where the wire is.
    std::vector<std::pair<uint8_t, bool>> wire;
    size_t sent = 0;
    uint64_t last_in = 0, first_out = 0;
    Bytes leaving;
    std::vector<Bytes> answers;
    bool was_leaving = false;
    uint32_t inputs = 0, stopped = 0;  // lines that change, and emergency stops that are pressed
    bool watches_gate = false, was_open = false;
    uint64_t committed = 0;
    unsigned taken = 0, commits = 0, held = 0, longest_access = 0;
    uint64_t accesses = 0;
    unsigned stepgens = 0, encoders = 0, pwms = 0;
    uint32_t sequence = 1;

    [[noreturn]] void fail(const char *format, ...) {
        va_list args;
        va_start(args, format);
        printf("FAIL fast_path: ");
        vprintf(format, args);
        printf(" (clock %llu; again with: gateware/tests/run.sh fast_path %llu)\n", (unsigned long long)clocks, (unsigned long long)seed);
        va_end(args);
        exit(1);
    }

    Board(int argc, char **argv)
        : seed(argc > 1 ? strtoull(argv[1], nullptr, 0) : (uint64_t)time(nullptr)), frames(argc > 2 ? strtoull(argv[2], nullptr, 0) : 3000), random(seed) {
        FILE *map = fopen(MAP, "r");
        char name[64];
        unsigned address;
        while (map && fscanf(map, "%63s %x", name, &address) == 2) registers[name] = address;
        if (map) fclose(map);
        next_eth += random.below(ETH);
        pins->link_status = 0xd, pins->gmii_rx_data = 0xdd;
        reset();
        CHECK(*this, read("ident.magic") == 0x46436e43, "no board");
        const uint32_t channels = read("ident.channels0");
        stepgens = channels & 255, encoders = channels >> 8 & 255, pwms = channels >> 16 & 255;
        inputs = ~read("gpio.estop_mask");
        write("watchdog.timeout", 300000), write("watchdog.grace", 1000);
        for (unsigned n = 0; n < stepgens; n++)
            write("stepgen" + std::to_string(n) + ".steplen", 1), write("stepgen" + std::to_string(n) + ".stepspace", 1);
        arm();
    }

    // ---- time and wires -------------------------------------------------------------------------
    void step() {
        now = std::min(next_sys, next_eth);
        const bool sys = now == next_sys, eth = now == next_eth;
        if (sys) {
            pins->sys_clk = 1, pins->eval();
            clocks++, next_sys += SYS;
            turn();
        }
        if (eth) {
            next_eth += byte;
            if (!eth_stands) {
                pins->eth_clk = 1, pins->eval();
                wire_clock();
            }
        }
        pins->sys_clk = pins->eth_clk = 0, pins->eval();
        if (!sys) return;
        taken += pins->see_taken, commits += pins->see_commit, held += pins->see_hold;
        CHECK(*this, !watches_gate || !pins->see_commit || was_open, "a commit behind a closed gate");
        if (pins->see_commit) committed = now;
        was_open = pins->gate;
    }
    // Encoders and inputs change all the time.
    void turn() {
        if (clocks % 11) return;
        static const int gray[4] = {0, 1, 3, 2};
        uint32_t a = 0, b = 0;
        for (int n = 0; n < 16; n++) {
            const int at = gray[(clocks / 11 + n * 7 / 3) & 3];
            a |= (at & 1) << n, b |= (at >> 1) << n;
        }
        pins->enc_a = a, pins->enc_b = b, pins->gpio_in = ((uint32_t)(clocks * 2654435761u) & inputs) | stopped;
    }
    void wire_clock() {
        pins->gmii_rx_dv = sent < wire.size() && wire[sent].second;
        pins->gmii_rx_data = sent < wire.size() ? wire[sent].first : 0xdd;
        sent += sent < wire.size();
        if (pins->gmii_rx_dv) last_in = now + byte;
        if (pins->gmii_tx_en) {
            if (!was_leaving) leaving.clear(), first_out = now;
            leaving.push_back(pins->gmii_tx_data);
        } else if (was_leaving) answers.push_back(leaving);
        was_leaving = pins->gmii_tx_en;
    }
    void run(uint64_t n) {
        for (const uint64_t to = clocks + n; clocks < to;) step();
    }
    void reset() {
        pins->sys_rst = 1, run(10);
        pins->sys_rst = 0, run(50);
    }
    void send(const Bytes &f) {
        for (int i = 0; i < 7; i++) wire.push_back({0x55, true});
        wire.push_back({0xd5, true});
        for (uint8_t b : f) wire.push_back({b, true});
        for (int i = 0; i < 12; i++) wire.push_back({0xdd, false});
    }
    size_t to_send() const { return wire.size() - sent; }
    // Until nothing comes or leaves.
    void quiet() {
        while (to_send()) step();
        run(40 * byte / ETH);
        while (pins->gmii_tx_en) step();
        run(10);
        wire.clear(), sent = 0;
    }

    // ---- the CPU's bus --------------------------------------------------------------------------
    uint32_t access(uint32_t address, bool store, uint32_t data) {
        const uint64_t before = clocks;
        pins->bus_adr = address >> 2, pins->bus_we = store, pins->bus_dat_w = data, pins->bus_stb = 1;
        for (unsigned n = 0; n < 4000; n++) {
            step();
            pins->eval();
            if (!pins->bus_ack) continue;
            const uint32_t value = pins->bus_dat_r;
            run(1);
            pins->bus_stb = 0;
            longest_access = std::max(longest_access, unsigned(clocks - before)), accesses++;
            return value;
        }
        fail("the bus is held for ever at %08x", address);
    }
    uint32_t address(const std::string &name) {
        CHECK(*this, registers.count(name), "no register %s", name.c_str());
        return registers[name];
    }
    uint32_t read(const std::string &name, unsigned word = 0) { return access(address(name) + 4 * word, false, 0); }
    void write(const std::string &name, uint32_t data, unsigned word = 0) { access(address(name) + 4 * word, true, data); }
    bool pending() { return read("ethmac.sram_writer_ev_pending"); }
    void release() { write("ethmac.sram_writer_ev_pending", 1), write("rx_admission.admit", 1); }
    void arm() {
        if (read("watchdog.status") == ARMED) return;
        write("watchdog.control", CLEAR), write("watchdog.control", ARM);
        CHECK(*this, read("watchdog.status") == ARMED, "does not arm: %x", read("watchdog.status"));
    }

    // ---- the exchange ---------------------------------------------------------------------------
    unsigned command_words() const { return 9 + 2 * stepgens + pwms; }
    unsigned status_words() const { return 15 + 3 * stepgens + 2 * encoders; }
    Words command(uint32_t token, uint32_t number, uint32_t flags, uint64_t apply, const std::function<uint32_t(unsigned)> &word) {
        Words p{0x4e6f1044, 0, 0x000f0000u | command_words() << 8, 0x20000, token, number, flags, (uint32_t)apply, (uint32_t)(apply >> 32)};
        for (unsigned n = 0; n < command_words() - 5; n++) p.push_back(word(n));
        return p;
    }
    // The words behind: enables, outputs, arms, the selected latch, stepgens, PWMs.
    uint32_t any_word(unsigned n) {
        if (n == 0) return (1u << stepgens) - 1;
        if (n == 1) return random.next() & 0xfff;
        if (n == 2) return 0;
        if (n == 3) return random.below(32) << 16;
        if (n < 4 + 2 * stepgens) return n & 1 ? 0 : (random.next() & 0x3fffffff) - 0x20000000;
        return random.next() & 0x5fffffff;
    }
    Words any(uint32_t number, uint32_t flags = 3, uint64_t apply = 0) {
        return command(TOKEN, number, flags, apply, [this](unsigned n) { return any_word(n); });
    }
    Bytes frame(const Words &payload, const Odd &odd = {}) {
        Bytes f(OURS, OURS + 6);
        f.insert(f.end(), THEIRS, THEIRS + 6), be16(f, 0x800);
        const uint32_t length = 4 * payload.size();
        Bytes ip;
        be16(ip, 0x4500 | odd.tos), be16(ip, 28 + length), be16(ip, odd.id), be16(ip, odd.fragment), be16(ip, 0x4011), be16(ip, 0);
        be32(ip, THEIR_IP), be32(ip, OUR_IP);
        uint64_t sum = 0;
        for (int i = 0; i < 20; i += 2) sum += ip[i] << 8 | ip[i + 1];
        uint32_t check = (~fold(sum) & 0xffff) ^ odd.bad_ip_sum;
        ip[10] = check >> 8, ip[11] = check;
        Bytes udp;
        be16(udp, THEIR_PORT), be16(udp, OUR_PORT), be16(udp, 8 + length), be16(udp, 0);
        for (uint32_t w : payload) be32(udp, w);
        sum = (uint64_t)sum16({THEIR_IP, OUR_IP, 17, 8 + length});
        for (size_t i = 0; i < udp.size(); i += 2) sum += udp[i] << 8 | udp[i + 1];
        check = ~fold(sum) & 0xffff;
        check = odd.no_sum ? 0 : (check ? check : 0xffff) ^ (odd.bad_sum ? 0x10 : 0);
        udp[6] = check >> 8, udp[7] = check;
        f.insert(f.end(), ip.begin(), ip.end()), f.insert(f.end(), udp.begin(), udp.end());
        f.resize(f.size() - odd.cut + odd.more);
        f = with_fcs(f);
        f.back() ^= odd.bad_fcs;
        return f;
    }
    // What firmware writes once for an owner.
    void open() {
        Bytes f = frame(any(0));
        f.insert(f.begin(), 2, 0);
        auto word = [&](unsigned n) { return word_at(f, 4 * n); };
        for (unsigned n = 0, place = 0; n < 18; n++)
            if (n != 5 && n != 12) write("rx_admission.header0", word(n), place++);
        write("rx_admission.mode", 3), write("rx_admission.admit", 1);
        write("fast_path.ip_sum", sum16({word(4), word(7), word(8)}));
        write("fast_path.udp_sum", sum16({word(7), word(8), word(9), 17, word(10) >> 16}));
        enum { COPY = 0, SKIP = 1, SELECT = 2, END = 4 };
        unsigned next = 0;
        auto run = [&](int kind, unsigned count, uint32_t at) {
            if (count) write("fast_path.run0", (uint32_t)kind << 16 | (count - 1) << 10 | at, next++);
        };
        auto number = [&](const char *name) {
            const uint32_t at = address(name) - 0xf0000000;
            return (at / 0x800 & 7) << 7 | at % 0x800 / 4;
        };
        run(COPY, 2, number("timebase.commit_at_lo"));
        run(COPY | (stepgens + pwms ? 0 : END), 4, number("command.enables"));
        run(COPY | (pwms ? 0 : END), 2 * stepgens, number("command.stepgen0_velocity"));
        run(COPY | END, pwms, number("command.pwm0_width"));
        next = 4;
        run(SKIP, 8, 17);
        run(COPY, 2, number("status.sample_lo")), run(COPY, 2, number("status.sample_lo")), run(COPY, 1, number("status.left"));
        run(SKIP, 1, 24);
        run(COPY, 1, number("status.estop")), run(COPY, 4, number("status.gpio_in"));
        run(COPY | SELECT | (stepgens + encoders ? 0 : END), 1, number("status.encoder0_latch"));
        run(COPY | (encoders ? 0 : END), 3 * stepgens, number("status.stepgen0_position_lo"));
        run(COPY | END, 2 * encoders, number("status.encoder0_count"));
        Words answer{0x4e6f1044, 0, 0x000f0000u | status_words() << 8, 0x30000};
        for (unsigned n = 0; n < status_words(); n++) answer.push_back(0xdead0000 + n);
        Bytes r(2, 0);
        r.insert(r.end(), THEIRS, THEIRS + 6), r.insert(r.end(), OURS, OURS + 6), be16(r, 0x800);
        r.resize(16 + 28);
        for (uint32_t w : answer) be32(r, w);
        for (size_t n = 0; n < r.size() / 4; n++) access(TX_SLOT + 4 * n, true, word_at(r, 4 * n));
        write("fast_path.length", r.size());
    }
    // What it writes for each command. The answer carries three words that are its own.
    void hand_out(uint32_t number, uint32_t flags = 3, uint32_t gate = ARMED, bool executes = true, bool timed = false) {
        write("rx_admission.header0", number, 14), write("rx_admission.header0", flags, 15);
        for (unsigned n = 14; n < 17; n++) access(TX_SLOT + 4 * n, true, number + n);
        write("fast_path.gate", gate | executes << 8 | timed << 9);
        write("fast_path.pass", 1);
    }
    void forget() { answers.clear(), taken = commits = held = 0; }

    void check_answer(uint32_t number, const Words &sent_words) {
        CHECK(*this, answers.size() == 1, "command %u has %zu answers", number, answers.size());
        Bytes f = answers[0];
        CHECK(*this, f.size() > 12 && f[7] == 0xd5, "an answer of %zu bytes", f.size());
        Bytes body(f.begin() + 8, f.end() - 4);
        CHECK(*this, with_fcs(body) == Bytes(f.begin() + 8, f.end()), "the FCS of the answer to %u", number);
        CHECK(*this, body.size() == 42 + 16 + 4 * status_words(), "the answer has %zu bytes", body.size());
        auto w = [&](unsigned n) { return word_at(body, 42 + 16 + 4 * n); };
        auto same = [&](unsigned n, uint32_t expected, const char *what) { CHECK(*this, w(n) == expected, "answer to %u, word %u, %s: %08x, expected %08x", number, n, what, w(n), expected); };
        CHECK(*this, word_at(body, 42 + 12) == number + 14, "firmware's words");
        same(0, number + 15, "firmware's"), same(1, number + 16, "firmware's");
        same(2, read("status.sample_lo"), "arrival"), same(4, read("status.sample_lo"), "sample"), same(3, read("status.sample_hi"), "sample");
        same(6, read("status.left"), "left"), same(7, 0xdead0007, "skipped"), same(8, 0xdead0008, "skipped"), same(9, read("status.estop"), "e-stop");
        for (unsigned n = 0; n < 4; n++) same(10 + n, read("status.gpio_in", n), "inputs and flags");
        same(14, read("status.encoder0_latch", sent_words[9 + 3] >> 16 & 31), "latch");
        for (unsigned n = 0; n < 3 * stepgens; n++) same(15 + n, read("status.stepgen0_position_lo", n), "stepgen");
        for (unsigned n = 0; n < 2 * encoders; n++) same(15 + 3 * stepgens + n, read("status.encoder0_count", n), "encoder");
        check_staged(sent_words);
    }
    void check_staged(const Words &sent_words) {
        const uint32_t *words = sent_words.data() + 9;
        auto same = [&](const char *name, unsigned n, uint32_t expected) {
            const uint32_t staged = read(name, n);
            CHECK(*this, staged == expected, "%s + %u is %08x, sent %08x", name, n, staged, expected);
        };
        same("command.gpio_out", 0, words[1]), same("command.probe_arms", 0, words[3]);
        for (unsigned n = 0; n < 2 * stepgens; n++) same("command.stepgen0_velocity", n, words[4 + n]);
        for (unsigned n = 0; n < pwms; n++) same("command.pwm0_width", n, words[4 + 2 * stepgens + n]);
    }
    // A good command with a pass, to its end. Returns clocks from last byte in to first out.
    unsigned exchange(const Odd &odd = {}) {
        const Words words = any(++sequence);
        hand_out(sequence);
        run(random.below(40));
        return exchange(words, odd);
    }
    unsigned exchange(const Words &words, const Odd &odd = {}) {
        forget();
        send(frame(words, odd));
        quiet();
        CHECK(*this, taken == 1 && commits == 1, "command %u: executed %u times, committed %u times", sequence, taken, commits);
        CHECK(*this, read("fast_path.status") == EXECUTED, "status %x behind an executed command", read("fast_path.status"));
        CHECK(*this, !pending(), "an executed command lies in a slot");
        const uint64_t took = first_out - last_in;
        CHECK(*this, byte != ETH || committed - last_in <= COMMIT * SYS, "committed %llu clocks behind the last byte", (unsigned long long)((committed - last_in) / SYS));
        check_answer(sequence, words);
        return (took + SYS - 1) / SYS;
    }
    // A frame that is not executed, in its slot or gone; and the pass stays as it was.
    void left_alone(const char *what, const Bytes &f, bool slot) {
        forget();
        const uint32_t before = read("fast_path.status");
        send(f), quiet();
        CHECK(*this, !taken && !commits && answers.empty(), "%s: executed", what);
        CHECK(*this, read("fast_path.status") == before, "%s: the pass has changed", what);
        CHECK(*this, pending() == slot, "%s: %s", what, slot ? "lies in no slot" : "lies in a slot");
        while (pending()) release();
    }

    // ---- the tests ------------------------------------------------------------------------------
    unsigned turnaround(unsigned count) {
        unsigned longest = 0;
        for (unsigned n = 0; n < count; n++) {
            Odd odd;
            odd.id = random.next() & 0xffff, odd.no_sum = random.one_in(5), odd.fragment = random.one_in(2) ? 0x4000 : 0;
            longest = std::max(longest, exchange(odd));
            next_eth += random.below(3) * 1000 + 1;  // another phase
        }
        CHECK(*this, longest <= TURNAROUND, "the longest turnaround is %u clocks", longest);
        return longest;
    }
    // A byte takes 10 and 100 times as long: the words come and leave one by one.
    unsigned slow_links() {
        unsigned longest = 0;
        for (unsigned slower : {10, 100}) {
            byte = slower * ETH;
            for (unsigned n = 0; n < 10; n++) longest = std::max(longest, exchange());
            Bytes f = frame(any(sequence + 1));
            hand_out(sequence + 1);
            f[50] ^= 1 << random.below(8), left_alone("turned over on a slow link", f, false);
            exchange();
        }
        byte = ETH;
        quiet();
        return longest;
    }
    void malformed() {
        const uint32_t number = ++sequence;
        const Words good = any(number);
        auto with = [&](unsigned n, uint32_t flip) { Words w = good; w[n] ^= flip; return frame(w); };
        auto odd = [&](const std::function<void(Odd &)> &set) { Odd o; set(o); return frame(good, o); };
        hand_out(number);
        left_alone("bad FCS", odd([](Odd &o) { o.bad_fcs = true; }), false);
        left_alone("bad UDP checksum", odd([](Odd &o) { o.bad_sum = true; }), true);
        left_alone("bad IP checksum", odd([](Odd &o) { o.bad_ip_sum = true; }), true);
        for (int n : {1, 2, 3, 4, 5, 8, 60}) {
            left_alone("too short", odd([&](Odd &o) { o.cut = n; }), true);
            // Without a checksum only the length tells.
            left_alone("too short", odd([&](Odd &o) { o.cut = n, o.no_sum = true; }), true);
            left_alone("too long", odd([&](Odd &o) { o.more = n; }), true);
            left_alone("too long", odd([&](Odd &o) { o.more = n, o.no_sum = true; }), true);
        }
        left_alone("first of a fragment", odd([](Odd &o) { o.fragment = 0x2000; }), true);
        left_alone("behind in a fragment", odd([](Odd &o) { o.fragment = 1; }), true);
        left_alone("reserved flag", odd([](Odd &o) { o.fragment = 0x8000; }), true);
        left_alone("another service class", odd([](Odd &o) { o.tos = 4; }), true);
        left_alone("another token", with(4, 1), true);
        left_alone("the last sequence", with(5, number ^ (number - 1)), true);
        left_alone("a sequence ahead", with(5, number ^ (number + 1)), true);
        left_alone("other flags", with(6, 2), true);
        left_alone("another base address", with(3, 4), true);
        left_alone("an unknown selection", with(9 + 3, 1u << 21), true);
        hand_out(number, 3, 0x20);
        left_alone("another gate", frame(good), true);
        write("fast_path.revoke", 1);
        left_alone("no pass", frame(good), true);
        hand_out(number);
        exchange(good);
        // The same again: the pass is used up.
        left_alone("twice", frame(good), true);
    }
    // Each bit turned over, with a right FCS. With a checksum none is executed; without one those
    // are that firmware's words leave open, such as a velocity.
    unsigned each_bit(unsigned &open) {
        unsigned bits = 0;
        Odd odd;
        for (bool no_sum : {false, true}) {
            odd.no_sum = no_sum;
            Words words;
            Bytes good;
            auto next = [&] { words = any(++sequence), good = frame(words, odd), hand_out(sequence); };
            next();
            for (unsigned bit = 0; bit < 8 * (good.size() - 4); bit++, bits++) {
                Bytes g(good.begin(), good.end() - 4);
                g[bit / 8] ^= 1 << bit % 8;
                g = with_fcs(g);
                const bool like = is_like(g, good);
                CHECK(*this, no_sum || !like, "bit %u is like the pass", bit);
                write("watchdog.token", bit);
                forget(), send(g), quiet();
                CHECK(*this, taken == like && commits == like && answers.size() == like, "bit %u turned over: executed %u times", bit, taken);
                while (pending()) release();
                write("rx_admission.admit", 1);
                if (like) open++, next();
            }
            // The FCS itself.
            for (unsigned bit = 0; bit < 32; bit++, bits++) {
                Bytes g = good;
                g[g.size() - 4 + bit / 8] ^= 1 << bit % 8;
                left_alone("a bit of the FCS turned over", g, false);
            }
            exchange(words, odd);
        }
        return bits;
    }
    // Whether firmware's words say that a frame is to be executed.
    bool is_like(const Bytes &f, const Bytes &good) {
        if (f.size() != good.size() || with_fcs(Bytes(f.begin(), f.end() - 4)) != f) return false;
        uint64_t ip = 0, udp = sum16({THEIR_IP, OUR_IP, 17}) + (word_at(f, 36) & 0xffff) * 0;
        for (unsigned n = 14; n < 34; n += 2) ip += f[n] << 8 | f[n + 1];
        udp += f[38] << 8 | f[39];
        for (unsigned n = 34; n + 4 < f.size(); n += 2) udp += f[n] << 8 | f[n + 1];
        const bool no_sum = !f[40] && !f[41];
        auto counts = [](unsigned n) { return n < 58 + 12 && !(n >= 18 && n < 22) && n != 24 && n != 25 && n != 40 && n != 41 && !(n >= 46 && n < 50); };
        for (unsigned n = 0; n < f.size() - 4; n++)
            if (counts(n) && f[n] != good[n]) return false;
        return fold(ip) == 0xffff && (no_sum || fold(udp) == 0xffff) && !(f[20] & 0xbf) && !f[21] && !(word_at(f, 90) >> 21);
    }
    unsigned random_frames() {
        unsigned executed = 0;
        Words words = any(++sequence);
        Bytes good = frame(words);
        hand_out(sequence);
        for (uint64_t n = 0; n < frames; n++) {
            Bytes f(good.begin(), good.end() - 4);
            switch (random.below(6)) {
            case 0:  // anything
                f.resize(random.below(random.one_in(4) ? 400 : 80));
                for (auto &b : f) b = random.next();
                break;
            case 1:  // anything behind a good beginning
                for (size_t at = random.below(f.size()); at < f.size(); at++) f[at] = random.next();
                break;
            case 2:  // of another length
                f.resize(random.one_in(2) ? random.below(f.size() + 40) : f.size() - 4 + random.below(9));
                break;
            case 3: {  // two halves changed so that the checksums do not notice
                const size_t a = 14 + 2 * random.below((f.size() - 14) / 2), b = 14 + 2 * random.below((f.size() - 14) / 2);
                std::swap(f[a], f[b]), std::swap(f[a + 1], f[b + 1]);
                break;
            }
            case 4:  // nothing, or what may differ
                if (random.one_in(2)) f[40] = f[41] = 0;
                if (random.one_in(2)) f[46] = random.next(), f[40] = f[41] = 0;
                break;
            default:  // some bits
                for (unsigned k = 1 + random.below(3); k; k--) f[random.below(f.size())] ^= 1 << random.below(8);
            }
            f = with_fcs(f);
            if (random.one_in(20)) f[random.below(f.size())] ^= 1 << random.below(8);
            const bool like = is_like(f, good);
            forget(), send(f), quiet();
            CHECK(*this, taken == like && commits == like && answers.size() == like, "random frame %llu: executed %u times, answered %zu times, expected %d",
                  (unsigned long long)n, taken, answers.size(), like);
            while (pending()) release();
            if (random.one_in(8)) write("rx_admission.admit", 1), write("watchdog.token", n);
            if (!like) continue;
            executed++;
            words = any(++sequence), good = frame(words);
            hand_out(sequence);
        }
        write("fast_path.revoke", 1);
        return executed;
    }
    void other_ways() {
        // A look is sampled and answered, not committed.
        Words words = any(++sequence, 0);
        hand_out(sequence, 0, ARMED, false), forget(), send(frame(words)), quiet();
        CHECK(*this, taken == 1 && !commits, "a look: executed %u times, committed %u times", taken, commits);
        check_answer(sequence, words);
        // A timed command is committed at its time; nothing is staged while it waits.
        write("timebase.snapshot", 1);
        const uint64_t at = (read("timebase.now_lo") | (uint64_t)read("timebase.now_hi") << 32) + 2500;
        words = any(++sequence, 7, at);
        hand_out(sequence, 7, ARMED, true, true), forget(), send(frame(words)), quiet();
        CHECK(*this, taken == 1 && !commits && read("timebase.status") == 1, "a timed command: executed %u times, committed %u times", taken, commits);
        hand_out(++sequence, 7, ARMED, true, true);
        left_alone("while a commit waits", frame(any(sequence, 7)), true);
        check_staged(words);
        forget(), run(2500);
        CHECK(*this, commits == 1, "a timed command: committed %u times at its time", commits);
        write("fast_path.revoke", 1);
        // Back to back: the second lies in its slot.
        words = any(++sequence);
        hand_out(sequence), forget();
        send(frame(words)), send(frame(any(sequence + 1))), quiet();
        CHECK(*this, taken == 1 && pending(), "back to back: executed %u times", taken);
        release();
        // The CPU sends something of its own meanwhile, from the other slot, and from this one.
        for (uint32_t slot : {1, 0}) {
            words = any(++sequence);
            hand_out(sequence), forget();
            write("ethmac.sram_reader_slot", slot), write("ethmac.sram_reader_length", 1000);
            for (unsigned n = 0; n < 16; n++) access(OTHER_TX_SLOT + 4 * n, true, n);
            send(frame(words));
            while (to_send() > 30) step();
            write("ethmac.sram_reader_start", 1);
            if (!slot) CHECK(*this, read("fast_path.status") & SENDING, "slot 0 is being sent, and no register says so");
            quiet(), run(1000), quiet();
            CHECK(*this, taken == slot && answers.size() == 1 + slot, "with slot %u being sent: executed %u times, %zu frames", slot, taken, answers.size());
            if (slot) CHECK(*this, answers[0].size() == 1010 && answers[1].size() == 8 + 42 + 16 + 4 * status_words() + 4, "answers of %zu and %zu bytes", answers[0].size(), answers[1].size());
            else release();
        }
        write("fast_path.revoke", 1);
        open();
    }
    void no_slot_free() {
        const uint32_t dropped = read("ethmac.sram_writer_errors");
        write("rx_admission.mode", 0);
        for (unsigned n = 0; n < RX_SLOTS; n++) send(with_fcs(Bytes(60, n))), quiet();
        write("rx_admission.mode", 3);
        Words words = any(++sequence);
        hand_out(sequence), forget(), send(frame(words)), quiet();
        CHECK(*this, taken == 1 && read("fast_path.status") == EXECUTED, "no slot free: not executed");
        check_answer(sequence, words);
        CHECK(*this, read("ethmac.sram_writer_errors") == dropped, "an executed command was counted as lost");
        // One that is not executed is, and leaves the next one alone.
        send(frame(words)), quiet();
        Odd wrong;
        wrong.bad_fcs = true;
        send(frame(words, wrong)), quiet();
        send(with_fcs(Bytes{1})), quiet();
        CHECK(*this, read("ethmac.sram_writer_errors") == dropped + 3, "%u counted as lost", read("ethmac.sram_writer_errors") - dropped);
        for (unsigned n = 0; n < RX_SLOTS; n++) {
            CHECK(*this, pending(), "%u of the frames are there", n);
            release();
        }
        CHECK(*this, !pending(), "one frame too many");
        exchange();
    }
    void busy_cpu() {
        for (unsigned n = 0; n < 60; n++) {
            const Words words = any(++sequence);
            hand_out(sequence), forget(), send(frame(words));
            longest_access = 0;
            for (unsigned k = 0; to_send() || answers.empty(); k++) {
                CHECK(*this, k < 4000, "no answer to a busy board");
                write(n & 1 ? "ctrl.scratch" : "gpio.safe", k & 0xfff);
                if (k & 1) access(OTHER_TX_SLOT + 4 * (k & 63), true, k);
                CHECK(*this, read(n & 1 ? "ctrl.scratch" : "gpio.safe") == (k & 0xfff), "a register lost its value");
            }
            quiet();
            check_answer(sequence, words);
            // The longest piece is the answer's words behind the latch, one a clock.
            CHECK(*this, longest_access <= 3 * stepgens + 2 * encoders + 20, "an access took %u clocks", longest_access);
        }
    }
    // What happens in the clocks around the frame's end, and firmware's part in them.
    void around_the_end(unsigned rounds, unsigned &yes, unsigned &no, const std::function<void()> &act, const std::function<void(bool)> &check) {
        for (unsigned n = 0; n < rounds; n++) {
            const uint64_t bytes = 12 + random.below(6);
            around_one_end(bytes, random.below(50), yes, no, act, check);
        }
    }
    // The frame has so many bytes to come; then `act` comes so many edges later.
    // The frame has so many bytes to come; `act` comes so many edges later.
    void around_one_end(uint64_t bytes, unsigned edges, unsigned &yes, unsigned &no, const std::function<void()> &act, const std::function<void(bool)> &check) {
        arm();
        const Words words = any(++sequence);
        hand_out(sequence), forget(), send(frame(words));
        while (to_send() > bytes) step();
        for (unsigned k = edges; k; k--) step();
        act();
        quiet();
        const bool executed = taken;
        CHECK(*this, answers.size() == executed && pending() != executed, "executed %d, %zu answers, %s", executed, answers.size(), pending() ? "in a slot" : "in no slot");
        check(executed);
        executed ? yes++ : no++;
        while (pending()) release();
        write("fast_path.revoke", 1);
    }
    // At every edge around the frame's end the CPU closes the gate, the external reset does, an
    // emergency stop does: executed in time or not at all, and no commit behind a closed gate.
    void gate_closes(unsigned &yes, unsigned &no) {
        const uint32_t stops = read("gpio.estop_mask");
        const std::function<void()> closes[] = {
            [&] { write("watchdog.control", STOP); },
            [&] { pins->ext_reset = 1, run(3), pins->ext_reset = 0; },
            [&] { stopped = stops, run(30), stopped = 0; },
        };
        watches_gate = true;
        for (const auto &act : closes) {
            unsigned done = 0, left = 0;
            for (unsigned edges = 0; edges < 120; edges++) around_one_end(22, edges, done, left, act, [](bool) {});
            CHECK(*this, (done && left) || (!stops && &act == &closes[2]), "executed %u, left %u: not around the end", done, left);
            yes += done, no += left;
        }
        watches_gate = false;
        arm();
    }
    void revoked(unsigned &yes, unsigned &no) {
        bool said = false;
        around_the_end(300, yes, no, [&] { write("fast_path.revoke", 1), said = read("fast_path.status") & EXECUTED; },
                       [&](bool executed) { CHECK(*this, executed == said, "executed behind a revocation that said %d", said); });
        // Anywhere in the frame: nothing is staged behind it, and the CPU's word stays.
        for (unsigned n = 0; n < 200; n++) {
            hand_out(++sequence), forget(), send(frame(any(sequence)));
            for (unsigned k = random.below(260); k; k--) step();
            write("fast_path.revoke", 1);
            const uint32_t status = read("fast_path.status");
            for (unsigned k = 0; k < 3; k++) write("command.stepgen0_velocity", 0x1000 + n, k);
            quiet();
            for (unsigned k = 0; k < 3; k++)
                CHECK(*this, read("command.stepgen0_velocity", k) == 0x1000 + n, "staged behind a revocation");
            CHECK(*this, taken == (status & EXECUTED) && read("fast_path.status") == status, "status %x behind a revocation, then %x", status, read("fast_path.status"));
            while (pending()) release();
        }
        // A pass handed out, or taken back and handed out again, in mid-frame is for the next one.
        for (unsigned n = 0; n < 200; n++) {
            write("fast_path.revoke", 1);
            const Words words = any(++sequence);
            hand_out(sequence);
            if (n & 1) write("fast_path.revoke", 1);
            forget(), send(frame(words));
            while (to_send() > 13 + random.below(150)) step();
            if (~n & 1) write("fast_path.revoke", 1);
            write("fast_path.pass", 1);
            const bool late = to_send() < 2 || pending();  // it came behind the frame
            quiet();
            CHECK(*this, !taken, "a pass for the frame that was already coming");
            CHECK(*this, late || pending(), "in no slot");
            while (pending()) release();
            exchange(words);
        }
    }
    // Firmware hangs with a pass out: one more command is executed, then none, and the watchdog
    // bites at its time.
    void hangs(unsigned rounds) {
        const unsigned timeout = 1500;
        write("watchdog.timeout", timeout);
        for (unsigned n = 0; n < rounds; n++) {
            arm();
            const Words words = any(++sequence);
            forget(), hand_out(sequence), run(random.below(timeout / 2)), send(frame(words));
            uint64_t fed = 0;
            for (unsigned k = 0; k < 4000 && !fed; k++) {
                step();
                if (taken) fed = clocks;
            }
            CHECK(*this, fed, "the command was not executed");
            // The host goes on, by this number and the next.
            send(frame(any(sequence))), send(frame(any(sequence + 1)));
            uint64_t bitten = 0;
            for (unsigned k = 0; k < 1000 && !bitten; k++)
                if (read("watchdog.status") & BITTEN) bitten = clocks;
            CHECK(*this, bitten > fed + timeout && bitten < fed + timeout + 20, "bitten %llu clocks behind the last command", (unsigned long long)(bitten - fed));
            quiet();
            CHECK(*this, taken == 1 && commits == 1 && answers.size() == 1, "%u executed, %u committed, %zu answers", taken, commits, answers.size());
            while (pending()) release();
        }
        write("watchdog.timeout", 300000);
        arm();
    }
    void cut_and_reset() {
        // The receive clock stops in mid-frame: the bus is free, and the frame goes on with it.
        for (unsigned n = 0; n < 20; n++) {
            const Words words = any(++sequence);
            hand_out(sequence), forget(), send(frame(words));
            for (size_t stop = random.below(190); to_send() > stop;) step();
            eth_stands = true, longest_access = 0;
            for (unsigned k = 0; k < 100; k++) read("timebase.status");
            CHECK(*this, longest_access <= 3 * stepgens + 2 * encoders + 20, "an access took %u clocks while the wire stood", longest_access);
            eth_stands = false;
            quiet();
            CHECK(*this, taken == 1, "not executed behind a pause of the wire");
            check_answer(sequence, words);
        }
        // The cable is pulled in mid-frame: nothing, and the pass stays.
        for (unsigned n = 0; n < 40; n++) {
            Bytes f = frame(any(sequence + 1));
            f.resize(1 + random.below(f.size() - 1));
            hand_out(sequence + 1);
            left_alone("cut off", f, false);
        }
        exchange();
        // A reset takes the pass back, whenever it comes.
        for (unsigned n = 0; n < 60; n++) {
            hand_out(++sequence), forget(), send(frame(any(sequence)));
            for (unsigned k = random.below(330); k; k--) step();
            const bool before = taken;
            pins->sys_rst = 1, run(2), pins->sys_rst = 0;
            CHECK(*this, read("fast_path.status") == 0, "status %x behind a reset", read("fast_path.status"));
            quiet(), run(400), quiet();
            CHECK(*this, taken == before && (!before || commits <= 1), "executed behind a reset");
            while (pending()) release();
            // The MAC may have been in mid-frame, either way: the next one has the rest in it.
            send(with_fcs(Bytes(60, 1)));
            write("ethmac.sram_reader_slot", 1), write("ethmac.sram_reader_length", 100), write("ethmac.sram_reader_start", 1);
            quiet();
            while (pending()) release();
            arm(), open(), exchange();
        }
    }

    int all() {
        run(100);
        open();
        const unsigned longest = turnaround(150);
        const unsigned slow = slow_links();
        malformed();
        other_ways();
        no_slot_free();
        busy_cpu();
        unsigned closed[2] = {}, back[2] = {};
        gate_closes(closed[0], closed[1]);
        revoked(back[0], back[1]);
        CHECK(*this, closed[0] && closed[1] && back[0] && back[1], "not around the end: %u %u %u %u", closed[0], closed[1], back[0], back[1]);
        cut_and_reset();
        hangs(1000);
        unsigned open = 0;
        const unsigned bits = each_bit(open);
        const unsigned executed = random_frames();
        printf("PASS fast_path: turnaround %u clocks, %u at 10 Mbit/s; %u bits turned over, %u of them left open; gate closed around the end %u, revoked %u times, executed %u and %u; hung 1000 times; "
               "%llu random frames, %u like the pass; %u+%u+%u channels, %.1f Mclk in %.1f s, seed %llu\n",
               longest, slow, bits, open, closed[0] + closed[1], back[0] + back[1], closed[0], back[0], (unsigned long long)frames, executed, stepgens, encoders, pwms, clocks / 1e6,
               double(clock() - began) / CLOCKS_PER_SEC, (unsigned long long)seed);
        return 0;
    }
};

int main(int argc, char **argv) { return Board(argc, argv).all(); }
