//! Files of plugins that move the pen with Z, from the tool to the pins.

use crate::rig::*;
use ferrocnc_tests::drawing;
use ferrocnc_tests::pins::{self, Pin};
use ferrocnc_tests::plotter::Plotter;
use ferrocnc_tests::{program as built, root};
use host::job::program::Program;
use std::process::Command;
use wire::jobs::End;

/// What `ferrocnc job prepare FILE --pen z` makes of it.
fn prepared(file: &str) -> Program {
    let job = std::env::temp_dir().join(format!("ferrocnc-pen-{}-{file}.job", std::process::id()));
    let output = Command::new(built("ferrocnc"))
        .args(["job", "prepare", "--pen", "z", "--force", "-o"])
        .arg(&job)
        .arg(root().join("host/tests/programs").join(file))
        .output()
        .expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let bytes = std::fs::read(&job).expect("the job");
    let _ = std::fs::remove_file(job);
    Program::from_job(&bytes).unwrap_or_else(|error| panic!("{error}"))
}

/// On the twin every edge is in its clock, Z stands, and the pen is down where these strokes begin
/// and up where they end, in steps of 80 to the mm.
fn draws(file: &str, strokes: &[[[i64; 2]; 2]]) {
    let machine = drawing::machine();
    let program = prepared(file);
    let plotter = Plotter::twin();
    let mut board = plotter.board();
    begin(&mut board, "pen", &program);
    let report = plotter.finish(&mut board);
    assert_eq!(report.end, End::Done, "{report:?}");
    drop(board);
    let emitted = plotter.events();
    let told = pins::predict(&program, &machine).unwrap_or_else(|error| panic!("{error}"));
    let difference = told.compare(&emitted);
    assert_eq!((difference.wrong, difference.late), (0, Some(0)));
    let (mut at, mut drawn, mut begun) = ([0i64; 3], Vec::new(), None);
    for (_, pin) in &emitted {
        match *pin {
            Pin::Step { axis, forward } => at[axis] += if forward { 1 } else { -1 },
            Pin::Tool(true) => begun = Some([at[0], at[1]]),
            Pin::Tool(false) => {
                let place = [at[0], at[1]];
                drawn.extend(begun.take().map(|begun| [begun, place]));
            }
        }
        assert_eq!(at[2], 0, "Z moves");
    }
    let mm = |[x, y]: [i64; 2]| [x * 80, y * 80];
    let strokes: Vec<_> = strokes.iter().map(|stroke| stroke.map(mm)).collect();
    assert_eq!(drawn, strokes);
}

#[test]
fn a_gcodetools_file_is_drawn_with_its_z_as_the_pen() {
    draws(
        "gcodetools.ngc",
        &[[[10, 10], [10, 20]], [[15, 30], [15, 30]]],
    );
}

#[test]
fn files_of_two_other_plugins_are_drawn_with_their_z_as_the_pen() {
    draws(
        "two-heights.gcode",
        &[[[5, 5], [25, 15]], [[40, 40], [45, 45]]],
    );
    draws("passes.nc", &[[[10, 10], [10, 10]], [[30, 30], [30, 30]]]);
}
