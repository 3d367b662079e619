//! Real LinuxCNC on the twin: homing to an index, probing, a thread, loops closed through `pid`, the peers' HAL files, and
//! four boards in one servo thread.
//!
//! The twin is the firmware's library on the cores' bit-exact models: as the RTL board at the pins, and fast enough for
//! programs of seconds. HAL exists once per machine, so these tests run one after the other.

use ferrocnc_tests::Simulator;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the workspace")
}

fn out(name: &str) -> PathBuf {
    let folder = root().join("target/linuxcnc").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for the run");
    folder
}

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
    let log = std::fs::File::create(folder.join("run.log")).expect("a log");
    let done = Command::new("python3")
        .arg(root().join("host/examples/mill/run.py"))
        .args(["--board", &twin.udp().to_string(), "--lockstep"])
        .arg("--config")
        .arg(&config)
        .args(["--ini", "complete.ini", "--program"])
        .arg(config.join("complete.ngc"))
        .arg("--out")
        .arg(&folder)
        .stdin(Stdio::null())
        .stdout(log.try_clone().expect("its log"))
        .stderr(log)
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

    // X homed to the encoder's index at 4000 counts, beyond the switch at 2000; Z to the stepgen's at -1600, below the switch
    // at -1000. Back at zero both stand there: Z to the step, X within what pid leaves alone (0.003 mm, 1.2 counts).
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

    // The contact closes at -4000 steps, 2400 below the index: -6.0 mm. LinuxCNC sees it a period or two late at 1 mm/s; the
    // fabric's latch to the step.
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
        .filter(|i| z[*i] < 0.8 && z[*i] > -0.8)
        .take_while(|i| *i < start + 400)
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
    assert_eq!(report["timing_violations"], 0);
}

/// Runs a HAL file on these twins, without LinuxCNC's task; what it said.
fn halrun(name: &str, hal: &str) -> String {
    let folder = out(name);
    let file = folder.join("test.hal");
    std::fs::write(&file, hal).expect("the HAL file");
    let done = Command::new("timeout")
        .args(["-k", "5", "120", "halrun"])
        .arg(&file)
        .env("RTAPI_UID", "1000")
        .env(
            "RTAPI_FIFO_PATH",
            format!("/tmp/ferrocnc_test_fifo_{}", std::process::id()),
        )
        .stdin(Stdio::null())
        .output()
        .expect("halrun, which `cargo xtask setup` installs");
    let said = format!(
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
    std::fs::write(folder.join("said.txt"), &said).expect("its words");
    said
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
