//! The variant of a machine that starts on the simulated board.

#[path = "common/folder.rs"]
mod common;

use common::{Folder, errors, machine, read_sample, sample, value};
use ferrocnc_config::source::Folder as Platforms;
use ferrocnc_machine::plan::{Wishes, plan};
use ferrocnc_machine::template::TEMPLATES;

const WISHES: Wishes = Wishes {
    discard: false,
    twin: true,
};

/// A folder with all files of the sample, those of its twin too.
fn with_twin(name: &str) -> Folder {
    let mut folder = Folder::default();
    let plan = plan(&read_sample(name), &folder, &Platforms::default(), WISHES);
    for change in plan.expect("a plan").changes {
        folder.put(&change.name, &change.after);
    }
    folder
}

/// The lines of one text that another has not.
fn more(one: &str, other: &str) -> Vec<String> {
    let lines = one
        .lines()
        .filter(|line| !other.lines().any(|it| it == *line));
    lines.map(str::to_owned).collect()
}

#[test]
fn the_twin_is_the_machine_with_another_board_that_the_first_hal_file_loads() {
    for (name, _, _) in TEMPLATES {
        let folder = with_twin(name);
        let ini = folder.file(&format!("{name}.ini"));
        let twin = folder.file(&format!("{name}-twin.ini"));
        let own: Vec<String> = more(&twin, &ini)
            .into_iter()
            .filter(|line| !line.starts_with('#'))
            .collect();
        let wanted = [
            "BOARD = 127.0.0.1:1234",
            "PACKET_READ_TIMEOUT = 100000000",
            "HALFILE = twin.hal",
        ];
        assert_eq!(own, wanted, "{name}");
        assert_eq!(value(&twin, "HAL", "HALFILE"), "twin.hal", "{name}");
        let load = format!(
            "\nloadusr -Wn ferrocnc-twin ferrocnc-twin machine.toml {name}.toml [FERROCNC]BOARD\n"
        );
        assert!(folder.file("twin.hal").contains(&load), "{name}");
    }
}

#[test]
fn the_picker_shows_a_text_beside_both_ini_files() {
    let folder = with_twin("router");
    let [card, twin] = ["router.txt", "router-twin.txt"].map(|name| folder.file(name));
    let begin = "router: X, Y with 2 motors, Z, a spindle with 0 to 10 V, a probe.";
    assert!(card.starts_with(begin), "{card}");
    assert!(twin.starts_with(begin), "{twin}");
    assert!(card.contains("router-wiring.md"), "{card}");
    assert!(twin.contains("without a card"), "{twin}");
}

#[test]
fn a_twin_that_is_there_follows_the_machine_and_lines_of_the_user() {
    let mut folder = with_twin("mill");
    let ini = folder.file("mill.ini");
    folder.put("mill.ini", &(ini + "[MINE]\nKEY = 1\n"));
    folder.put("mill.txt", "Mine.\n");
    let text = sample("mill").replacen("speed = 50", "speed = 40", 1);
    folder.write(&machine(&text));
    let twin = folder.file("mill-twin.ini");
    assert_eq!(value(&twin, "MINE", "KEY"), "1");
    assert_eq!(value(&twin, "AXIS_X", "MAX_VELOCITY"), "40");
    assert_eq!(value(&twin, "FERROCNC", "BOARD"), "127.0.0.1:1234");
    assert_eq!(folder.file("mill.txt"), "Mine.\n");
    assert!(folder.write(&machine(&text)).changes.is_empty());
}

/// It puts the user's folder of programs into every INI file of its copy.
#[test]
fn what_the_picker_writes_into_its_copy_is_no_edit() {
    let mut folder = with_twin("mill");
    for name in ["mill.ini", "mill-twin.ini"] {
        let ini = folder.file(name);
        let prefix = "PROGRAM_PREFIX = ~/linuxcnc/nc_files\n";
        assert!(ini.contains(prefix), "{ini}");
        folder.put(
            name,
            &ini.replace(prefix, "PROGRAM_PREFIX = /home/a/linuxcnc/nc_files\n"),
        );
    }
    let plan = folder.write(&read_sample("mill"));
    let changes: Vec<&str> = plan.changes.iter().map(|it| it.name.as_str()).collect();
    // It no longer remembers that line as ours.
    assert_eq!(changes, ["ferrocnc.hal"]);
    assert!(plan.conflicts.is_empty(), "{:?}", plan.conflicts);
    assert!(folder.write(&read_sample("mill")).changes.is_empty());
}

#[test]
fn a_twin_that_was_edited_is_not_written_over() {
    let mut folder = with_twin("mill");
    let twin = folder.file("mill-twin.ini");
    folder.put("mill-twin.ini", &(twin + "[MINE]\nKEY = 1\n"));
    let refused = errors(folder.plan(&read_sample("mill")));
    assert!(refused[0].contains("mill-twin.ini:2"), "{refused:?}");
    assert!(refused[0].contains("--discard-edits"), "{refused:?}");
}
