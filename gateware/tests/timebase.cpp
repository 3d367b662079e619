// The timebase: a commit at exactly its clock, at once when late, once per request, never when
// replaced.
#include "Vtimebase.h"
#include "bench.h"

int main(int argc, char **argv) {
    Bench<Vtimebase> b("timebase", argc, argv);
    Random &r = b.random;
    auto &c = *b.core;
    c.rst = c.commit_now = c.sample_now = c.commit_timed = 0, c.commit_at = 0;
    b.settle();
    uint64_t now = c.now, timed = 0, late = 0, replaced = 0;
    bool pending = false;
    uint64_t due = 0;

    auto edge = [&] { b.edge(), now++, b.settle(); };
    auto ask = [&](uint64_t at) {
        c.commit_timed = 0, c.commit_at = at;
        edge();
        c.commit_timed = 1;
        edge();
        c.commit_timed = 0;
        b.settle();
    };
    while (now < 2000) edge();
    // One request at a time: how many clocks after the strobe the commit comes, and that it comes
    // once.
    for (int64_t offset : {-1000ll, -2ll, -1ll, 0ll, 1ll, 2ll, 3ll, 40ll, 1000ll}) {
        // the first clock in which it can happen
        const uint64_t first = now + 2, at = first + offset;
        unsigned fired = 0;
        ask(at);
        for (unsigned i = 0; i < 1100; i++, edge()) {
            if (!c.commit) continue;
            CHECK(b, now == (offset < 0 ? first : at), "asked for %lld, fires at %lld", (long long)offset, (long long)(now - first));
            fired++;
        }
        CHECK(b, fired == 1, "asked for %lld, fires %u times", (long long)offset, fired);
    }
    // The ends of the numbers: 2^64 - 1 does not come, bits above bit 31 count, 0 and 1 are past.
    for (uint64_t at : {~0ull, 1ull << 63, 1ull << 32}) {
        ask(at);
        for (unsigned i = 0; i < 1000; i++, edge()) CHECK(b, !c.commit && c.pending, "%llx is past", (unsigned long long)at);
    }
    for (uint64_t at : {0ull, 1ull}) {  // and the request before, which never came, is replaced
        ask(at);
        CHECK(b, c.commit, "%llx is not past", (unsigned long long)at);
        edge();
        CHECK(b, !c.commit && !c.pending, "fires twice");
    }
    // Replaced in the clock it was due: the new one counts, and neither commits twice.
    ask(now + 12);
    for (; now != c.commit_at; edge()) CHECK(b, !c.commit, "early");
    c.commit_timed = 1;
    b.settle();
    CHECK(b, !c.commit, "a replaced commit fires");
    edge();
    c.commit_timed = 0;
    b.settle();
    CHECK(b, c.commit, "its replacement does not");
    edge();
    CHECK(b, !c.commit && !c.pending, "and fires again");

    for (unsigned n = 0; n < 6000000; n++) {
        c.commit_now = r.one_in(11), c.sample_now = r.one_in(7);
        if (r.one_in(40)) c.commit_timed = 0, c.commit_at = r.one_in(6) ? (r.one_in(2) ? ~0ull : 0) : now + 2 + r.below(60) - (r.one_in(4) ? 80 : 0);
        else c.commit_timed = r.one_in(30);
        c.rst = r.one_in(5000);
        b.settle();
        CHECK(b, c.now == now, "now is %llu, expected %llu", (unsigned long long)c.now, (unsigned long long)now);
        CHECK(b, c.sample == c.sample_now, "sample is not immediate");
        CHECK(b, c.pending == pending, "pending %d, expected %d", c.pending, pending);
        const bool fires = pending && now >= due && !c.commit_timed;
        CHECK(b, c.commit == (c.commit_now || fires), "commit %d at %llu, due %llu, pending %d", c.commit, (unsigned long long)now, (unsigned long long)due, pending);
        if (fires) timed++;
        if (c.rst) pending = false;
        else if (c.commit_timed) replaced += pending && !fires, pending = true, due = c.commit_at, late += due <= now;
        else if (fires) pending = false;
        // the register is live, as documented: stable from the clock before
        if (pending) due = c.commit_at;
        b.edge();
        now++;
    }
    return b.pass("%llu timed commits, %llu of them late, %llu replaced", (unsigned long long)timed, (unsigned long long)late, (unsigned long long)replaced);
}
