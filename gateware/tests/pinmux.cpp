// The pin multiplexer at its pins: random routes of every pin and every input against a reference
// that knows no tables, with words that come at the wrong moment and a gate that opens too early.
#include "Vpinmux.h"
#include "bench.h"

constexpr unsigned PINS = 56, SOURCES = 36, SINKS = 48, LAST = 124;  // from there on constants
constexpr uint64_t ALL = (1ull << PINS) - 1;

// A route's byte, asked with all sources there are.
static bool says(uint8_t byte, uint64_t sources, unsigned count) {
    const unsigned source = byte & 127;
    if (source >= LAST) return byte >> 7;
    return source < count && ((sources >> source & 1) ^ byte >> 7);
}

struct Half {  // which words are taken, and when they are complete
    unsigned left = 0;
    bool any = false, refused = false;
    bool ready() const { return any && !left; }
    // Before the edge; returns whether the word is taken.
    bool clock(bool shut, bool we, bool route) {
        const bool taken = we && shut && !left;
        if (we) refused = !taken;
        if (left && shut && !--left) any = true;
        if (taken && route) left = 16;
        return taken;
    }
};

struct Pins : Bench<Vpinmux> {
    Random &r = random;
    Vpinmux &c = *core;
    uint64_t boards = 0, refusals = 0, early = 0, edges = 0;

    // The reference. 124: a constant 0, as at power-up.
    uint8_t out[PINS], in[SINKS];
    Half outs, ins;
    uint64_t safe = 0, keeps = 0, drives = 0, levels = 0, meta = 0, seen = 0;
    bool live = false, opened = false;

    Pins(int argc, char **argv) : Bench("pinmux", argc, argv) {
        for (auto &byte : out) byte = LAST;
        for (auto &byte : in) byte = LAST;
        c.gate = c.we_in = c.we_out = 0;
    }

    void clock() {
        settle();
        for (unsigned n = 0; n < SINKS && !ins.left; n++)
            CHECK(*this, (c.sinks >> n & 1) == says(in[n], seen, PINS), "input %u does not carry what %02x says", n, in[n]);
        uint64_t next = 0;
        for (unsigned p = 0; p < PINS; p++) {
            const bool rest = (keeps >> p & 1) && opened ? levels >> p & 1 : safe >> p & 1;
            // its own group of four is behind the sources of all
            const uint64_t all = c.sources | uint64_t(c.own >> (p & ~3u) & 15) << SOURCES;
            next |= uint64_t(live ? says(out[p], all, SOURCES + 4) : rest) << p;
        }
        const bool next_live = c.gate && outs.ready() && ins.ready();
        const bool shut = !c.gate && !live;
        const bool taken = outs.clock(shut, c.we_out, c.at < 32);
        opened = live || (opened && !taken);
        if (taken) word();
        if (ins.clock(!c.gate, c.we_in, true) && c.at % 32 < SINKS / 4)
            for (unsigned n = 0; n < 4; n++) in[c.at % 32 * 4 + n] = c.word >> 8 * n;
        live = next_live, seen = meta, meta = c.pins;
        edges += __builtin_popcountll(levels ^ next), levels = next;
        edge();
        CHECK(*this, c.levels == levels, "pins %014llx, expected %014llx", (unsigned long long)c.levels, (unsigned long long)levels);
        CHECK(*this, c.drives == drives, "drives %014llx, expected %014llx", (unsigned long long)c.drives, (unsigned long long)drives);
        CHECK(*this, c.seen == seen, "sees %014llx, expected %014llx", (unsigned long long)c.seen, (unsigned long long)seen);
        CHECK(*this, c.live == live, "live %d, expected %d", c.live, live);
        CHECK(*this, c.idle_out == !outs.left && c.idle_in == !ins.left, "idle at the wrong clock");
        CHECK(*this, c.refused_out == outs.refused && c.refused_in == ins.refused, "a word is refused that should not be, or the reverse");
    }
    void word() {
        if (c.at < 32) {
            if (c.at < PINS / 4)
                for (unsigned n = 0; n < 4; n++) out[c.at * 4 + n] = c.word >> 8 * n;
            return;
        }
        if ((c.at & 3) > 1 || c.at >= 44) return;
        const unsigned shift = 32 * (c.at & 1);
        uint64_t &bits = c.at < 36 ? safe : c.at < 40 ? keeps : drives;
        bits = ((bits & ~(0xFFFFFFFFull << shift)) | uint64_t(c.word) << shift) & ALL;
    }
    void anything() {
        c.sources = r.next() & ((1ull << SOURCES) - 1), c.own = r.next() & ALL, c.pins = r.next() & ALL;
        clock();
    }
    void run(unsigned n) { while (n--) anything(); }
    void write(bool input, unsigned at, uint32_t value) {
        c.at = at, c.word = value;
        (input ? c.we_in : c.we_out) = 1;
        anything();
        c.we_in = c.we_out = 0;
        while (outs.left || ins.left) anything();
    }
    uint8_t route(unsigned count) {
        const unsigned source = r.one_in(8) ? LAST + r.below(4) : r.one_in(20) ? r.below(LAST) : r.below(count);
        return source | r.below(2) << 7;
    }
    uint32_t routes(unsigned count) {
        uint32_t word = 0;
        for (unsigned n = 0; n < 4; n++) word |= uint32_t(route(count)) << 8 * n;
        return word;
    }

    void nothing_drives_at_power_up() {
        c.gate = 1;
        run(50);
        CHECK(*this, !c.live && !c.levels && !c.drives, "live without a route");
        c.gate = 0;
        run(2);
    }
    void a_board() {
        for (unsigned at = 0; at < PINS / 4; at++) write(false, at, routes(SOURCES + 4));
        for (unsigned at = 0; at < SINKS / 4; at++) write(true, at, routes(PINS));
        for (unsigned at = 32; at < 44; at++) write(false, at, r.next());
        boards++;
    }
    void runs() {
        c.gate = 1;
        for (unsigned n = 20 + r.below(80); n--;) {
            c.we_out = r.one_in(8), c.we_in = r.one_in(8), c.at = r.below(64), c.word = r.next();
            refusals += c.we_out + c.we_in;
            anything();
        }
        c.we_out = c.we_in = c.gate = 0;
        run(r.below(10));
        c.gate = r.one_in(2);  // some gates open again at once
        run(r.below(10));
        c.gate = 0;
        run(2);
    }
    // It opens while routes are being written: nothing is live until it has closed and they are.
    void opens_too_early() {
        const bool input = r.one_in(2);
        c.at = r.below(12), c.word = routes(SOURCES);
        (input ? c.we_in : c.we_out) = 1;
        anything();
        c.we_in = c.we_out = 0;
        run(r.below(16));
        c.gate = 1;
        run(2 + r.below(30));
        CHECK(*this, !c.live, "live with half a route");
        c.gate = 0;
        run(20);
        early++;
    }
};

int main(int argc, char **argv) {
    Pins p(argc, argv);
    p.nothing_drives_at_power_up();
    for (unsigned round = 0; round < 300; round++) {
        p.a_board();
        for (unsigned n = 0; n < 4; n++) p.runs();
        p.opens_too_early();
    }
    return p.pass("%llu boards, %llu edges at the pins, %llu words refused, %llu gates that opened too early", (unsigned long long)p.boards,
                  (unsigned long long)p.edges, (unsigned long long)p.refusals, (unsigned long long)p.early);
}
