//! How connections end, and when their places are free again.

use super::host::{Host, TcpSegment, segment_of, visited, visitor};
use super::rig::{Board, MS};
use smoltcp::wire::{TcpControl, TcpSeqNumber};
use std::vec::Vec;
use wire::jobs::{SILENCE_SECONDS, Status};

/// A client that has died without a word is asked after 10 s, and gone after 92.
const GONE_MS: u64 = 92_000;
/// A handshake yields to the next client after so much.
const HANDSHAKE_MS: u64 = 250;
/// A client has so much time to end its half behind the board's.
const CLOSING_MS: u64 = 30_000;
/// The ROM calls every 10 ms, and the board asks and answers in turns.
const MORE_MS: u64 = 200;

/// After how many milliseconds this client gets in; it knocks every `every`.
fn enters_after(board: &mut Board, host: &Host, every: u64, limit: u64) -> u64 {
    let from = board.ms();
    loop {
        let passed = board.ms() - from;
        assert!(passed <= limit, "kept out for {passed} ms");
        let mut host = host.clone();
        if host.enters(board) {
            let alive = match host.to == wire::CONSOLE_PORT {
                true => host.is_heard(board),
                false => host.greets(board) == Some(Status::Normal),
            };
            host.leaves(board);
            if alive {
                return passed;
            }
        }
        board.wait(every);
    }
}

#[test]
fn clients_that_die_without_a_word_leave_their_consoles_within_92_s() {
    let (mut board, _) = visited();
    let next = Host::new(4);
    assert!(!next.clone().knocks(&mut board), "three at a time");
    let asked = board.wait(GONE_MS - 2_000);
    assert!(asked.len() <= 3 * 10, "{} questions", asked.len());
    let tcp = |(_, frame): &(u64, Vec<u8>)| segment_of(frame).is_some();
    assert!(asked.iter().all(tcp), "ARP for a client that was there");
    assert!(!next.clone().knocks(&mut board), "92 s are not over");
    let ms = enters_after(&mut board, &next, 10, 2_000 + MORE_MS);
    assert!(ms > 0, "it was kept out until then");
}

#[test]
fn clients_that_die_in_front_of_an_answer_leave_their_consoles_within_92_s() {
    let (mut board, mut hosts) = visited();
    for host in &mut hosts {
        board.frame(&host.segment(TcpControl::Psh, true, b"help\n"));
    }
    enters_after(&mut board, &Host::new(4), 100, GONE_MS + MORE_MS);
}

#[test]
fn clients_that_shut_their_window_and_die_leave_their_consoles_within_92_s() {
    let (mut board, mut hosts) = visited();
    for host in &mut hosts {
        host.window = 0;
        board.frame(&host.segment(TcpControl::Psh, true, b"help\n"));
    }
    enters_after(&mut board, &Host::new(4), 100, GONE_MS + MORE_MS);
}

#[test]
fn a_client_that_is_alive_keeps_its_console_for_a_day_without_a_word() {
    let (mut board, mut hosts) = visited();
    for _ in 0..24 * 360 {
        for (_, frame) in board.wait_by(10_000, 1_000) {
            let question = segment_of(&frame).expect("TCP");
            assert_eq!(question.control, TcpControl::None);
        }
        for host in &hosts {
            board.frame(&host.nod());
        }
    }
    for host in &mut hosts {
        assert!(host.is_heard(&mut board));
    }
    assert!(!Host::new(4).knocks(&mut board));
}

#[test]
fn a_shut_window_is_asked_for_as_long_as_its_owner_answers() {
    let (mut board, [mut host, ..]) = visited();
    host.window = 0;
    board.frame(&host.segment(TcpControl::Psh, true, b"y\n"));
    host.seq += 2;
    for _ in 0..300 {
        for (_, frame) in board.wait(1_000) {
            let ours = segment_of(&frame).is_some_and(|it| it.host == host.port);
            if ours {
                board.frame(&host.nod());
            }
        }
    }
    host.window = 4096;
    let mut sent = board.frame(&host.nod());
    sent.extend(board.wait(61_000).into_iter().map(|(_, frame)| frame));
    assert_eq!(host.hear(&sent), super::rig::echo("y").as_bytes());
}

#[test]
fn an_acknowledgement_that_comes_with_a_byte_beyond_a_shut_window_is_taken() {
    // A client that has filled the window asks with a byte whether there is room. That segment is
    // the only one that says what the client has: the others were lost.
    for ahead in [-1, 0, 1] {
        let mut board = Board::new();
        let mut host = visitor(&mut board, 1);
        let mut window = 64;
        let mut sent = Vec::new();
        for _ in 0..100 {
            let said = board.frame(&host.segment(TcpControl::Psh, true, b"help\n"));
            let last = segment_of(said.last().expect("an answer")).expect("TCP");
            sent.extend(said);
            host.seq = last.ack.expect("an acknowledgement");
            window = last.window;
            if window == 0 {
                break;
            }
        }
        assert_eq!(window, 0);
        host.hear(&sent);
        let mut probe = host.clone();
        probe.seq = TcpSeqNumber(host.seq.0.wrapping_add(ahead));
        let mut answer = board.frame(&probe.segment(TcpControl::None, true, b"m"));
        answer.extend(board.wait(100).into_iter().map(|(_, frame)| frame));
        let open = answer
            .iter()
            .any(|frame| segment_of(frame).is_some_and(|it| it.window > 0));
        assert!(open, "{ahead}: {} frames", answer.len());
    }
}

#[test]
fn unfinished_handshakes_keep_no_client_out_for_longer_than_250_ms() {
    let mut board = Board::new();
    for round in 0..20 {
        for last in 200..230 {
            for host in [Host::new(last), Host::of_jobs(last)] {
                // From addresses that do not answer.
                let forger = host.at(1_000 + round);
                board.frame(&forger.segment(TcpControl::Syn, false, b""));
            }
        }
        board.wait(13 * u64::from(round));
        for host in [Host::new(1), Host::of_jobs(1)] {
            let host = host.at(2_000 + round);
            enters_after(&mut board, &host, 10, HANDSHAKE_MS + MORE_MS);
        }
    }
}

#[test]
fn a_client_of_jobs_that_dies_leaves_the_line_within_its_silence() {
    let mut board = Board::new();
    let mut dead = Host::of_jobs(1);
    assert!(dead.enters(&mut board));
    assert_eq!(dead.greets(&mut board), Some(Status::Normal));
    let silence = u64::from(SILENCE_SECONDS) * 1_000;
    let ms = enters_after(&mut board, &Host::of_jobs(2), 50, silence + MORE_MS);
    assert!(ms > silence - 1_000, "{ms}");
}

#[test]
fn a_client_that_ends_in_any_state_leaves_a_free_place() {
    type End = fn(&mut Board, &mut Host);
    let ends: [(&str, End); 8] = [
        ("in its handshake", |board, host| {
            assert!(host.knocks(board));
            let sent = board.frame(&host.segment(TcpControl::Fin, true, b""));
            host.seq += 1;
            host.hear(&sent);
            board.frame(&host.nod());
        }),
        ("behind its greeting", |board, host| {
            assert!(host.enters(board));
            host.leaves(board);
        }),
        ("with a line", |board, host| {
            assert!(host.enters(board));
            let sent = board.frame(&host.segment(TcpControl::Fin, true, b"x\n"));
            host.seq += 3;
            assert!(!host.hear(&sent).is_empty(), "the line was answered");
            let sent = board.frame(&host.nod());
            host.hear(&sent);
            board.frame(&host.nod());
        }),
        ("in front of an answer", |board, host| {
            assert!(host.enters(board));
            board.take(&host.segment(TcpControl::Psh, true, b"help\n"));
            host.seq += 5;
            let sent = board.frame(&host.segment(TcpControl::Fin, true, b""));
            host.seq += 1;
            host.hear(&sent);
            let sent = board.frame(&host.nod());
            host.hear(&sent);
            board.frame(&host.nod());
        }),
        ("behind the board's end", |board, host| {
            assert!(host.enters(board));
            let sent = board.frame(&host.segment(TcpControl::Psh, true, b"quit\n"));
            host.seq += 5;
            host.hear(&sent);
            host.leaves(board);
        }),
        ("at the same time as the board", |board, host| {
            assert!(host.enters(board));
            board.frame(&host.segment(TcpControl::Psh, true, b"quit\n"));
            host.seq += 5;
            // It has not seen the board's end.
            let sent = board.frame(&host.segment(TcpControl::Fin, true, b""));
            host.seq += 1;
            host.hear(&sent);
            host.ack += "bye\r\n".len() + 1;
            board.frame(&host.nod());
        }),
        ("twice", |board, host| {
            assert!(host.enters(board));
            let end = host.segment(TcpControl::Fin, true, b"");
            board.frame(&end);
            let sent = board.frame(&end);
            host.seq += 1;
            host.hear(&sent);
            host.ack += 1;
            board.frame(&host.nod());
        }),
        ("with a reset behind its end", |board, host| {
            assert!(host.enters(board));
            board.frame(&host.segment(TcpControl::Fin, true, b""));
            host.seq += 1;
            host.resets(board);
        }),
    ];
    for (what, end) in ends {
        let mut board = Board::new();
        for last in [1, 2, 3] {
            let mut host = Host::new(last).at(40_000 + u16::from(last));
            end(&mut board, &mut host);
        }
        board.wait(20);
        // All three at once, with the same ports.
        let mut next = [1, 2, 3].map(|last: u8| Host::new(last).at(40_000 + u16::from(last)));
        for host in &mut next {
            host.seq += 1 << 24;
            assert!(host.enters(&mut board), "{what}");
        }
        for host in &mut next {
            assert!(host.is_heard(&mut board), "{what}");
        }
    }
}

#[test]
fn clients_that_die_behind_an_end_leave_their_consoles_within_30_s() {
    // Behind the board's end, behind their own, and with the board's end unacknowledged.
    for quits in [true, false] {
        let (mut board, mut hosts) = visited();
        for host in &mut hosts {
            let (control, line) = match quits {
                true => (TcpControl::Psh, &b"quit\n"[..]),
                false => (TcpControl::Fin, &b""[..]),
            };
            board.frame(&host.segment(control, true, line));
        }
        let ms = enters_after(&mut board, &Host::new(4), 100, CLOSING_MS + MORE_MS);
        assert!(ms > 1_000, "{ms}");
    }
}

#[test]
fn a_client_that_is_given_up_hears_of_it() {
    let mut board = Board::new();
    let mut host = visitor(&mut board, 1);
    let sent = board.frame(&host.segment(TcpControl::Psh, true, b"quit\n"));
    host.seq += 5;
    host.hear(&sent);
    // It never ends its own half.
    board.frame(&host.nod());
    let sent = board.wait(CLOSING_MS + MORE_MS);
    let segments: Vec<TcpSegment> = sent.iter().filter_map(|(_, it)| segment_of(it)).collect();
    let reset = segments.iter().find(|it| it.control == TcpControl::Rst);
    assert!(reset.is_some_and(|it| it.seq == host.ack), "{segments:?}");
}

#[test]
fn a_clock_that_has_run_for_50_days_ends_connections_as_before() {
    // 2^32 ms are 49.7 days.
    let wrap = 1u64 << 32;
    for before in [5_000, 50_000, 100_000] {
        let mut board = Board::new();
        // The program counts from its start: the days pass as on a board.
        while board.ms() + 60_000 < wrap - before {
            board.hold(60_000 * MS);
            board.turn();
        }
        board.wait_by(wrap - before - board.ms(), 100);
        let _dead = [1, 2, 3].map(|last| visitor(&mut board, last));
        enters_after(&mut board, &Host::new(4), 100, GONE_MS + MORE_MS);
    }
}
