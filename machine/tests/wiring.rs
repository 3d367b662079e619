//! The wiring table, and what is behind the pins of the simulated board.

#[path = "common/folder.rs"]
mod common;

use common::{Folder, errors, machine, read_sample, sample, with};
use ferrocnc_config::Class;
use ferrocnc_machine::plant::plant;
use ferrocnc_machine::template::TEMPLATES;

#[test]
fn every_pin_that_a_sample_uses_has_a_line_in_its_wiring_table() {
    for (name, _, text) in TEMPLATES {
        let plan = Folder::default().plan(&machine(text)).expect("a plan");
        let file = format!("{name}-wiring.md");
        let table = plan.changes.iter().find(|it| it.name == file);
        let table = &table.expect("a wiring table").after;
        for class in Class::ALL {
            for channel in plan.board.of(class) {
                for (_, pin) in &channel.pins {
                    let lines = table
                        .lines()
                        .filter(|line| line.contains(&format!("`{pin}`")));
                    assert_eq!(
                        lines.count(),
                        1,
                        "{name}: {pin} of {}\n{table}",
                        channel.name
                    );
                }
            }
        }
    }
}

#[test]
fn a_pin_has_the_number_of_the_silk_screen_and_the_level_that_acts() {
    let text = with("mill", "active_low = []", "active_low = [\"flood\"]");
    let table = Folder::written(&text).file("mill-wiring.md");
    assert!(
        table.contains("| drive X: PUL+ | J1 pin 1 | `j1:0` |"),
        "{table}"
    );
    assert!(table.contains("`flood`: low is on"), "{table}");
    assert!(table.contains("`mist`: high is on"), "{table}");
    assert!(table.contains("| J1 | pin 4, pin 16 |"), "{table}");
}

#[test]
fn a_switch_of_several_purposes_has_one_line() {
    let table = Folder::written(&sample("mill")).file("mill-wiring.md");
    assert!(table.contains("| limit switch X, minimum; limit switch X, maximum |"));
}

#[test]
fn a_wiring_table_with_notes_of_the_user_is_not_written_over() {
    let mut folder = Folder::written(&sample("mill"));
    let table = folder.file("mill-wiring.md");
    folder.put(
        "mill-wiring.md",
        &table.replace("drive X:", "the drive at the door:"),
    );
    let refused = errors(folder.plan(&read_sample("mill")));
    assert_eq!(refused.len(), 1);
    assert!(refused[0].contains("mill-wiring.md:2"), "{refused:?}");
    assert!(refused[0].contains("--discard-edits"), "{refused:?}");
}

/// The keys of the switch at this input, as the file has them.
fn switch(plant: &str, input: &str, motor: &str) -> Vec<String> {
    let begin = format!("[[switch]] # {input}, at ");
    let mut lines = plant.lines();
    let found = lines.find(|it| it.starts_with(&begin) && it.ends_with(&format!(" of {motor}")));
    assert!(found.is_some(), "no {input} of {motor}:\n{plant}");
    lines.take(5).map(str::to_owned).collect()
}

fn plant_of(text: &str) -> String {
    let machine = machine(text);
    let plan = Folder::default().plan(&machine).expect("a plan");
    plant(&machine, &plan.board)
}

#[test]
fn a_home_switch_is_a_second_of_search_away_on_the_side_where_its_motor_turns_to() {
    let mill = plant_of(&sample("mill"));
    // 20 mm at 320 steps/mm below, and 15 mm above.
    assert_eq!(
        switch(&mill, "home-x", "x")[1..3],
        ["at = -6400", "above = false"]
    );
    assert_eq!(
        switch(&mill, "home-z", "z")[1..3],
        ["at = 4800", "above = true"]
    );
    let router = plant_of(&sample("router"));
    assert_eq!(
        switch(&router, "home-y", "y")[1..3],
        ["at = -2560", "above = false"]
    );
    assert_eq!(
        switch(&router, "home-y2", "y2")[1..3],
        ["at = 2560", "above = true"]
    );
}

#[test]
fn a_limit_switch_that_homes_is_one_switch() {
    let limit = "method = \"limit\", end = \"min\", search = 20, latch = 2, offset = -3, position = 0, sequence = 1 }";
    let text = sample("mill").replacen(
        "method = \"switch\", inputs = [\"home-x\"], end = \"min\", search = 20, latch = 2, offset = -3, position = 0, sequence = 1 }",
        limit,
        1,
    );
    let plant = plant_of(&text);
    let of_x = plant
        .lines()
        .filter(|line| line.starts_with("[[switch]] # limit-x"));
    let places: Vec<&str> = of_x.filter_map(|line| line.split(", ").nth(1)).collect();
    assert_eq!(places, ["at -3 of x", "at 404 of x"]);
}

#[test]
fn what_nothing_presses_is_held_at_rest() {
    let router = plant_of(&sample("router"));
    let text = "[[jumper]] # tool-setter is at rest\nfrom = \"high\"\n";
    assert!(router.contains(text), "{router}");
    let text = "[[jumper]] # estop is at rest\nfrom = \"low\"\n";
    assert!(router.contains(text), "{router}");
}
