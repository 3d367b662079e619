//! Real LinuxCNC on the twin: homing to an index, probing, a thread, loops closed through `pid`,
//! the peers' HAL files, and four boards in one servo thread.
//!
//! The twin is the firmware's library on the cores' bit-exact models: as the RTL board at the pins,
//! and fast enough for programs of seconds. HAL exists once per machine, so these tests run one
//! after the other.

use ferrocnc_config::Class;
use ferrocnc_tests::hal::{halrun, out, root};
use ferrocnc_tests::{Simulator, report_part};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Runs the machine of `tests/linuxcnc/complete` on a twin with its plant; what its display found.
fn complete() -> (Value, Value) {
    let folder = out("complete");
    let config = root().join("tests/linuxcnc/complete");
    let report = folder.join("sim.json");
    let mut twin = Simulator::twin(&[
        "--mode",
        "lockstep",
        "--plant",
        &config.join("plant.toml").display().to_string(),
        "--report",
        &report.display().to_string(),
    ]);
    let done = twin
        .linuxcnc(&folder)
        .arg("--config")
        .arg(&config)
        .args(["--ini", "complete.ini", "--program"])
        .arg(config.join("complete.ngc"))
        .status();
    twin.finish();
    let said = std::fs::read_to_string(folder.join("run.log")).unwrap_or_default();
    assert!(
        done.is_ok_and(|status| status.success()),
        "the run failed:\n{}",
        &said[said.len().saturating_sub(4000)..]
    );
    let json = |path: &Path| -> Value {
        let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{path:?}: {e}"))
    };
    (json(&folder.join("result.json")), json(&report))
}

/// One column of the recording.
fn column(result: &Value, name: &str) -> Vec<f64> {
    let rows = result["rows"].as_array().expect("the recording");
    rows.iter()
        .map(|row| row[name].as_f64().unwrap_or_else(|| panic!("no {name}")))
        .collect()
}

#[test]
fn linuxcnc_homes_to_the_index_probes_threads_and_closes_its_loops() {
    let (result, report) = complete();
    let steps = |axis: usize| {
        report["axes"][axis]["pulses_at_pins"]
            .as_i64()
            .expect("pulses")
    };

    // X homed to the encoder's index at 4000 counts, beyond the switch at 2000; Z to the stepgen's
    // at -1600, below the switch at -1000. Back at zero both stand there: Z to the step, X within
    // what pid leaves alone (0.003 mm, 1.2 counts).
    assert!(
        (steps(0) - 4000).abs() <= 2,
        "X stands at {} steps",
        steps(0)
    );
    assert_eq!(steps(2), -1600, "Z stands on its index");

    // Y under pid with Lcnc's gains: within its deadband of 0.01 mm (4 steps) of where it began.
    assert!(steps(1).abs() <= 5, "Y stands at {} steps", steps(1));
    for (axis, bound) in [("x", 0.2), ("y", 0.2), ("z", 0.02)] {
        let command = column(&result, &format!("{axis}_cmd"));
        let feedback = column(&result, &format!("{axis}_fb"));
        let worst = command
            .windows(2)
            .zip(&feedback[1..])
            // Where the index was found command and feedback both change their origin.
            .filter(|(c, _)| (c[1] - c[0]).abs() < 0.5)
            .map(|(c, f)| (c[0] - f).abs())
            .fold(0.0, f64::max);
        println!("{axis}: largest difference of command and feedback {worst:.4} mm");
        assert!(worst < bound, "{axis}: {worst:.4} mm off on the way");
    }

    // The contact closes at -4000 steps, 2400 below the index: -6.0 mm. LinuxCNC sees it a period
    // or two late at 1 mm/s; the fabric's latch to the step.
    assert_eq!(result["probe_tripped"].as_bool(), Some(true));
    let probed = result["probed_z"].as_f64().expect("a probed position");
    println!(
        "probe: LinuxCNC {probed:.4} mm, latch {}",
        result["stepgen.z.position-latched"]
    );
    assert!((probed + 6.0).abs() < 0.005, "probed at {probed}");
    let latched: f64 = result["stepgen.z.position-latched"]
        .as_str()
        .and_then(|text| text.parse().ok())
        .expect("the latch");
    assert!((latched + 6.0).abs() <= 1.0 / 400.0, "latched at {latched}");

    // The thread: from the index on Z follows the spindle's encoder, 1 mm per turn, for two turns.
    let spindle = column(&result, "spindle_raw");
    let z = column(&result, "z_cmd");
    let waiting = column(&result, "spindle_index");
    let start = waiting
        .windows(2)
        .rposition(|pair| pair[0] == 1.0 && pair[1] == 0.0)
        .expect("the spindle's index was waited for");
    let inside: Vec<usize> = (start..z.len())
        .skip_while(|i| z[*i] >= 0.8)
        .take_while(|i| z[*i] > -0.8)
        .collect();
    assert!(inside.len() > 50, "the thread has {} periods", inside.len());
    let (first, last) = (inside[0], inside[inside.len() - 1]);
    let pitch = (z[first] - z[last]) / ((spindle[last] - spindle[first]) / 4000.0);
    let worst = inside
        .iter()
        .map(|i| ((spindle[*i] - spindle[first]) / 4000.0 * pitch - (z[first] - z[*i])).abs())
        .fold(0.0, f64::max);
    println!("thread: pitch {pitch:.4} mm, Z off by at most {worst:.4} mm from the spindle");
    assert!((pitch - 1.0).abs() < 0.01, "pitch {pitch}");
    assert!(worst < 0.02, "Z leaves the spindle by {worst:.4} mm");
    let off = [(steps(0) - 4000).abs(), (steps(2) + 1600).abs()];
    let figures = serde_json::json!({ "home_off_steps": off, "pitch_mm": pitch });
    report_part("twin", "homed and threaded", figures);
    assert_eq!(report["timing_violations"], 0);
}

/// Pulses per axis in a report.
fn pulses(report: &Path) -> Vec<i64> {
    let text = std::fs::read_to_string(report).unwrap_or_else(|e| panic!("{report:?}: {e}"));
    let report: Value = serde_json::from_str(&text).expect("JSON");
    let axes = report["axes"].as_array().expect("axes");
    axes.iter()
        .map(|axis| axis["pulses_at_pins"].as_i64().expect("pulses"))
        .collect()
}

/// A twin's description of the board that an import of the example's JSON makes; its name.
fn imported_from_litexcnc() -> String {
    let name = "imported-from-litexcnc";
    let file = root().join("host/examples/peers/litexcnc.json");
    let text = std::fs::read_to_string(&file).expect("their JSON");
    let platforms = ferrocnc_config::source::Folder::default();
    let import = ferrocnc_config::import::litexcnc("litexcnc.json", &text, "mill", &platforms);
    let board = import.unwrap_or_else(|error| panic!("{error}")).board;
    let folder = root().join("target/sim").join(name);
    std::fs::create_dir_all(&folder).expect("a folder");
    let blob = ferrocnc_config::blob::blob(&board).expect("a description");
    std::fs::write(folder.join("board.bin"), blob).expect("the description");
    let manifest = serde_json::json!({ "board": name, "sys_clk_hz": board.sys_clk_hz });
    std::fs::write(folder.join("manifest.json"), manifest.to_string()).expect("its manifest");
    name.to_owned()
}

/// The mill with a HAL file in another driver's names, on the twin: what its display found, what
/// its pins did, and all that was said.
fn mill_once(peer: &str) -> (Value, Value, String) {
    let folder = out(peer);
    let report = folder.join("sim.json");
    let board = match peer {
        "litexcnc" => imported_from_litexcnc(),
        _ => "mill6".to_owned(),
    };
    let to = report.display().to_string();
    let mut twin = Simulator::twin_of(&board, &["--mode", "lockstep", "--report", &to]);
    let _ = twin
        .linuxcnc(&folder)
        .arg("--hal")
        .arg(root().join(format!("host/examples/peers/{peer}.hal")))
        .arg("--program")
        .arg(root().join("tests/linuxcnc/short.ngc"))
        .status();
    twin.finish();
    let said = std::fs::read_to_string(folder.join("run.log")).unwrap_or_default();
    let result = std::fs::read_to_string(folder.join("result.json"))
        .unwrap_or_else(|_| panic!("LinuxCNC did not run the program:\n{said}"));
    let travelled = std::fs::read_to_string(&report).expect("the report");
    let json = |text: &str| serde_json::from_str(text).expect("JSON");
    (json(&result), json(&travelled), said)
}

fn off_at_rest(result: &Value) -> Vec<i64> {
    let axes = result["axes"].as_array().expect("axes");
    axes.iter()
        .map(|axis| axis["deviation_at_rest_steps"].as_i64().expect("steps"))
        .collect()
}

/// LinuxCNC waits for a move of its own that never comes, the machine is on, and every axis stands
/// where it was sent.
///
/// In Debian 12's LinuxCNC, 2.9.0~pre1, task and motion can use one command buffer at the same time
/// (LinuxCNC #2386, fixed by #2479 in May 2023): motion then executes a half-written command
/// wrongly or not at all. It was seen once in a gate, and not in 300 runs made to see it again. If
/// the program does not end a second time, the test fails.
fn waits_for_itself(result: &Value) -> bool {
    let text = result["text"].as_str().unwrap_or_default();
    let still = text.starts_with("nothing happened") && text.contains("the program ends");
    still && off_at_rest(result).iter().all(|off| off.abs() <= 1)
}

/// Runs the mill; how many steps each axis stands off its command.
fn mill_with(peer: &str) -> Vec<i64> {
    let (mut result, mut travelled, mut said) = mill_once(peer);
    if waits_for_itself(&result) {
        println!("{}: once more", result["text"]);
        (result, travelled, said) = mill_once(peer);
    }
    // 5 is "beside its step", which is for the caller to judge.
    assert!(
        [0, 5].contains(&result["exit"].as_i64().expect("an exit code")),
        "{}\n{said}",
        result["text"]
    );
    assert_eq!(result["messages"].as_array().map(Vec::len), Some(0));
    for axis in 0..2 {
        // There and back over a millimetre of 400 steps.
        let pulses = travelled["axes"][axis]["pulses_total"].as_i64();
        assert!(pulses >= Some(780), "axis {axis} made {pulses:?} pulses");
    }
    off_at_rest(&result)
}

#[test]
fn an_hal_file_written_for_lcnc_moves_the_axes() {
    // Under pid with a deadband of 0.8 steps an axis may rest on the step beside.
    for (axis, off) in mill_with("lcnc").into_iter().enumerate() {
        assert!(off.abs() <= 1, "axis {axis} stands {off} steps off");
    }
}

#[test]
fn an_hal_file_written_for_litexcnc_moves_the_axes() {
    for (axis, off) in mill_with("litexcnc").into_iter().enumerate() {
        assert_eq!(off, 0, "axis {axis}");
    }
}

#[test]
fn a_generated_first_light_file_moves_nothing_and_what_it_says_to_type_moves_every_channel() {
    let board = ferrocnc_config::read_board(&root().join("boards/mill6.toml")).expect("mill6");
    let report = out("first-light-report").join("report.json");
    let mut twin = Simulator::twin(&[
        "--mode",
        "lockstep",
        "--report",
        &report.display().to_string(),
    ]);
    let address = twin.udp().to_string();
    let file = ferrocnc_config::first_light::first_light(&board, Some(&address));
    let (_, below) = file.split_once("\nstart\n").expect("it starts");
    let typed = below.lines().filter_map(|line| line.strip_prefix("#   "));
    let typed = typed.filter(|line| !["loadusr halshow", "exit"].contains(line));
    // Every exchange is a period of the board's time: on a busy computer the answer is waited for.
    let patience = "setp ferrocnc.0.packet-read-timeout 2000000000";
    let counts: Vec<String> = board
        .of(Class::Stepgen)
        .iter()
        .map(|it| format!("getp ferrocnc.0.stepgen.{}.counts", it.name))
        .collect();
    let mut hal = format!(
        "{file}\n{patience}\nloadusr -w sleep 1\n{}\n",
        counts.join("\n")
    );
    for line in typed {
        hal += &format!("{line}\n");
        // What is asked for next needs a moment of the board's.
        if line.ends_with(".enable 1") || line.ends_with(".enable-request 1") {
            hal += "loadusr -w sleep 0.5\n";
        }
    }
    let said = halrun("first-light", &hal);
    twin.finish();
    let answers: Vec<&str> = said
        .lines()
        .filter(|line| ["TRUE", "FALSE"].contains(line) || line.parse::<f64>().is_ok())
        .collect();
    let [stepgens, encoders, pwms, inputs] =
        [Class::Stepgen, Class::Encoder, Class::Pwm, Class::Input]
            .map(|class| board.of(class).len());
    let (before, answers) = answers.split_at(stepgens);
    assert!(
        before.iter().all(|it| *it == "0"),
        "moved by itself: {said}"
    );
    let (_looks, answers) = answers.split_at(inputs + encoders);
    let (armed, answers) = answers.split_at(1);
    assert_eq!(armed, ["TRUE"], "{said}");
    let (moved, duties) = answers.split_at(stepgens);
    for (n, counts) in moved.iter().enumerate() {
        let counts: i64 = counts.parse().expect("counts");
        assert!(counts > 0, "step generator {n}: {said}");
        // The answer is of a moment when it still ran; then it ran on to its stop.
        assert!(pulses(&report)[n] >= counts, "step generator {n}: {said}");
    }
    let expected = vec!["0.1"; pwms];
    assert_eq!(duties, expected, "{said}");
}

#[test]
fn four_boards_share_a_servo_thread_and_cost_little_more_than_one() {
    let folder = std::env::temp_dir().join(format!("ferrocnc-four-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let reports: Vec<PathBuf> = (0..4).map(|n| folder.join(format!("{n}.json"))).collect();
    let mut twins: Vec<Simulator> = reports
        .iter()
        .map(|report| {
            Simulator::twin(&[
                "--mode",
                "lockstep",
                "--report",
                &report.display().to_string(),
            ])
        })
        .collect();
    let addresses: Vec<String> = twins.iter().map(|twin| twin.udp().to_string()).collect();

    let mut hal = String::from("loadrt threads name1=servo period1=1000000 fp1=1\n");
    hal += &format!("loadrt ferrocnc boards={}\n", addresses.join(","));
    let each = |line: &str| -> String {
        (0..4)
            .map(|n| line.replace('#', &n.to_string()) + "\n")
            .collect()
    };
    for function in ["read-request", "read", "write"] {
        hal += &each(&format!("addf ferrocnc.#.{function} servo"));
    }
    // Every exchange is a period of the boards' time, so wait for the answers, even on a busy
    // computer.
    hal += &each("setp ferrocnc.#.packet-read-timeout 2000000000");
    hal += &each("setp ferrocnc.#.stepgen.x.maxaccel 1000000");
    hal += &each("setp ferrocnc.#.stepgen.x.control-type 1");
    hal += &each("setp ferrocnc.#.stepgen.x.enable 1");
    hal += &each("setp ferrocnc.#.enable 1");
    // One signal, so that all boards hear of it in the same period or the next one.
    hal += &each("net velocity ferrocnc.#.stepgen.x.velocity-cmd");
    hal += "start\nloadusr -w sleep 1\n";
    hal += &each("setp ferrocnc.#.enable-request 1");
    hal += "loadusr -w sleep 1\n";
    hal += "sets velocity 5000\nloadusr -w sleep 2\nsets velocity 0\n";
    hal += "loadusr -w sleep 1\n";
    hal += &each("getp ferrocnc.#.enabled");
    hal += &each("getp ferrocnc.#.stepgen.x.counts");
    for function in ["read-request", "read", "write"] {
        hal += &each(&format!("getp ferrocnc.#.{function}.time"));
    }
    let said = halrun("four", &hal);
    for twin in &mut twins {
        twin.finish();
    }
    let answers: Vec<&str> = said
        .lines()
        .filter(|line| *line == "TRUE" || *line == "FALSE" || line.parse::<f64>().is_ok())
        .collect();
    assert_eq!(answers.len(), 20, "{said}");
    let number = |at: usize| answers[at].parse::<f64>().expect("a number");
    let mut travelled = Vec::new();
    for n in 0..4 {
        assert_eq!(answers[n], "TRUE", "board {n} is not enabled:\n{said}");
        let pins = pulses(&reports[n])[0];
        assert_eq!(number(4 + n) as i64, pins, "board {n}: counts and pins");
        travelled.push(pins);
    }
    let (least, most) = (travelled.iter().min(), travelled.iter().max());
    println!("four boards at 5000 steps/s: {travelled:?} steps");
    assert!(least > Some(&500), "they hardly moved: {travelled:?}");
    // The signal may change between two boards of a servo period, which is two exchanges and 10
    // steps long; at the start and at the end.
    assert!(
        most.zip(least)
            .is_some_and(|(most, least)| most - least <= 20),
        "{travelled:?}"
    );

    let of = |n: usize| -> i64 { (0..3).map(|f| number(8 + 4 * f + n) as i64).sum() };
    // HAL's own figures of the last period; printed, for they are this machine's.
    let (first, others) = (of(0), (1..4).map(of).sum::<i64>());
    println!("servo thread: first board {first} ns, the other three together {others} ns");
    let reports = root().join("target/reports");
    std::fs::create_dir_all(&reports).expect("a folder for reports");
    let json = serde_json::json!({
        "steps": travelled, "first_board_ns": first, "other_three_ns": others,
    });
    std::fs::write(reports.join("boards.json"), format!("{json:#}\n")).expect("the report");
    let _ = std::fs::remove_dir_all(folder);
}
