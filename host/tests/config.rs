//! `ferrocnc config`, run as a process, and the driver's view of the names in board files.

use ferrocnc_config::board::Class;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn boards(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../boards")
        .join(name);
    path.to_str().unwrap().to_owned()
}

/// A folder of its own, gone with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("ferrocnc-config-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
        command
            .arg("config")
            .args(arguments)
            .current_dir(&self.0)
            .output()
            .unwrap()
    }

    fn says(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(
            output.status.success(),
            "{arguments:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap()
    }

    fn refuses(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(!output.status.success(), "{arguments:?} was not refused");
        String::from_utf8_lossy(&output.stdout).into_owned()
            + &String::from_utf8_lossy(&output.stderr)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_new_configuration_checks_shows_and_draws() {
    let folder = Folder::new("new");
    let said = folder.says(&[
        "new",
        "router",
        "--platform",
        "5a-75b-8.2",
        "--stepgens",
        "4",
        "--encoders",
        "1",
        "--inputs",
        "3",
        "--modified",
        "j7,j8",
    ]);
    assert!(said.contains("router.toml: written"), "{said}");
    assert!(
        folder
            .says(&["check", "router.toml"])
            .contains("4 stepgen, 1 encoder, 1 pwm, 3 gpio_in, 4 gpio_out")
    );
    assert!(
        folder
            .says(&["show", "router.toml"])
            .contains("encoder.enc-00")
    );
    let toml = folder.says(&["show", "router.toml", "--toml"]);
    assert!(
        toml.contains("bus_switch = [\"j7\", \"j8\"]") && toml.contains("a = \"j7:0\""),
        "{toml}"
    );
    assert!(folder.says(&["pinout", "router.toml"]).contains("enc-00 a"));
    folder.says(&["pinout", "router.toml", "-o", "router.svg"]);
    assert!(
        std::fs::read_to_string(folder.0.join("router.svg"))
            .unwrap()
            .contains("enc-00 a")
    );
    let again = folder.refuses(&["new", "router", "--platform", "5a-75b-8.2"]);
    assert!(
        again.contains("router.toml is there already; --force"),
        "{again}"
    );
}

#[test]
fn what_cannot_be_had_is_said_before_anything_is_written() {
    let folder = Folder::new("room");
    let cases: [(&[&str], &str); 5] = [
        (&["new", "a"], "--platform is one of 5a-75b-6.1, 5a-75b-7.0"),
        (
            &["new", "a", "--platform", "5a-75b-8.0", "--inputs", "2"],
            "--modified j5,j6",
        ),
        (
            &["new", "a", "--platform", "5a-75b-8.0", "--modified", "j9"],
            "\"j9\" is not a header",
        ),
        (
            &[
                "new",
                "a",
                "--platform",
                "5a-75b-8.0",
                "--outputs",
                "30",
                "--stepgens",
                "16",
            ],
            "no pin left for gpio_out",
        ),
        (
            &["new", "a", "--platform", "5a-75e-8.2", "--stepgens", "17"],
            "more than the gateware has: 16",
        ),
    ];
    for (arguments, wanted) in cases {
        let said = folder.refuses(arguments);
        assert!(said.contains(wanted), "{arguments:?}: {said}");
        assert!(!folder.0.join("a.toml").exists());
    }
}

#[test]
fn check_names_every_bad_file_and_fails() {
    let folder = Folder::new("check");
    let good = std::fs::read_to_string(boards("mill6.toml")).unwrap();
    std::fs::write(
        folder.0.join("mill6.toml"),
        good.replace("step = \"j1:0\"", "step = \"j1:3\""),
    )
    .unwrap();
    let said = folder.refuses(&["check", "mill6.toml", &boards("max.toml")]);
    assert!(
        said.contains("stepgen[0].step: \"j1:3\" is ground")
            && said.contains("for simulation only")
            && said.contains("1 of 2 cannot be built"),
        "{said}"
    );
    let output = folder.run(&["check", "mill6.toml", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json[0]["ok"], false);
    assert_eq!(json[0]["key"], "stepgen[0].step");
    assert_eq!(
        json[0]["line"].as_u64(),
        Some(
            1 + good
                .lines()
                .position(|line| line == "step = \"j1:0\"")
                .unwrap() as u64
        )
    );
}

#[test]
fn an_import_says_what_it_could_not_take_over() {
    let folder = Folder::new("import");
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/tests/samples");
    let sample = |name: &str| samples.join(name).to_str().unwrap().to_owned();
    let said = folder.says(&["import", "litexcnc", &sample("plasma.json")]);
    assert!(
        said.contains("plasma.toml: written")
            && said.contains("note: ")
            && said.contains("heartbeat"),
        "{said}"
    );
    let said = folder.says(&[
        "import",
        "lcnc",
        &sample("router.ini"),
        "--name",
        "old-router",
    ]);
    assert!(said.contains("old-router.toml: written"), "{said}");
    assert!(
        folder
            .says(&["check", "plasma.toml", "old-router.toml"])
            .contains("ok")
    );
    assert!(
        folder
            .refuses(&["import", "lcnc", &sample("plasma.json")])
            .contains("plasma.toml is there already")
    );
    assert!(
        folder
            .refuses(&["import", "lcnc", &sample("plasma.json"), "--force"])
            .contains("plasma.json:1:1")
    );
}

#[test]
fn a_platform_can_be_drawn_with_nothing_on_it() {
    let folder = Folder::new("platform");
    let drawn = folder.says(&["pinout", "5a-75e-7.1"]);
    let file = boards("platforms/5a-75e-7.1.toml");
    assert!(
        folder
            .says(&["check", &file])
            .contains("Colorlight 5A-75E V7.1")
    );
    assert_eq!(folder.says(&["pinout", &file]), drawn);
    assert!(
        drawn.contains("J16") && drawn.contains("KEY (button): free"),
        "{drawn}"
    );
}

/// A folder with LiteX-CNC's JSON of the example, and its HAL file with this in place of our
/// `loadrt` line.
fn peers(name: &str, loadrt: &str) -> Folder {
    let folder = Folder::new(name);
    let json = include_str!("../examples/peers/litexcnc.json");
    std::fs::write(folder.0.join("board.json"), json).unwrap();
    let ours = "loadrt ferrocnc boards=[FERROCNC]BOARD names=litexcnc:test";
    let hal = include_str!("../examples/peers/litexcnc.hal");
    assert!(hal.contains(ours));
    std::fs::write(folder.0.join("mill.hal"), hal.replace(ours, loadrt)).unwrap();
    folder
}

const WITH_HAL: [&str; 5] = ["import", "litexcnc", "board.json", "--hal", "mill.hal"];

#[test]
fn an_import_rewrites_the_one_line_of_the_hal_file_and_shows_it() {
    let theirs = "  loadrt litexcnc connections=\"eth:192.168.2.51:1235\"  # the board";
    let ours = "  loadrt ferrocnc boards=192.168.2.51:1235 names=litexcnc:test  # the board";
    let folder = peers("hal", theirs);
    let said = folder.says(&WITH_HAL);
    let line = include_str!("../examples/peers/litexcnc.hal")
        .lines()
        .position(|line| line.starts_with("loadrt ferrocnc"))
        .unwrap()
        + 1;
    assert!(
        said.contains(&format!("  {line} - {theirs}\n  {line} + {ours}\n")),
        "{said}"
    );
    assert!(said.contains("names of the board in it exist"), "{said}");
    assert!(
        said.contains("note: The HAL file has the board at 192.168.2.51:1235"),
        "{said}"
    );
    let read = |name: &str| std::fs::read_to_string(folder.0.join(name)).unwrap();
    assert_eq!(
        read("mill-ferrocnc.hal"),
        read("mill.hal").replace(theirs, ours)
    );
    // What is there is not overwritten unasked.
    std::fs::remove_file(folder.0.join("board.toml")).unwrap();
    let said = folder.refuses(&WITH_HAL);
    assert!(
        said.contains("mill-ferrocnc.hal is there already; --force"),
        "{said}"
    );
    // Where the INI file says the address, the JSON's is taken.
    let folder = peers(
        "hal-ini",
        "loadrt litexcnc connections=[LITEXCNC](CONNECTION)",
    );
    let said = folder.says(&WITH_HAL);
    assert!(
        said.contains("+ loadrt ferrocnc boards=192.168.2.50 names=litexcnc:test\n"),
        "{said}"
    );
}

#[test]
fn a_hal_file_with_names_that_would_not_exist_is_refused_with_their_lines_and_nothing_is_written() {
    let folder = peers(
        "hal-names",
        "loadrt litexcnc connections=\"eth:192.168.2.50\"",
    );
    let file = folder.0.join("mill.hal");
    let text = std::fs::read_to_string(&file).unwrap();
    let lines = text.lines().count();
    // A signal may be called anything, and a line may go on.
    let more = "net test.signal \\\n  test.stepgen.99.enable\n\
                setp [LITEXCNC](NAME).stepgen.00.steplen 5000\n\
                setp [LITEXCNC](NAME).stepgen.00.step-length 5000 # test.comment\n\
                setp [CARD]NAME.gpio.77.invert-output [JOINT_0]SCALE\n\
                setp [MOTOR](PID).Pgain 1.0\n\
                addf test.read.tmax t\naddf test.update t\n";
    std::fs::write(&file, text + more).unwrap();
    let said = folder.refuses(&WITH_HAL);
    for (line, name) in [
        (2, "test.stepgen.99.enable"),
        (4, "test.stepgen.00.step-length"),
        (5, "test.gpio.77.invert-output"),
        (8, "test.update"),
    ] {
        let wanted = format!("mill.hal:{}: {name} would not exist", lines + line);
        assert!(said.contains(&wanted), "{wanted} is not in {said}");
    }
    assert!(
        said.contains("4 of ") && said.contains("Nothing was written"),
        "{said}"
    );
    assert!(!folder.0.join("board.toml").exists());
    assert!(!folder.0.join("mill-ferrocnc.hal").exists());
}

#[test]
fn a_hal_file_in_names_gets_the_names_as_they_are_written() {
    let folder = Folder::new("hal-named");
    let plasma = include_str!("../../config/tests/samples/plasma.json");
    std::fs::write(folder.0.join("board.json"), plasma).unwrap();
    let hal = "loadrt litexcnc connections=\"eth:10.0.0.11\"\n\
               addf plasma.read t\n\
               setp plasma.stepgen.torch-height.steplen 5000\n\
               net a plasma.gpio.button.in => plasma.gpio.01.in-not\n\
               source alias.hal\n";
    std::fs::write(folder.0.join("mill.hal"), hal).unwrap();
    let said = folder.says(&WITH_HAL);
    let note =
        "note: Line 5 reads another file, which was not looked at. If it is LiteX-CNC's alias.hal";
    assert!(said.contains(note), "{said}");
    assert!(
        said.contains("boards=10.0.0.11 names=litexcnc-named:plasma"),
        "{said}"
    );
}

#[test]
fn a_hal_file_may_give_the_boards_pins_other_names_and_then_not_use_the_old_ones() {
    let folder = Folder::new("hal-alias");
    let plasma = include_str!("../../config/tests/samples/plasma.json");
    std::fs::write(folder.0.join("board.json"), plasma).unwrap();
    // As `litexcnc build_firmware` writes it into its alias file.
    let hal = "loadrt litexcnc connections=\"eth:10.0.0.11\"\n\
               alias pin plasma.stepgen.01.enable plasma.stepgen.torch-height.enable\n\
               alias pin plasma.stepgen.01.counts plasma.stepgen.torch-height.counts\n\
               net a plasma.stepgen.torch-height.enable plasma.stepgen.torch-height.counts\n";
    let file = folder.0.join("mill.hal");
    std::fs::write(&file, hal).unwrap();
    let said = folder.says(&WITH_HAL);
    assert!(
        said.contains("boards=10.0.0.11 names=litexcnc:plasma\n"),
        "{said}"
    );
    // A pin of ours has lost the name that the alias replaces; one of theirs keeps both.
    let more = "setp plasma.stepgen.01.enable 1\nnet b plasma.stepgen.01.counts\n\
                alias pin plasma.stepgen.07.enable plasma.stepgen.z.enable\n";
    std::fs::write(&file, hal.to_owned() + more).unwrap();
    let said = folder.refuses(&[&WITH_HAL[..], &["--force"]].concat());
    for wanted in [
        "mill.hal:5: plasma.stepgen.01.enable would not exist any more: line 2 gives",
        "mill.hal:7: plasma.stepgen.07.enable would not exist on",
        "2 of ",
    ] {
        assert!(said.contains(wanted), "{wanted:?} is not in {said}");
    }
}

#[test]
fn a_hal_file_whose_board_cannot_be_told_is_refused_with_its_line() {
    for (loadrt, wanted) in [
        (
            "loadrt ferrocnc boards=1.2.3.4",
            "no line begins with loadrt litexcnc",
        ),
        ("loadrt litexcnc", "mill.hal:9: has no connections="),
        (
            "loadrt litexcnc connections=\"eth:10.0.0.1,eth:10.0.0.2\"",
            "mill.hal:9: connections=",
        ),
        (
            "loadrt litexcnc connections=\"eth:10.0.0.1,10.0.0.2\"",
            "several boards",
        ),
        (
            "loadrt litexcnc connections=\"spi:/dev/spi\"",
            "not by Ethernet",
        ),
        ("loadrt litexcnc connections=\"eth:board,1\"", "board"),
        (
            "loadrt litexcnc extra_modules=x connections=\"eth:10.0.0.1\"",
            "extra_modules=x has no counterpart",
        ),
        ("loadrt litexcnc \\", "mill.hal:9: goes on in the next line"),
        (
            "loadrt litexcnc connections=\"eth:10.0.0.1\"\nloadrt litexcnc",
            "mill.hal:10: loads litexcnc a second time, after line 9",
        ),
    ] {
        let folder = peers("hal-loadrt", loadrt);
        let said = folder.refuses(&WITH_HAL);
        assert!(
            said.contains(wanted),
            "{loadrt}: {wanted:?} is not in {said}"
        );
        assert!(!folder.0.join("board.toml").exists(), "{loadrt}");
    }
    let folder = peers("hal-lcnc", "");
    let said = folder.refuses(&["import", "lcnc", "board.json", "--hal", "mill.hal"]);
    assert!(said.contains("names=lcnc"), "{said}");
}

#[test]
fn an_export_is_written_and_imports_again_and_one_that_cannot_be_is_refused_with_every_key() {
    let folder = Folder::new("export");
    let board = boards("75b_v8_14o11i6s6e6p.toml");
    let said = folder.says(&["export", "lcnc", &board]);
    assert!(said.contains("75b_v8_14o11i6s6e6p.ini: written"), "{said}");
    assert!(said.contains("note: "), "{said}");
    let again = folder.refuses(&["export", "lcnc", &board]);
    assert!(again.contains("--force"), "{again}");
    folder.says(&[
        "import",
        "lcnc",
        "75b_v8_14o11i6s6e6p.ini",
        "--name",
        "again",
    ]);
    folder.says(&["check", "again.toml"]);
    let said = folder.refuses(&["export", "litexcnc", &board, "-o", "x.json"]);
    for part in [
        "name: \"75b_v8_14o11i6s6e6p\" cannot be said to LiteX-CNC",
        "ext_reset.pin: \"j8:6\" cannot be said",
        "nothing was written",
    ] {
        assert!(said.contains(part), "{part:?} is not in {said}");
    }
    assert!(!folder.0.join("x.json").exists());
    let json = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/peers/litexcnc.json");
    folder.says(&[
        "import",
        "litexcnc",
        json.to_str().unwrap(),
        "--name",
        "mill",
    ]);
    folder.says(&["export", "litexcnc", "mill.toml"]);
    folder.says(&["import", "litexcnc", "mill.json", "--name", "third"]);
    folder.says(&["check", "third.toml"]);
}

#[test]
fn the_reader_and_the_driver_agree_how_long_a_name_may_be() {
    let pins =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/driver/export.rs"))
            .unwrap();
    for class in Class::ALL {
        let hal = class.hal();
        assert!(
            pins.contains(&format!("\"{}\"", hal.longest)),
            "the driver measures names of {} by another pin",
            class.key()
        );
        let name = "n".repeat(hal.room());
        assert_eq!(hal.pin(&name).len(), wire::board::HAL_NAME_MAX);
    }
}

#[test]
fn the_reader_knows_litexcncs_longest_pin_of_each_class() {
    let page = include_str!("../../docs/pins.md");
    // `host/tests/pins.rs` compares the page with what is exported.
    let rows = page.lines().filter(|line| line.starts_with("| `"));
    let column = rows.filter_map(|row| row.split('|').nth(5));
    let names = column.flat_map(|cell| cell.split_whitespace());
    let names: Vec<&str> = names.map(|name| name.trim_matches(['`', '*'])).collect();
    for class in Class::ALL {
        let hal = class.hal();
        let prefix = format!("{}.<nn>.", hal.class);
        let pins = names.iter().filter_map(|name| name.strip_prefix(&prefix));
        let pins = pins.filter(|pin| match class {
            Class::Input => pin.starts_with("in") && !pin.starts_with("inv"),
            Class::Output => pin.starts_with("out") || pin.starts_with("inv"),
            Class::Stepgen | Class::Encoder | Class::Pwm => true,
        });
        let longest = pins.map(|pin| pin.len()).max();
        assert!(longest <= Some(hal.litexcnc.len()), "{}", class.key());
        let driver = include_str!("../src/names/litexcnc.rs");
        let measured = format!("\"{}\", \"{}\")", hal.class, hal.litexcnc);
        assert!(driver.contains(&measured), "the driver measures another");
    }
}

/// What the TOML says is what the driver reads of the board: names and pins, by way of the blob.
#[test]
fn names_and_pins_of_the_file_are_what_the_driver_finds() {
    let board =
        ferrocnc_config::read_board(Path::new(&boards("75e_v7_30o29i9s9e8p.toml"))).unwrap();
    let bytes = ferrocnc_config::blob::blob(&board).unwrap();
    let blob = wire::board::Blob::new_checked(&bytes).unwrap();
    assert_eq!(blob.text(wire::board::Kind::Output, 29), Some("out-29"));
    let last = blob
        .entries()
        .filter(|entry| entry.kind == wire::board::Kind::Pins)
        .last()
        .unwrap();
    assert_eq!((last.channel, last.value), (29, &b"opin=j14:14"[..]));
}
