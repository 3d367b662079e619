//! Real LinuxCNC on the twin, with faults: the cable is pulled in the middle of a G1, the board
//! restarts, LinuxCNC's realtime process is killed, frames are lost. Each time the operator is
//! told, the machine stops, nothing moves without a command of the operator, and after homing again
//! the same program ends at the same place.
//!
//! Home is an index at the machine itself (`tests/linuxcnc/complete/plant.toml`), so "the same
//! place" is a place at the pins, not a position in software. HAL exists once per machine, so these
//! tests run one after the other.

use ferrocnc_tests::Simulator;
use ferrocnc_tests::hal::{halrun, out, root};
use ferrocnc_tests::report_part;
use host::address;
use host::client::Client;
use host::driver::Driver;
use host::hal::fake::FakeHal;
use host::link::Link;
use serde_json::{Value, json};
use sim::edges::{Step, read_file};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Clocks per second, and per servo period.
const HZ: f64 = 60e6;
const PERIOD: u64 = 60_000;
/// The watchdog's timeout, and the longest stop: 40 mm/s at X's 2000 mm/s^2, Z's 1600 mm/s^2.
const WATCHDOG: f64 = 5e-3;
const SOFT_STOP: f64 = 40.0 / 1600.0;
/// Longer than both.
const LONELY_MS: u64 = 2000;
/// LinuxCNC hears of trouble a few periods before or after the board does.
const SOME_PERIODS: u64 = 8 * PERIOD;
/// Where the indexes are: X to what pid leaves alone (0.003 mm), Z to the step.
const X_HOME: i64 = 4000;
const Z_HOME: i64 = -1600;
/// A board in lockstep lives by the exchanges: a driver that waits for its answers depends on no
/// scheduler.
const PATIENT: &str = "setp ferrocnc.0.packet-read-timeout 2000000000\n";

fn json_of(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{path:?}: {e}"))
}

/// A twin with a plant, its records, and a way to give it trouble.
struct Shop {
    folder: PathBuf,
    twin: Simulator,
}

impl Shop {
    fn new(name: &str) -> Self {
        let folder = out(name);
        let config = root().join("tests/linuxcnc/complete/plant.toml");
        let file = |name: &str| folder.join(name).display().to_string();
        let twin = Simulator::twin(&[
            "--mode",
            "lockstep",
            "--plant",
            &config.display().to_string(),
            "--edges",
            &file("edges.bin"),
            "--report",
            &file("sim.json"),
        ]);
        Shop { folder, twin }
    }

    /// Runs LinuxCNC with the operator of `trouble.py`; returns its result.
    fn operator(&self, run: &str, trouble: &str, mend: &str) -> Value {
        let out = self.folder.join(run);
        let config = out.join("machine");
        std::fs::create_dir_all(&config).expect("a folder for the configuration");
        let cases = root().join("tests/linuxcnc");
        for file in [
            "complete/complete.hal",
            "trouble/trouble.ini",
            "trouble/trouble.py",
        ] {
            let name = Path::new(file).file_name().expect("a name");
            std::fs::copy(cases.join(file), config.join(name)).expect("a copy");
        }
        let done = self
            .twin
            .linuxcnc(&out)
            // Long enough for an answer on a busy computer, short enough for five missing ones.
            .args(["--read-timeout", "500000000", "--timeout", "300"])
            .arg("--config")
            .arg(&config)
            .args(["--ini", "trouble.ini", "--patience", "60", "--program"])
            .arg(cases.join("trouble/trouble.ngc"))
            .env("FERROCNC_CONTROL", self.twin.control().to_string())
            .env("FERROCNC_TROUBLE", trouble)
            .env("FERROCNC_MEND", mend)
            .status();
        let said = std::fs::read_to_string(out.join("run.log")).unwrap_or_default();
        // LinuxCNC itself ends with an error without its realtime process.
        assert!(
            trouble == "kill" || done.is_ok_and(|status| status.success()),
            "{trouble}: the run failed:\n{}",
            &said[said.len().saturating_sub(4000)..]
        );
        if trouble == "kill" {
            // The board's time goes on without its host.
            self.twin.run_ms(LONELY_MS);
        }
        json_of(&out.join("result.json"))
    }

    /// Ends the twin; its steps and its report.
    fn end(mut self) -> (Vec<Step>, Value) {
        self.twin.finish();
        let edges = std::fs::read(self.folder.join("edges.bin")).expect("the recorded edges");
        let (hz, steps) = read_file(&edges).expect("an edge file");
        assert_eq!(hz as f64, HZ);
        (steps, json_of(&self.folder.join("sim.json")))
    }
}

fn reached(result: &Value, name: &str) -> u64 {
    let clock = result["progress"][name].as_u64();
    clock.unwrap_or_else(|| panic!("no clock of {name} in {result:#}"))
}

/// Steps between two moments.
fn within(steps: &[Step], from: u64, to: u64) -> usize {
    let inside = steps.iter().filter(|s| (from..to).contains(&s.clock));
    inside.count()
}

/// The machine was moving, and came to rest in time.
fn stopped(steps: &[Step], trouble: u64, until: u64) {
    assert!(
        within(steps, trouble - 5 * PERIOD, trouble) > 50,
        "it did not move when it happened"
    );
    let bound = trouble + SOME_PERIODS + ((WATCHDOG + SOFT_STOP) * HZ) as u64;
    let last = steps.iter().rfind(|s| s.clock < until).expect("steps");
    println!(
        "last step {:.1} ms after it happened",
        (last.clock as i64 - trouble as i64) as f64 / HZ * 1e3
    );
    assert!(last.clock <= bound, "it went on for too long");
}

/// Every axis goes on from the step it stopped at.
fn no_step_is_missing(steps: &[Step], at: u64) {
    for channel in [0, 1, 2] {
        let before = steps.iter().rfind(|s| s.channel == channel && s.clock < at);
        let after = steps.iter().find(|s| s.channel == channel && s.clock >= at);
        let (before, after) = (before.expect("a step"), after.expect("a step"));
        assert_eq!(
            (before.count - after.count).abs(),
            1,
            "axis {channel} does not go on from where it stood"
        );
    }
}

fn at_home(report: &Value) {
    let pins = |axis: usize| report["axes"][axis]["pulses_at_pins"].as_i64();
    let x = pins(0).expect("pulses");
    assert!((x - X_HOME).abs() <= 2, "X ends at {x} steps");
    assert_eq!(pins(2), Some(Z_HOME), "Z ends beside its index");
    assert_eq!(report["timing_violations"], 0);
}

/// What our driver told the operator.
fn ours(heard: &Value) -> Vec<&str> {
    let heard = heard.as_array().expect("messages");
    let heard = heard.iter().filter_map(Value::as_str);
    heard.filter(|text| text.contains("ferrocnc")).collect()
}

/// The whole story of one kind of trouble.
fn story(name: &str, trouble: &str, mend: &str, told: &[&str]) -> Value {
    let shop = Shop::new(name);
    let result = shop.operator("run", trouble, mend);
    let (steps, report) = shop.end();

    let happened = reached(&result, "trouble");
    stopped(&steps, happened, reached(&result, "mend"));
    assert_eq!(result["off"]["enabled"], "FALSE");
    assert_eq!(result["off"]["io-error"], "TRUE");
    assert_eq!(
        result["back"]["enabled"], "FALSE",
        "the operator did not ask for it"
    );

    let heard = ours(&result["heard"]);
    assert_eq!(heard.len(), told.len(), "{heard:?}");
    for (heard, told) in heard.iter().zip(told) {
        assert!(heard.contains(told), "{heard:?} does not say {told:?}");
    }
    assert_eq!(ours(&result["heard_before"]), [""; 0]);
    assert_eq!(ours(&result["heard_after"]), [""; 0]);

    let moved = within(&steps, reached(&result, "mend"), reached(&result, "enable"));
    assert_eq!(moved, 0, "it moved when it was put right");
    let moved = within(
        &steps,
        reached(&result, "enable"),
        reached(&result, "enabled"),
    );
    assert_eq!(moved, 0, "it jumped when it was enabled");
    assert_eq!(result["enabled"]["enabled"], "TRUE");
    assert_eq!(result["enabled"]["io-error"], "FALSE");
    assert_eq!(result["enabled"]["fault-reason"], "0");
    at_home(&report);
    if trouble != "power" {
        no_step_is_missing(&steps, reached(&result, "enabled"));
    }
    result
}

#[test]
fn a_cable_pulled_during_a_g1_is_told_stops_the_machine_and_costs_a_homing() {
    let result = story("pulled", "pull", "plug", &["check cable"]);
    assert_eq!(result["off"]["fault-reason"], "5", "link down");
    assert_eq!(result["back"]["fault-reason"], "1", "the board's own word");
    assert_eq!(result["back"]["watchdog.has-bitten"], "TRUE");
    // It kept count.
    assert_eq!(
        result["back"]["stepgen.x.counts"],
        result["enabled"]["stepgen.x.counts"]
    );
}

#[test]
fn a_board_that_restarts_during_a_g1_is_told_and_never_armed_by_itself() {
    story("rebooted", "reboot", "", &["check cable", "has restarted"]);
}

#[test]
fn a_board_that_loses_its_supply_during_a_g1_does_not_move_the_position_linuxcnc_sees() {
    let result = story("dark", "power", "", &["check cable", "has restarted"]);
    let (off, back) = (&result["off"], &result["back"]);
    for axis in ["x", "y", "z"] {
        let counts = |when: &Value| -> i64 {
            let text = when[format!("stepgen.{axis}.counts")].as_str();
            text.and_then(|text| text.parse().ok()).expect("counts")
        };
        assert!((counts(off) - counts(back)).abs() <= 1, "{axis} jumped");
    }
    assert_eq!(back["position-trusted"], "FALSE");
}

#[test]
fn a_realtime_process_killed_during_a_g1_stops_the_machine_and_the_next_start_ends_at_the_same_place()
 {
    let shop = Shop::new("killed-twin");
    let killed = shop.operator("first", "kill", "");
    let result = shop.operator("second", "none", "");
    let (steps, report) = shop.end();
    stopped(
        &steps,
        reached(&killed, "trouble"),
        reached(&result, "enable"),
    );
    // The reason can be read, and nothing moved until the operator enabled and homed.
    assert_eq!(result["back"]["fault-reason"], "1", "watchdog");
    assert_eq!(result["back"]["enabled"], "FALSE");
    let rest = reached(&killed, "trouble") + SOME_PERIODS + ((WATCHDOG + SOFT_STOP) * HZ) as u64;
    assert_eq!(
        within(&steps, rest, reached(&result, "enabled")),
        0,
        "it moved by itself"
    );
    no_step_is_missing(&steps, reached(&result, "enabled"));
    at_home(&report);
}

#[test]
fn a_second_linuxcnc_on_the_same_board_is_told_the_owner_and_does_not_disturb_it() {
    let twin = Simulator::twin(&["--mode", "lockstep"]);
    let address = address::parse(&twin.udp().to_string(), 1234).expect("an address");
    let mut first = Client::open(&address).expect("a socket");
    let session = first.acquire().expect("the session");
    let said = halrun(
        "second",
        &format!("loadrt ferrocnc boards={}\n", twin.udp()),
    );
    let sentence = said.lines().find(|line| line.contains("is driven by"));
    let sentence = sentence.unwrap_or_else(|| panic!("no message named the owner:\n{said}"));
    // The simulated segment's address for this computer.
    assert!(sentence.contains("192.168.2.1:4"), "{sentence}");
    assert!(sentence.contains("stop LinuxCNC there"), "{sentence}");
    let token = first.read(&[wire::map::SESSION_TOKEN]);
    assert_eq!(token.expect("an answer"), [session.token]);
}

#[test]
fn what_is_loaded_or_added_twice_is_refused_and_the_first_goes_on() {
    // A board each: the first one's session ends with its time, which stands without exchanges.
    let twins = [0, 1].map(|_| Simulator::twin(&["--mode", "lockstep"]));
    let [first, second] = twins.each_ref().map(|twin| {
        let load = format!("loadrt ferrocnc boards={}\n", twin.udp());
        let begin = format!(
            "loadrt threads name1=servo period1=1000000 fp1=1\n{load}{PATIENT}addf ferrocnc.0.read servo\naddf ferrocnc.0.write servo\n"
        );
        (begin, load)
    });
    let said = halrun(
        "added-twice",
        &format!("{}addf ferrocnc.0.write servo\n", first.0),
    );
    assert!(
        said.contains("'ferrocnc.0.write' may only be added to one thread"),
        "{said}"
    );
    let (begin, load) = second;
    let said = halrun(
        "loaded-twice",
        &format!("{begin}start\nloadusr -w sleep 1\n{load}"),
    );
    assert!(said.contains("ferrocnc: already exists"), "{said}");
    assert!(
        !said.contains("answers missing"),
        "the first one was disturbed:\n{said}"
    );
}

/// Unloads under the real rtapi; a thousand in `FERROCNC_UNLOADS`, which takes a while.
const UNLOADS: u64 = 4;
/// HAL's memory is never given back, so a session of it takes no more than some dozens.
const UNLOADS_PER_SESSION: u64 = 20;

#[test]
fn a_driver_unloaded_while_armed_and_moving_leaves_its_threads_running_and_its_board_stopped() {
    let mut left = ferrocnc_tests::from_environment("FERROCNC_UNLOADS", UNLOADS);
    let mut done = 0;
    while left > 0 {
        let times = left.min(UNLOADS_PER_SESSION);
        unload_often(times);
        left -= times;
        done += times;
        println!("{done} unloaded while armed");
    }
}

/// One session of HAL in which the driver is loaded, armed, moves an axis, and is unloaded, again
/// and again; the thread runs all the while.
fn unload_often(times: u64) {
    let file = out("unloaded").join("sim.json");
    let mut twin = Simulator::twin(&[
        "--mode",
        "lockstep",
        "--report",
        &file.display().to_string(),
    ]);
    // Toggles `enable-request` until the board is armed; a period may take long.
    let armed = root().join("tests/linuxcnc/trouble/armed.sh");
    let mut hal = String::from("loadrt threads name1=servo period1=1000000 fp1=1\nstart\n");
    for _ in 0..times {
        hal += &format!("loadrt ferrocnc boards={}\n{PATIENT}", twin.udp());
        hal += "addf ferrocnc.0.read servo\naddf ferrocnc.0.write servo\n";
        hal +=
            "setp ferrocnc.0.stepgen.x.maxaccel 100000\nsetp ferrocnc.0.stepgen.x.control-type 1\n";
        hal += "setp ferrocnc.0.stepgen.x.velocity-cmd 5000\nsetp ferrocnc.0.stepgen.x.enable 1\n";
        hal += "setp ferrocnc.0.enable 1\n";
        hal += &format!("loadusr -w bash {}\n", armed.display());
        hal += "getp ferrocnc.0.enabled\nunloadrt ferrocnc\n";
    }
    // The thread is still there, and runs.
    hal += "loadusr -w sleep 0.1\nshow thread\n";
    let said = halrun("unloaded", &hal);
    let rest = at_rest(&twin);
    twin.finish();
    assert!(rest, "the board is released and not at rest:\n{said}");
    let armed = said.lines().filter(|line| *line == "TRUE").count();
    assert_eq!(armed as u64, times, "{said}");
    assert!(said.contains("servo"), "the thread is gone:\n{said}");
    for word in ["ERROR", "rror:", "ault", "answers missing", "internal"] {
        assert!(!said.contains(word), "{word}:\n{said}");
    }
    let report = json_of(&file);
    let x = &report["axes"][0];
    assert!(
        x["pulses_total"].as_i64() > Some(times as i64),
        "it hardly moved: {x}"
    );
    assert_eq!(report["timing_violations"], 0);
}

/// Has the released board closed its gate, a while later?
fn at_rest(twin: &Simulator) -> bool {
    twin.run_ms(LONELY_MS);
    let address = address::parse(&twin.udp().to_string(), 1234).expect("an address");
    let mut client = Client::open(&address).expect("a socket");
    let state = client.identify().expect("a board").describe.state;
    let owner = client.read(&[wire::map::SESSION_OWNER_IP]);
    !state.enabled && owner.is_ok_and(|owner| owner == [0])
}

/// How often `loss.ngc` goes round.
const ROUNDS: &str = "repeat [3]";
/// How long the driver waits for an answer, ns. The bucket overflows when this computer stands
/// still for five times as long. Every lost frame costs as much.
const LOSSY_PATIENCE: u64 = 500_000_000;

/// The mill cuts `loss.ngc` with so many rounds while frames are lost with this probability each
/// way; what came of it.
fn mill_losing(loss: &str, rounds: u32) -> Value {
    let shop = Shop::new(&format!("loss-{}", loss.replace('%', "")));
    let out = shop.folder.join("run");
    std::fs::create_dir_all(&out).expect("a folder");
    let source = root().join("tests/linuxcnc/trouble/loss.ngc");
    let source = std::fs::read_to_string(&source).unwrap_or_else(|e| panic!("{source:?}: {e}"));
    assert_eq!(source.matches(ROUNDS).count(), 1, "the rounds of loss.ngc");
    let program = shop.folder.join("loss.ngc");
    let text = source.replace(ROUNDS, &format!("repeat [{rounds}]"));
    std::fs::write(&program, text).expect("the program");
    let seed = ferrocnc_tests::seed();
    ferrocnc_tests::control(
        shop.twin.control(),
        &format!("fault loss={loss} seed={seed}"),
    );
    let _ = shop
        .twin
        .linuxcnc(&out)
        .args(["--read-timeout", &LOSSY_PATIENCE.to_string()])
        .args(["--timeout", "300", "--program"])
        .arg(&program)
        .status();
    let mut result = json_of(&out.join("result.json"));
    result["seed"] = json!(seed);
    // Runs of missing answers, as the recording shows them.
    let samples = std::fs::read_to_string(out.join("samples.csv")).expect("the recording");
    let mut lines = samples.lines();
    let head: Vec<&str> = lines.next().expect("a head").split(',').collect();
    let at = head
        .iter()
        .position(|name| *name == "packet_errors")
        .expect("its column");
    let errors: Vec<u64> = lines
        .filter_map(|line| line.split(',').nth(at)?.trim().parse().ok())
        .collect();
    let (mut run, mut longest) = (0u64, 0u64);
    for pair in errors.windows(2) {
        run = if pair[1] > pair[0] { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    result["longest_gap"] = json!(longest);
    shop.end();
    result
}

/// How far feedback may be from command on a lossy network, in steps: three of rounding and of a
/// velocity held for a period too long, and a period's travel for every answer missing in a row
/// beyond the first, which is bridged.
fn following_bound(axis: &Value, longest_gap: u64) -> f64 {
    let travel = axis["speed_max_steps_per_s"].as_f64().expect("a speed") / 1000.0;
    3.0 + travel * longest_gap.saturating_sub(1) as f64
}

#[test]
fn a_program_on_a_lossy_network_finishes_with_a_bounded_following_error_or_stops_as_the_bucket_says()
 {
    let mut rows = Vec::new();
    // The more frames are lost, the fewer rounds: each lost one is waited for.
    for (loss, rounds) in [("0.01%", 3), ("0.1%", 3), ("1%", 1)] {
        let result = mill_losing(loss, rounds);
        let gap = result["longest_gap"].as_u64().expect("a number");
        let seed = &result["seed"];
        assert_eq!(
            result["exit"], 0,
            "loss {loss}, seed {seed}: {}",
            result["text"]
        );
        assert_eq!(ours(&result["messages"]), [""; 0]);
        let mut worst = 0.0f64;
        for axis in result["axes"].as_array().expect("axes") {
            let error = axis["following_error_max_steps"]
                .as_f64()
                .expect("a number");
            let bound = following_bound(axis, gap);
            assert!(
                error <= bound,
                "loss {loss}, seed {seed}: {} follows {error:.1} steps behind, {bound:.1} allowed",
                axis["name"]
            );
            assert_eq!(
                axis["deviation_at_rest_steps"], 0,
                "loss {loss}, seed {seed}"
            );
            worst = worst.max(error);
        }
        println!(
            "loss {loss}: {} periods, {} without an answer, at most {gap} in a row; following error {worst:.1} steps",
            result["servo_periods"], result["packet_errors"]
        );
        rows.push(json!({
            "loss": loss,
            "finished": true,
            "exchanges": result["servo_periods"],
            "missing": result["packet_errors"],
            "longest_gap": gap,
            "following_error_max_steps": worst,
            "steps_per_mm": 400,
            "seed": seed,
        }));
    }
    // So much that the bucket fills: it says so, once, and the machine is off.
    let result = mill_losing("30%@4s", 3);
    let ours = ours(&result["messages"]);
    assert!(
        [4, 6].map(Value::from).contains(&result["exit"]),
        "{}",
        result["text"]
    );
    assert_eq!(ours.len(), 1, "{ours:?}");
    assert!(ours[0].contains("too many answers missing"), "{ours:?}");
    rows.push(json!({
        "loss": "30% from 4 s on",
        "finished": false,
        "exchanges": result["servo_periods"],
        "missing": result["packet_errors"],
        "longest_gap": result["longest_gap"],
        "seed": result["seed"],
    }));
    report_part("loss", "programs", json!(rows));
}

/// Exchanges of the long run; fewer in `FERROCNC_EXCHANGES`.
const EXCHANGES: u64 = 1_000_000;

#[test]
fn at_one_frame_in_ten_thousand_nothing_stops_over_a_million_exchanges() {
    let given = std::env::var("FERROCNC_EXCHANGES").ok();
    let exchanges = given
        .and_then(|text| text.parse().ok())
        .unwrap_or(EXCHANGES);
    let seed = ferrocnc_tests::seed();
    let file = out("million").join("sim.json");
    let mut twin = Simulator::twin(&[
        "--mode",
        "lockstep",
        "--fault",
        &format!("loss=0.01% seed={seed}"),
        "--report",
        &file.display().to_string(),
    ]);
    let mut hal = FakeHal::new();
    let address = address::parse(&twin.udp().to_string(), 1234).expect("an address");
    let mut client = Client::open(&address).expect("a socket");
    let identity = client.identify().expect("a board");
    client.acquire().expect("the session");
    let link = Link::new(client.into_socket()).expect("a link");
    let say = hal.messenger();
    let mut driver = Driver::export(&mut hal, 0, address, &identity, link, say).expect("pins");
    let x = |pin: &str| format!("ferrocnc.0.stepgen.x.{pin}");
    // 100 ms: even on a busy computer one of five answers in a row has come by then.
    hal.set("ferrocnc.0.packet-read-timeout", 100_000_000);
    hal.set(&x("position-scale"), 400.0);
    hal.set(&x("maxaccel"), 3000.0);
    hal.set("ferrocnc.0.enable", true);
    let mut period = |hal: &FakeHal, at: f64| {
        hal.set(&x("position-cmd"), at);
        driver.read(1_000_000);
        driver.write(1_000_000);
        hal.get::<f64>(&x("position-fb"))
    };
    for n in 0..300 {
        hal.set("ferrocnc.0.enable-request", n > 200);
        period(&hal, 0.0);
        // The session is asked for every 100 periods, without a wait for the answer.
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(hal.get::<bool>("ferrocnc.0.enabled"), "{:?}", hal.said());
    hal.set(&x("enable"), true);
    let (mut commanded, mut worst) = (0.0f64, 0.0f64);
    for n in 0..exchanges {
        // There and back once in two seconds, 50 mm/s at most.
        let at = 16.0 * (1.0 - (n as f64 / 1000.0 * core::f64::consts::PI).cos());
        let fb = period(&hal, at);
        worst = worst.max((fb - commanded).abs() * 400.0);
        commanded = at;
        assert!(
            hal.get::<bool>("ferrocnc.0.enabled"),
            "seed {seed}: stopped after {n} exchanges: {:?}",
            hal.said()
        );
    }
    for _ in 0..200 {
        period(&hal, commanded);
    }
    let missing: u32 = hal.get("ferrocnc.0.packet-error-total");
    let counts: i32 = hal.get(&x("counts"));
    assert!(
        u64::from(missing) > exchanges / 20_000,
        "seed {seed}: nothing was lost"
    );
    twin.finish();
    let pins = json_of(&file)["axes"][0]["pulses_at_pins"].as_i64();
    assert_eq!(pins, Some(i64::from(counts)), "seed {seed}");
    assert_eq!(
        i64::from(counts),
        (commanded * 400.0).round() as i64,
        "seed {seed}"
    );
    println!(
        "{exchanges} exchanges, {missing} without an answer, following error at most {worst:.1} steps"
    );
    report_part(
        "loss",
        "million",
        json!({
            "loss": "0.01%",
            "exchanges": exchanges,
            "missing": missing,
            "stopped": 0,
            "following_error_max_steps": worst,
            "seed": seed,
        }),
    );
}
