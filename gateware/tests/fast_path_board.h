// A whole board without a CPU for the bench of the fast path: GMII bytes with preamble and FCS in
// and out, and the CPU's bus, over which the bench writes what firmware would write.
//
// Watched on every clock of every test: a command is executed only with a pass that was handed out,
// and only if the gate read as firmware had said a clock before.
#pragma once
#include <algorithm>
#include <map>

#include "Vfast_path.h"
#include "fast_path_frame.h"

// Picoseconds. 60 MHz; the board's own frequency is that of its cores, which do not know it.
static const uint64_t SYS = 16667, ETH = 8000;
// Clocks from the last byte of a command to its commit.
static const unsigned COMMIT = 8;
// Bytes between two frames: the least a sender leaves, and the least that may arrive of it.
static const unsigned GAP = 12, LEAST_GAP = 8;

static const uint32_t ARM = 0x41524d31, SOFT = 0x534f4654, STOP = 0x53544f50, CLEAR = 0x434c5231;
static const uint32_t RX_SLOTS = 4, TX_QUEUE = 2, TX_SLOT = 0x80002000, OTHER_TX_SLOT = 0x80002800;
static const uint32_t EXECUTED = 1, OUT = 2, SENDING = 4, OPEN = 1, BITTEN = 4, ARMED = 0x21;
static const unsigned TIMEOUT = 300000, GRACE = 1000;

// A byte on its way to the board.
struct Beat {
    uint8_t data;
    bool valid, error;
};

struct Board {
    uint64_t seed;
    Random random;
    Vfast_path *pins = new Vfast_path;
    std::map<std::string, uint32_t> registers;
    clock_t began = clock();
    uint64_t now = 0, clocks = 0, next_sys = 5000, next_eth = 5000;
    bool eth_stands = false;
    uint64_t byte = ETH;  // on the wire
    std::vector<Beat> wire;
    size_t sent = 0;
    uint64_t last_in = 0, first_out = 0, committed = 0;
    Bytes leaving;
    std::vector<Bytes> answers;
    bool was_leaving = false;
    uint32_t inputs = 0, stopped = 0;  // lines that change, and emergency stops that are pressed
    bool watches_gate = false;
    unsigned passes = 0;  // written, and neither used up nor taken back
    uint64_t back_at = 0; // when those are back
    int lives = -1;       // accesses until the CPU is dead, if it is to die
    uint32_t gate_was = 0, gate_said = 0, gate_when_taken = 0;
    unsigned taken = 0, commits = 0, longest_access = 0;
    unsigned stepgens = 0, encoders = 0, pwms = 0;
    unsigned inputs_high = 0, outputs_high = 0;  // words for pins behind the first 32
    uint32_t sequence = 1;

    [[noreturn]] void fail(const char *format, ...) {
        va_list args;
        va_start(args, format);
        printf("FAIL fast_path: ");
        vprintf(format, args);
        printf(" (clock %llu; again with: BOARD=%s gateware/tests/run.sh fast_path %llu)\n", (unsigned long long)clocks, BOARD, (unsigned long long)seed);
        va_end(args);
        exit(1);
    }

    explicit Board(uint64_t seed) : seed(seed), random(seed) {
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
        const uint32_t pins = read("ident.channels1");
        inputs_high = (pins & 255) > 32, outputs_high = (pins >> 8 & 255) > 32;
        inputs = ~read("gpio.estop_mask");
        write("watchdog.timeout", TIMEOUT), write("watchdog.grace", GRACE);
        for (unsigned n = 0; n < stepgens; n++)
            write("stepgen" + std::to_string(n) + ".steplen", 1), write("stepgen" + std::to_string(n) + ".stepspace", 1);
        arm(), run(100), open();
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
        if (sys) watch();
    }
    void watch() {
        if (back_at && clocks >= back_at) passes = back_at = 0;
        if (pins->see_taken) {
            CHECK(*this, passes, "a command without a pass");
            CHECK(*this, gate_was == gate_said, "executed while the gate was %02x, not %02x", gate_was, gate_said);
            passes--, taken++, gate_when_taken = pins->see_gate;
        }
        if (pins->see_commit) {
            CHECK(*this, !watches_gate || gate_was & OPEN, "a commit behind a closed gate");
            committed = now, commits++;
        }
        gate_was = pins->see_gate;
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
        pins->enc_a = a, pins->enc_b = b, pins->gpio_in = (((uint32_t)(clocks * 2654435761u) & inputs) | stopped) | (uint64_t)(uint32_t)(clocks * 2246822519u) << 32;
    }
    void wire_clock() {
        const Beat beat = sent < wire.size() ? wire[sent++] : Beat{0xdd, false, false};
        pins->gmii_rx_dv = beat.valid, pins->gmii_rx_data = beat.data, pins->gmii_rx_er = beat.error;
        if (beat.valid) last_in = now + byte;
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
    void send(const Bytes &f, unsigned gap = GAP) {
        for (int i = 0; i < 7; i++) wire.push_back({0x55, true, false});
        wire.push_back({0xd5, true, false});
        for (uint8_t b : f) wire.push_back({b, true, false});
        for (unsigned i = 0; i < gap; i++) wire.push_back({0xdd, false, false});
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
    uint32_t address(const std::string &name, unsigned word = 0) {
        CHECK(*this, registers.count(name), "no register %s", name.c_str());
        return registers[name] + 4 * word;
    }
    void ask(uint32_t address, bool store, uint32_t data) {
        pins->bus_adr = address >> 2, pins->bus_we = store, pins->bus_dat_w = data, pins->bus_stb = 1;
    }
    uint32_t access(uint32_t address, bool store, uint32_t data) {
        if (!lives) return 0;
        lives -= lives > 0;
        const uint64_t before = clocks;
        ask(address, store, data);
        for (unsigned n = 0; n < 4000; n++) {
            step();
            pins->eval();
            if (!pins->bus_ack) continue;
            const uint32_t value = pins->bus_dat_r;
            run(1);
            pins->bus_stb = 0;
            longest_access = std::max(longest_access, unsigned(clocks - before));
            return value;
        }
        fail("the bus is held for ever at %08x", address);
    }
    uint32_t read(const std::string &name, unsigned word = 0) { return access(address(name, word), false, 0); }
    void write(const std::string &name, uint32_t data, unsigned word = 0) { access(address(name, word), true, data); }
    // The longest piece that an access waits for: the answer's words behind the latch, one a clock.
    unsigned longest_piece() const { return 3 * stepgens + 2 * encoders + 20; }

    bool pending() { return read("ethmac.sram_writer_ev_pending"); }
    void admit() { write("rx_admission.admit", 1); }
    // Frees the slots; returns how many frames lay there.
    unsigned release() {
        unsigned count = 0;
        for (; pending(); count++) write("ethmac.sram_writer_ev_pending", 1);
        return count;
    }
    void arm() {
        if (read("watchdog.status") == ARMED) return;
        write("watchdog.control", CLEAR), write("watchdog.control", ARM);
        CHECK(*this, read("watchdog.status") == ARMED, "does not arm: %x", read("watchdog.status"));
    }
    void feed() { write("watchdog.token", ++token); }
    uint32_t token = 0;

    // ---- what firmware does ---------------------------------------------------------------------
    unsigned command_words() const { return HEAD + 2 * stepgens + pwms + outputs_high; }
    unsigned status_words() const { return 15 + 3 * stepgens + 2 * encoders + inputs_high; }
    size_t answer_bytes() const { return 42 + 16 + 4 * status_words(); }
    // The words behind: enables, outputs, arms, the selected latch, stepgens, PWMs, more outputs.
    uint32_t any_word(unsigned n) {
        if (n == 0) return (1u << stepgens) - 1;
        if (n == 1) return random.next() & 0xfff;
        if (n == 2) return 0;
        if (n == 3) return random.below(32) << 16;
        if (n < 4 + 2 * stepgens) return n & 1 ? 0 : (random.next() & 0x3fffffff) - 0x20000000;
        return random.next() & 0x5fffffff;
    }
    Words any(uint32_t number, uint32_t flags = 3, uint64_t apply = 0) {
        Words p{0x4e6f1044, 0, 0x000f0000u | command_words() << 8, 0x20000, TOKEN, number, flags, (uint32_t)apply, (uint32_t)(apply >> 32)};
        for (unsigned n = 0; n < command_words() - 5; n++) p.push_back(any_word(n));
        return p;
    }
    static Bytes frame(const Words &words) { return Frame(words).bytes(); }

    // Once for an owner: what its commands look like, and of what the answers consist.
    void open() {
        Bytes f(2, 0);
        append(f, frame(any(0)));
        auto word = [&](unsigned n) { return word_at(f, 4 * n); };
        for (unsigned n = 0, place = 0; n < 18; n++)
            if (n != 5 && n != 12) write("rx_admission.header0", word(n), place++);
        write("rx_admission.mode", 3), admit();
        write("fast_path.ip_sum", sum16({word(4), word(7), word(8)}));
        write("fast_path.udp_sum", sum16({word(7), word(8), word(9), 17, word(10) >> 16}));
        write_runs();
        Bytes r(2, 0);
        append(r, THEIRS), append(r, OURS), be16(r, IPV4);
        r.resize(16 + 28);
        for (uint32_t w : {0x4e6f1044u, 0u, 0x000f0000u | status_words() << 8, 0x30000u}) be32(r, w);
        for (unsigned n = 0; n < status_words(); n++) be32(r, 0xdead0000 + n);
        for (size_t n = 0; n < r.size() / 4; n++) access(TX_SLOT + 4 * n, true, word_at(r, 4 * n));
        write("fast_path.length", r.size());
    }
    void write_runs() {
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
        run(COPY | (pwms + outputs_high ? 0 : END), 4 + 2 * stepgens, number("command.enables"));
        run(COPY | (outputs_high ? 0 : END), pwms, number("command.pwm0_width"));
        run(COPY | END, outputs_high, number("command.gpio_out_high"));
        next = 4;
        run(SKIP, 8, 17);
        run(COPY, 2, number("status.sample_lo")), run(COPY, 2, number("status.sample_lo")), run(COPY, 1, number("status.left"));
        run(SKIP, 1, 24);
        run(COPY, 1, number("status.estop")), run(COPY, 4, number("status.gpio_in"));
        run(COPY | SELECT | (stepgens + encoders + inputs_high ? 0 : END), 1, number("status.encoder0_latch"));
        run(COPY | (encoders + inputs_high ? 0 : END), 3 * stepgens, number("status.stepgen0_position_lo"));
        run(COPY | (inputs_high ? 0 : END), 2 * encoders, number("status.encoder0_count"));
        run(COPY | END, inputs_high, number("status.gpio_in_high"));
    }
    // For each command. The answer carries three words that are its own.
    void hand_out(uint32_t number, uint32_t flags = 3, uint32_t gate = ARMED, bool executes = true, bool timed = false) {
        write("rx_admission.header0", number, 14), write("rx_admission.header0", flags, 15);
        for (unsigned n = 14; n < 17; n++) access(TX_SLOT + 4 * n, true, number + n);
        gate_said = gate, passes = 0;
        write("fast_path.gate", gate | executes << 8 | timed << 9);
        pass();
    }
    void pass() { passes += lives != 0, back_at = 0, write("fast_path.pass", 1); }
    void revoke() { write("fast_path.revoke", 1), back_at = clocks + 4; }
    // The next command, with its pass.
    Words next() {
        Words words = any(++sequence);
        hand_out(sequence);
        return words;
    }
    void forget() { answers.clear(), taken = commits = 0; }

    // ---- what must be true behind a frame -------------------------------------------------------
    void check_answer(uint32_t number, const Words &sent_words) {
        CHECK(*this, answers.size() == 1, "command %u has %zu answers", number, answers.size());
        check_answer(number, sent_words, answers[0]);
    }
    void check_answer(uint32_t number, const Words &sent_words, const Bytes &f) {
        CHECK(*this, f.size() > 12 && f[7] == 0xd5, "an answer of %zu bytes", f.size());
        const Bytes all(f.begin() + 8, f.end()), body = without_fcs(all);
        CHECK(*this, with_fcs(body) == all, "the FCS of the answer to %u", number);
        CHECK(*this, body.size() == answer_bytes(), "the answer has %zu bytes", body.size());
        auto w = [&](unsigned n) { return word_at(body, 42 + 16 + 4 * n); };
        auto same = [&](unsigned n, uint32_t expected, const char *what) { CHECK(*this, w(n) == expected, "answer to %u, word %u, %s: %08x, expected %08x", number, n, what, w(n), expected); };
        CHECK(*this, word_at(body, 42 + 12) == number + 14, "firmware's words");
        same(0, number + 15, "firmware's"), same(1, number + 16, "firmware's");
        same(2, read("status.sample_lo"), "arrival"), same(4, read("status.sample_lo"), "sample"), same(3, read("status.sample_hi"), "sample");
        same(6, read("status.left"), "left"), same(7, 0xdead0007, "skipped"), same(8, 0xdead0008, "skipped"), same(9, read("status.estop"), "e-stop");
        for (unsigned n = 0; n < 4; n++) same(10 + n, read("status.gpio_in", n), "inputs and flags");
        same(14, read("status.encoder0_latch", sent_words[AT_SELECT] >> 16 & 31), "latch");
        for (unsigned n = 0; n < 3 * stepgens; n++) same(15 + n, read("status.stepgen0_position_lo", n), "stepgen");
        for (unsigned n = 0; n < 2 * encoders; n++) same(15 + 3 * stepgens + n, read("status.encoder0_count", n), "encoder");
        if (inputs_high) same(15 + 3 * stepgens + 2 * encoders, read("status.gpio_in_high"), "inputs from 32 on");
        check_staged(sent_words);
    }
    void check_staged(const Words &sent_words) {
        const uint32_t *words = sent_words.data() + HEAD;
        auto same = [&](const char *name, unsigned n, uint32_t expected) {
            const uint32_t staged = read(name, n);
            CHECK(*this, staged == expected, "%s + %u is %08x, sent %08x", name, n, staged, expected);
        };
        same("command.gpio_out", 0, words[1]), same("command.probe_arms", 0, words[3]);
        for (unsigned n = 0; n < 2 * stepgens; n++) same("command.stepgen0_velocity", n, words[4 + n]);
        for (unsigned n = 0; n < pwms; n++) same("command.pwm0_width", n, words[4 + 2 * stepgens + n]);
        if (outputs_high) same("command.gpio_out_high", 0, words[4 + 2 * stepgens + pwms]);
    }
    // What has come was executed once, and answered.
    void check_executed(const std::string &what, const Words &words) {
        CHECK(*this, taken == 1 && commits == 1, "%s: executed %u times, committed %u times", what.c_str(), taken, commits);
        check_answer(words[AT_NUMBER], words);
        CHECK(*this, read("fast_path.status") == EXECUTED, "%s: status %x behind an executed command", what.c_str(), read("fast_path.status"));
    }
    void check_slots(const std::string &what, unsigned expected) {
        const unsigned lay = release();
        CHECK(*this, lay == expected, "%s: %u frames lie in slots, expected %u", what.c_str(), lay, expected);
    }
    // A command with its pass, to its end. Returns clocks from last byte in to first out.
    unsigned exchange() {
        const Words words = next();
        run(random.below(40));
        return exchange(Frame(words));
    }
    unsigned exchange(const Frame &f) {
        forget(), send(f.bytes()), quiet();
        check_executed("a good command", f.payload);
        check_slots("a good command", 0);
        const uint64_t took = first_out - last_in;
        CHECK(*this, byte != ETH || committed - last_in <= COMMIT * SYS, "committed %llu clocks behind the last byte", (unsigned long long)((committed - last_in) / SYS));
        return (took + SYS - 1) / SYS;
    }
    // A frame that is not executed, in a slot or gone; and the pass stays as it was.
    void left_alone(const std::string &what, const Bytes &f, bool slot) {
        forget();
        const uint32_t before = read("fast_path.status");
        send(f), quiet();
        CHECK(*this, !taken && !commits && answers.empty(), "%s: executed", what.c_str());
        CHECK(*this, read("fast_path.status") == before, "%s: the pass has changed", what.c_str());
        check_slots(what, slot);
    }
};
