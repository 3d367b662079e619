//! Imports of other projects' configurations: the results, and that nothing is lost.

use ferrocnc_config::board::Class;
use ferrocnc_config::import::{Imported, lcnc, litexcnc};
use ferrocnc_config::pinout::Pinout;
use ferrocnc_config::source::Folder;
use ferrocnc_config::{Board, Level, show, write};

const ROUTER: &str = include_str!("samples/router.ini");
const LATHE: &str = include_str!("samples/lathe.json");
const SIX_AXIS: &str = include_str!("samples/six_axis.json");
const PLASMA: &str = include_str!("samples/plasma.json");

fn ini(text: &str) -> Result<Imported, String> {
    lcnc("router.ini", text, "router", &Folder::default()).map_err(|error| error.to_string())
}

fn json(text: &str) -> Result<Imported, String> {
    litexcnc("mill.json", text, "mill", &Folder::default()).map_err(|error| error.to_string())
}

fn all() -> [(&'static str, Imported); 4] {
    [
        (ROUTER, ini(ROUTER).unwrap()),
        (LATHE, json(LATHE).unwrap()),
        (SIX_AXIS, json(SIX_AXIS).unwrap()),
        (PLASMA, json(PLASMA).unwrap()),
    ]
}

/// Every pin a file names: `j`, digits, a colon, digits, or the button.
fn pins_of(text: &str) -> Vec<String> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == ':' || c == '_'));
    let is_pin = |word: &&str| {
        let parts = word.strip_prefix('j').and_then(|rest| rest.split_once(':'));
        parts.is_some_and(|(header, pin)| header.parse::<u8>().is_ok() && pin.parse::<u8>().is_ok())
    };
    let mut pins: Vec<String> = words.filter(is_pin).map(str::to_owned).collect();
    pins.sort();
    pins
}

fn pins_of_board(board: &Board) -> Vec<String> {
    let channels = board
        .channels
        .iter()
        .flatten()
        .flat_map(|channel| &channel.pins);
    let mut pins: Vec<String> = channels
        .map(|(_, pin)| pin.clone())
        .chain(board.ext_reset.pin.clone())
        .collect();
    pins.sort();
    pins
}

#[test]
fn no_pin_is_lost_through_import_toml_and_show() {
    for (theirs, imported) in all() {
        // A name of theirs may be a pin's, so names do not count.
        let without_names: String = theirs
            .lines()
            .filter(|line| !line.contains("\"name\": \"j"))
            .collect::<Vec<_>>()
            .join("\n");
        let mut wanted = pins_of(&without_names);
        if theirs.contains("user_btn") {
            wanted.push("key".to_owned());
            wanted.sort();
        }
        assert_eq!(pins_of_board(&imported.board), wanted);
        let again = Board::read(
            "again.toml",
            &imported.board.name,
            &imported.toml,
            &Folder::default(),
        )
        .unwrap();
        assert_eq!(again.channels, imported.board.channels);
        assert_eq!(
            write::to_toml(&again, &[]),
            write::to_toml(&imported.board, &[])
        );
        let shown = show::show(&again);
        for pin in &wanted {
            assert!(
                shown.contains(&format!("{pin} (")),
                "{pin} is not in\n{shown}"
            );
        }
        let drawn = Pinout::of_board(&again);
        let named = drawn
            .headers
            .iter()
            .flat_map(|header| &header.pins)
            .filter(|pin| !pin.label.is_empty() && pin.label != "GND" && pin.same_as.is_none());
        assert_eq!(
            named.count(),
            wanted.iter().filter(|pin| *pin != "key").count(),
            "the drawing has every pin once by name"
        );
    }
}

#[test]
fn lcnc_keeps_numbers_address_and_reset() {
    let Imported { board, notes, .. } = ini(ROUTER).unwrap();
    assert_eq!(board.platform.name, "5a-75e-7.1");
    assert_eq!(
        (board.phy, board.ipv4, board.udp_port),
        (1, [10, 0, 7, 2], 4321)
    );
    assert_eq!(board.mac, Some([0x10, 0xe2, 0xd5, 0, 0, 0x11]));
    assert_eq!(board.ext_reset.pin.as_deref(), Some("j4:6"));
    assert_eq!(board.ext_reset.active, Level::High);
    assert_eq!(board.modified.bus_switch, ["j2", "j3", "j4"]);
    let outputs: Vec<_> = board
        .of(Class::Output)
        .iter()
        .map(|c| (c.name.as_str(), c.pin("pin").unwrap()))
        .collect();
    assert_eq!(
        outputs,
        [
            ("out-00", "j9:0"),
            ("out-01", "j9:4"),
            ("out-02", "j9:7"),
            ("out-03", "j9:14")
        ]
    );
    assert!(
        board
            .of(Class::Output)
            .iter()
            .all(|c| c.safe == Some(Level::Low) && !c.invert)
    );
    assert!(
        notes.iter().any(|note| note.contains("60 MHz, not 40 MHz")),
        "{notes:?}"
    );
}

#[test]
fn the_older_litexcnc_keeps_names_safe_states_and_the_watchdogs_pin() {
    let Imported { board, notes, .. } = json(LATHE).unwrap();
    assert_eq!(
        (board.platform.name.as_str(), board.ipv4),
        ("5a-75e-6.0", [10, 0, 0, 20])
    );
    let outputs: Vec<_> = board
        .of(Class::Output)
        .iter()
        .map(|c| (c.name.as_str(), c.pin("pin").unwrap(), c.safe.unwrap()))
        .collect();
    assert_eq!(
        outputs,
        [
            ("watchdog", "j12:0", Level::Low),
            ("out-01", "j15:1", Level::Low),
            ("coolant-pump", "j15:5", Level::High)
        ]
    );
    assert_eq!(board.of(Class::Input)[0].name, "chuck-closed");
    assert!(
        notes
            .iter()
            .any(|note| note.contains("chuck closed") && note.contains("chuck-closed")),
        "{notes:?}"
    );
    assert_eq!(board.of(Class::Encoder)[0].pin("index"), Some("j3:2"));
    assert!(
        notes.iter().any(|note| note.contains("ferrocnc.0.enabled")),
        "{notes:?}"
    );
}

#[test]
fn the_newer_litexcnc_keeps_types_estops_and_the_index() {
    let Imported { board, notes, .. } = json(PLASMA).unwrap();
    let stepgen = &board.of(Class::Stepgen)[0];
    assert_eq!(
        stepgen.text(Class::Stepgen),
        "step=j3:0 step_n=j3:1 dir=j3:2 dir_n=j3:4 index=j7:1 as="
    );
    assert_eq!(
        board.of(Class::Stepgen)[1].name,
        "torch-h",
        "HAL has room for seven"
    );
    let pwms: Vec<_> = board
        .of(Class::Pwm)
        .iter()
        .map(|c| c.text(Class::Pwm))
        .collect();
    assert_eq!(
        pwms,
        [
            "pin=j1:2",
            "pin=j1:4 dir=j1:5 as=",
            "pin=j2:0 dir=j2:1 type=up_down as="
        ]
    );
    let inputs: Vec<_> = board
        .of(Class::Input)
        .iter()
        .map(|c| (c.name.as_str(), c.estop))
        .collect();
    assert_eq!(
        inputs,
        [
            ("estop-front", Some(Level::High)),
            ("estop-01", Some(Level::Low)),
            ("button", None),
            ("in-03", None)
        ]
    );
    let enable = &board.of(Class::Output)[0];
    assert_eq!(
        (enable.safe, enable.invert),
        (Some(Level::High), true),
        "an inverted enable is high while disabled"
    );
    assert_eq!(board.of(Class::Encoder)[0].kind, "counter");
    assert_eq!(board.factory, None, "the button has another use");
    for part in [
        "tx_delay",
        "with_hw_init_reset",
        "heartbeat",
        "min_value",
        "max_value",
        "reset_value",
        "soft_stop",
        "torch-height",
        "factory",
        "external reset",
    ] {
        assert!(
            notes.iter().any(|note| note.contains(part)),
            "nothing said about {part}: {notes:#?}"
        );
    }
}

/// `PLASMA` with another name in the place of one it has.
fn renamed(old: &str, new: &str) -> String {
    let old = format!("\"name\": \"{old}\"");
    assert!(PLASMA.contains(&old), "{old}");
    PLASMA.replacen(&old, &format!("\"name\": {new:?}"), 1)
}

#[test]
fn the_manuals_spelling_of_instances_is_read_too_and_not_beside_the_other() {
    let spelt = PLASMA.replace("\"instances\"", "\"instance\"");
    assert_eq!(
        json(&spelt).unwrap().board.channels,
        json(PLASMA).unwrap().board.channels
    );
    let both = PLASMA.replacen("\"instances\"", "\"instance\": [], \"instances\"", 1);
    let said = json(&both).unwrap_err();
    assert!(
        said.contains("modules[0].instance: is there beside instances"),
        "{said}"
    );
    let none = PLASMA.replacen("\"instances\"", "\"instans\"", 1);
    let said = json(&none).unwrap_err();
    assert!(
        said.contains("modules[0].instans") && said.contains("did you mean instance"),
        "{said}"
    );
    let none = PLASMA.replacen(
        "\"modules\": [",
        "\"modules\": [ { \"module_type\": \"gpio\" },",
        1,
    );
    let said = json(&none).unwrap_err();
    assert!(said.contains("modules[0].instances: is missing"), "{said}");
}

#[test]
fn a_name_of_litexcnc_is_kept_as_it_is_written_beside_ours() {
    let kept = |text: &str, class: Class| -> Vec<(String, Option<String>)> {
        let Imported { board, toml, .. } = json(text).unwrap();
        let again = Board::read("x.toml", "mill", &toml, &Folder::default()).unwrap();
        assert_eq!(again.channels, board.channels, "the board file has them");
        let channels = board.of(class).iter();
        channels
            .map(|one| (one.name.clone(), one.litexcnc_name.clone()))
            .collect()
    };
    let pair = |ours: &str, theirs: Option<&str>| (ours.to_owned(), theirs.map(str::to_owned));
    assert_eq!(
        kept(PLASMA, Class::Stepgen),
        [pair("x", Some("x")), pair("torch-h", Some("torch-height"))]
    );
    let written = renamed("x", "J1:10_Left").replace("\"torch-height\"", "\"24V.z/a+\"");
    assert_eq!(
        kept(&written, Class::Stepgen),
        [
            pair("j1-10-l", Some("J1:10_Left")),
            pair("v-z-a", Some("24V.z/a+"))
        ]
    );
    // Without a name there is a number; an e-stop's is no channel's name there.
    assert_eq!(
        kept(PLASMA, Class::Input)[..2],
        [pair("estop-front", None), pair("estop-01", None)]
    );
    // The board says it, in few bytes where it is ours.
    let texts = |text: &str| -> Vec<String> {
        let board = json(text).unwrap().board;
        let channels = board.of(Class::Stepgen).iter();
        channels.map(|one| one.text(Class::Stepgen)).collect()
    };
    assert!(texts(PLASMA)[0].ends_with(" as="), "{:?}", texts(PLASMA));
    assert!(texts(PLASMA)[1].ends_with(" as=torch-height"));
}

#[test]
fn a_name_of_litexcnc_that_hal_cannot_have_is_refused_with_the_pin_that_would_be_too_long() {
    let long = "torch-height2";
    let said = json(&renamed("torch-height", long)).unwrap_err();
    for part in [
        "modules[3].instances[1].name",
        long,
        "47",
        "plasma.stepgen.torch-height2.position-prediction has 48",
        "shorten",
    ] {
        assert!(said.contains(part), "{part:?} is not in {said:?}");
    }
    let said = json(&renamed("torch-height", "07")).unwrap_err();
    assert!(
        said.contains("is a number") && said.contains("HAL file"),
        "{said}"
    );
    let said = json(&renamed("torch-height", "x")).unwrap_err();
    assert!(said.contains("already that of stepgen 0"), "{said}");
    // What no HAL file can contain keeps its number, and a note says so.
    let notes = json(&renamed("torch-height", "torch height"))
        .unwrap()
        .notes;
    let note = notes.iter().find(|note| note.contains("no HAL file"));
    assert!(note.unwrap().contains("\"torch height\""), "{notes:?}");
}

#[test]
fn the_row_of_inputs_and_outputs_keeps_its_numbers_and_the_watchdogs_pins_have_none() {
    for (name, text) in [("lathe", LATHE), ("plasma", PLASMA)] {
        let board = json(text).unwrap().board;
        let theirs: serde_json::Value = serde_json::from_str(text).unwrap();
        let modules = theirs["modules"].as_array().unwrap().iter();
        let row = modules
            .filter(|module| module["module_type"] == "gpio")
            .flat_map(|module| module["instances"].as_array().unwrap());
        let mut numbered = 0;
        for (number, instance) in row.enumerate() {
            let class = match instance["direction"].as_str() {
                Some("in") => Class::Input,
                _ => Class::Output,
            };
            let pin = instance["pin"].as_str().unwrap();
            let pin = if pin.starts_with("user_btn") {
                "key"
            } else {
                pin
            };
            let mut channels = board.of(class).iter();
            let one = channels.find(|one| one.pin("pin") == Some(pin)).unwrap();
            assert_eq!(one.litexcnc, Some(number as u8), "{name}: {pin}");
            assert!(
                one.text(class).contains(&format!("gpio={number}")),
                "{name}: {pin}"
            );
            numbered += 1;
        }
        let all = [Class::Input, Class::Output]
            .into_iter()
            .flat_map(|class| board.of(class));
        assert_eq!(
            all.filter(|one| one.litexcnc.is_some()).count(),
            numbered,
            "{name}"
        );
        assert!(numbered > 0, "{name}");
    }
}

/// What to replace by what, what the message holds, its line if that is sure.
type BadIni = (&'static str, &'static str, &'static [&'static str], usize);

const BAD_INIS: [BadIni; 20] = [
    (
        "revision = 7.1",
        "revision = 9.9",
        &["[Hardware] revision", "9.9", "5a-75e 7.1"],
        4,
    ),
    ("board = 5a-75e", "board = arty", &["revision", "arty"], 4),
    (
        "ip = 10.0.7.2",
        "ip = 10.0.7",
        &["[Hardware] ip", "10.0.7"],
        7,
    ),
    (
        "ip = 10.0.7.2",
        "ip = 224.0.0.1",
        &["[Hardware] ip", "224.0.0.1"],
        7,
    ),
    (
        "port = 4321",
        "port = 0",
        &["[Hardware] port", "1 to 65535"],
        8,
    ),
    (
        "mac = 0x10e2d5000011",
        "mac = 0x11e2d5000011",
        &["[Hardware] mac", "group"],
        9,
    ),
    (
        "mac = 0x10e2d5000011",
        "mac = none",
        &["[Hardware] mac", "none"],
        9,
    ),
    ("phy = 1", "phy = 2", &["[Hardware] phy", "2"], 6),
    (
        "clock = 40000000.0",
        "clock = fast",
        &["[Hardware] clock", "fast"],
        5,
    ),
    (
        "clock = 40000000.0",
        "clokc = 40000000.0",
        &["clokc", "did you mean clock"],
        5,
    ),
    (
        "reset_in = j4:6",
        "reset_in = j17:0",
        &["[Hardware] reset_in", "j17:0", "j1 to j16"],
        10,
    ),
    (
        "1 = j2:1",
        "1 = j2:0",
        &["[inputs] 1", "already [inputs] 0"],
        14,
    ),
    (
        "1 = j2:1",
        "5 = j2:1",
        &["[inputs] 5", "in the place of 1"],
        14,
    ),
    ("1 = j2:1", "0 = j2:1", &["[inputs] 0", "twice"], 14),
    (
        "num = 3\n\n[outputs]",
        "num = 4\n\n[outputs]",
        &["[inputs] num", "\"4\"", "3"],
        16,
    ),
    ("2 = j9:7", "2 = j9:3", &["[outputs] 2", "ground"], 21),
    (
        "3 = j9:14",
        "3 = j1:7",
        &["[outputs] 3", "same line as \"j9:7\"", "[outputs] 2"],
        22,
    ),
    ("2_dir = j11:6\n", "", &["stepgens", "2"], 0),
    ("[pwms]", "[pwm]", &["[pwm]", "did you mean [pwms]"], 25),
    ("0 = j10:0", "j10:0", &["[pwms]"], 26),
];

#[test]
fn a_bad_ini_is_refused_by_its_own_words() {
    for (old, new, wanted, line) in BAD_INIS {
        assert!(ROUTER.contains(old), "{old}");
        let said = ini(&ROUTER.replacen(old, new, 1)).expect_err(new);
        for part in wanted {
            assert!(said.contains(part), "{new:?}: {part:?} is not in {said:?}");
        }
        if line > 0 {
            assert!(
                said.starts_with(&format!("router.ini:{line}:")),
                "{new:?} is not at line {line}: {said}"
            );
        }
    }
}

#[test]
fn the_ini_of_a_machine_is_refused_by_name_with_the_file_that_is_wanted() {
    let machine = include_str!("../../host/examples/mill/mill.ini");
    // Keys that are there twice are not what is wrong with it.
    let twice = "# a mill\n[HAL]\nHALFILE = a.hal\nHALFILE = b.hal\n  [KINS]\n";
    for (text, begins) in [
        (machine, "router.ini:2:1: [DISPLAY]"),
        (twice, "router.ini:5:1: [KINS]"),
    ] {
        let said = ini(text).unwrap_err();
        assert!(said.starts_with(begins), "{said}");
        for part in [
            "LinuxCNC starts with",
            "conf.ini",
            "[Hardware]",
            "--saveconf",
        ] {
            assert!(said.contains(part), "{part:?} is not in {said:?}");
        }
        let said = json(text).unwrap_err();
        for part in ["LinuxCNC starts with", "board_type", "build_firmware"] {
            assert!(said.contains(part), "{part:?} is not in {said:?}");
        }
    }
}

/// A JSON of the 5A-75E: inputs on its first pins, outputs on the next, each called by its pin.
fn all_named(inputs: usize, outputs: usize) -> String {
    let own = (1..=16).flat_map(|j| [0, 1, 2, 4, 5, 6].map(|pin| format!("j{j}:{pin}")));
    let shared = (7..=14).map(|pin| format!("j1:{pin}"));
    let pins = own.chain(shared).take(inputs + outputs).enumerate();
    let row = pins.map(|(n, pin)| {
        let direction = if n < inputs { "in" } else { "out" };
        serde_json::json!({ "direction": direction, "pin": pin, "name": pin })
    });
    let all = serde_json::json!({
        "board_name": "all",
        "board_type": "5A-75E v7.1",
        "connection": { "mac_address": "0x10e2d5000000" },
        "watchdog": {},
        "modules": [{ "module_type": "gpio", "instances": row.collect::<Vec<_>>() }],
    });
    all.to_string()
}

/// As LiteX-CNC's `5a-75e_v7.1_i48o56.json`: every pin of the card.
#[test]
fn every_pin_of_the_card_as_an_input_or_an_output_is_a_board() {
    let draft = json(&all_named(48, 56)).unwrap();
    let channels = draft.board.channels();
    assert_eq!((channels.inputs, channels.outputs), (48, 56));
    let blob = ferrocnc_config::blob::blob(&draft.board).unwrap();
    let blob = wire::board::Blob::new_checked(&blob).unwrap();
    let pins = |channel| {
        let of = |entry: &wire::board::Entry<'_>| {
            (entry.kind, entry.channel) == (wire::board::Kind::Pins, channel)
        };
        let found = blob.entries().filter(of);
        let text = found.map(|entry| String::from_utf8_lossy(entry.value).into_owned());
        text.collect::<Vec<_>>()
    };
    assert_eq!(pins(47).len(), 2, "an input and an output");
    assert_eq!(pins(55), ["opin=j1:14 gpio=103 as=j1:14"]);
}

#[test]
fn more_inputs_than_the_gateware_has_are_refused_with_both_numbers() {
    let said = json(&all_named(65, 0)).unwrap_err();
    for part in [
        "has 65 of what becomes gpio_in",
        "gateware has 64",
        "two boards",
    ] {
        assert!(said.contains(part), "{part:?} is not in {said:?}");
    }
}

#[test]
fn names_of_litexcnc_that_the_board_has_no_room_for_are_refused_with_the_key_to_leave_out() {
    let blob = |text: &str| ferrocnc_config::blob::blob(&json(text).unwrap().board);
    let long = all_named(48, 56).replace("\"name\":\"j", "\"name\":\"of-the-old-machine-j");
    let said = blob(&long).unwrap_err().to_string();
    for part in ["the board has 4096", "litexcnc_name", "name in its JSON"] {
        assert!(said.contains(part), "{part:?} is not in {said:?}");
    }
    // Without them it fits.
    let mut unnamed: serde_json::Value = serde_json::from_str(&long).unwrap();
    for instance in unnamed["modules"][0]["instances"].as_array_mut().unwrap() {
        instance.as_object_mut().unwrap().remove("name");
    }
    assert!(blob(&unnamed.to_string()).is_ok());
}

#[test]
fn a_bad_json_is_refused_by_its_own_words() {
    let cases: [(&str, &str, &[&str]); 17] = [
        (
            "\"5A-75B v7.0\"",
            "\"5A-75B v7\"",
            &["board_type", "5A-75B v7.0"],
        ),
        (
            "\"board_name\": \"plasma\",",
            "",
            &["board_name", "missing"],
        ),
        (
            "\"etherbone\"",
            "\"spi\"",
            &["connection_type", "spi", "Ethernet"],
        ),
        ("\"0x10e2d5000032\"", "\"10-e2\"", &["mac_address", "10-e2"]),
        (
            "\"10.0.0.11\"",
            "\"10.0.0.300\"",
            &["ip_address", "10.0.0.300"],
        ),
        (
            "\"estop\"",
            "\"e_stop\"",
            &["watchdog.e_stop", "did you mean estop"],
        ),
        (
            "\"trigger\": true",
            "\"trigger\": \"true\"",
            &["watchdog.estop[0].trigger", "neither true nor false"],
        ),
        (
            "\"trigger\": true,",
            "",
            &["watchdog.estop[0].trigger", "missing"],
        ),
        (
            "\"user_btn:0\"",
            "\"user_led:0\"",
            &["modules[0].instances[0].pin", "LED"],
        ),
        (
            "\"j8:2\"",
            "\"j8:1\"",
            &[
                "modules[0].instances[1].pin",
                "already watchdog.estop[1].pin",
            ],
        ),
        ("\"LVCMOS33\"", "\"LVCMOS25\"", &["io_standard", "LVCMOS25"]),
        (
            "\"module_type\": \"pwm\"",
            "\"module_type\": \"toolerator\"",
            &["modules[1].module_type", "toolerator"],
        ),
        (
            "\"down\": \"j2:1\"",
            "\"pwm\": \"j2:1\"",
            &["pins.down", "missing"],
        ),
        ("\"pin_B\": \"j8:6\",", "", &["pin_Z", "without pin_B"]),
        (
            "\"dir_neg_pin\": \"j3:4\"",
            "\"dir_neg_pin\": \"j3:3\"",
            &["ground"],
        ),
        (
            "\"name\": \"x\",",
            "\"name\": \"x\", \"name\": \"y\",",
            &["\"name\" is there twice"],
        ),
        ("\"modules\": [", "\"modules\": [,", &["is not JSON"]),
    ];
    for (old, new, wanted) in cases {
        assert!(PLASMA.contains(old), "{old}");
        let said = json(&PLASMA.replacen(old, new, 1)).expect_err(new);
        for part in wanted {
            assert!(said.contains(part), "{new:?}: {part:?} is not in {said:?}");
        }
        assert!(said.starts_with("mill.json:"), "{said}");
    }
}

#[test]
fn deeply_nested_brackets_are_refused_without_recursion() {
    for text in [
        "[".repeat(100_000),
        "{\"a\":".repeat(100_000),
        format!("{{\"watchdog\": {}1{}}}", "[".repeat(100), "]".repeat(100)),
    ] {
        assert!(json(&text).is_err());
    }
}
