// The watchdog and its gate: every way to close, every way to stay closed, and the right reason for
// each.
#include "Vwatchdog.h"
#include "bench.h"

enum Reason { NEVER, BITE, EXT_RESET, STOP_KEY, SOFT_STOP, E_STOP, SYSTEM_RESET };

struct Dog : Bench<Vwatchdog> {
    Random &r = random;
    Vwatchdog &c = *core;

    // The reference, as a sequence of events rather than as equations.
    enum { CLOSED, AWAKE, STOPPING } state = CLOSED;
    bool bitten = false, reset_latched = false, estop_latched = false;
    uint32_t left = 0, last_token = 0, bites = 0, closes[7] = {};
    unsigned reason = NEVER;

    Dog(int argc, char **argv) : Bench("watchdog", argc, argv) {}

    void clock() {
        settle();
        const bool pins = c.ext_reset || c.estop, open = state != CLOSED;
        CHECK(*this, c.gate == (open && !pins), "gate %d", c.gate);
        CHECK(*this, c.cleared == (c.clear && !open && !pins), "cleared %d", c.cleared);
        const bool fed = (c.token_we && c.token != last_token) || c.feed;
        if (c.token_we) last_token = c.token;
        const bool bites_now = state == AWAKE && left == 0 && !fed;
        if (bites_now) bites++;
        if (open) {
            const bool over = state == STOPPING && (c.all_stopped || left == 0);
            if (pins || c.rst || c.shut || over) {
                reason = c.estop ? E_STOP : c.ext_reset ? EXT_RESET : bitten || bites_now ? BITE : c.rst ? SYSTEM_RESET : c.shut ? STOP_KEY : SOFT_STOP;
                closes[reason]++;
                state = CLOSED, left = 0;
            } else if (state == AWAKE && (bites_now || c.soft_stop)) state = STOPPING, left = c.grace;
            else if (state == AWAKE && fed) left = c.timeout;
            else left--;
            if (bites_now) bitten = true;
        } else {
            if (c.arm && !bitten && !reset_latched && !estop_latched && !pins && !c.shut && !c.rst) state = AWAKE, left = c.timeout;
            if (c.clear && !pins) bitten = reset_latched = estop_latched = false;
        }
        if (c.rst) bitten = reset_latched = false;
        reset_latched |= c.ext_reset, estop_latched |= c.estop;
        edge();
        is_as_expected();
    }
    void is_as_expected() {
        CHECK(*this, c.bitten == bitten && c.reset_latched == reset_latched && c.estop_latched == estop_latched, "latched %d%d%d, expected %d%d%d",
              c.bitten, c.reset_latched, c.estop_latched, bitten, reset_latched, estop_latched);
        CHECK(*this, c.armed == (state == AWAKE) && c.stop == (state == STOPPING), "armed %d, stop %d, expected state %d", c.armed, c.stop, state);
        CHECK(*this, c.remaining == left, "remaining %u, expected %u", c.remaining, left);
        CHECK(*this, c.last_token == last_token && c.bites == bites, "token %u, bites %u", c.last_token, c.bites);
        CHECK(*this, c.last_close == reason, "closed by %d, expected %d", c.last_close, reason);
    }
    void run(uint64_t n) { while (n--) clock(); }
    void pulse(CData &input) { input = 1, clock(), input = 0; }
    bool open() { settle(); return c.gate; }
    void feed(uint32_t token) { c.token = token, pulse(c.token_we); }

    void powers_up_closed() {
        c.rst = c.ext_reset = c.estop = c.token_we = c.feed = c.token = c.arm = c.soft_stop = c.shut = c.clear = c.all_stopped = 0;
        c.timeout = 50, c.grace = 20;
        run(10);
        CHECK(*this, c.last_close == NEVER && !open(), "power-up");
    }
    // Latched, prevents arming, and changes no reason because no gate closed.
    void an_estop_while_disarmed() {
        pulse(c.estop);
        pulse(c.arm);
        CHECK(*this, !open() && c.estop_latched && c.last_close == NEVER, "armed over an e-stop");
        pulse(c.rst);
        CHECK(*this, c.estop_latched, "a system reset forgets an e-stop");
        c.estop = 1, pulse(c.clear), c.estop = 0;
        CHECK(*this, c.estop_latched, "cleared while it was held");
        c.ext_reset = 1, pulse(c.clear), c.ext_reset = 0;
        CHECK(*this, c.estop_latched && c.reset_latched, "cleared in part");
        pulse(c.clear);
        pulse(c.arm);
        CHECK(*this, open(), "does not arm");
    }
    // From the outside: its reason, and that a later system reset does not change it.
    void each_way_to_close_has_its_reason() {
        const unsigned how = 1 + r.below(6);
        pulse(c.shut);
        pulse(c.clear);
        c.timeout = r.one_in(5) ? 0 : r.below(200), c.grace = r.one_in(5) ? 0 : r.below(100);
        pulse(c.arm);
        CHECK(*this, open(), "does not arm");
        if (how != BITE && c.timeout == 0) feed(last_token + 1);  // in the clock it would bite
        c.timeout = 200;
        if (how != BITE) feed(last_token + 1), run(r.below(150));
        const uint32_t before = bites;
        close(how);
        CHECK(*this, !open() && c.last_close == how, "closed by %d, says %d", how, c.last_close);
        CHECK(*this, bites == before + (how == BITE), "bites counted");
        if (how == BITE) {
            for (unsigned i = 0; i < 20; i++) feed(r.next()), pulse(c.feed), pulse(c.arm);
            CHECK(*this, c.bitten && !open(), "bitten, and a token, a command or an arm undid it");
        }
        pulse(c.rst);
        run(r.below(5));
        CHECK(*this, !open() && c.last_close == how, "a system reset changed the story to %d", c.last_close);
    }
    void close(unsigned how) {
        switch (how) {
        case BITE:
            for (unsigned n = 0; open(); n++) {
                CHECK(*this, n < 400, "never closes");
                if (r.one_in(3)) feed(last_token);
                else clock();
            }
            break;
        case EXT_RESET:
            c.ext_reset = 1;
            CHECK(*this, !open(), "open in the clock of the reset");
            pulse(c.ext_reset);
            break;
        case STOP_KEY:
            pulse(c.shut);
            break;
        case SOFT_STOP:
            pulse(c.soft_stop);
            run(r.below(c.grace + 1));
            c.all_stopped = 1;
            while (open()) clock();
            c.all_stopped = 0;
            break;
        case E_STOP:
            c.estop = 1;
            CHECK(*this, !open(), "open in the clock of the e-stop");
            pulse(c.estop);
            break;
        default:
            pulse(c.rst);
        }
    }
    void anything_at_any_time() {
        for (unsigned i = 0; i < 8000000; i++) {
            c.arm = r.one_in(8), c.clear = r.one_in(12), c.soft_stop = r.one_in(150), c.shut = r.one_in(250), c.rst = r.one_in(400);
            c.ext_reset = r.one_in(300), c.estop = r.one_in(300), c.all_stopped = r.one_in(20);
            c.token_we = r.one_in(10), c.token = r.below(3), c.feed = r.one_in(60);
            if (r.one_in(50)) c.timeout = r.up_to_bits(7), c.grace = r.up_to_bits(6);
            clock();
        }
    }
};

int main(int argc, char **argv) {
    Dog d(argc, argv);
    d.powers_up_closed();
    d.an_estop_while_disarmed();
    for (unsigned round = 0; round < 3000; round++) d.each_way_to_close_has_its_reason();
    d.anything_at_any_time();
    return d.pass("%u bites; closed by bite %u, reset pin %u, stop key %u, soft stop %u, e-stop %u, system reset %u", d.bites,
                  d.closes[BITE], d.closes[EXT_RESET], d.closes[STOP_KEY], d.closes[SOFT_STOP], d.closes[E_STOP], d.closes[SYSTEM_RESET]);
}
