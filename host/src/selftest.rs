//! The self-test for the first power-up: tests a board and its wiring before they drive a machine.
//!
//! Two halves. The checks ([`board`], [`flash`], [`link`], [`ways`], [`clock`], [`loops`]) are
//! pure: facts go in, [`Finding`]s come out, each with the fact, a verdict, its reason and a
//! remedy. [`gather`] asks a board for the facts and changes nothing; [`drive`] arms it, and drives
//! only what was asked for.
//!
//! A report is meant to be sent to others, so it holds nothing that identifies a single board: no
//! unique id (a MAC address is made from it), no MAC address, no key, no IP address, no name.

pub mod board;
pub mod clock;
pub mod drive;
pub mod flash;
pub mod gather;
pub mod link;
pub mod loops;
pub mod run;
pub mod ways;

use crate::client::Identity;
pub use crate::finding::{Finding, Report, Verdict};
use std::time::{Duration, Instant};
use wire::board::Kind;

/// A report of this board, with nothing found yet.
pub fn report_of(identity: &Identity) -> Report {
    let (describe, blob) = (&identity.describe, identity.blob());
    let text = |kind| blob.text(kind, 0).unwrap_or("unnamed").to_owned();
    let version = |word: u32| format!("{}.{}.{}", word >> 16, word >> 8 & 0xff, word & 0xff);
    let c = describe.channels;
    Report {
        about: "board",
        head: vec![
            ("tool", env!("CARGO_PKG_VERSION").to_owned()),
            ("board", text(Kind::Board)),
            ("configuration", text(Kind::Configuration)),
            ("platform", text(Kind::Platform)),
            ("fpga", text(Kind::Fpga)),
            ("firmware", version(describe.firmware_version)),
            ("gateware", version(describe.gateware_version)),
            ("abi", format!("{:#010x}", describe.abi_gateware)),
            ("clock_hz", describe.clock_hz.to_string()),
            (
                "channels",
                format!(
                    "{} stepgens, {} encoders, {} PWMs, {} inputs, {} outputs",
                    c.stepgens, c.encoders, c.pwms, c.inputs, c.outputs
                ),
            ),
        ],
        findings: Vec::new(),
    }
}

/// The host's clock. A test has its own clock, so that its board and its clock agree on a busy
/// computer, too.
pub trait Time {
    /// Monotonic time since any moment.
    fn now(&mut self) -> Duration;
    /// Lets so much of it pass.
    fn pause(&mut self, time: Duration);
}

/// This computer's.
#[derive(Clone, Copy, Debug)]
pub struct Wall(Instant);

impl Default for Wall {
    fn default() -> Self {
        Wall(Instant::now())
    }
}

impl Time for Wall {
    fn now(&mut self) -> Duration {
        self.0.elapsed()
    }

    fn pause(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}
