//! The firmware without its IP stack: start-up, datagrams, housekeeping, and the rights of clients.
//!
//! The image adds frames and the services. The simulated board calls it from its own UDP and TCP
//! sockets, and implements [`Board`] with models. Both call it in this order:
//!
//! ```text
//!   Machine::start           gate closed, settings, addresses, state machine out of Boot
//!   forever
//!     a datagram             Machine::datagram (words) or Machine::payload (bytes), then, if
//!                            Machine::due(Machine::patience), Machine::housekeeping;
//!                            Machine::hold_path once it is sent
//!     none, and due(IDLE)    Machine::housekeeping
//!     a client of a console  Machine::visit: may it?
//!     a discovery datagram   Machine::discover
//!     the services           Machine::leased: an address from a DHCP server, or none any more
//!     has_broadcast          Machine::next_broadcast, and broadcast it
//!     moved                  the address changed: tell the IP stack
//!     server.wants_restart   leave ResetReason::Requested in the postmortem record, restart
//! ```
//!
//! The log belongs to the board: defmt's ring on the softcore, other storage in a model
//! ([`crate::log::Ring`]). [`Machine::housekeeping`] returns the events that are worth a log line.

use crate::auth::{Words, by_port};
use crate::cores::{Board, Control, Ident, Setting};
use crate::discovery::{self, Act, Names, Waiting};
use crate::net::{self, Us};
use crate::postmortem::Boot;
use crate::server::Server;
use crate::session::Peer;
use wire::auth::Purpose;
use wire::board::{Blob, Kind};
use wire::discovery::{Body, Message, proof};
use wire::flash::{OpResult, OpWord};
use wire::images::{Trailer, idcode_of};
use wire::map::{BoardConfig, StepgenConfig};
use wire::settings::{Settings, unicast};
use wire::{DISCOVERY_PORT, FaultReason, MAX_WORDS, Name, Refusal, State};

/// Housekeeping is due after an answer to the owner once one of its periods has passed: the next
/// request is a whole servo period away.
const BEHIND_AN_ANSWER: u32 = 1;
/// Without a frame it waits longer, so that it does not run between a request and its answer.
pub const IDLE: u32 = 3;
/// Behind another datagram of the owner it waits for 20 us without a frame, for ten of its periods
/// at most: the next one comes as soon as this one is answered, and may be the first exchange.
const BETWEEN_REQUESTS: u32 = 10;
/// 10 s without a lease: three tries of the services. A board on a bench without a server should be
/// usable before its user gives up. The services go on asking.
pub const FALLBACK_SECONDS: u32 = 10;
/// Bytes of the board information ROM that are read.
pub const BLOB_MAX: usize = wire::regmap::BOARD_ROM_SIZE;

/// Housekeeping runs a thousand times a second: TCP timers and the LED could wait, but a bite
/// should be reported soon.
const HOUSEKEEPING_PER_SECOND: u32 = 1000;
/// Locally administered; for a board without a MAC in its ROM and without a unique id in its flash.
const FALLBACK_MAC: [u8; 6] = [0x12, 0xe2, 0xd5, 0, 0, 1];
/// 5 ms, hostmot2's default: five missed periods of a 1 kHz servo thread.
const WATCHDOG_PER_SECOND: u32 = 200;

/// A datagram to be broadcast (255.255.255.255) by this board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Broadcast {
    /// Source address.
    pub from_ip: u32,
    /// Source port.
    pub from_port: u16,
    /// Destination port.
    pub to_port: u16,
    /// Words of payload.
    pub words: usize,
}

/// An address from a DHCP server, which the services have requested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lease {
    /// Our address.
    pub ip: u32,
    /// Bits of its netmask.
    pub prefix: u8,
    /// The router, 0 for none.
    pub gateway: u32,
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
    /// The settings ask for an address from a DHCP server.
    dhcp: bool,
    lease: Option<Lease>,
    waiting: Option<Waiting>,
    /// The result of a Set that has to be answered, if there is one.
    done: Option<OpResult>,
    /// The address changed and the transport has not been told.
    moved: bool,
    told: State,
    housekeeping_at: u32,
    housekeeping_every: u32,
    second_at: u32,
    second: u32,
    /// A bit for each client of the services' consoles: it has proved that it has the key.
    friends: u8,
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
            dhcp: false,
            lease: None,
            waiting: None,
            done: None,
            moved: false,
            told: State::Boot,
            housekeeping_at: 0,
            housekeeping_every: ident.clock_hz / HOUSEKEEPING_PER_SECOND,
            second_at: 0,
            second: 0,
            friends: 0,
        }
    }

    /// Closes the gate, gives every setting its default, configures the pins, reads the board's
    /// identity and addresses, and ends start-up.
    #[inline(never)]
    pub fn wake(&mut self) {
        let ident = self.server.ident;
        self.board.control(Control::Close);
        defaults(&mut self.board, &ident);
        let trailer = Trailer::from_words(self.board.trailer());
        let factory = self.server.find_pins(&mut self.board, trailer);
        self.find_itself(factory);
        self.server.start(&mut self.board);
        let now = self.board.now_lo();
        self.housekeeping_at = now;
        self.second_at = now;
        self.told = self.server.safety().state();
    }

    /// Reads the built-in and the saved settings: the board's identity and addresses.
    #[inline(never)]
    fn find_itself(&mut self, factory: bool) {
        let mut built = Built::new();
        built.read(&mut self.board, &self.server.ident);
        self.names = built.names;
        let flash = &mut self.server.flash;
        let spi = self.board.spi();
        flash.start(spi, built.idcode, built.settings, factory);
        let settings = flash.settings();
        self.server.auth.lock(settings.key);
        if settings.mac != [0; 6] {
            self.us.mac = settings.mac;
        }
        self.us.port = settings.port;
        self.net = (settings.prefix, settings.gateway);
        self.dhcp = settings.dhcp;
        if !settings.dhcp {
            // The board has no address while the services ask a DHCP server.
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

    /// The same for a datagram of the services, which run on this board and need no key. They
    /// get their answer at once, so `hold` runs right after it: [`Machine::hold_path`], or a
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
        self.received();
        let count = net::payload_words(bytes.len()).inspect_err(|why| self.server.refuse(*why))?;
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_be_bytes(*bytes);
        }
        let reply = self.datagram(words.get(..count).unwrap_or(&[]), peer, reply)?;
        self.sent(u32::from(!reply.is_empty()));
        Ok(reply)
    }

    /// Has the owner made an exchange?
    #[inline(always)]
    pub fn exchanges(&self) -> bool {
        self.server.exchanges
    }

    /// Periods of housekeeping that may pass after a frame; `owners`: the owner's. While a host
    /// owns the board, a frame of another one may be right in front of the owner's: housekeeping,
    /// and with it a turn of the services, waits for the answer to that.
    #[inline(always)]
    pub fn patience(&self, owners: bool) -> u32 {
        let owner = self.server.session().owner();
        if owner.is_none_or(|owner| owner == Peer::INSIDE) {
            BEHIND_AN_ANSWER
        } else if !owners {
            IDLE
        } else if self.exchanges() {
            BEHIND_AN_ANSWER
        } else {
            BETWEEN_REQUESTS
        }
    }

    /// Have this many periods passed since the last housekeeping? Then it is due, and counted as
    /// done.
    #[inline(always)]
    pub fn due(&mut self, periods: u32) -> bool {
        let now = self.board.now_lo();
        let due = now.wrapping_sub(self.housekeeping_at) >= self.housekeeping_every * periods;
        if due {
            self.housekeeping_at = now;
        }
        due
    }

    /// Housekeeping while a host moves the machine undisturbed. False if there is more to do than
    /// that: then [`Machine::housekeeping`] does it all. It changes nothing that the fast path
    /// shares ([`shared`]).
    fn glance(&mut self) -> bool {
        let Machine { board, server, .. } = self;
        let undisturbed = server.runs(board) && server.safety().state() == self.told;
        if undisturbed {
            self.seconds();
        }
        undisturbed
    }

    /// Does what is due without a datagram. Returns a change of state, to be logged.
    #[inline]
    pub fn housekeeping(&mut self) -> Option<(State, FaultReason)> {
        if self.server.flash.busy() {
            self.slice();
        } else {
            self.server.look_at_link(&mut self.board);
        }
        self.server.poll(&mut self.board);
        self.seconds();
        let state = self.server.safety().state();
        let changed = state != core::mem::replace(&mut self.told, state);
        changed.then(|| (state, self.server.safety().reason()))
    }

    fn seconds(&mut self) {
        let clock_hz = self.server.ident.clock_hz;
        if self.housekeeping_at.wrapping_sub(self.second_at) >= clock_hz {
            self.second_passed(clock_hz);
        }
    }

    /// One slice of the flash operation. While an operation runs, housekeeping runs without a
    /// pause.
    #[cold]
    #[inline(never)]
    fn slice(&mut self) {
        let done = self.server.poll_flash(&mut self.board);
        self.housekeeping_every = 0;
        if done {
            self.housekeeping_every = self.server.ident.clock_hz / HOUSEKEEPING_PER_SECOND;
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
        if self.dhcp {
            self.settle();
        }
    }

    /// Puts the current address into force. It does not change while a host owns the session.
    fn settle(&mut self) {
        let settings = self.server.flash.settings();
        let (ip, net) = match self.lease {
            Some(lease) => (lease.ip, (lease.prefix, lease.gateway)),
            None if self.second >= FALLBACK_SECONDS => {
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
        let leased = self.lease.is_some_and(|lease| lease.ip == self.us.ip);
        let here = || discovery::here(&self.server, &self.us, leased, &self.names);
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
        // A sender that has not received a challenge yet has done nothing wrong.
        if answer.is_some() {
            self.server.refuse(why);
        }
        Err(challenge)
    }

    /// The services have an address from a DHCP server, or have lost it. It comes into force when
    /// no host owns the session.
    pub fn leased(&mut self, lease: Option<Lease>) {
        // A server may offer anything.
        self.lease = lease.filter(|lease| unicast(lease.ip) && lease.prefix <= 32);
        if self.dhcp {
            self.settle();
        }
    }

    /// Is there something to broadcast ([`Machine::next_broadcast`])? Ask after housekeeping and
    /// after a datagram.
    #[inline(always)]
    pub fn has_broadcast(&self) -> bool {
        self.moved || self.done.is_some()
    }

    /// Writes what is to be broadcast into `words`. The answer to a Set that was saved is the last
    /// one: the machine wants a restart after it.
    pub fn next_broadcast(&mut self, words: &mut [u32; MAX_WORDS]) -> Option<Broadcast> {
        let (result, waiting) = (self.done.take()?, self.waiting.take()?);
        if result == OpResult::Ok {
            self.server.restart();
        }
        let message = Message {
            nonce: waiting.nonce,
            uid: self.server.flash.uid(),
            body: Body::Done(result),
        };
        Some(Broadcast {
            from_ip: self.us.ip,
            from_port: DISCOVERY_PORT,
            to_port: waiting.port,
            words: emit(&message, words).len(),
        })
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
            let text = core::str::from_utf8(entry.value).unwrap_or("");
            match entry.kind {
                Kind::Mac => us.mac = entry.value.try_into().unwrap_or(us.mac),
                Kind::Ipv4 => us.ip = entry.value.try_into().map_or(us.ip, u32::from_be_bytes),
                Kind::Port => us.port = entry.value.try_into().map_or(us.port, u16::from_be_bytes),
                Kind::Configuration | Kind::Platform => {
                    let name = match entry.kind == Kind::Platform {
                        true => &mut self.names.platform,
                        false => &mut self.names.configuration,
                    };
                    *name = Name::cut(text);
                }
                Kind::Fpga => self.idcode = idcode_of(text),
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

mod shared;
mod transport;
mod visitors;

pub use shared::{Guest, Shared, hold_path};
pub use visitors::{Verb, Verdict, WORDS as VISIT_WORDS};

/// The identity of a board with six axes.
#[cfg(test)]
pub(crate) fn ident_of_six() -> Ident {
    *crate::fake::Rig::new().server.ident()
}

#[cfg(test)]
mod tests;
