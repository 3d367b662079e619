//! Board files: which pin is what. The only reader of `boards/*.toml` and `boards/platforms/*.toml`.
//!
//! A file that cannot be built is refused with its place, the key, the value, what is wrong with it and what to do; nothing
//! is guessed and nothing that matters for safety has a default. The gateware loads what [`export`](export::export) writes;
//! the driver asks the board, which carries the [`blob`](blob::blob).

pub mod blob;
pub mod board;
pub mod error;
pub mod export;
pub mod hal;
pub mod platform;
pub mod source;
mod tree;

pub use board::{Board, Channel, Class};
pub use error::{Error, Place};
pub use platform::{Level, Platform};
pub use source::read_board;
