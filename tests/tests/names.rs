//! A name in a board file is the same in the board's description, in HAL and in the drawing.
//!
//! The board file is read by its one reader; the board is a twin that knows only the blob made from
//! it.

use std::path::{Path, PathBuf};
use std::process::Command;

use ferrocnc_config::{Class, read_board};
use ferrocnc_tests::{Simulator, program};
use host::client::Client;
use host::driver::Driver;
use host::hal::fake::FakeHal;
use host::link::Link;
use serde_json::Value;

/// Boards the twin knows without any elaboration.
const BOARDS: [&str; 2] = ["mill6", "75b_v8_14o11i6s6e6p"];

fn board_file(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    root.join("boards").join(format!("{name}.toml"))
}

fn ferrocnc(arguments: &[&str]) -> String {
    let mut tool = Command::new(program("ferrocnc"));
    let said = tool.args(arguments).output().expect("ferrocnc runs");
    let why = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.status.success(), "ferrocnc {arguments:?}: {why}");
    String::from_utf8_lossy(&said.stdout).into_owned()
}

/// Every pin that HAL gets.
fn hal_pins(address: &str) -> Vec<String> {
    let address = host::address::parse(address, wire::DEFAULT_PORT).expect("an address");
    let mut client = Client::open(&address).expect("a socket");
    let identity = client.identify().expect("a board");
    client.acquire().expect("the session");
    let link = Link::new(client.into_socket()).expect("a link");
    let mut hal = FakeHal::new();
    let say = hal.messenger();
    let driver = Driver::export(&mut hal, 0, address, &identity, link, say);
    let _driver = driver.expect("pins");
    hal.list().map(|(name, _, _)| name.to_owned()).collect()
}

#[test]
fn describe_hal_and_pinout_show_the_names_of_the_board_file() {
    let mut channels = 0;
    for name in BOARDS {
        let file = board_file(name);
        let board = read_board(&file).unwrap_or_else(|error| panic!("{error}"));
        let twin = Simulator::twin_of(name, &["--mode", "free"]);
        let address = twin.udp().to_string();
        let described: Value = serde_json::from_str(&ferrocnc(&["--json", "describe", &address]))
            .expect("JSON of describe");
        let hal = hal_pins(&address);
        let file = file.display().to_string();
        let drawing = ferrocnc(&["config", "pinout", "--color", "never", &file]);
        let shown = ferrocnc(&["config", "show", &file]);
        assert_eq!(described["configuration"], *board.name);

        for (class, channels_of) in Class::ALL.into_iter().zip(&board.channels) {
            let key = match class {
                Class::Stepgen => "stepgen",
                Class::Encoder => "encoder",
                Class::Pwm => "pwm",
                Class::Input => "input",
                Class::Output => "output",
            };
            let told = described[key].as_array().expect("a list of channels");
            assert_eq!(told.len(), channels_of.len(), "{name}: {key}");
            for (channel, told) in channels_of.iter().zip(told) {
                channels += 1;
                assert_eq!(told["name"], *channel.name, "{name}: {key}");
                let pins = told["pins"].as_str().expect("pins");
                let prefix = format!("ferrocnc.0.{}.{}.", class.hal().class, channel.name);
                assert!(
                    hal.iter().any(|pin| pin.starts_with(&prefix)),
                    "{name}: HAL has no {prefix}*"
                );
                for (what, pin) in &channel.pins {
                    let here = format!("{what}={pin}");
                    assert!(
                        pins.split(' ').any(|told| told == here),
                        "{name}: {here} is not among {pins:?}"
                    );
                    // In one line of the drawing, and of the list.
                    for (page, text) in [("pinout", &drawing), ("show", &shown)] {
                        let line = text.lines().find(|line| {
                            let has = |word: &str| {
                                let mut words = line.split([' ', '.', '(', ')']);
                                words.any(|there| there == word)
                            };
                            has(pin) && has(&channel.name)
                        });
                        assert!(
                            line.is_some(),
                            "{name}: {page} shows no {} at {pin}\n{text}",
                            channel.name
                        );
                    }
                }
            }
        }
    }
    println!("{channels} channels of {} boards", BOARDS.len());
}
