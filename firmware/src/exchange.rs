//! Executes the servo-period datagram: judges, stages, commits, samples and answers it. Each word
//! is moved once.
//!
//! ```text
//!   parse    net::FastPath or the server    its peer, whole, one record, our block's length
//!   judge    session, sequence, gate         a refusal here has touched nothing
//!   stage    command page, word by word      nothing takes effect before the commit
//!   commit   one strobe: every channel on one clock; the same strobe samples every channel
//!   copy     status page into the answer
//! ```
//!
//! The five stages work on contiguous windows, so each of them can move into gateware without a
//! change to the others. The request is read through [`Request`] and answered through [`Reply`]; so
//! the same code runs on MAC slots and on slices.

use crate::block::{REPLY_OVERHEAD, Reply, Request, Shape, reply_head};
use crate::cores::{Board, Control, Gate};
use crate::safety::Event;
use crate::server::Server;
use crate::session::Peer;
use wire::exchange::{
    COMMAND_HEAD, COMMAND_STEPGEN, FLAG_ALONE_SHIFT, FLAG_APPLY_TIME, FLAG_ENABLE,
    FLAG_ENABLE_REQUEST, REQUEST_OVERHEAD, STATUS_ENCODER, STATUS_STEPGEN, command_word,
    judge_sequence, status_word,
};
use wire::regmap::{command, status, timebase};
use wire::{Refusal, State};

const FLAGS_KNOWN: u32 =
    FLAG_ENABLE | FLAG_ENABLE_REQUEST | FLAG_APPLY_TIME | u32::MAX << FLAG_ALONE_SHIFT;

/// Number of the flags' word in a frame on the fast path.
pub const FRAME_FLAGS: usize = crate::net::PAYLOAD_WORD + REQUEST_OVERHEAD + command_word::FLAGS;

/// Number of the first word of an answer's frame after its headers and [`reply_head`].
const RESUME: usize = crate::net::PAYLOAD_WORD + REPLY_OVERHEAD - 1;
/// Number of the boot id's word in an answer's frame.
const KEPT: usize = crate::net::PAYLOAD_WORD + REPLY_OVERHEAD + status_word::BOOT_ID;

/// Loads words of the status page into names, then puts them: [`Request`] says why.
macro_rules! copy {
    ($board:ident, $reply:ident, $at:expr, $($name:ident $word:literal)+) => {
        $(let $name = $board.latched($at + $word);)+
        $($reply.put($name);)+
    };
}

/// The words of a command before those of its channels.
struct Head {
    token: u32,
    sequence: u32,
    flags: u32,
    apply: [u32; 2],
    enables: u32,
    outputs: u32,
    arms: u32,
    probe_arms: u32,
}

impl Head {
    #[inline(always)]
    fn take(request: &mut impl Request) -> Self {
        let words: [u32; COMMAND_HEAD] = request.take9();
        Head {
            token: words[command_word::TOKEN],
            sequence: words[command_word::SEQUENCE],
            flags: words[command_word::FLAGS],
            apply: [words[command_word::APPLY_LO], words[command_word::APPLY_HI]],
            enables: words[command_word::ENABLES],
            outputs: words[command_word::GPIO_OUT],
            arms: words[command_word::ARMS],
            probe_arms: words[command_word::PROBE_ARMS],
        }
    }

    /// Number of the latch whose position goes into the answer.
    #[inline(always)]
    fn latch(&self) -> u32 {
        self.probe_arms >> command_word::LATCH_SHIFT
    }
}

impl Server {
    /// Executes one exchange. `request` delivers the command block; the sequence number and the
    /// status block go into `reply`. A refused exchange has no effect, even if words were already
    /// put into `reply`.
    #[inline(always)]
    pub fn exchange<B: Board>(
        &mut self,
        board: &mut B,
        peer: Peer,
        request: &mut impl Request,
        reply: &mut impl Reply,
    ) -> Result<(), Refusal> {
        let head = Head::take(request);
        self.judge(peer, &head)?;
        if peer != Peer::INSIDE {
            self.took_long_way(head.sequence, head.flags);
        }
        let mut gate = board.gate();
        let left = board.watchdog_left();
        self.stage(board, &head, request)?;
        // A damaged command continues to the answer, which is not sent, and has no other effect: so
        // a warm-up runs through the same code.
        let whole = request.intact();
        if whole {
            gate = self.commit(board, &head, gate)?;
        }

        // Answer with the sampled status page. The compiler would build a function of its own
        // twice, once for damaged commands, and a warm-up would load the wrong one. `session_yours`
        // and `accepted` are true here, because anything else was refused above.
        let [arrival_lo, arrival_hi] = [board.arrival_lo(), board.arrival_hi()];
        let [sample_lo, sample_hi] = [
            board.latched(status::SAMPLE_LO),
            board.latched(status::SAMPLE_HI),
        ];
        let [estop, inputs] = [board.latched(status::ESTOP), board.latched(status::GPIO_IN)];
        let state = self.state_word(gate) | STATE_ANSWER;
        reply.put(head.sequence);
        reply.put(state);
        reply.put(head.sequence);
        reply.put(arrival_lo);
        reply.put(arrival_hi);
        reply.put(sample_lo);
        reply.put(sample_hi);
        reply.put(left);
        reply.put(self.counters.refused_total);
        reply.keep(self.boot.id);
        reply.put(estop);
        reply.put(inputs);
        let latch = board.latched(status::ENCODER0_LATCH + head.latch() as usize);
        copy!(board, reply, status::FLAGS0, a 0 b 1 c 2);
        reply.put(latch);
        // Read again: values held in registers would push others out of theirs.
        copy_stepgens(board, reply, self.shape.stepgens);
        copy_encoders(board, reply, self.shape.encoders);
        if whole {
            Ok(())
        } else {
            Err(Refusal::Checksum)
        }
    }

    /// Refuses a command by its head alone: session, sequence number, bits without a meaning.
    #[inline(always)]
    fn judge(&self, peer: Peer, head: &Head) -> Result<(), Refusal> {
        self.session.check(peer, head.token)?;
        let last = self.session.last_sequence();
        if head.sequence.wrapping_sub(last) as i32 <= 0 {
            return Err(not_ahead(head.sequence, last));
        }
        if head.flags & !FLAGS_KNOWN | head.latch() >> command_word::LATCH_BITS != 0 {
            return Err(Refusal::Value);
        }
        Ok(())
    }

    /// Writes the command page. Nothing of it takes effect before the commit.
    #[inline(always)]
    fn stage<B: Board>(
        &mut self,
        board: &mut B,
        head: &Head,
        request: &mut impl Request,
    ) -> Result<(), Refusal> {
        let shape = self.shape;
        if self.commit_pending {
            // A timed commit must not fire while half a block is staged, and a damaged block must
            // not replace it. From here on the new command counts.
            if !request.sound(shape.command - COMMAND_HEAD) {
                return Err(Refusal::Checksum);
            }
            board.commit_at(u64::MAX);
            self.commit_pending = false;
        }
        board.stage(command::ENABLES, head.enables);
        board.stage(command::GPIO_OUT, head.outputs);
        board.stage(command::ARMS, head.arms);
        // The register ignores the selection in the bits above the arms.
        board.stage(command::PROBE_ARMS, head.probe_arms);
        stage_stepgens(board, request, shape.stepgens);
        stage_pwms(board, request, shape.pwms);
        Ok(())
    }

    /// Makes the staged command take effect and samples every channel; returns the gate after that.
    #[inline(always)]
    fn commit<B: Board>(
        &mut self,
        board: &mut B,
        head: &Head,
        mut gate: Gate,
    ) -> Result<Gate, Refusal> {
        let enable = head.flags & FLAG_ENABLE != 0;
        let enable_request = head.flags & FLAG_ENABLE_REQUEST != 0;
        let now = head.flags & FLAG_APPLY_TIME == 0;
        if now && self.safety.steady(enable, enable_request, gate) {
            board.strobe(timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE);
        } else if self.safety.waiting(enable_request, gate) {
            board.strobe(timebase::STROBE_SAMPLE);
        } else {
            let at = (!now).then_some(head.apply);
            gate = self.decide(board, enable, enable_request, gate, at)?;
        }
        board.feed(head.sequence);
        self.session.accept(head.sequence);
        self.select = head.latch();
        Ok(gate)
    }

    /// Records what is left to do after the answer to an executed exchange with these flags is
    /// sent.
    #[inline]
    pub fn exchanged(&mut self, flags: u32) {
        self.spoke = true;
        self.flags = flags;
        if self.safety.state() == State::Armed {
            self.path_stop.executed(flags);
        }
        self.counters.exchanges = self.counters.exchanges.wrapping_add(1);
    }

    /// Makes the step generators' decelerations fit the last command ([`crate::path_stop`]). Call
    /// it after every answer if [`Server::owes_path`]. It takes a few hundred clocks.
    #[inline(always)]
    pub fn hold_path<B: Board>(&mut self, board: &mut B) {
        let segments = self.ident.plays_segments();
        self.path_stop.hold(board, self.shape.stepgens, segments);
    }

    /// Has a command been executed for which [`Server::hold_path`] has not run yet?
    #[inline(always)]
    pub fn owes_path(&self) -> bool {
        self.path_stop.owed()
    }

    /// Handles the servo periods in which something changes: arming, stopping, faults, timed
    /// commits.
    #[cold]
    #[inline(never)]
    fn decide<B: Board>(
        &mut self,
        board: &mut B,
        enable: bool,
        request: bool,
        gate: Gate,
        apply: Option<[u32; 2]>,
    ) -> Result<Gate, Refusal> {
        let event = Event::Command {
            enable,
            request,
            gate,
        };
        let effects = self.step(event, board.now());
        if effects.end_session {
            // The watchdog bit before this command came: the session has no owner any more.
            self.obey(board, effects);
            return Err(Refusal::NotOwner);
        }
        let arming = effects.order == Some(Control::Arm);
        if arming {
            // Outputs without motion take the command while the gate is still closed, so that they
            // open with it. Step generators take commands only with the gate open, so the command
            // is committed again.
            board.strobe(timebase::STROBE_COMMIT);
        }
        self.obey(board, effects);
        match apply {
            Some([lo, hi]) if effects.execute && !arming => {
                board.commit_at(u64::from(hi) << 32 | u64::from(lo));
                board.strobe(timebase::STROBE_COMMIT_AT | timebase::STROBE_SAMPLE);
                self.commit_pending = true;
            }
            Some(_) | None if effects.execute => {
                board.strobe(timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE)
            }
            Some(_) | None => board.strobe(timebase::STROBE_SAMPLE),
        }
        Ok(board.gate())
    }
}

/// Stages the two words of each of `count` stepgens, up to two stepgens at a time.
#[inline(always)]
fn stage_stepgens(board: &mut impl Board, request: &mut impl Request, count: usize) {
    let mut at = command::STEPGEN0_VELOCITY;
    for _ in 0..count / 2 {
        stage4(board, at, request.take4());
        at += 2 * COMMAND_STEPGEN;
    }
    if count & 1 != 0 {
        stage2(board, at, request.take2());
    }
}

/// Stages the word of each of `count` PWMs, up to four at a time.
#[inline(always)]
fn stage_pwms(board: &mut impl Board, request: &mut impl Request, count: usize) {
    let mut at = command::PWM0_WIDTH;
    for _ in 0..count / 4 {
        stage4(board, at, request.take4());
        at += 4;
    }
    if count & 2 != 0 {
        stage2(board, at, request.take2());
        at += 2;
    }
    if count & 1 != 0 {
        let [a] = request.take1();
        board.stage(at, a);
    }
}

#[inline(always)]
fn stage4(board: &mut impl Board, at: usize, [a, b, c, d]: [u32; 4]) {
    board.stage(at, a);
    board.stage(at + 1, b);
    board.stage(at + 2, c);
    board.stage(at + 3, d);
}

#[inline(always)]
fn stage2(board: &mut impl Board, at: usize, [a, b]: [u32; 2]) {
    board.stage(at, a);
    board.stage(at + 1, b);
}

/// Copies the three words of each of `count` stepgens into the answer, up to four stepgens at a
/// time.
#[inline(always)]
fn copy_stepgens(board: &mut impl Board, reply: &mut impl Reply, count: usize) {
    let mut at = status::STEPGEN0_POSITION_LO;
    for _ in 0..count / 4 {
        copy!(board, reply, at, a 0 b 1 c 2 d 3 e 4 f 5 g 6 h 7 i 8 j 9 k 10 l 11);
        at += 4 * STATUS_STEPGEN;
    }
    if count & 2 != 0 {
        copy!(board, reply, at, a 0 b 1 c 2 d 3 e 4 f 5);
        at += 2 * STATUS_STEPGEN;
    }
    if count & 1 != 0 {
        copy!(board, reply, at, a 0 b 1 c 2);
    }
}

/// Copies the two words of each of `count` encoders into the answer, up to four encoders at a time.
#[inline(always)]
fn copy_encoders(board: &mut impl Board, reply: &mut impl Reply, count: usize) {
    let mut at = status::ENCODER0_COUNT;
    for _ in 0..count / 4 {
        copy!(board, reply, at, a 0 b 1 c 2 d 3 e 4 f 5 g 6 h 7);
        at += 4 * STATUS_ENCODER;
    }
    if count & 2 != 0 {
        copy!(board, reply, at, a 0 b 1 c 2 d 3);
        at += 2 * STATUS_ENCODER;
    }
    if count & 1 != 0 {
        copy!(board, reply, at, a 0 b 1);
    }
}

const _: () = assert!(STATUS_STEPGEN == 3 && STATUS_ENCODER == 2);

/// Tells which of two reasons a sequence number is refused for. A function of its own keeps it out
/// of the fast path.
#[cold]
#[inline(never)]
fn not_ahead(sequence: u32, last: u32) -> Refusal {
    match judge_sequence(sequence, last) {
        Err(why) => why,
        Ok(()) => Refusal::Stale,
    }
}

/// Bits of a state word that are set only in the answer to an accepted command.
pub const STATE_ANSWER: u32 = 1 << 18 | 1 << 21;

/// An answer that is written directly into a transmit slot, after the headers and [`reply_head`].
#[derive(Debug)]
pub struct SlotReply<'s, S> {
    slot: &'s mut S,
    index: usize,
}

impl<'s, S: crate::net::Slot> SlotReply<'s, S> {
    /// Writes all words of the frame that are the same in every answer on this fast path.
    pub fn prepare(slot: &mut S, headers: impl FnOnce(&mut S), server: &Server) {
        headers(slot);
        crate::net::emit_payload(slot, &reply_head(&server.shape));
        slot.put(KEPT, server.boot.id);
    }

    /// Continues after what [`SlotReply::prepare`] wrote.
    #[inline(always)]
    pub fn resume(slot: &'s mut S) -> Self {
        SlotReply {
            slot,
            index: RESUME,
        }
    }

    /// Length of the answer's frame in bytes.
    pub const fn frame_length(shape: &Shape) -> usize {
        crate::net::HEADERS + (REPLY_OVERHEAD + shape.status) * 4
    }
}

impl<S: crate::net::Slot> Reply for SlotReply<'_, S> {
    #[inline(always)]
    fn put(&mut self, word: u32) {
        self.slot.put(self.index, word);
        self.index += 1;
    }

    /// Only the boot id is kept, and it is already in the slot.
    #[inline(always)]
    fn keep(&mut self, _word: u32) {
        self.index += 1;
    }
}
