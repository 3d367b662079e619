// The fast path on a whole board (fast_path_board.h): each answer's words are compared with the
// registers, each staged word with the frame. Behind everything that must not be executed the good
// frame comes, which must be, exactly once.
//   gateware/tests/run.sh fast_path [SEED [FRAMES]]    FRAMES: random frames for each board
#include "fast_path_board.h"

// Other boards than the first have one of so many of what takes long, and every fourth clock or
// byte of a sweep.
static const unsigned WHOLE = 1000 / SHARE, FRAMES = 3000 / SHARE, STEP = SHARE > 1 ? 4 : 1;
// Clocks from the last byte of a command to the first of its answer, which is its preamble, as seen
// at the pins, for any number of channels: the shortest, the median and no more than the longest.
static const unsigned SHORTEST = 16, MEDIAN = 16, LONGEST = 17;

struct Outcome {
    unsigned done = 0, left = 0;
    void count(bool executed) { executed ? done++ : left++; }
};

struct Tests : Board {
    uint64_t frames;
    Tests(uint64_t seed, uint64_t frames) : Board(seed), frames(frames) {}

    // What happens in the clocks around a frame's end has both outcomes, or it was elsewhere.
    void both(const char *what, const Outcome &o) { CHECK(*this, o.done && o.left, "%s: executed %u, left %u: not around the end", what, o.done, o.left); }

    // ---- executed -------------------------------------------------------------------------------
    // Returns the clocks of each, in their order.
    std::vector<unsigned> turnaround(unsigned count) {
        std::vector<unsigned> took;
        for (unsigned n = 0; n < count; n++) {
            Frame f(next());
            run(random.below(40));
            f.id = random.next() & 0xffff, f.no_sum = random.one_in(5), f.fragment = random.one_in(2) ? 0x4000 : 0;
            took.push_back(exchange(f));
            next_eth += random.below(3) * 1000 + 1;  // another phase
        }
        std::sort(took.begin(), took.end());
        const unsigned shortest = took.front(), median = took[count / 2], longest = took.back();
        CHECK(*this, shortest == SHORTEST && median == MEDIAN && longest <= LONGEST, "the turnaround is %u/%u/%u clocks", shortest, median, longest);
        return took;
    }
    // A byte takes 10 and 100 times as long: the words come and leave one by one.
    unsigned slow_links() {
        unsigned longest = 0;
        for (unsigned slower : {10, 100}) {
            byte = slower * ETH;
            for (unsigned n = 0; n < 12 / STEP; n++) longest = std::max(longest, exchange());
            const Words good = next();
            Bytes f = frame(good);
            f[50] ^= 1 << random.below(8);
            left_alone("turned over on a slow link", f, false);
            exchange(Frame(good));
        }
        byte = ETH;
        quiet();
        return longest;
    }
    // A look is sampled and answered, not committed.
    void looks() {
        const Words words = any(++sequence, 0);
        hand_out(sequence, 0, ARMED, false), forget(), send(frame(words)), quiet();
        CHECK(*this, taken == 1 && !commits, "a look: executed %u times, committed %u times", taken, commits);
        check_answer(sequence, words);
    }
    // A timed command is committed at its time; nothing is staged while it waits.
    void waits_for_its_time() {
        write("timebase.snapshot", 1);
        const uint64_t at = (read("timebase.now_lo") | (uint64_t)read("timebase.now_hi") << 32) + 4000;
        const Words words = any(++sequence, 7, at);
        hand_out(sequence, 7, ARMED, true, true), forget(), send(frame(words)), quiet();
        CHECK(*this, taken == 1 && !commits && read("timebase.status") == 1, "a timed command: executed %u times, committed %u times", taken, commits);
        hand_out(++sequence, 7, ARMED, true, true);
        left_alone("while a commit waits", frame(any(sequence, 7)), true);
        check_staged(words);
        forget(), run(4000);
        CHECK(*this, commits == 1, "a timed command: committed %u times at its time", commits);
        revoke();
    }

    // ---- not executed, and the good frame behind it is ------------------------------------------
    // Each kind with a ticket for guests, and without one.
    unsigned never_executed() {
        const Words good = next();
        const Kinds kinds(good);
        for (const Wrong &wrong : kinds.all) {
            admit();
            left_alone(wrong.what, wrong.frame, !wrong.gone);
            left_alone(wrong.what + ", no ticket", wrong.frame, !wrong.gone && is_the_owners(wrong.frame, frame(good)));
            exchange(Frame(good));
            hand_out(sequence);
        }
        revoke();
        return kinds.all.size();
    }
    void only_with_this_pass() {
        const Words good = next();
        hand_out(sequence, 3, ARMED ^ 1);
        left_alone("another gate", frame(good), true);
        revoke();
        left_alone("no pass", frame(good), true);
        hand_out(sequence);
        exchange(Frame(good));
        left_alone("the pass is used up", frame(good), true);
        left_alone("and remains so", frame(good), true);
    }
    // These frames one behind the other: the first good one is executed, and nothing else.
    void burst(const std::string &what, const Words &good, const std::vector<Bytes> &all, unsigned gap) {
        const Bytes g = frame(good);
        bool executed = false, ticket = true;
        unsigned lie = 0;
        hand_out(sequence), admit(), forget();
        for (const Bytes &f : all) {
            send(f, gap);
            if (with_fcs(without_fcs(f)) != f) continue;
            if (f == g && !executed) executed = true;
            else if (is_the_owners(f, g)) lie++;
            else lie += ticket, ticket = false;
        }
        quiet();
        if (executed) check_executed(what, good);
        else CHECK(*this, !taken && !commits && answers.empty(), "%s: executed", what.c_str());
        CHECK(*this, executed || read("fast_path.status") == OUT, "%s: the pass is gone", what.c_str());
        check_slots(what, lie);
    }
    unsigned back_to_back(unsigned random_bursts) {
        unsigned count = 0;
        const Words good = next();
        const Bytes g = frame(good);
        const Kinds kinds(good);
        auto any_gap = [&] { return random.one_in(2) ? GAP : LEAST_GAP; };
        for (const Wrong &wrong : kinds.all) {
            const Bytes &bad = wrong.frame;
            for (unsigned gap : {GAP, LEAST_GAP}) {
                if (STEP > 1 && random.one_in(2)) continue;
                burst(wrong.what + ", then the good one", good, {bad, g}, gap);
                burst("the good one, then " + wrong.what, good, {g, bad}, gap);
                count += 2;
            }
        }
        for (unsigned n = 0; n < random_bursts; n++, count++) {
            std::vector<Bytes> all;
            std::string what = "at random";
            for (size_t k = 2 + random.below(RX_SLOTS - 1); k; k--) {
                const Wrong &wrong = kinds.all[random.below(kinds.all.size())];
                const bool is_good = random.one_in(3);
                all.push_back(is_good ? g : wrong.frame), what += ", " + (is_good ? "good" : wrong.what);
            }
            burst(what, good, all, any_gap());
        }
        for (unsigned gap : {GAP, LEAST_GAP})
            for (size_t times : {2, 3, 4}) burst("the good one, repeated", good, std::vector<Bytes>(times, g), gap);
        revoke();
        return count;
    }
    // Each bit turned over, with a right FCS. With a checksum none is executed; without one those
    // are that firmware's words leave open, such as a velocity.
    unsigned each_bit(unsigned &open) {
        unsigned bits = 0;
        for (bool no_sum : {false, true}) {
            Frame good({});
            auto renew = [&] { good = Frame(next()), good.no_sum = no_sum; };
            renew();
            Bytes g = good.bytes();
            for (unsigned bit = 0; bit < 8 * (g.size() - 4); bit++, bits++) {
                Bytes f = without_fcs(g);
                f[bit / 8] ^= 1 << bit % 8;
                f = with_fcs(f);
                const bool like = is_like(f, g);
                CHECK(*this, no_sum || !like, "bit %u is like the pass", bit);
                feed(), admit();
                executed_if(like, f, "bit", bit);
                if (like) open++, renew(), g = good.bytes();
            }
            for (unsigned bit = 0; bit < 32; bit++, bits++) {
                Bytes f = g;
                f[f.size() - 4 + bit / 8] ^= 1 << bit % 8;
                left_alone("a bit of the FCS turned over", f, false);
            }
            exchange(good);
        }
        return bits;
    }
    void executed_if(bool like, const Bytes &f, const char *what, uint64_t n) {
        forget(), send(f), quiet();
        CHECK(*this, taken == like && commits == like && answers.size() == like, "%s %llu: executed %u times, answered %zu times, expected %d", what,
              (unsigned long long)n, taken, answers.size(), like);
        release();
    }
    Bytes anything_like(Bytes f) {
        f = without_fcs(f);
        auto any_pair = [&] { return 14 + 2 * random.below((f.size() - 14) / 2); };
        switch (random.below(6)) {
        case 0:  // anything
            f.resize(random.below(random.one_in(4) ? 400 : 80));
            for (auto &b : f) b = random.next();
            break;
        case 1:  // anything behind a good beginning
            for (size_t at = random.below(f.size()); at < f.size(); at++) f[at] = random.next();
            break;
        case 2:  // of another length
            f.resize(random.one_in(2) ? random.below(f.size() + 40) : f.size() - 4 + random.below(9));
            break;
        case 3: {  // two halves changed so that the checksums do not notice
            const size_t a = any_pair(), b = any_pair();
            std::swap(f[a], f[b]), std::swap(f[a + 1], f[b + 1]);
            break;
        }
        case 4:  // nothing, or what may differ
            if (random.one_in(2)) f[40] = f[41] = 0;
            if (random.one_in(2)) f[46] = random.next(), f[40] = f[41] = 0;
            break;
        default:  // some bits
            for (unsigned k = 1 + random.below(3); k; k--) f[random.below(f.size())] ^= 1 << random.below(8);
        }
        f = with_fcs(f);
        if (random.one_in(20)) f[random.below(f.size())] ^= 1 << random.below(8);
        return f;
    }
    unsigned random_frames() {
        unsigned executed = 0;
        Bytes good = frame(next());
        for (uint64_t n = 0; n < frames; n++) {
            const Bytes f = anything_like(good);
            const bool like = is_like(f, good);
            executed_if(like, f, "random frame", n);
            if (random.one_in(8)) admit(), feed();
            if (like) executed++, good = frame(next());
        }
        revoke();
        return executed;
    }

    // ---- slots and queues -----------------------------------------------------------------------
    // All receive slots are full: a command needs none, and every other frame is counted as lost.
    void no_slot_free() {
        uint32_t dropped = read("ethmac.sram_writer_errors");
        write("rx_admission.mode", 0);
        for (unsigned n = 0; n < RX_SLOTS; n++) send(with_fcs(Bytes(60, n))), quiet();
        write("rx_admission.mode", 3);
        const Words good = next();
        const Kinds kinds(good);
        auto lost = [&] { return read("ethmac.sram_writer_errors") - dropped; };
        for (const Wrong &wrong : kinds.all) {
            const bool before = random.one_in(2);
            forget();
            if (before) send(wrong.frame);
            send(frame(good));
            if (!before) send(wrong.frame);
            quiet();
            check_executed("no slot free, " + wrong.what, good);
            CHECK(*this, lost() == 1, "no slot free, %s: %u counted as lost", wrong.what.c_str(), lost());
            dropped++;
            hand_out(sequence);
        }
        revoke();
        check_slots("all were full", RX_SLOTS);
        exchange();
    }
    void choose(uint32_t slot, unsigned length) { write("ethmac.sram_reader_slot", slot), write("ethmac.sram_reader_length", length); }
    void start() { write("ethmac.sram_reader_start", 1); }
    // The CPU sends a frame of its own, from the other slot, and from the answer's.
    void cpu_sends() {
        for (uint32_t slot : {1, 0}) {
            const Words words = next();
            forget();
            for (unsigned n = 0; n < 16; n++) access(OTHER_TX_SLOT + 4 * n, true, n);
            choose(slot, 1000);
            send(frame(words));
            while (to_send() > 30) step();
            start();
            if (!slot) CHECK(*this, read("fast_path.status") & SENDING, "slot 0 is being sent, and no register says so");
            quiet(), run(1000), quiet();
            CHECK(*this, taken == slot && answers.size() == 1 + slot, "with slot %u being sent: executed %u times, %zu frames", slot, taken, answers.size());
            if (slot) CHECK(*this, answers[0].size() == 1010 && answers[1].size() == 8 + answer_bytes() + 4, "answers of %zu and %zu bytes", answers[0].size(), answers[1].size());
            else check_slots("sent from the answer's slot", 1);
        }
        revoke();
        open();
    }
    // So many frames of the CPU's are queued in every clock around the frame's end. The queue holds
    // two: with one an answer always leaves, behind two it may have to go the long way.
    Outcome cpu_queues(unsigned queued) {
        Outcome o;
        for (unsigned k = 0; k < 80; k++) {
            const Words words = next();
            forget(), choose(1, 62), send(frame(words));
            while (to_send() > GAP + 90) step();
            run(k);
            for (unsigned n = 0; n < queued; n++) start();
            quiet(), run(100), quiet();
            // The second is lost if the answer came before it: the queue was full.
            const bool lost = taken && queued == TX_QUEUE && answers.size() == queued;
            CHECK(*this, taken <= 1 && (lost || answers.size() == queued + taken), "executed %u times, %u sent, %zu came", taken, queued, answers.size());
            unsigned ours = 0;
            for (const Bytes &f : answers)
                if (f.size() == 8 + answer_bytes() + 4) ours++, check_answer(sequence, words, f);
                else CHECK(*this, f.size() == 8 + 60 + 4, "a frame of %zu bytes", f.size());
            CHECK(*this, ours == taken, "executed %u times, %u answers", taken, ours);
            check_slots("behind the CPU's frames", !taken);
            o.count(taken);
            revoke();
        }
        return o;
    }
    void until_taken() {
        for (unsigned k = 0; k < 4000 && !taken; k++) step();
        CHECK(*this, taken, "the command was not executed");
    }
    // The next pass comes soon behind a command that is repeated: executed a second time or not,
    // and never while the answer is written or sent.
    Outcome passes_at_once(unsigned rounds) {
        Outcome o;
        for (unsigned n = 0; n < rounds; n++) {
            const Words words = next();
            forget(), send(frame(words), GAP + random.below(300)), send(frame(words));
            until_taken();
            run(random.below(60)), pass();
            quiet();
            CHECK(*this, taken <= 2 && commits == taken && answers.size() == taken, "executed %u times, %zu answers", taken, answers.size());
            for (const Bytes &f : answers) CHECK(*this, f.size() == 8 + answer_bytes() + 4 && with_fcs(Bytes(f.begin() + 8, f.end() - 4)) == Bytes(f.begin() + 8, f.end()), "a broken answer");
            check_answer(sequence, words, answers.back());
            check_slots("repeated, with a second pass", 2 - taken);
            o.count(taken == 2);
            revoke();
        }
        return o;
    }

    // ---- around the frame's end -----------------------------------------------------------------
    // The frame has so many bytes to come; `act` comes so many edges later.
    void around_one_end(uint64_t bytes, unsigned edges, Outcome &o, const std::function<void()> &act, const std::function<void(bool)> &check) {
        arm();
        const Words words = next();
        forget(), send(frame(words));
        while (to_send() > bytes) step();
        for (unsigned k = edges; k; k--) step();
        act();
        quiet();
        const bool executed = taken;
        CHECK(*this, answers.size() == executed, "executed %d, %zu answers", executed, answers.size());
        check_slots("around the frame's end", !executed);
        check(executed);
        o.count(executed);
        revoke();
    }
    // At every edge around the frame's end the CPU closes the gate, softly or at once, the external
    // reset does, an emergency stop does: executed in time or not at all, and no commit behind a
    // closed gate.
    Outcome gate_closes() {
        const uint32_t stops = read("gpio.estop_mask");
        const std::function<void()> closes[] = {
            [&] { write("watchdog.control", STOP); },
            [&] { write("watchdog.control", SOFT); },
            [&] { pins->ext_reset = 1, run(3), pins->ext_reset = 0; },
            [&] { stopped = stops, run(30), stopped = 0; },
        };
        Outcome all;
        watches_gate = true;
        write("watchdog.grace", 20);
        for (const auto &act : closes) {
            if (&act == &closes[3] && !stops) continue;
            Outcome o;
            for (unsigned edges = random.below(STEP); edges < 120; edges += STEP) {
                around_one_end(22, edges, o, act, [](bool) {});
                closed_for_all();
            }
            both("the gate closes", o);
            all.done += o.done, all.left += o.left;
        }
        watches_gate = false;
        write("watchdog.grace", GRACE);
        arm();
        return all;
    }
    // A pass for the open gate does not pass a closed one.
    void closed_for_all() {
        const Words words = next();
        left_alone("the gate is closed", frame(words), true);
        run(30);
        revoke();
    }
    // The watchdog bites in every clock around the frame's end: executed and fed, or bitten.
    Outcome bites() {
        const unsigned timeout = 900;
        Outcome o;
        write("watchdog.timeout", timeout), write("watchdog.grace", 20);
        for (unsigned k = 0; k < 60; k++) {
            arm();
            const Words words = next();
            const Bytes f = frame(words);
            forget(), feed(), run(timeout - (f.size() + 8) * ETH / SYS - 45 + k), send(f), quiet();
            const bool bitten = read("watchdog.status") & BITTEN;
            // The last chance is the clock in which it bites.
            CHECK(*this, taken == !bitten || (taken && gate_when_taken & BITTEN), "executed %u times, bitten %d", taken, bitten);
            CHECK(*this, commits == taken && answers.size() == taken, "executed %u times, committed %u times", taken, commits);
            if (taken) check_answer(sequence, words);
            check_slots("a bite", !taken);
            o.count(taken);
            if (bitten) closed_for_all();
            revoke(), run(timeout + 50);
        }
        both("bites", o);
        write("watchdog.timeout", TIMEOUT), write("watchdog.grace", GRACE);
        arm();
        return o;
    }
    Outcome revoked() {
        bool said = false;
        Outcome o;
        for (unsigned n = 0; n < 300; n++)
            around_one_end(12 + random.below(6), random.below(50), o, [&] { revoke(), said = read("fast_path.status") & EXECUTED; },
                           [&](bool executed) { CHECK(*this, executed == said, "executed behind a revocation that said %d", said); });
        both("revoked", o);
        return o;
    }
    // Anywhere in the frame: nothing is staged behind it, and the CPU's word stays.
    void revoked_anywhere() {
        for (unsigned n = 0; n < 200; n++) {
            const Words words = next();
            forget(), send(frame(words));
            for (unsigned k = random.below(260); k; k--) step();
            revoke();
            const uint32_t status = read("fast_path.status") & ~SENDING;
            const char *staged = stepgens ? "command.stepgen0_velocity" : "command.pwm0_width";
            for (unsigned k = 0; k < 3; k++) write(staged, 0x1000 + n, k);
            quiet();
            for (unsigned k = 0; k < 3; k++)
                CHECK(*this, read(staged, k) == 0x1000 + n, "staged behind a revocation");
            CHECK(*this, taken == (status & EXECUTED) && read("fast_path.status") == status, "status %x behind a revocation, then %x", status, read("fast_path.status"));
            release();
        }
    }
    // A pass handed out, or taken back and handed out again, in mid-frame is for the next one.
    void handed_out_too_late() {
        for (unsigned n = 0; n < 200; n++) {
            revoke();
            const Words words = next();
            if (n & 1) revoke();
            forget(), send(frame(words));
            const size_t begun = to_send() - 40;
            while (to_send() > 13 + random.below(begun)) step();
            if (~n & 1) revoke();
            pass();
            const bool late = to_send() < 2 || pending();  // it came behind the frame
            quiet();
            CHECK(*this, !taken, "a pass for the frame that was already coming");
            CHECK(*this, late || pending(), "in no slot");
            release();
            exchange(Frame(words));
        }
    }

    // ---- the CPU --------------------------------------------------------------------------------
    void busy_cpu() {
        for (unsigned n = 0; n < 60; n++) {
            const Words words = next();
            forget(), send(frame(words));
            longest_access = 0;
            for (unsigned k = 0; to_send() || answers.empty(); k++) {
                CHECK(*this, k < 4000, "no answer to a busy board");
                write(n & 1 ? "ctrl.scratch" : "gpio.safe", k & 0xfff);
                if (k & 1) access(OTHER_TX_SLOT + 4 * (k & 63), true, k);
                CHECK(*this, read(n & 1 ? "ctrl.scratch" : "gpio.safe") == (k & 0xfff), "a register lost its value");
            }
            quiet();
            check_answer(sequence, words);
            CHECK(*this, longest_access <= longest_piece(), "an access took %u clocks", longest_access);
        }
    }
    // Clocks from the first byte of a command's preamble to the last byte of its answer: head,
    // words, FCS, and the answer.
    unsigned whole_exchange() { return (8 + frame(any(0)).size() + 8 + answer_bytes() + 4) * ETH / SYS + LONGEST; }
    // The CPU halts in the middle of an access, in every clock of an exchange, and whatever it
    // accessed: the access falls away, and in every other clock it stays for ever.
    unsigned halts_in_an_access() {
        const std::pair<uint32_t, bool> accesses[] = {
            {address("ctrl.scratch"), false}, {address("gpio.safe"), true}, {address("status.sample_lo"), false}, {address("fast_path.status"), false},
            {OTHER_TX_SLOT, true},
        };
        const unsigned to = whole_exchange();
        unsigned count = 0;
        write("gpio.safe", 0);
        for (unsigned k = 0; k < to; k++)
            for (const auto &[at, store] : accesses) {
                if (SHARE > 1 && !random.one_in(SHARE)) continue;
                const Words words = next();
                forget(), send(frame(words)), run(k), ask(at, store, 0x123);
                if (count++ & 1) quiet();
                else run(1 + random.below(4));
                pins->bus_stb = 0;
                quiet();
                check_executed("the CPU halts in an access", words);
                const uint32_t safe = read("gpio.safe");
                CHECK(*this, !safe || (safe & 0xfff) == 0x123, "gpio.safe is %x", safe);
                check_slots("the CPU halts in an access", 0);
            }
        return count;
    }
    // It halts before any of the accesses with which it hands out a pass: executed once if it came
    // to the last one, and then nothing any more.
    void halts_before_a_pass() {
        const int last = 7;  // two words of the head, three of the answer, the gate; then the pass
        for (int n = 0; n <= last; n++) {
            revoke(), run(5), sequence++;
            const Words words = any(sequence);
            lives = n, hand_out(sequence);
            CHECK(*this, !lives, "a pass takes fewer accesses than %d", n);
            lives = -1;
            forget(), send(frame(words)), send(frame(words)), send(frame(any(sequence + 1))), quiet();
            if (n == last) check_executed("the CPU halts with a pass out", words);
            else CHECK(*this, !taken && answers.empty(), "executed without a pass");
            check_slots("the CPU halts", 3 - (n == last));
        }
    }
    // Firmware hangs with a pass out: one more command is executed, then none, and the watchdog
    // bites at its time.
    void hangs(unsigned rounds) {
        const unsigned timeout = 1500;
        write("watchdog.timeout", timeout);
        for (unsigned n = 0; n < rounds; n++) {
            arm();
            const Words words = next();
            forget(), run(random.below(timeout / 2)), send(frame(words));
            until_taken();
            const uint64_t fed = clocks;
            // The host goes on, by this number and the next.
            send(frame(any(sequence))), send(frame(any(sequence + 1)));
            uint64_t bitten = 0;
            for (unsigned k = 0; k < 1000 && !bitten; k++)
                if (read("watchdog.status") & BITTEN) bitten = clocks;
            CHECK(*this, bitten > fed + timeout && bitten < fed + timeout + 20, "bitten %llu clocks behind the last command", (unsigned long long)(bitten - fed));
            quiet();
            CHECK(*this, taken == 1 && commits == 1 && answers.size() == 1, "%u executed, %u committed, %zu answers", taken, commits, answers.size());
            check_slots("behind a hang", 2);
        }
        write("watchdog.timeout", TIMEOUT);
        arm();
    }
    // A reset takes the pass back, whenever it comes: from outside and from the CPU, either in
    // every clock of an exchange.
    Outcome resets() {
        const unsigned to = whole_exchange();
        Outcome all;
        for (const bool by_cpu : {false, true}) {
            Outcome o;
            for (unsigned k = random.below(STEP); k < to; k += STEP) o.count(executed_before_reset(by_cpu, k));
            both(by_cpu ? "the CPU resets" : "reset", o);
            all.done += o.done, all.left += o.left;
        }
        return all;
    }
    bool executed_before_reset(bool by_cpu, unsigned clock) {
        const Words words = next();
        forget(), send(frame(words)), run(clock);
        const bool before = taken;
        if (by_cpu) write("ctrl.reset", 1);
        else pins->sys_rst = 1, run(2), pins->sys_rst = 0;
        const bool meanwhile = taken && by_cpu, executed = before || meanwhile;  // its access takes some clocks
        CHECK(*this, !read("fast_path.status"), "status %x behind a reset", read("fast_path.status"));
        quiet(), run(400), quiet();
        CHECK(*this, taken == executed && commits <= taken, "executed behind a reset");
        release();
        // The MAC may have been in mid-frame, either way: the next one has the rest in it.
        send(with_fcs(Bytes(60, 1)));
        choose(1, 100), start();
        quiet();
        release();
        arm(), open(), exchange();
        return executed;
    }

    // ---- the cable ------------------------------------------------------------------------------
    // The receive clock stops in mid-frame: the bus is free, and the frame goes on with it.
    void wire_stands() {
        for (unsigned n = 0; n < 20; n++) {
            const Words words = next();
            forget(), send(frame(words));
            for (size_t stop = random.below(190); to_send() > stop;) step();
            eth_stands = true, longest_access = 0;
            for (unsigned k = 0; k < 100; k++) read("timebase.status");
            CHECK(*this, longest_access <= longest_piece(), "an access took %u clocks while the wire stood", longest_access);
            eth_stands = false;
            quiet();
            check_executed("a pause of the wire", words);
        }
    }
    // Something happens to the wire in each byte from the preamble to the FCS: the frame is gone,
    // and the good one right behind it is executed. It is a good one itself if so many bytes of its
    // preamble are not needed; then the other one comes too late.
    void in_every_byte(const char *what, size_t not_needed, const std::function<void(size_t)> &hurt) {
        const Words good = next();
        const size_t size = 8 + frame(good).size();
        for (size_t n = random.below(STEP); n < size; n += STEP) {
            hand_out(sequence), forget();
            send(frame(good)), hurt(n), send(frame(good)), quiet();
            check_executed(std::string(what) + " in byte " + std::to_string(n), good);
            const unsigned lie = release();
            CHECK(*this, lie <= (n < not_needed), "%s in byte %zu: %u frames lie in slots", what, n, lie);
        }
        revoke();
    }
    void cable() {
        in_every_byte("cut", 0, [&](size_t n) { wire.resize(n), wire.insert(wire.end(), GAP, {0xdd, false, false}); });
        in_every_byte("RX_ER", 0, [&](size_t n) { wire[n].error = true; });
        in_every_byte("RX_ER from there on", 0, [&](size_t n) { for (; wire[n].valid; n++) wire[n].error = true; });
        in_every_byte("no RX_DV", 7, [&](size_t n) { wire[n].valid = false; });
        in_every_byte("no RX_DV for a while", 7, [&](size_t n) {
            const size_t to = n + 2 + random.below(11);
            for (; n < to && n < wire.size(); n++) wire[n].valid = false;
        });
        // A false carrier between frames is nothing.
        for (unsigned n = 0; n < 40; n++) {
            const Words good = next();
            wire.assign(1 + random.below(40), {uint8_t(random.next()), false, true});
            send(frame(good));
            for (auto beat = wire.end() - GAP; beat != wire.end(); beat++) beat->error = random.one_in(2);
            forget(), quiet();
            check_executed("between false carriers", good);
        }
    }

    int all() {
        const auto took = turnaround(300);
        const unsigned slow = slow_links();
        looks(), waits_for_its_time(), only_with_this_pass();
        const unsigned kinds = never_executed(), bursts = back_to_back(WHOLE);
        no_slot_free(), cpu_sends();
        const Outcome one = cpu_queues(1), two = cpu_queues(2), again = passes_at_once(200);
        CHECK(*this, !one.left, "left behind one frame of the CPU's");
        both("two frames of the CPU's", two), both("a second pass", again);
        busy_cpu();
        const unsigned halted = halts_in_an_access();
        halts_before_a_pass();
        const Outcome closed = gate_closes(), bitten = bites(), back = revoked();
        revoked_anywhere(), handed_out_too_late();
        wire_stands(), cable();
        const Outcome reset = resets();
        hangs(WHOLE);
        unsigned open = 0;
        const unsigned bits = each_bit(open), executed = random_frames();
        printf("PASS fast_path: %u+%u+%u channels: turnaround %u/%u/%u clocks, %u at 10 Mbit/s; %u kinds of other frames, %u times back to back; "
               "%u bits turned over, %u of them left open; at the frame's end closed, bitten, revoked: executed %u, %u, %u, left %u, %u, %u; "
               "halted in an access %u times, reset %u times, hung %u times; %llu random frames, %u like the pass, %.1f Mclk in %.1f s, seed %llu\n",
               stepgens, encoders, pwms, took.front(), took[took.size() / 2], took.back(), slow, kinds, bursts, bits, open, closed.done, bitten.done, back.done, closed.left, bitten.left, back.left, halted, reset.done + reset.left, WHOLE,
               (unsigned long long)frames, executed, clocks / 1e6, double(clock() - began) / CLOCKS_PER_SEC, (unsigned long long)seed);
        return 0;
    }
};

int main(int argc, char **argv) {
    const uint64_t seed = argc > 1 ? strtoull(argv[1], nullptr, 0) : (uint64_t)time(nullptr);
    return Tests(seed, argc > 2 ? strtoull(argv[2], nullptr, 0) : FRAMES).all();
}
