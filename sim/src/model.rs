//! The cores in Rust, bit for bit: one file per core of `gateware/rtl`, named after it.
//!
//! Each has `clock`, one rising edge with the inputs as they stand before it, written to be read
//! beside its `.sv`. Two more functions make the twin fast: `quiet` returns how many of the next
//! clocks change no pin and no visible register, `skip` makes that many at once. [`board::Board`]
//! connects the cores to the register map, as `gateware/ferrocnc/banks.py` does.
//!
//! Two tests check them: `tests/tests/lockstep` compares every pin and register with the
//! Verilated gateware for millions of clocks, and the tests here compare `skip` with as many calls
//! of `clock`.

pub mod board;
pub mod debounce;
pub mod encoder;
pub mod extreset;
pub mod fast_path;
pub mod gpio;
pub mod latch;
pub mod led;
pub mod pwm;
pub mod rx_admission;
pub mod segments;
pub mod stepgen;
pub mod timebase;
pub mod watchdog;
pub mod wide_counter;

pub use board::Board;

/// The lowest `count` bits.
fn lowest(count: u8) -> u64 {
    1u64.checked_shl(count.into()).unwrap_or(0).wrapping_sub(1)
}
