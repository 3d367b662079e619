//! Machines that cannot be made: each finding has its line, its key and a remedy.

#[path = "common/folder.rs"]
mod common;

use common::{Folder, errors, machine, sample, with};
use ferrocnc_machine::{check, read};

/// What reading and checking say of a sample with this changed.
fn told(name: &str, old: &str, new: &str) -> Vec<String> {
    let text = with(name, old, new);
    match read("machine.toml", &text) {
        Ok(machine) => check(&machine)
            .bad
            .iter()
            .map(ToString::to_string)
            .collect(),
        Err(error) => vec![error.to_string()],
    }
}

/// Each of these is changed in the mill, and this is said of it; nothing where it may be so.
fn each(rows: &[(&str, &str, &str)]) {
    for (old, new, says) in rows {
        let all = told("mill", old, new);
        let found = match *says {
            "" => all.is_empty(),
            _ => all.iter().any(|one| one.contains(says)),
        };
        assert!(found, "{new}: {says}\n{all:#?}");
    }
}

#[test]
fn what_is_wrong_about_file_and_board_is_said_with_line_key_and_remedy() {
    each(&[
        (
            "name = \"mill\" ",
            "name = \"my mill\" ",
            "machine.toml:5:8: name: \"my mill\" is not a name for files; write up to 32 letters",
        ),
        (
            "units = \"mm\" ",
            "units = \"cm\" ",
            "units: \"cm\" is not one of \"mm\", \"inch\"",
        ),
        ("[drives]", "[drive]", "drive: is not a known key"),
        (
            "pitch = 5 ",
            "ptch = 5 ",
            "axis[0].ptch: is not a known key (did you mean pitch?)",
        ),
        (
            "pitch = 5 ",
            "pitch = -5 ",
            "axis[0].pitch: -5 is not above 0",
        ),
        (
            "platform = \"5a-75b-8.0\"",
            "",
            "board.platform: is missing; write the PCB",
        ),
        (
            "address = ",
            "file = \"mill6.toml\"\naddress = ",
            "board.file: \"mill6.toml\" names a board file",
        ),
        (
            "address = \"192.168.2.50\"",
            "address = \"a b\"",
            "board.address: \"a b\" is not an address",
        ),
    ]);
}

#[test]
fn what_is_wrong_about_an_axis_is_said_with_key_and_remedy() {
    each(&[
        (
            "letter = \"y\"",
            "letter = \"x\"",
            "axis[1].letter: \"x\" is already axis[0]'s",
        ),
        (
            "letter = \"y\"",
            "letter = \"y\"\nmotors = [\"x\"]",
            "axis[1].motors: \"x\" is already a motor of axis[0]",
        ),
        (
            "letter = \"y\"",
            "letter = \"y\"\nreversed = [\"q\"]",
            "axis[1].reversed: \"q\" is not a motor of Y; write one of y",
        ),
        (
            "letter = \"y\"",
            "letter = \"y\"\nmotors = [\"Y-left\"]",
            "\"Y-left\" is not a name that HAL can have; write at most 7",
        ),
        (
            "max = 400",
            "max = -1",
            "axis[0].max: -1 is not above min, which is 0",
        ),
        (
            "speed = 50",
            "speed = 400",
            "axis[0].speed: 400 is 128000 steps/s at 320 steps a unit, and the drive's steplen and stepspace, together 10000 ns, allow 100000; write at most 250",
        ),
        (
            "\"generic\"",
            "\"gecko204\"",
            "axis[0].drive: \"gecko204\" is not a drive we know (did you mean gecko",
        ),
        (
            "\"generic\"",
            "{ steplen = 200_000, stepspace = 5, dirsetup = 5, dirhold = 5 }",
            "axis[0].drive.steplen: 200000 is longer than the board can count; write at most 136516 ns",
        ),
        (
            "\"generic\"",
            "{ steplen = 5 }",
            "axis[0].drive.stepspace: is missing; write nanoseconds",
        ),
    ]);
}

#[test]
fn what_is_wrong_about_homing_is_said_with_key_and_remedy() {
    each(&[
        (
            "offset = -3, position = 0",
            "offset = -3, position = 401",
            "axis[0].home.position: 401 is outside 0 to 400",
        ),
        (
            "inputs = [\"home-x\"], ",
            "",
            "axis[0].home.method: \"switch\" needs a switch; write inputs",
        ),
        (
            "method = \"switch\", inputs = [\"home-z\"]",
            "method = \"limit\"",
            "axis[2].home.method: \"limit\" needs a limit switch at the end",
        ),
        ("end = \"min\", ", "", "axis[0].home.end: is missing"),
        (
            "search = 20",
            "search = 60",
            "axis[0].home.search: 60 is faster than the axis, which is 50",
        ),
        (
            "latch = 2",
            "latch = 30",
            "axis[0].home.latch: 30 is faster than search, which is 20",
        ),
        (
            "offset = -3",
            "offset = 399",
            "axis[0].home.offset: 399 is nearer to the other end",
        ),
        (
            "offset = -3",
            "square = 3, offset = -3",
            "axis[0].home.square: 3 is not a list of numbers",
        ),
        (
            "\"home-y\"",
            "\"home-x\"",
            "axis[1].home.sequence: 1 homes at once with X, by the same switch",
        ),
    ]);
}

#[test]
fn what_is_wrong_about_spindle_stop_and_interface_is_said_with_key_and_remedy() {
    each(&[
        (
            "\"home-x\"",
            "\"estop\"",
            "estop.input: \"estop\" is also axis[0].home.inputs's",
        ),
        ("max_rpm = 24000", "", "spindle.max_rpm: is missing"),
        (
            "max_rpm = 24000",
            "max_rpm = 24000\nfull_rpm = 12000",
            "spindle.full_rpm: 12000 is less than max_rpm, 24000",
        ),
        (
            "max_rpm = 24000",
            "max_rpm = 24000\nmin_rpm = 30000",
            "spindle.min_rpm: 30000 is not from 0 to max_rpm",
        ),
        (
            "frequency = 5000 ",
            "frequency = 1000000 ",
            "spindle.frequency: 1000000 is not what the board",
        ),
        (
            "max_rpm = 24000",
            "max_rpm = 24000\nencoder = \"spindle\"",
            "spindle.counts_per_turn: is missing",
        ),
        (
            "active_low = []",
            "active_low = [\"lamp\"]",
            "board.active_low: \"lamp\" is not an output of this machine",
        ),
        (
            "gui = \"axis\" ",
            "gui = \"qtplasmac\" ",
            "gui: \"qtplasmac\" needs to know the torch",
        ),
        ("gui = \"axis\" ", "lathe = true\ngui = \"axis\" ", ""),
    ]);
}

#[test]
fn a_torch_needs_its_mode_and_no_spindle_beside_it() {
    let all = told("plasma", "arc_voltage = \"arc-volts\"", "");
    assert!(
        all[0].contains("plasma.arc_voltage: is missing for mode 1"),
        "{all:?}"
    );
    let all = told("plasma", "mode = 1 ", "mode = 2 ");
    assert!(
        all[0].contains("plasma.move_up: is missing for mode 2"),
        "{all:?}"
    );
    let all = told(
        "plasma",
        "[plasma]",
        "[spindle]\ncontrol = \"on_off\"\non = \"s\"\n[plasma]",
    );
    assert!(
        all[0].contains("spindle: cannot be beside a torch"),
        "{all:?}"
    );
}

#[test]
fn all_findings_are_said_at_once() {
    let text = sample("mill")
        .replace("speed = 50", "speed = 5000")
        .replace("max = 0", "max = -200");
    assert_eq!(check(&machine(&text)).bad.len(), 3);
}

#[test]
fn a_stepgen_with_little_to_catch_up_and_a_stop_by_software_are_notes() {
    let text = with("mill", "speed = 50", "speed = 300")
        .replace("source = \"input\" ", "source = \"software\" ");
    let found = check(&machine(&text));
    let notes: Vec<String> = found.notes.iter().map(ToString::to_string).collect();
    assert!(
        found.bad.is_empty() && notes.len() == 2,
        "{notes:?} {:?}",
        found.bad
    );
    assert!(
        notes[0].contains("less than a quarter to catch up"),
        "{notes:?}"
    );
    assert!(notes[1].contains("estop.source"), "{notes:?}");
}

#[test]
fn a_file_of_a_job_is_known_as_one() {
    let job = include_str!("../../host/examples/plotter/machine.toml");
    let error = read("machine.toml", job).expect_err("it is another file");
    assert!(
        error
            .to_string()
            .contains("is of a machine for `ferrocnc job`"),
        "{error}"
    );
}

#[test]
fn a_board_file_that_would_be_this_file_is_refused() {
    let mut machine = common::read_sample("mill");
    machine.file = "here/mill.toml".to_owned();
    let told = errors(Folder::default().plan(&machine));
    assert!(
        told[0].contains("would make mill.toml the board file"),
        "{told:?}"
    );
}

#[test]
fn too_many_inputs_are_told_with_the_next_header() {
    let text = with(
        "mill",
        "modified = [\"j7\", \"j8\"] ",
        "modified = [\"j8\"] ",
    );
    let told = errors(Folder::default().plan(&machine(&text)));
    assert!(
        told[0].contains("needs an input pin") && told[0].contains("as in \"j7\" or"),
        "{told:?}"
    );
}

#[test]
fn a_board_file_for_another_card_is_not_touched() {
    let folder = Folder::written(&sample("mill"));
    let text = with("mill", "5a-75b-8.0", "5a-75e-8.2");
    let told = errors(folder.plan(&machine(&text)));
    assert!(
        told[0].contains("board.platform: \"5a-75e-8.2\" is not the one of mill.toml"),
        "{told:?}"
    );
    let text = with("mill", "[\"j7\", \"j8\"]", "[\"j6\", \"j7\", \"j8\"]");
    let told = errors(folder.plan(&machine(&text)));
    assert!(
        told[0].contains("\"j6\" is not modified in mill.toml"),
        "{told:?}"
    );
}

#[test]
fn a_generated_file_with_edits_is_not_overwritten() {
    let mut folder = Folder::written(&sample("mill"));
    let edited = folder
        .file("ferrocnc.hal")
        .replace("pwm-freq 5000", "pwm-freq 4000");
    folder.put("ferrocnc.hal", &edited);
    let told = errors(folder.plan(&common::read_sample("mill")));
    assert!(
        told[0].starts_with("ferrocnc.hal:2:1: was edited since it was generated"),
        "{told:?}"
    );
    folder.put("ferrocnc.hal", "loadrt trivkins\n");
    let told = errors(folder.plan(&common::read_sample("mill")));
    assert!(
        told[0].contains("was not written by `ferrocnc machine write`"),
        "{told:?}"
    );
}

#[test]
fn a_line_of_the_ini_that_is_yours_stays_and_is_told() {
    let mut folder = Folder::written(&sample("mill"));
    let tuned = folder
        .file("mill.ini")
        .replacen("SCALE = 320", "SCALE = 321.4", 1);
    folder.put("mill.ini", &tuned);
    let plan = folder.write(&machine(&with("mill", "pitch = 5 ", "pitch = 4 ")));
    let ini = folder.file("mill.ini");
    assert_eq!(common::value(&ini, "JOINT_0", "SCALE"), "321.4");
    let told = plan.conflicts[0].to_string();
    assert!(
        told.contains("[JOINT_0]SCALE: 321.4 is yours and stays; the machine's file makes it 400"),
        "{told}"
    );
    let line = plan.conflicts[0].place.expect("a line").line;
    assert_eq!(ini.lines().nth(line - 1), Some("SCALE = 321.4"));
}
