//! A board with jobs and its clients on a simulated network.

use crate::rig::*;
use sim::lan_segment::{BOARD_IP, Connection, LanSegment};
use wire::jobs::{FRAME, Frame, Op, PORT, Request, Status};

/// Where TCP has its ports in a frame without IP options.
const SOURCE: usize = 34;
const DESTINATION: usize = 36;

pub struct Lan {
    pub rig: Rig,
    pub segment: LanSegment,
    /// Hosts that are switched off: their ports.
    pub gone: Vec<u16>,
    /// Of 256 frames so many are lost, each way.
    pub loss: u32,
    dice: u32,
    id: u16,
    /// Frames that reached the board and were more than an acknowledgement.
    pub frames: u32,
}

impl Lan {
    pub fn of(rig: Rig) -> Self {
        Lan {
            rig,
            segment: LanSegment::new(BOARD_IP),
            gone: Vec::new(),
            loss: 0,
            dice: 1,
            id: 0,
            frames: 0,
        }
    }

    fn lost(&mut self, frame: &[u8]) -> bool {
        self.dice = self
            .dice
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        let port = |at: usize| u16::from_be_bytes([frame[at], frame[at + 1]]);
        let tcp = frame.len() > DESTINATION + 1 && frame[12..14] == [8, 0];
        let gone = |at| tcp && self.gone.contains(&port(at));
        tcp && self.dice >> 24 < self.loss || gone(SOURCE) || gone(DESTINATION)
    }

    pub fn turn(&mut self) {
        let us = self.rig.now() * 1000 / MS;
        self.segment.poll(us);
        while let Some(frame) = self.segment.take_frame() {
            if self.lost(&frame) {
                continue;
            }
            let mut outer = Outer {
                machine: &mut self.rig.machine,
                sent: &mut self.rig.sent,
            };
            self.rig.jobs.frame(&frame, &mut outer);
            self.frames += u32::from(frame.len() > 54);
        }
        self.rig.turn();
        for frame in std::mem::take(&mut self.rig.sent) {
            if !self.lost(&frame) {
                self.segment.receive(&frame, us, us);
            }
        }
    }

    pub fn run(&mut self, clocks: u64) {
        let end = self.rig.now() + clocks;
        while self.rig.now() < end {
            self.turn();
        }
    }

    /// A connection, if it comes about within so many milliseconds.
    pub fn dial_within(&mut self, ms: u64) -> Option<Connection> {
        self.dial_at(PORT, ms)
    }

    /// The same at another port.
    pub fn dial_at(&mut self, port: u16, ms: u64) -> Option<Connection> {
        let connection = self.segment.connect(port);
        let end = self.rig.now() + ms * MS;
        while !self.segment.established(connection) {
            if self.rig.now() > end || self.segment.closed(connection) {
                self.segment.drop_connection(connection);
                return None;
            }
            self.turn();
        }
        Some(connection)
    }

    pub fn dial(&mut self) -> Connection {
        self.dial_within(3000).expect("a connection")
    }

    /// What comes back, within a second; an answer if it is one.
    pub fn hears(&mut self, connection: Connection) -> Option<(Op, Status, Vec<u8>)> {
        let mut heard = Vec::new();
        let end = self.rig.now() + 9000 * MS;
        while self.rig.now() < end {
            self.turn();
            heard.extend(self.segment.recv(connection));
            if let Some((frame, length)) = Frame::parse(&heard).unwrap() {
                assert_eq!(length, heard.len());
                let (op, status) = frame.answer().unwrap();
                return Some((op, status, frame.payload.to_vec()));
            }
            if self.segment.closed(connection) {
                return None;
            }
        }
        None
    }

    /// So many answers, in their order; fewer if the board hangs up, or says nothing for nine
    /// seconds.
    pub fn answers(&mut self, connection: Connection, count: usize) -> Vec<(Op, Status, Vec<u8>)> {
        let (mut heard, mut answers) = (Vec::new(), Vec::new());
        let end = self.rig.now() + 9000 * MS;
        while answers.len() < count && self.rig.now() < end {
            self.turn();
            heard.extend(self.segment.recv(connection));
            while let Some((frame, length)) = Frame::parse(&heard).unwrap() {
                let (op, status) = frame.answer().unwrap();
                answers.push((op, status, frame.payload.to_vec()));
                heard.drain(..length);
            }
            if self.segment.closed(connection) {
                break;
            }
        }
        answers
    }

    /// Sends all of these one after the other, without reading the answers.
    pub fn pipeline(&mut self, connection: Connection, requests: &[Request]) {
        let mut bytes = Vec::new();
        for request in requests {
            self.id += 1;
            let mut out = [0; FRAME];
            let length = request.emit(self.id, &mut out);
            bytes.extend(&out[..length]);
        }
        while !bytes.is_empty() {
            let taken = self.segment.send(connection, &bytes);
            bytes.drain(..taken);
            self.turn();
        }
    }

    pub fn say(&mut self, connection: Connection, request: &Request) {
        self.id += 1;
        let mut out = [0; FRAME];
        let length = request.emit(self.id, &mut out);
        assert_eq!(self.segment.send(connection, &out[..length]), length);
    }

    pub fn ask(&mut self, connection: Connection, request: &Request) -> (Status, Vec<u8>) {
        self.say(connection, request);
        let (op, status, payload) = self.hears(connection).expect("an answer");
        assert_eq!(op, request.op());
        (status, payload)
    }

    pub fn hello(&mut self, connection: Connection, client: u32) -> Status {
        self.ask(connection, &Request::Hello { client }).0
    }

    /// The client's supply or cable is cut: it neither sends nor receives.
    pub fn vanish(&mut self, connection: Connection) {
        let port = self.segment.local_port(connection);
        self.gone.push(port);
    }

    /// A new client, that wants to be served: after how many ms it was.
    pub fn served_after(&mut self, client: u32) -> u64 {
        let from = self.rig.now();
        loop {
            let ms = (self.rig.now() - from) / MS;
            assert!(ms < 60_000, "no client is served for a minute");
            let Some(connection) = self.dial_within(1000) else {
                self.run(100 * MS);
                continue;
            };
            self.say(connection, &Request::Hello { client });
            let heard = self.hears(connection);
            if heard.is_some_and(|(_, status, _)| status == Status::Normal) {
                let ms = (self.rig.now() - from) / MS;
                self.leave(connection);
                return ms;
            }
            self.leave(connection);
            self.run(100 * MS);
        }
    }

    pub fn leave(&mut self, connection: Connection) {
        self.segment.close(connection);
        for _ in 0..1000 {
            self.turn();
            if self.segment.closed(connection) {
                break;
            }
        }
        self.segment.drop_connection(connection);
    }
}
