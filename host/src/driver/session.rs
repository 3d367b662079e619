//! Requests for the session, and the evaluation of the answers.

use super::Driver;
use crate::client::{CHALLENGE_WORDS, Owner, SESSION_WORDS, Session};
use crate::fault::Fault;
use crate::hal::Level;
use crate::keys::Key;
use std::net::{Ipv4Addr, SocketAddrV4};
use wire::{Request, ResetReason, map};

/// Our token, then the owner of the board: the input of `Driver::owned`.
const OWNER_WORDS: [u32; 3] = [
    map::SESSION_TOKEN,
    map::SESSION_OWNER_IP,
    map::SESSION_OWNER_PORT,
];

/// The request that gives a session back.
pub(super) fn release(token: u32, words: &mut [u32]) -> Option<&[u32]> {
    Request::new(words)
        .write(map::SESSION_RELEASE, &[token])
        .words()
}

impl Driver {
    /// The key the board was taken with.
    pub fn remember(&mut self, key: Option<Key>) {
        self.session.key = key;
    }

    pub(super) fn send_acquire(&mut self) -> u32 {
        let tag = self.next_tag();
        let mut words = [0; 16];
        // The driver first requests a challenge from a board with a key; `prove` answers it.
        let request = Request::new(&mut words);
        let request = match self.session.key {
            None => request
                .write(map::SESSION_ACQUIRE, &[tag])
                .read(tag, &SESSION_WORDS),
            Some(_) => request.read(tag, &CHALLENGE_WORDS),
        };
        self.send(request);
        // A refused request gets no answer either. Reads are always answered, so they tell refusal
        // from silence.
        self.send(Request::new(&mut words).read(tag, &OWNER_WORDS));
        tag
    }

    /// Answers a challenge. Should the board have no key any more, the answer is ignored.
    pub(super) fn prove(&mut self, tag: u32, challenge: [u32; wire::auth::WORDS]) {
        let Some(key) = self.session.key else { return };
        let mut words = [0; 24];
        let request = Request::new(&mut words)
            .write(map::SESSION_RESPONSE, &key.acquire(challenge, tag))
            .write(map::SESSION_ACQUIRE, &[tag])
            .read(tag, &SESSION_WORDS);
        self.send(request);
    }

    fn send(&mut self, request: Request<'_>) {
        let request = request.words();
        debug_assert!(request.is_some(), "an acquisition is at most 21 words");
        if let Some(request) = request {
            // A datagram that was not sent gets no answer, so it is due again in a moment.
            let _ = self.link.send(request);
        }
    }

    pub(super) fn acquired(&mut self, session: Option<Session>) {
        // No token: the answer about the owner gives the reason.
        let Some(session) = session else { return };
        if session.wire_version != wire::WIRE_VERSION
            || session.channels != self.channels.to_words()
        {
            return self.notifier.once(
                Fault::Stranger,
                format_args!("{}; {}", Fault::Stranger.text(), Fault::Stranger.remedy()),
            );
        }
        if session.boot_id != self.session.boot_id {
            self.follow_restart(&session);
        } else if self.notifier.has_told(Fault::Silent) {
            self.notifier
                .tell(Level::Info, format_args!("the board answers again"));
        }
        self.pins.reset_reason.set(session.reset_reason);
        self.pins.gate_close.set(session.gate_close);
        self.exchange.opened(session.last_sequence);
        self.blocks.exchanges.given_up();
        self.times.opened();
        self.blocks.forget_latches();
        self.session.opened(session.token);
        self.condition.halting = None;
        self.blocks.packets.recovered();
        self.tell_group();
    }

    /// The firmware has restarted since: its settings are gone, and its counts may be, too.
    fn follow_restart(&mut self, session: &Session) {
        let why =
            ResetReason::from_code(session.reset_reason as u8).unwrap_or(ResetReason::Unknown);
        // Starts since power-up are counted in the low half.
        let other_record = (session.boot_id ^ self.session.boot_id) >> 16 != 0;
        self.condition.new_fabric = why == ResetReason::PowerUp || other_record;
        self.session.boot_id = session.boot_id;
        self.blocks.ethernet.forget();
        self.tell_restart(why);
    }

    /// The board has restarted, by its own word or by its clock.
    pub(super) fn tell_restart(&mut self, why: ResetReason) {
        self.condition.restarted = true;
        self.notifier.once(
            Fault::Restarted,
            format_args!(
                "{} (reason: {why}); {}",
                Fault::Restarted.text(),
                Fault::Restarted.remedy()
            ),
        );
    }

    /// The owner of the board after our request: if it is not us, the operator is told.
    pub(super) fn owned(&mut self, token: u32, ip: u32, port: u32) {
        if token != 0 || ip == 0 {
            return;
        }
        if self.session.foreign_owner.replace((ip, port)) == Some((ip, port))
            && self.notifier.has_told(Fault::Owned)
        {
            return;
        }
        let there = Owner(
            SocketAddrV4::new(Ipv4Addr::from_bits(ip), port as u16),
            self.link.local(),
        );
        self.notifier.once(
            Fault::Owned,
            format_args!(
                "the board is driven by {there} now; {}",
                Fault::Owned.remedy()
            ),
        );
    }
}
