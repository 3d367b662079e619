//! The driver, the tool and other drivers' names on a board whose pins are configured: inputs and
//! outputs have the numbers of their pins, and only those of the board file are there.

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod tool;

use common::rig::{LOCKSTEP, Rig, load_with};
use common::{EIGHT, FakeBoard};
use ferrocnc::client::Client;
use ferrocnc::hal::fake::FakeHal;
use ferrocnc::names::{self, Scheme};
use ferrocnc_config::Board;
use ferrocnc_config::pins::configuration;
use ferrocnc_config::source::Folder;
use tool::{answer, complaint};
use wire::map;
use wire::pins::Verdict;

const MILL6: &str = include_str!("../../boards/mill6.toml");
// Lines of mill6: j8 begins at 42, j4 at 18, the shared lines at 48.
const LIMIT_X: u32 = 44;
const PROBE: u32 = 50;
const DRIVE_ENABLE: u32 = 18;
const BRAKE: u32 = 23;

/// A board that has this board file.
fn board(text: &str) -> FakeBoard {
    let wanted = Board::read("mill6.toml", "mill6", text, &Folder::default()).unwrap();
    let bytes = configuration(&wanted, text, EIGHT, 1).unwrap();
    let board = FakeBoard::mill6(LOCKSTEP);
    {
        let mut mind = board.look();
        let start = mind.flash.layout().pins_copy(0).start as usize;
        mind.flash.bytes[start..start + bytes.len()].copy_from_slice(&bytes);
        mind.become_image(EIGHT, "5a-75b-8.0");
        let verdict = mind.flash.pins.unwrap().verdict;
        assert_eq!(verdict, Verdict::InForce);
    }
    board
}

#[test]
fn inputs_and_outputs_have_their_names_and_the_bits_of_their_pins() {
    let mut rig = Rig::of(board(MILL6));
    let gpio: Vec<String> = { rig.hal.list() }
        .filter(|(name, ..)| name.starts_with("ferrocnc.0.gpio."))
        .filter(|(name, ..)| name.ends_with(".in") || name.ends_with(".out"))
        .map(|(name, ..)| name.to_owned())
        .collect();
    assert_eq!(gpio.len(), 12 + 12, "{gpio:?}");
    rig.arm();
    for (name, line) in [("limit-x", LIMIT_X), ("probe", PROBE)] {
        let pin = format!("ferrocnc.0.gpio.{name}.in");
        for level in [true, false] {
            rig.board.look().knobs.gpio_in = if level { 1 << line } else { !(1 << line) };
            rig.run(2);
            assert_eq!(rig.hal.get::<bool>(&pin), level, "{name}");
        }
    }
    for (name, line) in [("drive-enable", DRIVE_ENABLE), ("brake", BRAKE)] {
        rig.hal.set(&format!("ferrocnc.0.gpio.{name}.out"), true);
        rig.run(2);
        assert_eq!(rig.board.look().command.gpio_out, 1 << line, "{name}");
        rig.hal.set(&format!("ferrocnc.0.gpio.{name}.out"), false);
    }
}

#[test]
fn debounce_safe_levels_and_polarity_reach_the_settings_of_the_pin() {
    let text = MILL6.replace(
        "name = \"brake\"\npin = \"j4:6\"\nsafe = \"low\"",
        "name = \"brake\"\npin = \"j4:6\"\nsafe = \"high\"",
    );
    let mut rig = Rig::of(board(&text));
    rig.hal
        .set("ferrocnc.0.gpio.limit-x.debounce-ns", 1_000_000u32);
    rig.hal.set("ferrocnc.0.gpio.drive-enable.invert", true);
    rig.run(60);
    let config = rig.board.look().config.clone();
    let board = |which: map::BoardConfig| config[&(map::CONFIG_BOARD + 4 * which as u32)];
    // Inverted behind the safe level, so that an inverted output rests low.
    let safe = 1 << BRAKE | 1 << DRIVE_ENABLE;
    assert_eq!(board(map::BoardConfig::GpioSafe), safe);
    assert_eq!(board(map::BoardConfig::GpioInvert), 1 << DRIVE_ENABLE);
    let looks = |line: u32| config[&(map::CONFIG_DEBOUNCE + 4 * line)];
    assert_eq!((looks(LIMIT_X), looks(PROBE)), (1875, 0));
}

#[test]
fn an_estop_input_has_the_bit_of_its_place_among_them() {
    // A second one on a line before the first one's, further down in the file.
    let text = MILL6.replace("pin = \"j8:6\"", "pin = \"j8:6\"\nestop = \"low\"");
    let mut rig = Rig::of(board(&text));
    let tripped = |rig: &Rig| {
        ["home-x", "estop"].map(|name| {
            rig.hal
                .get::<bool>(&format!("ferrocnc.0.gpio.{name}.estop"))
        })
    };
    assert_eq!(tripped(&rig), [false, false]);
    rig.board.look().knobs.estop = 1;
    rig.run(3);
    assert_eq!(tripped(&rig), [true, false]);
    rig.board.look().knobs.estop = 2;
    rig.run(3);
    assert_eq!(tripped(&rig), [true, true], "a latch stays");
}

#[test]
fn lcncs_names_are_numbered_in_the_order_of_the_board_file() {
    let board = board(MILL6);
    let mut hal = FakeHal::new();
    let (mut driver, identity) = load_with(&board, &mut hal, 0);
    let glue = names::export(&Scheme::Lcnc, &mut hal, 0, &identity, &driver).unwrap();
    driver.adopt(glue);
    hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    let mut rig = Rig { board, driver, hal };
    rig.connect();
    // `home-x` is the fourth input of the file and `spindle-on` its second output.
    rig.board.look().knobs.gpio_in = 1 << 47;
    rig.hal.set("Lcnc.00.output.01.out", true);
    rig.run(3);
    assert!(rig.hal.get::<bool>("Lcnc.00.input.03.in"));
    assert!(!rig.hal.get::<bool>("Lcnc.00.input.02.in"));
    assert_eq!(rig.board.look().command.gpio_out, 1 << 19);
}

#[test]
fn litexcncs_names_follow_its_row_and_its_estops() {
    let text = MILL6
        .replace("pin = \"j8:2\"", "pin = \"j8:2\"\nlitexcnc = 7")
        .replace("pin = \"j4:6\"", "pin = \"j4:6\"\nlitexcnc = 3");
    let board = board(&text);
    let mut hal = FakeHal::new();
    let (mut driver, identity) = load_with(&board, &mut hal, 0);
    let scheme = Scheme::LitexCnc(vec!["mill".to_owned()]);
    scheme.check(0, &identity).unwrap();
    let glue = names::export(&scheme, &mut hal, 0, &identity, &driver).unwrap();
    driver.adopt(glue);
    hal.set("ferrocnc.0.packet-read-timeout", 200_000_000);
    let mut rig = Rig { board, driver, hal };
    rig.connect();
    rig.board.look().knobs.gpio_in = 1 << LIMIT_X;
    rig.board.look().knobs.estop = 1;
    rig.hal.set("mill.gpio.03.out", true);
    rig.run(3);
    assert!(rig.hal.get::<bool>("mill.gpio.07.in"));
    assert!(rig.hal.get::<bool>("mill.watchdog.estop.00.fault-out"));
    assert_eq!(rig.board.look().command.gpio_out, 1 << BRAKE);
}

#[test]
fn the_tool_shows_what_the_board_file_has_and_what_became_of_it() {
    let board = board(MILL6);
    let at = board.text();
    let said = answer(&["describe", &at]);
    for part in [
        "pins       configured by",
        "44  limit-x",
        "18  drive-enable",
        "55  estop",
    ] {
        assert!(said.contains(part), "{part} is not in\n{said}");
    }
    board.look().knobs.gpio_in = 1 << PROBE;
    let json = answer(&["watch", "--once", "--json", &at]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let inputs = json["input"].as_array().unwrap();
    assert_eq!(inputs.len(), 12);
    assert_eq!(inputs[0]["name"], "limit-x");
    let said = complaint(&["selftest", &at, "--loop", "output.0=limit-x", "--yes"]);
    assert!(said.contains("\"output.0\" is no"), "{said}");
    board.look().pins.as_mut().unwrap().factory = true;
    board.look().power_cycle();
    let said = answer(&["describe", &at]);
    assert!(said.contains("nothing is driven"), "{said}");
    assert!(said.contains("release the factory pin"), "{said}");
    let json = answer(&["describe", "--json", &at]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["pins"], Verdict::FactoryPin.text());
    assert_eq!(json["input"].as_array().unwrap().len(), 0);
}

#[test]
fn a_board_whose_file_is_none_for_its_image_is_refused_when_the_driver_is_loaded() {
    let board = board(MILL6);
    board.look().pins.as_mut().unwrap().built.stepgens = 4;
    board.look().power_cycle();
    let address = ferrocnc::address::parse(&board.text(), wire::DEFAULT_PORT).unwrap();
    let mut client = Client::open(&address).unwrap();
    let identity = client.identify().unwrap();
    let why = client.check(&identity).unwrap_err().to_string();
    assert!(why.contains("ferrocnc config apply"), "{why}");
    let report = std::env::temp_dir().join(format!("configured-{}.json", std::process::id()));
    let report = report.to_str().unwrap();
    complaint(&["doctor", &board.text(), "--report", report]);
    let said = std::fs::read_to_string(report).unwrap();
    std::fs::remove_file(report).unwrap();
    assert!(said.contains("does not arm"), "{said}");
}
