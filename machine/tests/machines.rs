//! What is written for the samples, and how the files change with the machine.

#[path = "common/folder.rs"]
mod common;

use common::{Folder, errors, machine, read_sample};
use ferrocnc_machine::template::TEMPLATES;

#[test]
fn every_sample_is_read_and_has_nothing_against_it() {
    for (name, _, _) in TEMPLATES {
        let found = ferrocnc_machine::check(&read_sample(name));
        assert!(found.bad.is_empty(), "{name}: {:?}", found.bad);
        assert!(found.notes.is_empty(), "{name}: {:?}", found.notes);
    }
}

#[test]
fn every_sample_gets_its_files_and_a_second_time_nothing_changes() {
    for (name, _, text) in TEMPLATES {
        let mut folder = Folder::default();
        let plan = folder.write(&machine(text));
        let mut names: Vec<String> = plan.changes.iter().map(|it| it.name.clone()).collect();
        names.sort();
        let mut files = vec![
            "custom.hal".to_owned(),
            "custom_postgui.hal".to_owned(),
            "ferrocnc.hal".to_owned(),
            format!("{name}-wiring.md"),
            format!("{name}.ini"),
            format!("{name}.svg"),
            format!("{name}.toml"),
            "tool.tbl".to_owned(),
        ];
        files.sort();
        assert_eq!(names, files);
        assert!(folder.write(&machine(text)).changes.is_empty(), "{name}");
    }
}

#[test]
fn steps_in_a_unit_come_of_motor_drive_gear_and_screw() {
    let text = common::with("mill", "gear = 1 ", "gear = 2.5 ");
    let ini = Folder::written(&text).file("mill.ini");
    // 200 x 8 x 2.5 / 5.
    assert_eq!(common::value(&ini, "JOINT_0", "SCALE"), "800");
    assert_eq!(common::value(&ini, "JOINT_1", "SCALE"), "320");
}

#[test]
fn the_speeds_of_the_spindle_are_those_that_linuxcnc_asks_for() {
    let ini = Folder::written(&common::sample("lathe")).file("lathe.ini");
    let of = |key: &str| common::value(&ini, "SPINDLE_0", &format!("{key}_FORWARD_VELOCITY"));
    assert_eq!([of("MIN"), of("MAX")], ["100", "3000"]);
}

#[test]
fn two_motors_of_an_axis_home_together_and_one_turns_the_other_way() {
    let folder = Folder::written(&common::sample("router"));
    let (ini, hal) = (folder.file("router.ini"), folder.file("ferrocnc.hal"));
    let kinematics = common::value(&ini, "KINS", "KINEMATICS");
    assert_eq!(kinematics, "trivkins coordinates=XYYZ kinstype=BOTH");
    assert_eq!(common::value(&ini, "TRAJ", "COORDINATES"), "X Y Y Z");
    let of = |joint: &str, key: &str| common::value(&ini, joint, key);
    assert_eq!(of("JOINT_1", "SCALE"), "64");
    assert_eq!(of("JOINT_2", "SCALE"), "-64");
    assert_eq!(of("JOINT_1", "HOME_SEQUENCE"), "-3");
    assert_eq!(of("JOINT_2", "HOME_SEQUENCE"), "-3");
    assert_eq!(of("JOINT_3", "HOME_SEQUENCE"), "1");
    assert!(hal.contains("net in:home-y2 ferrocnc.0.gpio.home-y2.in => joint.2.home-sw-in\n"));
}

#[test]
fn every_way_of_homing_is_linuxcncs() {
    let home = |way: &str| {
        let old = "home = { method = \"switch\", inputs = [\"home-x\"], end = \"min\", search = 20, latch = 2, offset = -3, position = 0, sequence = 1 }";
        let text = common::with("mill", old, &format!("home = {way}"));
        let ini = Folder::written(&text).file("mill.ini");
        [
            "SEARCH_VEL",
            "LATCH_VEL",
            "USE_INDEX",
            "IGNORE_LIMITS",
            "ABSOLUTE_ENCODER",
        ]
        .map(|key| common::value(&ini, "JOINT_0", &format!("HOME_{key}")))
    };
    let index = "method = \"index\", latch = 2";
    let there = "end = \"max\", search = 20, latch = 2, offset = 400";
    assert_eq!(home("{ method = \"immediate\" }"), ["0", "0", "", "", ""]);
    assert_eq!(home("{ method = \"absolute\" }"), ["0", "0", "", "", "2"]);
    assert_eq!(home(&format!("{{ {index} }}")), ["0", "-2", "YES", "", ""]);
    let switch = format!("{{ method = \"switch\", inputs = [\"home-x\"], {there} }}");
    assert_eq!(home(&switch), ["20", "-2", "", "", ""]);
    let contact = switch.replace(" }", ", latch_on = \"contact\" }");
    assert_eq!(home(&contact), ["20", "2", "", "", ""]);
    let limit = format!("{{ method = \"limit\", {there} }}");
    assert_eq!(home(&limit), ["20", "-2", "", "YES", ""]);
    let both = limit.replace("limit", "limit_index");
    assert_eq!(home(&both), ["20", "-2", "YES", "YES", ""]);
    let both = switch.replace("\"switch\"", "\"switch_index\"");
    assert_eq!(home(&both), ["20", "-2", "YES", "", ""]);
}

#[test]
fn an_axis_that_homes_onto_its_end_may_stand_there() {
    let ini = Folder::written(&common::sample("mill")).file("mill.ini");
    for section in ["JOINT_2", "AXIS_Z"] {
        assert_eq!(common::value(&ini, section, "MAX_LIMIT"), "0.01");
        assert_eq!(common::value(&ini, section, "MIN_LIMIT"), "-120");
    }
}

#[test]
fn a_switch_that_homes_two_axes_is_shared() {
    let text = common::sample("mill")
        .replace("home-x", "homes")
        .replace("home-z", "homes");
    let folder = Folder::written(&text);
    let (ini, hal) = (folder.file("mill.ini"), folder.file("ferrocnc.hal"));
    assert_eq!(common::value(&ini, "JOINT_0", "HOME_IS_SHARED"), "1");
    assert_eq!(common::value(&ini, "JOINT_1", "HOME_IS_SHARED"), "");
    let net = "net in:homes ferrocnc.0.gpio.homes.in => joint.0.home-sw-in joint.2.home-sw-in\n";
    assert!(hal.contains(net), "{hal}");
}

#[test]
fn the_stop_input_stops_the_board_itself() {
    let board = Folder::written(&common::sample("mill")).file("mill.toml");
    assert!(
        board.contains("name = \"estop\"\npin = \"j7:6\"\nestop = \"high\"\n"),
        "{board}"
    );
}

#[test]
fn an_output_that_is_active_low_is_off_when_the_board_is_not_armed() {
    let text = common::with("mill", "active_low = []", "active_low = [\"drive-enable\"]");
    let board = Folder::written(&text).file("mill.toml");
    let channel = "name = \"drive-enable\"\npin = \"j2:0\"\nsafe = \"high\"\ninvert = true\n";
    assert!(board.contains(channel), "{board}");
}

#[test]
fn a_channel_keeps_its_pin_when_another_is_added_and_yours_stay() {
    let mut folder = Folder::written(&common::sample("mill"));
    let before = folder.file("mill.toml");
    let mine = format!(
        "# wired on Tuesday\n{before}\n[[gpio_out]]\nname = \"lamp\"\npin = \"j5:0\"\nsafe = \"low\"\n"
    );
    folder.put("mill.toml", &mine);
    let text = common::with("mill", "[coolant]", "[coolant]\nair = \"air\"");
    let plan = folder.write(&machine(&text));
    let after = folder.file("mill.toml");
    assert!(after.starts_with(&mine), "{after}");
    assert!(after[mine.len()..].contains("name = \"air\""), "{after}");
    assert!(
        plan.notes
            .iter()
            .any(|note| note.contains("needs a new image"))
    );
    assert!(
        plan.notes
            .iter()
            .any(|note| note.contains("gpio_out lamp is not used"))
    );
}

#[test]
fn headers_for_the_inputs_are_proposed_if_none_are_named() {
    let modified = "modified = [\"j7\", \"j8\"]     # headers with bus switches in place of their buffers: inputs\n";
    let text = common::with("mill", modified, "");
    let mut folder = Folder::default();
    let plan = folder.write(&machine(&text));
    assert_eq!(plan.board.modified.bus_switch, ["j7", "j8"]);
    assert!(
        plan.notes[0].contains("j7 and j8 of the card"),
        "{:?}",
        plan.notes
    );
}

#[test]
fn an_image_that_is_there_is_used_as_it_is() {
    let mill6 = include_str!("../../boards/mill6.toml");
    let text = common::on_mill6();
    let mut folder = Folder::default();
    folder.put("mill6.toml", mill6);
    let plan = folder.write(&machine(&text));
    assert_eq!(plan.board.name, "mill6");
    assert_eq!(folder.file("mill6.toml"), mill6);
    assert!(
        !plan
            .changes
            .iter()
            .any(|change| change.name.ends_with(".toml"))
    );
}

#[test]
fn what_an_image_has_not_is_named_with_what_it_has() {
    let mut folder = Folder::default();
    folder.put("mill6.toml", include_str!("../../boards/mill6.toml"));
    let text = common::on_mill6().replace("\"home-z\"", "\"home-w\"");
    let told = errors(folder.plan(&machine(&text)));
    assert!(
        told[0]
            .contains("\"home-w\" is not a gpio_in of mill6.toml; write one that it has: limit-x"),
        "{told:?}"
    );
    let text = text
        .replace("\"home-w\"", "\"door\"")
        .replace("estop\"\nactive = \"high\"", "in-8\"");
    let told = errors(folder.plan(&machine(&text)));
    assert!(told[0].contains("does not stop the board"), "{told:?}");
}

#[test]
fn probe_and_tool_setter_trip_the_same_input() {
    let hal = Folder::written(&common::sample("router")).file("ferrocnc.hal");
    assert!(hal.contains("net probe probes.out => motion.probe-input\n"));
    assert!(
        hal.contains("net in:tool-setter-not ferrocnc.0.gpio.tool-setter.in-not => probes.in1\n")
    );
}

#[test]
fn qtdragon_gets_its_tool_dialog_when_it_runs() {
    let text = common::with("mill", "gui = \"axis\"  ", "gui = \"qtdragon\"  ");
    let folder = Folder::written(&text);
    let ini = folder.file("mill.ini");
    assert!(ini.contains(
        "POSTGUI_HALFILE = ferrocnc_postgui.hal\nPOSTGUI_HALFILE = custom_postgui.hal\n"
    ));
    let hal = folder.file("ferrocnc_postgui.hal");
    assert!(hal.contains("net tool-change => hal_manualtoolchange.change\n"));
}

#[test]
fn no_pin_of_hal_has_two_writers_and_no_signal_two_sources() {
    for (name, _, text) in TEMPLATES {
        let hal = Folder::written(text).file("ferrocnc.hal");
        let mut readers = Vec::new();
        let mut signals = Vec::new();
        for line in hal.lines().filter_map(|line| line.strip_prefix("net ")) {
            let (left, right) = line.split_once("=> ").unwrap_or((line, ""));
            let mut words = left.split_whitespace();
            let signal = words.next().expect("a signal");
            if words.next().is_some() && !line.contains("<=>") {
                assert!(!signals.contains(&signal), "{name}: {signal}");
                signals.push(signal);
            }
            for pin in right.split_whitespace() {
                assert!(!readers.contains(&pin.to_owned()), "{name}: {pin}");
                readers.push(pin.to_owned());
            }
        }
        assert!(readers.len() > 10, "{name}");
    }
}
