//! The twin's part of the fast path: the exchanges that the gateware executes and answers without
//! the firmware ([`firmware::pass`]).
//!
//! As in the image's loop, passes are handed out behind the frames and housekeeping, and everything
//! but a guest takes them back. A UDP payload comes to the gateware as the frame that its host
//! would have sent. The answer goes out as soon as it is gathered, some 70 clocks behind the
//! question; on a board its first byte leaves long before that, and its last one later.

use super::ethernet::{Received, framed};
use super::letters::Letter;
use super::{HOST, Service, Twin};
use crate::gmii::MIN_FRAME;
use firmware::cores::Board as _;
use firmware::net::{Datagram, Frame as _, HEADERS, Us};
use firmware::session::Peer;

/// The MAC address of every host where the network is datagrams.
const HOST_MAC: [u8; 6] = [2, 0, 0, 0, 0, 1];
/// What such a host sends.
const TTL: u8 = 64;
/// Nanoseconds of a byte on the wire.
const BYTE_NS: u64 = 8;

impl Twin {
    /// A datagram's sender, where the network is datagrams.
    pub(super) fn sender(peer: Peer) -> Datagram {
        let [a, b, c, d, e, f] = HOST_MAC;
        Datagram {
            peer,
            mac: (u16::from_be_bytes([a, b]), u32::from_be_bytes([c, d, e, f])),
            length: 0,
            options: 0,
            service: 0,
            ttl: TTL,
        }
    }

    /// Clocks of so many bytes on the wire.
    pub(super) fn on_wire(&self, bytes: usize) -> u64 {
        let ns = bytes as u64 * BYTE_NS;
        (ns * self.clockwork.sys_hz).div_ceil(1_000_000_000)
    }

    /// What came has ended. Does the gateware execute it?
    pub(super) fn executes(&mut self, letter: &Letter) -> bool {
        // A frame that came while the last answer was gathered is none for the fast path.
        if self.owner.is_none() || !self.machine.board.hears() {
            return false;
        }
        let Some(mut frame) = self.as_frame(letter) else {
            return false;
        };
        frame.resize(frame.len().max(MIN_FRAME), 0);
        let received = Received(&frame);
        // Word 0 begins two bytes in front of the frame.
        let words = (frame.len() + 2).div_ceil(4);
        let words: Vec<u32> = (0..words).map(|n| received.word(n)).collect();
        self.machine.board().hear(&words, frame.len())
    }

    fn as_frame(&self, letter: &Letter) -> Option<Vec<u8>> {
        match letter.service {
            Service::Cable => Some(letter.payload.clone()),
            Service::Etherbone => {
                let (words, []) = letter.payload.as_chunks() else {
                    return None;
                };
                let words: Vec<u32> = words.iter().map(|word| u32::from_be_bytes(*word)).collect();
                let us = self.machine.us;
                let host = Us {
                    mac: HOST_MAC,
                    ip: HOST,
                    port: letter.port,
                };
                let [high, low] = firmware::net::to_mac(us.mac);
                let peer = Peer {
                    ip: us.ip,
                    port: us.port,
                };
                let to = Datagram {
                    mac: (high as u16, low),
                    ..Self::sender(peer)
                };
                Some(framed(&host, &to, &words))
            }
            Service::Discovery | Service::Dhcp => None,
        }
    }

    /// The gateware has answered what it executed. True if the host has the answer.
    pub(super) fn executed(&mut self) -> bool {
        let Some(letter) = self.executing.take() else {
            return false;
        };
        let mut answer = self.machine.board().answer();
        if letter.service != Service::Cable {
            answer.drain(..HEADERS);
        }
        self.reply(letter.port, letter.service, &letter.payload, answer);
        if !self.frozen {
            self.settle();
        }
        !self.replies.is_empty()
    }

    /// The firmware's loop looks whether a command was executed.
    pub(super) fn settle(&mut self) {
        if self.machine.executed() {
            self.machine.alone();
            self.hold_path();
            if self.machine.due(self.machine.patience(true)) {
                self.housekeeping();
            }
        }
        self.offer();
    }

    /// The answer is on its way: now there is time for the decelerations.
    pub(super) fn hold_path(&mut self) {
        if self.machine.owes_path() {
            self.machine.alone().hold_path();
        }
    }

    /// The owner's next exchange may be executed without the firmware, as soon as the last answer
    /// has left.
    pub(super) fn offer(&mut self) {
        self.offer_at = u64::MAX;
        if self.owner.is_none() || self.frozen {
            return;
        }
        let sent = self.machine.board.sent_at();
        if sent > self.clock_now() {
            self.offer_at = sent;
        } else {
            self.machine.offer();
        }
    }

    fn clock_now(&self) -> u64 {
        self.machine.board.clock()
    }

    /// Exchanges of a datagram's sender can be judged in advance from now on, if it is the owner.
    pub(super) fn judge_ahead_for(&mut self, datagram: &Datagram) {
        let session = self.machine.session();
        if datagram.options != 0 || !session.is_owner(datagram.peer) {
            return;
        }
        let owner = Datagram {
            length: 0,
            ..*datagram
        };
        let token = session.token_for(datagram.peer);
        if self.owner == Some((owner, token)) {
            return;
        }
        let machine = self.machine.alone();
        if machine.board.sending() {
            return;
        }
        let (us, shape, boot_id) = (machine.us, *machine.shape(), machine.boot_id());
        machine.board.guard(&owner, token, &us, &shape, boot_id);
        self.owner = Some((owner, token));
    }

    /// The session may have no owner any more.
    pub(super) fn forget_owner(&mut self) {
        let session = self.machine.session();
        let gone = |(owner, _): &(Datagram, u32)| !session.is_owner(owner.peer);
        if self.owner.as_ref().is_some_and(gone) {
            self.machine.alone();
            self.owner = None;
        }
    }
}
