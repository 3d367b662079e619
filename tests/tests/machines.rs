//! Every machine of `ferrocnc machine new --from`, as a user makes it: the tool writes its files,
//! LinuxCNC starts with them on the twin of its own board file, homes all axes against the switches
//! of `ferrocnc machine plant`, and runs a program. Only the display is another one, and
//! `custom.hal` records.
//!
//! HAL exists once per machine, so these tests run one after the other.

use ferrocnc_tests::hal::{out, root};
use ferrocnc_tests::{Simulator, program};
use serde_json::Value;
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// How far a switch may be found from where it is, in seconds at the speed of its edge: 2 ms until
/// it counts as at rest, and two servo periods.
const FOUND_LATE: f64 = 4e-3;

/// A machine whose files are written.
struct Written {
    folder: PathBuf,
    ini: String,
}

fn tool(folder: &Path, arguments: &[&str]) -> String {
    let done = Command::new(program("ferrocnc"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the tool");
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{arguments:?}: {said}");
    String::from_utf8_lossy(&done.stdout).into_owned()
}

/// Each joint's command, feedback and counts, every servo period, and a display without a screen.
fn without_a_screen(folder: &Path, ini: &mut String, joints: usize) {
    let display = ini.lines().find(|line| line.starts_with("DISPLAY = "));
    let display = display.expect("a display").to_owned();
    *ini = ini.replacen(&display, "DISPLAY = ./display.py", 1);
    // The board's time passes with the exchanges, and task waits for it.
    *ini = ini.replacen("COMM_TIMEOUT = 1.0", "COMM_TIMEOUT = 60.0", 1);
    let mut hal = format!(
        "loadrt sampler depth=20000 cfg={}\naddf sampler.0 servo-thread\n",
        "ffs".repeat(joints)
    );
    for joint in 0..joints {
        let pin = |n: usize| format!("sampler.0.pin.{}", 3 * joint + n);
        hal += &format!(
            "net j{joint}-cmd => {}\nnet j{joint}-fb => {}\n",
            pin(0),
            pin(1)
        );
    }
    let main = std::fs::read_to_string(folder.join("ferrocnc.hal")).expect("the HAL file");
    let stepgens = main.lines().filter_map(|line| {
        let (_, rest) = line.split_once("ferrocnc.0.stepgen.")?;
        rest.strip_suffix(".position-cmd")
    });
    for (joint, stepgen) in stepgens.enumerate() {
        hal += &format!(
            "net j{joint}-counts ferrocnc.0.stepgen.{stepgen}.counts => sampler.0.pin.{}\n",
            3 * joint + 2
        );
    }
    std::fs::write(folder.join("custom.hal"), hal).expect("custom.hal");
    let display = root().join("tests/linuxcnc/machine/display.py");
    std::fs::copy(display, folder.join("display.py")).expect("the display");
}

/// `ferrocnc machine new`, `write` and what this test adds.
fn written(name: &str) -> Written {
    let folder = out(&format!("machine-{name}")).join("machine");
    std::fs::create_dir_all(&folder).expect("a folder");
    tool(&folder, &["machine", "new", "--from", name]);
    tool(&folder, &["machine", "write", "--yes"]);
    for file in ["-wiring.md", ".svg", ".ini", ".toml"] {
        let file = folder.join(format!("{name}{file}"));
        assert!(file.is_file(), "no {}", file.display());
    }
    let path = folder.join(format!("{name}.ini"));
    let mut ini = std::fs::read_to_string(&path).expect("the INI file");
    let joints = value(&ini, "KINS", "JOINTS") as usize;
    without_a_screen(&folder, &mut ini, joints);
    std::fs::write(&path, &ini).expect("the INI file");
    Written { folder, ini }
}

/// A number of the INI file, if it has it.
fn value_if(ini: &str, section: &str, key: &str) -> Option<f64> {
    let (_, rest) = ini.split_once(&format!("[{section}]\n")).expect(section);
    let mut lines = rest.split("\n[").next().unwrap_or_default().lines();
    let begin = format!("{key} = ");
    let value = lines.find_map(|line| line.strip_prefix(&begin))?;
    Some(value.parse().expect("a number"))
}

/// A number of the INI file.
fn value(ini: &str, section: &str, key: &str) -> f64 {
    value_if(ini, section, key).unwrap_or_else(|| panic!("[{section}]{key}"))
}

/// A home switch of the plant: the machine's coordinate there, its motor, and the steps.
struct HomeSwitch {
    coordinate: f64,
    motor: String,
    steps: f64,
}

fn home_switches(plant: &str) -> Vec<HomeSwitch> {
    let mut lines = plant.lines();
    let mut found = Vec::new();
    while let Some(line) = lines.next() {
        let Some(rest) = line.strip_prefix("[[switch]] # home-") else {
            continue;
        };
        let (_, rest) = rest.split_once(", at ").expect("its place");
        let (coordinate, motor) = rest.split_once(" of ").expect("its motor");
        let at = lines.find_map(|line| line.strip_prefix("at = "));
        found.push(HomeSwitch {
            coordinate: coordinate.parse().expect("a coordinate"),
            motor: motor.to_owned(),
            steps: at.and_then(|at| at.parse().ok()).expect("steps"),
        });
    }
    found
}

/// Writes the machine, starts it, homes it, runs the program; what the display found. Every joint
/// is where its home switch says that it is.
fn run(name: &str, motors: &[&str], gcode: &str) -> Value {
    let machine = written(name);
    let plant = tool(&machine.folder, &["machine", "plant"]);
    let run = machine.folder.parent().expect("the run's folder");
    let plant_file = run.join("plant.toml");
    std::fs::write(&plant_file, &plant).expect("the plant");
    let ngc = run.join("program.ngc");
    std::fs::write(&ngc, gcode).expect("the program");
    let report = run.join("sim.json");
    let board = machine.folder.join(format!("{name}.toml"));
    let mut twin = Simulator::twin_of(
        &board.display().to_string(),
        &[
            "--mode",
            "lockstep",
            "--no-plant",
            "--plant",
            &plant_file.display().to_string(),
            "--report",
            &report.display().to_string(),
        ],
    );
    let _ = twin
        .linuxcnc(run)
        .arg("--config")
        .arg(&machine.folder)
        .args(["--ini", &format!("{name}.ini"), "--program"])
        .arg(&ngc)
        .status();
    twin.finish();
    let said = std::fs::read_to_string(run.join("run.log")).unwrap_or_default();
    let said = &said[said.len().saturating_sub(4000)..];
    let json = |path: &Path| -> Value {
        let text =
            std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path:?}: {e}\n{said}"));
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{path:?}: {e}"))
    };
    let (result, report) = (json(&run.join("result.json")), json(&report));
    assert_eq!(result["exit"], 0, "{}\n{said}", result["text"]);
    assert_eq!(
        result["messages"].as_array().map(Vec::len),
        Some(0),
        "{result}"
    );
    assert_eq!(report["timing_violations"], 0);
    let switches = home_switches(&plant);
    for (joint, motor) in motors.iter().enumerate() {
        assert_eq!(result["homed"][joint], 1, "{motor}: {result}");
        let section = format!("JOINT_{joint}");
        let scale = value(&machine.ini, &section, "SCALE");
        let of = |key: &str| result["joints"][joint][key].as_f64().expect("a number");
        let off = (of("command") - of("feedback")).abs();
        assert!(off <= 1.5 / scale.abs(), "{motor} is {off} off its command");
        let Some(switch) = switches.iter().find(|it| it.motor == *motor) else {
            continue;
        };
        // The switch, in this run's coordinates, from where the motor really is.
        let found = of("place") - (of("counts") - switch.steps) / scale;
        let late = value(&machine.ini, &section, "HOME_LATCH_VEL").abs() * FOUND_LATE;
        // The motor is so far ahead of the axis where the screw has play.
        let play = value_if(&machine.ini, &section, "BACKLASH").unwrap_or(0.0);
        let off = (found - switch.coordinate).abs();
        println!("{name}: {motor} homed {off:.4} off its switch");
        let most = late + play + 1.5 / scale.abs();
        assert!(off <= most, "{motor} homed {off} off, {most} at most");
    }
    result
}

/// The axes stand there.
fn stands(result: &Value, places: &[(&str, f64)]) {
    for (axis, place) in places {
        let at = result["position"][axis].as_f64().expect("a place");
        assert!((at - place).abs() < 0.02, "{axis} at {at}, not {place}");
    }
}

/// LinuxCNC with a machine's second INI file, which starts the board by itself, as the picker's
/// copy of a sample does; what it says goes to `run.log`.
fn from_the_picker(folder: &Path, ini: &str, board: SocketAddr, ngc: &Path) {
    let run = folder.parent().expect("the run's folder");
    let log = std::fs::File::create(run.join("run.log")).expect("a log");
    let tool = program("ferrocnc");
    let programs = tool.parent().expect("its folder").display();
    // Installed, all three are in /usr/bin.
    let packaging = root().join("host/packaging");
    let path = std::env::var("PATH").expect("a path");
    let _ = Command::new("python3")
        .arg(root().join("host/examples/mill/run.py"))
        .args(["--board", &board.to_string(), "--lockstep", "--out"])
        .arg(run)
        .arg("--config")
        .arg(folder)
        .args(["--ini", ini, "--program"])
        .arg(ngc)
        .env("PATH", format!("{programs}:{}:{path}", packaging.display()))
        .stdin(Stdio::null())
        .stdout(log.try_clone().expect("its log"))
        .stderr(log)
        .status();
}

/// The processes whose command names this address, but for those that have ended.
fn with_address(board: SocketAddr) -> Vec<String> {
    let processes = std::fs::read_dir("/proc").expect("/proc").flatten();
    // One that has ended and waits for its parent has no command.
    let commands = processes.filter_map(|it| std::fs::read(it.path().join("cmdline")).ok());
    let commands = commands.map(|it| String::from_utf8_lossy(&it).replace('\0', " "));
    commands
        .filter(|command| command.contains(&board.to_string()))
        .collect()
}

#[test]
fn a_sample_starts_its_board_by_itself_and_leaves_no_process() {
    let folder = out("machine-picker").join("machine");
    std::fs::create_dir_all(&folder).expect("a folder");
    tool(&folder, &["machine", "new", "--from", "mill"]);
    tool(&folder, &["machine", "write", "--twin", "--yes"]);
    let path = folder.join("mill-twin.ini");
    let mut ini = std::fs::read_to_string(&path).expect("the twin's INI file");
    without_a_screen(&folder, &mut ini, 3);
    std::fs::write(&path, &ini).expect("the INI file");
    // A host that waits for its processor must not count as dead.
    let path = folder.join("twin.hal");
    let hal = std::fs::read_to_string(&path).expect("the twin's HAL file");
    let hal = format!("{} --silence-ms 600000\n", hal.trim_end());
    std::fs::write(&path, hal).expect("the HAL file");
    let run = folder.parent().expect("the run's folder");
    let ngc = run.join("program.ngc");
    std::fs::write(&ngc, "G21 G90\nG0 X10 Y20\nM2\n").expect("the program");
    let board = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
    let board = board.expect("a free UDP port");

    from_the_picker(&folder, "mill-twin.ini", board, &ngc);

    let said = std::fs::read_to_string(run.join("run.log")).unwrap_or_default();
    let result = std::fs::read_to_string(run.join("result.json")).expect(&said);
    let result: Value = serde_json::from_str(&result).expect("JSON");
    assert_eq!(result["exit"], 0, "{}\n{said}", result["text"]);
    stands(&result, &[("x", 10.0), ("y", 20.0), ("z", 0.0)]);
    assert_eq!(with_address(board), [""; 0], "{said}");
}

#[test]
fn the_mill_homes_probes_and_turns_its_spindle() {
    let result = run(
        "mill",
        &["x", "y", "z"],
        "G21 G90\nM3 S12000\nG0 X10 Y20\nM5\nG0 Z-105\nG38.2 Z-112 F300\nG0 Z-100\nM2\n",
    );
    stands(&result, &[("x", 10.0), ("y", 20.0), ("z", -100.0)]);
    // The plant's probe touches a tenth of Z's travel above its end.
    assert_eq!(result["probe_tripped"], true);
    let probed = result["probed_z"].as_f64().expect("a place");
    assert!((probed + 108.0).abs() < 0.05, "probed at {probed}");
}

#[test]
fn the_lathe_homes_and_cuts_a_thread() {
    let result = run(
        "lathe",
        &["x", "z"],
        "G21 G90 G18 G8\nM3 S600\nG0 X40 Z-2\nG33 Z-6 K1\nG0 X45\nM5\nM2\n",
    );
    stands(&result, &[("x", 45.0), ("z", -6.0)]);
}

#[test]
fn the_plasma_table_squares_its_gantry_and_moves() {
    let result = run(
        "plasma",
        &["x", "y", "y2", "z"],
        "G21 G90\nG0 X60 Y40\nG0 Z-10\nM2\n",
    );
    stands(&result, &[("x", 60.0), ("y", 40.0), ("z", -10.0)]);
}

#[test]
fn the_router_squares_its_gantry_and_moves() {
    let result = run(
        "router",
        &["x", "y", "y2", "z"],
        "G21 G90\nM3 S12000\nG0 X60 Y40\nG1 Z-5 F1200\nM5\nM2\n",
    );
    stands(&result, &[("x", 60.0), ("y", 40.0), ("z", -5.0)]);
}

#[test]
fn the_plotter_homes_and_lowers_its_pen() {
    let result = run(
        "plotter",
        &["x", "y", "z"],
        "G21 G90\nG0 X60 Y40\nG1 Z-2 F600\nG1 X80 F6000\nM2\n",
    );
    stands(&result, &[("x", 80.0), ("y", 40.0), ("z", -2.0)]);
}
