//! A job and LinuxCNC exclude each other, and a board with a key requires it.

use crate::rig::*;
use crate::stops::client::Client;
use sim::plant::Plant;
use wire::etherbone::{HEADER, record};
use wire::jobs::{End, Request, State, Status, UNATTENDED};
use wire::{Name, jobs};

#[test]
fn a_session_keeps_jobs_out() {
    let mut rig = Rig::plotter();
    rig.send("x", &file(&program("G1 X9 F6000\nM2\n")));
    assert!(rig.linuxcnc());
    assert_eq!(rig.command_with(2, UNATTENDED, 0, "x"), Status::Owned);
    // Uploads and questions do not disturb the session.
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
    let read = [HEADER, 0, record(0, 1), 0, wire::map::SESSION_TOKEN];
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
    let start = unattended(name);
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

/// A host drives the axes, its stop is cut off, and it goes on as after any e-stop: it acquires
/// again, arms and gives the session back.
fn cut_off_and_armed_again(rig: &mut Rig) {
    let mut client = Client::of(rig);
    client.arm(rig, 7);
    rig.estop(true);
    rig.run(5 * MS);
    rig.estop(false);
    client.acquire(rig);
    client.command.enable = true;
    for request in [false, true, true, false, true, true] {
        client.command.enable_request = request;
        client.exchange(rig).expect("the session is ours");
    }
    let safety = *rig.machine.server.safety();
    assert_eq!(safety.state(), wire::State::Armed);
    assert!(safety.position_trusted(), "nothing was cut off since");
    client.release(rig);
    rig.run(5 * MS);
}

#[test]
fn a_stop_that_was_cut_off_is_not_forgotten_when_its_host_arms_again() {
    let mut rig = Rig::switched();
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert!(rig.finish().known);
    cut_off_and_armed_again(&mut rig);
    rig.start("G1 X10 Y10 F9000\nM2\n");
    let report = rig.finish();
    assert!(report.end == End::NotHomed && !report.known, "{report:?}");
    // The switches make it known, for good.
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert!(rig.finish().known);
    rig.start("G1 X10 Y10 F9000\nM2\n");
    let report = rig.finish();
    assert!(report.end == End::Done && report.known, "{report:?}");
    // The same without switches: what was driven is said not to be known.
    let mut rig = Rig::plotter();
    rig.draw("G1 X5 F6000\nM2\n");
    assert!(rig.report().known);
    cut_off_and_armed_again(&mut rig);
    assert!(!rig.report().known);
}

#[test]
fn a_stop_that_was_cut_off_while_a_job_is_looked_through_ends_the_job_before_it_moves() {
    let mut rig = Rig::switched();
    assert_eq!(rig.command_with(11, UNATTENDED, 0, ""), Status::Normal);
    assert!(rig.finish().known);
    // Its lines take some time to be looked through.
    let lines = (0..400).map(|n| format!("G1 X{} Y{} F6000\n", n % 7, n % 5));
    rig.start(&format!("{}M2\n", lines.collect::<String>()));
    assert_eq!(rig.report().state, State::Checking);
    let from = rig.pins();
    let mut client = Client::of(&mut rig);
    client.arm(&mut rig, 7);
    rig.estop(true);
    rig.machine.board.pass(rig.now() + 100);
    rig.machine.housekeeping();
    rig.estop(false);
    client.release(&mut rig);
    assert_eq!(rig.report().state, State::Checking);
    let report = rig.finish();
    assert!(report.end == End::NotHomed && !report.known, "{report:?}");
    assert_eq!(rig.pins(), from);
}
