// The board's PHY at its pins, with LiteEth's MAC: frames both ways at 1000, 100 and 10 Mbit/s, the
// speed changing during the run.
#include "Vrgmii.h"
#include "bench.h"
#include <deque>
#include <vector>

using Frame = std::vector<uint8_t>;

static uint32_t crc32(const Frame &frame) {
    uint32_t crc = ~0u;
    for (uint8_t byte : frame) {
        crc ^= byte;
        for (int k = 0; k < 8; k++) crc = crc >> 1 ^ (0xEDB88320 & -(crc & 1));
    }
    return ~crc;
}

struct Cycle {  // of RXC or TXC: the wires' levels at its two edges
    uint8_t rise, fall, ctl_rise, ctl_fall;
};

enum Flaw { GOOD, FCS, RX_ER, CUT, DRIBBLE, FEW_PREAMBLE, FLAWS };

struct Link {
    Bench<Vrgmii> &b;
    Random &r;
    unsigned speed = 2;  // as in-band: 0, 1, 2 are 10, 100, 1000
    bool up = true, running = true;
    std::deque<Cycle> cycles;    // towards the FPGA
    // the frames the MAC has to give; true: unless it is lost
    std::deque<std::pair<Frame, bool>> expected;
    std::deque<Frame> sending;   // the frames given to the MAC
    uint64_t received = 0, broken = 0, sent = 0, overtaken = 0;
    uint64_t ps = 0, next_sys = 8333, next_quarter = 1000, quarter = 0;
    // the core's side
    Frame incoming;
    const Frame *outgoing = nullptr;
    size_t at = 0;
    // the wire out of the FPGA
    Cycle out{};
    std::vector<Cycle> wire;
    uint64_t silence = 1000;
    uint64_t beats = 0, rx_clocks = 0;  // what the core is told of RXC, and RXC
    bool torn = false;  // the speed has changed during this frame, or before it was all out

    Link(Bench<Vrgmii> &b) : b(b), r(b.random) {}

    uint64_t period() const { return speed == 2 ? 8000 : speed == 1 ? 40000 : 400000; }
    uint8_t in_band() const { return up | speed << 1 | 8; }

    void idle(unsigned count) {
        while (count--) cycles.push_back({in_band(), in_band(), 0, 0});
    }
    void nibble(uint8_t value, bool er) { cycles.push_back({value, value, 1, !er}); }
    void byte(uint8_t value, bool er) {
        if (speed == 2) cycles.push_back({uint8_t(value & 15), uint8_t(value >> 4), 1, !er});
        else nibble(value & 15, er), nibble(value >> 4, er);
    }
    Frame random_frame(size_t longest) {
        Frame frame(60 + r.below(longest - 59));
        for (auto &byte : frame) byte = r.one_in(4) ? r.one_in(2) ? 0x55 : 0xd5 : r.next();
        return frame;
    }
    // Puts a frame and its gap on the wire towards the FPGA. `unsure`: it may be lost, but must not
    // be delivered damaged.
    void push(Flaw flaw, size_t longest, bool unsure = false) {
        const Frame frame = random_frame(longest);
        uint32_t fcs = crc32(frame);
        if (flaw == FCS) fcs ^= 1u << r.below(32);
        Frame all = frame;
        for (int i = 0; i < 4; i++) all.push_back(fcs >> 8 * i);
        const size_t hit = flaw == RX_ER ? r.below(all.size()) : ~0ull;
        // LiteEth runs a frame of one byte together with the next one
        if (flaw == CUT) all.resize(2 + r.below(all.size() - 2));
        unsigned preamble = 7;
        if (flaw == FEW_PREAMBLE) {  // nibbles at the lower speeds
            preamble = r.below(7);
            if (speed != 2) {
                for (unsigned n = 1 + r.below(13); n--;) nibble(5, false);
                preamble = 0;
            }
        }
        if (flaw == FEW_PREAMBLE && speed != 2) nibble(5, false), nibble(0xd, false);
        else {
            while (preamble--) byte(0x55, false);
            byte(0xd5, false);
        }
        for (size_t n = 0; n < all.size(); n++) byte(all[n], n == hit);
        if (flaw == DRIBBLE) {
            if (speed != 2) nibble(r.next() & 15, false);
            else flaw = GOOD;
        }
        idle((r.one_in(2) ? 12 : 12 + r.below(60)) * (speed == 2 ? 1 : 2));
        if (flaw == FCS || flaw == RX_ER || flaw == CUT) broken++;
        else expected.push_back({frame, unsure});
    }
    void send(size_t longest) { sending.push_back(random_frame(longest)); }

    void core_edge() {
        auto &c = *b.core;
        // The edge samples the levels before it.
        const bool taken = c.to_valid && c.to_ready;
        beats += c.beat;
        if (c.from_valid) {
            for (int n = 0; n < 4; n++) {
                incoming.push_back(c.from_word >> 8 * n);
                if (c.from_last && c.from_last_be >> n & 1) break;
            }
            if (c.from_last) {
                if (!c.from_error) deliver();
                incoming.clear();
            }
        }
        b.edge();
        if (taken) {
            at += 4;
            if (at >= outgoing->size()) {
                on_wire.push_back(*outgoing);
                sending.pop_front();
                outgoing = nullptr;
            }
        }
        if (!outgoing && !sending.empty() && sending_allowed && r.one_in(3)) outgoing = &sending.front(), at = 0;
        c.to_valid = outgoing != nullptr;
        if (outgoing) {
            c.to_word = 0;
            for (size_t n = 0; n < 4 && at + n < outgoing->size(); n++) c.to_word |= uint32_t((*outgoing)[at + n]) << 8 * n;
            c.to_last = at + 4 >= outgoing->size();
            c.to_last_be = c.to_last ? 1 << (outgoing->size() - 1) % 4 : 0;
        }
        b.settle();
    }
    std::deque<Frame> on_wire;  // given to the MAC, not yet seen on the wire
    bool sending_allowed = true;

    void deliver() {
        while (!expected.empty() && expected.front().first != incoming && expected.front().second) expected.pop_front();
        CHECK(b, !expected.empty() && expected.front().first == incoming, "a frame of %zu bytes that was not sent, or too early; %zu waited for", incoming.size(), expected.size());
        expected.pop_front();
        received++;
    }

    // A cycle of TXC is complete.
    void out_cycle() {
        CHECK(b, out.ctl_rise == out.ctl_fall, "TX_CTL says an error");
        if (out.ctl_rise) {
            if (wire.empty()) {
                CHECK(b, torn || silence >= (speed == 2 ? 12 : 24), "a gap of %llu clocks", (unsigned long long)silence);
                frame_speed = speed;
            }
            wire.push_back(out);
            silence = 0;
            return;
        }
        silence++;
        if (wire.empty()) return;
        judge();
        wire.clear();
    }
    unsigned frame_speed = 2;
    void judge() {
        CHECK(b, !on_wire.empty(), "a frame leaves that was not sent");
        Frame want = on_wire.front();
        on_wire.pop_front();
        while (want.size() < 60) want.push_back(0);
        const uint32_t fcs = crc32(want);
        for (int i = 0; i < 4; i++) want.push_back(fcs >> 8 * i);
        Frame got;
        // If the speed changed, the frame may have begun at either speed; it has to end as it
        // began.
        if (torn && wire.size() != want.size() + 8) frame_speed = 0;
        else if (torn) frame_speed = 2;
        if (torn) torn = false, overtaken++;
        if (frame_speed == 2) {
            for (auto &c : wire) got.push_back(c.rise | c.fall << 4);
        } else {
            CHECK(b, wire.size() % 2 == 0, "half a byte leaves");
            for (size_t n = 0; n < wire.size(); n += 2) {
                CHECK(b, wire[n].rise == wire[n].fall && wire[n + 1].rise == wire[n + 1].fall, "a nibble changes within its clock");
                got.push_back(wire[n].rise | wire[n + 1].rise << 4);
            }
        }
        CHECK(b, got.size() == want.size() + 8, "%zu bytes leave, %zu expected", got.size(), want.size() + 8);
        for (int n = 0; n < 8; n++) CHECK(b, got[n] == (n == 7 ? 0xd5 : 0x55), "byte %d of the preamble is %02x", n, got[n]);
        CHECK(b, Frame(got.begin() + 8, got.end()) == want, "a frame leaves with other bytes than it had");
        sent++;
    }

    void phy_quarter() {
        auto &c = *b.core;
        switch (quarter++ & 3) {
        case 0:
            CHECK(b, !c.tx_clk, "TXC is not RXC");
            out.fall = c.tx_data, out.ctl_fall = c.tx_ctl;
            out_cycle();
            if (cycles.empty()) idle(1);
            c.rx_data = cycles.front().rise, c.rx_ctl = cycles.front().ctl_rise;
            break;
        case 1: c.rx_clk = 1, rx_clocks++; break;
        case 2:
            CHECK(b, c.tx_clk, "TXC is not RXC");
            out.rise = c.tx_data, out.ctl_rise = c.tx_ctl;
            c.rx_data = cycles.front().fall, c.rx_ctl = cycles.front().ctl_fall;
            cycles.pop_front();
            break;
        case 3: c.rx_clk = 0; break;
        }
        b.settle();
        b.clocks++;
    }
    void step() {
        if (next_sys <= next_quarter || !running) {
            ps = next_sys, next_sys += 16667;
            if (!running && next_quarter < next_sys) next_quarter = next_sys;
            core_edge();
        } else {
            ps = next_quarter, next_quarter += period() / 4;
            phy_quarter();
        }
    }
    void run(uint64_t nanoseconds) {
        const uint64_t end = ps + nanoseconds * 1000;
        while (ps < end) step();
    }
    // Until all expected frames have come: 8 ms after the last one is on the wire, which alone can
    // take that long.
    void drain(const char *what) {
        const uint64_t end = ps + cycles.size() * period() + 8000 * 1000000ull;
        while (!cycles.empty() || !sending.empty() || !on_wire.empty() || !wire.empty()) {
            step();
            CHECK(b, ps < end, "%s: nothing moves any more (%zu cycles, %zu to send, %zu on their way)", what, cycles.size(), sending.size(), on_wire.size());
        }
        run(60 * period() / 1000 + 2000);
        while (!expected.empty() && expected.front().second) expected.pop_front();
        CHECK(b, expected.empty(), "%s: %zu frames have not come", what, expected.size());
    }
    uint64_t dropped() { return b.core->crc_errors + b.core->preamble_errors; }
};

int main(int argc, char **argv) {
    Bench<Vrgmii> b("rgmii", argc, argv);
    auto &c = *b.core;
    Random &r = b.random;
    c.rx_clk = c.rx_ctl = c.rx_data = c.to_valid = c.to_last = c.to_last_be = 0, c.to_word = 0;
    b.settle();
    Link link(b);

    // A PHY without in-band status works at 1000.
    link.up = false, link.speed = 2;
    auto silent = [&] { for (auto &cycle : link.cycles) if (!cycle.ctl_rise) cycle.rise = cycle.fall = 0; };
    for (int n = 0; n < 20; n++) link.push(GOOD, 300), link.send(300);
    silent();
    link.drain("no in-band status");
    CHECK(b, (c.status & 1) == 0, "a link that was never up");
    link.up = true;

    // Every change of speed: all good frames pass both ways, and no damaged one.
    static const unsigned order[] = {2, 1, 0, 2, 0, 1, 2};
    for (unsigned speed : order) {
        link.speed = speed;
        link.idle(40);
        link.drain("a change of speed");
        CHECK(b, c.status == (1 | speed << 1 | 8), "status %x at speed %u", c.status, speed);
        const uint64_t dropped = link.dropped(), broken = link.broken, beats = link.beats, rx_clocks = link.rx_clocks;
        const size_t longest = speed == 0 ? 200 : 1514;
        for (int n = 0; n < (speed == 0 ? 60 : 300); n++) {
            link.push(Flaw(r.one_in(3) ? r.below(FLAWS) : GOOD), r.one_in(4) ? longest : 90);
            if (r.one_in(2)) link.send(r.one_in(4) ? longest : 90);
        }
        link.drain(speed == 2 ? "1000 Mbit/s" : speed == 1 ? "100 Mbit/s" : "10 Mbit/s");
        CHECK(b, link.dropped() - dropped == link.broken - broken, "%llu broken frames, %llu counted", (unsigned long long)(link.broken - broken), (unsigned long long)(link.dropped() - dropped));
        // A beat is 4 clocks of RXC, at every speed; one is on its way at either end.
        const int64_t counted = 4 * int64_t(link.beats - beats), made = int64_t(link.rx_clocks - rx_clocks);
        CHECK(b, made > 1000 && std::abs(counted - made) <= 8, "%lld clocks of RXC, %lld told in beats", (long long)made, (long long)counted);
    }

    // The speed changes in the middle of frames, again and again, with traffic both ways. Frames
    // that were complete before the change and frames after the new speed was reported must arrive;
    // those in between may be lost; no wrong frame is delivered.
    for (int round = 0; round < 300; round++) {
        for (unsigned n = r.below(3); n--;) link.push(GOOD, 120);
        if (r.one_in(2)) link.send(200);
        const size_t left = link.cycles.size();
        link.push(GOOD, 300, true);
        // In that frame, or after it, the PHY changes its clock and continues with its next data.
        link.cycles.resize(left + r.below(link.cycles.size() - left));
        while (!link.cycles.empty()) link.step();
        link.torn = !link.wire.empty() || !link.on_wire.empty() || !link.sending.empty();
        const unsigned was = link.speed;
        do link.speed = r.below(3);
        while (link.speed == was);
        link.quarter = 0, c.rx_clk = 0, b.settle();
        if (r.one_in(2)) {  // a frame, or the rest of one, before the new speed is reported
            link.push(GOOD, 120, true);
            if (r.one_in(2))
                for (size_t n = r.below(60); n--;) link.cycles.pop_front();
        }
        link.idle(60);
        while (!link.cycles.empty()) link.step();
        link.drain("after a change of speed");
        link.torn = false;
        CHECK(b, c.status == (1 | link.speed << 1 | 8), "status %x at speed %u", c.status, link.speed);
        // The first one may be lost: LiteEth joins it with what looked like a frame of one byte.
        for (int n = 0; n < 3; n++) link.push(GOOD, 120, n == 0), link.send(120);
        link.drain("at the new speed");
    }

    // A PHY without a clock has no link, whatever its last status; the link returns with the clock.
    link.running = false;
    link.run(6000);
    CHECK(b, c.status == 0, "status %x without a clock", c.status);
    link.running = true;
    link.idle(40);
    link.drain("a clock that was gone");
    CHECK(b, c.status == (1 | link.speed << 1 | 8), "status %x", c.status);
    // A link that goes down is reported, and the speed stays the same.
    link.up = false;
    link.idle(40);
    link.drain("link down");
    CHECK(b, (c.status & 1) == 0, "a link that is down is up");

    return b.pass("%llu frames in, %llu broken ones dropped, %llu out at 10, 100, 1000 Mbit/s; %llu caught by a change of speed",
                  (unsigned long long)link.received, (unsigned long long)link.broken, (unsigned long long)link.sent, (unsigned long long)link.overtaken);
}
