//! Turnaround of the exchange on the simulated board, in clock cycles, and the size of the image
//! that does it.

use anyhow::{Context, Result};
use clap::Parser;
use ferrocnc_tests::{BenchMachine, parts, wired};
use object::{Object, ObjectSection, SectionKind};
use rand::{Rng, SeedableRng};
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
}

fn main() -> Result<()> {
    let options = Options::parse();
    let mut machine = BenchMachine::boot(wired::mill());
    let channels = machine.channels();
    let bytes = |words: usize| 4 * words + 42 + 12; // UDP/IP/Ethernet headers, preamble and FCS
    let (rx, tx) = (
        bytes(exchange::REQUEST_OVERHEAD + exchange::command_words(channels)),
        bytes(exchange::REQUEST_OVERHEAD + exchange::status_words(channels)),
    );
    machine.make_ready();
    let mut cases = Vec::new();
    for (name, reach) in [("at rest", 0.0), ("all axes moving", 200e3)] {
        let mut random = rand_pcg::Pcg32::seed_from_u64(7);
        let mut command = machine.enabled_command();
        for _ in 0..options.periods {
            for (rate, accel) in command.stepgen.iter_mut().take(channels.stepgens.into()) {
                *rate = Velocity::from_hz(
                    reach * (2.0 * random.random::<f64>() - 1.0),
                    machine.clock_hz(),
                );
                *accel = Accel::from_steps(1e8, machine.clock_hz());
            }
            machine.exchange_and_wait(&mut command);
        }
        cases.push((name, machine.turnaround_spread(options.periods)));
        command.stepgen = Command::default().stepgen;
        for _ in 0..5 {
            machine.exchange_and_wait(&mut command);
        }
    }
    // The console is shut while the machine is armed: silence until the watchdog has disarmed it.
    machine.run_millis(100);
    let stack = machine.stack_used();
    let services = wired::program().len();
    let image = image_sizes(&parts().1)?;

    println!(
        "| exchange, {} axes, {rx} bytes in, {tx} out | min | median | max | clocks |",
        channels.stepgens
    );
    println!("|---|---|---|---|---|");
    for (name, spread) in &cases {
        println!(
            "| {name} | {} | {} | {} | at {} MHz |",
            spread.min,
            spread.median,
            spread.max,
            machine.clock_hz() / 1e6
        );
    }
    println!(
        "image: text {} data {} bss {} stack {stack}, services {services} bytes",
        image.text, image.data, image.bss
    );

    let cases: Vec<_> = cases
        .iter()
        .map(|(name, spread)| {
            serde_json::json!({ "name": name, "rx_bytes": rx, "tx_bytes": tx, "turnaround_cycles": spread })
        })
        .collect();
    let report = serde_json::json!({
        "sys_clk_hz": machine.clock_hz(),
        "cases": cases,
        "image": { "text": image.text, "data": image.data, "bss": image.bss, "stack_max": stack, "services": services },
    });
    std::fs::write(&options.report, serde_json::to_string_pretty(&report)?)
        .with_context(|| format!("cannot write {}", options.report.display()))
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
