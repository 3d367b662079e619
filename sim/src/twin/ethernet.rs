//! The twin's other network: Ethernet frames, told apart by the firmware's own [`net::classify`]
//! and taken by its services, as in the image's loop.
//!
//! Times are round figures as everywhere in the twin: a frame is taken [`super::ANSWER`] clocks
//! after it came, and the MAC has a place for each. So the twin shows what is answered, and the
//! Verilated board shows what it costs.

use super::{Device, Reply, Service, Twin};
use crate::gmii::MIN_FRAME;
use firmware::net::{self, Class, Datagram, Frame, Slot, UdpPorts, Us};
use firmware::{reserve, services};
use wire::{MAX_WORDS, Refusal};

/// A received frame, as words.
pub(super) struct Received<'f>(pub(super) &'f [u8]);

impl Frame for Received<'_> {
    fn word(&self, index: usize) -> u32 {
        // Two bytes in: word 0 begins in front of the frame.
        let byte = |n: usize| (4 * index + n).checked_sub(2);
        let at = |n| byte(n).and_then(|at| self.0.get(at)).copied();
        u32::from_be_bytes([0, 1, 2, 3].map(|n| at(n).unwrap_or(0)))
    }
}

/// A frame to be sent, as words.
#[derive(Default)]
struct Written(Vec<u8>);

impl Slot for Written {
    fn put(&mut self, index: usize, word: u32) {
        self.0.resize(self.0.len().max(4 * index + 4), 0);
        self.0[4 * index..4 * index + 4].copy_from_slice(&word.to_be_bytes());
    }
}

/// A datagram of these words from `us`.
pub(super) fn framed(us: &Us, to: &Datagram, words: &[u32]) -> Vec<u8> {
    let mut slot = Written::default();
    net::emit_headers(&mut slot, us, to, words.len() * 4);
    let length = net::emit_payload(&mut slot, words);
    slot.0.drain(..2);
    slot.0.truncate(length);
    slot.0
}

impl Twin {
    /// From now on its network is frames: [`Service::Cable`].
    pub fn plug_in(&mut self) {
        self.cable = true;
        self.start_services();
    }

    /// Takes a frame. Returns the answer that the ROM makes to it, if it makes one, and whether the
    /// frame was the owner's.
    pub(super) fn take_frame(&mut self, frame: &[u8]) -> (Option<Vec<u8>>, bool) {
        let mut bytes = frame.to_vec();
        bytes.resize(bytes.len().max(MIN_FRAME), 0);
        let frame = Received(&bytes);
        self.machine.received();
        let ports = match self.services {
            Some(_) => services::PORTS,
            None => UdpPorts::default(),
        };
        let mut payload = [0; MAX_WORDS];
        let us = &self.machine.us;
        match net::classify(&frame, bytes.len(), us, &ports, &mut payload) {
            Class::Ours(datagram) => {
                let answer = self.datagram(&payload[..datagram.words()], &datagram);
                (answer, self.machine.session().is_owner(datagram.peer))
            }
            Class::Discovery(datagram) => {
                let words = &payload[..datagram.words()];
                (self.discover(words, datagram.peer.port), false)
            }
            Class::Refused(why) => {
                self.machine.refuse(why);
                (None, false)
            }
            Class::Services => {
                let longest = net::longest_in_motion(&frame, self.services.is_some());
                if bytes.len() > longest && crate::services::moving(&self.machine) {
                    self.machine.refuse(Refusal::Oversized);
                    return (None, false);
                }
                (self.serve(&bytes), false)
            }
            Class::Nothing => (None, false),
        }
    }

    fn datagram(&mut self, words: &[u32], datagram: &Datagram) -> Option<Vec<u8>> {
        let mut buffer = [0; MAX_WORDS];
        let peer = datagram.peer;
        let reply = match self.machine.session().is_owner(peer) {
            true => self.machine.alone().datagram(words, peer, &mut buffer),
            false => self.machine.guest().datagram(words, peer, &mut buffer),
        };
        self.judge_ahead_for(datagram);
        let reply = reply.ok().filter(|reply| !reply.is_empty())?;
        self.machine.sent(1);
        Some(framed(&self.machine.us, datagram, reply))
    }

    fn discover(&mut self, words: &[u32], port: u16) -> Option<Vec<u8>> {
        let mut buffer = [0; MAX_WORDS];
        let reply = self.machine.guest().discover(words, port, &mut buffer);
        (!reply.is_empty()).then(|| {
            self.machine.sent(1);
            let us = Us {
                port: wire::DISCOVERY_PORT,
                ..self.machine.us
            };
            framed(&us, &Datagram::broadcast(port), reply)
        })
    }

    /// A frame for the services, or for what answers where there are none.
    fn serve(&mut self, frame: &[u8]) -> Option<Vec<u8>> {
        let Some(services) = &mut self.services else {
            let mut room = [0; reserve::ROOM];
            let length = reserve::answer(frame, &self.machine.us, &mut room)?;
            self.machine.sent(1);
            return Some(room[..length].to_vec());
        };
        let sent = services.frame(frame, self.machine.guest());
        self.send_frames(sent);
        self.jobs_at = self.clock();
        None
    }

    /// A turn of the services. True if they sent something.
    pub(super) fn turn_services(&mut self) -> bool {
        let now = self.clock();
        let Some(services) = self.services.as_mut().filter(|_| !self.frozen) else {
            self.jobs_at = u64::MAX;
            return false;
        };
        let (sent, due) = services.turn(self.machine.guest());
        self.jobs_at = now + due;
        self.offer();
        self.send_frames(sent);
        !self.replies.is_empty()
    }

    fn send_frames(&mut self, sent: Vec<Vec<u8>>) {
        self.machine.sent(sent.len() as u32);
        for frame in sent {
            self.frames.from_board += 1;
            self.send_frame(frame);
        }
    }

    /// Puts a frame on the cable.
    pub(super) fn send_frame(&mut self, mut frame: Vec<u8>) {
        frame.resize(frame.len().max(MIN_FRAME), 0);
        self.send(Reply {
            service: Service::Cable,
            port: 0,
            payload: frame,
        });
    }

    /// A broadcast as a frame.
    pub(super) fn broadcast_frame(
        &mut self,
        broadcast: firmware::machine::Broadcast,
        words: &[u32],
    ) {
        let us = Us {
            mac: self.machine.us.mac,
            ip: broadcast.from_ip,
            port: broadcast.from_port,
        };
        let frame = framed(&us, &Datagram::broadcast(broadcast.to_port), words);
        self.send_frame(frame);
    }
}
