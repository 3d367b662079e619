//! The jobs port on the network: frames, with another TCP implementation at the other end and a
//! wire that loses frames.

use crate::lan::*;
use crate::rig::*;
use wire::Name;
use wire::crc::crc32;
use wire::jobs::{
    self, End, Entry, FRAME, Op, PORT, Report, Request, SILENCE_SECONDS, Status, UNATTENDED,
};

const SILENCE_MS: u64 = SILENCE_SECONDS as u64 * 1000;

#[test]
fn the_longest_request_comes_in_one_frame() {
    // The board has room for two frames. A client that sends a request in two would lose one of
    // them with its next acknowledgement.
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
fn of_two_requests_in_one_frame_a_call_answers_one() {
    // A call does one thing: the board's exchange comes between the two.
    let mut lan = Lan::of(Rig::plotter());
    let client = lan.dial();
    assert_eq!(lan.hello(client, 9), Status::Normal);
    let one = lan.ask(client, &Request::Report).1.len() + jobs::OVERHEAD;
    lan.run(100 * MS);
    lan.say(client, &Request::Report);
    lan.say(client, &Request::Report);
    let us = lan.rig.now() * 1000 / MS;
    lan.segment.poll(us);
    lan.rig.sent.clear();
    let mut outer = Outer {
        machine: &mut lan.rig.machine,
        sent: &mut lan.rig.sent,
    };
    while let Some(frame) = lan.segment.take_frame() {
        lan.rig.jobs.frame(&frame, &mut outer);
    }
    assert_eq!(outer.sent.len(), 0, "a frame is taken, and no more");
    // A request is answered, and the answer sent.
    for sent in [0, 1] {
        lan.rig.jobs.poll(&mut outer);
        assert_eq!(outer.sent.len(), sent);
    }
    let said = |frame: &Vec<u8>| usize::from(u16::from_be_bytes([frame[16], frame[17]])) - 40;
    let first: Vec<usize> = lan.rig.sent.iter().map(said).collect();
    assert_eq!(first, [one]);
    for frame in std::mem::take(&mut lan.rig.sent) {
        lan.segment.receive(&frame, us, us);
    }
    assert_eq!(lan.answers(client, 2).len(), 2);
}

#[test]
fn a_client_after_a_long_silence_is_accepted_at_once() {
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
    // Its cable is pulled after a Hello, after a commit, in the middle of a request.
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
fn a_client_that_vanishes_in_its_handshake_delays_the_next_by_less_than_a_second() {
    let mut lan = Lan::of(Rig::plotter());
    let first = lan.segment.connect(PORT);
    // ARP and the SYN; the client is gone when the answer comes.
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
    assert!(ms < 1_000, "{ms} ms");
}

#[test]
fn a_handshake_that_ends_late_and_with_the_first_request_is_greeted_once() {
    let mut lan = Lan::of(Rig::plotter());
    let connection = lan.segment.connect(PORT);
    while lan.rig.sent.is_empty() && lan.segment.board_mac().is_none() {
        lan.turn();
    }
    let us = |lan: &Lan| lan.rig.now() * 1000 / MS;
    let turn_for = |lan: &mut Lan, frame: Option<Vec<u8>>| {
        let Rig {
            machine,
            sent,
            jobs,
            ..
        } = &mut lan.rig;
        if let Some(frame) = frame {
            jobs.frame(&frame, &mut Outer { machine, sent });
        }
        lan.rig.turn();
        std::mem::take(&mut lan.rig.sent)
    };
    let now = us(&lan);
    lan.segment.poll(now);
    let syn = lan.segment.take_frame();
    // The board's first answer is lost, and the acknowledgement of the second.
    let mut lost = turn_for(&mut lan, syn);
    while lost.is_empty() {
        lost = turn_for(&mut lan, None);
    }
    let mut answers = Vec::new();
    while answers.is_empty() {
        answers = turn_for(&mut lan, None);
    }
    let now = us(&lan);
    lan.segment.receive(&answers[0], now, now);
    lan.segment.poll(now);
    while lan.segment.take_frame().is_some() {}
    assert!(lan.segment.established(connection));
    assert_eq!(lan.hello(connection, 9), Status::Normal);
    assert_eq!(lan.ask(connection, &Request::Report).0, Status::Normal);
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
fn while_a_client_is_connected_every_other_is_told_so_and_does_not_disturb_it() {
    let mut lan = Lan::of(Rig::plotter());
    let first = lan.dial();
    assert_eq!(lan.hello(first, 9), Status::Normal);
    for n in 0..5 {
        let other = lan.dial();
        let (op, status, _) = lan.hears(other).expect("an unrequested answer");
        assert_eq!((op, status), (Op::Hello, Status::Busy), "{n}");
        if n % 2 == 0 {
            lan.leave(other);
        } else {
            // It is told and then vanishes: the next one is told, too.
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
    while lan.rig.jobs.executor().expect("jobs").busy() {
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

/// An upload that does not wait for answers.
fn upload<'a>(name: &str, bytes: &'a [u8]) -> Vec<Request<'a>> {
    let put = Request::Put {
        total: bytes.len() as u32,
        crc: crc32(bytes),
        name: Name::new(name).unwrap(),
    };
    let pieces = (0..).step_by(jobs::DATA).zip(bytes.chunks(jobs::DATA));
    let data = pieces.map(|(offset, bytes)| Request::Data { offset, bytes });
    let mut all = vec![put];
    all.extend(data);
    all.push(Request::Commit);
    all
}

/// All of them were answered, each as what it is, and the last with a job that can be started.
fn whole(requests: &[Request], answers: &[(Op, Status, Vec<u8>)], crc: u32) {
    let asked: Vec<Op> = requests.iter().map(Request::op).collect();
    let answered: Vec<Op> = answers.iter().map(|(op, ..)| *op).collect();
    assert_eq!(answered, asked);
    for (op, status, _) in answers {
        assert_eq!(*status, Status::Normal, "{op}");
    }
    let entry = Entry::parse(&answers.last().unwrap().2).unwrap();
    assert!(entry.ready && entry.crc == crc, "{entry:?}");
}

fn long_job(lines: u32) -> Vec<u8> {
    let text: String = (0..lines)
        .map(|n| format!("G1 X{} Y{} F6000\n", n % 97, n * 7 % 83))
        .collect();
    file(&program(&(text + "M2\n")))
}

#[test]
fn a_commit_that_comes_right_behind_the_last_data_is_answered() {
    for lines in [1, 50, 150, 1500] {
        let mut lan = Lan::of(Rig::plotter());
        let bytes = long_job(lines);
        let client = lan.dial();
        assert_eq!(lan.hello(client, 9), Status::Normal);
        let requests = upload("at once", &bytes);
        lan.pipeline(client, &requests);
        let answers = lan.answers(client, requests.len());
        whole(&requests, &answers, crc32(&bytes));
        // And the next request is answered, too.
        assert_eq!(lan.ask(client, &Request::Report).0, Status::Normal);
    }
}

#[test]
fn a_commit_that_waits_beside_a_dense_job_is_answered() {
    let mut lan = Lan::of(Rig::plotter());
    // Chords of 45 um, at 100 mm/s.
    lan.rig
        .start("G1 X10 Y10 F6000\nG2 X10 Y10 I2 J0\nG2 X10 Y10 I2 J0\nG1 X0 Y0\nM2\n");
    lan.rig.underway();
    let bytes = long_job(800);
    let client = lan.dial();
    assert_eq!(lan.hello(client, 9), Status::Normal);
    let requests = upload("beside", &bytes);
    lan.pipeline(client, &requests);
    let answers = lan.answers(client, requests.len());
    whole(&requests, &answers, crc32(&bytes));
    lan.leave(client);
    while lan.rig.jobs.executor().expect("jobs").busy() {
        lan.turn();
    }
    lan.rig.connect();
    assert_eq!(lan.rig.report().end, End::Done);
}

#[test]
fn a_commit_is_answered_though_the_client_has_said_all_it_will() {
    let mut lan = Lan::of(Rig::plotter());
    let bytes = long_job(50);
    let client = lan.dial();
    assert_eq!(lan.hello(client, 9), Status::Normal);
    let requests = upload("and over", &bytes);
    lan.pipeline(client, &requests);
    lan.segment.close(client);
    let answers = lan.answers(client, requests.len());
    whole(&requests, &answers, crc32(&bytes));
}
