//! A board without a board: the test suite's fake behind a real UDP port, for trying LinuxCNC and the
//! tool. `cargo run -p ferrocnc --example fake_board -- [ADDRESS:PORT] [lockstep PERIOD_US]`
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{CLOCK_HZ, FakeBoard, Time};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let address = arguments.first().map_or("127.0.0.1:1234", String::as_str);
    let time = match arguments.get(2).map(|text| text.parse::<u64>()) {
        Some(Ok(microseconds)) => Time::Lockstep(u64::from(CLOCK_HZ) * microseconds / 1_000_000),
        Some(Err(error)) => panic!("the period in microseconds: {error}"),
        None => Time::Wall,
    };
    let board = FakeBoard::start(address, time);
    println!("a fake mill6 board at {}", board.address);
    loop {
        std::thread::park();
    }
}
