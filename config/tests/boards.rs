//! The committed boards and platforms, and their compatibility with machines wired for Lcnc.

use ferrocnc_config::board::Class;
use ferrocnc_config::pinout::{Pinout, Use, svg, terminal};
use ferrocnc_config::source::{BUILT_IN, Folder};
use ferrocnc_config::{Board, Level, Platform, blob, export, read_board, schema, write};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn boards() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../boards")
}

fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = entries
        .filter(|path| path.to_str().unwrap().ends_with(ending))
        .collect();
    files.sort();
    files
}

fn board(name: &str) -> Board {
    read_board(&boards().join(format!("{name}.toml"))).unwrap_or_else(|error| panic!("{error}"))
}

fn platform(name: &str) -> Platform {
    let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name).unwrap();
    Platform::read("test", name, text).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn every_committed_board_reads_describes_itself_and_comes_back_from_our_own_toml() {
    let files = files(&boards(), ".toml");
    assert!(files.len() >= 10, "{files:?}");
    for file in files {
        let board = read_board(&file).unwrap_or_else(|error| panic!("{error}"));
        let blob = blob::blob(&board).unwrap_or_else(|error| panic!("{error}"));
        assert!(blob.len() <= blob::ROM);
        assert_eq!(
            board.missing_pins().is_empty(),
            board.name != "max",
            "{}",
            board.name
        );
        let toml = write::to_toml(&board, &["A note.".to_owned()]);
        let again = Board::read("again.toml", &board.name, &toml, &Folder::beside(&file)).unwrap();
        let mut exports = [
            export::export(&board).unwrap(),
            export::export(&again).unwrap(),
        ];
        for export in &mut exports {
            export["file"] = serde_json::Value::Null;
        }
        assert_eq!(exports[0], exports[1], "{}", board.name);
    }
}

#[test]
fn every_board_uses_its_sdram_unless_its_file_says_otherwise() {
    for file in files(&boards(), ".toml") {
        let board = read_board(&file).unwrap();
        // The largest board of the simulation has no pins, and is no card's.
        assert_eq!(board.sdram, board.name != "max", "{}", board.name);
        let again = write::to_toml(&board, &[]);
        assert_eq!(again.contains("sdram = false"), !board.sdram, "{again}");
    }
    let known = Folder::beside(&boards().join("mill6.toml"));
    let mill6 = std::fs::read_to_string(boards().join("mill6.toml")).unwrap();
    for (said, sdram) in [("true", true), ("false", false)] {
        let text = mill6.replace("sys_clk_hz", &format!("sdram = {said}\nsys_clk_hz"));
        let board = Board::read("boards/mill6.toml", "mill6", &text, &known).unwrap();
        assert_eq!((board.jobs, board.sdram), (0, sdram));
    }
}

#[test]
fn a_board_with_streamed_jobs_uses_no_sdram_and_needs_none() {
    let plotter = std::fs::read_to_string(boards().join("plotter.toml")).unwrap();
    let read = |text: &str, platforms: &Folder| {
        Board::read("boards/plotter.toml", "plotter", text, platforms)
    };
    let known = Folder::beside(&boards().join("plotter.toml"));
    assert!(read(&plotter, &known).unwrap().sdram);
    let without = plotter.replace("jobs = 3\n", "jobs = 3\nsdram = false\n");
    let board = read(&without, &known).unwrap();
    assert_eq!((board.jobs, board.sdram), (3, false));
    assert_eq!(export::export(&board).unwrap()["sdram"], false);
    let again = read(&write::to_toml(&board, &[]), &known).unwrap();
    assert_eq!((again.jobs, again.sdram), (3, false));

    // A card without a description of its SDRAM.
    let folder = std::env::temp_dir().join(format!("ferrocnc-no-sdram-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("platforms")).unwrap();
    let (_, card) = BUILT_IN
        .iter()
        .find(|(known, _)| *known == "5a-75b-8.0")
        .unwrap();
    let (card, _) = card.split_once("[sdram]").unwrap();
    std::fs::write(folder.join("platforms/5a-75b-8.0.toml"), card).unwrap();
    let bare = Folder::beside(&folder.join("plotter.toml"));
    let error = read(&plotter, &bare).unwrap_err().to_string();
    for part in ["jobs: 3 needs an SDRAM", "sdram = false", "[sdram]"] {
        assert!(error.contains(part), "{part:?} is not in {error:?}");
    }
    assert!(!read(&without, &bare).unwrap().sdram);
    let nothing_said = read(&plotter.replace("jobs = 3\n", ""), &bare).unwrap();
    assert!(!nothing_said.sdram);
    assert!(!write::to_toml(&nothing_said, &[]).contains("sdram"));
    let demanded = plotter.replace("jobs = 3\n", "sdram = true\n");
    let error = read(&demanded, &bare).unwrap_err().to_string();
    for part in ["sdram: true needs an SDRAM", "sdram = false", "[sdram]"] {
        assert!(error.contains(part), "{part:?} is not in {error:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_blob_says_every_name_and_pin_as_the_driver_reads_it() {
    use wire::board::{Blob, Kind};
    for file in files(&boards(), ".toml") {
        let board = read_board(&file).unwrap();
        let bytes = blob::blob(&board).unwrap();
        let blob = Blob::new_checked(&bytes).unwrap();
        assert_eq!(blob.text(Kind::Configuration, 0), Some(board.name.as_str()));
        assert_eq!(
            blob.text(Kind::Fpga, 0),
            Some(board.platform.device.as_str())
        );
        assert_eq!(
            blob.text(Kind::Platform, 0),
            Some(board.platform.name.as_str())
        );
        assert_eq!(
            blob.facts().any(|entry| entry.kind == Kind::Mac),
            board.mac.is_some()
        );
        for (class, kind) in Class::ALL.into_iter().zip([
            Kind::Stepgen,
            Kind::Encoder,
            Kind::Pwm,
            Kind::Input,
            Kind::Output,
        ]) {
            for (n, channel) in (0..).zip(board.of(class)) {
                assert_eq!(blob.text(kind, n), Some(channel.name.as_str()));
                let said = blob.entries().find(|e| {
                    e.kind == Kind::Pins
                        && e.channel == n
                        && e.value.first() == Some(&(class.letter() as u8))
                });
                let said = said
                    .map(|entry| std::str::from_utf8(&entry.value[1..]).unwrap())
                    .unwrap_or_default();
                assert_eq!(
                    said,
                    channel.text(class),
                    "{} {} {n}",
                    board.name,
                    class.key()
                );
            }
        }
    }
}

#[test]
fn a_machine_wired_for_lcncs_images_finds_every_pin_where_it_was() {
    let mut seen = 0;
    for section in include_str!("lcnc_pins.txt").split("\n[").skip(1) {
        let (name, facts) = section.split_once(']').unwrap();
        let board = board(name);
        let of = |key: &str| -> Vec<&str> {
            let line = facts
                .lines()
                .find_map(|line| line.strip_prefix(key)?.strip_prefix(' '));
            line.map_or(Vec::new(), |line| line.split(' ').collect())
        };
        let ours = |class: Class, keys: &[&str]| -> Vec<String> {
            let channel = |channel: &ferrocnc_config::Channel| {
                keys.iter()
                    .map(|key| channel.pin(key).unwrap())
                    .collect::<Vec<_>>()
                    .join(",")
            };
            board.of(class).iter().map(channel).collect()
        };
        assert_eq!(of("platform"), [board.platform.name.as_str()], "{name}");
        assert_eq!(
            of("reset"),
            [board.ext_reset.pin.as_deref().unwrap()],
            "{name}"
        );
        assert_eq!(
            board.ext_reset.active,
            Level::High,
            "{name}: an open reset line stops, as with Lcnc"
        );
        assert_eq!(of("inputs"), ours(Class::Input, &["pin"]), "{name}");
        assert_eq!(of("outputs"), ours(Class::Output, &["pin"]), "{name}");
        assert_eq!(of("pwms"), ours(Class::Pwm, &["pin"]), "{name}");
        assert_eq!(of("encoders"), ours(Class::Encoder, &["a", "b"]), "{name}");
        assert_eq!(
            of("stepgens"),
            ours(Class::Stepgen, &["step", "dir"]),
            "{name}"
        );
        // The folder's name counts them.
        let counts = name.rsplit('_').next().unwrap();
        let wanted = [
            (Class::Output, 'o'),
            (Class::Input, 'i'),
            (Class::Stepgen, 's'),
            (Class::Encoder, 'e'),
            (Class::Pwm, 'p'),
        ];
        let told: String = wanted
            .iter()
            .filter(|(class, _)| !board.of(*class).is_empty())
            .map(|(class, letter)| format!("{}{letter}", board.of(*class).len()))
            .collect();
        assert_eq!(counts, told);
        assert_eq!(board.sys_clk_hz, 60_000_000);
        assert_eq!((board.ipv4, board.udp_port), ([192, 168, 2, 50], 1234));
        assert!(
            board
                .of(Class::Output)
                .iter()
                .all(|output| output.safe == Some(Level::Low)),
            "Lcnc's reset makes them low, too"
        );
        seen += 1;
    }
    assert_eq!(seen, 8);
}

#[test]
fn the_platforms_we_carry_are_those_of_the_folder() {
    let stems: Vec<String> = files(&boards().join("platforms"), ".toml")
        .iter()
        .map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    let carried: Vec<&str> = BUILT_IN.iter().map(|(name, _)| *name).collect();
    assert_eq!(stems, carried);
}

#[test]
fn every_platform_has_its_headers_two_phys_and_no_ball_twice() {
    for (name, _) in BUILT_IN {
        let platform = platform(name);
        assert_eq!(
            platform.headers.len(),
            if name.starts_with("5a-75b") { 8 } else { 16 },
            "{name}"
        );
        assert_eq!(platform.phys.len(), 2, "{name}");
        let balls: BTreeSet<&str> = platform.pins().map(|(_, ball)| ball).collect();
        assert_eq!(balls.len(), platform.headers.len() * 6 + 8 + 1, "{name}");
        assert!(
            platform.phy_reset.is_some(),
            "{name}: the reset is listed, so that it is not taken for a free ball"
        );
        assert_eq!(
            platform.flash_bytes,
            if *name == "5a-75b-6.1" {
                2 << 20
            } else {
                4 << 20
            },
            "{name}"
        );
        assert_eq!(
            platform.package,
            if *name == "5a-75b-6.1" {
                "CABGA381"
            } else {
                "CABGA256"
            },
            "{name}"
        );
        for n in 7..15 {
            let lines: BTreeSet<_> = platform
                .headers
                .iter()
                .map(|(header, _)| platform.pin(&format!("{header}:{n}")).unwrap())
                .map(|(_, ball)| ball)
                .collect();
            assert_eq!(
                lines.len(),
                1,
                "{name}: pin {n} is one line on every header"
            );
        }
        for n in [3, 15] {
            assert_eq!(
                platform.pin(&format!("j1:{n}")).unwrap().1,
                None,
                "{name}: pin {n} is ground"
            );
        }
        assert_eq!(platform.pin("j1:16"), None);
        assert_eq!(platform.pin("j1:01"), None);
    }
}

#[test]
fn boards_of_one_connection_are_one_but_for_the_fpga() {
    for (old, new) in [("5a-75b-8.0", "5a-75b-8.2"), ("5a-75e-6.0", "5a-75e-8.2")] {
        let (old, new) = (platform(old), platform(new));
        assert_eq!(
            (old.headers, old.shared, old.phys, old.flash_balls),
            (new.headers, new.shared, new.phys, new.flash_balls)
        );
        assert_ne!(old.device, new.device);
    }
}

#[test]
fn the_committed_schemas_are_what_the_reader_checks() {
    for (name, make) in schema::FILES {
        let committed = std::fs::read_to_string(boards().join(name)).unwrap();
        let committed: serde_json::Value = serde_json::from_str(&committed).unwrap();
        assert_eq!(
            committed,
            make(),
            "{name} is stale: cargo run -p ferrocnc-config -- schema boards"
        );
    }
}

#[test]
fn the_manual_names_every_key() {
    let manual = std::fs::read_to_string(boards().join("../docs/configuration.md")).unwrap();
    let board = schema::board();
    let mut keys: Vec<String> = Vec::new();
    let mut open = vec![&board];
    while let Some(table) = open.pop() {
        let Some(properties) = table["properties"].as_object() else {
            continue;
        };
        for (key, property) in properties {
            keys.push(key.clone());
            open.extend([property, &property["items"]]);
        }
    }
    assert!(keys.len() > 30, "{keys:?}");
    for key in keys {
        let ways = [
            format!("`{key}`"),
            format!("`[{key}]`"),
            format!("`[[{key}]]`"),
        ];
        assert!(
            ways.iter().any(|way| manual.contains(way)),
            "docs/configuration.md does not name `{key}`"
        );
    }
}

#[test]
fn the_drawings_show_every_channel_once_and_shared_lines_on_every_header() {
    for file in files(&boards(), ".toml") {
        let board = read_board(&file).unwrap();
        let pinout = Pinout::of_board(&board);
        let (svg, text) = (svg(&pinout), terminal(&pinout, 200, false));
        assert!(
            svg.starts_with("<svg ")
                && svg.ends_with("</svg>\n")
                && svg.matches("<g ").count() == svg.matches("</g>").count()
        );
        for channel in board
            .channels
            .iter()
            .flatten()
            .filter(|channel| !channel.pins.is_empty())
        {
            assert!(
                svg.contains(&channel.name),
                "{}: {} is not drawn",
                board.name,
                channel.name
            );
            assert!(
                text.contains(&channel.name),
                "{}: {} is not in\n{text}",
                board.name,
                channel.name
            );
        }
        for header in &pinout.headers {
            assert!(svg.contains(&format!(">{}<", header.name.to_uppercase())));
            assert_eq!(
                header
                    .pins
                    .iter()
                    .filter(|pin| pin.usage == Use::Ground)
                    .count(),
                2
            );
            assert_eq!(header.pins.iter().filter(|pin| pin.shared).count(), 8);
        }
        for n in 7..15 {
            let labels: BTreeSet<&str> = pinout
                .headers
                .iter()
                .map(|header| header.pins[n].label.as_str())
                .collect();
            assert_eq!(
                labels.len(),
                1,
                "{}: line {n} is the same on every header",
                board.name
            );
        }
        assert!(!terminal(&pinout, 80, false).contains('\u{1b}'));
        assert!(terminal(&pinout, 80, true).contains("\u{1b}["));
        let widest = |width: usize| {
            terminal(&pinout, width, false)
                .lines()
                .filter(|line| line.contains('\u{2502}'))
                .map(|line| line.chars().count())
                .max()
        };
        assert!(
            widest(80) <= Some(80) && widest(200) <= Some(200),
            "{:?} {:?}",
            widest(80),
            widest(200)
        );
    }
}

#[test]
fn a_name_with_an_ampersand_does_not_break_the_drawing() {
    let mut pinout = Pinout::of_platform(&platform("5a-75b-8.0"));
    pinout.title = "a <b> & \"c\"".to_owned();
    assert!(svg(&pinout).contains("a &lt;b&gt; &amp; \"c\""));
}

#[test]
fn the_drawing_in_the_manual_is_what_we_draw() {
    let committed = std::fs::read_to_string(boards().join("../docs/img/mill6-pinout.svg")).unwrap();
    let drawn = svg(&Pinout::of_board(&board("mill6")));
    assert!(
        committed == drawn,
        "stale: ferrocnc config pinout boards/mill6.toml -o docs/img/mill6-pinout.svg"
    );
}
