//! Owns a board and keeps it armed, as LinuxCNC does, until its input ends: a program of its own
//! because it runs in another network namespace than the test.
//!
//!   hold-armed 192.168.2.50:1234 MILLISECONDS

use std::io::Read as _;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use ferrocnc_tests::driver::Driver;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [board, period] = &words[..] else {
        panic!("a board and a period, not {words:?}");
    };
    let period = Duration::from_millis(period.parse().expect("milliseconds"));
    let mut driver = Driver::armed(board.parse().expect("an address and a port"));
    let (ended, end) = channel();
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        let _ = ended.send(());
    });
    println!("armed");
    while end.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
        let state = driver.exchange().state;
        assert!(state.enabled, "{state:?}");
    }
    println!("still armed");
}
