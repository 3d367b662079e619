//! Scripts of [`crate::server`]: sessions, motion and its ends, settings, requests.

use super::{Seed, message, settings};
use crate::byte_reader::bytes;
use wire::discovery::Body;
use wire::{etherbone, map};

type Step = Vec<u8>;

pub(super) fn server_seeds() -> Vec<Seed> {
    [motion(), ends(), sessions(), configuration(), requests()].concat()
}

fn script<const N: usize>(name: &'static str, steps: [Step; N]) -> Seed {
    ("server", name, steps.concat())
}

/// A step: its kind, its sender, and its bytes.
fn by(peer: u8, what: u8, needs: &[u8]) -> Step {
    [&[peer << 4 | what][..], needs].concat()
}

/// The same with bytes of any number.
fn counted(what: u8, raw: &[u8]) -> Step {
    let length = (raw.len() as u16).to_be_bytes();
    by(0, what, &[&length[..], raw].concat())
}

fn acquire(peer: u8) -> Step {
    by(peer, 1, &[7])
}

fn exchange(peer: u8, flags: u8, velocities: u8) -> Step {
    by(peer, 2, &[flags, 0, velocities])
}

/// A servo period goes by.
fn period() -> Step {
    by(0, 4, &[16])
}

/// Longer than the watchdog waits.
fn long() -> Step {
    by(0, 4, &[21])
}

fn pins(pins: u8) -> Step {
    by(0, 6, &[pins, 0xff, 0])
}

fn setting(class: u8, value: u32) -> Step {
    by(0, 5, &[&[class, 0, 0][..], &value.to_be_bytes()].concat())
}

fn discovery(body: Body) -> Step {
    counted(11, &message(body))
}

fn armed() -> Step {
    [
        acquire(0),
        exchange(0, 1, 0),
        exchange(0, 3, 0),
        exchange(0, 3, 0),
    ]
    .concat()
}

fn moving() -> Step {
    [armed(), exchange(0, 3, 40), period(), exchange(0, 3, 40)].concat()
}

fn motion() -> Vec<Seed> {
    vec![
        script(
            "armed_and_moving",
            [moving(), period(), exchange(0, 3, 0x80)],
        ),
        script(
            "timed_commit",
            [
                armed(),
                by(0, 2, &[11, 0, 9, 0x10, 0]),
                period(),
                exchange(0, 3, 0),
            ],
        ),
        script(
            "stale_and_foreign_commands",
            [
                acquire(0),
                by(0, 2, &[1, 0xff, 0]),
                by(0, 2, &[5, 0, 0, 0, 0, 0, 1]),
            ],
        ),
    ]
}

/// What ends a motion.
fn ends() -> Vec<Seed> {
    let back = [exchange(0, 1, 0), exchange(0, 3, 0)].concat();
    vec![
        script(
            "host_falls_silent",
            [moving(), long(), long(), exchange(0, 3, 0)],
        ),
        script(
            "host_disables",
            [moving(), exchange(0, 2, 0), long(), exchange(0, 3, 0)],
        ),
        script(
            "external_reset_and_back",
            [
                moving(),
                pins(1),
                exchange(0, 3, 0),
                pins(0),
                acquire(0),
                back.clone(),
                back,
                exchange(0, 3, 0),
            ],
        ),
        script(
            "link_goes_down",
            [
                moving(),
                pins(2),
                exchange(0, 3, 0),
                period(),
                exchange(0, 3, 0),
                period(),
                exchange(0, 3, 0),
                period(),
                exchange(0, 3, 0),
                long(),
                long(),
            ],
        ),
    ]
}

fn sessions() -> Vec<Seed> {
    vec![
        script(
            "stranger_tries",
            [
                moving(),
                acquire(2),
                exchange(2, 3, 9),
                by(2, 8, &[1, 1, 2, 3, 4]),
                acquire(1),
            ],
        ),
        script(
            "acquired_again_in_motion",
            [moving(), acquire(0), exchange(0, 3, 0), long()],
        ),
        script(
            "given_back_in_motion",
            [moving(), by(0, 8, &[0]), long(), acquire(2)],
        ),
    ]
}

/// Settings of the cores, and those in the flash.
fn configuration() -> Vec<Seed> {
    vec![
        script(
            "configured_then_armed",
            [
                acquire(0),
                setting(0, 60),
                setting(1, 0),
                setting(2, 3000),
                setting(3, 300_000),
                setting(4, 5),
                armed(),
            ],
        ),
        script(
            "configured_while_armed",
            [armed(), setting(0, 60), setting(3, 600_000)],
        ),
        script(
            "acquire_and_configure_at_once",
            [by(0, 15, &[2, 0, 1, 0, 0, 0, 7, 2, 1, 0, 0, 0, 60])],
        ),
        script(
            "flash_saves_settings",
            [
                by(0, 9, &[7, 0, 0, 0, 0, 0, 0]),
                by(0, 4, &[20]),
                acquire(0),
                exchange(0, 3, 0),
            ],
        ),
        script(
            "given_settings",
            [
                discovery(Body::Discover),
                discovery(Body::Set(settings())),
                long(),
            ],
        ),
        script(
            "given_settings_while_owned",
            [acquire(0), discovery(Body::Set(settings()))],
        ),
    ]
}

fn requests() -> Vec<Seed> {
    let restart = [
        etherbone::HEADER,
        0,
        0x000f_0100,
        map::SESSION_REBOOT,
        map::REBOOT_KEY,
    ];
    vec![
        script(
            "reads",
            [
                by(1, 7, &[12, 0, 0, 0, 0, 0, 1, 0, 4, 0, 4, 0, 0, 9]),
                by(0, 13, b"\x0estatus\nregs 8\n"),
            ],
        ),
        script(
            "raw_register",
            [acquire(0), by(0, 10, &[16, 0, 0, 0, 0, 60])],
        ),
        script("restart_asked_for", [counted(0, &bytes(&restart))]),
    ]
}
