// The SDRAM bridge under two caches and a CPU that is reset in between: every word read is the last
// one stored, a line comes in one burst, and a store is answered before it is done. Behind it there
// are the controller and a chip that checks its times.
#include "Vsdram_bridge.h"
#include "sdram_chip.h"
#include <algorithm>

static const unsigned BANK_BITS = 1, ROW_BITS = 11, COL_BITS = 8, WORDS = 1u << (BANK_BITS + ROW_BITS + COL_BITS), LINE = 8;

struct Master {
    Bench<Vsdram_bridge> &b;
    Chip<Vsdram_bridge> chip{b, BANK_BITS, ROW_BITS, COL_BITS};
    // the pads' registers
    struct { bool ras_n = true, cas_n = true, we_n = true, drives = false; unsigned ba = 0, a = 0; uint32_t d = 0; } pins;
    std::vector<uint32_t> words = std::vector<uint32_t>(WORDS);   // the CPU's view
    // and what they may be after an interrupted store
    std::vector<uint32_t> others = std::vector<uint32_t>(WORDS);

    bool clock() {  // one clock; true if there was an ack
        auto &c = *b.core;
        b.settle();
        const bool ack = c.ack;
        CHECK(b, !ack || (c.cyc && c.stb), "an answer without a request");
        seen = c.dat_r;
        const uint32_t caught = chip.clock(pins.ras_n, pins.cas_n, pins.we_n, pins.ba, pins.a, pins.drives, pins.d);
        pins = {bool(c.ras_n), bool(c.cas_n), bool(c.we_n), bool(c.drives), c.ba, c.a, c.dq_out};
        b.edge();
        c.dq_in = caught;
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
    for (unsigned at = 0; at < WORDS; at++) m.words[at] = m.others[at] = m.chip.words[at] = r.next();
    uint64_t loads = 0, stores = 0, torn = 0;
    while (!b.core->ready) m.rest(1);
    for (unsigned round = 0; round < 120000; round++) {
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
    // The durations without a refresh in between: a line in a row that is open, closed, and behind
    // another row of its bank; the one that follows; stores.
    const auto quiet = [&] {
        m.rest(40);
        while (b.core->ras_n || b.core->cas_n) m.rest(1);
        m.rest(20);
    };
    quiet();
    const unsigned closed = m.load(0x1000, LINE, true);
    m.rest(40);
    const unsigned next = m.load(0x1008, LINE, true);
    m.rest(40);
    const unsigned open = m.load(0x1040, LINE, true);
    m.rest(40);
    const unsigned other = m.load(0x2040, LINE, true);
    m.rest(40);
    quiet();
    const unsigned first = m.store(0x3100, 1, 15);
    m.rest(20);
    unsigned all = 0;
    for (unsigned n = 0; n < 8; n++) all += m.store(0x3101 + n, n, 15);
    m.rest(20);
    unsigned spread = 0;
    for (unsigned n = 0; n < 8; n++) spread += m.store(0x4000 * (n + 1), n, 15);
    CHECK(b, next == LINE + 2, "a line that is here takes %u clocks", next);
    CHECK(b, open == 14 && closed == 16 && other == 18, "a line that is not here takes %u, %u, %u clocks", open, closed, other);
    CHECK(b, first == 2 && all == 16, "stores wait: %u, eight take %u", first, all);
    m.rest(60);
    for (unsigned at = 0; at < WORDS; at++)
        CHECK(b, m.chip.words[at] == m.words[at] || m.chip.words[at] == m.others[at], "%x is %08x in the SDRAM, stored was %08x", at, m.chip.words[at], m.words[at]);
    return b.pass("%llu loads, %llu stores, %llu torn; a line in %u, %u or %u clocks (row open, closed, another one), %u if it follows the last; a store in %u, eight in %u, in as many rows %u",
                  (unsigned long long)loads, (unsigned long long)stores, (unsigned long long)torn, open, closed, other, next, first, all, spread);
}
