//! Jobs: what the board does without a PC. A program of its own, in SDRAM; the ROM has no room for it.

pub mod abi;
