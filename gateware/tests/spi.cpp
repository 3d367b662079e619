// The flash's wires under a CPU that writes at the wrong time, with a flash that answers as late as
// allowed.
#include "Vspi.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vspi> b("spi", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    c.select = c.start = c.data = c.length = 0, c.miso = 1;
    b.settle();

    bool cs_was = true, sck_was = false, mosi_was = false, busy_was = false;
    unsigned rested = 1, low = 100, high = 100, rises = 0, length = 0, transfers = 0, ignored = 0, answered = 0;
    uint64_t wanted = 0, got = 0, answer = 0, sent = 0;
    bool miso = true;

    for (uint64_t clock = 0; clock < 3000000; clock++) {
        // The CPU.
        const bool sensible = r.below(1 << 16) < 60000;
        c.start = !c.busy && c.select ? r.one_in(6) : r.one_in(sensible ? 4000 : 20);
        c.data = r.one_in(8) ? 0 : r.next();
        c.length = r.one_in(4) ? 8 : r.below(32);
        if (r.one_in(c.select ? (sensible ? 600 : 30) : 8)) c.select = !c.select;
        b.settle();
        if (c.start && (!c.select || c.busy)) ignored++;
        if (c.start && c.select && !c.busy) {
            CHECK(b, rises == length, "%u of %u bits, and a new transfer", rises, length);
            length = c.length ? c.length : 32, rises = 0, wanted = c.data, got = answer = 0, transfers++;
        }
        // The flash: for two clocks after the fall MISO is undefined.
        c.miso = low < 3 && !c.sck ? r.next() & 1 : miso;
        b.edge();

        CHECK(b, !(c.sck != sck_was && (c.cs_n || cs_was)), "SCK moves while CS is high");
        CHECK(b, !(c.cs_n && !cs_was && (busy_was || c.busy)), "CS rises in a transfer");
        if (!c.cs_n && cs_was) CHECK(b, rested >= 4, "CS was high for %u clocks", rested);
        rested = c.cs_n ? rested + 1 : 0;
        if (c.sck && !sck_was) {
            CHECK(b, c.mosi == mosi_was, "MOSI moves with the rise");
            CHECK(b, low >= 2 || rises == 0, "SCK was low for %u clocks", low);
            got = got << 1 | c.mosi, rises++;
            CHECK(b, rises <= length, "more than %u clocks", length);
            high = 0;
        } else if (c.sck) {
            CHECK(b, c.mosi == mosi_was, "MOSI moves while SCK is high");
        }
        if (!c.sck && sck_was) {
            CHECK(b, high >= 2, "SCK was high for %u clocks", high);
            answer = answer << 1 | miso, answered++;
        }
        // the bit for the next rise
        if (!c.sck && (sck_was || c.cs_n)) low = 0, miso = r.next() & 1;
        low += !c.sck, high += c.sck;
        if (busy_was && !c.busy) {
            CHECK(b, rises == length, "%u clocks, %u asked for", rises, length);
            CHECK(b, got == wanted >> (32 - length), "sent %llx of %llx", (unsigned long long)got, (unsigned long long)wanted);
            const uint32_t unsent = length == 32 ? 0 : uint32_t(wanted << length);
            CHECK(b, c.received == (unsent | uint32_t(answer)), "received %08x, the flash said %llx", c.received, (unsigned long long)answer);
            sent += length;
        }
        cs_was = c.cs_n, sck_was = c.sck, mosi_was = c.mosi, busy_was = c.busy;
    }
    CHECK(b, transfers > 5000 && ignored > 1000 && answered > 50000, "%u transfers, %u ignored", transfers, ignored);
    return b.pass("%u transfers, %llu bits, %u starts out of turn ignored", transfers, (unsigned long long)sent, ignored);
}
