//! Several clients, and answers that are lost.

use crate::rig::*;
use ferrocnc_tests::drawing;
use ferrocnc_tests::plotter::{Plotter, Scissors};
use host::client::Client;
use host::job::client::{self, Board};
use host::job::stream::Streamer;
use host::keys::Keys;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpStream};
use std::time::Duration;
use wire::jobs::{End, FRAME, JobCommand, Request, State};
use wire::{Name, Refusal, map};

#[test]
fn a_start_with_a_lost_answer_is_asked_again_and_acted_on_once() {
    let _machine = drawing::machine();
    let program = program(b"G1 X3 F6000\nG1 Y2\nM2\n");
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    send(&mut board, "line", &program);
    drop(board);
    // The answer to the Hello comes, the one to the Start does not.
    let welcome = wire::jobs::OVERHEAD + 24;
    let scissors = Scissors::deaf(plotter.jobs, &[welcome]);
    let mut board = scissors.board();
    let report = board
        .start("line", None)
        .expect("it is begun once, and said twice");
    assert_eq!(scissors.cuts(), 1);
    assert_ne!(report.state, State::Stopped, "{report:?}");
    let report = plotter.finish(&mut board);
    assert_eq!((report.end, report.refused), (End::Done, 0), "{report:?}");
    drop(board);
    let drawn = plotter.events();
    assert_eq!(
        drawn.len(),
        5 * 80,
        "one line of 3 mm and one of 2, and no more"
    );
}

/// A job waits for the operator, and a client has the line and keeps it.
fn stops_beside(plotter: Plotter) {
    let program = program(b"G1 X3 F6000\nM0\nG1 Y2\nM2\n");
    let mut holder = plotter.board();
    begin(&mut holder, "held", &program);
    let report = |holder: &mut Board| holder.report().unwrap_or_else(|error| panic!("{error}"));
    while report(&mut holder).state != State::Paused {
        std::thread::sleep(Duration::from_millis(20));
    }
    for (code, state) in [
        (JobCommand::Pause, State::Paused),
        (JobCommand::Stop, State::Stopping),
    ] {
        let said = client::halt_within(plotter.jobs, code, Duration::from_secs(120));
        let said = said.unwrap_or_else(|error| panic!("{code}: {error}"));
        assert_eq!(said.state, state, "{said:?}");
        // The other one is still there.
        report(&mut holder);
    }
    assert_eq!(plotter.finish(&mut holder).end, End::Stopped);
    // The line is free now, and it is the same.
    holder.hang_up();
    let said = client::halt_within(plotter.jobs, JobCommand::Stop, Duration::from_secs(120));
    assert_eq!(said.map(|said| said.state).ok(), Some(State::Stopped));
    plotter.events();
}

#[test]
fn stop_and_pause_are_taken_while_another_client_holds_the_line() {
    stops_beside(Plotter::twin());
    stops_beside(Plotter::streamed(SLOWER, ""));
}

#[test]
fn a_stop_behind_many_requests_counts_though_its_client_has_closed_its_side() {
    let plotter = Plotter::streamed(SLOWER, "");
    let program = program(b"G1 X3 F6000\nM0\nG1 Y2\nM2\n");
    let mut board = plotter.board();
    begin(&mut board, "held", &program);
    board.hang_up();
    let stop = Request::Command {
        code: JobCommand::Stop.code(),
        flags: 0,
        keepalive: 0,
        name: Name::EMPTY,
    };
    let looks = std::iter::repeat_n(Request::List { index: 0 }, 150);
    let requests = [Request::Hello { client: 77 }]
        .into_iter()
        .chain(looks)
        .chain([stop]);
    let mut frame = [0; FRAME];
    let mut bytes = Vec::new();
    for (id, request) in (1..).zip(requests) {
        let length = request.emit(id, &mut frame);
        bytes.extend_from_slice(&frame[..length]);
    }
    let mut stream = TcpStream::connect(plotter.jobs).expect("it listens");
    stream.write_all(&bytes).expect("there is room");
    stream.shutdown(Shutdown::Write).expect("half of it");
    let mut answers = Vec::new();
    // The program may close before all answers are read.
    let _ = stream.read_to_end(&mut answers);
    assert_eq!(plotter.finish(&mut board).end, End::Stopped);
    plotter.events();
}

#[test]
fn a_board_that_executes_jobs_by_itself_refuses_the_window() {
    let plotter = Plotter::twin();
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let error = Streamer::open(&plotter.address(), Keys::default(), any);
    let error = error.expect_err("it executes jobs itself").to_string();
    assert!(error.contains("executes jobs by itself (ready)"), "{error}");

    let patience = Duration::from_millis(300);
    let mut client = Client::open(&plotter.address()).expect("a socket");
    client.acquire().expect("its session");
    let mut client = client.with_patience(patience);
    let refused = map::COUNTERS_REFUSED + 4 * Refusal::ReadOnly.index() as u32;
    let count = |client: &mut Client| client.read(&[refused]).expect("the counter")[0];
    let before = count(&mut client);
    for base in [map::SEGMENTS, map::SESSION_SEGMENTS] {
        let answer = client.write_then_read(base, &[6000], &[map::DESCRIBE]);
        assert!(answer.is_err(), "{answer:?}");
    }
    assert!(count(&mut client) >= before + 2);
    let status = client.read(&[map::SEGMENTS + 4 * STATUS]);
    assert_eq!(
        status.expect("every host may read it")[0] & 0xff,
        0,
        "nothing waits"
    );
    assert_eq!(plotter.events().len(), 0);
}
