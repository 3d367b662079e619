//! Real LinuxCNC, our driver as `loadrt` finds it, the simulated board in lockstep.
//!
//! HAL exists once per machine, so these tests run one after the other and not beside a LinuxCNC
//! session.

use ferrocnc_tests::Simulator;
use ferrocnc_tests::hal::{halrun, out, root};
use sim::edges::{Step, read_file};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The mill's watchdog timeout and its soft stop from full speed (60 mm/s at 1600 mm/s^2), seconds.
const WATCHDOG: f64 = 5e-3;
const SOFT_STOP: f64 = 60.0 / 1600.0;
/// Clocks in a servo period at the board's 60 MHz.
const PERIOD: u64 = 60_000;

#[test]
fn loadrt_says_in_one_sentence_what_is_wrong_with_its_parameters() {
    let said = halrun("malformed", "loadrt ferrocnc boards=not-an-address:99999\n");
    let sentence = said.lines().find(|line| line.contains("not-an-address"));
    let sentence = sentence.unwrap_or_else(|| panic!("no message named the address:\n{said}"));
    assert!(
        sentence.contains("boards"),
        "it should name the parameter: {sentence}"
    );
}

#[test]
fn loadrt_names_a_board_that_does_not_answer() {
    let said = halrun("unreachable", "loadrt ferrocnc boards=127.0.0.1:9\n");
    let sentence = said.lines().find(|line| line.contains("127.0.0.1:9"));
    assert!(sentence.is_some(), "no message named the board:\n{said}");
}

#[test]
fn loadrt_shows_the_boards_own_names_as_pins() {
    let simulator = Simulator::start(&["--mode", "free"]);
    let said = halrun(
        "pins",
        &format!("loadrt ferrocnc boards={}\nshow pin\n", simulator.udp()),
    );
    for pin in [
        "ferrocnc.0.stepgen.x.position-cmd",
        "ferrocnc.0.encoder.spindle.index-enable",
        "ferrocnc.0.enable-request",
    ] {
        assert!(said.contains(pin), "no pin {pin}:\n{said}");
    }
}

/// The mill on a simulated board.
fn mill(simulator: &Simulator, program: &Path, out: &Path) -> Child {
    let mut run = simulator.linuxcnc(out);
    run.arg("--program").arg(program).spawn().expect("python3")
}

fn log_of(out: &Path) -> String {
    std::fs::read_to_string(out.join("run.log")).unwrap_or_default()
}

/// The last whole line of the recording, as numbers.
fn last_sample(out: &Path) -> Option<Vec<f64>> {
    let text = std::fs::read_to_string(out.join("samples.raw")).ok()?;
    let (whole, _) = text.rsplit_once('\n')?;
    whole
        .lines()
        .next_back()?
        .split_whitespace()
        .map(|field| field.parse().ok())
        .collect()
}

/// Waits until X has gone 5 mm of its 20: at full speed by then.
fn at_speed(out: &Path) {
    let deadline = Instant::now() + Duration::from_secs(300);
    let at_speed = loop {
        match last_sample(out) {
            Some(sample) if sample[1] > 5.0 => break sample,
            _ if Instant::now() > deadline => panic!("the move never began:\n{}", log_of(out)),
            _ => std::thread::sleep(Duration::from_millis(50)),
        }
    };
    assert!(
        at_speed[1] < 19.0,
        "the move was over before it could be interrupted"
    );
}

/// The steps before and after the longest pause.
fn around_the_pause(steps: &[Step]) -> [Step; 2] {
    let gap = steps
        .windows(2)
        .max_by_key(|pair| pair[1].clock - pair[0].clock)
        .expect("steps");
    gap.try_into().expect("a pair")
}

#[test]
fn killing_linuxcnc_mid_move_stops_the_machine_and_a_new_start_moves_nothing_by_itself() {
    let first = out("killed");
    let (edges, report) = (first.join("edges.bin"), first.join("sim.json"));
    let mut simulator = Simulator::start(&[
        "--mode",
        "lockstep",
        "--edges",
        &edges.display().to_string(),
        "--report",
        &report.display().to_string(),
    ]);
    let mut linuxcnc = mill(
        &simulator,
        &root().join("tests/linuxcnc/there_and_back.ngc"),
        &first,
    );

    at_speed(&first);
    let killed = Command::new("pkill")
        .args(["-9", "-x", "rtapi_app"])
        .status();
    assert!(
        killed.is_ok_and(|status| status.success()),
        "there was no rtapi_app to kill"
    );
    // The board's time goes on without its host: the watchdog, the stop, and a while.
    simulator.run_ms(100);
    let _ = Command::new("kill")
        .args(["-INT", &linuxcnc.id().to_string()])
        .status();
    let _ = linuxcnc.wait();
    let last = last_sample(&first).expect("the recording");
    let last_seen = last[15] as u64 * (1 << 32) + last[14] as u64;

    // LinuxCNC comes back. It has to ask for the machine again, and nothing moves before that.
    let second = out("restarted");
    let done = mill(
        &simulator,
        &root().join("tests/linuxcnc/short.ngc"),
        &second,
    )
    .wait();
    assert!(
        done.is_ok_and(|status| status.success()),
        "the second run failed:\n{}",
        log_of(&second)
    );
    simulator.finish();

    let (hz, steps) =
        read_file(&std::fs::read(&edges).expect("the recorded edges")).expect("an edge file");
    let bound = last_seen + 3 * PERIOD + ((WATCHDOG + SOFT_STOP) * hz as f64) as u64;
    let [before, after] = around_the_pause(&steps);
    assert!(
        before.clock <= bound,
        "the last step came {:.1} ms after the last status LinuxCNC saw",
        (before.clock - last_seen) as f64 / hz as f64 * 1e3
    );
    let x_when_stopped = steps
        .iter()
        .rfind(|s| s.clock <= before.clock && s.channel == 0)
        .map(|s| s.count);
    let x_when_moving = steps
        .iter()
        .find(|s| s.clock >= after.clock && s.channel == 0)
        .map(|s| s.count);
    let (stopped, moving) = (
        x_when_stopped.expect("X moved"),
        x_when_moving.expect("X moved again"),
    );
    assert_eq!(
        (stopped - moving).abs(),
        1,
        "X went on from where it stood, step by step"
    );

    // The second program ends where it began: at the place the first one was stopped.
    let report = std::fs::read_to_string(&report).expect("the simulator's report");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    for axis in report["axes"].as_array().expect("axes") {
        assert_eq!(axis["pulses_at_pins"], axis["firmware_counts"], "{axis}");
    }
    assert_eq!(
        report["axes"][0]["pulses_at_pins"], stopped,
        "no step was lost or invented on the way"
    );
    assert_eq!(report["timing_violations"], 0);
}

#[test]
fn linuxcnc_cuts_the_demo_program_and_the_pins_agree() {
    let folder = out("demo");
    let (soc, firmware) = ferrocnc_tests::parts();
    let log = folder.join("demo.log");
    let file = std::fs::File::create(&log).expect("a log");
    let run = Command::new("python3")
        .arg(root().join("tests/demo/run.py"))
        .args([&soc, &firmware, &folder])
        .arg("--simulator")
        .arg(ferrocnc_tests::program("ferrocnc-sim"))
        .stdin(Stdio::null())
        .stdout(file.try_clone().expect("its log"))
        .stderr(file)
        .status();
    let said = std::fs::read_to_string(&log).unwrap_or_default();
    assert!(
        run.is_ok_and(|status| status.success()),
        "the run failed:\n{said}"
    );
    let report = Command::new(root().join("target/venv/bin/python"))
        .arg(root().join("tests/demo/report.py"))
        .arg(&folder)
        .arg("--json")
        .arg(folder.join("demo.json"))
        .output()
        .expect("the Python environment");
    let said = String::from_utf8_lossy(&report.stdout).into_owned();
    println!("{said}");
    assert!(
        report.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&report.stderr)
    );
}
