// The timebase: a commit at exactly its clock, at once when late, once when asked once.
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

    for (unsigned n = 0; n < 6000000; n++) {
        c.commit_now = r.one_in(11), c.sample_now = r.one_in(7);
        if (r.one_in(40)) c.commit_timed = 0, c.commit_at = r.one_in(6) ? 0 : now + 2 + r.below(60) - (r.one_in(4) ? 80 : 0);
        else c.commit_timed = r.one_in(30);
        c.rst = r.one_in(5000);
        b.settle();
        CHECK(b, c.now == now, "now is %llu, expected %llu", (unsigned long long)c.now, (unsigned long long)now);
        CHECK(b, c.sample == c.sample_now, "sample is not immediate");
        CHECK(b, c.pending == pending, "pending %d, expected %d", c.pending, pending);
        const bool fires = pending && now >= due;
        CHECK(b, c.commit == (c.commit_now || fires), "commit %d at %llu, due %llu, pending %d", c.commit, (unsigned long long)now, (unsigned long long)due, pending);
        if (fires) timed++;
        if (c.rst) pending = false;
        else if (c.commit_timed) replaced += pending && !fires, pending = true, due = c.commit_at, late += due <= now;
        else if (fires) pending = false;
        if (pending) due = c.commit_at;  // the register is live, as documented: stable from the clock before
        b.edge();
        now++;
    }
    return b.pass("%llu timed commits, %llu of them late, %llu replaced", (unsigned long long)timed, (unsigned long long)late, (unsigned long long)replaced);
}
