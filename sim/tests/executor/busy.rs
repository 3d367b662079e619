//! Stop and Pause are taken from every client, also while another client has the one connection for
//! jobs.

use crate::lan::*;
use crate::rig::*;
use sim::lan_segment::Connection;
use sim::plant::Plant;
use wire::Name;
use wire::jobs::{
    self, End, FRAME, Frame, JobCommand, Op, Report, Request, SILENCE_SECONDS, State, Status,
};

fn command(code: JobCommand) -> Request<'static> {
    Request::Command {
        code: code.code(),
        flags: 0,
        keepalive: 0,
        name: Name::EMPTY,
    }
}

/// A job on its way, and a stranger that has the line and asks for a report all the time.
struct Held {
    lan: Lan,
    stranger: Connection,
    reports: u32,
}

impl Held {
    /// Another client greets the board, and stops the job.
    fn is_stopped_by_another(&mut self) {
        let answers = self.knock(&[Request::Hello { client: 10 }, command(JobCommand::Stop)]);
        assert_eq!(answers.last().map(|answer| answer.1), Some(Status::Normal));
        self.run(1000);
        assert_eq!(self.state(), State::Stopped);
    }

    fn of(mut rig: Rig) -> Self {
        rig.start("G1 X200 F6000\nG1 X0\nM2\n");
        rig.underway();
        let mut lan = Lan::of(rig);
        let stranger = lan.dial();
        assert_eq!(lan.hello(stranger, 666), Status::Normal);
        let reports = 0;
        Held {
            lan,
            stranger,
            reports,
        }
    }

    fn turn(&mut self) {
        // As many requests as the line takes.
        let mut out = [0; FRAME];
        let length = Request::Report.emit(1, &mut out);
        for _ in 0..20 {
            if self.lan.segment.unsent(self.stranger) > 1000 {
                break;
            }
            self.reports += 1;
            self.lan.segment.send(self.stranger, &out[..length]);
        }
        self.lan.turn();
        self.lan.segment.recv(self.stranger);
    }

    fn run(&mut self, ms: u64) {
        let end = self.lan.rig.now() + ms * MS;
        while self.lan.rig.now() < end {
            self.turn();
        }
    }

    /// Sends these requests and reads the answers until the board closes, at most two seconds.
    fn knock(&mut self, requests: &[Request]) -> Vec<(Op, Status, Vec<u8>)> {
        let visitor = self.lan.segment.connect(jobs::PORT);
        let (mut said, mut heard, mut answers) = (false, Vec::new(), Vec::new());
        let end = self.lan.rig.now() + 2000 * MS;
        while self.lan.rig.now() < end && !self.lan.segment.closed(visitor) {
            if !said && self.lan.segment.established(visitor) {
                said = true;
                for (id, request) in (1..).zip(requests) {
                    let mut out = [0; FRAME];
                    let length = request.emit(id, &mut out);
                    assert_eq!(self.lan.segment.send(visitor, &out[..length]), length);
                }
            }
            self.turn();
            heard.extend(self.lan.segment.recv(visitor));
            if self.lan.segment.hung_up(visitor) {
                self.lan.segment.close(visitor);
            }
        }
        while let Some((frame, length)) = Frame::parse(&heard).unwrap() {
            let (op, status) = frame.answer().unwrap();
            answers.push((op, status, frame.payload.to_vec()));
            heard.drain(..length);
        }
        self.lan.segment.drop_connection(visitor);
        answers
    }

    fn state(&mut self) -> State {
        self.lan.rig.jobs.executor().expect("jobs").state()
    }
}

fn held() -> Held {
    Held::of(Rig::plotter())
}

/// What the board said, without the payloads.
fn statuses(answers: &[(Op, Status, Vec<u8>)]) -> Vec<(Op, Status)> {
    let said = answers.iter().map(|(op, status, _)| (*op, *status));
    said.collect()
}

#[test]
fn stop_is_taken_while_a_stranger_holds_the_line() {
    let mut held = held();
    let answers = held.knock(&[Request::Hello { client: 10 }, command(JobCommand::Stop)]);
    let [
        (Op::Hello, Status::Busy, _),
        (Op::Command, Status::Normal, report),
    ] = &answers[..]
    else {
        panic!("{answers:?}");
    };
    let report = Report::parse(report).unwrap();
    assert!(report.state == State::Stopping, "{report:?}");
    held.run(1000);
    assert_eq!(held.state(), State::Stopped);
    // The stranger was answered all the time.
    let before = held.reports;
    held.run(100);
    assert!(held.reports > before);
    held.lan.rig.connect();
    assert_eq!(held.lan.rig.report().end, End::Stopped);
}

#[test]
fn pause_is_taken_without_a_word_of_greeting_and_stop_behind_it() {
    let mut held = held();
    let answers = held.knock(&[command(JobCommand::Pause)]);
    assert_eq!(
        statuses(&answers),
        [(Op::Hello, Status::Busy), (Op::Command, Status::Normal)]
    );
    held.run(1000);
    assert_eq!(held.state(), State::Paused);
    let answers = held.knock(&[command(JobCommand::Stop)]);
    assert_eq!(answers.last().map(|answer| answer.1), Some(Status::Normal));
    held.run(1000);
    assert_eq!(held.state(), State::Stopped);
}

#[test]
fn a_board_with_a_key_also_stops_for_every_client() {
    let mut rig = Rig::keyed(Plant::direct(0));
    rig.prove();
    rig.ok(&Request::PutMachine(plotter()));
    let mut held = Held::of(rig);
    held.is_stopped_by_another();
}

#[test]
fn nothing_else_is_done_for_a_second_client() {
    let mut held = held();
    let name = Name::new("job").unwrap();
    let long = [7; jobs::DATA];
    for request in [
        command(JobCommand::Continue),
        command(JobCommand::Unpause),
        command(JobCommand::Calibrate),
        command(JobCommand::Start),
        Request::Report,
        Request::Commit,
        Request::Delete { name },
        Request::Feed { percent: 10 },
        Request::PutMachine(plotter()),
        Request::Put {
            total: 5,
            crc: 1,
            name,
        },
        Request::Data {
            offset: 0,
            bytes: &long,
        },
    ] {
        let answers = held.knock(&[request]);
        assert_eq!(
            statuses(&answers),
            [(Op::Hello, Status::Busy), (request.op(), Status::Busy)]
        );
        assert_eq!(held.state(), State::Running, "{request:?}");
    }
    let executor = held.lan.rig.jobs.executor().expect("jobs");
    assert!(executor.busy());
}

#[test]
fn a_frame_that_is_none_stops_nothing_and_is_the_last_of_its_connection() {
    let mut held = held();
    let mut out = [0; FRAME];
    let length = command(JobCommand::Stop).emit(1, &mut out);
    for at in 0..length {
        let mut bytes = out[..length].to_vec();
        bytes[at] ^= 1 << (at % 8);
        let mut busy = ::jobs::server::BusyReply::new();
        let mut text = firmware::text::Text::new();
        let mut outer = Outer {
            machine: &mut held.lan.rig.machine,
            sent: &mut held.lan.rig.sent,
        };
        let jobs = &mut held.lan.rig.jobs;
        jobs.busy_reply(&mut busy, &bytes, &mut text, &mut outer);
        // A length that was made longer waits for the rest.
        assert!(text.close || text.bytes().is_empty(), "byte {at}");
        assert_eq!(held.state(), State::Running, "byte {at}");
    }
}

#[test]
fn a_crowd_of_second_clients_does_not_keep_a_stop_out() {
    let mut held = held();
    // More silent clients than there is room for, in every way to be silent.
    let crowd: Vec<Connection> = (0..12)
        .map(|_| {
            let connection = held.lan.segment.connect(jobs::PORT);
            held.run(5);
            connection
        })
        .collect();
    for (n, connection) in crowd.iter().enumerate() {
        if n % 3 == 0 {
            held.lan.segment.send(*connection, &[10, 0]);
        }
        if n % 3 == 1 {
            held.lan.vanish(*connection);
        }
    }
    held.run(20);
    held.is_stopped_by_another();
}

#[test]
fn a_silent_second_client_is_sent_away() {
    let mut held = held();
    let visitor = held.lan.segment.connect(jobs::PORT);
    held.run(u64::from(SILENCE_SECONDS) * 1000 - 100);
    assert!(!held.lan.segment.recv(visitor).is_empty(), "it is told");
    held.lan.segment.send(visitor, &[1]);
    held.run(50);
    assert!(held.lan.segment.established(visitor));
    held.run(200);
    held.lan.segment.send(visitor, &[1]);
    held.run(500);
    assert!(held.lan.segment.closed(visitor));
}
