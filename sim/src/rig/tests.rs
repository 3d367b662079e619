use super::*;
use crate::board::tests::Toy;

/// The toy sends every frame back as it is: an ARP request seen from the other side.
fn rig() -> Rig<Toy> {
    let mut board = Board::new(Toy::default(), 60_000_000, Plant::direct(1));
    board.reset(|_| {});
    Rig::around(board, BOARD_IP)
}

#[test]
fn frames_go_round_and_are_captured() {
    let mut rig = rig();
    rig.capture_frames();
    rig.inject_frame(&[0x5a; 100]);
    rig.run(1000);
    assert_eq!(rig.take_frames(), [vec![0x5a; 100]]);
    assert_eq!((rig.frames.to_board, rig.frames.from_board), (1, 1));
}

#[test]
fn faults_strike_as_often_as_told() {
    let mut rig = rig();
    rig.capture_frames();
    let mut frame = |n, plan: &str| {
        rig.trouble(&plan.parse().unwrap()).unwrap();
        rig.inject_frame(&[n; 60]);
        rig.run(1000);
        rig.take_frames()
    };
    assert_eq!(frame(0, "to-board:drop=1"), [[0; 60]; 0]);
    assert_eq!(frame(1, "from-board:drop=1"), [[1; 60]; 0]);
    assert_eq!(frame(2, "to-board:dup=1"), [[2; 60]; 2]);
    assert_eq!(frame(3, "off corrupt=1 seed=1"), [[3; 60]; 0]);
    assert_eq!(frame(4, "off pull"), [[4; 60]; 0]);
    assert_eq!(frame(5, "plug"), [[5; 60]]);
    assert_eq!(
        (rig.frames.dropped, rig.frames.malformed_from_board),
        (3, 1)
    );
    assert!(rig.faults.quiet());
}

#[test]
fn a_late_frame_is_fed_when_it_is_due() {
    let mut rig = rig();
    rig.capture_frames();
    rig.trouble(&"to-board:delay=1ms".parse().unwrap()).unwrap();
    assert_eq!(rig.inject_frame(&[7; 60]), None);
    rig.run(59_000);
    assert_eq!(rig.take_frames(), [[0; 60]; 0]);
    rig.run(2000);
    assert_eq!(rig.take_frames(), [[7; 60]]);
}

#[test]
fn a_supply_that_fails_is_for_the_twin() {
    let error = rig().trouble(&"power".parse().unwrap()).unwrap_err();
    assert!(error.contains("reboot"), "{error}");
}

#[test]
fn a_silent_board_is_an_error_that_says_so() {
    let mut board = Board::new(Toy::default(), 60_000_000, Plant::default());
    board.silicon().mute = true;
    board.reset(|_| {});
    let mut rig = Rig::around(board, BOARD_IP);
    let error = rig.wait_ready(100_000).unwrap_err().to_string();
    assert!(
        error.contains("192.168.2.50") && error.contains("100000 clocks"),
        "{error}"
    );
}

#[test]
fn datagrams_arrive_with_their_timing() {
    let mut rig = rig();
    // Sent "from the board" to a host's port, the echo is a datagram of the board.
    let from = (HOST_IP, 777);
    let frame = rig.segment.udp((BOARD_IP, BOARD_PORT), 777, b"hello");
    rig.inject_frame(&frame);
    rig.run(1000);
    let (datagram, timing) = rig.take_datagrams().remove(0);
    // The toy does not swap addresses: it is for the board's own address.
    assert_eq!(
        (datagram.to, &datagram.payload[..]),
        ((BOARD_IP, from.1), &b"hello"[..])
    );
    assert_eq!(timing, None);
    assert!(rig.send_udp(5, b"nothing comes back to us").is_none());
}

#[test]
fn time_passes_exactly() {
    let mut rig = rig();
    let start = rig.clock();
    rig.run(12_345);
    rig.run_ms(2);
    assert_eq!(rig.clock() - start, 12_345 + 120_000);
    assert!(rig.kcycles_per_second() > 0.0);
}
