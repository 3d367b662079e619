//! Answers ARP and ping and holds one TCP connection: a minimal IP stack, since UDP is handled
//! elsewhere.
//!
//! Frames are bytes here, one at a time: a received frame gives at most one frame to send
//! ([`Ip::frame`]). The caller then asks for further TCP segments until there are none
//! ([`Ip::poll`]).
//!
//! The stack starts no conversation: it resolves no addresses, because an answer goes to the MAC
//! address the question came from, and it opens no connections. It does not reassemble fragments,
//! and it skips IP options. TCP takes segments in order, a few lines at a time; the peer has to
//! send the rest again.
//!
//! ```text
//!   Listen --SYN--> Opening --ACK--> Open --all sent, FIN--> Closing --ACK--> Waiting --their FIN, or patience--> Listen
//! ```
//!
//! A handshake that is not finished within 250 ms yields to the next SYN. After a minute of silence
//! the peer is asked for half a minute whether it is still there; then the connection is dropped. A
//! segment that cannot be right (outside of the window, or with an acknowledgement of bytes that
//! were never sent) changes nothing (RFC 9293, 3.10.7.4). The answer to it states the right
//! numbers, as keepalives and probes of a closed window require. That happens at most four times a
//! second, so that two stacks that disagree do not talk for ever.

use crate::net::Us;
use crate::thrift::move_down;

/// Room for what the other side has not acknowledged yet.
pub const TEXT: usize = 1536;
/// Bytes the peer may send ahead: two of the console's longest lines. Other users of [`Ip`] choose
/// their own.
pub const AHEAD: usize = 128;
/// Longest payload of ours: fits every tunnel.
const SEGMENT: usize = 512;
/// Milliseconds until the first retransmission; the time doubles with each further one.
const RESEND_MS: u32 = 250;
/// After 0.25, 0.5, 1, 2, 4, 8 and 16 s without an answer the peer is given up.
const RESENDS: u8 = 6;
/// After a minute of silence the peer is asked whether it is still there.
const IDLE_MS: u32 = 60_000;

/// No acknowledgement is older than the largest window without scaling.
const LATE: u32 = 0xffff;

const ETHERNET: usize = 14;
const IP_HEADER: usize = 20;
const TCP_HEADER: usize = 20;
/// Type, code, check sum, identifier, sequence number.
const ECHO_HEADER: usize = 8;
const TCP_AT: usize = ETHERNET + IP_HEADER;
const PAYLOAD_AT: usize = TCP_AT + TCP_HEADER;

const FIN: u8 = 1;
const SYN: u8 = 2;
const RST: u8 = 4;
const PSH: u8 = 8;
const ACK: u8 = 16;

/// The longest segment that a stack with that much room may receive: a full frame.
const MSS: u16 = 1460;
/// Bytes of the option that states it.
const MSS_OPTION: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Listen,
    Opening,
    Open,
    Closing,
    Waiting,
}

/// The other end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Peer {
    mac: [u8; 6],
    ip: [u8; 4],
    port: [u8; 2],
}

/// A segment from a peer, whose check sum is right.
struct TcpSegment<'a> {
    from: [u8; 2],
    to: u16,
    sequence: u32,
    ack: u32,
    flags: u8,
    window: u16,
    data: &'a [u8],
}

impl<'a> TcpSegment<'a> {
    /// Parses what an IP packet from `peer` to us carries.
    fn parse(tcp: &'a [u8], peer: &Peer, us: &Us) -> Option<Self> {
        let pseudo = sum(&peer.ip, sum(&us.ip.to_be_bytes(), 6 + tcp.len() as u32));
        let offset = usize::from(*tcp.get(12)? >> 4) * 4;
        let data = tcp.get(offset.max(TCP_HEADER)..)?;
        if fold(sum(tcp, pseudo)) != 0xffff {
            return None;
        }
        Some(TcpSegment {
            from: *tcp.first_chunk()?,
            to: half(tcp, 2)?,
            sequence: word(tcp, 4)?,
            ack: word(tcp, 8)?,
            flags: *tcp.get(13)?,
            window: half(tcp, 14)?,
            data,
        })
    }

    /// Does it ask for a new connection?
    fn opens(&self) -> bool {
        self.flags & (SYN | ACK | RST | FIN) == SYN
    }
}

/// Takes the bytes that the connection brings.
pub trait StreamHandler {
    /// A client has connected.
    fn greet(&mut self, out: &mut Text);
    /// Takes at most one line of these bytes; returns how many bytes it took. 0: none now, ask
    /// again later.
    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize;
}

/// Text to be sent: acknowledged bytes are removed at the front.
#[derive(Clone, Debug)]
pub struct Text {
    bytes: [u8; TEXT],
    used: usize,
    /// Close the connection after this text.
    pub close: bool,
}

impl Default for Text {
    fn default() -> Self {
        Self::new()
    }
}

impl Text {
    /// Empty.
    pub const fn new() -> Self {
        Text {
            bytes: [0; TEXT],
            used: 0,
            close: false,
        }
    }

    /// All of it.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.used).unwrap_or(&[])
    }

    /// Is there anything to be sent, or to be closed?
    pub fn some(&self) -> bool {
        self.used > 0 || self.close
    }

    /// Bytes that still fit.
    pub fn room(&self) -> usize {
        TEXT - self.used
    }

    /// Forgets all of it.
    pub fn clear(&mut self) {
        self.used = 0;
        self.close = false;
    }

    fn drop_front(&mut self, count: usize) {
        // Sliced first: so the compiler sees that no index is out of range.
        let text = self.bytes.get_mut(..self.used).unwrap_or(&mut []);
        let count = count.min(text.len());
        move_down(text, count);
        self.used = text.len() - count;
    }
}

impl crate::text::Sink for Text {
    fn put(&mut self, text: &[u8]) {
        if let Some(room) = self.bytes.get_mut(self.used..self.used + text.len()) {
            room.copy_from_slice(text);
            self.used += text.len();
        }
    }
}

impl<const AHEAD: usize> Default for Ip<AHEAD> {
    fn default() -> Self {
        Self::new()
    }
}

/// The stack.
#[derive(Clone, Debug)]
pub struct Ip<const AHEAD: usize = { crate::ip::AHEAD }> {
    port: u16,
    /// While there is less room for text than this, the peer may not send another byte.
    reserve: usize,
    state: State,
    peer: Peer,
    /// First byte not acknowledged, next byte to send, the byte after the last one ever sent, next
    /// byte expected.
    una: u32,
    next: u32,
    top: u32,
    expected: u32,
    their_window: u32,
    /// The peer has closed its half.
    theirs_done: bool,
    /// An acknowledgement is due: data came, or the window opened.
    owe_ack: bool,
    window_shut: bool,
    sent_at: u32,
    resends: u8,
    /// When the last answer to an impossible segment was sent.
    objected_at: u32,
    ahead: heapless::Vec<u8, AHEAD>,
    text: Text,
}

impl<const AHEAD: usize> Ip<AHEAD> {
    /// A stack that listens on no port. It is all zeros, so that a static one costs no ROM.
    pub const fn new() -> Self {
        Ip {
            port: 0,
            reserve: 0,
            state: State::Listen,
            peer: Peer {
                mac: [0; 6],
                ip: [0; 4],
                port: [0; 2],
            },
            una: 0,
            next: 0,
            top: 0,
            expected: 0,
            their_window: 0,
            theirs_done: false,
            owe_ack: false,
            window_shut: false,
            sent_at: 0,
            resends: 0,
            objected_at: 0,
            ahead: heapless::Vec::new(),
            text: Text::new(),
        }
    }

    /// Listens on this TCP port. A client may send while this many bytes of answer fit.
    pub fn listen(&mut self, port: u16, reserve: usize) {
        self.port = port;
        self.reserve = reserve;
    }

    /// Is this TCP frame from the peer of the connection?
    pub fn is_peer(&self, frame: &[u8]) -> bool {
        let source = |ip: &[u8]| {
            let tcp = usize::from(ip.first()? & 15) * 4;
            Some((
                ip.get(12..16)? == self.peer.ip,
                ip.get(tcp..tcp + 2)? == self.peer.port,
            ))
        };
        frame.get(ETHERNET..).and_then(source) == Some((true, true))
    }

    /// Is there a connection, so that the timers have to be polled?
    pub fn busy(&self) -> bool {
        self.state != State::Listen
    }

    /// Is the connection in use? A handshake that waits to send its answer again does not count.
    pub fn taken(&self) -> bool {
        self.busy() && (self.state != State::Opening || self.resends == 0)
    }

    /// Drops the connection without telling the peer: the address changed.
    pub fn reset(&mut self) {
        self.state = State::Listen;
        self.text.clear();
        self.ahead.clear();
    }

    /// Appends text to what is to be sent.
    pub fn say(&mut self, text: &[u8]) {
        crate::text::Sink::put(&mut self.text, text);
    }

    /// Passes received bytes on, line by line, as long as the answers fit.
    fn feed(&mut self, handler: &mut impl StreamHandler) {
        let mut taken = 0;
        while !self.text.close && self.text.room() >= self.reserve {
            let rest = self.ahead.get(taken..).unwrap_or(&[]);
            if rest.is_empty() {
                break;
            }
            match handler.take(rest, &mut self.text) {
                0 => break,
                count => taken += count,
            }
        }
        if self.text.close {
            taken = self.ahead.len(); // the connection is closing
        }
        let taken = taken.min(self.ahead.len());
        move_down(&mut self.ahead, taken);
        self.ahead.truncate(self.ahead.len() - taken);
    }

    /// Takes a frame. If there is an answer, it is in `out`, and its length is returned.
    pub fn frame(
        &mut self,
        frame: &[u8],
        us: &Us,
        now_ms: u32,
        handler: &mut impl StreamHandler,
        out: &mut [u8],
    ) -> Option<usize> {
        let ours = us.ip.to_be_bytes();
        let kind = frame.get(12..ETHERNET)?;
        let for_us = frame.get(..6)? == us.mac;
        if us.ip == 0 {
            return None;
        }
        if kind == [8, 6] {
            return arp(frame, us, out);
        }
        let version = *frame.get(ETHERNET)?;
        let header = usize::from(version & 15) * 4;
        let total = usize::from(half(frame, ETHERNET + 2)?);
        let ip = frame.get(ETHERNET..ETHERNET + header)?;
        let right = kind == [8, 0]
            && for_us
            && version >> 4 == 4
            && header >= IP_HEADER
            && half(ip, 6)? & 0x3fff == 0
            && ip.get(16..20)? == ours
            && fold(sum(ip, 0)) == 0xffff;
        let body = frame.get(ETHERNET + header..ETHERNET + total)?;
        if !right {
            return None;
        }
        let mut peer = Peer::default();
        peer.mac.copy_from_slice(frame.get(6..12)?);
        peer.ip.copy_from_slice(ip.get(12..16)?);
        match ip.get(9)? {
            1 => ping(body, &peer, us, out),
            6 => self.segment(body, peer, us, now_ms, handler, out),
            _ => None,
        }
    }

    /// The next TCP segment to send now; call it until there is none.
    pub fn poll(
        &mut self,
        us: &Us,
        now_ms: u32,
        handler: &mut impl StreamHandler,
        out: &mut [u8],
    ) -> Option<usize> {
        if self.state == State::Listen {
            return None;
        }
        self.feed(handler);
        let waited = now_ms.wrapping_sub(self.sent_at);
        // Bytes are not acknowledged, or do not fit the peer's window, or the peer's half stays
        // open after ours closed.
        let waiting = self.next != self.una
            || self.text.used > 0 && self.their_window == 0
            || self.state == State::Waiting;
        let window = (AHEAD - self.ahead.len()) as u16;
        let patience = match waiting || self.resends > 0 {
            true => RESEND_MS << self.resends,
            false => IDLE_MS,
        };
        if waited >= patience {
            if self.resends >= RESENDS {
                self.reset();
                return None;
            }
            self.resends += 1;
            self.sent_at = now_ms;
            self.next = self.una;
            if !waiting {
                // The peer has acknowledged this already, and will say so.
                return self.emit(us, ACK, self.una.wrapping_sub(1), window, 0, 0, out);
            }
        }
        if self.state == State::Opening {
            if self.next != self.una {
                return None;
            }
            self.next = self.una.wrapping_add(1);
            self.top = self.next;
            return self.emit(us, SYN | ACK, self.una, window, 0, 0, out);
        }
        let sent = self.next.wrapping_sub(self.una) as usize;
        // One byte into a closed window, when it is time to probe.
        let their_window = self.their_window.max(u32::from(self.resends > 0)) as usize;
        let end = self.text.used.min(their_window);
        let count = end.saturating_sub(sent).min(SEGMENT);
        let last = sent + count == self.text.used;
        let over = self.text.close || self.theirs_done && self.ahead.is_empty();
        let fin = over && last && self.state != State::Waiting;
        self.owe_ack |= self.window_shut && window > 0;
        if count == 0 && !fin && !self.owe_ack {
            return None;
        }
        if self.next == self.una {
            self.sent_at = now_ms;
        }
        let from = self.next;
        self.next = from.wrapping_add(count as u32 + u32::from(fin));
        if (self.next.wrapping_sub(self.top) as i32) > 0 {
            self.top = self.next;
        }
        let mut flags = ACK;
        if count > 0 {
            flags |= PSH;
        }
        if fin {
            flags |= FIN;
            self.state = State::Closing;
        }
        self.emit(us, flags, from, window, sent, count, out)
    }

    /// Takes a segment of this peer, whose port is not known yet, and answers it.
    fn segment(
        &mut self,
        tcp: &[u8],
        mut peer: Peer,
        us: &Us,
        now_ms: u32,
        handler: &mut impl StreamHandler,
        out: &mut [u8],
    ) -> Option<usize> {
        let segment = TcpSegment::parse(tcp, &peer, us).filter(|it| it.to == self.port)?;
        peer.port = segment.from;
        let opens = segment.opens();
        let theirs = (peer.ip, peer.port) == (self.peer.ip, self.peer.port);
        let opening = self.state == State::Opening;
        // Our answer to the peer's SYN was lost. Any other SYN replaces a late handshake.
        let again = opening && theirs && segment.sequence.wrapping_add(1) == self.expected;
        if opens && !self.taken() && !again {
            self.begin_handshake(peer, &segment, now_ms);
            return self.poll(us, now_ms, handler, out);
        }
        if opens && opening && !theirs {
            // The handshake may still finish soon; the client will ask again.
            return None;
        }
        let fresh = segment.ack.wrapping_sub(self.una);
        let confirms = segment.flags & (RST | ACK) != ACK || fresh == 1;
        let known = self.busy() && theirs && (!opening || confirms);
        if !known {
            return self.refuse(peer, &segment, us, out);
        }
        let ahead = segment.sequence.wrapping_sub(self.expected) as usize;
        if segment.flags & RST != 0 && (ahead == 0 || ahead >= self.room()) {
            if ahead == 0 {
                self.reset();
            }
            return None;
        }
        if opens && opening {
            self.next = self.una;
            return self.poll(us, now_ms, handler, out);
        }
        let never_sent = fresh > self.top.wrapping_sub(self.una);
        // An old acknowledgement may come late. One of bytes that were never sent is a guess.
        let guess = never_sent && self.una.wrapping_sub(segment.ack) > LATE;
        if segment.flags & (SYN | RST) != 0 || segment.flags & ACK != 0 && guess {
            // Either the peer lost the connection, and will say so in reply, or the sender is not
            // the peer.
            self.object(now_ms);
            return self.poll(us, now_ms, handler, out);
        }
        if segment.flags & ACK == 0 {
            return None;
        }
        if !never_sent && self.acknowledge(&segment, now_ms, handler) {
            self.reset();
            return None;
        }
        if self.receive(&segment, now_ms) {
            let sent = self.emit(us, ACK, self.next, 0, 0, 0, out);
            self.reset();
            return sent;
        }
        self.poll(us, now_ms, handler, out)
    }

    /// Bytes the peer may still send ahead.
    fn room(&self) -> usize {
        AHEAD - self.ahead.len()
    }

    /// Begins a handshake with this peer; the answer to its SYN is the next segment to send.
    fn begin_handshake(&mut self, peer: Peer, syn: &TcpSegment, now_ms: u32) {
        self.peer = peer;
        self.una = now_ms.wrapping_mul(250_000) ^ syn.sequence.rotate_left(13);
        self.next = self.una;
        self.top = self.una;
        self.expected = syn.sequence.wrapping_add(1);
        self.their_window = u32::from(syn.window);
        self.theirs_done = false;
        self.owe_ack = false;
        self.resends = 0;
        self.sent_at = now_ms;
        self.objected_at = now_ms.wrapping_sub(RESEND_MS);
        self.reset();
        self.state = State::Opening;
    }

    /// There is no connection for this segment: answers with a reset, unless it is one.
    fn refuse(
        &mut self,
        peer: Peer,
        segment: &TcpSegment,
        us: &Us,
        out: &mut [u8],
    ) -> Option<usize> {
        let flags = segment.flags;
        if flags & RST != 0 {
            return None;
        }
        let expected = self.expected;
        let other = core::mem::replace(&mut self.peer, peer);
        let length = segment.data.len() as u32 + u32::from(flags & (SYN | FIN) != 0);
        self.expected = segment.sequence.wrapping_add(length);
        let from = if flags & ACK != 0 { segment.ack } else { 0 };
        let sent = self.emit(us, RST | ACK, from, 0, 0, 0, out);
        (self.peer, self.expected) = (other, expected);
        sent
    }

    /// Takes the acknowledgement of bytes that were sent. True if it was the last that the
    /// connection waited for.
    fn acknowledge(
        &mut self,
        segment: &TcpSegment,
        now_ms: u32,
        handler: &mut impl StreamHandler,
    ) -> bool {
        let fresh = segment.ack.wrapping_sub(self.una);
        self.their_window = u32::from(segment.window);
        if fresh > 0 {
            self.una = segment.ack;
            if (self.next.wrapping_sub(segment.ack) as i32) < 0 {
                self.next = segment.ack;
            }
            self.resends = 0;
            self.sent_at = now_ms;
            if self.state == State::Opening {
                self.state = State::Open;
                handler.greet(&mut self.text);
            } else {
                if fresh as usize > self.text.used {
                    // The peer has acknowledged our FIN, too. Both sides may have closed.
                    self.state = State::Waiting;
                    if self.theirs_done {
                        return true;
                    }
                }
                self.text.drop_front(fresh as usize);
            }
        } else if self.state != State::Waiting && (self.next == self.una || self.their_window == 0)
        {
            // The peer answers, and has no bytes to acknowledge.
            self.resends = 0;
            self.sent_at = now_ms;
        }
        false
    }

    /// Takes the bytes that are new and have room, and the peer's FIN behind the last of them. True
    /// if both sides have closed now.
    fn receive(&mut self, segment: &TcpSegment, now_ms: u32) -> bool {
        let (data, fin) = (segment.data, segment.flags & FIN != 0);
        let again = self.expected.wrapping_sub(segment.sequence);
        if !data.is_empty() || fin {
            self.owe_ack = true;
        } else if again != 0 {
            self.object(now_ms);
        }
        let Some(news) = data.get(again as usize..).filter(|_| !self.theirs_done) else {
            return false;
        };
        let head = news.get(..self.room().min(news.len())).unwrap_or(&[]);
        let _ = self.ahead.extend_from_slice(head);
        self.expected = self.expected.wrapping_add(head.len() as u32);
        if !fin || head.len() < news.len() {
            return false;
        }
        self.expected = self.expected.wrapping_add(1);
        self.theirs_done = true;
        self.state == State::Waiting
    }

    /// Answers with the right numbers, unless that was done a moment ago.
    fn object(&mut self, now_ms: u32) {
        if now_ms.wrapping_sub(self.objected_at) >= RESEND_MS {
            self.objected_at = now_ms;
            self.owe_ack = true;
        }
    }

    /// A segment to the peer, with `count` bytes of text from `at`.
    #[expect(clippy::too_many_arguments, reason = "a header has that many fields")]
    fn emit(
        &mut self,
        us: &Us,
        flags: u8,
        sequence: u32,
        window: u16,
        at: usize,
        count: usize,
        out: &mut [u8],
    ) -> Option<usize> {
        if flags & RST == 0 {
            self.owe_ack = false;
            self.window_shut = window == 0;
        }
        let text = self.text.bytes.get(at..at + count)?;
        out.get_mut(PAYLOAD_AT..PAYLOAD_AT + count)?
            .copy_from_slice(text);
        // A stack that does not get this option sends 536 bytes at a time: two frames instead of
        // one.
        let says = AHEAD >= usize::from(MSS) && flags & SYN != 0;
        let (count, offset) = match says {
            true => (count + MSS_OPTION, 0x60),
            false => (count, 0x50),
        };
        if says {
            let [m0, m1] = MSS.to_be_bytes();
            let option = out.get_mut(PAYLOAD_AT..PAYLOAD_AT + MSS_OPTION)?;
            option.copy_from_slice(&[2, 4, m0, m1]);
        }
        let tcp = out.get_mut(TCP_AT..PAYLOAD_AT + count)?;
        let (head, _) = tcp.split_first_chunk_mut::<TCP_HEADER>()?;
        let [p0, p1] = self.port.to_be_bytes();
        let [q0, q1] = self.peer.port;
        let [s0, s1, s2, s3] = sequence.to_be_bytes();
        let [e0, e1, e2, e3] = self.expected.to_be_bytes();
        let [w0, w1] = window.to_be_bytes();
        *head = [
            p0, p1, q0, q1, s0, s1, s2, s3, e0, e1, e2, e3, offset, flags, w0, w1, 0, 0, 0, 0,
        ];
        let pseudo = sum(
            &self.peer.ip,
            sum(&us.ip.to_be_bytes(), 6 + tcp.len() as u32),
        );
        let check = !fold(sum(tcp, pseudo));
        tcp.get_mut(16..18)?.copy_from_slice(&check.to_be_bytes());
        envelope(&self.peer, us, 6, TCP_HEADER + count, out)
    }
}

/// Writes the Ethernet and IP headers around this many bytes; returns the frame's length.
fn envelope(peer: &Peer, us: &Us, protocol: u8, length: usize, out: &mut [u8]) -> Option<usize> {
    let (ethernet, rest) = out.split_first_chunk_mut::<ETHERNET>()?;
    let (ip, _) = rest.split_first_chunk_mut::<IP_HEADER>()?;
    ethernet.get_mut(..6)?.copy_from_slice(&peer.mac);
    ethernet.get_mut(6..12)?.copy_from_slice(&us.mac);
    ethernet.get_mut(12..)?.copy_from_slice(&[8, 0]);
    let [l0, l1] = ((IP_HEADER + length) as u16).to_be_bytes();
    let [a, b, c, d] = us.ip.to_be_bytes();
    let [e, f, g, h] = peer.ip;
    // Do not fragment; TTL 64.
    *ip = [
        0x45, 0, l0, l1, 0, 0, 0x40, 0, 64, protocol, 0, 0, a, b, c, d, e, f, g, h,
    ];
    let check = !fold(sum(ip, 0));
    ip.get_mut(10..12)?.copy_from_slice(&check.to_be_bytes());
    Some(TCP_AT + length)
}

/// Answers an ARP request for our address.
fn arp(frame: &[u8], us: &Us, out: &mut [u8]) -> Option<usize> {
    const LENGTH: usize = 28;
    let asked = frame.get(ETHERNET..ETHERNET + LENGTH)?;
    let ours = us.ip.to_be_bytes();
    if !asked.starts_with(&[0, 1, 8, 0, 6, 4, 0, 1]) || asked.get(24..28)? != ours {
        return None;
    }
    let theirs = asked.get(8..18)?;
    let answer = out.get_mut(..ETHERNET + LENGTH)?;
    for (at, bytes) in [
        (0, theirs.get(..6)?),
        (6, &us.mac),
        (12, &[8, 6, 0, 1, 8, 0, 6, 4, 0, 2]),
        (22, &us.mac),
        (28, &ours),
        (32, theirs),
    ] {
        answer.get_mut(at..at + bytes.len())?.copy_from_slice(bytes);
    }
    Some(ETHERNET + LENGTH)
}

/// Answers a ping. It is a function of its own because a test breaks it to see a trap.
#[inline(never)]
fn ping(asked: &[u8], peer: &Peer, us: &Us, out: &mut [u8]) -> Option<usize> {
    let whole = asked.starts_with(&[8, 0]) && asked.len() >= ECHO_HEADER;
    if !whole || fold(sum(asked, 0)) != 0xffff {
        return None;
    }
    let answer = out.get_mut(TCP_AT..TCP_AT + asked.len())?;
    answer.copy_from_slice(asked);
    answer.get_mut(..4)?.fill(0);
    let check = !fold(sum(answer, 0));
    answer.get_mut(2..4)?.copy_from_slice(&check.to_be_bytes());
    envelope(peer, us, 1, asked.len(), out)
}

fn half(bytes: &[u8], at: usize) -> Option<u16> {
    bytes
        .get(at..)?
        .first_chunk()
        .map(|b| u16::from_be_bytes(*b))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes
        .get(at..)?
        .first_chunk()
        .map(|b| u32::from_be_bytes(*b))
}

/// Ones' complement sum of big-endian halves; frames are far too short to overflow it.
#[inline(never)]
fn sum(bytes: &[u8], start: u32) -> u32 {
    let (halves, rest) = bytes.as_chunks::<2>();
    let sum = halves.iter().fold(start, |sum, half| {
        sum + u32::from(u16::from_be_bytes(*half))
    });
    sum + rest.first().map_or(0, |byte| u32::from(*byte) << 8)
}

fn fold(sum: u32) -> u16 {
    let sum = (sum >> 16) + (sum & 0xffff);
    ((sum >> 16) + (sum & 0xffff)) as u16
}

#[cfg(test)]
mod tests;
