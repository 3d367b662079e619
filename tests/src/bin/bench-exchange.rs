//! The exchange on the simulated board, on its fast way through the gateware and on the long one
//! through the firmware: turnaround in clock cycles, the whole exchange with its time on the wire
//! in microseconds; and the size of the image.

use anyhow::{Context, Result};
use clap::Parser;
use ferrocnc_tests::{BenchMachine, parts, wired};
use object::{Object, ObjectSection, SectionKind};
use rand::{Rng, SeedableRng};
use serde_json::{Value, json};
use sim::exchange::Spread;
use std::path::{Path, PathBuf};
use wire::exchange::{self, Command};
use wire::units::{Accel, Velocity};

/// The board and the image are those of the tests (`ferrocnc_tests::parts`).
#[derive(Parser)]
struct Options {
    /// Where the figures go.
    #[arg(long)]
    report: PathBuf,
    /// Servo periods measured per case.
    #[arg(long, default_value_t = 300)]
    periods: usize,
    /// The folder of the simulated board with the most channels, to be measured, too.
    #[arg(long)]
    largest: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let mut machine = BenchMachine::boot(wired::mill());
    let mill = measure(&mut machine, options.periods);
    mill.print();
    // The console is shut while the machine is armed: silence until the watchdog has disarmed it.
    machine.run_millis(100);
    let stack = machine.stack_used();
    let services = wired::program().len();
    let without_jobs = wired::program_without_jobs().len();
    let image = image_sizes(&parts().1)?;
    println!(
        "image: text {} data {} bss {} stack {stack}, services {services} bytes, {without_jobs} without jobs",
        image.text, image.data, image.bss
    );
    let mut report = mill.report();
    report["image"] = json!({
        "text": image.text, "data": image.data, "bss": image.bss, "stack_max": stack,
        "services": services, "services_without_jobs": without_jobs,
    });

    if let Some(largest) = options.largest {
        let mut setup = wired::mill();
        setup.soc_dir = largest;
        let largest = measure(&mut BenchMachine::boot(setup), options.periods);
        largest.print();
        report["largest"] = largest.report();
    }
    std::fs::write(&options.report, serde_json::to_string_pretty(&report)?)
        .with_context(|| format!("cannot write {}", options.report.display()))
}

/// The exchanges of a board that has just started.
fn measure(machine: &mut BenchMachine, periods: usize) -> Measured {
    let channels = machine.channels();
    let bytes = |words: usize| 4 * words + 42 + 12; // UDP/IP/Ethernet headers, preamble and FCS
    let mut cases = vec![first(machine)];
    machine.make_ready();
    for (name, reach, long) in [
        ("at rest", 0.0, false),
        ("all axes moving", 200e3, false),
        ("the long way, at rest", 0.0, true),
        ("the long way, all axes moving", 200e3, true),
    ] {
        let mut random = rand_pcg::Pcg32::seed_from_u64(7);
        let mut command = machine.enabled_command();
        // The pass behind the reading of the counters is out.
        let before = machine.ways();
        machine.run_millis(1);
        for n in 0..periods {
            for (velocity, accel) in command.stepgen.iter_mut().take(channels.stepgens.into()) {
                *velocity = Velocity::from_hz(
                    reach * (2.0 * random.random::<f64>() - 1.0),
                    machine.clock_hz(),
                );
                *accel = Accel::from_steps(1e8, machine.clock_hz());
            }
            // No frame is like the one before it.
            machine.rig().segment.ttl = if long { 63 - (n % 2) as u8 } else { 64 };
            machine.exchange_and_wait(&mut command);
        }
        machine.rig().segment.ttl = 64;
        let after = machine.ways();
        cases.push(Case {
            name,
            fast: after.fast - before.fast,
            long: after.long - before.long,
            turnaround: machine.turnaround_spread(periods),
            total: machine.total_spread(periods),
        });
        command.stepgen = Command::default().stepgen;
        for _ in 0..5 {
            machine.exchange_and_wait(&mut command);
        }
    }
    Measured {
        axes: channels.stepgens,
        clock_hz: machine.clock_hz(),
        rx: bytes(exchange::REQUEST_OVERHEAD + exchange::command_words(channels)),
        tx: bytes(exchange::REQUEST_OVERHEAD + exchange::status_words(channels)),
        cases,
    }
}

/// The exchanges of a board.
struct Measured {
    axes: u8,
    clock_hz: f64,
    /// Bytes of a request on the wire.
    rx: usize,
    /// Bytes of an answer.
    tx: usize,
    cases: Vec<Case>,
}

impl Measured {
    fn print(&self) {
        println!(
            "| exchange, {} axes, {} bytes in, {} out | fast way, long way | turnaround min / median / max, clocks at {} MHz | whole exchange min / median / max, us |",
            self.axes,
            self.rx,
            self.tx,
            self.clock_hz / 1e6
        );
        println!("|---|---|---|---|");
        for case in &self.cases {
            let Spread { min, median, max } = case.turnaround;
            let [least, middle, most] = case.micros(self.clock_hz);
            println!(
                "| {} | {}, {} | {min} / {median} / {max} | {least:.2} / {middle:.2} / {most:.2} |",
                case.name, case.fast, case.long
            );
        }
    }

    fn report(&self) -> Value {
        let case = |case: &Case| {
            let [min, median, max] = case.micros(self.clock_hz);
            json!({
                "name": case.name,
                "rx_bytes": self.rx,
                "tx_bytes": self.tx,
                "fast": case.fast,
                "long": case.long,
                "turnaround_cycles": case.turnaround,
                "total_us": { "min": min, "median": median, "max": max },
            })
        };
        let cases: Vec<_> = self.cases.iter().map(case).collect();
        json!({ "sys_clk_hz": self.clock_hz, "cases": cases })
    }
}

/// What was measured of some exchanges.
struct Case {
    name: &'static str,
    /// How many took the fast and the long way, by the board's own counters.
    fast: u32,
    long: u32,
    /// Last byte in to first byte out.
    turnaround: Spread,
    /// First byte in to last byte out.
    total: Spread,
}

impl Case {
    /// The whole exchanges.
    fn micros(&self, clock_hz: f64) -> [f64; 3] {
        let Spread { min, median, max } = self.total;
        [min, median, max].map(|clocks| clocks as f64 * 1e6 / clock_hz)
    }
}

/// The first exchange since power-up, for which the firmware has handed out no pass.
fn first(machine: &mut BenchMachine) -> Case {
    let before = machine.ways();
    machine.acquire();
    machine.run_millis(1);
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let (turnaround, total) = (machine.turnaround_spread(1), machine.total_spread(1));
    let after = machine.ways();
    Case {
        name: "the first since power-up",
        fast: after.fast - before.fast,
        long: after.long - before.long,
        turnaround,
        total,
    }
}

struct Sizes {
    text: u64,
    data: u64,
    bss: u64,
}

fn image_sizes(elf: &Path) -> Result<Sizes> {
    let bytes = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let file =
        object::File::parse(&*bytes).with_context(|| format!("{} is no ELF", elf.display()))?;
    let mut sizes = Sizes {
        text: 0,
        data: 0,
        bss: 0,
    };
    for section in file.sections() {
        let reserved = section
            .name()
            .is_ok_and(|name| name.contains("stack") || name.contains("heap"));
        match section.kind() {
            _ if reserved => {}
            SectionKind::Text | SectionKind::ReadOnlyData | SectionKind::ReadOnlyString => {
                sizes.text += section.size()
            }
            SectionKind::Data => sizes.data += section.size(),
            SectionKind::UninitializedData => sizes.bss += section.size(),
            _ => {}
        }
    }
    Ok(sizes)
}
