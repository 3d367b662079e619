// ROM and RAM under a CPU that fetches instructions, loads data at the same time, and is reset in
// between: every word is the one of its address, a line of the ROM comes in nine clocks whatever
// else is loaded, data wait for one line at most, and the RAM holds what was stored.
#include "Vonchip.h"
#include "bench.h"

static const unsigned ROM = 15360, RAM = 4608, LINE = 8;

static uint32_t word(unsigned n) { return (n + 1) * 0x9E3779B1u; }

struct Masters {
    Bench<Vonchip> &b;
    std::vector<uint32_t> ram = std::vector<uint32_t>(RAM);
    unsigned resting = 0, left = 0, fetched = 0, fetch_since = 0, data_since = 0, ram_since = 0;
    uint64_t lines = 0, words = 0, aways = 0, loads = 0, stores = 0, resets = 0;

    void begin_fetch() {
        auto &c = *b.core;
        Random &r = b.random;
        const bool away = r.one_in(6), line = r.one_in(4) ? false : true;
        const unsigned at = r.one_in(4) ? 14336 - LINE + r.below(3 * LINE) : r.below(ROM);
        c.fetch_cyc = c.fetch_stb = 1;
        c.fetch_adr = (away ? 0x10000000 + r.below(1 << 20) : at) & (line ? ~(LINE - 1) : ~0u);
        left = line ? LINE : 1, fetched = 0, fetch_since = 0;
        c.fetch_cti = line ? 2 : 0;
        away ? aways++ : line ? lines++ : words++;
    }

    void clock() {
        auto &c = *b.core;
        Random &r = b.random;
        resting -= resting > 0;
        if (!left && !resting && r.one_in(3)) begin_fetch();
        if (!c.data_cyc && !resting && r.one_in(4)) {
            c.data_cyc = c.data_stb = 1, data_since = 0;
            c.data_adr = r.one_in(3) ? ROM - 1 - r.below(1100) : r.below(ROM);
        }
        if (!c.ram_cyc && r.one_in(2)) {
            c.ram_cyc = c.ram_stb = 1, ram_since = 0;
            c.ram_adr = r.one_in(3) ? 4096 - 4 + r.below(8) : r.below(RAM);
            c.ram_we = r.next() & 1, c.ram_sel = r.below(16), c.ram_dat_w = r.next();
        }
        // what is behind the other instruction bus: it answers when it likes
        c.beyond_ack = 0;
        b.settle();
        const bool away = left && c.fetch_adr >= 0x10000000;
        CHECK(b, c.beyond_cyc == away, "the bus is asked for a word of the ROM, or not for another");
        if (away) {
            CHECK(b, c.beyond_adr == c.fetch_adr, "the bus is asked for %x, not %x", c.beyond_adr, c.fetch_adr);
            c.beyond_ack = r.one_in(3), c.beyond_dat_r = word(c.beyond_adr);
            b.settle();
        }
        CHECK(b, left || !c.fetch_ack, "an answer to nothing");
        if (left) {
            fetch_since++;
            if (c.fetch_ack) {
                CHECK(b, c.fetch_dat_r == word(c.fetch_adr), "instruction %x is %08x", c.fetch_adr, c.fetch_dat_r);
                CHECK(b, away || fetch_since == fetched + 2, "word %u of a line comes after %u clocks", fetched, fetch_since);
                fetched++, left--;
            }
        }
        data_since += c.data_cyc, ram_since += c.ram_cyc;
        const bool data = c.data_cyc && c.data_ack, store = c.ram_cyc && c.ram_ack;
        if (data) {
            CHECK(b, c.data_dat_r == word(c.data_adr), "data %x are %08x", c.data_adr, c.data_dat_r);
            loads++;
        }
        CHECK(b, data_since <= longest, "data wait %u clocks", data_since);
        if (store) {
            CHECK(b, ram_since == 2, "the RAM answers after %u clocks", ram_since);
            uint32_t &now = ram[c.ram_adr];
            if (c.ram_we) {
                for (int n = 0; n < 4; n++)
                    if (c.ram_sel >> n & 1) now = (now & ~(0xFFu << 8 * n)) | (c.ram_dat_w & 0xFFu << 8 * n);
                stores++;
            } else
                CHECK(b, c.ram_dat_r == now, "RAM %x is %08x, stored was %08x", c.ram_adr, c.ram_dat_r, now);
        }
        const bool was_fetched = c.fetch_ack;
        b.edge();
        if (was_fetched) {
            if (left) c.fetch_adr++, c.fetch_cti = left > 1 ? 2 : 7;
            else c.fetch_cyc = c.fetch_stb = 0;
        }
        if (data) c.data_cyc = c.data_stb = 0;
        if (store) c.ram_cyc = c.ram_stb = 0;
        if (r.one_in(200)) {  // the CPU is reset: all its requests end
            c.fetch_cyc = c.fetch_stb = c.data_cyc = c.data_stb = 0, left = 0, resting = 2, resets++;
        }
    }
    static const unsigned longest = LINE + 2;
};

int main(int argc, char **argv) {
    Bench<Vonchip> b("onchip", argc, argv);
    Masters m{b};
    for (unsigned at = 0; at < RAM; at++) m.ram[at] = 0;
    for (unsigned n = 0; n < 400000; n++) m.clock();
    return b.pass("%llu lines and %llu words of the ROM, %llu fetches from elsewhere, %llu loads beside them, %llu stores in the RAM, %llu resets",
                  (unsigned long long)m.lines, (unsigned long long)m.words, (unsigned long long)m.aways, (unsigned long long)m.loads,
                  (unsigned long long)m.stores, (unsigned long long)m.resets);
}
