//! The firmware without its IP stack: start-up, datagrams, housekeeping, console.
//!
//! The image wraps this in frames and a TCP socket. The simulated board calls it from its own UDP
//! and TCP sockets, with models behind [`Board`]. Both call it in this order:
//!
//! ```text
//!   Machine::start           gate closed, settings, addresses, state machine out of Boot
//!   forever
//!     a datagram             Machine::datagram (words) or Machine::payload (bytes), then, if
//!                            Machine::due(BEHIND_A_FRAME), Machine::chores; Machine::hold_path once it is sent
//!     none, and due(IDLE)    Machine::chores
//!     a byte of the console  console::Line::push, and its result into Machine::answer
//!     a discovery datagram   Machine::discover; a DHCP server's: Machine::offered
//!     has_to_shout           Machine::shout, and broadcast it
//!     moved                  the address changed: tell the IP stack
//!     server.wants_restart   leave ResetReason::Requested in the postmortem record, start anew
//! ```
//!
//! The log belongs to the board: defmt's ring on the softcore, other storage in a model
//! ([`crate::log::Ring`]). [`Machine::chores`] returns the events that are worth a log line.

use crate::auth::{Words, by_port};
use crate::console::{self, Ask, Vitals};
use crate::cores::{Board, Control, Ident, Setting};
use crate::dhcp::{self, Client};
use crate::discovery::{self, Act, Names, Waiting};
use crate::net::{self, Us};
use crate::postmortem::Boot;
use crate::server::Server;
use crate::session::Peer;
use crate::text::Sink;
use wire::auth::Purpose;
use wire::board::{Blob, Kind};
use wire::discovery::{Body, Message, proof};
use wire::flash::{OpResult, OpWord};
use wire::images::{Trailer, idcode_of};
use wire::map::{BoardConfig, StepgenConfig};
use wire::settings::Settings;
use wire::{DISCOVERY_PORT, FaultReason, MAX_WORDS, Name, Refusal, State};

/// Housekeeping is due after an answer once one of its periods has passed: the next request is a
/// whole servo period away.
pub const BEHIND_A_FRAME: u32 = 1;
/// Without a frame it waits longer, so that it does not run between a request and its answer.
pub const IDLE: u32 = 3;
/// Bytes of the board information ROM that are read.
pub const BLOB_MAX: usize = wire::regmap::BOARD_ROM_SIZE;

/// Housekeeping runs a thousand times a second: TCP timers and the LED could wait, but a bite
/// should be reported soon.
const CHORES_PER_SECOND: u32 = 1000;
/// Locally administered; for a board without a MAC in its ROM and without a unique id in its flash.
const FALLBACK_MAC: [u8; 6] = [0x12, 0xe2, 0xd5, 0, 0, 1];
/// 5 ms, hostmot2's default: five missed periods of a 1 kHz servo thread.
const WATCHDOG_PER_SECOND: u32 = 200;

/// A datagram to be broadcast (255.255.255.255) by this board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shout {
    /// Source address.
    pub from_ip: u32,
    /// Source port.
    pub from_port: u16,
    /// Destination port.
    pub to_port: u16,
    /// Words of payload.
    pub words: usize,
}

/// A board and the server that judges its datagrams.
#[derive(Debug)]
pub struct Machine<B> {
    /// The board.
    pub board: B,
    /// Session, state machine, counters, flash, link.
    pub server: Server,
    /// Our addresses.
    pub us: Us,
    /// Bits of the netmask, and the gateway (0 for none).
    pub net: (u8, u32),
    names: Names,
    client: Client,
    waiting: Option<Waiting>,
    /// The result of a Set that has to be answered, if there is one.
    done: Option<OpResult>,
    ask: bool,
    /// The address changed and the transport has not been told.
    moved: bool,
    told: State,
    chores_at: u32,
    chores_every: u32,
    second_at: u32,
    second: u32,
}

impl<B: Board> Machine<B> {
    /// Brings the board into a safe state, finds its addresses, and ends start-up. `abi` is the
    /// firmware's; `boot` comes from the postmortem record.
    pub fn start(board: B, ident: Ident, abi: u32, boot: Boot) -> Self {
        let mut machine = Machine::asleep(board, ident, abi, boot);
        machine.wake();
        machine
    }

    /// The machine before start-up; [`Machine::wake`] comes next. The image builds it and wakes it
    /// in its final place: a move would put it on the stack twice.
    #[inline(never)]
    pub fn asleep(board: B, ident: Ident, abi: u32, boot: Boot) -> Self {
        Machine {
            board,
            server: Server::new(ident, abi, boot),
            us: Us {
                mac: FALLBACK_MAC,
                ip: 0,
                port: 0,
            },
            net: (0, 0),
            names: Names::default(),
            client: Client::off(),
            waiting: None,
            done: None,
            ask: false,
            moved: false,
            told: State::Boot,
            chores_at: 0,
            chores_every: ident.clock_hz / CHORES_PER_SECOND,
            second_at: 0,
            second: 0,
        }
    }

    /// Closes the gate, gives every setting its default, reads the board's identity and addresses,
    /// and ends start-up.
    #[inline(never)]
    pub fn wake(&mut self) {
        let (ident, boot) = (self.server.ident, self.server.boot);
        self.board.control(Control::Close);
        defaults(&mut self.board, &ident);
        self.find_itself(&ident, boot);
        self.server.start(&mut self.board);
        let now = self.board.now_lo();
        self.chores_at = now;
        self.second_at = now;
        self.told = self.server.safety().state();
        self.ask = self.client.tick(0);
    }

    /// Reads the built-in and the saved settings: the board's identity and addresses.
    #[inline(never)]
    fn find_itself(&mut self, ident: &Ident, boot: Boot) {
        let mut built = Built::new();
        built.read(&mut self.board, ident);
        self.names = built.names;
        let trailer = Trailer::from_words(self.board.trailer());
        let factory = self.board.factory_pin();
        let flash = &mut self.server.flash;
        let spi = self.board.spi();
        flash.start(spi, trailer, built.idcode, built.settings, factory);
        let [uid_hi, uid_lo] = flash.uid();
        let settings = flash.settings();
        self.server.auth.lock(settings.key);
        if settings.mac != [0; 6] {
            self.us.mac = settings.mac;
        }
        self.us.port = settings.port;
        self.net = (settings.prefix, settings.gateway);
        if settings.dhcp {
            // The board has no address while it asks a DHCP server.
            self.client = Client::on(boot.id ^ uid_hi ^ uid_lo.rotate_left(16));
        } else {
            self.us.ip = settings.ip;
        }
        self.server.ip = self.us.ip;
    }

    /// Judges a datagram and executes it; an answer, if there is one, is in `reply`.
    pub fn datagram<'r>(
        &mut self,
        words: &[u32],
        peer: Peer,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> Result<&'r [u32], Refusal> {
        if peer.ip == Peer::INSIDE.ip {
            // No frame on the wire can have this sender.
            return Err(Refusal::NotOwner);
        }
        self.server.datagram(&mut self.board, words, peer, reply)
    }

    /// The same for a datagram of the jobs program, which runs on this board and needs no key. It
    /// gets its answer at once, so `hold` runs right after it: [`Machine::hold_path`], or a
    /// function that calls it.
    pub fn inside<'r>(
        &mut self,
        words: &[u32],
        reply: &'r mut [u32; MAX_WORDS],
        hold: impl FnOnce(&mut Self),
    ) -> Result<&'r [u32], Refusal> {
        let answer = self
            .server
            .datagram(&mut self.board, words, Peer::INSIDE, reply);
        if self.server.owes_path() {
            hold(self);
        }
        answer
    }

    /// Makes the decelerations fit the command that was executed last. Call it after every answer
    /// if [`Server::owes_path`].
    #[inline(always)]
    pub fn hold_path(&mut self) {
        self.server.hold_path(&mut self.board);
    }

    /// The same for a UDP payload as bytes, for transports with other frames than words. Counts the
    /// frames.
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

    /// Have this many periods passed since the last housekeeping? Then it is due, and counted as
    /// done.
    #[inline(always)]
    pub fn due(&mut self, periods: u32) -> bool {
        let now = self.board.now_lo();
        let due = now.wrapping_sub(self.chores_at) >= self.chores_every * periods;
        if due {
            self.chores_at = now;
        }
        due
    }

    /// Does what is due without a datagram. Returns a change of state, to be logged.
    #[inline]
    pub fn chores(&mut self) -> Option<(State, FaultReason)> {
        if self.server.flash.busy() {
            self.slice();
        } else {
            self.server.look_at_link(&mut self.board);
        }
        self.server.poll(&mut self.board);
        let clock_hz = self.server.ident.clock_hz;
        if self.chores_at.wrapping_sub(self.second_at) >= clock_hz {
            self.second_passed(clock_hz);
        }
        let state = self.server.safety().state();
        let changed = state != core::mem::replace(&mut self.told, state);
        changed.then(|| (state, self.server.safety().reason()))
    }

    /// One slice of the flash operation. While an operation runs, housekeeping runs without a
    /// pause.
    #[cold]
    #[inline(never)]
    fn slice(&mut self) {
        let done = self.server.poll_flash(&mut self.board);
        self.chores_every = 0;
        if done {
            self.chores_every = self.server.ident.clock_hz / CHORES_PER_SECOND;
            if self.waiting.is_some() {
                self.done = Some(self.server.flash.word().result);
            }
        }
    }

    #[cold]
    #[inline(never)]
    fn second_passed(&mut self, clock_hz: u32) {
        self.second_at = self.second_at.wrapping_add(clock_hz);
        self.second = self.second.wrapping_add(1);
        self.server.auth.tick();
        if self.client.enabled() {
            self.ask |= self.client.tick(self.second);
            self.settle();
        }
    }

    /// Puts the current address into force. It does not change while a host owns the session.
    fn settle(&mut self) {
        let settings = self.server.flash.settings();
        let (ip, net) = match self.client.lease() {
            Some(lease) => (lease.ip, (lease.prefix, lease.gateway)),
            None if self.client.gave_up(self.second) => {
                (settings.ip, (settings.prefix, settings.gateway))
            }
            None => return,
        };
        let same = ip == self.us.ip && net == self.net;
        if !same && self.server.safety().at_rest() && self.server.session().owner().is_none() {
            self.us.ip = ip;
            self.server.ip = ip;
            self.net = net;
            self.moved = true;
        }
    }

    /// Has the address changed since this was last asked?
    pub fn moved(&mut self) -> bool {
        core::mem::take(&mut self.moved)
    }

    /// Judges a datagram, as words, that came to [`DISCOVERY_PORT`]. `reply` is to be broadcast to
    /// `port`, the port the datagram came from; if it is empty, there is no answer.
    pub fn discover<'r>(
        &mut self,
        words: &[u32],
        port: u16,
        reply: &'r mut [u32; MAX_WORDS],
    ) -> &'r [u32] {
        let message = match Message::parse_request(words) {
            Ok(message) => message,
            Err(why) => {
                self.server.refuse(why);
                return &[];
            }
        };
        let dhcp = self
            .client
            .lease()
            .is_some_and(|lease| lease.ip == self.us.ip);
        let here = || discovery::here(&self.server, &self.us, dhcp, &self.names);
        let body = match discovery::judge(&message, &self.server, self.waiting, here) {
            Act::Nothing => return &[],
            Act::Answer(body) => body,
            Act::Save(settings) => match self.prove(words, port) {
                Err(challenge) => Body::Prove(challenge),
                Ok(()) => {
                    self.server.save(&mut self.board, settings);
                    let OpWord { busy, result, .. } = self.server.flash.word();
                    if busy {
                        let nonce = message.nonce;
                        self.waiting = Some(Waiting { nonce, port });
                        return &[];
                    }
                    Body::Done(result)
                }
            },
        };
        let uid = self.server.flash.uid();
        let nonce = message.nonce;
        emit(&Message { nonce, uid, body }, reply)
    }

    /// Has the sender proved that it has the key? If not, the error is a challenge to prove it
    /// with.
    fn prove(&mut self, words: &[u32], port: u16) -> Result<(), Words> {
        let (signed, answer) = proof(words).unzip();
        let from = by_port(port);
        let auth = &mut self.server.auth;
        auth.stir(self.board.arrival_lo());
        let Err(why) = auth.prove(from, Purpose::Set, signed.unwrap_or(&[]), answer) else {
            return Ok(());
        };
        let challenge = *auth.challenge(from);
        // A sender that was not asked for a proof yet has done nothing wrong.
        if answer.is_some() {
            self.server.refuse(why);
        }
        Err(challenge)
    }

    /// Takes a datagram of this many bytes that came to [`dhcp::PORT`].
    pub fn offered(&mut self, words: &[u32], length: usize) {
        let client = &mut self.client;
        self.ask |= client.take(self.us.mac, words, length, self.second);
        if client.enabled() {
            self.settle();
        }
    }

    /// Is there something to broadcast ([`Machine::shout`])? Ask after housekeeping and after a
    /// datagram.
    #[inline(always)]
    pub fn has_to_shout(&self) -> bool {
        self.ask || self.moved || self.done.is_some()
    }

    /// Writes what is to be broadcast into `words`. The answer to a Set that was saved is the last
    /// one: the machine wants a restart after it.
    pub fn shout(&mut self, words: &mut [u32; MAX_WORDS]) -> Option<Shout> {
        if let (Some(result), Some(waiting)) = (self.done.take(), self.waiting.take()) {
            if result == OpResult::Ok {
                self.server.restart();
            }
            let message = Message {
                nonce: waiting.nonce,
                uid: self.server.flash.uid(),
                body: Body::Done(result),
            };
            return Some(Shout {
                from_ip: self.us.ip,
                from_port: DISCOVERY_PORT,
                to_port: waiting.port,
                words: emit(&message, words).len(),
            });
        }
        if !core::mem::take(&mut self.ask) {
            return None;
        }
        let name = self.server.flash.settings().name;
        let place = words.first_chunk_mut()?;
        self.client.emit(self.us.mac, name.text(), place);
        Some(Shout {
            from_ip: self.client.lease().map_or(0, |lease| lease.ip),
            from_port: dhcp::PORT,
            to_port: dhcp::SERVER_PORT,
            words: dhcp::WORDS,
        })
    }

    /// A new client is at the console.
    pub fn greet(&mut self) {
        self.server.auth.greet();
    }

    /// May the client of the console do more than look?
    pub fn trusted(&self) -> bool {
        self.server.auth.trusted()
    }

    /// Answers a line of the console. Afterwards the server may want a restart.
    #[inline]
    pub fn answer(&mut self, ask: Ask, vitals: &Vitals, out: &mut dyn Sink) {
        console::answer(
            ask,
            &mut self.server,
            &mut self.board,
            &self.us,
            vitals,
            out,
        );
    }
}

/// The board's settings before a host configures it: slow enough for any drive, with the watchdog
/// on.
fn defaults(board: &mut impl Board, ident: &Ident) {
    let per_us = ident.clock_hz / 1_000_000;
    for n in 0..ident.channels.stepgens {
        // 5 us pulses, 20 us around a change of direction: slower than the slowest driver chip's
        // data sheet.
        for (field, us) in [
            (StepgenConfig::Steplen, 5),
            (StepgenConfig::Stepspace, 5),
            (StepgenConfig::Dirsetup, 20),
            (StepgenConfig::Dirhold, 20),
            // The gateware's power-up value: a restart forgets decelerations that were adapted to a
            // path.
            (StepgenConfig::StopAccel, 0),
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

fn emit<'r>(message: &Message, words: &'r mut [u32; MAX_WORDS]) -> &'r [u32] {
    match words.first_chunk_mut() {
        Some(room) => message.emit_answer(room),
        None => &[], // a message is shorter than a frame
    }
}

/// What the board information ROM says about the board's identity and addresses.
struct Built {
    settings: Settings,
    names: Names,
    idcode: Option<u32>,
}

impl Built {
    fn new() -> Self {
        Built {
            settings: Settings::BUILT_IN,
            names: Names::default(),
            idcode: None,
        }
    }

    #[inline(never)]
    fn read(&mut self, board: &mut impl Board, ident: &Ident) {
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
            return;
        };
        let us = &mut self.settings;
        for entry in blob.facts() {
            let text = || core::str::from_utf8(entry.value).unwrap_or("");
            match entry.kind {
                Kind::Mac => us.mac = entry.value.try_into().unwrap_or(us.mac),
                Kind::Ipv4 => us.ip = entry.value.try_into().map_or(us.ip, u32::from_be_bytes),
                Kind::Port => us.port = entry.value.try_into().map_or(us.port, u16::from_be_bytes),
                Kind::Configuration => self.names.configuration = Name::cut(text()),
                Kind::Platform => self.names.platform = Name::cut(text()),
                Kind::Fpga => self.idcode = idcode_of(text()),
                Kind::Board
                | Kind::Stepgen
                | Kind::Encoder
                | Kind::Pwm
                | Kind::Input
                | Kind::Output
                | Kind::Pins => {}
            }
        }
    }
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
    fn no_sender_on_the_wire_is_taken_for_the_jobs_program() {
        let mut machine = machine(Notebook::new());
        let mut reply = [0; MAX_WORDS];
        for port in [0, 724] {
            let peer = Peer {
                port,
                ..Peer::INSIDE
            };
            let refused = machine.payload(&read(0), peer, &mut reply);
            assert_eq!(refused, Err(Refusal::NotOwner));
        }
        let request = [0x4e6f_1044u32, 0, 0x000f_0001, 0x77, 0];
        let answer = machine
            .inside(&request, &mut reply, Machine::hold_path)
            .unwrap();
        assert_eq!(answer[4], wire::describe::MAGIC);
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

    fn ask(machine: &mut Machine<Notebook>, message: &Message) -> Option<Message> {
        let mut words = [0; wire::discovery::WORDS_MAX];
        let mut reply = [0; MAX_WORDS];
        let answer = machine.discover(message.emit(&mut words), 50_000, &mut reply);
        (!answer.is_empty()).then(|| Message::parse(answer).unwrap())
    }

    fn message(uid: [u32; 2], body: Body) -> Message {
        Message {
            nonce: 99,
            uid,
            body,
        }
    }

    const UID: [u32; 2] = [0x0102_0304, 0x0506_0708];

    /// Runs housekeeping and broadcasts until nothing is left to do.
    fn shouts(machine: &mut Machine<Notebook>) -> Vec<(Shout, Vec<u32>)> {
        let mut all = Vec::new();
        for _ in 0..100 {
            machine.chores();
            let mut words = [0; MAX_WORDS];
            if machine.has_to_shout()
                && let Some(shout) = machine.shout(&mut words)
            {
                all.push((shout, words[..shout.words].to_vec()));
            }
        }
        all
    }

    #[test]
    fn a_board_is_found_by_any_host_and_by_its_own_id() {
        let mut machine = machine(Notebook::new());
        for (uid, found) in [([0, 0], true), (UID, true), ([1, 2], false)] {
            let answer = ask(&mut machine, &message(uid, Body::Discover));
            assert_eq!(answer.is_some(), found);
            if let Some(answer) = answer {
                assert_eq!((answer.nonce, answer.uid), (99, UID));
                let Body::Here(here) = answer.body else {
                    panic!("{answer:?}");
                };
                assert_eq!((here.ip, here.port, here.mac[0]), (0xc0a8_0232, 1234, 2));
                assert!(!here.armed && !here.owned && !here.dhcp);
            }
        }
        let mut reply = [0; MAX_WORDS];
        assert!(machine.discover(&[1, 2, 3], 5, &mut reply).is_empty());
        assert_eq!(machine.server.counters().refused_total, 1);
    }

    #[test]
    fn a_board_saves_the_settings_it_gets_confirms_them_and_restarts() {
        let mut machine = machine(Notebook::new());
        let settings = Settings {
            ip: 0x0a00_0002,
            name: Name::new("mill").unwrap(),
            ..Settings::default()
        };
        let set = message(UID, Body::Set(settings));
        assert_eq!(
            ask(&mut machine, &message([0; 2], set.body)),
            None,
            "for another board"
        );
        assert_eq!(ask(&mut machine, &set), None, "not yet");
        assert_eq!(ask(&mut machine, &set), None, "repeated, still not saved");
        assert!(!machine.server.wants_restart());
        let told = shouts(&mut machine);
        let [(shout, words)] = &told[..] else {
            panic!("{told:?}");
        };
        assert_eq!((shout.from_port, shout.to_port), (51234, 50_000));
        let done = message(UID, Body::Done(OpResult::Ok));
        assert_eq!(Message::parse(words), Ok(done));
        assert!(machine.server.wants_restart());
        let mut again = Machine::start(machine.board, ident(), ABI, BOOT);
        assert_eq!(again.us.ip, 0x0a00_0002);
        assert_eq!(ask(&mut again, &set), Some(done), "saved already");
        assert!(!again.server.wants_restart());
    }

    #[test]
    fn a_board_that_is_armed_or_owned_is_not_told_anything() {
        let mut machine = machine(Notebook::new());
        let set = message(UID, Body::Set(Settings::default()));
        let mut rig = Rig::new();
        rig.acquire();
        for armed in [false, true] {
            if armed {
                rig.arm();
            }
            core::mem::swap(&mut machine.server.session, &mut rig.server.session);
            core::mem::swap(&mut machine.server.safety, &mut rig.server.safety);
            let refused = message(UID, Body::Done(OpResult::Armed));
            assert_eq!(ask(&mut machine, &set), Some(refused));
            core::mem::swap(&mut machine.server.session, &mut rig.server.session);
            core::mem::swap(&mut machine.server.safety, &mut rig.server.safety);
        }
        assert!(machine.board.chip.writes.is_empty());
    }

    #[test]
    fn a_board_with_dhcp_asks_falls_back_after_ten_seconds_and_asks_on() {
        let mut board = Notebook::new();
        let settings = Settings {
            dhcp: true,
            ..Settings::default()
        };
        let mut words = [0; 128];
        wire::words_to_bytes(&settings.to_words(), &mut words);
        board.chip.put(0x1f_0000, &words);
        let mut machine = machine(board);
        assert_eq!(machine.us.ip, 0, "none yet");
        let asked = shouts(&mut machine);
        assert_eq!((asked[0].0.from_ip, asked[0].0.to_port), (0, 67));
        let mut seconds = Vec::new();
        for second in 1..=16 {
            machine.board.now += u64::from(CLOCK);
            machine.due(IDLE);
            if shouts(&mut machine)
                .iter()
                .any(|(shout, _)| shout.to_port == 67)
            {
                seconds.push(second);
            }
            let ip = if second < 10 { 0 } else { settings.ip };
            assert_eq!(machine.us.ip, ip, "second {second}");
        }
        assert_eq!(seconds, [2, 6, 14]);
        assert!(machine.moved() && !machine.moved());
    }

    #[test]
    fn a_cable_that_is_pulled_stops_the_machine_at_the_third_look() {
        let mut machine = machine(Notebook::new());
        let mut rig = Rig::armed();
        core::mem::swap(&mut machine.server, &mut rig.server);
        core::mem::swap(&mut machine.board, &mut rig.board);
        machine.chores();
        machine.board.link.status = 0;
        assert_eq!((machine.chores(), machine.chores()), (None, None));
        let told = (State::Stopping, FaultReason::LinkDown);
        assert_eq!(machine.chores(), Some(told));
        let word = machine.server.state_word(crate::cores::Gate::LIVE);
        let word = wire::exchange::StateWord::from_word(word).unwrap();
        assert!(!word.link && word.speed == wire::LinkSpeed::Down);
    }

    #[test]
    fn speed_and_errors_are_in_every_answer() {
        let mut machine = machine(Notebook::new());
        machine.board.link.errors = 0x102;
        machine.chores();
        let word = machine.server.state_word(crate::cores::Gate(0));
        let word = wire::exchange::StateWord::from_word(word).unwrap();
        assert!(word.link && word.speed == wire::LinkSpeed::M1000);
        assert_eq!(word.link_errors, 2);
    }

    #[test]
    fn the_factory_pin_at_start_gives_the_built_in_address() {
        let mut board = Notebook::new();
        let settings = Settings {
            ip: 0x0a00_0002,
            ..Settings::default()
        };
        let mut bytes = [0; 128];
        wire::words_to_bytes(&settings.to_words(), &mut bytes);
        board.chip.put(0x1f_1000, &bytes);
        assert_eq!(machine(board.clone()).us.ip, 0x0a00_0002);
        board.factory = true;
        assert_eq!(machine(board).us.ip, 0xc0a8_0232);
    }
}
