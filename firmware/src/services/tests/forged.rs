//! Segments of strangers, and damaged ones: what they may not do to a client that is there.

use super::host::{Host, TcpSegment, segment_of, visited};
use super::rig::{Board, echo};
use smoltcp::wire::{Ipv4Packet, TcpControl, TcpSeqNumber};
use std::vec::Vec;
use wire::jobs::Status;

/// Is there no answer but an acknowledgement with the board's current numbers?
fn only_says_where_it_is(sent: &[Vec<u8>], host: &Host, board_next: TcpSeqNumber) -> bool {
    sent.iter().all(|frame| {
        let Some(segment) = segment_of(frame) else {
            return false;
        };
        segment.control == TcpControl::None
            && (segment.seq, segment.ack) == (board_next, Some(host.seq))
            && segment.data.is_empty()
    })
}

/// Numbers that are not the next one: in the window, at its edges, and far outside.
const OTHERS: [i32; 12] = [
    1,
    2,
    63,
    64,
    100,
    5_000,
    1 << 30,
    -1,
    -2,
    -64,
    -5_000,
    i32::MIN,
];

#[test]
fn a_forged_reset_has_to_hit_the_very_number() {
    let (mut board, [mut host, ..]) = visited();
    for distance in OTHERS {
        board.wait(2_000);
        for ack in [true, false] {
            let mut forged = host.clone();
            forged.seq = TcpSeqNumber(host.seq.0.wrapping_add(distance));
            let sent = board.frame(&forged.segment(TcpControl::Rst, ack, b""));
            assert!(
                only_says_where_it_is(&sent, &host, host.ack),
                "{distance}: {sent:?}"
            );
        }
    }
    assert!(host.is_heard(&mut board));
    assert!(!Host::new(4).knocks(&mut board), "all places are taken");
    host.resets(&mut board);
    assert!(Host::new(4).enters(&mut board), "the right one is heard");
}

#[test]
fn a_reset_with_the_very_number_is_heard_in_every_state() {
    // While a line waits in the board, while its answer waits for an acknowledgement, behind the
    // client's end.
    for case in 0..4 {
        let (mut board, [mut host, ..]) = visited();
        match case {
            0 => {
                board.take(&host.segment(TcpControl::Psh, true, b"x\n"));
                host.seq += 2;
            }
            1 => {
                board.frame(&host.segment(TcpControl::Psh, true, b"help\n"));
                host.seq += 5;
            }
            2 => {
                board.frame(&host.segment(TcpControl::Fin, true, b""));
                host.seq += 1;
            }
            _ => {
                board.frame(&host.segment(TcpControl::Fin, true, b"quit\n"));
                host.seq += 6;
            }
        }
        host.resets(&mut board);
        assert!(Host::new(4).enters(&mut board), "case {case}");
    }
}

#[test]
fn a_reset_ends_a_handshake_only_with_its_number() {
    let mut board = Board::new();
    let mut host = Host::new(1);
    assert!(host.knocks(&mut board));
    let mut forged = host.clone();
    forged.seq += 77;
    board.frame(&forged.segment(TcpControl::Rst, true, b""));
    let sent = board.frame(&host.nod());
    assert!(!host.hear(&sent).is_empty(), "greeted");
    assert!(host.is_heard(&mut board));
}

#[test]
fn what_acknowledges_what_was_never_sent_is_not_taken() {
    let (mut board, [mut host, ..]) = visited();
    let logins = board.rom.logins;
    for ahead in [1, 1000, 1 << 30, i32::MIN] {
        for data in [&b""[..], b"login\n"] {
            board.wait(2_000);
            let mut forged = host.clone();
            forged.ack = TcpSeqNumber(host.ack.0.wrapping_add(ahead));
            let sent = board.frame(&forged.segment(TcpControl::None, true, data));
            assert!(
                only_says_where_it_is(&sent, &host, host.ack),
                "{ahead}: {sent:?}"
            );
        }
    }
    // A segment without an acknowledgement is ignored.
    let sent = board.frame(&host.segment(TcpControl::Psh, false, b"login\n"));
    assert_eq!(sent, Vec::<Vec<u8>>::new());
    assert_eq!(board.rom.logins, logins);
    assert!(host.is_heard(&mut board));
}

#[test]
fn data_outside_the_window_is_not_taken() {
    let (mut board, [mut host, ..]) = visited();
    let logins = board.rom.logins;
    for distance in [64, 65, 5_000, 1 << 30, -6, -64, -5_000, i32::MIN] {
        board.wait(2_000);
        let mut forged = host.clone();
        forged.seq = TcpSeqNumber(host.seq.0.wrapping_add(distance));
        let sent = board.frame(&forged.segment(TcpControl::Psh, true, b"login\n"));
        assert!(only_says_where_it_is(&sent, &host, host.ack), "{distance}");
    }
    assert_eq!(board.rom.logins, logins);
    assert!(host.is_heard(&mut board));
}

#[test]
fn a_forged_knock_of_the_visitor_changes_nothing_and_one_of_its_own_is_served_soon() {
    let (mut board, [mut host, ..]) = visited();
    for distance in [0, 1, 77, 1 << 20, -5] {
        board.wait(2_000);
        let mut forged = host.clone();
        forged.seq = TcpSeqNumber(host.seq.0.wrapping_add(distance));
        let sent = board.frame(&forged.segment(TcpControl::Syn, false, b""));
        assert!(only_says_where_it_is(&sent, &host, host.ack), "{distance}");
    }
    assert!(host.is_heard(&mut board));
    // The host restarts, and begins anew with the same port. It refuses the board's next question.
    let mut anew = Host::new(1);
    anew.seq = TcpSeqNumber(12_345);
    assert!(!anew.knocks(&mut board));
    let mut asked = None;
    for _ in 0..12 {
        for (at, frame) in board.wait(1_000) {
            let segment = segment_of(&frame).expect("TCP");
            // All hosts of the test have this port; their addresses tell them apart.
            if frame[30..34] == anew.ip.octets() && asked.is_none() {
                asked = Some(at);
                let reset = TcpSegment {
                    host: anew.port,
                    control: TcpControl::Rst,
                    seq: segment.ack.expect("a question"),
                    ack: None,
                    window: 0,
                    data: Vec::new(),
                };
                board.frame(&anew.frame(&reset));
            }
        }
        if asked.is_some() && anew.enters(&mut board) {
            return assert!(anew.is_heard(&mut board));
        }
    }
    panic!("kept out by itself: asked at {asked:?}");
}

#[test]
fn two_stacks_that_disagree_do_not_talk_for_ever() {
    let (mut board, [host, ..]) = visited();
    board.wait(2_000);
    let mut wrong = host.clone();
    wrong.seq = TcpSeqNumber(host.seq.0 - 5_000);
    let wrong = wrong.nod();
    let mut answers = 0;
    for _ in 0..1_000 {
        answers += board.frame(&wrong).len();
        board.wait(10);
    }
    assert!((1..=50).contains(&answers), "{answers} answers in 10 s");
}

/// Changes bytes of a frame; corrects the IP header's sum if asked to.
fn spoiled(frame: &[u8], changes: &[(usize, u8)], seal: bool) -> Vec<u8> {
    let mut frame = frame.to_vec();
    for (at, byte) in changes {
        frame[*at] = *byte;
    }
    if seal {
        Ipv4Packet::new_unchecked(&mut frame[14..]).fill_checksum();
    }
    frame
}

#[test]
fn while_the_machine_moves_a_segment_of_no_connection_costs_no_answer() {
    let mut board = Board::new();
    let stranger = Host::new(5).segment(TcpControl::Psh, true, b"evil\n");
    assert_eq!(
        board.frame(&stranger).len(),
        1,
        "a reset, or a question for its MAC address"
    );
    board.rom.moving = true;
    assert_eq!(board.frame(&stranger), Vec::<Vec<u8>>::new());
    assert!(Host::new(6).enters(&mut board), "a client still enters");
}

#[test]
fn a_wrong_sum_and_a_fragment_are_nothing() {
    let (mut board, [mut host, other, _]) = visited();
    other.resets(&mut board);
    let logins = board.rom.logins;
    let good = host.segment(TcpControl::Psh, true, b"login\n");
    let length = good.len() as u8 - 14;
    let knock = Host::new(4).segment(TcpControl::Syn, false, b"");
    let reset = host.segment(TcpControl::Rst, false, b"");
    for frame in [&good, &knock, &reset] {
        for (what, changes, seal) in [
            ("TCP's sum", &[(50, frame[50] ^ 1)][..], false),
            ("no TCP sum", &[(50, 0), (51, 0)], false),
            ("IP's sum", &[(24, frame[24] ^ 1)], false),
            ("a first fragment", &[(20, 0x20)], true),
            ("a middle fragment", &[(20, 0x20), (21, 1)], true),
            ("a last fragment", &[(20, 0), (21, 1)], true),
            ("another board's address", &[(33, 51)], true),
            ("TCP's header of 4 words", &[(46, 0x40)], false),
            ("TCP's header of 15 words", &[(46, 0xf0)], false),
            ("IP says it is longer", &[(17, length + 4)], true),
            ("IP says it is shorter", &[(17, 30)], true),
            ("IP's header of 4 words", &[(14, 0x44)], true),
            ("IP's header of 15 words", &[(14, 0x4f)], false),
        ] {
            let sent = board.frame(&spoiled(frame, changes, seal));
            assert_eq!(sent, Vec::<Vec<u8>>::new(), "{what}");
        }
        for length in 0..frame.len() {
            let sent = board.frame(&frame[..length]);
            assert_eq!(sent, Vec::<Vec<u8>>::new(), "{length} bytes");
        }
    }
    assert_eq!(board.rom.logins, logins);
    assert!(host.is_heard(&mut board));
    assert!(
        Host::new(4).enters(&mut board),
        "and the free place is free"
    );
}

#[test]
fn ten_thousand_knocks_of_strangers_harm_no_client_and_keep_no_client_out_afterwards() {
    let mut board = Board::new();
    let mut host = Host::new(1);
    assert!(host.enters(&mut board));
    let mut jobs = Host::of_jobs(1).at(41_000);
    assert!(jobs.enters(&mut board));
    assert_eq!(jobs.greets(&mut board), Some(Status::Normal));
    for n in 0..10_000u32 {
        let knock = match n % 2 {
            0 => Host::new(100 + (n % 100) as u8),
            _ => Host::of_jobs(100 + (n % 100) as u8),
        };
        let mut knock = knock.at(1_000 + (n / 100) as u16);
        knock.seq = TcpSeqNumber(n.wrapping_mul(0x9e37_79b9) as i32);
        board.frame(&knock.segment(TcpControl::Syn, false, b""));
        board.wait(if n % 10 == 0 { 10 } else { 0 });
        if n % 100 == 0 {
            assert!(host.is_heard(&mut board), "{n}");
            assert_eq!(jobs.greets(&mut board), Some(Status::Normal), "{n}");
        }
    }
    board.wait(250);
    let mut others = [2, 3].map(Host::new);
    for other in &mut others {
        assert!(other.enters(&mut board) && other.is_heard(&mut board));
    }
    assert!(host.is_heard(&mut board));
    assert!(Host::of_jobs(2).enters(&mut board), "to be told Busy");
}

#[test]
fn bytes_in_any_pieces_and_order_are_the_same_line() {
    let (mut board, [mut host, ..]) = visited();
    let line = b"one line in pieces\n";
    // The second half first, then the first half, twice.
    let mut second = host.clone();
    second.seq += 9;
    board.frame(&second.segment(TcpControl::Psh, true, &line[9..]));
    let first = host.segment(TcpControl::Psh, true, &line[..9]);
    let mut sent = board.frame(&first);
    sent.extend(board.frame(&first));
    host.seq += line.len();
    sent.extend(board.frame(&host.nod()));
    let mut heard = host.hear(&sent);
    // The half that came too early may have been dropped: it is sent again.
    if heard.is_empty() {
        host.seq = TcpSeqNumber(host.seq.0 - (line.len() - 9) as i32);
        heard = host.says(&mut board, &line[9..]);
    }
    assert_eq!(heard, echo("one line in pieces").as_bytes());
    board.frame(&host.nod());
    assert!(host.is_heard(&mut board));
}
