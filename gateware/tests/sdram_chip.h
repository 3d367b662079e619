// An SDRAM at its pins, from the data sheets of M12L64322A, M12L16161A (two of them) and EM636165,
// the slowest grade of each: a command that comes too early, to a bank that is not as it needs it,
// or before the start is complete, ends the test. It does bursts of one word with CL 2, and has no
// data masks. Times are in nanoseconds here and counted in clocks of 60 MHz: the core's own numbers
// are not used.
#pragma once
#include "bench.h"
#include <vector>

struct Times {  // ns, but where it says clocks
    double rcd = 21, rp = 21, ras = 42, rc = 63, rfc = 80, rrd = 14, ras_max = 100'000, pause = 200'000;
    unsigned rdl = 2, mrd = 2;         // clocks
    unsigned rows = 4096;              // refreshes
    double every = 64'000'000;         // within which all of them come
    double period = 1000.0 / 60;
};

template <class Core>
struct Chip {
    Bench<Core> &b;
    unsigned bank_bits, row_bits, col_bits;
    Times t{};
    std::vector<uint32_t> words = std::vector<uint32_t>(1u << (bank_bits + row_bits + col_bits), 0xDEAD5D5D);
    static constexpr uint64_t NEVER = 0;  // clocks begin at 1
    struct Bank { bool open = false; unsigned row = 0; uint64_t activated = NEVER, closed = NEVER, wrote = NEVER, read = NEVER; };
    std::vector<Bank> banks = std::vector<Bank>(1u << bank_bits);
    // when the last ones were
    std::vector<uint64_t> refreshes = std::vector<uint64_t>(t.rows, NEVER);
    uint64_t now = 0, refreshed = NEVER, moded = NEVER, activated = NEVER, all_closed = NEVER, count = 0, started = 0;
    bool usable = false;
    uint64_t activates = 0, closes = 0, reads = 0, writes = 0;
    uint32_t later = 0;
    // the word of the last command; that of the one before it may still be there
    bool drives = false, drove = false;

    unsigned clocks(double ns) const { return unsigned(ns / t.period + 0.999999); }
    void since(uint64_t then, unsigned least, const char *what) {
        CHECK(b, then == NEVER || now - then >= least, "%s after %llu clocks, must be %u", what, (unsigned long long)(now - then), least);
    }
    void power() {  // it must be started again, and its banks may be open
        usable = false, started = now, count = 0, all_closed = NEVER;
    }

    // A clock with the levels of the pins. Returns what the pins' input register catches at its
    // end.
    uint32_t clock(bool ras_n, bool cas_n, bool we_n, unsigned ba, unsigned a, bool host_drives, uint32_t d) {
        now++;
        Bank &bank = banks[ba];
        const uint32_t caught = drives ? later : uint32_t(b.random.next());
        CHECK(b, !((drives || drove) && host_drives), "both ends drive the data");
        drove = drives, drives = false;
        const bool ap = a >> 10 & 1;
        const size_t at = ((size_t(bank.row) << bank_bits | ba) << col_bits) | (a & ((1u << col_bits) - 1));
        const unsigned command = ras_n << 2 | cas_n << 1 | we_n;
        if (command != 7) {
            CHECK(b, now - started >= clocks(t.pause), "a command %llu clocks after power-up", (unsigned long long)(now - started));
            since(refreshed, clocks(t.rfc), "a command after a refresh");
            since(moded, t.mrd, "a command after the mode register");
        }
        CHECK(b, !host_drives || command == 4, "data without a write");
        switch (command) {
        case 0:  // mode register
            for (auto &other : banks) {
                CHECK(b, !other.open, "mode register with an open bank");
                since(other.closed, clocks(t.rp), "mode register after a precharge");
            }
            CHECK(b, all_closed != NEVER && count >= 8, "mode register after %llu refreshes", (unsigned long long)count);
            CHECK(b, a == 0x020 && ba == 0, "mode register %x, bank %u", a, ba);
            moded = now, usable = true;
            break;
        case 1:  // refresh
            for (auto &other : banks) {
                CHECK(b, !other.open, "refresh with an open bank");
                since(other.closed, clocks(t.rp), "refresh after a precharge");
                since(other.activated, clocks(t.rc), "refresh after an activate");
            }
            CHECK(b, all_closed != NEVER, "refresh before the banks were closed");
            if (usable) {
                const uint64_t first = refreshes[count % t.rows];
                CHECK(b, count < t.rows || now - first <= uint64_t(t.every / t.period), "%u refreshes took %llu clocks", t.rows, (unsigned long long)(now - first));
                CHECK(b, refreshed == NEVER || now - refreshed < 9 * t.every / t.rows / t.period, "no refresh for %llu clocks", (unsigned long long)(now - refreshed));
            }
            refreshes[count++ % t.rows] = refreshed = now;
            break;
        case 2:  // precharge
            for (unsigned n = 0; n < banks.size(); n++) if (ap || n == ba) {
                Bank &one = banks[n];
                if (!one.open) continue;
                since(one.activated, clocks(t.ras), "precharge after an activate");
                since(one.wrote, t.rdl, "precharge after a write");
                since(one.read, 1, "precharge after a read");  // CL + burst - 2
                one.open = false, one.closed = now, closes++;
            }
            if (ap) all_closed = now;
            break;
        case 3:  // activate
            CHECK(b, usable && !bank.open, "activate of bank %u, which is %s", ba, usable ? "open" : "not started");
            since(bank.closed, clocks(t.rp), "activate after a precharge");
            since(bank.activated, clocks(t.rc), "activate after an activate");
            since(activated, clocks(t.rrd), "activate after one of another bank");
            bank.open = true, bank.row = a & ((1u << row_bits) - 1), bank.activated = activated = now, bank.wrote = bank.read = NEVER, activates++;
            break;
        case 4: case 5:  // write, read
            CHECK(b, usable && bank.open && !ap, "%s of a bank that is not open, or with a precharge", command == 4 ? "write" : "read");
            since(bank.activated, clocks(t.rcd), "a column after its row");
            CHECK(b, now - bank.activated <= t.ras_max / t.period, "a row was open for too long");
            if (command == 4) {
                CHECK(b, host_drives, "a write without data");
                words[at] = d, bank.wrote = now, writes++;
            } else drives = true, bank.read = now, reads++;
            break;
        case 6: CHECK(b, false, "burst stop"); break;
        default: ;
        }
        // CL 2: the word is there from 6 ns after the next edge on, and goes 6 ns behind the edge
        // after that. The pins' registers catch it between them.
        if (drives) later = words[at];
        return caught;
    }
};
