// An image: cores, multiplexer and the registers between them, for a platform instead of a board
// file. Random configurations are written over the bus; then every source must be at the lines it
// was routed to, every input of a core must follow its line, and no line may drive that was not
// asked to.
#include "Vimage.h"
#include "bench.h"
#include <algorithm>
#include <fstream>
#include <map>
#include <string>
#include <vector>

constexpr unsigned LINES = 56, KEY = LINES, CHANNELS = 8;
// Numbers of `wire::pins`.
constexpr unsigned PWM = 16, ENABLED = 32, HEARTBEAT = 33, OWN = 36, INDEX = 32, RESET = 40, FACTORY = 41, ESTOP = 44, SINKS = 48;
constexpr uint8_t NONE = 127, INVERT = 128;
constexpr uint64_t ALL = (1ull << LINES) - 1;
constexpr uint32_t ARM = 0x41524d31, STOP = 0x53544f50, CLEAR = 0x434c5231;

struct Image : Bench<Vimage> {
    Random &r = random;
    Vimage &c = *core;
    std::map<std::string, uint32_t> map;
    uint8_t out[LINES], in[SINKS];
    uint64_t safe = 0, drives = 0, edges = 0, beats = 0;
    uint64_t seen = 0, meta = 0;        // what was at the pads, the button behind the lines
    unsigned open = 0, closed = 3;      // clocks since the gate has moved
    bool routed = false, still = false; // all words are written; the lines stay as they are
    bool beat_was = false;
    uint64_t beat_at = 0, levels_were = 0;

    Image(int argc, char **argv) : Bench("image", argc, argv) {
        std::ifstream file(MAP);
        std::string name, at, access, mask;
        while (file >> name >> at >> access >> mask) map[name] = uint32_t(strtoul(at.c_str(), nullptr, 16));
        std::fill(out, out + LINES, NONE), std::fill(in, in + SINKS, NONE);
        c.key = 1;
    }

    // What the sources are, less those of `enabled` and `heartbeat`, which are no ports.
    bool source(unsigned line, uint8_t route) {
        const unsigned n = route & 127;
        bool level = false;
        if (n < PWM) level = (n & 1 ? c.dir : c.step) >> n / 2 & 1;
        else if (n < ENABLED) level = (n & 1 ? c.pwm_dir : c.pwm) >> (n - PWM) / 2 & 1;
        else if (n == ENABLED) level = open >= 1;
        else if (n >= OWN && n < OWN + 4) level = c.outputs >> ((line & ~3u) + n - OWN) & 1;
        return level != (route >= INVERT);
    }
    bool sink(unsigned n) {
        if (n < INDEX) return std::vector<uint32_t>{c.enc_a, c.enc_b, c.enc_i, c.enc_mask}[n % 4] >> n / 4 & 1;
        if (n < RESET) return c.step_index >> (n - INDEX) & 1;
        return n == RESET ? c.ext_reset : c.factory;
    }
    void clock() {
        if (!still && r.one_in(4)) c.line_seen = r.next() & ALL;
        settle();
        uint64_t next = 0;
        for (unsigned p = 0; p < LINES; p++) next |= uint64_t(source(p, out[p])) << p;
        const uint64_t pads = c.line_seen | uint64_t(c.key) << KEY;
        seen = meta, meta = pads;
        const bool was = c.gate;
        edge();
        settle();
        open = was ? open + 1 : 0, closed = was ? 0 : closed + 1;
        const uint64_t levels = c.line_levels;
        for (unsigned p = 0; p < LINES; p++) {
            if ((out[p] & 127) == HEARTBEAT) { heart(levels >> p & 1, out[p] >= INVERT); continue; }
            if (open >= 3 && routed) CHECK(*this, (levels >> p & 1) == (next >> p & 1), "line %u is not what route %02x says", p, out[p]);
        }
        if (closed >= 3) CHECK(*this, levels == safe, "at rest lines are %014llx, not %014llx", (unsigned long long)levels, (unsigned long long)safe);
        CHECK(*this, c.line_drives == drives, "drives %014llx, not %014llx", (unsigned long long)c.line_drives, (unsigned long long)drives);
        for (unsigned n = 0; n <= FACTORY && routed; n++) {
            const unsigned line = in[n] & 127;
            bool level = in[n] != NONE && ((seen >> line & 1) != (in[n] >= INVERT));
            if (n == FACTORY) level |= !(seen >> KEY & 1);
            CHECK(*this, sink(n) == level, "input %u does not follow route %02x", n, in[n]);
        }
        CHECK(*this, c.inputs == (seen & ALL), "inputs are not the lines");
        edges += __builtin_popcountll(levels ^ levels_were), levels_were = levels;
    }
    // The heartbeat is at any number of lines; one of them is looked at.
    void heart(bool level, bool inverted) {
        if (open < 4 || !routed) { beat_at = 0, beat_was = level != inverted; return; }
        if ((level != inverted) == beat_was) return;
        if (beat_at && beat_at != clocks) CHECK(*this, clocks - beat_at == 4096, "a heartbeat of %llu clocks", (unsigned long long)(clocks - beat_at));
        beat_was = level != inverted, beat_at = clocks, beats++;
    }
    void run(unsigned n) { while (n--) clock(); }
    uint32_t at(const std::string &name) {
        CHECK(*this, map.count(name), "no register %s", name.c_str());
        return map[name];
    }
    void write(const std::string &name, uint32_t value, unsigned word = 0) {
        c.adr = at(name) + word, c.dat_w = value, c.we = 1;
        clock();
        c.we = 0, c.adr = r.next();
        clock();
    }
    uint32_t read(const std::string &name) {
        c.coming = at(name);
        clock();
        c.coming = r.next();
        clock();
        return c.dat_r;
    }
    void expect(const std::string &name, uint32_t value) {
        const uint32_t is = read(name);
        CHECK(*this, is == value, "%s reads %08x, expected %08x", name.c_str(), is, value);
    }
    uint8_t polarity(uint8_t source) { return source | (r.one_in(2) ? INVERT : 0); }

    // The lines are as they are until `still` ends, so that e-stops and the reset stay released.
    void configure() {
        write("watchdog.control", STOP);
        run(4);
        routed = false, still = true, c.key = 1, c.line_seen = r.next() & ALL;
        for (auto &route : out) route = r.one_in(5) ? NONE : polarity(r.one_in(4) ? OWN + r.below(4) : r.below(ENABLED + 2));
        auto released = [&] { const unsigned line = r.below(LINES); return uint8_t(line | (c.line_seen >> line & 1 ? INVERT : 0)); };
        for (unsigned n = 0; n < SINKS; n++) in[n] = r.one_in(6) ? NONE : n >= RESET ? released() : polarity(r.below(LINES + 1));
        auto four = [](const uint8_t *from) { return from[0] | from[1] << 8 | from[2] << 16 | uint32_t(from[3]) << 24; };
        for (unsigned w = 0; w < SINKS / 4; w++) write("pinmux_in.route0", four(in + 4 * w), w), run(16);
        for (unsigned w = 0; w < LINES / 4; w++) write("pinmux_out.route0", four(out + 4 * w), w), run(16);
        expect("pinmux_in.status", 0b101), expect("pinmux_out.status", 0b001);
        routed = true;
        const uint64_t rest = r.next() & ALL, wanted = r.next() & ALL;
        for (unsigned w = 0; w < 2; w++) {
            closed = 0;
            write("pinmux_out.safe0", uint32_t(rest >> 32 * w), w);
            safe = (safe & ~(0xffffffffull << 32 * w)) | (rest & 0xffffffffull << 32 * w);
        }
        for (unsigned w = 0; w < 2; w++) {
            c.adr = at("pinmux_out.drives0") + w, c.dat_w = uint32_t(wanted >> 32 * w), c.we = 1;
            clock();
            c.we = 0, drives = (drives & ~(0xffffffffull << 32 * w)) | (wanted & 0xffffffffull << 32 * w);
            clock();  // it changes a clock behind the bus
        }
    }
    void move() {
        for (unsigned n = 0; n < CHANNELS; n++) {
            const std::string step = "command.stepgen" + std::to_string(n), pwm = "command.pwm" + std::to_string(n);
            write(step + "_velocity", r.next() & 0x9fffffff);
            write(pwm + "_width", 1u << 30 | r.one_in(2) << 31 | r.below(60 * 256));
        }
        write("command.enables", 0xff);
        write("command.gpio_out", r.next()), write("command.gpio_out_high", r.next());
        write("timebase.strobe", 1);
    }
    void arm() {
        write("watchdog.control", CLEAR);
        write("watchdog.control", ARM);
        CHECK(*this, c.gate, "it cannot be armed: watchdog.status %02x, estop routes %02x %02x %02x %02x", read("watchdog.status"), in[ESTOP], in[ESTOP + 1], in[ESTOP + 2], in[ESTOP + 3]);
    }

    void power_up() {
        run(8);
        expect("ident.features", 0b111), expect("ident.pins", LINES), expect("ident.platform", PLATFORM);
        expect("ident.channels0", 0x080808), expect("ident.channels1", LINES | LINES << 8);
        expect("gpio.estop_mask", 0), expect("pads.step", 0);
        arm();
        move();
        run(2000);
        CHECK(*this, !c.line_levels && !c.line_drives, "something is driven, and nothing was configured");
    }
    // With the gate open no word has an effect.
    void refused() {
        for (const std::string name : {"pinmux_out.route3", "pinmux_out.safe1", "pinmux_out.keeps0", "pinmux_out.drives0", "pinmux_in.route2"}) {
            write(name, r.next());
            expect(name.substr(0, name.find('.')) + ".status", 0b111);
        }
    }
    void stops() {
        for (unsigned k = 0; k < 4; k++) {
            if (in[ESTOP + k] == NONE) continue;
            const uint64_t line = 1ull << (in[ESTOP + k] & 127);
            uint32_t same = 0;  // others that listen to the line
            for (unsigned j = 0; j < 4; j++) same |= uint32_t(in[ESTOP + j] != NONE && (in[ESTOP + j] & 127) == (in[ESTOP + k] & 127)) << j;
            arm();
            run(4);
            c.line_seen ^= line;
            run(3);
            CHECK(*this, !c.gate, "e-stop %u has not closed the gate in three clocks", k);
            run(6);
            write("timebase.strobe", 2);
            run(18);
            expect("status.estop", same);
            CHECK(*this, read("watchdog.last_close") == 5, "the e-stop is not the reason");
            write("watchdog.control", CLEAR);
            CHECK(*this, read("watchdog.status") & 0xc0, "the latch fell with the line active");
            c.line_seen ^= line;
            run(6);
            write("watchdog.control", CLEAR);
            CHECK(*this, !(read("watchdog.status") & 0xc0), "the latch does not fall");
        }
        if (in[RESET] == NONE) return;
        arm();
        c.line_seen ^= 1ull << (in[RESET] & 127);
        run(4);
        CHECK(*this, !c.gate, "the external reset has not closed the gate in four clocks");
        c.line_seen ^= 1ull << (in[RESET] & 127);
        run(6);
    }
    int all(unsigned boards) {
        write("watchdog.timeout", 100000000);
        power_up();
        for (unsigned n = 0; n < CHANNELS; n++) {
            write("stepgen" + std::to_string(n) + ".steplen", 1 + r.below(8)), write("stepgen" + std::to_string(n) + ".dirsetup", 1 + r.below(8));
            write("pwm" + std::to_string(n) + ".period", 20 + r.below(40));
        }
        for (unsigned n = 0; n < boards; n++) {
            configure();
            arm();
            for (unsigned k = 0; k < 3; k++) move(), run(1000);
            if (n % 16 == 0) run(9000);
            refused();
            stops();
            write("watchdog.control", STOP);
            run(4);
            // A button that is pressed is the factory pin, whatever is routed.
            c.key = 0;
            run(8);
            CHECK(*this, c.factory && (read("flash.status") & 2), "the button is not the factory pin");
            c.key = 1;
            // Pads that nothing listens to for a stop may do what they like.
            still = false;
            std::fill(in + RESET, in + SINKS, NONE);
            routed = false;
            run(200);
        }
        CHECK(*this, beats > 4, "no heartbeat was seen");
        return pass("%u configurations over the bus, %llu edges", boards, (unsigned long long)edges);
    }
};

int main(int argc, char **argv) {
    Image image(argc, argv);
    return image.all(argc > 2 ? unsigned(atoi(argv[2])) : 40);
}
