//! Executes the servo-period datagram: judges, stages, commits, samples and answers it. Each word
//! is moved once.
//!
//! ```text
//!   parse    the server                      its peer, whole, one record, our block's length
//!   judge    session, sequence, gate         a refusal here has touched nothing
//!   stage    command page, word by word      nothing takes effect before the commit
//!   commit   one strobe: every channel on one clock; the same strobe samples every channel
//!   copy     status page into the answer
//! ```
//!
//! This is the long way: of the first exchange, of arming and stopping, and behind a lost frame.
//! With a pass ([`crate::pass`]) the gateware stages, commits, samples and answers.

use crate::block::STATE_ANSWER;
use crate::cores::{Board, Control, Gate};
use crate::net::FOUR;
use crate::server::Server;
use crate::session::Peer;
use wire::etherbone::ReplyWriter;
use wire::exchange::{
    COMMAND_HEAD, COMMAND_STEPGEN, FLAG_ALONE_SHIFT, FLAG_APPLY_TIME, FLAG_ENABLE,
    FLAG_ENABLE_REQUEST, STATUS_ENCODER, STATUS_HEAD, STATUS_STEPGEN, command_word, judge_sequence,
    status_word,
};
use wire::regmap::{command, status, timebase};
use wire::{Refusal, State};

const FLAGS_KNOWN: u32 =
    FLAG_ENABLE | FLAG_ENABLE_REQUEST | FLAG_APPLY_TIME | u32::MAX << FLAG_ALONE_SHIFT;

/// The words of a command before those of its channels.
struct Head {
    token: u32,
    sequence: u32,
    flags: u32,
    apply: [u32; 2],
    probe_arms: u32,
}

impl Head {
    /// `None` if the block has fewer words.
    fn of(block: &[u32]) -> Option<Self> {
        let words: &[u32; COMMAND_HEAD] = block.first_chunk()?;
        Some(Head {
            token: words[command_word::TOKEN],
            sequence: words[command_word::SEQUENCE],
            flags: words[command_word::FLAGS],
            apply: [words[command_word::APPLY_LO], words[command_word::APPLY_HI]],
            probe_arms: words[command_word::PROBE_ARMS],
        })
    }

    /// Number of the latch whose position goes into the answer.
    #[inline(always)]
    fn latch(&self) -> u32 {
        self.probe_arms >> command_word::LATCH_SHIFT
    }
}

impl Server {
    /// Executes one exchange: a command block of this board's length. The status block goes into
    /// `reply`. A refused exchange has no effect.
    pub(crate) fn exchange<B: Board>(
        &mut self,
        board: &mut B,
        peer: Peer,
        block: &[u32],
        reply: &mut ReplyWriter,
    ) -> Result<(), Refusal> {
        let head = Head::of(block).ok_or(Refusal::BlockLength)?;
        self.judge(peer, &head)?;
        if peer != Peer::INSIDE {
            self.took_long_way(head.sequence, head.flags);
        }
        let gate = board.gate();
        let left = board.watchdog_left();
        self.stage(board, block);
        let gate = self.commit(board, &head, gate)?;
        // `session_yours` and `accepted` are true here, because anything else was refused above.
        // The caller provides a buffer for the longest answer.
        reply.push(head.sequence);
        if let Some(words) = reply.room::<STATUS_HEAD>() {
            words[status_word::STATE] = self.state_word(gate) | STATE_ANSWER;
            words[status_word::SEQUENCE] = head.sequence;
            words[status_word::ARRIVAL_LO] = board.arrival_lo();
            words[status_word::ARRIVAL_HI] = board.arrival_hi();
            words[status_word::SAMPLE_LO] = board.latched(status::SAMPLE_LO);
            words[status_word::SAMPLE_HI] = board.latched(status::SAMPLE_HI);
            words[status_word::WATCHDOG_LEFT] = left;
            words[status_word::REFUSED] = self.counters.refused_total;
            words[status_word::BOOT_ID] = self.boot.id;
            words[status_word::ESTOP] = board.latched(status::ESTOP);
            words[status_word::GPIO_IN] = board.latched(status::GPIO_IN);
            words[status_word::FLAGS0] = board.latched(status::FLAGS0);
            words[status_word::FLAGS1] = board.latched(status::FLAGS1);
            words[status_word::FLAGS2] = board.latched(status::FLAGS2);
            words[status_word::LATCH] =
                board.latched(status::ENCODER0_LATCH + head.latch() as usize);
        }
        let stepgens = STATUS_STEPGEN * self.shape.stepgens;
        let encoders = STATUS_ENCODER * self.shape.encoders;
        if let Some((of_stepgens, rest)) = reply
            .places(stepgens + encoders + self.shape.inputs_high)
            .and_then(|places| places.split_at_mut_checked(stepgens))
        {
            copy(board, status::STEPGEN0_POSITION_LO, of_stepgens);
            let (of_encoders, high) = rest.split_at_mut_checked(encoders).unwrap_or_default();
            copy(board, status::ENCODER0_COUNT, of_encoders);
            copy(board, status::GPIO_IN_HIGH, high);
        }
        self.exchanged(head.flags);
        Ok(())
    }

    /// Refuses a command by its head alone: session, sequence number, bits without a meaning.
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
    fn stage<B: Board>(&mut self, board: &mut B, block: &[u32]) {
        if self.commit_pending {
            // A timed commit must not fire while half a block is staged. From here on the new
            // command counts.
            board.commit_at(u64::MAX);
            self.commit_pending = false;
        }
        // The registers have the order of the block, but for the channels that this board lacks.
        let Some((head, channels)) = block.split_at_checked(COMMAND_HEAD) else {
            return; // `Head::of` found them
        };
        let common = head.get(command_word::ENABLES..).unwrap_or(&[]);
        let stepgens = COMMAND_STEPGEN * self.shape.stepgens;
        let (stepgens, rest) = channels.split_at_checked(stepgens).unwrap_or_default();
        let (pwms, high) = rest.split_at_checked(self.shape.pwms).unwrap_or_default();
        stage(board, command::ENABLES, common);
        stage(board, command::STEPGEN0_VELOCITY, stepgens);
        stage(board, command::PWM0_WIDTH, pwms);
        stage(board, command::GPIO_OUT_HIGH, high);
    }

    /// Makes the staged command take effect and samples every channel; returns the gate after that.
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
            self.safety.waited(enable_request);
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

    /// Records what is left to do after an executed exchange with these flags.
    pub(crate) fn exchanged(&mut self, flags: u32) {
        self.spoke = true;
        self.exchanges = true;
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
        let now = board.now();
        let effects = self.follow(|safety| safety.commanded(enable, request, gate, now));
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

/// Stages words in registers that follow one another.
#[inline(never)]
fn stage<B: Board>(board: &mut B, mut register: usize, words: &[u32]) {
    let (fours, rest) = words.as_chunks::<FOUR>();
    for [a, b, c, d] in fours {
        board.stage(register, *a);
        board.stage(register + 1, *b);
        board.stage(register + 2, *c);
        board.stage(register + 3, *d);
        register += FOUR;
    }
    for word in rest {
        board.stage(register, *word);
        register += 1;
    }
}

/// Copies sampled words that follow one another.
#[inline(never)]
fn copy<B: Board>(board: &mut B, mut word: usize, places: &mut [u32]) {
    let (fours, rest) = places.as_chunks_mut::<FOUR>();
    for four in fours {
        *four = [
            board.latched(word),
            board.latched(word + 1),
            board.latched(word + 2),
            board.latched(word + 3),
        ];
        word += FOUR;
    }
    for place in rest {
        *place = board.latched(word);
        word += 1;
    }
}

/// Tells which of two reasons a sequence number is refused for.
fn not_ahead(sequence: u32, last: u32) -> Refusal {
    match judge_sequence(sequence, last) {
        Err(why) => why,
        Ok(()) => Refusal::Stale,
    }
}
