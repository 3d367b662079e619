//! The firmware less its IP stack: start-up, datagrams, chores, console.
//!
//! The image wraps this in frames and a TCP socket; the simulated board calls it from its own UDP and TCP
//! sockets, with models behind [`Board`]. Both in this order:
//!
//! ```text
//!   Machine::start           gate closed, settings, addresses, state machine out of Boot
//!   forever
//!     a datagram             Machine::datagram (words) or Machine::payload (bytes), then, if
//!                            Machine::due(BEHIND_A_FRAME), Machine::chores
//!     none, and due(IDLE)    Machine::chores
//!     a byte of the console  console::Line::push, and what it says into Machine::answer
//!     server.wants_restart   leave ResetReason::Requested in the postmortem record, start anew
//! ```
//!
//! The log is the board's: defmt's ring on the softcore, whatever a model keeps elsewhere
//! ([`crate::log::Ring`]). What is worth a line in it comes back from [`Machine::chores`].

use crate::console::{self, Ask, Vitals};
use crate::cores::{Board, Control, Ident, Setting};
use crate::net::{self, Us};
use crate::postmortem::Boot;
use crate::server::Server;
use crate::session::Peer;
use crate::text::Sink;
use wire::board::{Blob, Kind};
use wire::map::{BoardConfig, StepgenConfig};
use wire::{FaultReason, MAX_WORDS, Refusal, State};

/// Chores are due behind an answer once a period of theirs has passed: the next request is a whole servo
/// period away.
pub const BEHIND_A_FRAME: u32 = 1;
/// Without a frame they wait longer, lest they stand between a request and its answer.
pub const IDLE: u32 = 3;
/// Bytes of the board information ROM that are looked at.
pub const BLOB_MAX: usize = 2048;

/// A thousand chores a second: TCP timers and the LED are in no hurry, a bite should be told soon.
const CHORES_PER_SECOND: u32 = 1000;
/// 192.168.2.50, as Lcnc; for a board whose ROM names none.
const FALLBACK_IP: u32 = 0xc0a8_0232;
/// Locally administered; for a board whose ROM names none.
const FALLBACK_MAC: [u8; 6] = [0x12, 0xe2, 0xd5, 0, 0, 1];
/// 5 ms, hostmot2's default: five missed periods of a 1 kHz servo thread.
const WATCHDOG_PER_SECOND: u32 = 200;

/// A board and the judgement over it.
#[derive(Debug)]
pub struct Machine<B> {
    /// The board.
    pub board: B,
    /// Session, state machine, counters.
    pub server: Server,
    /// Our addresses.
    pub us: Us,
    told: State,
    chores_at: u32,
    chores_every: u32,
}

impl<B: Board> Machine<B> {
    /// Brings the board into a safe state, finds out where it is, and ends start-up. `abi` is the
    /// firmware's; `boot` comes from the postmortem record.
    pub fn start(mut board: B, ident: Ident, abi: u32, boot: Boot) -> Self {
        board.control(Control::Close);
        defaults(&mut board, &ident);
        let us = addresses(&mut board, &ident);
        let mut server = Server::new(ident, abi, boot);
        server.start(&mut board);
        Machine {
            chores_at: board.now_lo(),
            chores_every: ident.clock_hz / CHORES_PER_SECOND,
            told: server.safety().state(),
            board,
            server,
            us,
        }
    }

    /// Judges a datagram and executes it; what is to be sent back, if anything, is in `reply`.
    pub fn datagram<'r>(
        &mut self,
        words: &[u32],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        self.server.datagram(&mut self.board, words, peer, reply)
    }

    /// The same for a UDP payload as bytes, for transports whose frames are not words. Counts the frames.
    pub fn payload<'r>(
        &mut self,
        bytes: &[u8],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        let mut words = [0; MAX_WORDS];
        let counters = self.server.counters_mut();
        counters.frames_rx = counters.frames_rx.wrapping_add(1);
        let count = net::payload_words(bytes.len()).inspect_err(|why| self.server.refuse(*why))?;
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_be_bytes(*bytes);
        }
        let reply = self.datagram(words.get(..count).unwrap_or(&[]), peer, reply)?;
        let counters = self.server.counters_mut();
        counters.frames_tx = counters
            .frames_tx
            .wrapping_add(u32::from(!reply.is_empty()));
        Ok(reply)
    }

    /// Have so many periods passed since the last chores? Then they are due, and counted as done.
    #[inline(always)]
    pub fn due(&mut self, periods: u32) -> bool {
        let now = self.board.now_lo();
        let due = now.wrapping_sub(self.chores_at) >= self.chores_every * periods;
        if due {
            self.chores_at = now;
        }
        due
    }

    /// Looks after what happens without a datagram. A change of state comes back, to be logged.
    #[inline]
    pub fn chores(&mut self) -> Option<(State, FaultReason)> {
        self.server.poll(&mut self.board);
        let state = self.server.safety().state();
        let changed = state != core::mem::replace(&mut self.told, state);
        changed.then(|| (state, self.server.safety().reason()))
    }

    /// Answers a line of the console.
    #[inline]
    pub fn answer(&mut self, ask: Ask, vitals: &Vitals, out: &mut dyn Sink) {
        console::answer(ask, &self.server, &mut self.board, &self.us, vitals, out);
    }
}

/// What a board is before a host configures it: slow enough for any drive, watchful.
fn defaults(board: &mut impl Board, ident: &Ident) {
    let per_us = ident.clock_hz / 1_000_000;
    for n in 0..ident.channels.stepgens {
        // 5 us pulses, 20 us around a change of direction: slower than the slowest driver chip's data sheet.
        for (field, us) in [
            (StepgenConfig::Steplen, 5),
            (StepgenConfig::Stepspace, 5),
            (StepgenConfig::Dirsetup, 20),
            (StepgenConfig::Dirhold, 20),
        ] {
            board.set(Setting::Stepgen(n, field), us * per_us);
        }
    }
    board.set(
        Setting::Board(BoardConfig::WatchdogTimeout),
        ident.clock_hz / WATCHDOG_PER_SECOND,
    );
    // 1 s: longer than any soft stop a machine can be asked to make.
    board.set(Setting::Board(BoardConfig::WatchdogGrace), ident.clock_hz);
}

/// MAC, IP and port from the board information ROM.
fn addresses(board: &mut impl Board, ident: &Ident) -> Us {
    let mut us = Us {
        mac: FALLBACK_MAC,
        ip: FALLBACK_IP,
        port: wire::DEFAULT_PORT,
    };
    let mut bytes = [0; BLOB_MAX];
    let (chunks, _) = bytes.as_chunks_mut::<4>();
    for (index, chunk) in chunks
        .iter_mut()
        .take(ident.blob_words as usize)
        .enumerate()
    {
        *chunk = board.blob(index).to_be_bytes();
    }
    let Ok(blob) = Blob::new_checked(&bytes) else {
        return us;
    };
    for entry in blob.facts() {
        match entry.kind {
            Kind::Mac => us.mac = entry.value.try_into().unwrap_or(us.mac),
            Kind::Ipv4 => us.ip = entry.value.try_into().map_or(us.ip, u32::from_be_bytes),
            Kind::Port => us.port = entry.value.try_into().map_or(us.port, u16::from_be_bytes),
            Kind::Board
            | Kind::Configuration
            | Kind::Stepgen
            | Kind::Encoder
            | Kind::Pwm
            | Kind::Input
            | Kind::Output
            | Kind::Pins
            | Kind::Fpga
            | Kind::Platform => {}
        }
    }
    us
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fake::*;
    use wire::GateClose;

    fn ident() -> Ident {
        *Rig::new().server.ident()
    }

    fn machine(board: Notebook) -> Machine<Notebook> {
        Machine::start(board, ident(), ABI, BOOT)
    }

    fn read(address: u32) -> Vec<u8> {
        [0x4e6f_1044u32, 0, 0x000f_0001, 0x77, address]
            .iter()
            .flat_map(|word| word.to_be_bytes())
            .collect()
    }

    #[test]
    fn start_up_closes_the_gate_first_and_leaves_a_watchful_board() {
        let machine = machine(Notebook::new());
        assert_eq!(machine.board.done[0], Change::Order(Control::Close));
        let timeout = Setting::Board(BoardConfig::WatchdogTimeout);
        assert!(machine.board.done.contains(&Change::Set(timeout, 300_000)));
        let steplen = Setting::Stepgen(5, StepgenConfig::Steplen);
        assert!(machine.board.done.contains(&Change::Set(steplen, 300)));
        assert_eq!(machine.server.safety().state(), State::Disarmed);
    }

    #[test]
    fn every_default_is_a_value_the_setting_may_have() {
        for clock_hz in [40_000_000, 60_000_000, 125_000_000] {
            let mut board = Notebook::new();
            let ident = Ident {
                clock_hz,
                ..ident()
            };
            defaults(&mut board, &ident);
            for change in &board.done {
                let Change::Set(setting, value) = change else {
                    panic!("{change:?}");
                };
                let checked = crate::config::check(*setting, *value, SIX, clock_hz);
                assert_eq!(checked, Ok(()), "{setting:?} {value} at {clock_hz}");
            }
        }
    }

    #[test]
    fn a_board_without_addresses_gets_the_usual_ones() {
        let us = machine(Notebook::new()).us;
        assert_eq!((us.ip, us.port), (0xc0a8_0232, 1234));
    }

    #[test]
    fn a_payload_is_answered_counted_and_refused_like_a_frame() {
        let mut machine = machine(Notebook::new());
        let mut reply = [0; MAX_WORDS];
        let answer = machine.payload(&read(0x100), ALICE, &mut reply).unwrap();
        assert_eq!(answer[4], 0xb10b_0000);
        let ragged = machine.payload(&read(0)[..19], ALICE, &mut reply);
        assert_eq!(ragged, Err(Refusal::Ragged));
        let long = machine.payload(&[0; wire::MAX_PAYLOAD + 4], ALICE, &mut reply);
        assert_eq!(long, Err(Refusal::Oversized));
        let counters = machine.server.counters();
        assert_eq!((counters.frames_rx, counters.frames_tx), (3, 1));
        assert_eq!(counters.refused_total, 2);
    }

    #[test]
    fn chores_are_due_every_millisecond_behind_a_frame_and_later_without() {
        let mut machine = machine(Notebook::new());
        assert!(!machine.due(BEHIND_A_FRAME));
        machine.board.now += 60_000;
        assert!(!machine.due(IDLE));
        assert!(machine.due(BEHIND_A_FRAME));
        assert!(!machine.due(BEHIND_A_FRAME), "done");
        machine.board.now += 180_000;
        assert!(machine.due(IDLE));
    }

    #[test]
    fn a_change_of_state_is_told_once() {
        let mut board = Notebook::new();
        board.close = GateClose::Never as u32;
        let mut machine = machine(board);
        assert_eq!(machine.chores(), None);
        let mut rig = Rig::armed();
        core::mem::swap(&mut machine.server, &mut rig.server);
        core::mem::swap(&mut machine.board, &mut rig.board);
        assert_eq!(machine.chores(), Some((State::Armed, FaultReason::None)));
        assert_eq!(machine.chores(), None);
        machine.board.estop = true;
        let told = (State::Faulted, FaultReason::EStop);
        assert_eq!(machine.chores(), Some(told));
    }

    #[test]
    fn the_console_answers_through_the_machine() {
        let mut machine = machine(Notebook::new());
        let mut text = String::new();
        machine.answer(Ask::Net, &Vitals::default(), &mut text);
        assert!(text.contains("192.168.2.50:1234"), "{text}");
    }
}
