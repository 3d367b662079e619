//! Errors before a board runs. Once it runs, its misbehaviour is a result, not an error.

use std::path::PathBuf;

/// Why a simulated board could not be started or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that should be there could not be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// `manifest.json` is not what the gateware elaboration writes.
    #[error(
        "{path} is not a SoC manifest: {source}; elaborate the board again (`python -m ferrocnc elaborate` in gateware/)"
    )]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Where the parser stopped.
        source: serde_json::Error,
    },
    /// No board of this name is known.
    #[error("no board {name}: {why}")]
    Board {
        /// What was requested.
        name: String,
        /// What is wrong.
        why: String,
    },
    /// The plant file describes no plant.
    #[error("{path} is not a valid plant file: {why}")]
    Plant {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The Verilated library is missing or is no such library.
    #[error("cannot load {path}: {source}; build it with sim/verilator/build.sh")]
    Load {
        /// The shared library.
        path: PathBuf,
        /// What the loader said.
        source: libloading::Error,
    },
    /// The library was built from another shim than this crate knows.
    #[error(
        "{path} speaks shim ABI {theirs}, this simulator {ours}: run sim/verilator/build.sh again"
    )]
    ShimAbi {
        /// The shared library.
        path: PathBuf,
        /// Version in the library.
        theirs: u32,
        /// Version in this crate.
        ours: u32,
    },
    /// The firmware file is no ELF that fits this board.
    #[error("{path} cannot be the firmware: {why}")]
    Firmware {
        /// The ELF.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The waveform library has no writer.
    #[error("{path} was built without waveforms: run sim/verilator/build.sh --trace fst")]
    NoTrace {
        /// The shared library.
        path: PathBuf,
    },
    /// The board did not come up.
    #[error(
        "the board at {ip} answered nothing within {clocks} clocks after reset (frames seen from it: {frames}); are firmware and SoC built from the same tree?"
    )]
    Silent {
        /// The address that was asked.
        ip: std::net::Ipv4Addr,
        /// How long, in sys clocks.
        clocks: u64,
        /// Frames the board sent in that time.
        frames: u64,
    },
    /// A TCP connection to the board failed.
    #[error("the board refused or dropped the TCP connection to port {port}")]
    Tcp {
        /// The board's port.
        port: u16,
    },
}
