//! What one servo period costs the PC: the real driver in LinuxCNC's realtime on the twin, and in
//! turn with it a plain C component with the same system calls, the same bytes and as many pins
//! (`host/benches/benchudp.comp`), so that what else the machine does hits both.
//!
//! ```text
//!   round 1   stamp stamp read stamp write stamp     ferrocnc, alone in the thread
//!   round 1   stamp stamp read stamp write stamp     C, alone in the thread
//!   round 2   the same, C before ferrocnc; and so on
//! ```
//!
//! A stamp notes two clocks: the CPU time of the thread, which does not run while it sleeps (a wait
//! for an answer), and the monotonic clock, which does. The two stamps in front tell what a stamp
//! costs. In the shape `usual` no driver waits: `read` finds the answer to the last `write`. In the
//! shape `read-request` it waits for the answer of this period: then the elapsed time has the
//! responder in it, and those of the two drivers are not alike.
//!
//! The thread has the last processor, what answers has the first, both at a real-time priority
//! where the user may have one: to wake a program on the same processor costs a fifth of what it
//! costs on another one, and that would be all that is seen.
//!
//! The figures are of this machine in this run. Nothing is asserted about time.

mod session;

use crate::{build, root, setup, step, target};
use anyhow::Result;
use serde_json::{Value, json};
use session::{Session, twin};
use std::process::Command;

/// The board of the twin: six axes.
const BOARD: &str = build::BOARD;
/// The components in C, in `host/benches`.
const COMPONENTS: [&str; 2] = ["benchudp", "benchstamp"];
/// Seconds of a round that count.
const SECONDS: u64 = 5;
/// Seconds at each servo rate.
const RATE_SECONDS: u64 = 10;
/// Servo rates of which the driver's pins are read.
const RATES: [u64; 3] = [1000, 4000, 10_000];

/// How a thread calls the drivers.
struct Shape {
    name: &'static str,
    ours: &'static [&'static str],
    theirs: &'static [&'static str],
}

const SHAPES: [Shape; 2] = [
    Shape {
        name: "usual",
        ours: &["ferrocnc.0.read", "ferrocnc.0.write"],
        theirs: &["benchudp.0.read", "benchudp.0.write"],
    },
    Shape {
        name: "read-request",
        ours: &[
            "ferrocnc.0.read-request",
            "ferrocnc.0.read",
            "ferrocnc.0.write",
        ],
        theirs: &["benchudp.0.request", "benchudp.0.read", "benchudp.0.write"],
    },
];

/// Measures and prints.
pub fn run(rounds: u64) -> Result<()> {
    setup::run(setup::Need::LinuxCnc)?;
    build::driver_and_simulator()?;
    build::install_driver()?;
    for name in COMPONENTS {
        component(name)?;
    }
    step::heading("bench: host");
    let like = session::alike(BOARD)?;
    println!("{like}");
    let mut shapes = Vec::new();
    for shape in &SHAPES {
        shapes.push(compare(shape, &like, rounds)?);
    }
    let rates: Vec<Value> = RATES.into_iter().map(rate).collect::<Result<_>>()?;
    let report = json!({
        "board": BOARD,
        "scheduling": like.scheduling,
        "rounds": rounds,
        "seconds_per_round": SECONDS,
        "pins_in": like.inputs,
        "pins_out": like.outputs,
        "command_bytes": 4 * like.command,
        "status_bytes": 4 * like.status,
        "shapes": shapes,
        "rates": rates,
    });
    std::fs::create_dir_all(target("reports"))?;
    let path = target("reports/host.json");
    std::fs::write(&path, serde_json::to_string_pretty(&report)?)?;
    println!("figures: {}", path.display());
    Ok(())
}

/// Compiles a component in C and makes `loadrt` find it.
fn component(name: &str) -> Result<()> {
    let folder = target("bench-host");
    std::fs::create_dir_all(&folder)?;
    let source = format!("{name}.comp");
    std::fs::copy(
        root().join("host/benches").join(&source),
        folder.join(&source),
    )?;
    let mut compile = Command::new("bash");
    compile.arg("-c").arg(format!(
        "cd {} && halcompile --compile {source}",
        folder.display()
    ));
    let title = format!("compile {name} (C, halcompile)");
    step::run(&format!("bench-host-{name}"), &title, "2 s", &mut compile)?;
    build::install_module(&folder.join(format!("{name}.so")), name)
}

/// The rounds of one shape.
fn compare(shape: &Shape, like: &session::Alike, rounds: u64) -> Result<Value> {
    let mut seen = [Samples::new("ferrocnc"), Samples::new("C")];
    let functions = [shape.ours, shape.theirs];
    for round in 0..rounds {
        for turn in 0..2 {
            let which = (round as usize + turn) % 2;
            let rows = alone(shape.name, functions[which], like)?;
            seen[which].take(&rows);
        }
    }
    println!("\n{}: us per period", shape.name);
    println!(
        "  {:<10}{:>9}{:>30}{:>32}",
        "", "periods", "CPU: median, p99, max", "elapsed: median, p99, max"
    );
    let mut rows = Vec::new();
    for (samples, functions) in seen.iter_mut().zip(functions) {
        rows.push(samples.judge(functions));
    }
    let median = |row: &Value| row["cpu_us"]["median"].as_f64().unwrap_or(f64::NAN);
    let [ours, theirs] = [median(&rows[0]), median(&rows[1])];
    println!("  ferrocnc / C: {:.2} of the CPU time", ours / theirs);
    for (row, functions) in rows.iter_mut().zip(functions) {
        let calls = session::calls(BOARD, shape.name, functions, like)?;
        println!(
            "  system calls of {} per period: {}",
            row["name"].as_str().unwrap_or_default(),
            session::told(&calls)
        );
        row["calls"] = json!(calls.values().sum::<f64>());
        row["calls_by_name"] = json!(calls);
    }
    Ok(json!({
        "name": shape.name,
        "rows": rows,
        "cpu_ratio": ours / theirs,
        "cpu_more_us": ours - theirs,
    }))
}

/// One session with one driver in the thread; a row per period, a pair of times per interval.
fn alone(shape: &str, functions: &[&str], like: &session::Alike) -> Result<Vec<Vec<[i64; 2]>>> {
    let (mut session, _ends) = session::one(BOARD, shape, functions, like)?;
    session.stamped(functions, (SECONDS + 3) * 1000);
    session.run(SECONDS + 1)?;
    session.intervals(1500)
}

/// The driver alone at a servo rate, on a twin in real time.
fn rate(hz: u64) -> Result<Value> {
    let twin = twin(BOARD, &["--mode", "free"])?;
    let period = 1_000_000_000 / hz;
    let mut session = Session::new(&format!("rate-{hz}"), period);
    session.ferrocnc(twin.port);
    session.stamped(
        &["ferrocnc.0.read", "ferrocnc.0.write"],
        (RATE_SECONDS + 2) * hz,
    );
    let said = session.run(RATE_SECONDS)?;
    let pin = |name: &str| session::value(&said, &format!("ferrocnc.0.{name}"));
    let settled = (hz * 3 / 2) as usize;
    let starts = session.starts(settled)?;
    let mut samples = Samples::new("ferrocnc");
    samples.take(&session.intervals(settled)?);
    let [elapsed, cpu] = samples.whole.each_mut().map(|nanos| spread(nanos));
    let mut late: Vec<i64> = starts
        .windows(2)
        .map(|pair| pair[1] - pair[0] - period as i64)
        .collect();
    late.sort_unstable();
    let beyond = late.iter().filter(|nanos| **nanos > period as i64).count();
    let worst = late.last().copied().unwrap_or_default() as f64 / 1000.0;
    let (missing, margin) = (pin("packet-error-total"), pin("watchdog.margin-ns-min"));
    let periods = late.len();
    let enabled = pin("enabled").unwrap_or(0.0) != 0.0;
    let bitten = pin("watchdog.has-bitten").unwrap_or(0.0) != 0.0;
    let margin_us = margin.map(|nanos| nanos / 1000.0);
    println!(
        "{hz} Hz: {periods} periods, {} answers missing, least margin {} us of 5000; still armed: {enabled}, \
         bitten: {bitten}; the thread was late by {worst:.0} us at worst, and by a period or more \
         {beyond} times; the driver: CPU {:.1} us, elapsed {:.1} us, p99 {:.1} us",
        missing.unwrap_or(f64::NAN),
        margin_us.map_or("no".to_owned(), |us| format!("{us:.0}")),
        cpu[0],
        elapsed[0],
        elapsed[1],
    );
    Ok(json!({
        "name": format!("{} kHz", hz / 1000),
        "hz": hz,
        "periods": periods,
        "missing": missing,
        "margin_min_us": margin_us,
        "enabled_at_end": enabled,
        "bitten": bitten,
        "fast_way": pin("exchange.fast-way"),
        "long_way": pin("exchange.long-way"),
        "late_max_us": worst,
        "late_by_a_period": beyond,
        "cpu_us": cpu[0],
        "elapsed_us": {"median": elapsed[0], "p99": elapsed[1]},
    }))
}

/// The times of one driver.
struct Samples {
    name: &'static str,
    /// Per period: elapsed and CPU time.
    whole: [Vec<i64>; 2],
    /// CPU time of each function.
    each: Vec<Vec<i64>>,
}

impl Samples {
    fn new(name: &'static str) -> Self {
        Samples {
            name,
            whole: Default::default(),
            each: Vec::new(),
        }
    }

    /// Adds a session's periods, less what the stamps cost: the first interval has nothing else.
    fn take(&mut self, rows: &[Vec<[i64; 2]>]) {
        let stamp = [0, 1].map(|clock: usize| {
            let mut stamps: Vec<i64> = rows.iter().map(|row| row[0][clock]).collect();
            stamps.sort_unstable();
            stamps.get(stamps.len() / 2).copied().unwrap_or(0)
        });
        for row in rows {
            let spans = &row[1..];
            for (clock, into) in self.whole.iter_mut().enumerate() {
                into.push(spans.iter().map(|span| span[clock] - stamp[clock]).sum());
            }
            self.each.resize(spans.len(), Vec::new());
            for (span, into) in spans.iter().zip(&mut self.each) {
                into.push(span[1] - stamp[1]);
            }
        }
    }

    fn judge(&mut self, functions: &[&str]) -> Value {
        let [wall, cpu] = self.whole.each_mut().map(|nanos| spread(nanos));
        println!(
            "  {:<10}{:>9}{:>10.2}{:>10.2}{:>10.1}{:>12.2}{:>10.2}{:>10.1}",
            self.name,
            self.whole[0].len(),
            cpu[0],
            cpu[1],
            cpu[2],
            wall[0],
            wall[1],
            wall[2]
        );
        let mut each = json!({});
        for (function, nanos) in functions.iter().zip(&mut self.each) {
            let name = function.rsplit('.').next().unwrap_or_default();
            each[name] = json!(spread(nanos)[0]);
        }
        let named =
            |spread: [f64; 3]| json!({"median": spread[0], "p99": spread[1], "max": spread[2]});
        json!({
            "name": self.name,
            "periods": self.whole[0].len(),
            "cpu_us": named(cpu),
            "elapsed_us": named(wall),
            "cpu_median_us": each,
        })
    }
}

/// Median, 99th percentile and maximum, in microseconds.
fn spread(nanos: &mut [i64]) -> [f64; 3] {
    nanos.sort_unstable();
    let at = |percent: usize| {
        let place = (nanos.len() * percent / 100).min(nanos.len().saturating_sub(1));
        nanos.get(place).map_or(f64::NAN, |n| *n as f64 / 1000.0)
    };
    [at(50), at(99), at(100)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stamp_costs_is_taken_off_every_interval() {
        let rows = vec![vec![[100, 10], [1100, 510], [2100, 1010]]; 3];
        let mut samples = Samples::new("x");
        samples.take(&rows);
        assert_eq!(samples.whole, [vec![3000; 3], vec![1500; 3]]);
        assert_eq!(samples.each, [vec![500; 3], vec![1000; 3]]);
    }

    #[test]
    fn a_spread_is_median_p99_and_maximum() {
        let mut nanos: Vec<i64> = (0..1000).rev().map(|n| n * 1000).collect();
        assert_eq!(spread(&mut nanos), [500.0, 990.0, 999.0]);
    }
}
