//! A host that drives the board itself, as LinuxCNC's driver does: a session, settings, an exchange
//! in every period.

use crate::rig::Rig;
use firmware::machine::Machine;
use firmware::session::Peer;
use sim::model_board::ModelBoard;
use wire::etherbone::{HEADER, record};
use wire::exchange::{COMMAND_MAX, Command, REQUEST_OVERHEAD, Status};
use wire::{MAX_WORDS, map};

/// Where it is.
pub const HOST: Peer = Peer {
    ip: 0xc0a8_0201,
    port: 40_000,
};

/// What the loop of the firmware does with a datagram of another host; words of the answer.
pub fn post(
    machine: &mut Machine<ModelBoard>,
    words: &[u32],
    reply: &mut [u32; MAX_WORDS],
) -> usize {
    let answer = machine.datagram(words, HOST, reply);
    let length = answer.map_or(0, <[u32]>::len);
    if machine.server.owes_path() {
        machine.hold_path();
    }
    length
}

pub struct Client {
    pub command: Command,
}

impl Client {
    /// With the session of this board.
    pub fn of(rig: &mut Rig) -> Self {
        let mut client = Client {
            command: Command::default(),
        };
        client.acquire(rig);
        assert_ne!(client.command.token, 0, "the session is another host's");
        client
    }

    /// The session, or the session once more.
    pub fn acquire(&mut self, rig: &mut Rig) {
        let nonce = (rig.now() as u32) | 1;
        let request = [
            HEADER,
            0,
            record(1, 1),
            map::SESSION_ACQUIRE,
            nonce,
            0,
            map::SESSION_TOKEN,
        ];
        let mut reply = [0; MAX_WORDS];
        post(&mut rig.machine, &request, &mut reply);
        self.command.token = reply[4];
        self.command.sequence = 0;
    }

    pub fn write(&self, rig: &mut Rig, base: u32, words: &[u32]) {
        let mut request = vec![HEADER, 0, record(words.len(), 0), base];
        request.extend(words);
        post(&mut rig.machine, &request, &mut [0; MAX_WORDS]);
    }

    pub fn read(&self, rig: &mut Rig, address: u32) -> u32 {
        let mut reply = [0; MAX_WORDS];
        let request = [HEADER, 0, record(0, 1), 0, address];
        post(&mut rig.machine, &request, &mut reply);
        reply[4]
    }

    /// One command; `None`: refused.
    pub fn exchange(&mut self, rig: &mut Rig) -> Option<Status> {
        self.command.sequence = self.command.sequence.wrapping_add(1);
        let channels = rig.machine.server.ident().channels;
        let mut words = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let request = self.command.emit_request(channels, &mut words)?;
        let mut reply = [0; MAX_WORDS];
        let length = post(&mut rig.machine, request, &mut reply);
        Status::parse_reply(&reply[..length], channels).ok()
    }

    /// Armed, with these axes enabled.
    pub fn arm(&mut self, rig: &mut Rig, axes: u16) {
        self.command.enable = true;
        self.command.stepgen_enable = axes;
        for request in [false, true, true] {
            self.command.enable_request = request;
            self.exchange(rig).expect("the session is ours");
        }
        assert!(rig.machine.server.safety().state() == wire::State::Armed);
    }

    pub fn release(&self, rig: &mut Rig) {
        self.write(rig, map::SESSION_RELEASE, &[self.command.token]);
    }
}
