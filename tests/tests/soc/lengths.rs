//! Frames that leave the board are whole, whatever their length.

use ferrocnc_tests::BenchMachine;
use sim::gmii::MIN_FRAME;

/// Headers of Ethernet, IP and ICMP.
const HEADERS: usize = 14 + 20 + 8;

/// LiteEth's MAC does not pad the frame behind one of 57 to 59 bytes, and a frame of less than 64
/// with its FCS is no frame: a console's echo of a few letters was lost, and TCP waited a second.
#[test]
fn a_short_frame_is_padded_with_zeros_whatever_the_one_before_it_was() {
    let mut machine = BenchMachine::start();
    for length in 0..24 {
        // Behind each length itself, the shortest one, and a long one with other bytes.
        for before in [length, 0, 200] {
            for payload in [vec![0xa5; before], vec![0x5a; length]] {
                let bytes = HEADERS + payload.len();
                let frame = machine.ping_with(&payload);
                let frame = frame.unwrap_or_else(|| panic!("{bytes} bytes behind {before}"));
                assert_eq!(frame.len(), bytes.max(MIN_FRAME));
                assert!(frame[bytes..].iter().all(|byte| *byte == 0), "{frame:02x?}");
            }
        }
    }
}
