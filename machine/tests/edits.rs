//! Files are generated, edited at random and generated again, round after round: no line of the
//! user's is lost, whatever was edited.

#[path = "common/folder.rs"]
mod common;

use common::{Folder, machine, sample};
use ferrocnc_machine::template::TEMPLATES;
use proptest::prelude::*;

/// Lines that a user may write: comments, keys that we write, sections, and what is no INI line.
const LINES: [&str; 16] = [
    "# a comment",
    "; another",
    "",
    "   indented = 1",
    "SCALE = 321.5",
    "SCALE=320",
    "MAX_VELOCITY = 7 # slow",
    "HALFILE = mine.hal",
    "POSTGUI_HALFILE = mine_too.hal",
    "[JOINT_0]",
    "[MINE]",
    "[JOINT_1",
    "LONG = one \\",
    "= nothing",
    "no line of an INI file",
    "HOME_SEQUENCE = 4\t",
];

#[derive(Clone, Debug)]
enum Edit {
    Insert(usize, &'static str),
    Change(usize, &'static str),
    Delete(usize),
    Swap(usize, usize),
}

fn an_edit() -> impl Strategy<Value = Edit> {
    let line = proptest::sample::select(LINES.to_vec());
    let at = 0..200_usize;
    prop_oneof![
        (at.clone(), line.clone()).prop_map(|(at, line)| Edit::Insert(at, line)),
        (at.clone(), line).prop_map(|(at, line)| Edit::Change(at, line)),
        at.clone().prop_map(Edit::Delete),
        (at.clone(), at).prop_map(|(a, b)| Edit::Swap(a, b)),
    ]
}

fn edited(text: &str, edits: &[Edit]) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    for edit in edits {
        let count = lines.len().max(1);
        match *edit {
            Edit::Insert(at, line) => lines.insert(at % (lines.len() + 1), line),
            Edit::Change(at, line) if !lines.is_empty() => lines[at % count] = line,
            Edit::Delete(at) if !lines.is_empty() => {
                lines.remove(at % count);
            }
            Edit::Swap(a, b) if !lines.is_empty() => lines.swap(a % count, b % count),
            Edit::Change(..) | Edit::Delete(_) | Edit::Swap(..) => {}
        }
    }
    lines.join("\n")
}

/// Another machine of the same kind.
#[derive(Clone, Debug)]
struct Other {
    pitch: u32,
    speed: u32,
    gui: &'static str,
    relay: bool,
    without_y: bool,
}

fn another() -> impl Strategy<Value = Other> {
    let gui = proptest::sample::select(vec!["axis", "gmoccapy", "qtdragon"]);
    (4..10_u32, 30..50_u32, gui, any::<bool>(), any::<bool>()).prop_map(
        |(pitch, speed, gui, relay, without_y)| Other {
            pitch,
            speed,
            gui,
            relay,
            without_y,
        },
    )
}

impl Other {
    fn text(&self) -> String {
        let mut text = sample("mill")
            .replace("pitch = 5", &format!("pitch = {}", self.pitch))
            .replace("speed = 50", &format!("speed = {}", self.speed))
            .replace("gui = \"axis\"", &format!("gui = \"{}\"", self.gui));
        if self.relay {
            text = text.replace("[coolant]", "[coolant]\nair = \"air\"");
        }
        if self.without_y {
            let mut parts: Vec<&str> = text.split("[[axis]]").collect();
            parts.remove(2);
            text = parts.join("[[axis]]");
        }
        text
    }
}

/// These lines are in the text, in this order.
fn are_in_order(lines: &[&str], text: &str) -> bool {
    let mut there = text.lines();
    lines.iter().all(|line| there.any(|it| it == *line))
}

proptest! {
    // A case plans up to eight machines.
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_line_of_the_users_is_lost(
        rounds in proptest::collection::vec(
            (proptest::collection::vec(an_edit(), 0..12), another()), 1..5),
        hal in "[ -~\n]{0,200}",
    ) {
        let mut folder = Folder::written(&sample("mill"));
        for name in ["custom.hal", "custom_postgui.hal"] {
            folder.put(name, &hal);
        }
        for (edits, other) in rounds {
            let generated = folder.file("mill.ini");
            let mine = edited(&generated, &edits);
            folder.put("mill.ini", &mine);
            let board = edited(&folder.file("mill.toml"), &[Edit::Insert(edits.len() * 7, "# mine")]);
            folder.put("mill.toml", &board);

            folder.write(&machine(&other.text()));

            let after = folder.file("mill.ini");
            let ours: Vec<&str> = generated.lines().collect();
            let users: Vec<&str> = mine.lines().filter(|line| !ours.contains(line)).collect();
            prop_assert!(are_in_order(&users, &after), "{users:?}\n{after}");
            let all: Vec<&str> = board.lines().collect();
            prop_assert!(are_in_order(&all, &folder.file("mill.toml")));
            prop_assert_eq!(folder.file("custom.hal"), hal.clone());
            prop_assert_eq!(folder.file("custom_postgui.hal"), hal.clone());
            let again = folder.plan(&machine(&other.text())).expect("a plan");
            prop_assert!(again.changes.is_empty(), "{}", again.changes[0].diff());
        }
    }

    #[test]
    fn a_mangled_machine_is_refused_or_made_and_nothing_panics(
        which in 0..TEMPLATES.len(),
        cuts in proptest::collection::vec((any::<prop::sample::Index>(), 0..30_usize, "[ -~\n]{0,6}"), 1..4),
    ) {
        let mut text = TEMPLATES[which].2.to_owned();
        for (at, length, new) in cuts {
            let at = at.index(text.len());
            let end = (at + length).min(text.len());
            if text.is_char_boundary(at) && text.is_char_boundary(end) {
                text.replace_range(at..end, &new);
            }
        }
        if let Ok(machine) = ferrocnc_machine::read("machine.toml", &text)
            && let Err(errors) = Folder::default().plan(&machine)
        {
            for error in errors {
                prop_assert!(!error.remedy.is_empty() && !error.problem.is_empty());
            }
        }
    }
}
