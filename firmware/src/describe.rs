//! The board's description of itself: everything in `wire::describe`, collected from the parts.

use crate::cores::Ident;
use crate::postmortem::Boot;
use wire::GateClose;
pub use wire::describe::WORDS;
use wire::describe::{Describe, OBSTACLE_ABI};
use wire::exchange::StateWord;

/// The describe block of this board in this state.
pub fn describe(
    ident: &Ident,
    abi: u32,
    boot: Boot,
    state: StateWord,
    gate_close: GateClose,
) -> Describe {
    Describe {
        wire_version: wire::WIRE_VERSION,
        abi_firmware: abi,
        abi_gateware: ident.abi,
        firmware_version: crate::VERSION,
        gateware_version: ident.version,
        clock_hz: ident.clock_hz,
        channels: ident.channels,
        features: ident.features,
        boot_id: boot.id,
        blob_words: ident.blob_words,
        state,
        obstacles: obstacles(ident, abi),
        reset_reason: boot.reset,
        gate_close,
    }
}

/// The reasons this board will not arm at all.
pub const fn obstacles(ident: &Ident, abi: u32) -> u32 {
    if ident.abi == abi { 0 } else { OBSTACLE_ABI }
}
