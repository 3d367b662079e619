// The SDRAM bridge under two caches and a CPU that is reset in between: every word read is the last
// one stored, a line comes in one burst, and a store is answered before it is done. Behind it there
// is a port like LiteDRAM's: it takes commands in order, at any time, the word of a store at any
// time, and gives those of loads some clocks later.
#include "Vsdram_bridge.h"
#include "bench.h"
#include <array>
#include <deque>

static const unsigned WORDS = 1024, LINE = 8, LATENCY = 7;

struct Sdram {
    Bench<Vsdram_bridge> &b;
    std::array<uint32_t, WORDS> words{};
    struct Command { bool we; uint32_t at; };
    std::deque<Command> commands;
    std::deque<std::pair<uint64_t, uint32_t>> loads;  // the clock they come in, the word
    bool eager = false;  // as fast as LiteDRAM in an open row
    uint64_t stores = 0, lines = 0;

    void before() {  // its outputs for this clock
        auto &c = *b.core;
        c.cmd_ready = commands.size() < 8 && (eager || !b.random.one_in(3));
        c.wdata_ready = 0;
        if (!commands.empty() && commands.front().we && (eager || b.random.one_in(3))) c.wdata_ready = 1;
        c.rdata_valid = !loads.empty() && loads.front().first <= b.clocks;
        c.rdata = c.rdata_valid ? loads.front().second : uint32_t(b.random.next());
    }
    void after() {  // the pins' levels at this edge; called before it
        auto &c = *b.core;
        if (c.rdata_valid) loads.pop_front();
        if (c.wdata_ready) {
            CHECK(b, c.wdata_valid && c.wdata_we == 15, "the SDRAM takes a word that is not there");
            words[commands.front().at] = c.wdata;
            commands.pop_front();
            stores++;
        } else if (!commands.empty() && !commands.front().we && (eager || !b.random.one_in(4))) {
            loads.push_back({b.clocks + LATENCY, words[commands.front().at]});
            lines += commands.front().at % LINE == 0;
            commands.pop_front();
        }
        if (c.cmd_valid && c.cmd_ready) commands.push_back({bool(c.cmd_we), c.cmd_addr});
    }
};

struct Master {
    Bench<Vsdram_bridge> &b;
    Sdram sdram{b};
    std::array<uint32_t, WORDS> words{};   // the CPU's view
    std::array<uint32_t, WORDS> others{};  // and what they may be after an interrupted store

    bool clock() {  // one clock; true if there was an ack
        sdram.before();
        b.settle();
        const bool ack = b.core->ack;
        CHECK(b, !ack || (b.core->cyc && b.core->stb), "an answer without a request");
        seen = b.core->dat_r;
        sdram.after();
        b.edge();
        return ack;
    }
    uint32_t seen = 0;

    void rest(unsigned clocks) {
        b.core->cyc = b.core->stb = 0;
        b.core->cti = b.random.below(8), b.core->adr = b.random.next() % WORDS, b.core->we = b.random.next() & 1;
        while (clocks--) clock();
    }
    // Words from `at` on in one burst, or until it is interrupted. Returns the number of clocks.
    unsigned load(unsigned at, unsigned count, bool burst, unsigned patience = 500) {
        auto &c = *b.core;
        const uint64_t begin = b.clocks;
        for (unsigned n = 0; n < count; n++) {
            c.cyc = c.stb = 1, c.we = 0, c.sel = 15, c.adr = at + n;
            c.cti = !burst ? 0 : n + 1 < count ? 2 : 7;
            for (uint64_t since = b.clocks; !clock();) {
                if (b.clocks - begin > patience) return rest(1 + b.random.below(9)), b.clocks - begin;
                CHECK(b, b.clocks - since < 400, "no answer to a load of %x", at + n);
            }
            CHECK(b, seen == words[at + n] || seen == others[at + n], "%x holds %08x, read %08x", at + n, words[at + n], seen);
            words[at + n] = others[at + n] = seen;
        }
        const unsigned took = b.clocks - begin;
        c.cyc = c.stb = 0;
        return took;
    }
    unsigned store(unsigned at, uint32_t value, unsigned sel, bool torn = false) {
        auto &c = *b.core;
        const uint64_t begin = b.clocks;
        c.cyc = c.stb = c.we = 1, c.sel = sel, c.adr = at, c.dat_w = value, c.cti = b.random.one_in(2) ? 0 : 7;
        uint32_t mask = 0;
        for (int n = 0; n < 4; n++) mask |= sel >> n & 1 ? 0xFFu << 8 * n : 0;
        const uint32_t after = (words[at] & ~mask) | (value & mask), other = (others[at] & ~mask) | (value & mask);
        if (torn) {  // before it can be answered
            CHECK(b, !clock(), "answered at once");
            rest(1 + b.random.below(3));
            if (sel == 15 || words[at] == others[at]) others[at] = after;  // done or not
            else words[at] = others[at] = load(at, 1, false), words[at] = others[at] = seen;
            return 0;
        }
        while (!clock()) CHECK(b, b.clocks - begin < 400, "no answer to a store at %x", at);
        words[at] = after, others[at] = other;
        c.cyc = c.stb = 0;
        return b.clocks - begin;
    }
};

int main(int argc, char **argv) {
    Bench<Vsdram_bridge> b("sdram_bridge", argc, argv);
    Random &r = b.random;
    Master m{b};
    for (unsigned at = 0; at < WORDS; at++) m.words[at] = m.others[at] = m.sdram.words[at] = r.next();
    uint64_t loads = 0, stores = 0, torn = 0;
    m.rest(3);
    for (unsigned round = 0; round < 120000; round++) {
        m.sdram.eager = round / 1000 % 2;
        // A few lines in turn, so that they meet in the bridge; and the last ones, after which the
        // addresses wrap.
        const unsigned line = r.one_in(8) ? r.below(WORDS / LINE) : r.one_in(9) ? WORDS / LINE - 1 : (round / 50 + r.below(4)) % (WORDS / LINE);
        const unsigned at = line * LINE + r.below(LINE);
        switch (r.below(8)) {
        case 0: m.load(at, 1, r.one_in(2)), loads++; break;
        case 1: m.load(at, 1 + r.below(LINE - at % LINE), true), loads++; break;
        case 2: m.load(line * LINE, LINE, true, r.below(30)), torn++; break;
        case 3:
            if (m.words[at] == m.others[at]) m.store(at, r.next(), r.one_in(2) ? 15 : 1 + r.below(14), true), torn++;
            break;
        case 4: m.store(at, r.next(), 1 + r.below(14)), stores++; break;
        case 5:
            for (unsigned n = 0; n < 1 + r.below(8); n++) m.store(line * LINE + r.below(LINE), r.next(), 15), stores++;
            break;
        default: m.load(line * LINE, LINE, true), loads++;
        }
        if (r.one_in(2)) m.rest(r.below(r.one_in(5) ? 60 : 6));
    }
    // The duration with an SDRAM that is not busy.
    m.sdram.eager = true;
    m.rest(100);
    for (unsigned line : {3, 9}) m.load(line * LINE, LINE, true), m.rest(40);
    const unsigned far = m.load(0, LINE, true);
    m.rest(40);
    const unsigned next = m.load(LINE, LINE, true);
    m.rest(40);
    CHECK(b, next == LINE + 2, "a line that is here takes %u clocks", next);
    CHECK(b, far > LINE + 2 && far <= LINE + LATENCY + 6, "a line that is not here takes %u clocks", far);
    unsigned first = m.store(0x100, 1, 15), all = first;
    for (unsigned n = 1; n < 4; n++) all += m.store(0x100 + n, n, 15);
    CHECK(b, first == 2 && all == 8, "stores wait: %u, four take %u", first, all);
    m.rest(60);
    for (unsigned at = 0; at < WORDS; at++)
        CHECK(b, m.sdram.words[at] == m.words[at] || m.sdram.words[at] == m.others[at], "%x is %08x in the SDRAM, stored was %08x", at, m.sdram.words[at], m.words[at]);
    return b.pass("%llu loads, %llu stores, %llu torn; a line in %u clocks, %u if it follows the last, a store in %u", (unsigned long long)loads,
                  (unsigned long long)stores, (unsigned long long)torn, far, next, first);
}
