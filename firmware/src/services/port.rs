//! The connections of the board: three consoles, two readers of the status page, the client of
//! jobs, and the clients that come while another one has the line for jobs. Datagrams of UDP are
//! passed on from here ([`super::lease`], [`super::status`]).
//!
//! Each connection has its own socket, and its own set for it. A segment goes to the connection of
//! its sender; one that opens a connection goes to the first place that is free. A place is free,
//! too, while it only waits for late segments, and if its handshake is not finished in time. A
//! segment for no connection is refused by smoltcp. A reset has to hit the very number that is
//! expected next (RFC 5961; smoltcp takes all of its window). smoltcp drops the SYN of a connected
//! client: one that has begun anew resets the old connection at the next look whether it is there.
//!
//! A turn looks at one connection, and does one thing for it: it answers a request, or sends a
//! segment. After ten seconds of silence a client is asked whether it is still there.

use super::console::{Console, PIECE_MAX, Reader, Visit};
use super::line_editor::LINE_MAX;
use super::shut::{NOD, nod};
use super::stack::{Stack, udp_ports};
use super::status::{self, Status};
use super::{Network, facts, http, lease};
use crate::net::GUEST_FRAME_SERVICES;
use crate::text::Text;
use ::jobs::server::BusyReply;
use ::jobs::{AHEAD, Jobs};
use core::num::NonZeroU32;
use smoltcp::iface::{SocketHandle, SocketSet, SocketStorage};
use smoltcp::socket::tcp::{Socket, SocketBuffer, State};
use smoltcp::time::{Duration, Instant};
use wire::describe::Describe;
use wire::jobs::{PORT, SILENCE_SECONDS};
use wire::{CONSOLE_PORT, PAGE_PORT};

/// Consoles at a time.
pub const CONSOLES: usize = 3;
/// Readers of the status page at a time.
pub const PAGES: usize = 2;
/// Clients told Busy at a time, and one place for the next. When a client takes that place, the one
/// that has waited longest is dropped.
const BUSY: usize = 5;
/// The connection that has the line for jobs.
const LINE: usize = CONSOLES + PAGES;
const FIRST_BUSY: usize = LINE + 1;
const CONNECTIONS: usize = FIRST_BUSY + BUSY;

/// Bytes a client of a console may send ahead: the longest line. So its frames are short enough to
/// be taken while a host moves the machine.
const CONSOLE_AHEAD: usize = LINE_MAX;
/// Bytes that a reader of the page may send ahead. A request is longer and comes in pieces, so that
/// a reader hears that the board is busy while a host moves the machine.
const PAGE_AHEAD: usize = 64;
/// Bytes of a segment around its data; no option of TCP is agreed on that would need more.
const AROUND: usize = 14 + 20 + 20;
const _: () = assert!(AROUND + CONSOLE_AHEAD <= GUEST_FRAME_SERVICES);
const _: () = assert!(AROUND + PAGE_AHEAD <= GUEST_FRAME_SERVICES);
/// Bytes that a client told Busy may send ahead: a Hello and a command.
const BUSY_AHEAD: usize = 128;
/// Room for what the client has not acknowledged yet: the longest answer.
const TEXT: usize = crate::text::TEXT_ROOM;
const _: () = assert!(TEXT >= LEISURE + PIECE_MAX && TEXT >= wire::jobs::FRAME);
const _: () = assert!(TEXT >= http::TURN_MAX);
/// Text of a console that is made in one turn while the machine is at rest, ...
const LEISURE: usize = 512;
/// ... and that may wait for an acknowledgement while it is not: to send more in one segment takes
/// longer than the owner should wait.
const SHORT: usize = 256;

/// A handshake that takes longer yields to the next client.
const HANDSHAKE_MS: u32 = 250;
/// After so many strangers and so much time a client's MAC address is told to the stack again,
/// which keeps 16 of them for a minute: no connection waits for ARP, and a client that does not
/// answer ARP any more is asked over its connection until it is gone.
const FORGOTTEN: u32 = 16 - CONNECTIONS as u32;
const EXPIRES_MS: u32 = 50_000;
/// After so much silence a client is asked whether it is still there.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// A client that has answered nothing for so long is gone.
const GONE: Duration = Duration::from_secs(92);
/// A client has so much time to close its half behind ours.
const CLOSING_MS: u32 = 30_000;

const FIN: u8 = 1;
const SYN: u8 = 2;
const RST: u8 = 4;
const ACK: u8 = 16;

/// The memory of the sockets, given to [`super::Program::new`].
pub struct Place<'m> {
    lease: lease::Place<'m>,
    status: status::Place<'m>,
    sockets: [[SocketStorage<'m>; 1]; CONNECTIONS],
    buffers: [u8; BUFFERS],
}

/// Bytes of all buffers.
const BUFFERS: usize =
    CONNECTIONS * TEXT + CONSOLES * CONSOLE_AHEAD + PAGES * PAGE_AHEAD + AHEAD + BUSY * BUSY_AHEAD;

impl Default for Place<'_> {
    fn default() -> Self {
        Self::new()
    }
}

impl core::fmt::Debug for Place<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Place")
    }
}

impl Place<'_> {
    /// Without a socket.
    pub const fn new() -> Self {
        Place {
            lease: lease::Place::new(),
            status: status::Place::new(),
            sockets: [const { [SocketStorage::EMPTY] }; CONNECTIONS],
            buffers: [0; BUFFERS],
        }
    }
}

/// The other end of a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Peer {
    ip: [u8; 4],
    port: [u8; 2],
}

/// What a TCP segment says in its first bytes; smoltcp checks the rest.
#[derive(Clone, Copy, Debug)]
struct TcpSegment {
    mac: [u8; 6],
    peer: Peer,
    to: u16,
    sequence: u32,
    flags: u8,
}

impl TcpSegment {
    fn parse(frame: &[u8]) -> Option<Self> {
        let tcp = frame.get(12..14)? == [8, 0] && *frame.get(23)? == 6;
        let at = 14 + usize::from(frame.get(14)? & 15) * 4;
        let header = frame.get(at..at + 14).filter(|_| tcp)?;
        Some(TcpSegment {
            mac: *frame.get(6..12)?.first_chunk()?,
            peer: Peer {
                ip: *frame.get(26..30)?.first_chunk()?,
                port: *header.first_chunk()?,
            },
            to: u16::from_be_bytes(*header.get(2..)?.first_chunk()?),
            sequence: u32::from_be_bytes(*header.get(4..)?.first_chunk()?),
            flags: *header.last()?,
        })
    }

    /// Does it ask for a new connection?
    fn opens(&self) -> bool {
        self.flags & (SYN | ACK | RST | FIN) == SYN
    }
}

/// A connection, or a place for one.
struct Connection<'m> {
    sockets: SocketSet<'m>,
    handle: SocketHandle,
    peer: Peer,
    /// The client's MAC address, of its SYN.
    mac: [u8; 6],
    /// [`Port::strangers`] and the milliseconds when it was told to the stack.
    introduced: Option<(u32, u32)>,
    /// The number of the first byte of the client's that was not read.
    expected: u32,
    /// When it was opened; when we closed it, or when the client was heard after that and lacked
    /// text; milliseconds.
    since: u32,
    greeted: bool,
    closing: bool,
}

impl<'m> Connection<'m> {
    fn socket(&mut self) -> &mut Socket<'m> {
        self.sockets.get_mut(self.handle)
    }

    fn state(&self) -> State {
        self.sockets.get::<Socket>(self.handle).state()
    }

    fn used(&self) -> bool {
        !matches!(self.state(), State::Listen | State::Closed)
    }

    /// May another client have this place?
    fn free(&self, ms: u32) -> bool {
        match self.state() {
            State::Listen | State::Closed | State::TimeWait => true,
            State::SynReceived => ms.wrapping_sub(self.since) >= HANDSHAKE_MS,
            State::SynSent
            | State::Established
            | State::FinWait1
            | State::FinWait2
            | State::CloseWait
            | State::Closing
            | State::LastAck => false,
        }
    }

    /// Forgets the client, and listens.
    fn listen(&mut self, port: u16) {
        (self.introduced, self.greeted, self.closing) = (None, false, false);
        let socket = self.socket();
        socket.abort();
        // A port that is not 0, and a socket that is closed: it cannot fail.
        let _ = socket.listen(port);
    }

    /// Passes the client's bytes on; `take` says how many it took.
    fn read(&mut self, take: impl FnOnce(&[u8]) -> usize) -> usize {
        let taken = self.socket().recv(|bytes| {
            let taken = match bytes {
                [] => 0,
                bytes => take(bytes),
            };
            (taken, taken)
        });
        let taken = taken.unwrap_or(0);
        self.expected = self.expected.wrapping_add(taken as u32);
        taken
    }

    /// The number that the client's next byte will have.
    fn next_number(&mut self) -> u32 {
        let ended = matches!(
            self.state(),
            State::CloseWait | State::LastAck | State::Closing | State::TimeWait
        );
        let waits = self.socket().recv_queue() as u32 + u32::from(ended);
        self.expected.wrapping_add(waits)
    }

    /// Is this a reset that its sender guessed?
    fn guessed(&mut self, segment: &TcpSegment) -> bool {
        segment.flags & RST != 0 && segment.sequence != self.next_number()
    }

    /// The acknowledgement of a segment that comes while there is no room for its bytes.
    fn nod_at_a_shut_window(&mut self, frame: &[u8]) -> Option<[u8; NOD]> {
        let next = self.next_number();
        let socket = self.socket();
        let shut = socket.recv_queue() == socket.recv_capacity() && socket.send_queue() > 0;
        shut.then(|| nod(frame, next))?
    }

    /// Ends the connection behind what is to be sent.
    fn close(&mut self, ms: u32) {
        if !self.closing {
            (self.closing, self.since) = (true, ms);
            self.socket().close();
        }
    }

    /// Bytes that still fit behind what is to be sent.
    fn room(&mut self) -> usize {
        let socket = self.socket();
        socket.send_capacity() - socket.send_queue()
    }
}

/// The clock in milliseconds. There is no 64-bit division in it.
#[derive(Clone, Copy, Debug)]
struct Millis {
    per_ms: NonZeroU32,
    at: u64,
    /// smoltcp's clock must not begin anew, as 32 bits would every 50 days.
    ms: u64,
}

impl Millis {
    /// The milliseconds for smoltcp, and their lower half for differences.
    fn pass(&mut self, now: u64) -> (Instant, u32) {
        let passed = u32::try_from(now.wrapping_sub(self.at)).unwrap_or(u32::MAX);
        let ms = passed / self.per_ms;
        self.at = self.at.wrapping_add(u64::from(ms * self.per_ms.get()));
        self.ms = self.ms.wrapping_add(u64::from(ms));
        let instant = Instant::from_millis(self.ms.cast_signed());
        (instant, self.ms as u32)
    }
}

/// The connections.
pub struct Port<'m> {
    stack: Stack,
    /// If the board's address comes from a DHCP server.
    lease: Option<lease::Client<'m>>,
    connections: [Connection<'m>; CONNECTIONS],
    /// What the board says of itself.
    status: Status<'m>,
    pages: [http::Connection; PAGES],
    /// Connections that can be used: on boards without jobs the consoles and the pages.
    count: usize,
    /// Hosts that the stack may have learned the MAC address of, a count. It keeps 16.
    strangers: u32,
    /// For frames of no connection.
    none: SocketSet<'m>,
    consoles: [Console; CONSOLES],
    reader: Reader,
    busy: [BusyReply; BUSY],
    clock: Millis,
    /// The connection that is looked at next, and how many were looked at in vain.
    next: usize,
    in_vain: usize,
    /// The last turn looked at [`Port::status`] first.
    own_turn: bool,
    /// An answer.
    text: Text,
}

impl core::fmt::Debug for Port<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Port").field("stack", &self.stack).finish()
    }
}

/// The port that this connection listens at.
const fn port_of(index: usize) -> u16 {
    match index {
        0..CONSOLES => CONSOLE_PORT,
        CONSOLES..LINE => PAGE_PORT,
        _ => PORT,
    }
}

/// Which reader of the page has this connection.
fn page_of(index: usize) -> Option<usize> {
    index.checked_sub(CONSOLES).filter(|page| *page < PAGES)
}

impl<'m> Port<'m> {
    /// Listens at all ports; at that of jobs if there are `jobs`.
    pub fn new(
        place: &'m mut Place<'m>,
        log: &'m mut [u8],
        jobs: bool,
        board: &Describe,
        out: &mut impl Network,
    ) -> Self {
        let Place {
            lease,
            status,
            sockets,
            buffers,
        } = place;
        let count = if jobs { CONNECTIONS } else { LINE };
        let mut buffers = &mut buffers[..];
        let mut cut = |length: usize| {
            let (piece, rest) = core::mem::take(&mut buffers).split_at_mut(length);
            buffers = rest;
            SocketBuffer::new(piece)
        };
        let mut storages = sockets.iter_mut();
        let connections = core::array::from_fn(|index| {
            let ahead = match index {
                LINE => AHEAD,
                0..CONSOLES => CONSOLE_AHEAD,
                CONSOLES..LINE => PAGE_AHEAD,
                _ => BUSY_AHEAD,
            };
            let mut socket = Socket::new(cut(ahead), cut(TEXT));
            socket.set_keep_alive(Some(KEEP_ALIVE));
            socket.set_timeout(Some(GONE));
            // An answer follows at once, and acknowledges the request.
            socket.set_ack_delay(None);
            socket.set_nagle_enabled(false);
            let storage = storages.next().map_or(&mut [][..], |storage| storage);
            let mut sockets = SocketSet::new(storage);
            let handle = sockets.add(socket);
            let mut connection = Connection {
                sockets,
                handle,
                peer: Peer::default(),
                mac: [0; 6],
                introduced: None,
                expected: 0,
                since: 0,
                greeted: false,
                closing: false,
            };
            if index < count {
                connection.listen(port_of(index));
            }
            connection
        });
        let now = out.now();
        let us = out.us();
        let settings = facts::settings(out);
        let lease = settings
            .dhcp
            .then(|| lease::Client::new(lease, &settings.name));
        let [a, b, c, d, e, f] = us.mac;
        let mac = u64::from_be_bytes([a, b, c, d, e, f, 0, 0]);
        let seed = now ^ mac ^ u64::from(us.ip) << 32;
        let mut stack = Stack::new(seed, out);
        stack.settle(us);
        let seconds = now.checked_div(board.clock_hz.into()).unwrap_or(0) as u32;
        let random = (seed ^ seed >> 32) as u32;
        let status = Status::new(status, log, settings, seconds, random);
        Port {
            stack,
            lease,
            connections,
            status,
            pages: [const { http::Connection::new() }; PAGES],
            count,
            strangers: 0,
            none: SocketSet::new(&mut [][..]),
            consoles: [const { Console::new() }; CONSOLES],
            reader: Reader::new(board.channels, board.clock_hz),
            busy: [const { BusyReply::new() }; BUSY],
            clock: Millis {
                per_ms: NonZeroU32::new(board.clock_hz / 1000).unwrap_or(NonZeroU32::MIN),
                at: now,
                ms: 0,
            },
            next: 0,
            in_vain: 0,
            own_turn: false,
            text: Text::new(),
        }
    }

    /// Takes a frame. What it asks for is answered in later turns, but for ARP and ping.
    pub fn frame(&mut self, jobs: Option<&mut Jobs>, frame: &[u8], out: &mut impl Network) {
        let now = out.now();
        let (instant, ms) = self.clock.pass(now);
        let nowhere = self.settle(out);
        if let Some((from, lease::PORT)) = udp_ports(frame) {
            // smoltcp would tell the sender of any other that the port is closed, and quote the
            // whole frame, which may be longer than others while the machine moves.
            return match &mut self.lease {
                Some(lease) if from == lease::SERVER_PORT => {
                    lease.take(frame, &mut self.stack, instant, out);
                }
                _ => self.strangers = self.strangers.wrapping_add(1),
            };
        }
        if nowhere {
            return;
        }
        if let Some((_, port)) = udp_ports(frame).filter(|(_, to)| Status::listens(*to)) {
            self.strangers = self.strangers.wrapping_add(1);
            let stack = &mut self.stack;
            return self.status.frame((port, frame), stack, instant, out);
        }
        let segment = TcpSegment::parse(frame);
        let placed = segment.as_ref().and_then(|segment| {
            let index = self.place_for(segment, ms)?;
            Some((*segment, index))
        });
        let Some((segment, index)) = placed else {
            self.strangers = self.strangers.wrapping_add(1);
            // smoltcp's answer to a segment of no connection, a reset, takes 12 000 clocks. While
            // the machine moves such a segment gets none, and its client asks again.
            if segment.is_none() || !out.moving() {
                self.stack.take(frame, &mut self.none, instant, out);
            }
            return;
        };
        (self.next, self.in_vain) = (index, 0);
        let Some(connection) = self.connections.get_mut(index) else {
            return;
        };
        let listened = connection.state() == State::Listen;
        if connection.guessed(&segment) {
            return;
        }
        if let Some(nod) = connection.nod_at_a_shut_window(frame) {
            self.stack.take(&nod, &mut connection.sockets, instant, out);
        }
        self.stack
            .take(frame, &mut connection.sockets, instant, out);
        // A client that is there and lacks text still has its time behind our end: its network may
        // lose a segment several times, and each time it is sent later.
        if connection.closing && connection.socket().send_queue() > 0 {
            connection.since = ms;
        }
        if listened && connection.state() == State::SynReceived {
            connection.peer = segment.peer;
            connection.expected = segment.sequence.wrapping_add(1);
            connection.since = ms;
            connection.mac = segment.mac;
            connection.introduced = None;
            self.opened(index, jobs, now, ms, out);
        }
    }

    /// A client begins its handshake.
    fn opened(
        &mut self,
        index: usize,
        jobs: Option<&mut Jobs>,
        now: u64,
        ms: u32,
        out: &mut impl Network,
    ) {
        if let Some(console) = self.consoles.get_mut(index) {
            console.open();
        } else if let Some(page) = page_of(index).and_then(|page| self.pages.get_mut(page)) {
            page.open(ms);
        } else if index == LINE {
            // A client has the time of silence from its first frame on, not from its predecessor's
            // last.
            if let Some(jobs) = jobs {
                jobs.request_context(now, out).greet();
            }
        } else if self.connections[FIRST_BUSY..]
            .iter()
            .all(|connection| !connection.free(ms))
        {
            let waited = |connection: &&mut Connection| ms.wrapping_sub(connection.since);
            let busy = self.connections[FIRST_BUSY..].iter_mut();
            if let Some(connection) = busy.max_by_key(waited) {
                connection.listen(PORT);
            }
        }
    }

    /// The connection that this segment is for. One that opens another gets a place that listens.
    fn place_for(&mut self, segment: &TcpSegment, ms: u32) -> Option<usize> {
        let (opens, to) = (segment.opens(), segment.to);
        let known = self
            .connections
            .iter()
            .enumerate()
            .position(|(index, connection)| {
                connection.peer == segment.peer && port_of(index) == to && connection.used()
            });
        match known {
            // A client may begin anew with the port it had.
            Some(index) if opens && self.connections[index].state() == State::TimeWait => {
                self.connections[index].listen(to);
                Some(index)
            }
            Some(index) => Some(index),
            None if opens => {
                let mut all = self.connections.iter_mut().enumerate().take(self.count);
                let (index, connection) =
                    all.find(|(index, connection)| port_of(*index) == to && connection.free(ms))?;
                if connection.state() != State::Listen {
                    connection.listen(to);
                }
                Some(index)
            }
            None => None,
        }
    }

    /// Our address. True if there is none.
    fn settle(&mut self, out: &mut impl Network) -> bool {
        let us = out.us();
        if self.stack.settle(us) {
            let connections = self.connections.iter_mut().enumerate();
            for (index, connection) in connections.take(self.count) {
                connection.listen(port_of(index));
            }
        }
        us.ip == 0
    }

    /// Is a client connected?
    pub fn visited(&self) -> bool {
        self.connections.iter().any(Connection::used)
    }

    /// Is there something to do soon?
    pub fn busy(&self) -> bool {
        let used = || self.connections.iter().filter(|it| it.used()).count();
        self.in_vain < CONNECTIONS && self.in_vain < used()
    }

    /// Does one thing for the next connection. True if there was something to do.
    pub fn turn(&mut self, jobs: Option<&mut Jobs>, now: u64, out: &mut impl Network) -> bool {
        let (instant, ms) = self.clock.pass(now);
        let nowhere = self.settle(out);
        if let Some(lease) = &mut self.lease
            && lease.turn(&mut self.stack, instant, out)
        {
            return true;
        }
        if nowhere {
            return false;
        }
        // At most one of these between two turns of the connections.
        self.own_turn = !self.own_turn;
        let (status, stack) = (&mut self.status, &mut self.stack);
        if self.own_turn && status.turn(stack, &mut self.none, (instant, ms), out) {
            return true;
        }
        let rest = (self.next..CONNECTIONS).chain(0..self.next);
        let Some(index) = { rest }.find(|index| self.connections[*index].used()) else {
            return false;
        };
        self.next = (index + 1) % CONNECTIONS;
        let done = self.look_at(index, jobs, (now, instant, ms), out);
        self.in_vain = if done {
            0
        } else {
            self.in_vain.saturating_add(1)
        };
        done
    }

    fn look_at(
        &mut self,
        index: usize,
        jobs: Option<&mut Jobs>,
        (now, instant, ms): (u64, Instant, u32),
        out: &mut impl Network,
    ) -> bool {
        let connection = &mut self.connections[index];
        let known = connection.introduced.is_some_and(|(strangers, since)| {
            self.strangers.wrapping_sub(strangers) < FORGOTTEN
                && ms.wrapping_sub(since) < EXPIRES_MS
        });
        if !known {
            let client = (connection.mac, connection.peer.ip);
            // Only the first time: the connections must not drive each other out.
            let new = connection.introduced.is_none();
            self.strangers = self.strangers.wrapping_add(u32::from(new));
            connection.introduced = Some((self.strangers, ms));
            self.stack.introduce(client, &mut self.none, instant, out);
            return true;
        }
        let waited = ms.wrapping_sub(connection.since);
        let over = match index {
            // The one line for jobs waits for its client's end no longer than for a request.
            0..CONSOLES => connection.closing && waited >= CLOSING_MS,
            CONSOLES..LINE => {
                let page = page_of(index).and_then(|page| self.pages.get(page));
                page.is_some_and(|page| page.late(ms))
            }
            LINE => jobs.as_ref().is_some_and(|jobs| jobs.server().silent(now)),
            // A place for Busy is not held open longer either.
            _ => waited >= SILENCE_SECONDS * 1000,
        };
        if over {
            // A reset: a client that is still there need not wait for its own clock.
            connection.socket().abort();
            self.stack.send(&mut connection.sockets, instant, out);
            connection.listen(port_of(index));
            return true;
        }
        // What still comes behind the last answer is dropped, so that the client can end, too.
        if connection.closing && connection.read(<[u8]>::len) > 0 {
            return true;
        }
        // Answers leave before the next request is looked at; an acknowledgement leaves with one.
        let speaks = connection.socket().send_queue() > 0;
        if speaks && self.stack.send(&mut connection.sockets, instant, out) {
            return true;
        }
        let open = matches!(connection.state(), State::Established | State::CloseWait);
        let done = open
            && match (index, jobs) {
                (0..CONSOLES, jobs) => self.console(index, jobs, out),
                (CONSOLES..LINE, _) => self.page(index, ms, out),
                (LINE, Some(jobs)) => self.request(jobs, now, out),
                (_, Some(jobs)) => self.busy_reply(index, jobs, now, out),
                // Nothing listens there.
                (_, None) => false,
            };
        let connection = &mut self.connections[index];
        if done {
            self.finish(index, ms);
            return true;
        }
        let heard = connection.socket().recv_queue() == 0;
        if connection.state() == State::CloseWait && heard && !connection.closing {
            connection.close(ms);
            return true;
        }
        !speaks && self.stack.send(&mut connection.sockets, instant, out)
    }

    /// Sends what is in the text, and ends the connection if that is wanted.
    fn finish(&mut self, index: usize, ms: u32) {
        let connection = &mut self.connections[index];
        // There is room: nothing is asked before.
        let _ = connection.socket().send_slice(self.text.bytes());
        if self.text.close {
            connection.close(ms);
        }
        self.text.clear();
    }

    /// A console's turn: it takes bytes of its client, or answers.
    fn console(
        &mut self,
        index: usize,
        mut jobs: Option<&mut Jobs>,
        out: &mut impl Network,
    ) -> bool {
        let connection = &mut self.connections[index];
        let Some(console) = self.consoles.get_mut(index) else {
            return false;
        };
        let waits = connection.socket().send_queue();
        let moving = out.moving();
        let most = if moving {
            SHORT
        } else {
            TEXT - LEISURE - PIECE_MAX
        };
        if waits > most {
            return false;
        }
        let mut visit = Visit {
            visitor: index,
            reader: &mut self.reader,
            jobs: jobs.take(),
            out,
        };
        let text = &mut self.text;
        if console.busy() {
            console.turn(&[], &mut visit, text);
            while !moving && console.busy() && text.bytes().len() < LEISURE {
                console.turn(&[], &mut visit, text);
            }
            return true;
        }
        connection.read(|bytes| console.turn(bytes, &mut visit, text)) > 0
    }

    /// The turn of a reader of the page: it takes bytes, or answers. While a host moves the
    /// machine, the answer is that the machine needs the time.
    fn page(&mut self, index: usize, ms: u32, out: &mut impl Network) -> bool {
        let connection = &mut self.connections[index];
        let Some(page) = page_of(index).and_then(|page| self.pages.get_mut(page)) else {
            return false;
        };
        if !page.answers() {
            return connection.read(|bytes| page.take(bytes, ms)) > 0;
        }
        if connection.room() < http::TURN_MAX {
            return false;
        }
        let load = match out.moving() {
            true => http::Load::Busy,
            false => http::Load::Rest,
        };
        match page.turn(&self.status.source(ms), load, &mut self.text, out) {
            http::Turn::Idle => false,
            http::Turn::Wrote => true,
            http::Turn::Close => {
                self.text.close = true;
                true
            }
        }
    }

    /// Takes bytes of the client of jobs, at most one request.
    fn request(&mut self, jobs: &mut Jobs, now: u64, out: &mut impl Network) -> bool {
        let connection = &mut self.connections[LINE];
        if connection.room() < wire::jobs::FRAME {
            return false;
        }
        let mut context = jobs.request_context(now, out);
        let text = &mut self.text;
        let taken = connection.read(|bytes| context.take(bytes, text));
        taken > 0 || self.text.some()
    }

    /// Takes bytes of a client that was told Busy.
    fn busy_reply(
        &mut self,
        index: usize,
        jobs: &mut Jobs,
        now: u64,
        out: &mut impl Network,
    ) -> bool {
        let connection = &mut self.connections[index];
        let Some(busy) = self.busy.get_mut(index - FIRST_BUSY) else {
            return false;
        };
        if connection.room() < wire::jobs::FRAME {
            return false;
        }
        let mut caller = jobs.caller(busy, now, out);
        let text = &mut self.text;
        if !connection.greeted {
            connection.greeted = true;
            caller.greet(text);
            return true;
        }
        let taken = connection.read(|bytes| caller.take(bytes, text));
        taken > 0 || self.text.some()
    }
}
