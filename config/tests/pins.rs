//! Board files as configurations of an image's pins.

use ferrocnc_config::board::{Class, Platforms};
use ferrocnc_config::pins::{Image, Stored, configuration};
use ferrocnc_config::source::{BUILT_IN, Folder};
use ferrocnc_config::{Board, Error, Level, Platform, read_board};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use wire::board::{Blob, Kind};
use wire::describe::FEATURE_JOBS;
use wire::pins::{BYTES_MAX, Built, Head, INVERT, NONE, Verdict, platform_number, route};

const EIGHT: Built = Built {
    stepgens: 8,
    encoders: 8,
    pwms: 8,
    lines: 56,
};
const MILL6: &str = include_str!("../../boards/mill6.toml");

fn read(text: &str) -> Board {
    read_as("mill6", text)
}

fn read_as(name: &str, text: &str) -> Board {
    Board::read(&format!("{name}.toml"), name, text, &Folder::default())
        .unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn compiled(board: &Board, text: &str, built: Built) -> Vec<u8> {
    configuration(board, text, built, 7).unwrap_or_else(|error| panic!("{error}"))
}

/// The line of a pin, counted on the fingers: six of each header, then the shared ones.
fn finger(headers: u8, pin: &str) -> u8 {
    let (header, n) = pin[1..].split_once(':').unwrap();
    let (header, n): (u8, u8) = (header.parse().unwrap(), n.parse().unwrap());
    match [0, 1, 2, 4, 5, 6].iter().position(|own| *own == n) {
        Some(own) => (header - 1) * 6 + own as u8,
        None => headers * 6 + n - 7,
    }
}

/// What the words in front say, by the names of a board file: each driven line with its source, and
/// each input of a core that listens.
fn said(head: &Head) -> (BTreeMap<u8, u8>, BTreeMap<u8, u8>) {
    let outputs = (0..128).filter(|line| head.driven(*line));
    let outputs = outputs.map(|line| (line, route(head.outputs(), line)));
    let inputs = (0..128).map(|sink| (sink, route(head.inputs(), sink)));
    (
        outputs.collect(),
        inputs.filter(|(_, route)| *route != NONE).collect(),
    )
}

/// Every pin is where the file says, and nothing else is anywhere.
fn assert_is(board: &Board, bytes: &[u8], built: Built) {
    let stored = Stored::new_checked(bytes).unwrap();
    let head = stored.head;
    let platform = platform_number(&board.platform.name);
    assert_eq!(head.check(built, platform), Verdict::InForce);
    let headers = board.platform.headers.len() as u8;
    let (mut outputs, mut inputs) = (BTreeMap::new(), BTreeMap::new());
    let mut stops = BTreeMap::new();
    for class in Class::ALL {
        for (n, channel) in (0..).zip(board.of(class)) {
            for (key, pin) in &channel.pins {
                let line = finger(headers, pin);
                let source = match (class, *key) {
                    (Class::Stepgen, "step") => built.step(n),
                    (Class::Stepgen, "dir") => built.step(n) + 1,
                    (Class::Stepgen, "step_n") => built.step(n) | INVERT,
                    (Class::Stepgen, "dir_n") => (built.step(n) + 1) | INVERT,
                    (Class::Pwm, "pin") => built.pwm(n),
                    (Class::Pwm, "dir") => built.pwm(n) + 1,
                    (Class::Output, "pin") => built.own(line),
                    _ => NONE,
                };
                let sink = match (class, *key) {
                    (Class::Stepgen, "index") => built.index(n),
                    (Class::Encoder, key) => {
                        let keys = ["a", "b", "index", "mask"];
                        built.encoder(n) + keys.iter().position(|it| *it == key).unwrap() as u8
                    }
                    (Class::Input, _) => {
                        stops.extend(channel.estop.map(|level| (line, level)));
                        continue;
                    }
                    _ => {
                        outputs.insert(line, source);
                        continue;
                    }
                };
                inputs.insert(sink, line);
            }
        }
    }
    for (n, (line, level)) in (0..).zip(stops) {
        let inverted = if level == Level::Low { INVERT } else { 0 };
        inputs.insert(built.estop(n), line | inverted);
    }
    let controls = [
        (Some(&board.ext_reset), built.reset()),
        (board.factory.as_ref(), built.factory()),
    ];
    for (control, sink) in controls {
        if let Some(control) = control
            && let Some(pin) = &control.pin
        {
            let inverted = if control.active == Level::Low {
                INVERT
            } else {
                0
            };
            let line = if pin == "key" {
                built.key()
            } else {
                finger(headers, pin)
            };
            inputs.insert(sink, line | inverted);
        }
    }
    assert_eq!(said(&head), (outputs, inputs), "{}", board.name);
    assert_described(board, &stored, headers);
}

/// The description has every channel in the file's order, inputs and outputs under the numbers of
/// their lines.
fn assert_described(board: &Board, stored: &Stored<'_>, headers: u8) {
    let blob = Blob::new_checked(stored.description).unwrap();
    assert_eq!(blob.text(Kind::Platform, 0), Some(&*board.platform.name));
    let mut ends = [0, 0];
    for (class, kind) in Class::ALL.into_iter().zip([
        Kind::Stepgen,
        Kind::Encoder,
        Kind::Pwm,
        Kind::Input,
        Kind::Output,
    ]) {
        let wanted: Vec<(u8, &str)> = (0..)
            .zip(board.of(class))
            .map(|(n, channel)| match class {
                Class::Input | Class::Output => {
                    let line = finger(headers, channel.pin("pin").unwrap());
                    let end = &mut ends[usize::from(class == Class::Output)];
                    *end = (line + 1).max(*end);
                    (line, channel.name.as_str())
                }
                _ => (n, channel.name.as_str()),
            })
            .collect();
        let found: Vec<(u8, &str)> = { blob.entries() }
            .filter(|entry| entry.kind == kind)
            .map(|entry| (entry.channel, std::str::from_utf8(entry.value).unwrap()))
            .collect();
        assert_eq!(found, wanted, "{} {}", board.name, class.key());
    }
    let [motion, general] = stored.head.channels();
    let counts = [Class::Stepgen, Class::Encoder, Class::Pwm].map(|class| board.of(class).len());
    assert_eq!(motion.to_le_bytes().map(usize::from)[..3], counts);
    assert_eq!(general.to_le_bytes(), [ends[0], ends[1], 0, 0]);
}

#[test]
fn every_board_file_of_a_5a_75b_is_a_configuration_for_its_image() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../boards");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "toml") {
            continue;
        }
        let board = read_board(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        if !board.platform.name.starts_with("5a-75b") {
            continue;
        }
        if !board.missing_pins().is_empty() {
            let said = configuration(&board, &text, EIGHT, 1)
                .unwrap_err()
                .to_string();
            assert!(said.contains("can only be simulated"), "{said}");
            continue;
        }
        let bytes = compiled(&board, &text, EIGHT);
        assert_is(&board, &bytes, EIGHT);
        assert_eq!(Stored::new_checked(&bytes).unwrap().text, text);
        seen += 1;
    }
    assert_eq!(seen, 8);
}

#[test]
fn the_file_comes_back_as_it_was_and_a_changed_byte_makes_the_copy_none() {
    let text = format!("{MILL6}\n# gr\u{fc}\u{df}e \u{1f9f0}");
    let bytes = compiled(&read(&text), &text, EIGHT);
    let stored = Stored::new_checked(&bytes).unwrap();
    assert_eq!((stored.text, stored.head.generation()), (&*text, 7));
    let mut longer = bytes.clone();
    longer.resize(BYTES_MAX as usize, 0xff);
    assert_eq!(
        Stored::new_checked(&longer),
        Some(stored),
        "as it lies in flash"
    );
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 4;
        assert_eq!(Stored::new_checked(&bad), None, "byte {at}");
    }
    for length in 0..bytes.len() {
        assert_eq!(Stored::new_checked(&bytes[..length]), None, "{length}");
    }
}

#[test]
fn lines_are_counted_in_the_order_of_the_headers_and_shared_ones_come_last() {
    for (name, _) in BUILT_IN {
        let (file, text) = Folder::default().text(name).unwrap();
        let platform = Platform::read(&file, name, &text).unwrap();
        let headers = platform.headers.len();
        let mut seen = vec![0; platform.lines().len()];
        for (header, _) in &platform.headers {
            for n in 0..16 {
                let pin = format!("{header}:{n}");
                let found = platform.line(&pin);
                match n {
                    3 | 15 => assert_eq!(found, None, "{pin} is ground"),
                    _ => {
                        let line = finger(headers as u8, &pin);
                        assert_eq!(found, Some(line), "{name} {pin}");
                        seen[usize::from(line)] += 1;
                    }
                }
            }
        }
        let (own, shared) = seen.split_at(headers * 6);
        assert!(own.iter().all(|count| *count == 1), "{name}");
        assert!(shared.iter().all(|count| *count == headers), "{name}");
        for pin in ["key", "none", "j99:0", "j1:16", "j1:00"] {
            assert_eq!(platform.line(pin), None, "{pin}");
        }
    }
}

fn refused(text: &str, built: Built) -> String {
    let refused = configuration(&read(text), text, built, 1);
    refused.unwrap_err().to_string()
}

fn assert_says(said: &str, parts: &[&str]) {
    for part in parts {
        assert!(said.contains(part), "{part:?} is not in {said:?}");
    }
    assert!(!said.contains('\n'), "one sentence: {said}");
}

#[test]
fn a_file_with_more_channels_than_the_image_names_both_counts_and_what_would_have_them() {
    for (built, parts) in [
        (
            Built {
                stepgens: 4,
                ..EIGHT
            },
            [
                "stepgen: is there 6 times",
                "image has 4",
                "cargo xtask bitstream boards/mill6.toml",
            ],
        ),
        (
            Built {
                encoders: 0,
                ..EIGHT
            },
            [
                "encoder: is there 6 times",
                "image has 0",
                "cargo xtask bitstream boards/mill6.toml",
            ],
        ),
        (
            Built { pwms: 5, ..EIGHT },
            [
                "pwm: is there 6 times",
                "image has 5",
                "cargo xtask bitstream boards/mill6.toml",
            ],
        ),
        (
            Built {
                lines: 104,
                ..EIGHT
            },
            ["has 56 header lines", "the image has 104", "the card"],
        ),
    ] {
        assert_says(&refused(MILL6, built), &parts);
    }
}

#[test]
fn a_file_for_another_image_is_refused_by_the_key_that_differs() {
    let image = Image {
        built: EIGHT,
        platform: platform_number("5a-75b-8.0"),
        clock_hz: 60_000_000,
        features: 0,
    };
    let board = read(MILL6);
    assert_eq!(image.fits(&board), Ok(()));
    let fails = |image: Image, text: &str| image.fits(&read(text)).unwrap_err().to_string();
    let elsewhere = Image {
        platform: platform_number("5a-75e-7.1"),
        ..image
    };
    assert_says(
        &fails(elsewhere, MILL6),
        &[
            "platform: \"5a-75b-8.0\"",
            "is not the card's, which is 5a-75e-7.1",
        ],
    );
    let unknown = Image {
        platform: 1,
        ..image
    };
    assert_says(&fails(unknown, MILL6), &["this version does not know"]);
    let slow = MILL6.replace("60_000_000", "50_000_000");
    assert_says(
        &fails(image, &slow),
        &["sys_clk_hz: 50000000", "write 60000000"],
    );
    let jack = format!("phy = 1\n{MILL6}");
    assert_says(&fails(image, &jack), &["phy: 1", "use the other jack"]);
    let jobs = format!("jobs = 3\n{MILL6}");
    assert_says(&fails(image, &jobs), &["jobs: 3 needs an image with jobs"]);
    let with = Image {
        features: FEATURE_JOBS,
        ..image
    };
    assert_eq!(with.fits(&read(&jobs)), Ok(()));
    let without = format!("sdram = false\n{MILL6}");
    assert_eq!(image.fits(&read(&without)), Ok(()), "the image decides");
}

#[test]
fn a_fifth_estop_input_a_button_as_input_and_a_channel_without_pins_are_refused() {
    let stop = |n: u8| format!("pin = \"j8:{n}\"\nestop = \"low\"");
    let mut text = MILL6.to_owned();
    for n in [7, 8, 10, 11] {
        text = text.replace(&format!("pin = \"j8:{n}\""), &stop(n));
    }
    assert_says(
        &refused(&text, EIGHT),
        &["gpio_in: has 5 e-stop inputs, and an image has 4"],
    );
    let four = text.replace(&stop(11), "pin = \"j8:11\"");
    assert_is(&read(&four), &compiled(&read(&four), &four, EIGHT), EIGHT);

    let button = MILL6
        .replace("{ pin = \"key\"", "{ pin = \"none\"")
        .replace("pin = \"j8:2\"", "pin = \"key\"");
    assert_says(
        &refused(&button, EIGHT),
        &["gpio_in[0].pin: \"key\"", "ext_reset or factory"],
    );

    let pinless = MILL6.replace("pin = \"j3:0\"\n", "");
    assert_says(
        &refused(&pinless, EIGHT),
        &["pwm[0].pin", "can only be simulated"],
    );
}

#[test]
fn a_file_is_as_long_as_a_copy_has_room() {
    let short = compiled(&read(MILL6), MILL6, EIGHT).len();
    let room = BYTES_MAX as usize - short;
    let filled = |more: usize| format!("{MILL6}#{}\n", "x".repeat(more - 2));
    let bytes = compiled(&read(MILL6), &filled(room), EIGHT);
    assert_eq!(bytes.len(), BYTES_MAX as usize);
    assert_says(
        &refused(&filled(room + 4), EIGHT),
        &[
            "is too long: the board stores 24576 bytes",
            "shorten its comments",
        ],
    );
}

#[test]
fn an_input_or_output_beyond_the_first_64_lines_is_refused_and_a_step_pin_is_not() {
    let built = Built {
        lines: 104,
        ..EIGHT
    };
    let of = |pins: &str| {
        format!(
            "name = \"e\"\nplatform = \"5a-75e-7.1\"\nsys_clk_hz = 60_000_000\n\
             ext_reset = {{ pin = \"none\", active = \"low\" }}\n\
             network = {{ ipv4 = \"192.168.2.50\", udp_port = 1234 }}\n{pins}"
        )
    };
    let far = of("[[gpio_out]]\nname = \"o\"\npin = \"j11:5\"\nsafe = \"low\"\n");
    let board = read_as("e", &far);
    let said: Result<_, Error> = configuration(&board, &far, built, 1);
    assert_says(
        &said.unwrap_err().to_string(),
        &[
            "gpio_out[0].pin: \"j11:5\" is line 64",
            "the first 64 lines",
        ],
    );
    let near = of("[[gpio_out]]\nname = \"o\"\npin = \"j11:4\"\nsafe = \"low\"\n");
    let board = read_as("e", &near);
    assert_is(&board, &compiled(&board, &near, built), built);
    let step = of("[[stepgen]]\nname = \"x\"\nstep = \"j16:6\"\ndir = \"j16:14\"\n");
    let board = read_as("e", &step);
    assert_is(&board, &compiled(&board, &step, built), built);
}

/// A legal file: channels as the counts say, on pins in this order.
fn file(counts: [u8; 5], optional: u64, mut pins: Vec<String>, stops: u8) -> String {
    let mut text = String::from(
        "name = \"mill6\"\nplatform = \"5a-75b-8.0\"\nsys_clk_hz = 60_000_000\n\
         network = { ipv4 = \"192.168.2.50\", udp_port = 1234 }\n",
    );
    let level = |bit: u64| {
        if optional >> bit & 1 == 0 {
            "low"
        } else {
            "high"
        }
    };
    let mut next = |fallback: &str| pins.pop().unwrap_or(fallback.to_owned());
    let reset = if optional & 1 == 0 {
        "key".to_owned()
    } else {
        next("none")
    };
    let factory = if optional & 2 == 0 {
        reset.clone()
    } else {
        next("none")
    };
    let _ = writeln!(
        text,
        "ext_reset = {{ pin = {reset:?}, active = {:?} }}",
        level(2)
    );
    let _ = writeln!(
        text,
        "factory = {{ pin = {factory:?}, active = {:?} }}",
        level(3)
    );
    let shared: Vec<String> = (1..=8)
        .map(|n| format!("\"j{n}\", \"j{n}:shared\""))
        .collect();
    let _ = writeln!(text, "[modified]\nbus_switch = [{}]", shared.join(", "));
    let mut stops = stops;
    for (class, count) in Class::ALL.into_iter().zip(counts) {
        for n in 0..count {
            let wanted: Vec<(&str, String)> = { class.pins().iter().zip(4..) }
                .filter(|((_, needed, _), bit)| {
                    *needed || optional >> (bit + u64::from(n)) & 1 != 0
                })
                .map(|((key, ..), _)| (*key, next("")))
                .collect();
            if wanted.iter().any(|(_, pin)| pin.is_empty()) {
                return text;
            }
            let _ = writeln!(text, "[[{}]]\nname = \"n{n}\"", class.key());
            for (key, pin) in wanted {
                let _ = writeln!(text, "{key} = {pin:?}");
            }
            if class == Class::Input && stops > 0 {
                stops -= 1;
                let _ = writeln!(text, "estop = {:?}", level(n.into()));
            }
            if class == Class::Output {
                let _ = writeln!(text, "safe = {:?}", level(n.into()));
            }
        }
    }
    text
}

fn pins() -> Vec<String> {
    let own = (1..=8).flat_map(|header| [0, 1, 2, 4, 5, 6].map(|n| format!("j{header}:{n}")));
    // A shared line is on every header.
    let shared = (7..15).map(|n| format!("j{}:{n}", n - 6));
    own.chain(shared).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_legal_assignment_is_a_configuration_and_each_pin_is_where_the_file_says(
        counts in [0u8..=8, 0u8..=8, 0u8..=8, 0u8..=40, 0u8..=40],
        optional in any::<u64>(),
        pins in Just(pins()).prop_shuffle(),
        stops in 0u8..=4,
    ) {
        let text = file(counts, optional, pins, stops);
        let board = read(&text);
        let bytes = compiled(&board, &text, EIGHT);
        assert_is(&board, &bytes, EIGHT);
    }
}
