//! `docs/pins.md` says what the driver exports: every pin, its type, its direction, and the other
//! drivers' names for it.

#[path = "common/fake_board.rs"]
mod common;

use common::rig::{Rig, load_with};
use common::{FakeBoard, MILL6_ROW, Time};
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::hal::{Direction, Type};
use ferrocnc::names::{self, Scheme};
use ferrocnc_config::Class;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const PAGE: &str = include_str!("../../docs/pins.md");

/// Everything a `mill6` exports under a scheme.
fn export(scheme: Option<&Scheme>) -> FakeHal {
    let board = FakeBoard::saying(MILL6_ROW);
    let mut hal = FakeHal::new();
    let (driver, identity) = load_with(&board, &mut hal, 0);
    if let Some(scheme) = scheme {
        assert_eq!(scheme.check(0, &identity), Ok(()));
        names::export(scheme, &mut hal, 0, &identity, &driver).unwrap();
    }
    hal
}

fn kind(ty: Type, direction: Direction) -> String {
    let ty = match ty {
        Type::Bit => "bit",
        Type::Float => "float",
        Type::S32 => "s32",
        Type::U32 => "u32",
    };
    let direction = match direction {
        Direction::In => "in",
        Direction::Out => "out",
        Direction::Io => "io",
        Direction::ReadOnly => "ro",
        Direction::ReadWrite => "rw",
    };
    format!("{ty} {direction}")
}

/// The name without its board, and `<nn>` for the channel.
fn general(name: &str, prefix: &str) -> Option<String> {
    let name = name.strip_prefix(prefix)?;
    let mut parts: Vec<&str> = name.split('.').collect();
    let classes = [
        "stepgen", "encoder", "pwm", "gpio", "input", "output", "estop",
    ];
    for n in 0..parts.len().saturating_sub(2) {
        if classes.contains(&parts[n]) {
            parts[n + 1] = "<nn>";
        }
    }
    Some(parts.join("."))
}

/// Cells of every table row with a name in backquotes in its first cell.
fn rows() -> impl Iterator<Item = Vec<&'static str>> {
    PAGE.lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
}

/// The names in a cell, with whether they are starred.
fn listed(cell: &str) -> Vec<(String, bool)> {
    let words = cell.split_whitespace().filter(|word| *word != "-");
    words
        .map(|word| {
            (
                word.trim_matches(['`', '*']).to_owned(),
                word.ends_with('*'),
            )
        })
        .collect()
}

#[test]
fn every_pin_is_on_the_page_with_its_type_and_nothing_else_is() {
    let exported: BTreeMap<String, String> = export(None)
        .list()
        .map(|(name, ty, direction)| (general(name, "ferrocnc.0.").unwrap(), kind(ty, direction)))
        .collect();
    let page: BTreeMap<String, String> = rows()
        .filter(|row| row.len() == 6)
        .map(|row| (row[0].trim_matches('`').to_owned(), row[1].to_owned()))
        .collect();
    for (name, kind) in &exported {
        assert_eq!(page.get(name), Some(kind), "{name} is {kind}, on the page");
    }
    for name in page.keys() {
        assert!(exported.contains_key(name), "{name} is on the page only");
    }
}

/// What the comments of a first-light file ask to be typed, and what the file sets itself.
fn first_light_lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map(|line| line.strip_prefix("#   ").unwrap_or(line))
        .filter(|line| line.starts_with("setp ") || line.starts_with("getp "))
}

#[test]
fn a_first_light_file_sets_and_asks_for_pins_that_are_there() {
    let boards = Path::new(env!("CARGO_MANIFEST_DIR")).join("../boards");
    let board = ferrocnc_config::read_board(&boards.join("mill6.toml")).unwrap();
    let hal = export(None);
    let there: BTreeMap<String, Direction> = hal
        .list()
        .map(|(name, _, direction)| (general(name, "ferrocnc.0.").unwrap(), direction))
        .collect();
    let text = ferrocnc_config::first_light::first_light(&board, None);
    let mut looked = 0;
    for line in first_light_lines(&text) {
        let words: Vec<&str> = line.split(' ').collect();
        let direction = general(words[1], "ferrocnc.0.").and_then(|name| there.get(&name));
        let direction = direction.unwrap_or_else(|| panic!("{line}: no such pin"));
        match words[0] {
            "setp" => assert!(
                matches!(
                    direction,
                    Direction::In | Direction::Io | Direction::ReadWrite
                ),
                "{line}"
            ),
            _ => looked += 1,
        }
    }
    // Every input, every encoder, every step generator, every PWM, and whether it is armed.
    let channels = board.channels();
    let all = [
        channels.stepgens,
        channels.encoders,
        channels.pwms,
        channels.inputs,
    ];
    assert_eq!(
        looked,
        1 + all.iter().map(|n| usize::from(*n)).sum::<usize>()
    );
    assert!(text.contains("\nloadrt ferrocnc boards=192.168.2.50\n"));
    let long = text.lines().find(|line| line.len() > 100);
    assert_eq!(long, None, "a line is too long to read in a terminal");
    let elsewhere = ferrocnc_config::first_light::first_light(&board, Some("10.0.0.7:99"));
    assert!(elsewhere.contains("\nloadrt ferrocnc boards=10.0.0.7:99\n"));
}

/// Aliases and pins of their own, exported under `prefix`, against a column of the page.
fn compare(scheme: &Scheme, prefix: &str, column: usize, alone: &str) {
    let hal = export(Some(scheme));
    // Starred, if the pin it belongs to is one of theirs, too.
    let aliases: BTreeSet<(String, bool)> = hal
        .aliases_of()
        .filter_map(|(name, of)| Some((general(name, prefix)?, of.starts_with(prefix))))
        .collect();
    let own: BTreeMap<String, String> = hal
        .list()
        .filter_map(|(name, ty, direction)| Some((general(name, prefix)?, kind(ty, direction))))
        .collect();
    let mut page = BTreeSet::new();
    for row in rows().filter(|row| row.len() == 6) {
        page.extend(listed(row[column]));
    }
    for row in rows().filter(|row| row.len() == 3) {
        if let Some(name) = row[0].trim_matches('`').strip_prefix(alone) {
            assert_eq!(own.get(name).map(String::as_str), Some(row[1]), "{name}");
            page.insert((name.to_owned(), true));
        }
    }
    let exported: BTreeSet<_> = aliases
        .into_iter()
        .chain(own.into_keys().map(|name| (name, true)))
        .collect();
    let missing: Vec<_> = exported.difference(&page).collect();
    let invented: Vec<_> = page.difference(&exported).collect();
    assert!(
        missing.is_empty() && invented.is_empty(),
        "not on the page: {missing:?}; only there: {invented:?}"
    );
}

#[test]
fn lcncs_column_is_what_names_lcnc_exports() {
    compare(&Scheme::Lcnc, "Lcnc.00.", 3, "Lcnc.<nn>.");
}

#[test]
fn litexcncs_column_is_what_names_litexcnc_exports() {
    let scheme = Scheme::LitexCnc(vec!["test".to_owned()]);
    compare(&scheme, "test.", 4, "NAME.");
    let own = Scheme::LitexCnc(Vec::new());
    let hal = export(Some(&own));
    assert!(
        hal.aliases()
            .any(|(name, _, _)| name == "mill6.watchdog.reset")
    );
}

/// The two names are those of one pin.
fn is_one_pin(hal: &FakeHal, theirs: &str, ours: &str) {
    for level in [true, false] {
        hal.set(theirs, level);
        assert_eq!(hal.get::<bool>(ours), level, "{theirs} is {ours}");
    }
}

/// What a HAL file calls ours: the words that begin with `prefix`.
fn words<'f>(file: &'f str, prefix: &str) -> Vec<&'f str> {
    file.lines()
        .filter_map(|line| line.split('#').next())
        .flat_map(str::split_whitespace)
        .filter(|word| word.starts_with(prefix))
        .collect()
}

/// LiteX-CNC's configuration of the board the example's HAL file is for.
const THEIRS: &str = include_str!("../examples/peers/litexcnc.json");

/// A board made of an import of it.
fn imported() -> (FakeBoard, ferrocnc_config::Board) {
    let platforms = ferrocnc_config::source::Folder::default();
    let import = ferrocnc_config::import::litexcnc("litexcnc.json", THEIRS, "mill", &platforms);
    let board = import.unwrap().board;
    let fake = FakeBoard::of("127.0.0.1:0", board.channels(), Time::Lockstep(60_000));
    fake.look().described = Some(ferrocnc_config::blob::blob(&board).unwrap());
    (fake, board)
}

#[test]
fn an_imported_board_has_every_pin_of_litexcncs_row_under_the_number_it_had_there() {
    let (fake, board) = imported();
    let mut hal = FakeHal::new();
    let (driver, identity) = load_with(&fake, &mut hal, 0);
    let scheme = Scheme::LitexCnc(vec!["test".to_owned()]);
    assert_eq!(scheme.check(0, &identity), Ok(()));
    let _glue = names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
    let theirs: serde_json::Value = serde_json::from_str(THEIRS).unwrap();
    let row = theirs["modules"][0]["instances"].as_array().unwrap();
    for (number, instance) in row.iter().enumerate() {
        let (class, pin) = match instance["direction"].as_str() {
            Some("in") => (Class::Input, "in"),
            _ => (Class::Output, "out"),
        };
        // The channel at the pin that the JSON names, whatever its number is here.
        let mut channels = board.of(class).iter();
        let ours = channels
            .find(|one| one.pin("pin") == instance["pin"].as_str())
            .unwrap();
        let ours = format!("ferrocnc.0.gpio.{}.{pin}", ours.name);
        is_one_pin(&hal, &format!("test.gpio.{number:02}.{pin}"), &ours);
    }
    let known: BTreeSet<&str> = hal
        .list()
        .chain(hal.aliases())
        .map(|(name, _, _)| name)
        .collect();
    let file = include_str!("../examples/peers/litexcnc.hal");
    for name in words(file, "test.") {
        assert!(
            ["test.read", "test.write"].contains(&name) || known.contains(name),
            "{name}"
        );
    }
    // What had no number there has none here: the e-stop and the watchdog's pin.
    let numbered = known.iter().filter(|name| {
        name.starts_with("test.gpio.") && (name.ends_with(".in") || name.ends_with(".out"))
    });
    assert_eq!(numbered.count(), row.len());
}

#[test]
fn a_board_that_mixes_inputs_and_outputs_and_does_not_say_their_row_is_refused_in_words() {
    let scheme = Scheme::LitexCnc(vec!["test".to_owned()]);
    let told = |fake: &FakeBoard| {
        let mut hal = FakeHal::new();
        let (driver, identity) = load_with(fake, &mut hal, 0);
        let told = scheme
            .check(0, &identity)
            .map_err(|error| error.to_string());
        // A driver that does not check exports none rather than wrong ones.
        if told.is_err() {
            names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
            assert!(
                !hal.aliases()
                    .any(|(name, _, _)| name.starts_with("test.gpio."))
            );
        }
        told
    };
    let said = told(&FakeBoard::saying(&[])).unwrap_err();
    for part in [
        "test",
        "one row",
        "wrong outputs",
        "config import litexcnc",
        "litexcnc = NUMBER",
    ] {
        assert!(said.contains(part), "{part} is not in: {said}");
    }
    assert!(
        told(&FakeBoard::saying(&[(8, 0, "ogpio=128")]))
            .unwrap_err()
            .contains("128")
    );
    let twice = FakeBoard::saying(&[(8, 0, "ogpio=3"), (8, 4, "igpio=3")]);
    assert!(told(&twice).unwrap_err().contains("the number 3 to two"));
    // With outputs alone both count alike, unless the watchdog's pin was put in front of them.
    let outputs = wire::describe::Channels {
        stepgens: 3,
        encoders: 1,
        pwms: 1,
        inputs: 0,
        outputs: 7,
    };
    let alone = FakeBoard::of("127.0.0.1:0", outputs, Time::Lockstep(60_000));
    assert_eq!(told(&alone), Ok(()));
    let led = FakeBoard::of("127.0.0.1:0", outputs, Time::Lockstep(60_000));
    for (kind, channel, name) in &mut led.look().names {
        if (*kind, *channel) == (7, 0) {
            "watchdog".clone_into(name);
        }
    }
    assert!(told(&led).is_err());
    // Lcnc counts as we do.
    let mut hal = FakeHal::new();
    let (_, identity) = load_with(&FakeBoard::saying(&[]), &mut hal, 0);
    assert_eq!(Scheme::Lcnc.check(0, &identity), Ok(()));
}

#[test]
fn the_names_before_litexcnc_1_2_show_what_the_newer_ones_do() {
    let mut rig = Rig::named(&Scheme::LitexCnc(vec!["test".to_owned()]));
    rig.hal.set("test.stepgen.00.position-scale", 100.0);
    rig.hal.set("test.stepgen.00.max-acceleration", 5000.0);
    rig.arm();
    rig.hal.set("test.stepgen.00.enable", true);
    rig.hal.set("test.stepgen.00.velocity-mode", true);
    rig.hal.set("test.stepgen.00.velocity-cmd", 20.0);
    rig.run(50);
    for (old, new) in [
        ("position_fb", "position-feedback"),
        ("speed_fb", "velocity-feedback"),
        ("position_prediction", "position-prediction"),
        ("speed_prediction", "velocity-prediction"),
    ] {
        let value = |pin: &str| rig.hal.get::<f64>(&format!("test.stepgen.00.{pin}"));
        assert_eq!(value(old), value(new), "{old}");
        assert!(value(old) > 0.0, "{old} is {}", value(old));
    }
}

#[test]
fn a_channel_with_a_name_in_litexcnc_is_called_by_it_as_it_is_written_and_others_by_their_number() {
    let names: &[(u8, u8, &str)] = &[
        (8, 0, "sas=J1:10_Left"),
        (8, 1, "sas="),
        (8, 5, "eas=Spindle_Encoder"),
        (8, 0, "pas=24V"),
        (8, 0, "iigpio=1 as=j8:2"),
        (8, 0, "ogpio=0 as=Drive"),
    ];
    // The entries of inputs and outputs begin with their letter.
    let said: Vec<_> = MILL6_ROW[2..]
        .iter()
        .chain(names)
        .map(|(kind, channel, text)| (*kind, *channel, text.replace("iigpio", "igpio")))
        .collect();
    let said: Vec<_> = said.iter().map(|(k, c, text)| (*k, *c, &**text)).collect();
    let board = FakeBoard::saying(&said);
    let mut hal = FakeHal::new();
    let (driver, identity) = load_with(&board, &mut hal, 0);
    let scheme = Scheme::LitexCncNamed(vec!["test".to_owned()]);
    assert_eq!(scheme.check(0, &identity), Ok(()));
    let _glue = names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
    for (theirs, ours) in [
        ("stepgen.J1:10_Left.enable", "stepgen.x.enable"),
        ("stepgen.y.enable", "stepgen.y.enable"),
        ("stepgen.02.enable", "stepgen.z.enable"),
        ("gpio.j8:2.in", "gpio.limit-x.in"),
        ("gpio.Drive.out", "gpio.drive-enable.out"),
        ("gpio.02.out", "gpio.spindle-on.out"),
        (
            "encoder.Spindle_Encoder.index-enable",
            "encoder.spindle.index-enable",
        ),
        ("pwm.24V.enable", "pwm.spindle.enable"),
    ] {
        let ours = format!("ferrocnc.0.{ours}");
        is_one_pin(&hal, &format!("test.{theirs}"), &ours);
    }
    // Pins of its own, too, and no other name beside it.
    let known: BTreeSet<&str> = hal
        .list()
        .chain(hal.aliases())
        .map(|(name, _, _)| name)
        .collect();
    assert!(known.contains("test.stepgen.J1:10_Left.counts"));
    assert!(
        !known
            .iter()
            .any(|name| name.starts_with("test.stepgen.00."))
    );
    // By number, as the driver of 1.3 has them, with the other word.
    let board = FakeBoard::saying(&said);
    let mut hal = FakeHal::new();
    let (driver, identity) = load_with(&board, &mut hal, 0);
    let scheme = Scheme::LitexCnc(vec!["test".to_owned()]);
    let _glue = names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
    let known: BTreeSet<&str> = hal
        .list()
        .chain(hal.aliases())
        .map(|(name, _, _)| name)
        .collect();
    assert!(known.contains("test.stepgen.00.counts"));
    assert!(!known.iter().any(|name| name.contains("J1:10_Left")));
}

#[test]
fn a_name_of_litexcnc_that_hal_cannot_have_is_refused_when_the_board_is_loaded() {
    let refused = |texts: &[&str], prefix: &str| {
        let more: Vec<_> = texts
            .iter()
            .zip(0..)
            .map(|(text, n)| (8, n, *text))
            .chain(MILL6_ROW.iter().copied())
            .collect();
        let board = FakeBoard::saying(&more);
        let mut hal = FakeHal::new();
        let (driver, identity) = load_with(&board, &mut hal, 0);
        let scheme = Scheme::LitexCncNamed(vec![prefix.to_owned()]);
        let said = scheme.check(0, &identity).unwrap_err().to_string();
        let checked = names::export(&scheme, &mut hal, 0, &identity, &driver);
        (said, checked.is_ok())
    };
    let (said, exported) = refused(
        &["sas=torch height\u{e4}".replace(' ', "\u{a0}").as_str()],
        "test",
    );
    assert!(said.contains("no HAL file") && exported, "{said}");
    let (said, _) = refused(&["sas=Y", "sas=Y"], "test");
    assert!(said.contains("two channels \"Y\""), "{said}");
    let (said, _) = refused(&["sas=torch-height"], "plasma2");
    for part in [
        "plasma2.stepgen.torch-height.position-prediction has 48",
        "47",
        "names=litexcnc-named:NAME",
    ] {
        assert!(said.contains(part), "{part:?} is not in {said:?}");
    }
}

#[test]
fn every_pin_the_example_files_name_exists() {
    let mill = include_str!("../examples/mill/mill.hal");
    for (scheme, prefix, functions, file) in [
        (None, "ferrocnc.0.", &["read", "write"][..], mill),
        (
            Some(Scheme::Lcnc),
            "Lcnc.00.",
            &["update"],
            include_str!("../examples/peers/lcnc.hal"),
        ),
    ] {
        let hal = export(scheme.as_ref());
        let known: BTreeSet<&str> = hal
            .list()
            .chain(hal.aliases())
            .map(|(name, _, _)| name)
            .collect();
        let used = words(file, prefix);
        assert!(used.len() > 40, "{prefix}: {}", used.len());
        for name in used {
            let function = name
                .strip_prefix(prefix)
                .is_some_and(|f| functions.contains(&f));
            assert!(function || known.contains(name), "{name}");
        }
    }
}
