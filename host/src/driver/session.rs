//! Requests for the session, and the evaluation of the answers.

use super::tell::Event;
use super::{Driver, Phase};
use crate::client::{CHALLENGE_WORDS, Owner, SESSION_WORDS, Session};
use crate::hal::Level;
use crate::keys::Key;
use std::net::{Ipv4Addr, SocketAddrV4};
use wire::{ReplyWriter, ResetReason, etherbone, map};

/// Our token, then the owner of the board: the input of `Driver::owned`.
const OWNER_WORDS: [u32; 3] = [
    map::SESSION_TOKEN,
    map::SESSION_OWNER_IP,
    map::SESSION_OWNER_PORT,
];

impl Driver {
    /// The key the board was taken with.
    pub fn remember(&mut self, key: Option<Key>) {
        self.key = key;
    }

    pub(super) fn send_acquire(&mut self) -> u32 {
        let tag = self.next_tag();
        let mut words = [0; 16];
        let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
        // A board with a key is asked for a challenge first; `prove` answers it.
        let fits = match self.key {
            None => {
                request.write_record(map::SESSION_ACQUIRE, 1)
                    && request.push(tag)
                    && request.read_record(tag, &SESSION_WORDS)
            }
            Some(_) => request.read_record(tag, &CHALLENGE_WORDS),
        };
        debug_assert!(fits, "an acquisition is 13 words");
        // A datagram that was not sent gets no answer, so it is due again in a moment.
        let _ = self.link.send(request.words());
        // A refused request gets no answer either. Reads are always answered, so they tell refusal
        // from silence.
        let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
        if request.read_record(tag, &OWNER_WORDS) {
            let _ = self.link.send(request.words());
        }
        tag
    }

    /// Answers a challenge. Should the board have no key any more, the answer is ignored.
    pub(super) fn prove(&mut self, tag: u32, challenge: [u32; wire::auth::WORDS]) {
        let Some(key) = self.key else { return };
        let mut words = [0; 24];
        let mut request = ReplyWriter::new(&mut words, etherbone::HEADER);
        let answer = key.acquire(challenge, tag);
        let fits = request.write_record(map::SESSION_RESPONSE, answer.len() as u8)
            && request.extend(&answer)
            && request.write_record(map::SESSION_ACQUIRE, 1)
            && request.push(tag)
            && request.read_record(tag, &SESSION_WORDS);
        debug_assert!(fits, "an acquisition with its answer is 21 words");
        let _ = self.link.send(request.words());
    }

    pub(super) fn acquired(&mut self, session: Option<Session>) {
        // No token: the answer about the owner gives the reason.
        let Some(session) = session else { return };
        if session.wire_version != wire::WIRE_VERSION
            || session.channels != self.channels.to_words()
        {
            return self.voice.once(
                Event::Stranger,
                format_args!(
                    "another board or firmware answers at this address; restart LinuxCNC to use it"
                ),
            );
        }
        if session.boot_id != self.boot_id {
            self.follow_restart(&session);
        } else if self.voice.has_told(Event::Silent) {
            self.voice
                .tell(Level::Info, format_args!("the board answers again"));
        }
        self.pins.reset_reason.set(session.reset_reason);
        self.pins.gate_close.set(session.gate_close);
        self.sequence = session.last_sequence;
        self.last = None;
        self.arrival = None;
        self.apply_at = None;
        for stepgen in &mut self.stepgens {
            stepgen.forget_latch();
        }
        for encoder in &mut self.encoders {
            encoder.forget_latch();
        }
        self.phase = Phase::Online {
            token: session.token,
        };
        self.disarmed_settings.forget();
        self.periods.forget();
        self.arm.forget();
        self.halting = None;
        self.first_answer = true;
        self.answered = false;
        self.missing = 0;
        self.packets.recovered();
        self.tell_group();
    }

    /// The firmware has restarted since: its settings are gone, and its counts may be, too.
    fn follow_restart(&mut self, session: &Session) {
        let why =
            ResetReason::from_code(session.reset_reason as u8).unwrap_or(ResetReason::Unknown);
        // Starts since power-up are counted in the low half.
        let other_record = (session.boot_id ^ self.boot_id) >> 16 != 0;
        self.new_fabric = why == ResetReason::PowerUp || other_record;
        self.boot_id = session.boot_id;
        self.ethernet.forget();
        self.tell_restart(why);
    }

    /// The board has started anew, by its own word or by its clock.
    pub(super) fn tell_restart(&mut self, why: ResetReason) {
        self.restarted = true;
        self.voice.once(
            Event::Restarted,
            format_args!("the board has restarted (reason: {why}); home and enable again when the machine is in order"),
        );
    }

    /// The owner of the board after our request: if it is not us, the operator is told.
    pub(super) fn owned(&mut self, token: u32, ip: u32, port: u32) {
        if token != 0 || ip == 0 {
            return;
        }
        if self.foreign_owner.replace((ip, port)) == Some((ip, port))
            && self.voice.has_told(Event::Owned)
        {
            return;
        }
        let there = Owner(
            SocketAddrV4::new(Ipv4Addr::from_bits(ip), port as u16),
            self.link.local(),
        );
        self.voice.once(
            Event::Owned,
            format_args!("the board is driven by {there} now; stop LinuxCNC there to take it back"),
        );
    }
}
