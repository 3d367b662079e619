//! The committed inputs that are not taken from users' files: each is described and written here.
//!
//! `FERROCNC_WRITE_SEEDS=1 cargo test -p ferrocnc-fuzz-targets` writes them into `fuzz/corpus`;
//! without it the test compares.

use crate::tape::bytes;
use firmware::net::{Datagram, Slot, Us, emit_headers, emit_payload};
use motion::instruction::{AUX_TOOL, Arc, Feed, Instruction};
use motion::job::{self, FRAME};
use motion::xypen::{self, Record};
use sim::card::Card;
use wire::describe::{Channels, Describe};
use wire::discovery::{Body, Here, Message, WORDS_MAX};
use wire::exchange::{Command, REQUEST_OVERHEAD, StateWord};
use wire::flash::{OpResult, Origin, Running};
use wire::settings::Settings;
use wire::{FaultReason, GateClose, LinkSpeed, Name, ResetReason, State, etherbone, map};

/// An input: its target, its name, its bytes.
pub type Seed = (&'static str, &'static str, Vec<u8>);

/// All of them.
pub fn all() -> Vec<Seed> {
    let mut seeds = Vec::new();
    for each in [
        etherbone_seeds(),
        exchange_seeds(),
        discovery_seeds(),
        dhcp_seeds(),
        describe_seeds(),
        image_seeds(),
        console_seeds(),
        server_seeds(),
        frames_seeds(),
        gcode_seeds(),
        job_seeds(),
        jobs_seeds(),
        xypen_seeds(),
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

fn state() -> StateWord {
    StateWord {
        state: State::Armed,
        reason: FaultReason::None,
        position_trusted: true,
        enabled: true,
        session_yours: true,
        bitten: false,
        external_reset: false,
        accepted: true,
        link: true,
        estop: false,
        speed: LinkSpeed::M1000,
        link_errors: 0,
    }
}

fn command() -> Vec<u32> {
    let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
    let command = Command {
        token: 0x1234_5678,
        sequence: 7,
        enable: true,
        enable_request: true,
        stepgen_enable: 0x3f,
        ..Command::default()
    };
    command
        .emit_request(SIX, &mut buffer)
        .unwrap_or(&[])
        .to_vec()
}

fn status() -> Vec<u32> {
    let mut words = vec![0; wire::exchange::status_words(SIX)];
    words[0] = state().to_word();
    words[1] = 7;
    words
}

/// LiteX's golden vectors, then ours.
fn etherbone_seeds() -> Vec<Seed> {
    let [h, probe] = [etherbone::HEADER, etherbone::HEADER_PROBE];
    let all: [(&str, Vec<u32>); 9] = [
        ("probe", vec![probe, 0, 0]),
        (
            "read_two",
            vec![h, 0, 0x000f_0002, 0xdead_beef, 0x100, 0x104],
        ),
        (
            "write_two",
            vec![h, 0, 0x000f_0200, 0x20, 0x1122_3344, 0x5566_7788],
        ),
        (
            "write_and_read_then_read",
            vec![
                h,
                0,
                0x000f_0101,
                0x20,
                7,
                0xaa,
                0x100,
                0x000f_0001,
                0xbb,
                0x104,
            ],
        ),
        ("no_reads", vec![h | 0x400, 0, 0x000f_0001, 0, 0x100]),
        ("acquire", vec![h, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7]),
        ("exchange", command()),
        ("write_cut_short", vec![h, 0, 0x000f_0200, 0x20, 1]),
        ("padded", vec![h, 0, 0x000f_0100, 0x20, 1, 0]),
    ];
    let mut seeds: Vec<Seed> = all
        .into_iter()
        .map(|(name, words)| ("etherbone", name, bytes(&words)))
        .collect();
    seeds.push(("etherbone", "ragged", bytes(&[h, 0])[..7].to_vec()));
    seeds
}

fn exchange_seeds() -> Vec<Seed> {
    let input = |mode: u8, words: &[u32]| {
        let mut input = vec![6, 6, 6, 12, 12, mode];
        input.extend(bytes(&[6, 7]));
        input.extend(bytes(words));
        input
    };
    let mut reply = vec![
        etherbone::HEADER,
        0,
        0x000f_0000 | (status().len() as u32) << 8,
        7,
    ];
    reply.extend(status());
    vec![
        (
            "exchange",
            "command_of_six_axes",
            input(1, &command()[REQUEST_OVERHEAD..]),
        ),
        ("exchange", "status_of_six_axes", input(2, &status())),
        ("exchange", "answer_to_six_axes", input(0, &reply)),
    ]
}

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

fn discovery_seeds() -> Vec<Seed> {
    let here = Here {
        mac: [0x12, 0xe2, 0xd5, 0, 0, 1],
        ip: 0xc0a8_0232,
        port: 1234,
        dhcp: false,
        armed: false,
        owned: true,
        keyed: false,
        running: Running::A,
        origin: Origin::BuiltIn,
        speed: LinkSpeed::M1000,
        wire_version: wire::WIRE_VERSION,
        firmware_version: 0x100,
        build_id: 9,
        name: Name::cut("mill"),
        configuration: Name::cut("mill6"),
        platform: Name::cut("5a-75b-8.0"),
    };
    let input = |mode: u8, body| [vec![mode], message(body)].concat();
    vec![
        ("discovery", "who", input(0, Body::Discover)),
        ("discovery", "here", input(0, Body::Here(here))),
        ("discovery", "set", input(1, Body::Set(settings()))),
        ("discovery", "done", input(0, Body::Done(OpResult::Ok))),
    ]
}

fn dhcp_seeds() -> Vec<Seed> {
    // Netmask, router, lease time, server.
    let options = [
        1, 4, 255, 255, 255, 0, 3, 4, 10, 0, 0, 1, 51, 4, 0, 0, 14, 16, 54, 4, 10, 0, 0, 1, 255,
    ];
    let answer = |kind: u8| {
        let mut step = vec![kind << 2 | 2, 10, 0, 0, 99, options.len() as u8];
        step.extend(options);
        step
    };
    let later = |second: u32| [vec![0], second.to_be_bytes().to_vec()].concat();
    let seed = vec![0, 0, 0, 9];
    let lease = [seed.clone(), answer(2), answer(5)].concat();
    vec![
        ("dhcp", "offer_and_ack", lease.clone()),
        (
            "dhcp",
            "lease_renewed",
            [lease.clone(), later(2000), answer(5)].concat(),
        ),
        (
            "dhcp",
            "lease_over",
            [lease.clone(), later(4000), later(4001), answer(2)].concat(),
        ),
        ("dhcp", "nak", [lease, later(2000), answer(6)].concat()),
        (
            "dhcp",
            "nobody",
            [seed, later(4), later(12), later(40)].concat(),
        ),
    ]
}

fn describe_seeds() -> Vec<Seed> {
    let describe = Describe {
        wire_version: wire::WIRE_VERSION,
        abi_firmware: 1,
        abi_gateware: 1,
        firmware_version: 0x100,
        gateware_version: 0x100,
        clock_hz: 60_000_000,
        channels: SIX,
        features: 0,
        boot_id: 9,
        blob_words: 100,
        state: state(),
        obstacles: 0,
        reset_reason: ResetReason::PowerUp,
        gate_close: GateClose::Never,
    };
    let words = bytes(&describe.to_words());
    let board = |name| Card::named(name).map_or(Vec::new(), |card| card.blob);
    let input = |mode: u8, blob: &[u8]| [vec![mode], words.clone(), blob.to_vec()].concat();
    // Two lists: names that HAL can bear and names that it cannot.
    let odd = b"s\nx\nx s\nX\nspindle-on step=j1:0\n";
    let mut lists = vec![0; 16];
    lists.extend([9, 0, odd.len() as u8, 0]);
    lists.extend(odd);
    lists.resize(lists.len().next_multiple_of(4), 0);
    vec![
        ("describe", "mill6", input(3, &board("mill6"))),
        ("describe", "mill6_as_it_is", input(0, &board("mill6"))),
        (
            "describe",
            "mill6_with_names_of_lcnc",
            input(7, &board("mill6")),
        ),
        (
            "describe",
            "max_with_names_of_litexcnc",
            input(11, &board("max")),
        ),
        ("describe", "odd_names", input(3, &lists)),
    ]
}

fn image_seeds() -> Vec<Seed> {
    use host::image::sample;
    let file = sample::file("mill6", "5a-75b-8.0", 0x89ab_cdef, 40);
    let meta = host::image::Image::parse(&file).map(|image| image.meta().to_page());
    let stub = wire::images::Stub { target: 0x2_0000 }.to_page();
    vec![
        ("image", "bitstream", [vec![0], file].concat()),
        (
            "image",
            "bitstream_of_few_bytes",
            [vec![1], bytes(&[9, 0x4111_1043, 1])].concat(),
        ),
        ("image", "flash_as_built", vec![2]),
        ("image", "flash_of_another_stub", vec![2, 0, 36, 2, 9, 9]),
        (
            "image",
            "meta_page",
            [
                vec![3],
                meta.map_or(Vec::new(), |page| page[..100].to_vec()),
            ]
            .concat(),
        ),
        (
            "image",
            "stub_page",
            [vec![3], stub[..40].to_vec()].concat(),
        ),
    ]
}

fn console_seeds() -> Vec<Seed> {
    let all = "help\nstatus\nnet\nregs\nregs 8\nstepgen\nstepgen 5\nencoder\nencoder 16\npwm\npwm 0\ngpio\nwatchdog\nlog\nlink\nflash\nsettings\nquit\n";
    let telnet = [255, 253, 3, 255, 251, 24, 255, 244];
    vec![
        ("console", "every_command", all.into()),
        (
            "console",
            "telnet_negotiates",
            [&telnet[..], b"status\r\n"].concat(),
        ),
        (
            "console",
            "corrected",
            b"statsu\x08\x08us\r\n\x7f\x7f\n? \nstepgen 256\n".to_vec(),
        ),
        (
            "console",
            "too_long",
            [vec![b'x'; 80], b"\nnet\n".to_vec()].concat(),
        ),
    ]
}

/// A step of `server`: its kind, its sender, and its bytes.
fn by(peer: u8, what: u8, needs: &[u8]) -> Vec<u8> {
    [&[peer << 4 | what][..], needs].concat()
}

fn server_seeds() -> Vec<Seed> {
    let acquire = |peer| by(peer, 1, &[7]);
    let exchange = |peer, flags: u8, rates: u8| by(peer, 2, &[flags, 0, rates]);
    let period = by(0, 4, &[16]);
    let long = by(0, 4, &[21]);
    let armed = [
        acquire(0),
        exchange(0, 1, 0),
        exchange(0, 3, 0),
        exchange(0, 3, 0),
    ]
    .concat();
    let moving = [
        armed.clone(),
        exchange(0, 3, 40),
        period.clone(),
        exchange(0, 3, 40),
    ]
    .concat();
    let raw = |words: &[u32]| {
        let raw = bytes(words);
        by(
            0,
            0,
            &[&(raw.len() as u16).to_be_bytes()[..], &raw].concat(),
        )
    };
    let discovery = |body| {
        let raw = message(body);
        by(
            0,
            11,
            &[&(raw.len() as u16).to_be_bytes()[..], &raw].concat(),
        )
    };
    let setting =
        |class: u8, value: u32| by(0, 5, &[&[class, 0, 0][..], &value.to_be_bytes()].concat());
    let pins = |pins: u8| by(0, 6, &[pins, 0xff, 0]);
    vec![
        (
            "server",
            "armed_and_moving",
            [moving.clone(), period.clone(), exchange(0, 3, 0x80)].concat(),
        ),
        (
            "server",
            "host_falls_silent",
            [
                moving.clone(),
                long.clone(),
                long.clone(),
                exchange(0, 3, 0),
            ]
            .concat(),
        ),
        (
            "server",
            "host_disables",
            [
                moving.clone(),
                exchange(0, 2, 0),
                long.clone(),
                exchange(0, 3, 0),
            ]
            .concat(),
        ),
        (
            "server",
            "external_reset_and_back",
            [
                moving.clone(),
                pins(1),
                exchange(0, 3, 0),
                pins(0),
                acquire(0),
                exchange(0, 1, 0),
                exchange(0, 3, 0),
                exchange(0, 1, 0),
                exchange(0, 3, 0),
                exchange(0, 3, 0),
            ]
            .concat(),
        ),
        (
            "server",
            "link_goes_down",
            [
                moving.clone(),
                pins(2),
                exchange(0, 3, 0),
                period.clone(),
                exchange(0, 3, 0),
                period.clone(),
                exchange(0, 3, 0),
                period.clone(),
                exchange(0, 3, 0),
                long.clone(),
                long.clone(),
            ]
            .concat(),
        ),
        (
            "server",
            "stranger_tries",
            [
                moving.clone(),
                acquire(2),
                exchange(2, 3, 9),
                by(2, 8, &[1, 1, 2, 3, 4]),
                acquire(1),
            ]
            .concat(),
        ),
        (
            "server",
            "acquired_again_in_motion",
            [moving.clone(), acquire(0), exchange(0, 3, 0), long.clone()].concat(),
        ),
        (
            "server",
            "given_back_in_motion",
            [moving, by(0, 8, &[0]), long.clone(), acquire(2)].concat(),
        ),
        (
            "server",
            "stale_and_foreign_commands",
            [
                acquire(0),
                by(0, 2, &[1, 0xff, 0]),
                by(0, 2, &[5, 0, 0, 0, 0, 0, 1]),
            ]
            .concat(),
        ),
        (
            "server",
            "timed_commit",
            [
                armed.clone(),
                by(0, 2, &[11, 0, 9, 0x10, 0]),
                period.clone(),
                exchange(0, 3, 0),
            ]
            .concat(),
        ),
        (
            "server",
            "configured_then_armed",
            [
                acquire(0),
                setting(0, 60),
                setting(1, 0),
                setting(2, 3000),
                setting(3, 300_000),
                setting(4, 5),
                armed.clone(),
            ]
            .concat(),
        ),
        (
            "server",
            "configured_while_armed",
            [armed.clone(), setting(0, 60), setting(3, 600_000)].concat(),
        ),
        (
            "server",
            "flash_saves_settings",
            [
                by(0, 9, &[7, 0, 0, 0, 0, 0, 0]),
                by(0, 4, &[20]),
                acquire(0),
                exchange(0, 3, 0),
            ]
            .concat(),
        ),
        (
            "server",
            "told_who_to_be",
            [
                discovery(Body::Discover),
                discovery(Body::Set(settings())),
                long.clone(),
            ]
            .concat(),
        ),
        (
            "server",
            "told_who_to_be_while_owned",
            [acquire(0), discovery(Body::Set(settings()))].concat(),
        ),
        (
            "server",
            "reads",
            [
                by(1, 7, &[12, 0, 0, 0, 0, 0, 1, 0, 4, 0, 4, 0, 0, 9]),
                by(0, 13, b"\x0estatus\nregs 8\n"),
            ]
            .concat(),
        ),
        (
            "server",
            "acquire_and_configure_at_once",
            [by(0, 15, &[2, 0, 1, 0, 0, 0, 7, 2, 1, 0, 0, 0, 60])].concat(),
        ),
        (
            "server",
            "restart_asked_for",
            raw(&[
                etherbone::HEADER,
                0,
                0x000f_0100,
                map::SESSION_REBOOT,
                map::REBOOT_KEY,
            ]),
        ),
        (
            "server",
            "raw_register",
            [acquire(0), by(0, 10, &[16, 0, 0, 0, 0, 60])].concat(),
        ),
    ]
}

#[derive(Default)]
struct Bytes(Vec<u32>);

impl Slot for Bytes {
    fn put(&mut self, index: usize, word: u32) {
        self.0.resize(self.0.len().max(index + 1), 0);
        self.0[index] = word;
    }
}

/// A raw frame of `frames`: from another board, addressed to ours.
fn frame(payload: &[u32]) -> Vec<u8> {
    let us = Us {
        mac: [2, 3, 4, 5, 6, 7],
        ip: 0xc0a8_0201,
        port: 40_000,
    };
    let to = Datagram {
        peer: firmware::session::Peer {
            ip: 0xc0a8_0232,
            port: 1234,
        },
        mac: (0x10e2, 0xd500_0001),
        length: 0,
        options: 0,
    };
    let mut slot = Bytes::default();
    emit_headers(&mut slot, &us, &to, 4 * payload.len());
    let length = emit_payload(&mut slot, payload);
    let frame: Vec<u8> = bytes(&slot.0)[2..][..length].to_vec();
    [&[0][..], &(length as u16).to_be_bytes(), &frame].concat()
}

fn frames_seeds() -> Vec<Seed> {
    let h = etherbone::HEADER;
    let udp = |step: u8, odd: u8, words: &[u32]| {
        let raw = bytes(words);
        [&[step, odd][..], &(raw.len() as u16).to_be_bytes(), &raw].concat()
    };
    let acquire = udp(1, 0x80, &[h, 0, 0x000f_0100, map::SESSION_ACQUIRE, 7]);
    let lane = |flags: u8| vec![2, 0, flags];
    let later = |step: u8| vec![7 | step << 3];
    let tcp =
        |flags: u8, text: &[u8]| [&[3, 0, flags, 0, 255, text.len() as u8][..], text].concat();
    let opened = [tcp(2, b""), tcp(16, b"")].concat();
    let read = [h, 0, 0x000f_0001, 7, 0];
    let mut discover = vec![1 | 1 << 3, 8];
    let who = message(Body::Discover);
    discover.extend((who.len() as u16).to_be_bytes());
    discover.extend(who);
    vec![
        ("frames", "raw_read", frame(&read)),
        (
            "frames",
            "read_with_options",
            [udp(1, 1, &read), vec![3]].concat(),
        ),
        (
            "frames",
            "fragment",
            [udp(1, 2, &read), vec![0x20, 0]].concat(),
        ),
        (
            "frames",
            "total_length_off",
            [udp(1, 4, &read), vec![1]].concat(),
        ),
        (
            "frames",
            "cut_short",
            [udp(1, 0x40, &read), vec![0, 43]].concat(),
        ),
        (
            "frames",
            "one_byte_wrong",
            [udp(1, 0xa0, &read), vec![0, 50, 1]].concat(),
        ),
        ("frames", "discovery_to_all", discover),
        (
            "frames",
            "down_the_fast_lane",
            [
                acquire.clone(),
                lane(1),
                lane(3),
                lane(3),
                later(4),
                lane(0x43),
            ]
            .concat(),
        ),
        (
            "frames",
            "the_lane_and_damage",
            [acquire, lane(1), vec![2, 0xa0, 1, 0, 90, 1]].concat(),
        ),
        (
            "frames",
            "console_says_hello",
            [
                opened.clone(),
                tcp(24, b"status\n"),
                tcp(16, b""),
                later(6),
                tcp(17, b""),
            ]
            .concat(),
        ),
        (
            "frames",
            "console_says_quit",
            [opened.clone(), tcp(24, b"quit\n"), tcp(17, b""), later(9)].concat(),
        ),
        (
            "frames",
            "console_dies",
            [
                opened.clone(),
                tcp(24, b"net\n"),
                later(9),
                later(10),
                later(11),
                later(12),
            ]
            .concat(),
        ),
        ("frames", "console_is_reset", [opened, tcp(4, b"")].concat()),
        ("frames", "knock_at_a_closed_door", tcp(16, b"x")),
        (
            "frames",
            "ping",
            vec![5 | 1 << 6, 0, 0, 8, 0, 7, 0, 1, 1, 2, 3, 4],
        ),
        ("frames", "who_has", vec![6, 0]),
        ("frames", "runt", vec![0, 0, 3, 1, 2, 3]),
    ]
}

fn gcode_seeds() -> Vec<Seed> {
    let program = |mode: u8, text: &str| [&[mode, 50][..], text.as_bytes()].concat();
    vec![
        (
            "gcode",
            "square_with_a_pen",
            program(
                0,
                "%\nG21 G90\nG0 X10 Y10\nM3\nG4 P0.1\nG1 X20 F600\nY20\nX10\nY10\nM5\nG0 X0 Y0\nM2\n",
            ),
        ),
        (
            "gcode",
            "arcs_and_a_full_circle",
            program(
                0,
                "G1 F1200 X5\nG2 X10 Y5 I5 J0\nG3 X5 Y0 R5\nG2 I2 J0\nG3 X0 Y1 Z1 R-4\nM30\n",
            ),
        ),
        (
            "gcode",
            "inches_and_relative",
            program(
                2,
                "N10 G20 G91 (inches)\nN20 G1 X.5 Y-.25 F30 ; a comment\nN30 G92 X0\nN40 G0 Z1*94\nG90 G0 X0\n",
            ),
        ),
        (
            "gcode",
            "homed_paused_slowed",
            program(
                5,
                "G28 X0 Y0\nM0\nG1 X3 Y3 F300\nG4 P250\nG4 S1\nM2\nG1 X9\n",
            ),
        ),
        (
            "gcode",
            "many_short_lines",
            program(
                0,
                &(0..40)
                    .map(|n| format!("G1 X{}.{n:02} Y{} F3000\n", n % 7, n % 3))
                    .collect::<String>(),
            ),
        ),
        ("gcode", "refused", program(0, "G1 X1 F100\nG64 P0.01\n")),
        (
            "gcode",
            "too_far",
            program(0, "G0 X9999.999999\nG0 X10001\n"),
        ),
    ]
}

/// Whole job files, and the content of their blocks.
fn job_seeds() -> Vec<Seed> {
    let to = |x: i64, y: i64| [1_000_000 * x, 1_000_000 * y, 0];
    let line = |x, y| Instruction::Line {
        to: to(x, y),
        feed: Feed::Rate(20_000_000),
    };
    let arc = |x, y, center: [i64; 2], clockwise| {
        Instruction::Arc(Arc {
            to: to(x, y),
            center: center.map(|mm| 1_000_000 * mm),
            clockwise,
            feed: Feed::Rate(10_000_000),
        })
    };
    let rapid = |x, y| Instruction::Line {
        to: to(x, y),
        feed: Feed::Rapid,
    };
    let pen = |bits| Instruction::Aux { bits };
    let programs: [(&str, &[Instruction]); 3] = [
        (
            "a_square",
            &[
                rapid(10, 10),
                pen(AUX_TOOL),
                line(20, 10),
                line(20, 20),
                line(10, 20),
                line(10, 10),
                pen(0),
                Instruction::End,
            ],
        ),
        (
            "arcs_and_a_full_circle",
            &[
                line(10, 0),
                arc(0, 10, [0, 0], false),
                arc(0, 10, [5, 10], true),
                Instruction::End,
            ],
        ),
        (
            "home_dwell_pause",
            &[
                Instruction::Home { axes: [true; 3] },
                Instruction::Dwell { micros: 250_000 },
                Instruction::Pause,
                rapid(1, 1),
                Instruction::End,
            ],
        ),
    ];
    let mut seeds = Vec::new();
    for (name, program) in programs {
        let mut writer = job::Writer::new(name);
        let mut file = writer.header().to_vec();
        let mut blocks = vec![0];
        let mut held = |block: &[u8]| {
            blocks.extend(((block.len() - FRAME) as u16).to_be_bytes());
            blocks.extend(&block[FRAME - 4..block.len() - 4]);
        };
        for (instruction, number) in program.iter().zip(1..) {
            writer.add(instruction, number, |full| {
                held(full);
                file.extend(full);
            });
        }
        // The last block is the end, with the count of instructions: a fuzzer's blocks do not have
        // it.
        let mut last = Vec::new();
        writer.finish(|full| last.push(full.to_vec()));
        for block in &last[..last.len() - 1] {
            held(block);
        }
        file.extend(last.concat());
        seeds.push(("job", name, blocks));
        seeds.push(("job", whole(name), [&[1][..], &file].concat()));
    }
    seeds
}

/// The name of the same job as a file.
/// Real conversations with the port of jobs, as scripts of [`crate::jobs`].
fn jobs_seeds() -> Vec<Seed> {
    let script = |steps: &[&[u8]]| steps.concat();
    let hello: &[u8] = &[0, 6];
    // A job of three lines, an arc and a dwell, called `a`, in blocks of 60 bytes.
    let upload: &[u8] = &[
        1, 5, 16, 20, 10, 16, 0, 20, 24, 5, 5, 10, 30, 0, 16, 0, 0, 0, 0,
    ];
    let (free, switched): (&[u8], &[u8]) = (&[2, 0], &[2, 1]);
    // Keepalive 100 ms.
    let command = |code: u8, flags: u8| [3, code, flags, 5, 0];
    let (start, attended) = (command(2, 128), command(2, 0));
    let (pause, go_on, stop, home) = (
        command(10, 0),
        command(1, 0),
        command(0, 0),
        command(11, 128),
    );
    let (some, long): (&[u8], &[u8]) = (&[4, 7], &[4, 10]);
    let (report, again, list): (&[u8], &[u8], &[u8]) = (&[14, 0], &[11], &[14, 1]);
    let talk: Vec<u8> = (0..11).flat_map(|verb| [10, verb << 1 | 1, 0]).collect();
    vec![
        (
            "jobs",
            "sent_started_and_drawn",
            script(&[
                hello, free, upload, list, &start, again, some, report, long, long, long, long,
                report,
            ]),
        ),
        (
            "jobs",
            "paused_gone_on_and_stopped",
            script(&[
                hello, free, upload, &start, some, &pause, some, report, &go_on, some, &stop,
                again, long, long, long, long, report,
            ]),
        ),
        (
            "jobs",
            "switches_are_looked_for",
            script(&[
                hello, switched, upload, &start, some, &home, some, report, long, report,
            ]),
        ),
        (
            "jobs",
            "an_estop_in_mid_job",
            script(&[hello, free, upload, &start, long, &[8, 8], some, report]),
        ),
        (
            "jobs",
            "its_starter_hangs_up",
            script(&[
                hello,
                free,
                upload,
                &attended,
                some,
                &[9],
                long,
                long,
                long,
                long,
                hello,
                report,
            ]),
        ),
        (
            "jobs",
            "the_console_says_it_all",
            script(&[hello, free, upload, &talk, long, &talk]),
        ),
        (
            "jobs",
            "fpga_gs_words",
            script(&[
                hello,
                free,
                &[12, 3, 0, 28],
                &[1; 28],
                &[12, 1, 0, 0],
                &[12, 2, 0, 0],
                long,
                report,
            ]),
        ),
        (
            "jobs",
            "garbled_in_pieces_and_unknown",
            script(&[
                &[14, 0],
                hello,
                &[15, 9],
                &[5, 99, 0, 2, 1, 2],
                &[7, 40, 128],
                &[6, 0, 4, 1, 2, 3, 4],
                hello,
                report,
            ]),
        ),
    ]
}

fn whole(name: &str) -> &'static str {
    match name {
        "a_square" => "a_file_with_a_square",
        "arcs_and_a_full_circle" => "a_file_with_arcs",
        _ => "a_file_with_a_pause",
    }
}

/// Records as `g2b.py` writes them and as its description has them.
fn xypen_seeds() -> Vec<Seed> {
    const NONE: f32 = f32::from_bits(xypen::MISSING);
    let record = |code: u32, [x, y, z, i, j]: [f32; 5], p: u32| {
        Record([
            code,
            x.to_bits(),
            y.to_bits(),
            z.to_bits(),
            i.to_bits(),
            j.to_bits(),
            p,
        ])
    };
    let go = |code, x, y, z| record(code, [x, y, z, NONE, NONE], xypen::MISSING);
    let arc = |code, x, y, i, j| record(code, [x, y, NONE, i, j], xypen::MISSING);
    let input = |flags: u8, counted: bool, records: &[Record]| {
        let mut input = vec![flags, 10, 20];
        if counted {
            input.extend((7 * records.len() as u32).to_le_bytes());
        }
        input.extend(records.iter().flat_map(|record| record.to_bytes()));
        input
    };
    let square = [
        go(0, 10.0, -10.0, 1.0),
        go(1, NONE, NONE, -1.0),
        go(1, 20.0, -10.0, NONE),
        go(1, 20.0, -20.0, NONE),
        record(4, [NONE; 5], 30),
        go(0, 0.0, 0.0, 1.0),
    ];
    let circles = [
        go(1, 10.0, 0.0, -1.0),
        arc(2, 10.0, 0.0, -5.0, NONE),
        arc(3, 0.0, -10.0, -10.0, 0.0),
        arc(2, 0.01, -10.0, NONE, 10.0),
    ];
    vec![
        ("xypen", "a_square_of_g2b", input(0b111, true, &square)),
        ("xypen", "a_square_upright", input(0b000, false, &square)),
        (
            "xypen",
            "circles_and_a_short_arc",
            input(0b011, false, &circles),
        ),
        (
            "xypen",
            "an_arc_without_a_centre",
            input(0b011, false, &[arc(2, 1.0, 1.0, NONE, NONE)]),
        ),
    ]
}
