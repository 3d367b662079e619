//! The memory that `docs/jobs.md` names, on a PC. Bounds, because each compiler has a layout of its
//! own.

use jobs::executor::LOOK_AHEAD;
use jobs::{gcode, plan::Planner};

const PLANNER: usize = 8;
const READER: usize = 512;

#[test]
fn the_page_names_the_memory_of_planner_and_reader() {
    let (planner, reader) = (size_of::<Planner<LOOK_AHEAD>>(), size_of::<gcode::Reader>());
    assert!(
        planner <= PLANNER * 1024 && reader <= READER,
        "{planner}, {reader}"
    );
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/jobs.md"));
    let said = format!(
        "{PLANNER} KiB for {LOOK_AHEAD} lines of look-ahead, and {READER} bytes for the reader"
    );
    let page = page.expect("the page");
    let words: Vec<&str> = page.split_whitespace().collect();
    assert!(words.join(" ").contains(&said), "{said}");
}
