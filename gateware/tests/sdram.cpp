// The SDRAM's controller at the pins of a chip that measures every time by itself: random lines and
// stores, in a few rows and in many, with resets in between. Every word read is the last one
// stored, and every request is done within a bound.
#include "Vsdram.h"
#include "sdram_chip.h"
#include <algorithm>
#include <deque>
#include <unordered_map>

static const unsigned BANK_BITS = 2, ROW_BITS = 11, COL_BITS = 8, LINE = 8, BOUND = 42, START = 15 + 9;

struct Board {
    Bench<Vsdram> &b;
    Chip<Vsdram> chip{b, BANK_BITS, ROW_BITS, COL_BITS};
    // the pads' registers
    struct { bool ras_n = true, cas_n = true, we_n = true, drives = false; unsigned ba = 0, a = 0; uint32_t d = 0; } pins;
    std::unordered_map<unsigned, uint32_t> words;  // stored
    struct Read { unsigned at; bool known; uint32_t word; };
    // words that are to come, as they were when requested
    std::deque<Read> reads;
    uint64_t lines = 0, stores = 0, longest = 0;

    bool clock() {  // true: the request has been taken
        auto &c = *b.core;
        b.settle();
        const bool taken = c.taken;
        CHECK(b, !taken || c.want, "taken, but there is no request");
        if (c.valid) {
            CHECK(b, !reads.empty(), "a word without a request");
            const Read read = reads.front();
            CHECK(b, !read.known || read.word == c.word, "%x holds %08x, read %08x", read.at, read.word, c.word);
            reads.pop_front();
        }
        const uint32_t caught = chip.clock(pins.ras_n, pins.cas_n, pins.we_n, pins.ba, pins.a, pins.drives, pins.d);
        pins = {bool(c.ras_n), bool(c.cas_n), bool(c.we_n), bool(c.drives), c.ba, c.a, c.dq_out};
        b.edge();
        c.dq_in = caught;
        return taken;
    }
    void expect(unsigned at) {  // the words of a line
        for (unsigned n = at & ~(LINE - 1); n <= (at | (LINE - 1)); n++) {
            const auto found = words.find(n);
            reads.push_back({n, found != words.end(), found != words.end() ? found->second : 0});
        }
    }
    void rest(uint64_t clocks) {
        auto &c = *b.core;
        c.want = 0, c.at = b.random.next() & ((1u << (BANK_BITS + ROW_BITS + COL_BITS)) - 1), c.store = b.random.next() & 1, c.data = b.random.next();
        while (clocks--) clock();
    }
    unsigned request(unsigned at, bool store, uint32_t data = 0) {
        auto &c = *b.core;
        const uint64_t begin = b.clocks;
        c.want = 1, c.at = at, c.store = store, c.data = data;
        if (store) words[at] = data, stores++;
        else {
            expect(at);
            lines++;
        }
        while (!clock()) CHECK(b, b.clocks - begin < BOUND, "a request is not done after %u clocks", BOUND);
        c.want = 0;
        longest = std::max(longest, b.clocks - begin);
        return b.clocks - begin;
    }
    // From power-up or a reset until it is ready.
    uint64_t start() {
        const uint64_t begin = b.clocks;
        b.core->want = 0;
        while (b.settle(), !b.core->ready) {
            clock();
            CHECK(b, b.clocks - begin < START * 931, "not started after %llu clocks", (unsigned long long)(b.clocks - begin));
        }
        return b.clocks - begin;
    }
};

int main(int argc, char **argv) {
    Bench<Vsdram> b("sdram", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    c.reset = c.want = c.store = 0, c.at = c.data = c.dq_in = 0;
    Board m{b};
    const uint64_t started = m.start();
    unsigned resets = 0;
    const unsigned all = 1u << (BANK_BITS + ROW_BITS + COL_BITS);
    while (b.clocks < 6'000'000) {
        const unsigned few = r.next() % all & ~0x180000u;
        for (unsigned round = r.below(2000); round; round--) {
            // In one place, in a few rows and banks around it, or anywhere.
            const unsigned at = (r.one_in(4) ? few + r.below(64) : r.one_in(3) ? few ^ (r.next() & 0x7FF) : r.one_in(9) ? r.next() : few ^ (r.next() & 0x180)) % all;
            m.request(r.one_in(2) || m.words.empty() ? at : at & ~7u, r.one_in(2), r.next());
            if (r.one_in(3)) m.rest(r.below(r.one_in(20) ? 300 : 12));
        }
        if (r.one_in(20) && b.clocks < 1'500'000) {  // in the middle of whatever there is
            c.want = r.next() & 1, c.store = 0, c.at = r.next() % all;
            const bool line = c.want;
            if (line) m.expect(c.at);
            for (unsigned n = r.below(12); n && line; n--) if (m.clock()) c.want = 0;
            c.reset = 1;
            m.clock();
            c.reset = c.want = 0;
            for (unsigned n = 0; n < 5; n++) m.clock();
            m.reads.clear();
            m.chip.power();
            m.start();
            resets++;
        }
        if (r.one_in(3)) m.rest(r.below(5000));
    }
    // The durations without a refresh in between, to `taken`.
    const auto quiet = [&] { m.rest(900); while (!(c.ras_n == 0 && c.cas_n == 0)) m.rest(1); m.rest(20); };
    quiet();
    const unsigned closed = m.request(0x100, false), open = m.request(0x108, false);
    m.rest(4);
    const unsigned store = m.request(0x110, true, 1), second = m.request(0x111, true, 2);
    m.rest(4);
    const unsigned other = m.request(0x80100, true, 3);
    CHECK(b, closed == 10 && open == 8 && store == 1 && second == 1 && other == 5, "line %u, %u, store %u, %u, %u", closed, open, store, second, other);
    m.rest(20);
    return b.pass("%llu lines, %llu stores, longest %llu, %llu activates, %llu refreshes since %u resets, started after %llu clocks", (unsigned long long)m.lines,
                  (unsigned long long)m.stores, (unsigned long long)m.longest, (unsigned long long)m.chip.activates, (unsigned long long)m.chip.count, resets,
                  (unsigned long long)started);
}
