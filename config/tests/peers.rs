//! The way back: board files as configurations of other projects. What is imported and written
//! again imports as the same board; what cannot be said is refused by its key.

use ferrocnc_config::board::Class;
use ferrocnc_config::error::Error;
use ferrocnc_config::import;
use ferrocnc_config::peers::{Written, lcnc, litexcnc};
use ferrocnc_config::source::Folder;
use ferrocnc_config::{Board, read_board, write};
use std::path::Path;

const ROUTER: &str = include_str!("samples/router.ini");
const LATHE: &str = include_str!("samples/lathe.json");
const SIX_AXIS: &str = include_str!("samples/six_axis.json");
const PLASMA: &str = include_str!("samples/plasma.json");
const MILL: &str = include_str!("../../host/examples/peers/litexcnc.json");

fn from_ini(text: &str, name: &str) -> Board {
    let import = import::lcnc("x.ini", text, name, &Folder::default());
    import
        .unwrap_or_else(|error| panic!("{error}\n{text}"))
        .board
}

fn from_json(text: &str) -> Board {
    let import = import::litexcnc("x.json", text, "mill", &Folder::default());
    import
        .unwrap_or_else(|error| panic!("{error}\n{text}"))
        .board
}

fn text(written: Result<Written, Vec<Error>>) -> String {
    written.unwrap_or_else(|all| panic!("{all:#?}")).text
}

fn toml(board: &Board) -> String {
    write::to_toml(board, &[])
}

/// A board file of the checkout.
fn ours(name: &str) -> Board {
    let boards = Path::new(env!("CARGO_MANIFEST_DIR")).join("../boards");
    read_board(&boards.join(format!("{name}.toml"))).unwrap()
}

#[test]
fn an_ini_of_lcnc_comes_back_as_the_same_board() {
    let board = from_ini(ROUTER, "router");
    let written = text(lcnc(&board));
    assert_eq!(toml(&from_ini(&written, "router")), toml(&board));
    // And as the same file, but for its comment.
    let bare = |text: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| !line.is_empty());
        lines
            .filter(|line| !line.starts_with(';'))
            .map(str::to_owned)
            .collect()
    };
    assert_eq!(bare(&written), bare(ROUTER));
}

#[test]
fn lcncs_eight_boards_come_back_from_its_ini_with_their_pins() {
    for name in [
        "75b_v6_14o11i6s6e6p",
        "75b_v6_26o23i6p",
        "75b_v7_14o11i6s6e6p",
        "75b_v7_26o23i6p",
        "75b_v8_14o11i6s6e6p",
        "75b_v8_26o23i6p",
        "75e_v6_v8_30o29i9s9e8p",
        "75e_v7_30o29i9s9e8p",
    ] {
        let board = ours(name);
        let again = from_ini(&text(lcnc(&board)), name);
        assert_eq!(again.channels, board.channels, "{name}");
        assert_eq!(again.ext_reset, board.ext_reset, "{name}");
        assert_eq!(again.platform.name, board.platform.name, "{name}");
        assert_eq!(again.mac, Some([0x10, 0xe2, 0xd5, 0, 0, 0]), "{name}");
        let notes = lcnc(&board).unwrap().notes;
        assert!(notes.iter().any(|note| note.contains("MAC")), "{notes:?}");
    }
}

#[test]
fn a_json_of_litexcnc_comes_back_as_the_same_board() {
    for theirs in [SIX_AXIS, PLASMA, MILL, LATHE] {
        let mut board = from_json(theirs);
        // A name that no HAL file can contain comes back as ours of it.
        for class in Class::ALL {
            for channel in &mut board.channels[class as usize] {
                let (prefix, number) = channel.name.rsplit_once('-').unwrap_or_default();
                let numbered = ["sg", "enc", "pwm", "in", "out"].contains(&prefix);
                let numbered = numbered && number.len() == 2;
                let gpio = matches!(class, Class::Input | Class::Output);
                if !numbered && (!gpio || channel.litexcnc.is_some()) {
                    channel.litexcnc_name.get_or_insert(channel.name.clone());
                }
            }
        }
        let written = text(litexcnc(&board));
        assert_eq!(toml(&from_json(&written)), toml(&board));
    }
}

#[test]
fn a_board_of_ours_without_numbers_becomes_one_row_of_inputs_and_outputs() {
    let mut board = ours("75b_v8_14o11i6s6e6p");
    board.ext_reset.pin = None;
    board.name = "mill".to_owned();
    let again = from_json(&text(litexcnc(&board)));
    let inputs = board.of(Class::Input).len();
    for class in Class::ALL {
        for (n, (new, old)) in again.of(class).iter().zip(board.of(class)).enumerate() {
            assert_eq!((&new.name, &new.pins), (&old.name, &old.pins));
            let number = match class {
                Class::Input => Some(n as u8),
                Class::Output => Some((inputs + n) as u8),
                Class::Stepgen | Class::Encoder | Class::Pwm => None,
            };
            assert_eq!(new.litexcnc, number);
        }
        assert_eq!(again.of(class).len(), board.of(class).len());
    }
}

/// A change of a board, the key that is refused for it, and what else is said.
type Change = (fn(&mut Board), &'static str, &'static [&'static str]);

fn refusals(written: Result<Written, Vec<Error>>, changes: &[&Change], theirs: &str) {
    let all = written.unwrap_err();
    let said: Vec<String> = all.iter().map(Error::to_string).collect();
    for (_, key, parts) in changes {
        let of_key = all.iter().position(|error| error.key == *key);
        let said = &said[of_key.unwrap_or_else(|| panic!("{key} is not in {said:#?}"))];
        for part in parts.iter().chain(&[theirs]) {
            assert!(said.contains(part), "{part:?} is not in {said:?}");
        }
    }
    assert_eq!(all.len(), changes.len(), "{said:#?}");
}

#[test]
fn what_lcnc_cannot_say_is_refused_by_its_key_and_all_of_it_at_once() {
    let changes: [Change; 16] = [
        (
            |b| b.platform.name = "5a-75x".to_owned(),
            "platform",
            &["5a-75x", "5a-75b-8.0"],
        ),
        (|b| b.ext_reset.pin = None, "ext_reset.pin", &["reset pin"]),
        (|b| b.jobs = 3, "jobs", &["without a PC"]),
        (
            |b| set(b, Class::Stepgen, 0).kind = "up_down".to_owned(),
            "stepgen[0].type",
            &["up_down", "step_dir"],
        ),
        (
            |b| add(b, Class::Stepgen, 1, "step_n"),
            "stepgen[1].step_n",
            &["j16:0"],
        ),
        (
            |b| add(b, Class::Stepgen, 2, "index"),
            "stepgen[2].index",
            &["take it away"],
        ),
        (
            |b| set(b, Class::Encoder, 0).kind = "counter".to_owned(),
            "encoder[0].type",
            &["counter"],
        ),
        (
            |b| add(b, Class::Encoder, 1, "mask"),
            "encoder[1].mask",
            &["j16:0"],
        ),
        (|b| many(b, Class::Pwm, 16), "pwm", &["16", "at most 15"]),
        (|b| add(b, Class::Pwm, 0, "dir"), "pwm[0].dir", &["j16:0"]),
        (
            |b| set(b, Class::Input, 0).estop = Some(ferrocnc_config::Level::High),
            "gpio_in[0].estop",
            &["reset_in"],
        ),
        (
            |b| set(b, Class::Input, 1).pins[0].1 = "key".to_owned(),
            "gpio_in[1]",
            &["key", "header"],
        ),
        (
            |b| set(b, Class::Input, 2).pins.clear(),
            "gpio_in[2]",
            &["no pins"],
        ),
        (
            |b| set(b, Class::Output, 0).safe = Some(ferrocnc_config::Level::High),
            "gpio_out[0].safe",
            &["low while"],
        ),
        (
            |b| set(b, Class::Output, 1).invert = true,
            "gpio_out[1].invert",
            &["output.NN.inv"],
        ),
        (
            |b| many(b, Class::Output, 32),
            "gpio_out",
            &["32", "at most 31"],
        ),
    ];
    let board = from_ini(ROUTER, "router");
    let mut all = board.clone();
    for change in &changes {
        let mut one = board.clone();
        change.0(&mut one);
        refusals(lcnc(&one), &[change], "Lcnc");
        change.0(&mut all);
    }
    refusals(lcnc(&all), &changes.iter().collect::<Vec<_>>(), "Lcnc");
    let low: Change = (
        |b| b.ext_reset.active = ferrocnc_config::Level::Low,
        "ext_reset.active",
        &["high or open"],
    );
    let key: Change = (
        |b| b.ext_reset.pin = Some("key".to_owned()),
        "ext_reset.pin",
        &["headers only"],
    );
    for change in [low, key] {
        let mut one = board.clone();
        change.0(&mut one);
        refusals(lcnc(&one), &[&change], "Lcnc");
    }
}

#[test]
fn what_litexcnc_cannot_say_is_refused_by_its_key_and_all_of_it_at_once() {
    let changes: [Change; 18] = [
        (
            |b| b.platform.name = "5a-75b-8.2".to_owned(),
            "platform",
            &["5a-75b-8.2", "5a-75b-8.0"],
        ),
        (|b| b.name = "mi.ll".to_owned(), "name", &["at most 15"]),
        (
            |b| b.ext_reset.pin = Some("j7:2".to_owned()),
            "ext_reset.pin",
            &["j7:2", "estop"],
        ),
        (|b| b.phy = 1, "phy", &["first jack"]),
        (|b| b.udp_port = 4321, "network.udp_port", &["1234"]),
        (|b| b.jobs = 3, "jobs", &["without a PC"]),
        (
            |b| {
                set(b, Class::Stepgen, 0)
                    .pins
                    .retain(|(key, _)| *key != "dir_n")
            },
            "stepgen[0].dir_n",
            &["both"],
        ),
        (
            |b| set(b, Class::Stepgen, 1).kind = "quadrature".to_owned(),
            "stepgen[1].type",
            &["quadrature", "step_dir"],
        ),
        (
            |b| set(b, Class::Stepgen, 1).litexcnc_name = Some("a-name-of-18-chars".to_owned()),
            "stepgen[1].name",
            &["47", "shorten"],
        ),
        (
            |b| add(b, Class::Encoder, 0, "index"),
            "encoder[0].index",
            &["counters"],
        ),
        (
            |b| add(b, Class::Encoder, 1, "mask"),
            "encoder[1].mask",
            &["j16:0"],
        ),
        (
            |b| set(b, Class::Encoder, 1).pins[0].1 = "key".to_owned(),
            "encoder[1].a",
            &["button"],
        ),
        (
            |b| set(b, Class::Pwm, 0).kind = "pdm".to_owned(),
            "pwm[0].type",
            &["pdm", "up_down"],
        ),
        (
            |b| set(b, Class::Input, 0).litexcnc = Some(9),
            "gpio_in[0].litexcnc",
            &["e-stops"],
        ),
        (
            |b| set(b, Class::Input, 3).litexcnc = Some(5),
            "gpio_in[3].litexcnc",
            &["5", "would be 1"],
        ),
        (
            |b| set(b, Class::Input, 2).pins.clear(),
            "gpio_in[2]",
            &["no pins"],
        ),
        (
            |b| set(b, Class::Output, 0).invert = false,
            "gpio_out[0].safe",
            &["inactive"],
        ),
        (
            |b| {
                many(b, Class::Output, 3);
                set(b, Class::Output, 2).invert = true;
            },
            "gpio_out[2].invert",
            &["gpio.NN.invert-output"],
        ),
    ];
    let board = from_json(PLASMA);
    let mut all = board.clone();
    for change in &changes {
        let mut one = board.clone();
        change.0(&mut one);
        refusals(litexcnc(&one), &[change], "LiteX-CNC");
        change.0(&mut all);
    }
    refusals(
        litexcnc(&all),
        &changes.iter().collect::<Vec<_>>(),
        "LiteX-CNC",
    );
}

fn set(board: &mut Board, class: Class, n: usize) -> &mut ferrocnc_config::Channel {
    &mut board.channels[class as usize][n]
}

fn add(board: &mut Board, class: Class, n: usize, key: &'static str) {
    set(board, class, n).pins.push((key, "j16:0".to_owned()));
}

/// As many channels of a class, the last one again and again.
fn many(board: &mut Board, class: Class, count: usize) {
    let channels = &mut board.channels[class as usize];
    let mut last = channels.last().unwrap().clone();
    (last.invert, last.name) = (false, "more".to_owned());
    channels.resize(count, last);
}
