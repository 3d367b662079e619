//! The port of jobs as a network sees it: frames, with somebody else's TCP at the other end of a wire that loses them.

use crate::rig::*;
use firmware::ip::{Ip, Taker, Text};
use sim::segment::{BOARD_IP, Connection, Segment};
use wire::Name;
use wire::crc::crc32;
use wire::jobs::{
    self, End, Entry, FRAME, Frame, Op, PORT, Report, Request, SILENCE_SECONDS, Status, UNATTENDED,
};

/// Where TCP has its ports in a frame without IP options.
const SOURCE: usize = 34;
const DESTINATION: usize = 36;

/// The console's stack, which answers ARP on a board.
struct Nobody;

impl Taker for Nobody {
    fn greet(&mut self, _: &mut Text) {}
    fn take(&mut self, bytes: &[u8], _: &mut Text) -> usize {
        bytes.len()
    }
}

struct Lan {
    rig: Rig,
    segment: Segment,
    arp: Ip,
    /// Hosts that are switched off: their ports.
    gone: Vec<u16>,
    /// Of 256 frames so many are lost, each way.
    loss: u32,
    dice: u32,
    id: u16,
    /// Frames that reached the board and were more than an acknowledgement.
    frames: u32,
}

impl Lan {
    fn of(rig: Rig) -> Self {
        Lan {
            rig,
            segment: Segment::new(BOARD_IP),
            arp: Ip::new(),
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

    fn turn(&mut self) {
        let us = self.rig.now() * 1000 / MS;
        self.segment.poll(us);
        while let Some(frame) = self.segment.take_frame() {
            if self.lost(&frame) {
                continue;
            }
            if frame[12..14] == [8, 6] {
                let (board, mut answer) = (self.rig.machine.us, [0; 1514]);
                let length = self.arp.frame(&frame, &board, 0, &mut Nobody, &mut answer);
                self.segment.receive(&answer[..length.unwrap()], us, us);
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

    fn run(&mut self, clocks: u64) {
        let end = self.rig.now() + clocks;
        while self.rig.now() < end {
            self.turn();
        }
    }

    /// A connection, if it comes about within so many milliseconds.
    fn dial_within(&mut self, ms: u64) -> Option<Connection> {
        let connection = self.segment.connect(PORT);
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

    fn dial(&mut self) -> Connection {
        self.dial_within(3000).expect("a connection")
    }

    /// What comes back, within a second; an answer if it is one.
    fn hears(&mut self, connection: Connection) -> Option<(Op, Status, Vec<u8>)> {
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

    fn say(&mut self, connection: Connection, request: &Request) {
        self.id += 1;
        let mut out = [0; FRAME];
        let length = request.emit(self.id, &mut out);
        assert_eq!(self.segment.send(connection, &out[..length]), length);
    }

    fn ask(&mut self, connection: Connection, request: &Request) -> (Status, Vec<u8>) {
        self.say(connection, request);
        let (op, status, payload) = self.hears(connection).expect("an answer");
        assert_eq!(op, request.op());
        (status, payload)
    }

    fn hello(&mut self, connection: Connection, client: u32) -> Status {
        self.ask(connection, &Request::Hello { client }).0
    }

    /// His supply is cut, or his cable: nothing of his comes, nothing reaches him.
    fn vanish(&mut self, connection: Connection) {
        let port = self.segment.local_port(connection);
        self.gone.push(port);
    }

    /// A client nobody knows yet, that wants to be served: after how many ms it was.
    fn served_after(&mut self, client: u32) -> u64 {
        let from = self.rig.now();
        loop {
            let ms = (self.rig.now() - from) / MS;
            assert!(ms < 60_000, "nobody is served for a minute");
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

    fn leave(&mut self, connection: Connection) {
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

const SILENCE_MS: u64 = SILENCE_SECONDS as u64 * 1000;

#[test]
fn the_longest_request_comes_in_one_frame() {
    // The board has two places for frames; who sent it in two would lose one of them as soon as he acknowledged something.
    let mut lan = Lan::of(Rig::plotter());
    let client = lan.dial();
    assert_eq!(lan.hello(client, 9), Status::Normal);
    let bytes = [7; jobs::DATA];
    let put = Request::Put {
        total: 2 * jobs::DATA as u32,
        crc: 1,
        name: Name::new("long").unwrap(),
    };
    assert_eq!(lan.ask(client, &put).0, Status::Normal);
    lan.run(100 * MS);
    let before = lan.frames;
    let data = Request::Data {
        offset: 0,
        bytes: &bytes,
    };
    assert_eq!(lan.ask(client, &data).0, Status::Normal);
    assert_eq!(lan.frames - before, 1);
}

#[test]
fn who_comes_after_a_long_silence_is_let_in_at_once() {
    let mut lan = Lan::of(Rig::plotter());
    lan.run(2 * SILENCE_MS * MS);
    let first = lan.dial();
    assert_eq!(lan.hello(first, 9), Status::Normal);
    lan.leave(first);
    lan.run(2 * SILENCE_MS * MS);
    assert!(lan.served_after(10) < 100);
}

#[test]
fn a_client_that_vanished_keeps_the_next_one_out_no_longer_than_the_silence() {
    // Its cable is pulled behind a Hello, behind a commit, in the middle of a request.
    for pieces in [0, 1, 2] {
        let mut lan = Lan::of(Rig::plotter());
        let first = lan.dial();
        assert_eq!(lan.hello(first, 9), Status::Normal);
        if pieces > 0 {
            let mut out = [0; FRAME];
            let length = Request::List { index: 0 }.emit(77, &mut out);
            let sent = if pieces == 1 { length } else { length - 3 };
            lan.segment.send(first, &out[..sent]);
            lan.run(10 * MS);
        }
        lan.vanish(first);
        let ms = lan.served_after(10);
        // A knock takes a tenth of a second.
        assert!(
            (SILENCE_MS - 500..SILENCE_MS + 500).contains(&ms),
            "{pieces}: {ms} ms"
        );
    }
}

#[test]
fn a_client_that_vanishes_in_its_handshake_keeps_nobody_out_longer_either() {
    let mut lan = Lan::of(Rig::plotter());
    let first = lan.segment.connect(PORT);
    // ARP, and the SYN; its answer finds nobody.
    while lan.rig.sent.is_empty() && lan.segment.board_mac().is_none() {
        lan.turn();
    }
    lan.segment.poll(lan.rig.now() * 1000 / MS);
    let syn = lan.segment.take_frame().expect("a SYN");
    let mut outer = Outer {
        machine: &mut lan.rig.machine,
        sent: &mut lan.rig.sent,
    };
    lan.rig.jobs.frame(&syn, &mut outer);
    lan.vanish(first);
    let ms = lan.served_after(10);
    assert!(ms < SILENCE_MS + 500, "{ms} ms");
}

#[test]
fn a_connection_that_is_reset_in_the_middle_of_an_upload_is_gone_on_with_at_once() {
    let mut lan = Lan::of(Rig::plotter());
    let bytes = file(&program(&"G1 X5 F6000\nG1 X0\n".repeat(300)));
    let put = Request::Put {
        total: bytes.len() as u32,
        crc: crc32(&bytes),
        name: Name::new("long").unwrap(),
    };
    let first = lan.dial();
    assert_eq!(lan.hello(first, 9), Status::Normal);
    assert_eq!(lan.ask(first, &put).0, Status::Normal);
    let data = Request::Data {
        offset: 0,
        bytes: &bytes[..1000],
    };
    assert_eq!(lan.ask(first, &data).0, Status::Normal);
    lan.say(
        first,
        &Request::Data {
            offset: 1000,
            bytes: &bytes[1000..1500],
        },
    );
    lan.segment.abort(first);
    lan.run(50 * MS);
    let from = lan.rig.now();
    let second = lan.dial();
    assert_eq!(lan.hello(second, 9), Status::Normal);
    assert!(lan.rig.now() - from < 100 * MS);
    let (status, offset) = lan.ask(second, &put);
    assert_eq!(status, Status::Normal);
    assert!([1000, 1500].contains(&jobs::word(&offset).unwrap()));
}

#[test]
fn while_somebody_is_there_everybody_else_is_told_so_and_disturbs_nobody() {
    let mut lan = Lan::of(Rig::plotter());
    let first = lan.dial();
    assert_eq!(lan.hello(first, 9), Status::Normal);
    for n in 0..5 {
        let other = lan.dial();
        let (op, status, _) = lan.hears(other).expect("an answer nobody asked for");
        assert_eq!((op, status), (Op::Hello, Status::Busy), "{n}");
        if n % 2 == 0 {
            lan.leave(other);
        } else {
            // Told, and gone without a word: the next one is told, too.
            lan.vanish(other);
        }
        assert_eq!(lan.ask(first, &Request::Report).0, Status::Normal);
    }
    lan.leave(first);
    assert!(lan.served_after(10) < 500);
}

#[test]
fn two_that_come_at_once_are_served_one_after_the_other() {
    let mut lan = Lan::of(Rig::plotter());
    let (one, two) = (lan.segment.connect(PORT), lan.segment.connect(PORT));
    lan.run(20 * MS);
    let status = [one, two].map(|connection| {
        lan.say(connection, &Request::Hello { client: 9 });
        lan.hears(connection).map(|(_, status, _)| status)
    });
    assert_eq!(status, [Some(Status::Normal), Some(Status::Busy)]);
}

#[test]
fn an_upload_beside_a_running_job_over_a_wire_that_loses_frames_is_whole() {
    let mut lan = Lan::of(Rig::plotter());
    lan.rig.start("G1 X40 F3000\nG1 X0\nM2\n");
    lan.rig.underway();
    // One frame of eight.
    lan.loss = 32;
    let text: String = (0..1500)
        .map(|n| format!("G1 X{} Y{} F6000\n", n % 97, n * 7 % 83))
        .collect();
    let bytes = file(&program(&(text + "M2\n")));
    let connection = loop {
        if let Some(connection) = lan.dial_within(5000) {
            break connection;
        }
    };
    assert_eq!(lan.hello(connection, 9), Status::Normal);
    let (total, name) = (bytes.len() as u32, Name::new("beside").unwrap());
    let crc = crc32(&bytes);
    let put = Request::Put { total, crc, name };
    assert_eq!(lan.ask(connection, &put).0, Status::Normal);
    let mut offset = 0;
    for bytes in bytes.chunks(jobs::DATA) {
        let (status, next) = lan.ask(connection, &Request::Data { offset, bytes });
        assert_eq!(status, Status::Normal);
        offset = jobs::word(&next).unwrap();
    }
    let (status, entry) = lan.ask(connection, &Request::Commit);
    assert_eq!(status, Status::Normal);
    let entry = Entry::parse(&entry).unwrap();
    assert!(entry.ready && entry.crc == crc, "{entry:?}");
    let report = Report::parse(&lan.ask(connection, &Request::Report).1).unwrap();
    assert!(
        report.end == End::None || report.end == End::Done,
        "{report:?}"
    );
    lan.loss = 0;
    lan.leave(connection);
    while lan.rig.jobs.executor().busy() {
        lan.turn();
    }
    lan.rig.connect();
    let report = lan.rig.report();
    assert_eq!((report.end, report.steps), (End::Done, [0; 3]));
    assert_eq!(
        lan.rig.command_with(2, UNATTENDED, 0, "beside"),
        Status::Normal
    );
}
