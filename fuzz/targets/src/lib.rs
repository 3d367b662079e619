//! The fuzz targets, one function each: libFuzzer calls them (`fuzz/fuzz_targets`), and plain
//! `cargo test` calls them with every committed input (`fuzz/corpus`, `fuzz/regressions`).
//!
//! A target panics when a property does not hold; that is a finding. The properties hold for every
//! input, however wrong.
//!
//! | module | targets |
//! |---|---|
//! | [`protocol`] | `etherbone`, `exchange`, `discovery`, `dhcp` |
//! | [`server`] | `server`, `console` |
//! | [`frames`] | `frames` |
//! | [`describe`] | `describe` |
//! | [`files`] | `board_toml`, `lcnc_ini`, `litexcnc_json`, `image` |
//! | [`job`] | `gcode`, `job`, `xypen` |
//! | [`mod@jobs`] | `jobs` |
//!
//! A new target is a function here, a line in [`TARGETS`], a file in `fuzz/fuzz_targets` with its
//! `[[bin]]`, and a few inputs in `fuzz/corpus`; the tests say which of these is missing.

pub mod byte_reader;
pub mod describe;
pub mod files;
pub mod frames;
pub mod job;
pub mod jobs;
pub mod protocol;
pub mod seeds;
pub mod server;
pub mod watched;

use std::sync::atomic::AtomicBool;

/// A target that runs scripts can record its steps, for the message of a failure. Recording takes
/// longer than the script.
pub static EXPLAIN: AtomicBool = AtomicBool::new(false);

/// A target: its name and its function.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: &[Target] = &[
    ("board_toml", files::board_toml),
    ("console", server::console),
    ("describe", describe::describe),
    ("dhcp", protocol::dhcp),
    ("discovery", protocol::discovery),
    ("etherbone", protocol::etherbone),
    ("exchange", protocol::exchange),
    ("frames", frames::frames),
    ("gcode", job::gcode),
    ("job", job::job),
    ("jobs", jobs::jobs),
    ("xypen", job::xypen),
    ("image", files::image),
    ("lcnc_ini", files::lcnc_ini),
    ("litexcnc_json", files::litexcnc_json),
    ("server", server::server),
];

/// The target of this name.
///
/// # Panics
/// If there is none: a binary without a function.
pub fn run(name: &str, data: &[u8]) {
    let target = TARGETS.iter().find(|(known, _)| *known == name);
    target.unwrap_or_else(|| panic!("no target {name}")).1(data);
}
