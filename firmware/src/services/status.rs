//! What the board says of itself to every device: its name, the facts of the status page, the log,
//! events for a syslog server, and the time for their stamps.
//!
//! A turn does one thing: it sends a datagram, takes one, writes one, or looks at a few words of
//! the board. While a host moves the machine, names are neither asked nor answered: such a message
//! takes longer than the host's next exchange should wait.

use super::events::Watch;
use super::facts;
use super::http::page::PageSource;
use super::journal::{Journal, Stamp};
use super::look::Facts;
use super::mdns::{self, Identity, Responder};
use super::post::{self, Party, Post};
use super::stack::Stack;
use super::{Network, sntp, syslog};
use smoltcp::iface::SocketSet;
use smoltcp::time::Instant;
use wire::settings::Settings;

/// Between two looks at the board.
const LOOK_MS: u32 = 100;
/// The same as long as names and versions are not known and a host moves the machine; at rest there
/// is no pause.
const LEARN_MS: u32 = 1;
/// So many looks between two at the settings, which may be changed.
const LOOKS: u32 = 32;
/// Longest message of the network's names that fits into a frame.
const NAMES: usize = 1472;
/// Most devices' messages stay on the cable; those of the time may pass routers.
const HOPS: u8 = 64;
/// RFC 6762 asks for it.
const NAMES_HOPS: u8 = 255;

/// The memory of the UDP ports.
#[derive(Debug, Default)]
pub struct Place<'m> {
    names: post::Place<'m, NAMES, { mdns::MESSAGE }>,
    events: post::Place<'m, 0, { syslog::MESSAGE }>,
    time: post::Place<'m, { sntp::PACKET }, { sntp::PACKET }>,
}

impl Place<'_> {
    /// Without a port.
    pub const fn new() -> Self {
        Place {
            names: post::Place::new(),
            events: post::Place::new(),
            time: post::Place::new(),
        }
    }
}

/// Seconds since power-up, without a division each time.
#[derive(Clone, Copy, Debug)]
struct Uptime {
    seconds: u32,
    /// Milliseconds since the services started, at the last full second.
    at: u32,
}

impl Uptime {
    fn pass(&mut self, ms: u32) {
        let passed = ms.wrapping_sub(self.at) / 1000;
        self.seconds = self.seconds.wrapping_add(passed);
        self.at = self.at.wrapping_add(passed * 1000);
    }
}

/// What the board says.
#[derive(Debug)]
pub struct Status<'m> {
    settings: Settings,
    facts: Facts,
    journal: Journal<'m>,
    watch: Watch,
    uptime: Uptime,
    /// Once the unique id is known.
    responder: Option<Responder>,
    names: Post<'m>,
    /// The device that asked for a name last: an answer to it alone needs its MAC address.
    asker: Option<([u8; 6], [u8; 4])>,
    sender: syslog::Sender,
    events: Post<'m>,
    clock: sntp::Client,
    time: Post<'m>,
    /// When the board is looked at next, and looks until now.
    due: u32,
    looks: u32,
    random: u32,
}

impl<'m> Status<'m> {
    /// With the log in `memory`, so many seconds after power-up.
    pub fn new(
        place: &'m mut Place<'m>,
        memory: &'m mut [u8],
        settings: Settings,
        seconds: u32,
        random: u32,
    ) -> Self {
        let journal = Journal::open(memory);
        Status {
            facts: Facts::new(),
            watch: Watch::new(),
            uptime: Uptime { seconds, at: 0 },
            responder: None,
            names: Post::new(&mut place.names, wire::mdns::PORT, NAMES_HOPS),
            asker: None,
            sender: syslog::Sender::new(journal.next()),
            events: Post::new(&mut place.events, syslog::PORT, HOPS),
            clock: sntp::Client::default(),
            time: Post::new(&mut place.time, sntp::PORT, HOPS),
            due: 0,
            looks: 0,
            random: random | 1,
            settings,
            journal,
        }
    }

    /// Is this UDP port one of these?
    pub fn listens(port: u16) -> bool {
        port == wire::mdns::PORT || port == sntp::PORT
    }

    /// What the status page shows.
    pub fn source(&self, ms: u32) -> PageSource<'_, 'm> {
        PageSource {
            facts: &self.facts,
            journal: &self.journal,
            host: self.responder.as_ref().map_or("", Responder::name),
            uptime: self.uptime.seconds,
            unix: self.clock.unix(ms),
        }
    }

    /// Takes a frame for this port.
    pub fn frame(
        &mut self,
        (port, frame): (u16, &[u8]),
        stack: &mut Stack,
        now: Instant,
        out: &mut impl Network,
    ) {
        if port == sntp::PORT {
            return self.time.frame(frame, stack, now, out);
        }
        if out.moving() {
            return;
        }
        let part = |at: usize| frame.get(at..);
        let mac = part(6).and_then(|it| it.first_chunk());
        let ip = part(26).and_then(|it| it.first_chunk());
        if let (Some(mac), Some(ip)) = (mac, ip) {
            self.asker = Some((*mac, *ip));
        }
        self.names.frame(frame, stack, now, out);
    }

    /// Does one thing. True if there was something to do.
    pub fn turn(
        &mut self,
        stack: &mut Stack,
        none: &mut SocketSet,
        (now, ms): (Instant, u32),
        out: &mut impl Network,
    ) -> bool {
        self.uptime.pass(ms);
        self.events.send(stack, now, out)
            || self.time.send(stack, now, out)
            || self.heard(ms)
            || (!out.moving() && self.named(stack, none, (now, ms), out))
            || self.said(ms)
            || self.look(ms, out)
    }

    /// An answer of the server of the time.
    fn heard(&mut self, ms: u32) -> bool {
        let clock = &mut self.clock;
        self.time.read(|from, packet| {
            if from.port == sntp::PORT {
                clock.take(from.ip, packet, ms);
            }
        })
    }

    /// Questions for names, and what we say to them.
    fn named(
        &mut self,
        stack: &mut Stack,
        none: &mut SocketSet,
        (now, ms): (Instant, u32),
        out: &mut impl Network,
    ) -> bool {
        let Some(responder) = &mut self.responder else {
            return self.names.read(|_, _| {});
        };
        if self.names.send(stack, now, out) {
            return true;
        }
        if self
            .names
            .read(|from, message| responder.take(message, from, ms))
        {
            return true;
        }
        if !responder.busy(ms) || !self.names.free() {
            return false;
        }
        if let Some(asker) = self.asker.take() {
            stack.introduce(asker, none, now, out);
            return true;
        }
        let mut room = [0; mdns::MESSAGE];
        if let Some((to, length)) = responder.poll(ms, &mut room) {
            self.names.write(to, room.get(..length).unwrap_or(&[]));
        }
        true
    }

    /// An event for the syslog server, or a question for the time.
    fn said(&mut self, ms: u32) -> bool {
        if self.sender.busy(&self.journal) && self.events.free() {
            let host = self.responder.as_ref().map_or("-", Responder::name);
            let mut room = [0; syslog::MESSAGE];
            if let Some((ip, length)) = self.sender.poll(&self.journal, host, &mut room) {
                let port = syslog::PORT;
                let message = room.get(..length).unwrap_or(&[]);
                self.events.write(Party { ip, port }, message);
            }
            return true;
        }
        if self.clock.busy(ms) && self.time.free() {
            let mut packet = [0; sntp::PACKET];
            self.random = self
                .random
                .wrapping_mul(0x0019_660d)
                .wrapping_add(0x3c6e_f35f)
                ^ ms;
            if let Some(ip) = self.clock.poll(ms, self.random, &mut packet) {
                let port = sntp::PORT;
                self.time.write(Party { ip, port }, &packet);
            }
            return true;
        }
        false
    }

    /// Looks at a few words of the board.
    fn look(&mut self, ms: u32, out: &mut impl Network) -> bool {
        if (ms.wrapping_sub(self.due) as i32) < 0 {
            return false;
        }
        let learned = self.facts.done();
        let rests = !out.moving();
        let wait = match (learned, rests) {
            (true, _) => LOOK_MS,
            (false, false) => LEARN_MS,
            (false, true) => 0,
        };
        self.due = ms.wrapping_add(wait);
        self.looks = self.looks.wrapping_add(1);
        if rests && self.looks % LOOKS == 1 {
            if let Some(settings) = facts::settings_now(out) {
                self.settings = settings;
            }
            self.settle(ms, out);
        } else if !learned && !self.looks.is_multiple_of(4) {
            self.facts.read(rests, out);
            if rests && self.facts.done() {
                // It has a name from now on.
                self.settle(ms, out);
            }
        } else {
            let boot = self.watch.boot().unwrap_or(0);
            let (uptime, unix) = (self.uptime.seconds, self.clock.unix(ms));
            let stamp = Stamp { boot, uptime, unix };
            if self.watch.look(stamp, &mut self.journal, out) {
                self.due = ms.wrapping_add(LEARN_MS);
            }
        }
        true
    }

    /// The settings and the address are what they are now.
    fn settle(&mut self, ms: u32, out: &mut impl Network) {
        if self.sender.settle(self.settings.syslog) {
            self.events.forget();
        }
        if self.clock.settle(self.settings.sntp) {
            self.time.forget();
        }
        if !self.facts.done() {
            return;
        }
        let us = out.us();
        let identity = Identity {
            name: self.settings.name,
            uid: self.facts.uid,
            ip: us.ip,
            port: us.port,
        };
        match &mut self.responder {
            Some(responder) => responder.settle(identity, ms),
            None => self.responder = Some(Responder::new(identity, ms)),
        }
    }
}
