// Segments and three stepgens, compared with a model that knows only path clocks: positions to the
// last bit in every clock, outputs, refusals and their reasons, underruns, pauses, gates. The model
// takes `advance` as given; a separate check ensures that it comes as often as it should, and never
// while a pulse waits.
#include <algorithm>
#include <array>
#include <deque>

#include "Vjobs.h"
#include "bench.h"

using B = Bench<Vjobs>;

enum { IDLE, SETTLE, PLAY, HALT };
enum { NONE, DONE, UNDERRUN, QUIT, HALTED, CLOSED };
enum { FULL = 1, INCOMPLETE = 2, SHORT = 4, NOT_NOW = 8, NO_START = 16 };

struct Segment {
    uint32_t clocks;
    uint16_t tag, aux;
    int32_t velocity[3];
    uint32_t accel[3];
};

// One stepgen in path time.
struct Axis {
    int64_t position = 1ll << 31, velocity = 0;
    int32_t target = 0;
    uint32_t accel = 0;
    bool learns = false;
    void clock(bool taken, int32_t to, uint32_t by) {
        position = int64_t(uint64_t(position) + uint64_t(velocity >> 24));
        if (!taken && !learns) {
            __int128 away = (__int128(target) << 24) - velocity, most = accel;
            if (accel && away > most) away = most;
            if (accel && away < -most) away = -most;
            velocity += int64_t(away);
        }
        learns = taken;
        if (taken) target = to, accel = by;
    }
};

struct Checker {
    B &b;
    std::deque<Segment> fifo;
    std::array<Axis, 3> axes;
    Segment now{};
    uint64_t left = 0;      // path clocks left of the current segment
    bool first = true, ghost = false, pulsed[3] = {};
    uint16_t aux = 0;
    int64_t counted[3] = {};
    uint64_t edges = 0, commits = 0, underruns = 0, pauses = 0, held = 0, refusals = 0, since_play = 0, ends = 0;
    uint32_t refused = 0;
    uint64_t halting = 0, since_push = 0;
    int64_t scale = 1ll << 32;  // path clocks per clock, 2^32 times
    uint32_t phase = 0;
    bool tick = true, turned = false;
    int ended = NONE;
    bool pending = false, fast = false;
    Segment arriving{};

    explicit Checker(B &b) : b(b) {}

    int64_t position(unsigned n) { return int64_t(n == 0 ? b.core->position0 : n == 1 ? b.core->position1 : b.core->position2); }
    int32_t velocity(unsigned n) { return int32_t(b.core->velocities[n]); }

    void clock() {
        auto &c = *b.core;
        b.settle();
        const unsigned state = c.state;
        const bool plays = state == PLAY, breaks = !c.gate || c.halt || c.quit;
        CHECK(b, c.pace_now == scale >> 16, "a pace of %u, not %lld", c.pace_now, (long long)scale >> 16);
        CHECK(b, c.advance == (state < PLAY || (tick && !c.waits)), "time %s in state %u, tick %d, waits %d", c.advance ? "passes" : "stands", state, tick, c.waits);
        const bool dead = c.reason > DONE || !c.gate;
        since_push++;
        CHECK(b, c.stop == (state & 1), "stop is %d in state %u", c.stop, state);
        if (plays) {
            since_play++;
            CHECK(b, ghost, "plays unasked");
            // The last path clock of a segment is also the next one's commit; without a next one it
            // is the last clock of all.
            const bool last = c.advance && (first ? bool(c.commit) : left == 1);
            CHECK(b, c.commit == (last && !breaks && c.commit), "a commit %llu path clocks before its time", (unsigned long long)left);
            if (c.commit) {
                CHECK(b, !fifo.empty(), "a commit of nothing");
                CHECK(b, since_play > 2 * 3 + 2, "a commit before the words can have been read");
            }
            for (auto &a : axes) {
                const unsigned n = unsigned(&a - &axes[0]);
                if (c.advance) a.clock(c.commit, c.commit ? fifo.front().velocity[n] : 0, c.commit ? fifo.front().accel[n] : 0);
            }
            if (c.advance && !first) left--;
            if (last && !first && !c.commit && !breaks) {
                CHECK(b, fifo.empty() || since_push < 12, "stops with %zu segments to come", fifo.size());
                bool moving = false;
                for (auto v : now.velocity) moving |= v != 0;
                ended = moving ? UNDERRUN : DONE;
                underruns += moving, ends++;
            }
            if (breaks) ended = !c.gate ? CLOSED : c.halt ? HALTED : QUIT;
            if (c.commit) {
                now = fifo.front(), fifo.pop_front();
                left = now.clocks, first = false, aux = now.aux, commits++;
            }
        }
        if (state == SETTLE && breaks) ended = !c.gate ? CLOSED : c.halt ? HALTED : QUIT;
        if (!c.gate) fifo.clear();
        pauses += plays && c.stands;
        held += plays && c.held;
        const int64_t before[3] = {position(0), position(1), position(2)};
        const bool stood = !c.advance;
        const uint32_t commits_were = c.begun;
        const bool commit = c.commit;
        halting = state == HALT ? halting + 1 : 0;
        if (state == HALT && !c.gate && ended == DONE) ended = CLOSED;
        const int64_t wanted = int64_t(std::min<uint32_t>(c.pace, 65536)) << 16;
        if (state < PLAY) scale = wanted;
        else if (state == PLAY && !turned) scale = !c.slew ? wanted : scale + std::clamp<int64_t>(wanted - scale, -int64_t(c.slew), c.slew);
        turned = c.pace_we;
        phase += c.pace_now, tick = phase >> 16, phase &= 0xffff;
        if (state == IDLE && dead) aux = 0;

        b.edge();

        if (pending) fifo.push_back(arriving), pending = false, since_push = 0;
        CHECK(b, c.begun - commits_were == commit, "begun %u more", c.begun - commits_were);
        for (unsigned n = 0; n < 3; n++) {
            if (stood) CHECK(b, position(n) == before[n], "axis %u moves while time stands", n);
            if (plays && (c.state == PLAY || ended == DONE || ended == UNDERRUN))
                CHECK(b, position(n) == axes[n].position, "axis %u is at %016llx, the path at %016llx", n, (long long)position(n), (long long)axes[n].position);
            const bool pulse = c.step >> n & 1;
            if (pulse && !pulsed[n]) counted[n] += c.dir >> n & 1 ? -1 : 1, edges++;
            pulsed[n] = pulse;
            CHECK(b, int32_t(counted[n]) == int32_t(position(n) >> 32), "axis %u: pins had %lld pulses, the position says %d", n, (long long)counted[n], int32_t(position(n) >> 32));
        }
        if (c.state == PLAY && !plays) {
            for (unsigned n = 0; n < 3; n++) {
                CHECK(b, velocity(n) == 0, "begins at a velocity of %d", velocity(n));
                axes[n] = Axis(), axes[n].position = position(n);
            }
            first = true, since_play = 0;
        }
        if (plays) CHECK(b, (c.state == HALT) == (ended != NONE), "state %u, reason %u; the ghost says %d", c.state, c.reason, ended);
        if (c.state == HALT || (c.state == IDLE && state != IDLE)) {
            CHECK(b, c.reason == ended, "reason %u, not %d", c.reason, ended);
            if (ended != DONE) fifo.clear();
            CHECK(b, halting < 400000, "never comes to rest");
        }
        if (state == HALT && c.state == IDLE) {
            ghost = false;
            for (unsigned n = 0; n < 3; n++) CHECK(b, velocity(n) == 0, "at the end axis %u has a velocity of %d", n, velocity(n));
        }
        const uint16_t shown = aux & ~(c.state != PLAY || c.stands ? c.beam : 0);
        CHECK(b, c.aux == shown, "outputs %04x, not %04x", c.aux, shown);
        CHECK(b, c.level == fifo.size() || !c.gate || c.reason > DONE, "level %u, not %zu", c.level, fifo.size());
        CHECK(b, c.refused == refused, "refused %x, not %x", c.refused, refused);
    }

    void clocks(uint64_t n) {
        while (n--) clock();
    }

    void pulse(uint8_t &line) {
        line = 1;
        clock();
        line = 0;
    }

    void write(unsigned at, uint32_t word) {
        auto &c = *b.core;
        c.word_we = 1, c.word_at = at, c.word = word;
        clock();
        c.word_we = 0;
    }

    void word(const Segment &s, unsigned at) {
        write(at, at == 0 ? s.clocks : at == 1 ? uint32_t(s.tag) << 16 | s.aux : at & 1 ? s.accel[(at - 2) / 2] : uint32_t(s.velocity[(at - 2) / 2]));
    }

    // `missing` (8: none) is the word that is not written.
    void push(const Segment &s, unsigned missing = 8) {
        auto &c = *b.core;
        const unsigned from = unsigned(b.random.below(8));
        bool room = true;
        for (unsigned i = 0; i < 8; i++)
            if (const unsigned at = (from + i) & 7; at != missing) {
                room &= c.level < 64;
                word(s, at);
                if (b.random.one_in(5)) clock();
            }
        b.settle();
        const bool dead = !c.gate || c.reason > DONE;
        const unsigned why = c.level == 64 ? FULL : dead ? NOT_NOW : missing < 8 || !room ? INCOMPLETE : s.clocks < 64 ? SHORT : 0;
        refused |= why, refusals += why != 0;
        pending = !why, arriving = s;
        pulse(c.push);
    }

    void start() {
        auto &c = *b.core;
        b.settle();
        const bool can = c.state == IDLE && c.gate && !c.halt && c.reason <= DONE && c.level;
        if (!can) refused |= NO_START;
        else ghost = true, ended = NONE;
        pulse(c.start);
    }

    void clear() {
        refused = 0;
        if (b.core->state == IDLE) fifo.clear();
        pulse(b.core->clear);
    }
};

static Segment any_segment(Random &r, const Segment &before, bool last, bool fast) {
    Segment s{};
    s.clocks = r.one_in(8) ? 64 : 64 + uint32_t(r.up_to_bits(11));
    s.tag = uint16_t(r.next()), s.aux = uint16_t(r.next());
    // one axis alone, at the lowest velocity there is
    const unsigned creeps = r.one_in(20) ? unsigned(r.below(3)) : 3;
    for (unsigned n = 0; n < 3; n++) {
        const int32_t top = fast ? 0x0fffffff : 0x007fffff;
        int32_t v = last || r.one_in(6) ? 0 : r.one_in(4) ? before.velocity[n] : int32_t(r.below(2 * uint64_t(top))) - top;
        if (r.one_in(20)) v = r.one_in(2) ? 1 : -1;
        if (creeps < 3) v = n == creeps;
        if (last) v = 0;
        s.velocity[n] = v;
        const uint64_t away = uint64_t(std::llabs(int64_t(v) - before.velocity[n]));
        // Segments that usually come in time, sometimes at once, sometimes never.
        s.accel[n] = r.one_in(10) ? 0 : r.one_in(10) ? uint32_t(r.up_to_bits(32)) : uint32_t(std::min<uint64_t>(0xffffffff, ((away << 24) + s.clocks - 3) / (s.clocks - 2)));
    }
    return s;
}

static void a_job(Checker &k) {
    Random &r = k.b.random;
    auto &c = *k.b.core;
    if (c.reason > DONE || r.one_in(3)) k.clear();
    c.steplen = r.one_in(2) ? 1 : 1 + r.below(r.one_in(4) ? 60 : 12), c.dirsetup = r.one_in(2) ? 1 : r.below(60);
    k.fast = r.one_in(3);
    c.stop_accel = k.fast || r.one_in(6) ? 0 : 1u << 30 | uint32_t(r.up_to_bits(32));
    c.slew = r.one_in(4) ? 0 : uint32_t(r.up_to_bits(30)) | 1 << 18;
    c.beam = uint16_t(r.next());
    if (r.one_in(4)) {  // the host left it moving
        c.bus_velocity = uint32_t(r.below(1 << 24)), c.bus_commit = 1;
        k.clocks(2);
        c.bus_commit = 0;
        k.clocks(r.below(300));
    }
    const unsigned all = 1 + unsigned(r.below(120)), ahead = 1 + unsigned(r.below(66));
    const bool starves = r.one_in(3);
    Segment before{};
    unsigned pushed = 0;
    if (r.one_in(10)) k.start();
    const auto next = [&] {
        const Segment s = any_segment(r, before, pushed + 1 == all, k.fast);
        if (r.one_in(30)) k.push(s, unsigned(r.below(8)));
        if (r.one_in(30)) {
            Segment bad = s;
            bad.clocks = uint32_t(r.below(64));
            k.push(bad);
        }
        k.push(s);
        before = s, pushed++;
    };
    while (pushed < all && pushed < ahead && k.fifo.size() < 64) next();
    if (r.one_in(20)) k.push(before, unsigned(r.below(9)));
    if (r.one_in(5)) c.gate = 0, k.clocks(3), c.gate = 1, k.clocks(1);
    k.start();
    unsigned patience = 0;
    while (k.ghost) {
        const bool full = c.level == 64;
        if (pushed < all && (!full || r.one_in(50)) && !(starves && !r.one_in(12))) {
            if (full) k.push(before);
            else next();
        }
        if (r.one_in(30)) {
            c.pace_we = 1;
            k.clock();
            c.pace_we = 0;
            c.pace = r.one_in(3) ? 0 : r.one_in(3) ? 65536 : uint32_t(r.below(70000));
            patience = 0;
        }
        if (++patience > 60 && c.pace < 4000) {
            c.pace_we = 1;
            k.clock();
            c.pace_we = 0, c.pace = 65536;
        }
        k.clocks(r.below(400));
        if (r.one_in(150)) k.pulse(c.quit);
        if (r.one_in(200)) {  // a stop in the very clock that would begin the next segment
            for (unsigned n = 0; n < 3000 && c.state == PLAY && (k.first || k.left != 1); n++) k.clock();
            uint8_t &line = r.one_in(3) ? c.quit : c.halt;
            line = !r.one_in(3), c.gate = line;
            k.clock();
            line = 0, c.gate = 1;
        }
        if (r.one_in(300)) {
            c.halt = 1;
            k.clocks(r.below(500));
            if (r.one_in(2)) c.gate = 0, k.clock();
            c.halt = 0;
            k.clock();
            c.gate = 1;
        }
        if (r.one_in(300)) c.gate = 0, k.clocks(1 + r.below(3)), c.gate = 1;
        if (r.one_in(40)) k.clear();
    }
    k.clocks(r.below(20));
    c.pace_we = 1;
    k.clock();
    c.pace_we = 0, c.pace = 65536;
    k.clock();
}

int main(int argc, char **argv) {
    B b("jobs", argc, argv);
    Checker k(b);
    auto &c = *b.core;
    c.gate = 1, c.pace = 65536, c.steplen = 1, c.dirsetup = 1;
    k.clocks(4);
    const uint64_t wanted = argc > 2 ? strtoull(argv[2], nullptr, 0) : 10'000'000;
    while (b.clocks < wanted) a_job(k);
    CHECK(b, k.underruns > 20 && k.held && k.pauses && k.refusals > 100 && k.commits > 1000 && k.ends > 50, "too little happened");
    return b.pass("%llu segments, %llu pulses at the pins, each where the path has it; %llu underruns, %llu clocks paused, %llu pushes refused",
                  (unsigned long long)k.commits, (unsigned long long)k.edges, (unsigned long long)k.underruns, (unsigned long long)k.pauses,
                  (unsigned long long)k.refusals);
}
