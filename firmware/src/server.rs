//! The Etherbone server: a datagram is checked completely, then executed completely or not at all.
//!
//! [`Server::datagram`] takes every datagram that the gateware has not executed
//! ([`crate::pass`]). Checks run against a copy of the session and
//! the state machine, so that one datagram can acquire the session and configure the board.
//!
//! The server answers probes, reads and the exchange, but not a plain write. A refused datagram is
//! counted by reason and has no other effect.

mod ahead;
mod judge;
mod stored;

use self::judge::{COMMAND_END, FLASH_END, Judge, PANIC_END, check_read, writes_of};
use crate::auth::Auth;
use crate::block::{REPLY_OVERHEAD, Shape, reply_head};
use crate::cores::{Board, Control, Gate, Ident, Led, Setting};
use crate::flash::Flash;
use crate::link::Link;
use crate::pass::Pass;
use crate::path_stop::PathStop;
use crate::pins::{self, Pins};
use crate::postmortem::Boot;
use crate::safety::{Effects, Event, Safety};
use crate::session::{Peer, Session};
use crate::{config, describe, log};
use wire::describe::{FEATURE_KEY, JobsState};
use wire::etherbone::{self, Packet, Record, ReplyWriter};
use wire::exchange::{STATUS_ENCODER, STATUS_HEAD, STATUS_STEPGEN, StateWord, status_word};
use wire::map::BoardConfig;
use wire::refusal::{COUNTERS_CALLS, COUNTERS_CUTS, COUNTERS_WAYS};
use wire::regmap::{self, command, segments, status, timebase};
use wire::{GateClose, LongWay, MAX_WORDS, Refusal, ResetReason, map};

/// 10 ms: clients do not poll an idle machine faster than this, and a sample is cheap.
const IDLE_SAMPLE_PER_SECOND: u32 = 100;
/// 3 s without any frame: a missing cable is more likely than a network without broadcasts.
const QUIET_SECONDS: u32 = 3;

/// The word of [`Counters::cuts`].
const CUTS_WORD: u32 = (COUNTERS_CUTS - map::COUNTERS) / 4;
/// The words of [`Counters::calls`].
const CALLS_WORD: u32 = (COUNTERS_CALLS - map::COUNTERS) / 4;
const CALLS_END: u32 = CALLS_WORD + 2;
/// The words of [`Counters::ways`] and [`Counters::long_way`].
const WAYS_WORD: u32 = (COUNTERS_WAYS - map::COUNTERS) / 4;
const WAYS_END: u32 = WAYS_WORD + 3;
/// Outputs that follow the segments core; boards without that core are not told.
const SEGMENTS_MASK: u32 = regmap::address(segments::BASE, segments::MASK);

/// Counters of frames and datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counters {
    /// Frames received, of any kind.
    pub frames_rx: u32,
    /// Frames sent, of any kind.
    pub frames_tx: u32,
    /// Exchanges executed.
    pub exchanges: u32,
    /// Datagrams refused.
    pub refused_total: u32,
    /// Datagrams refused, by reason.
    pub refused: [u32; Refusal::COUNT],
    /// How often pulses may have been cut off since the start; the client that arms next makes
    /// `position_trusted` true again.
    pub cuts: u32,
    /// Clocks of the longest call of the services, while a host moved the machine and at any other
    /// time.
    pub calls: [u32; 2],
    /// Exchanges that the gateware executed with a pass, and those that took the long way.
    pub ways: [u32; 2],
    /// Why the last one of those did.
    pub long_way: LongWay,
}

/// The server's whole state.
#[derive(Clone, Debug)]
pub struct Server {
    pub(crate) ident: Ident,
    pub(crate) shape: Shape,
    pub(crate) abi: u32,
    pub(crate) boot: Boot,
    pub(crate) session: Session,
    pub(crate) auth: Auth,
    pub(crate) safety: Safety,
    pub(crate) counters: Counters,
    pub(crate) flash: Flash,
    pins: Pins,
    pub(crate) link: Link,
    /// The state word without the gate; every answer begins with it.
    state_word: u32,
    pub(crate) path_stop: PathStop,
    /// A timed commit may still be waiting in gateware.
    pub(crate) commit_pending: bool,
    /// The pass that was taken back without a command, if the next exchange is the first since.
    pub(crate) returned: Option<Pass>,
    /// The latch that the last answer carried.
    pub(crate) select: u32,
    /// The owner sent something since the last [`Server::poll`].
    pub(crate) spoke: bool,
    /// The owner's last datagram was an exchange.
    pub(crate) exchanges: bool,
    /// The flags of the last exchange that was executed.
    pub(crate) flags: u32,
    /// A command was committed since the machine was last put to rest.
    committed: bool,
    sampled_at: u64,
    /// The number of frames at the last look, and when it last changed.
    frames: (u32, u64),
    restart: bool,
    /// True from power-up until the first datagram of a host: the boot id is still the same as
    /// after every power-up.
    nameless: bool,
    /// The address in force, shown in the flash window.
    pub(crate) ip: u32,
}

impl Server {
    /// A server for this board, in state `Boot`. `abi` is the firmware's.
    pub const fn new(ident: Ident, abi: u32, boot: Boot) -> Self {
        Server {
            shape: Shape::new(ident.channels),
            ident,
            abi,
            boot,
            session: Session::new(),
            auth: Auth::new(boot.id),
            safety: Safety::new(),
            counters: Counters {
                frames_rx: 0,
                frames_tx: 0,
                exchanges: 0,
                refused_total: 0,
                refused: [0; Refusal::COUNT],
                cuts: 0,
                calls: [0; 2],
                ways: [0; 2],
                long_way: LongWay::None,
            },
            flash: Flash::new(),
            pins: Pins::new(),
            link: Link::new(),
            state_word: 0,
            path_stop: PathStop::new(),
            commit_pending: false,
            returned: None,
            select: 0,
            spoke: false,
            exchanges: false,
            flags: 0,
            committed: true,
            sampled_at: 0,
            frames: (0, 0),
            restart: false,
            nameless: matches!(boot.reset, ResetReason::PowerUp),
            ip: 0,
        }
    }

    /// Ends start-up: gate closed, machine at rest.
    pub fn start<B: Board>(&mut self, board: &mut B) {
        let event = Event::Booted {
            abi_fits: self.ident.abi == self.abi,
            reset: self.boot.reset,
            close: last_close(board),
        };
        self.event(board, event);
        self.poll(board);
    }

    /// The gateware's identity.
    pub fn ident(&self) -> &Ident {
        &self.ident
    }

    /// Records in the description what became of the services, and with them of jobs.
    pub fn jobs(&mut self, state: JobsState) {
        self.ident.features &= !(JobsState::MASK << JobsState::AT);
        self.ident.features |= state.code() << JobsState::AT;
        self.refresh();
    }

    /// Has the board the memory that the services need?
    pub fn has_sdram(&self) -> bool {
        match JobsState::of(self.ident.features) {
            JobsState::None | JobsState::Streamed => false,
            JobsState::Alive
            | JobsState::Sdram
            | JobsState::Missing
            | JobsState::Damaged
            | JobsState::Foreign
            | JobsState::Ended
            | JobsState::Loading
            | JobsState::GivenUp => true,
        }
    }

    /// The lengths of this board's blocks.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// The state machine.
    pub fn safety(&self) -> &Safety {
        &self.safety
    }

    /// The session.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The counters.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The counters, for the transport that counts frames.
    pub fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    /// The flash.
    pub fn flash(&self) -> &Flash {
        &self.flash
    }

    /// The link.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// The number and the reason of this start.
    pub fn boot(&self) -> Boot {
        self.boot
    }

    /// Firmware's ABI number.
    pub fn abi(&self) -> u32 {
        self.abi
    }

    /// A client with the right to do so has requested a restart.
    pub fn wants_restart(&self) -> bool {
        self.restart
    }

    /// Asks for a restart.
    pub(crate) fn restart(&mut self) {
        self.restart = true;
    }

    /// Looks at the link. After three looks in a row that see it down, the machine treats it as
    /// down for good.
    #[inline(always)]
    pub fn look_at_link<B: Board>(&mut self, board: &mut B) {
        let now = board.link();
        if !self.link.same(now) {
            self.link_changed(board, now);
        }
    }

    #[cold]
    #[inline(never)]
    fn link_changed<B: Board>(&mut self, board: &mut B, now: crate::cores::Link) {
        // A job checks by itself whether its client is present: an unattended job runs on.
        if self.link.look(now) && !self.session.is_owner(Peer::INSIDE) {
            self.event(board, Event::LinkDown);
        }
        self.refresh();
    }

    fn refresh(&mut self) {
        self.state_word = self.state(Gate(0), false).to_word();
    }

    /// Counts a refusal.
    #[cold]
    pub fn refuse(&mut self, why: Refusal) {
        self.counters.refused_total = self.counters.refused_total.wrapping_add(1);
        if let Some(count) = self.counters.refused.get_mut(why.index()) {
            *count = count.wrapping_add(1);
        }
    }

    /// Judges a datagram and executes it. An answer, if there is one, is in `reply`.
    pub fn datagram<'r, B: Board>(
        &mut self,
        board: &mut B,
        words: &[u32],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        match self.serve(board, words, peer, reply) {
            Ok(length) => Ok(reply.get(..length).unwrap_or(&[])),
            Err(why) => {
                self.refuse(why);
                Err(why)
            }
        }
    }

    /// While the machine is not at rest, it has little time for senders that do not own the
    /// session.
    fn welcome(&self, words: usize, peer: Peer) -> Result<(), Refusal> {
        if words <= wire::GUEST_WORDS || self.safety.at_rest() || self.session.is_owner(peer) {
            Ok(())
        } else {
            Err(Refusal::Oversized)
        }
    }

    /// Does what is due without a datagram: the gate's own decisions, silent owners, the LED, rest.
    /// Call it a few hundred times a second; it is cheap.
    #[inline(always)]
    pub fn poll<B: Board>(&mut self, board: &mut B) {
        let gate = board.gate();
        if self.safety.running(gate) {
            self.safety.seen(board.now_lo());
        } else {
            self.look_after(board, gate);
        }
    }

    /// Does the machine run undisturbed, with the link as it was and no operation of the flash?
    /// Then [`Server::poll`] and [`Server::look_at_link`] need not be called.
    pub(crate) fn runs<B: Board>(&mut self, board: &mut B) -> bool {
        let gate = board.gate();
        let runs = !self.flash.busy() && self.safety.running(gate) && self.link.same(board.link());
        if runs {
            self.safety.seen(board.now_lo());
        }
        runs
    }

    /// What [`Server::poll`] does unless the machine runs undisturbed.
    #[inline(never)]
    fn look_after<B: Board>(&mut self, board: &mut B, gate: Gate) {
        self.event(board, Event::Gate(gate));
        let now = board.now();
        if core::mem::take(&mut self.spoke) {
            self.session.heard(now);
        }
        if self.counters.frames_rx != self.frames.0 {
            self.frames = (self.counters.frames_rx, now);
        }
        if self.safety.at_rest() {
            if self.session.silent(now, self.ident.clock_hz) {
                self.session.kill();
                self.event(board, Event::Lost);
            }
            if self.committed {
                self.rest(board);
            }
            let period = u64::from(self.ident.clock_hz / IDLE_SAMPLE_PER_SECOND);
            if self.session.owner().is_none() && now.wrapping_sub(self.sampled_at) >= period {
                self.sampled_at = now;
                board.strobe(timebase::STROBE_SAMPLE);
            }
        }
        board.led(self.led(gate, now));
    }

    /// The state of the machine, for the session's owner or for another client.
    fn state(&self, gate: Gate, session_yours: bool) -> StateWord {
        StateWord {
            state: self.safety.state(),
            reason: self.safety.reason(),
            position_trusted: self.safety.position_trusted(),
            enabled: gate.open(),
            session_yours,
            bitten: gate.bitten(),
            external_reset: gate.reset_pin(),
            accepted: false,
            link: self.link.up(),
            estop: gate.estop(),
            speed: self.link.word().speed,
            services: JobsState::of(self.ident.features),
            link_errors: self.link.word().errors as u8,
        }
    }

    /// The state word without the bits that depend on the reader
    /// ([`crate::block::STATE_ANSWER`]).
    #[inline]
    pub fn state_word(&self, gate: Gate) -> u32 {
        let gate = if gate.0 == Gate::LIVE.0 {
            StateWord::ENABLED
        } else {
            u32::from(gate.open()) << 17
                | u32::from(gate.bitten()) << 19
                | u32::from(gate.reset_pin()) << 20
                | u32::from(gate.estop()) << 23
        };
        self.state_word | gate
    }

    /// Steps the state machine and executes its effects.
    pub(crate) fn event<B: Board>(&mut self, board: &mut B, event: Event) {
        let effects = self.step(event, board.now());
        self.obey(board, effects);
    }

    /// Steps the state machine; the effects are still to be executed.
    pub(crate) fn step(&mut self, event: Event, now: u64) -> Effects {
        self.follow(|safety| safety.step(event, now))
    }

    /// Keeps account of a transition of the state machine.
    #[inline(always)]
    pub(crate) fn follow(&mut self, transition: impl FnOnce(&mut Safety) -> Effects) -> Effects {
        let (trusted, state) = (self.safety.position_trusted(), self.safety.state());
        let effects = transition(&mut self.safety);
        // What a start finds is no cut of this start: counts begin again with it.
        let lost = trusted && !self.safety.position_trusted();
        if lost && state != wire::State::Boot {
            self.counters.cuts = self.counters.cuts.wrapping_add(1);
        }
        self.refresh();
        effects
    }

    /// Executes the effects of the state machine, except the commit.
    pub(crate) fn obey<B: Board>(&mut self, board: &mut B, effects: Effects) {
        if effects.end_session {
            self.session.kill();
        }
        if let Some(order) = effects.order {
            if order == Control::Arm {
                self.committed = true;
                board.led(Led::On);
                let grace = board.setting(Setting::Board(BoardConfig::WatchdogGrace));
                self.safety.opens(grace, board.now_lo());
            }
            board.control(order);
        }
    }

    /// Commits an all-zero command, so that no old command waits while the gate is closed. Gives
    /// the cores their configured decelerations back, and the outputs of a job back to the
    /// commands.
    fn rest<B: Board>(&mut self, board: &mut B) {
        if self.commit_pending {
            board.commit_at(u64::MAX);
            self.commit_pending = false;
        }
        for word in 0..command::WORDS {
            board.stage(word, 0);
        }
        board.strobe(timebase::STROBE_COMMIT);
        // Outputs that followed a job are the next session's.
        if self.ident.plays_segments() {
            board.csr_write(SEGMENTS_MASK, 0);
        }
        self.path_stop.end(board, self.shape.stepgens);
        self.committed = false;
    }

    fn led(&self, gate: Gate, now: u64) -> Led {
        use wire::State;
        let quiet = u64::from(QUIET_SECONDS) * u64::from(self.ident.clock_hz);
        let (frames, heard) = self.frames;
        match self.safety.state() {
            State::Boot => Led::Off,
            State::Disarmed | State::Faulted if gate.pinned() => Led::Triple,
            State::Disarmed if self.session.owner().is_some() => Led::Double,
            State::Disarmed if frames == 0 || now.wrapping_sub(heard) >= quiet => Led::Heartbeat,
            State::Disarmed => Led::Slow,
            State::Armed => Led::On,
            State::Stopping => Led::Flicker,
            State::Faulted => Led::Fast,
        }
    }

    fn serve<B: Board>(
        &mut self,
        board: &mut B,
        words: &[u32],
        peer: Peer,
        reply: &mut [u32; MAX_WORDS],
    ) -> Result<usize, Refusal> {
        let packet = Packet::new_checked(words)?;
        if packet.is_probe() {
            self.welcome(words.len(), peer)?;
            let mut writer = ReplyWriter::new(reply, etherbone::HEADER_PROBE_REPLY);
            writer.extend(packet.body());
            return Ok(writer.words().len());
        }
        if let Some(block) = self.find_exchange(&packet)? {
            let mut writer = ReplyWriter::new(reply, etherbone::HEADER);
            let [_, _, record] = reply_head(&self.shape);
            writer.push(record);
            self.exchange(board, peer, block, &mut writer)?;
            debug_assert_eq!(writer.words().len(), REPLY_OVERHEAD + self.shape.status);
            return Ok(if packet.no_reads() {
                0
            } else {
                writer.words().len()
            });
        }
        self.welcome(words.len(), peer)?;
        self.validate(board, &packet, peer)?;
        if self.session.is_owner(peer) {
            self.spoke = true;
            self.exchanges = false;
        }
        let mut writer = ReplyWriter::new(reply, etherbone::HEADER);
        for record in packet.records() {
            self.execute(board, &record, peer);
            if !record.reads.is_empty() && !packet.no_reads() {
                writer.write_record(record.return_base, record.reads.len() as u8);
                let mut description = None;
                for address in record.reads {
                    writer.push(self.read(board, *address, peer, &mut description));
                }
            }
        }
        let length = writer.words().len();
        Ok(if length > etherbone::HEADER_WORDS {
            length
        } else {
            0
        })
    }

    /// The command block, if this packet is an exchange; a refusal if it is a malformed one.
    fn find_exchange<'w>(&self, packet: &Packet<'w>) -> Result<Option<&'w [u32]>, Refusal> {
        let touches = |record: &Record| {
            let last = record
                .write_base
                .saturating_add(4 * record.writes.len() as u32);
            !record.writes.is_empty() && record.write_base < COMMAND_END && last > map::COMMAND
        };
        let Some(record) = packet.sole() else {
            return match packet.records().any(|record| touches(&record)) {
                true => Err(Refusal::NotAlone),
                false => Ok(None),
            };
        };
        if !touches(&record) {
            return Ok(None);
        }
        if !record.reads.is_empty() {
            return Err(Refusal::NotAlone);
        }
        if record.write_base != map::COMMAND || record.writes.len() != self.shape.command {
            return Err(Refusal::BlockLength);
        }
        Ok(Some(record.writes))
    }

    /// Would every record be accepted? Runs the writes against a copy of the session and the state.
    fn validate<B: Board>(
        &mut self,
        board: &mut B,
        packet: &Packet,
        peer: Peer,
    ) -> Result<(), Refusal> {
        let now = board.now();
        let arrival = board.arrival_lo();
        self.auth.stir(arrival);
        // The services ask at the same time after every power-up.
        if self.nameless && peer != Peer::INSIDE {
            self.nameless = false;
            self.boot.id = board.rename_boot(arrival);
        }
        let mut judge = Judge {
            ident: &self.ident,
            boot_id: self.boot.id,
            session: self.session,
            auth: &mut self.auth,
            answer: None,
            safety: self.safety,
            peer,
            now,
            flash_busy: self.flash.busy(),
            counted: false,
        };
        for record in packet.records() {
            if let (map::SESSION_RESPONSE, Ok(answer)) =
                (record.write_base, record.writes.try_into())
            {
                judge.answer = Some(answer);
            } else {
                for (address, value) in writes_of(&record)? {
                    judge.write(address, value)?;
                }
            }
            for address in record.reads {
                check_read(*address)?;
            }
        }
        Ok(())
    }

    fn execute<B: Board>(&mut self, board: &mut B, record: &Record, peer: Peer) {
        let Ok(writes) = writes_of(record) else {
            return; // `validate` made the same check
        };
        if !record.writes.is_empty() && self.committed && self.safety.at_rest() {
            // The next poll must not undo what is written now. A client that only reads changes
            // nothing.
            self.rest(board);
        }
        let mut levels = false;
        for (address, value) in writes {
            match address {
                map::SESSION_ACQUIRE => {
                    let now = board.now();
                    let boot_id = self.boot.id ^ self.auth.secret();
                    if self.session.acquire(peer, value, boot_id, now).is_ok() {
                        self.event(board, Event::Acquired);
                    }
                }
                map::SESSION_RELEASE => {
                    if self.session.release(peer, value).is_ok() {
                        self.event(board, Event::Lost);
                    }
                }
                map::SESSION_REBOOT => self.restart = true,
                map::SESSION_SEGMENTS => self.session.count_segments(),
                map::FLASH..FLASH_END => {
                    self.flash.write_word(board.spi(), address, value);
                    self.hold();
                }
                map::SERVICE.. => {
                    board.csr_write(address, value);
                    levels = true;
                }
                _ => {
                    if let Some(setting) = config::setting_at(address, self.ident.channels) {
                        board.set(setting, value);
                        levels |= pins::decides(setting);
                    }
                }
            }
        }
        if levels {
            self.follow_settings(board);
        }
    }

    /// Reads a word that [`check_read`] allowed. A read changes nothing but the challenge in force.
    /// The describe block is built once for all words of a record: that takes as long as twenty
    /// other words.
    fn read<B: Board>(
        &mut self,
        board: &mut B,
        address: u32,
        peer: Peer,
        description: &mut Option<[u32; describe::WORDS]>,
    ) -> u32 {
        match address {
            map::DESCRIBE..map::DESCRIBE_BLOB => description
                .get_or_insert_with(|| self.describe(board, peer))
                .get((address - map::DESCRIBE) as usize / 4)
                .copied()
                .unwrap_or(0),
            map::DESCRIBE_BLOB..map::SESSION => {
                let word = (address - map::DESCRIBE_BLOB) / 4;
                if word < self.ident.blob_words {
                    board.blob(word as usize)
                } else {
                    0
                }
            }
            map::SESSION_TOKEN => self.session.token_for(peer),
            map::SESSION_OWNER_IP => self.session.owner().map_or(0, |owner| owner.ip),
            map::SESSION_OWNER_PORT => self
                .session
                .owner()
                .map_or(0, |owner| u32::from(owner.port)),
            map::SESSION_LAST_SEQ => self.session.last_sequence(),
            map::SESSION_SEGMENTS => self.session.segments(),
            map::SESSION_CHALLENGE..map::SESSION_RESPONSE => {
                // While the session has an owner, other clients read zeros: a challenge would be of
                // no use to them, and the hash would delay the owner.
                if self.session.owner().is_some() && !self.session.is_owner(peer) {
                    return 0;
                }
                let word = (address - map::SESSION_CHALLENGE) / 4;
                self.auth.read(peer, word)
            }
            map::CONFIG..map::COMMAND => config::setting_at(address, self.ident.channels)
                .map_or(0, |setting| self.setting(board, setting)),
            map::STATUS..map::COUNTERS => {
                self.status_word(board, ((address - map::STATUS) / 4) as usize, peer)
            }
            map::COUNTERS..map::LOG => self.counter((address - map::COUNTERS) / 4),
            map::LOG => board.log(log::Read::Head),
            LOG_SIZE => board.log(log::Read::Size),
            LOG_BOOT => self.boot.id,
            map::LOG_RING..map::PANIC => {
                board.log(log::Read::Ring(((address - map::LOG_RING) / 4) as usize))
            }
            map::PANIC..PANIC_END => board.panic(address - map::PANIC),
            map::FLASH_LINK => self.link.word().to_word(),
            map::FLASH_IP => self.ip,
            map::FLASH..FLASH_END => self.flash.read_word(address),
            map::SERVICE.. => board.csr_read(address),
            _ => 0,
        }
    }

    #[inline(never)]
    fn describe<B: Board>(&self, board: &mut B, peer: Peer) -> [u32; describe::WORDS] {
        let state = self.state(board.gate(), self.session.is_owner(peer));
        let close = last_close(board);
        let mut describe = describe::describe(&self.ident, self.abi, self.boot, state, close);
        describe.obstacles |= self.held_by();
        if self.auth.locked() {
            describe.features |= FEATURE_KEY;
        }
        describe.to_words()
    }

    /// A setting as the host configured it.
    pub(crate) fn setting<B: Board>(&self, board: &mut B, which: Setting) -> u32 {
        let configured = self.path_stop.configured(which);
        configured.unwrap_or_else(|| board.setting(which))
    }

    /// A word of the last status block, for clients that do not own the session.
    fn status_word<B: Board>(&self, board: &mut B, word: usize, peer: Peer) -> u32 {
        let encoders_at = STATUS_HEAD + usize::from(self.ident.channels.stepgens) * STATUS_STEPGEN;
        let end = encoders_at + usize::from(self.ident.channels.encoders) * STATUS_ENCODER;
        let high = end..end + self.ident.channels.inputs_high();
        match word {
            status_word::STATE => {
                let gate = board.gate();
                self.state(gate, self.session.is_owner(peer)).to_word()
            }
            status_word::SEQUENCE => self.session.last_sequence(),
            status_word::ARRIVAL_LO => board.arrival_lo(),
            status_word::ARRIVAL_HI => board.arrival_hi(),
            status_word::SAMPLE_LO | status_word::SAMPLE_HI => {
                board.latched(status::SAMPLE_LO + word - status_word::SAMPLE_LO)
            }
            status_word::WATCHDOG_LEFT => board.watchdog_left(),
            status_word::REFUSED => self.counters.refused_total,
            status_word::BOOT_ID => self.boot.id,
            status_word::ESTOP => board.latched(status::ESTOP),
            status_word::GPIO_IN..=status_word::FLAGS2 => {
                board.latched(status::GPIO_IN + word - status_word::GPIO_IN)
            }
            status_word::LATCH => board.latched(status::ENCODER0_LATCH + self.select as usize),
            _ if word >= STATUS_HEAD && word < encoders_at => {
                board.latched(status::STEPGEN0_POSITION_LO + word - STATUS_HEAD)
            }
            _ if word >= encoders_at && word < end => {
                board.latched(status::ENCODER0_COUNT + word - encoders_at)
            }
            _ if high.contains(&word) => board.latched(status::GPIO_IN_HIGH),
            _ => 0,
        }
    }

    fn counter(&self, word: u32) -> u32 {
        match word {
            0 => self.counters.frames_rx,
            1 => self.counters.frames_tx,
            2 => self.counters.exchanges,
            CUTS_WORD => self.counters.cuts,
            WAYS_WORD..WAYS_END => {
                let [fast, long] = self.counters.ways;
                let all = [fast, long, self.counters.long_way as u32];
                all.get((word - WAYS_WORD) as usize).copied().unwrap_or(0)
            }
            CALLS_WORD..CALLS_END => {
                let [moving, other] = self.counters.calls;
                if word == CALLS_WORD { moving } else { other }
            }
            _ => self
                .counters
                .refused
                .get(word as usize - 3)
                .copied()
                .unwrap_or(0),
        }
    }
}

/// Why the gate closed last. A gateware that returns an unknown code was built from another map.
pub(crate) fn last_close(board: &mut impl Board) -> GateClose {
    GateClose::from_code(board.last_close() as u8).unwrap_or(GateClose::SystemReset)
}

const LOG_SIZE: u32 = map::LOG + 4;
const LOG_BOOT: u32 = map::LOG + 8;

#[cfg(test)]
mod tests;
