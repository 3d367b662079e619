//! A job and LinuxCNC exclude each other, and the key is asked for.

use crate::rig::*;
use sim::plant::Plant;
use wire::jobs::{End, Request, Status, UNATTENDED};
use wire::{Name, jobs};

#[test]
fn a_session_keeps_jobs_out() {
    let mut rig = Rig::plotter();
    rig.send("x", &file(&program("G1 X9 F6000\nM2\n")));
    assert!(rig.linuxcnc());
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::Owned);
    // Uploads and questions do not disturb anybody.
    rig.send("y", &file(&program("G1 X8 F6000\nM2\n")));
    rig.run(3500 * MS);
    // It fell silent at rest, so its session is over.
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::Normal);
    assert_eq!(rig.finish().end, End::Done);
}

#[test]
fn a_job_keeps_sessions_out_until_it_is_over() {
    let mut rig = Rig::plotter();
    rig.start("G1 X20 F6000\nG1 X0\nM2\n");
    rig.underway();
    assert!(!rig.linuxcnc());
    assert_eq!(rig.command(10), Status::Normal);
    rig.run(500 * MS);
    assert!(!rig.linuxcnc(), "in a pause");
    assert_eq!(rig.command(1), Status::Normal);
    assert_eq!(rig.finish().end, End::Done);
    assert!(rig.linuxcnc());
}

#[test]
fn a_session_taken_while_a_job_is_looked_through_wins() {
    let mut rig = Rig::plotter();
    rig.start("G1 X20 F6000\nG1 X0\nM2\n");
    assert!(rig.linuxcnc());
    let report = rig.finish();
    assert_eq!(report.end, End::NotArmed);
    assert_eq!(rig.pins(), [0; 3]);
}

#[test]
fn nothing_from_the_wire_is_taken_for_the_program() {
    let mut rig = Rig::plotter();
    rig.start("G1 X20 F6000\nG1 X0\nM2\n");
    rig.underway();
    let read = [0x4e6f_1044, 0, 0x000f_0001, 0, wire::map::SESSION_TOKEN];
    let mut reply = [0; wire::MAX_WORDS];
    let inside = firmware::session::Peer::INSIDE;
    let answer = rig.machine.datagram(&read, inside, &mut reply);
    assert_eq!(answer, Err(wire::Refusal::NotOwner));
    assert_eq!(rig.finish().end, End::Done);
}

#[test]
fn a_board_with_a_key_lets_strangers_look_and_stop_and_nothing_else() {
    let mut rig = Rig::keyed(Plant::direct(0));
    let name = Name::new("x").unwrap();
    let (total, crc) = (1, 0);
    let start = Request::Command {
        code: 2,
        flags: UNATTENDED,
        keepalive: 0,
        name,
    };
    for request in [
        Request::Put { total, crc, name },
        Request::Data {
            offset: 0,
            bytes: &[1],
        },
        Request::Commit,
        Request::Delete { name },
        Request::PutMachine(plotter()),
        Request::Feed { percent: 50 },
        Request::Segment {
            command: 3,
            form: 0,
            words: jobs::Words::new(&[]),
        },
        start,
    ] {
        assert_eq!(rig.status(&request), Status::Key, "{request:?}");
    }
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.status(&Request::GetMachine), Status::NoMachine);
    // A wrong answer, and the right one.
    let challenge = words(&rig.ok(&Request::Challenge));
    assert_ne!(challenge, [0; 4]);
    assert_eq!(
        rig.status(&Request::Respond {
            words: [1, 2, 3, 4]
        }),
        Status::Key
    );
    let answer = answer(challenge, rig.client);
    assert_eq!(
        rig.status(&Request::Respond { words: answer }),
        Status::Normal
    );
    rig.ok(&Request::PutMachine(plotter()));
    rig.draw("G1 X5 F6000\nM2\n");
    // The next connection has to prove it again, and an answer is good once.
    rig.connect();
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "job"), Status::Key);
    assert_eq!(rig.status(&Request::Respond { words: answer }), Status::Key);
}

fn words(payload: &[u8]) -> [u32; 4] {
    let mut reader = jobs::Reader::new(payload);
    reader.words().unwrap()
}

fn answer(challenge: [u32; 4], nonce: u32) -> [u32; 4] {
    let head = wire::auth::Purpose::Acquire.head(challenge);
    firmware::auth::tag(&wire::auth::EXAMPLE_KEY, &head, &[nonce])
}
