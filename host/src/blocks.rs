//! One function block per file, each with the same verbs: `export` its pins, `configure` the board,
//! take what was sampled, make the next command. A block knows the units and rules of its kind; it
//! knows no socket.

pub mod arming;
pub mod encoder;
pub mod ethernet;
pub mod exchange;
pub mod gpio;
pub mod latch;
pub mod packets;
pub mod pwm;
pub mod stepgen;
pub mod wallclock;
pub mod watchdog;
pub mod ways;

use wire::units::Clocks;

/// The servo period in the units blocks think in.
#[derive(Clone, Copy, Debug)]
pub struct Period {
    /// Its nominal length.
    pub seconds: f64,
    /// The same in clocks of the board.
    pub clocks: Clocks,
    /// The board's clock.
    pub clock_hz: f64,
}

impl Period {
    /// From what HAL passes to a function. Never 0, for any value from HAL.
    pub fn new(nanos: i64, clock_hz: u32) -> Self {
        let nanos = nanos.clamp(1_000, 10_000_000_000);
        Period {
            seconds: nanos as f64 * 1e-9,
            clocks: Clocks((nanos as u128 * u128::from(clock_hz) / 1_000_000_000) as u64),
            clock_hz: f64::from(clock_hz),
        }
    }
}

/// What the board does between a sample and the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PredictionBasis {
    /// It goes on with the command before for `lead`, then executes the one the sample answered for
    /// `ahead`.
    Commanded {
        /// From the sample to the apply time, 0 if it was applied at once.
        lead: Clocks,
        /// From there to the next command.
        ahead: Clocks,
    },
    /// It comes to rest by itself.
    Stopping {
        /// From the sample to the next command.
        ahead: Clocks,
    },
    /// Its gate is closed: nothing moves.
    Still,
}

/// How well the present is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feedback {
    /// The last command was answered.
    Fresh,
    /// One answer is missing; the model bridges it.
    Bridged,
    /// More than one is missing; feedback is frozen.
    Frozen,
}

/// A time parameter as a register, between the least and the most it can hold.
pub(crate) fn nanos_to_register(nanos: u32, clock_hz: f64, least: u32, most: u32) -> u32 {
    let clocks = Clocks::from_nanos_ceil(u64::from(nanos), clock_hz as u32).0;
    clocks.clamp(u64::from(least), u64::from(most)) as u32
}
