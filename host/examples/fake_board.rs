//! The test suite's fake board behind a real UDP port, to try LinuxCNC and the tool without
//! hardware. `cargo run -p ferrocnc --example fake_board -- [ADDRESS:PORT] [lockstep PERIOD_US]
//! [index COUNTS]`
#![allow(missing_docs)]

#[path = "../tests/common/fake_board.rs"]
mod common;

use common::{CLOCK_HZ, FakeBoard, Time};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let address = arguments.first().map_or("127.0.0.1:1234", String::as_str);
    let number = |word: &str| {
        let at = arguments.iter().position(|argument| argument == word)?;
        Some(arguments.get(at + 1)?.parse::<u64>())
    };
    let time = match number("lockstep") {
        Some(Ok(microseconds)) => Time::Lockstep(u64::from(CLOCK_HZ) * microseconds / 1_000_000),
        Some(Err(error)) => panic!("the period in microseconds: {error}"),
        None => Time::Wall,
    };
    let board = FakeBoard::start(address, time);
    if let Some(Ok(counts)) = number("index") {
        board.look().knobs.index_every = i32::try_from(counts).ok();
    }
    println!("a fake mill6 board at {}", board.address);
    loop {
        std::thread::park();
    }
}
