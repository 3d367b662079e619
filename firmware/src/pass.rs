//! Judges the owner's next exchange before its frame comes, so that the gateware can execute and
//! answer it without the CPU.
//!
//! The firmware writes down what the frame must look like ([`Expected`]), where its words go and
//! what its answer consists of ([`runs`]), and hands out a [`Pass`] for one command. The gateware
//! (`fast_path.sv`) executes a frame that is like that to the last bit, once, and uses up the pass.
//! Every other frame lies in its receive slot and takes the long way through the [`crate::server`].
//!
//! ```text
//!   judged, pass out --- the frame comes: commit, sample, feed, answer ---> executed
//!         ^                                                                    |
//!         +---- next pass <---- decelerations <---- accepted, counted <--------+
//! ```
//!
//! [`crate::machine::Shared`] holds the rule that makes this safe.

use crate::block::{REPLY_OVERHEAD, Shape, reply_head};
use crate::gate::Gate;
use crate::net::{self, Datagram, HEADERS, PAYLOAD_WORD, Slot, Us};
use wire::exchange::{
    COMMAND_STEPGEN, FLAG_APPLY_TIME, REQUEST_OVERHEAD, STATUS_ENCODER, STATUS_STEPGEN, status_word,
};
use wire::regmap::{command, fast_path, ident, status, timebase};

/// Runs that say where words of the frame go.
const FRAME_RUNS: usize = 4;
/// All runs.
pub const RUNS: usize = fast_path::IP_SUM - fast_path::RUN0;
/// Words of a frame's head that are compared.
pub const PLACES: usize = 16;
/// Among them the sequence number, ...
pub const SEQUENCE_PLACE: usize = 14;
/// ... and the flags.
pub const FLAGS_PLACE: usize = 15;

/// Lowest page that a run can name: the first of our own cores.
const FIRST_PAGE: u32 = ident::PAGE;
/// Bits of a register's number on its page.
const PAGE_BITS: u32 = 7;
/// Clocks between the sample and the first word of it that is right everywhere, less those that
/// pass anyway: the sampled counts are complete 18 clocks behind the strobe.
const SAMPLE_CLOCKS: usize = 8;

/// First word of the status block in an answer's frame.
const STATUS_AT: usize = PAYLOAD_WORD + REPLY_OVERHEAD;
/// The word in front of it: the base address, which is the sequence number.
const BASE_AT: usize = STATUS_AT - 1;

/// One command, judged in advance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pass {
    /// Its sequence number.
    pub sequence: u32,
    /// Its flags.
    pub flags: u32,
    /// How the gate must read when it comes.
    pub gate: Gate,
    /// It is committed. If not, it is only sampled and answered.
    pub executes: bool,
    /// The state word of its answer.
    pub state: u32,
    /// The count of refused datagrams in its answer.
    pub refused: u32,
}

impl Pass {
    /// It is committed at its time.
    pub const fn timed(&self) -> bool {
        self.executes && self.flags & FLAG_APPLY_TIME != 0
    }

    /// The register `fast_path.gate`.
    pub const fn condition(&self) -> u32 {
        let executes = if self.executes {
            fast_path::GATE_EXECUTES
        } else {
            0
        };
        let timed = if self.timed() {
            fast_path::GATE_TIMED
        } else {
            0
        };
        self.gate.0 & fast_path::GATE_STATUS | executes | timed
    }

    /// The words of the answer's frame that differ from pass to pass, by number.
    pub const fn answer(&self) -> [(usize, u32); 4] {
        [
            (BASE_AT, self.sequence),
            (STATUS_AT + status_word::STATE, self.state),
            (STATUS_AT + status_word::SEQUENCE, self.sequence),
            (STATUS_AT + status_word::REFUSED, self.refused),
        ]
    }
}

/// What the frames of the owner's exchanges look like up to the flags, and sums of what does not
/// change in them. A host that changes its TOS or TTL from frame to frame takes the long way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    /// Words 0 to 4, 6 to 11 and 13 to 17 of the frame. The lower halves of words 6 and 10, which
    /// are checksums, are not compared.
    pub words: [u32; PLACES],
    /// Ones' complement sum of words 4, 7 and 8.
    pub ip_sum: u32,
    /// Ones' complement sum of pseudo header and ports.
    pub udp_sum: u32,
}

impl Expected {
    /// Exchanges of `command_words` words, from the sender of `datagram`, with this token.
    pub fn new(us: &Us, datagram: &Datagram, command_words: usize, token: u32) -> Self {
        let payload = (REQUEST_OVERHEAD + command_words) * 4;
        let udp_length = (net::UDP_HEADER + payload) as u32;
        let service = u32::from(datagram.service) << 16;
        let version = net::IPV4_IHL5 | service | (udp_length + net::IP_HEADER as u32);
        let (theirs, ours) = (datagram.peer.ip, us.ip);
        let ports = u32::from(datagram.peer.port) << 16 | u32::from(us.port);
        let [ours_high, ours_low] = net::to_mac(us.mac);
        let (theirs_high, theirs_low) = datagram.mac;
        let peers = net::add(theirs, ours);
        let pseudo = net::add(peers, net::PROTOCOL_UDP + udp_length);
        Expected {
            words: [
                ours_high,
                ours_low,
                u32::from(theirs_high) << 16 | theirs_low >> 16,
                theirs_low << 16 | net::ETHERTYPE_IPV4,
                version,
                u32::from(datagram.ttl) << 24 | net::PROTOCOL_UDP << 16,
                theirs,
                ours,
                ports,
                udp_length << 16,
                wire::etherbone::HEADER,
                wire::etherbone::record(command_words, 0),
                wire::map::COMMAND,
                token,
                0,
                0,
            ],
            ip_sum: net::fold(net::add(version, peers)),
            udp_sum: net::fold(net::add(pseudo, ports)),
        }
    }
}

/// Bytes of an answer's frame.
pub const fn answer_length(shape: &Shape) -> usize {
    HEADERS + (REPLY_OVERHEAD + shape.status) * 4
}

/// Writes the words of an answer's frame that are the same in every answer to the sender of
/// `datagram`.
pub fn prepare(slot: &mut impl Slot, us: &Us, datagram: &Datagram, shape: &Shape, boot_id: u32) {
    net::emit_headers(slot, us, datagram, answer_length(shape) - HEADERS);
    net::emit_payload(slot, &reply_head(shape));
    slot.put(STATUS_AT + status_word::BOOT_ID, boot_id);
}

/// Where the words of a command go from its apply time on, and what its answer consists of.
pub fn runs(shape: &Shape) -> [u32; RUNS] {
    let mut frame = List::new();
    frame.words(timebase::PAGE, timebase::COMMIT_AT_LO, 2);
    // The step generators' words are behind the common ones, on the page as in the frame.
    let common = command::STEPGEN0_VELOCITY - command::ENABLES;
    let stepgens = COMMAND_STEPGEN * shape.stepgens;
    frame.words(command::PAGE, command::ENABLES, common + stepgens);
    frame.words(command::PAGE, command::PWM0_WIDTH, shape.pwms);
    frame.words(command::PAGE, command::GPIO_OUT_HIGH, shape.outputs_high);

    let mut answer = List::new();
    let page = status::PAGE;
    answer.skip(SAMPLE_CLOCKS, STATUS_AT + status_word::ARRIVAL_LO);
    // The frame arrived when it was sampled.
    answer.words(page, status::SAMPLE_LO, 2);
    answer.words(page, status::SAMPLE_LO, 2);
    answer.words(page, status::LEFT, 1);
    answer.skip(1, STATUS_AT + status_word::ESTOP);
    answer.words(page, status::ESTOP, 1);
    answer.words(page, status::GPIO_IN, 4);
    answer.words(page, status::ENCODER0_LATCH, 1);
    answer.mark(fast_path::RUN0_SELECT);
    let stepgens = STATUS_STEPGEN * shape.stepgens;
    answer.words(page, status::STEPGEN0_POSITION_LO, stepgens);
    let encoders = STATUS_ENCODER * shape.encoders;
    answer.words(page, status::ENCODER0_COUNT, encoders);
    answer.words(page, status::GPIO_IN_HIGH, shape.inputs_high);

    let mut all = [0; RUNS];
    let (head, tail) = all.split_at_mut(FRAME_RUNS);
    frame.end(head);
    answer.end(tail);
    all
}

/// Runs, one after the other.
struct List {
    runs: [u32; RUNS],
    count: usize,
}

impl List {
    const fn new() -> Self {
        List {
            runs: [0; RUNS],
            count: 0,
        }
    }

    fn push(&mut self, run: u32) {
        if let Some(place) = self.runs.get_mut(self.count) {
            *place = run;
            self.count += 1;
        }
    }

    /// `count` words of a page, from this one on.
    fn words(&mut self, page: u32, word: usize, count: usize) {
        if count != 0 {
            let register = (page - FIRST_PAGE) << PAGE_BITS | word as u32;
            self.push(register | (count as u32 - 1) << fast_path::RUN0_COUNT_SHIFT);
        }
    }

    /// Waits, and goes on at this word of the answer's frame.
    fn skip(&mut self, clocks: usize, at: usize) {
        let count = (clocks as u32 - 1) << fast_path::RUN0_COUNT_SHIFT;
        self.push(fast_path::RUN0_SKIP | count | at as u32);
    }

    /// Sets bits of the last run.
    fn mark(&mut self, bits: u32) {
        if let Some(last) = self.runs.get_mut(self.count.wrapping_sub(1)) {
            *last |= bits;
        }
    }

    /// The list is complete.
    fn end(mut self, places: &mut [u32]) {
        debug_assert!(self.count <= places.len(), "more runs than there are");
        self.mark(fast_path::RUN0_END);
        for (place, run) in places.iter_mut().zip(self.runs) {
            *place = run;
        }
    }
}

#[cfg(test)]
mod tests;
