//! Board files: which pin is what. The only reader of `boards/*.toml` and
//! `boards/platforms/*.toml`.
//!
//! A file that cannot be built is refused. The error names the place, the key, the value, the
//! problem and the remedy. Nothing is guessed, and nothing that matters for safety has a default.
//! The gateware loads what [`export`](export::export) writes; the driver asks the board, which
//! carries the [`blob`](blob::blob).

pub mod blob;
pub mod board;
pub mod error;
pub mod export;
pub mod first_light;
pub mod hal;
pub mod image;
pub mod import;
pub mod new;
pub mod peers;
pub mod pinout;
pub mod pins;
pub mod platform;
pub mod schema;
pub mod show;
pub mod source;
pub mod tree;
pub mod write;

pub use board::{Board, Channel, Class};
pub use error::{Error, Place, Report};
pub use platform::{Level, Platform};
pub use source::{read_board, read_board_text};
