//! A fake board, a driver, a fake HAL, in lockstep.
#![allow(dead_code)]

use super::{CLOCK_HZ, FakeBoard, Time};
use ferrocnc::address;
use ferrocnc::client::{Client, Identity};
use ferrocnc::driver::Driver;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::link::Link;
use ferrocnc::names::{self, Scheme};
use std::time::Duration;
use wire::map;

pub const PERIOD_NS: i64 = 1_000_000;
pub const LOCKSTEP: Time = Time::Lockstep(CLOCK_HZ as u64 / 1000);

/// A board, a driver, a HAL, in lockstep.
pub struct Rig {
    pub board: FakeBoard,
    pub driver: Driver,
    pub hal: FakeHal,
}

impl Rig {
    pub fn new() -> Self {
        Rig::of(FakeBoard::mill6(LOCKSTEP))
    }

    /// With a board that has a step generator called x.
    pub fn of(board: FakeBoard) -> Self {
        let mut hal = FakeHal::new();
        let driver = load(&board, &mut hal);
        // A test that loses an answer waits for this time: short, but long enough for a slow
        // computer.
        hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
        hal.set("ferrocnc.0.stepgen.x.position-scale", 800.0);
        hal.set("ferrocnc.0.stepgen.x.maxaccel", 1000.0);
        hal.set("ferrocnc.0.stepgen.x.steplen", 1000u32);
        hal.set("ferrocnc.0.stepgen.x.stepspace", 1000u32);
        let mut rig = Rig { board, driver, hal };
        rig.connect();
        rig
    }

    /// With another driver's names for its pins.
    pub fn named(scheme: &Scheme) -> Self {
        let board = FakeBoard::mill6(LOCKSTEP);
        let mut hal = FakeHal::new();
        let (mut driver, identity) = load_with(&board, &mut hal, 0);
        let glue = names::export(scheme, &mut hal, 0, &identity, &driver).unwrap();
        driver.adopt(glue);
        hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
        let mut rig = Rig { board, driver, hal };
        rig.connect();
        rig
    }

    pub fn armed() -> Self {
        let mut rig = Rig::new();
        rig.arm();
        assert!(rig.enabled(), "{:?}", rig.hal.said());
        rig
    }

    /// Until the first exchange has been answered and the settings have arrived.
    pub fn connect(&mut self) {
        for _ in 0..500 {
            self.run(1);
            std::thread::sleep(Duration::from_millis(1));
            let board = self.board.look();
            if board.exchanges > 3 && board.config.contains_key(&map::CONFIG_BOARD) {
                drop(board);
                return self.run(5);
            }
        }
        panic!("no session: {:?}", self.hal.said());
    }

    pub fn arm(&mut self) {
        self.hal.set("ferrocnc.0.enable", true);
        self.hal.set("ferrocnc.0.enable-request", false);
        self.run(2);
        self.hal.set("ferrocnc.0.enable-request", true);
        self.run(6);
        self.hal.set("ferrocnc.0.enable-request", false);
        self.run(3);
    }

    pub fn run(&mut self, periods: usize) {
        for _ in 0..periods {
            self.driver.read(PERIOD_NS);
            let (seen, unplugged) = {
                let board = self.board.look();
                (board.datagrams, board.knobs.unplugged)
            };
            self.driver.write(PERIOD_NS);
            // A knob set before the board has seen this command would affect the wrong command.
            for _ in 0..if unplugged { 0 } else { 100 } {
                if self.board.look().datagrams != seen {
                    break;
                }
                std::thread::sleep(Duration::from_micros(20));
            }
        }
    }

    /// Runs a ramped move of `distance` with x enabled.
    pub fn travel(&mut self, distance: f64, periods: usize) {
        let start: f64 = self.hal.get("ferrocnc.0.stepgen.x.position-fb");
        self.hal.set("ferrocnc.0.stepgen.x.position-cmd", start);
        self.run(1);
        self.hal.set("ferrocnc.0.stepgen.x.enable", true);
        self.run(2);
        for n in 1..=periods {
            // Half a cosine: at rest at both ends.
            let phase = n as f64 / periods as f64 * core::f64::consts::PI;
            let at = start + distance * 0.5 * (1.0 - phase.cos());
            self.hal.set("ferrocnc.0.stepgen.x.position-cmd", at);
            self.run(1);
        }
    }

    pub fn enabled(&self) -> bool {
        self.hal.get("ferrocnc.0.enabled")
    }

    pub fn position(&self) -> f64 {
        self.hal.get("ferrocnc.0.stepgen.x.position-fb")
    }

    pub fn reason(&self) -> u32 {
        self.hal.get("ferrocnc.0.fault-reason")
    }
}

pub fn load(board: &FakeBoard, hal: &mut FakeHal) -> Driver {
    load_with(board, hal, 0).0
}

/// As `loadrt` does it, as board `index`.
pub fn load_with(board: &FakeBoard, hal: &mut FakeHal, index: usize) -> (Driver, Identity) {
    let address = address::parse(&board.text(), 1234).unwrap();
    let mut client = Client::open(&address).unwrap();
    let identity = client.identify().unwrap();
    client.check(&identity).unwrap();
    client.acquire().unwrap();
    let link = Link::new(client.into_socket()).unwrap();
    let say = hal.messenger();
    let driver = Driver::export(hal, index, address, &identity, link, say).unwrap();
    (driver, identity)
}
