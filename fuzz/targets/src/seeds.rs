//! The committed inputs that are not taken from users' files: each is described and written here.
//!
//! `FERROCNC_WRITE_SEEDS=1 cargo test -p ferrocnc-fuzz-targets` writes them into `fuzz/corpus`;
//! without it the test compares.

mod console;
mod frames;
mod image;
mod jobs;
mod programs;
mod protocol;
mod server;

use crate::byte_reader::bytes;
use wire::Name;
use wire::describe::Channels;
use wire::discovery::{Body, Message, WORDS_MAX};
use wire::settings::Settings;

/// An input: its target, its name, its bytes.
pub type Seed = (&'static str, &'static str, Vec<u8>);

/// All of them.
pub fn all() -> Vec<Seed> {
    let mut seeds = Vec::new();
    for each in [
        protocol::etherbone_seeds(),
        protocol::exchange_seeds(),
        protocol::discovery_seeds(),
        protocol::dhcp_seeds(),
        protocol::describe_seeds(),
        image::image_seeds(),
        console::console_seeds(),
        server::server_seeds(),
        frames::frames_seeds(),
        programs::gcode_seeds(),
        programs::job_seeds(),
        jobs::jobs_seeds(),
        programs::xypen_seeds(),
    ] {
        seeds.extend(each);
    }
    seeds
}

const SIX: Channels = Channels {
    stepgens: 6,
    encoders: 6,
    pwms: 6,
    inputs: 12,
    outputs: 12,
};

fn message(body: Body) -> Vec<u8> {
    let mut buffer = [0; WORDS_MAX];
    let message = Message {
        nonce: 7,
        uid: [0xd162_0c8a, 0x1b2c_3d4e],
        body,
    };
    bytes(message.emit(&mut buffer))
}

fn settings() -> Settings {
    Settings {
        ip: 0x0a00_0002,
        name: Name::cut("mill"),
        ..Settings::default()
    }
}
