//! Prints where the clocks of an exchange are spent: `cargo run --release -p ferrocnc-sim --example
//! profile -- SOC_DIR ELF [EXCHANGES]`.
//!
//! Acquires a session, makes exchanges a servo period apart, and charges every clock between the
//! last request byte and the first reply byte to the source line of the instruction that left the
//! pipeline last (a stall is charged to the instruction before it). Prints clocks per exchange and
//! line; needs `riscv64-unknown-elf-addr2line` to see through inlining.

use std::collections::BTreeMap;
use std::process::Command;

use sim::lan_segment::{BOARD_PORT, HOST_IP};
use sim::rig::{RIG_PORT, Rig};
use wire::describe::Channels;
use wire::exchange;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [soc, elf, rest @ ..] = &arguments[..] else {
        return Err("usage: profile SOC_DIR ELF [EXCHANGES]".into());
    };
    let exchanges: u32 = rest.first().map_or(Ok(20), |n| n.parse())?;
    let mut rig = Rig::start(soc.as_ref(), elf.as_ref())?;
    let [c0, c1] = rig.read_words(&[0x1c, 0x20]).ok_or("no description")?[..] else {
        unreachable!("two were asked for")
    };
    let channels = Channels {
        stepgens: c0 as u8,
        encoders: (c0 >> 8) as u8,
        pwms: (c0 >> 16) as u8,
        inputs: c1 as u8,
        outputs: (c1 >> 8) as u8,
    };
    rig.write_words(wire::map::SESSION_ACQUIRE, &[0x5eed]);
    let token = rig.read_word(wire::map::SESSION_TOKEN).ok_or("no token")?;
    let mut command = exchange::Command {
        token,
        enable: true,
        ..exchange::Command::default()
    };
    let (mut charged, mut total) = (BTreeMap::<u32, u64>::new(), 0);
    for n in 0..exchanges + 5 {
        command.sequence = n + 1;
        command.enable_request = n > 1;
        let mut buffer = [0; wire::MAX_WORDS];
        let words = command
            .emit_request(channels, &mut buffer)
            .ok_or("too long")?;
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_be_bytes()).collect();
        let start = rig.clock();
        rig.post((HOST_IP, RIG_PORT), BOARD_PORT, &bytes);
        rig.advance(start + 1);
        let mut at = None;
        let mut clocks = Vec::new();
        while rig.pins().gmii_tx_en == 0 && rig.clock() < start + 60_000 {
            rig.advance(rig.clock() + 1);
            at = rig.board.silicon().pc().or(at);
            if rig.pins().gmii_rx_dv == 0 {
                clocks.push(at);
            }
        }
        // The first few fill the caches and open the gate.
        if n >= 5 {
            total += clocks.len() as u64;
            for pc in clocks.into_iter().flatten() {
                *charged.entry(pc).or_default() += 1;
            }
        }
        rig.run_while(start + 60_000, |_| true);
    }
    println!(
        "{:8.1} clocks per exchange",
        total as f64 / f64::from(exchanges)
    );
    let mut lines = BTreeMap::<String, u64>::new();
    for (place, clocks) in places(elf, charged.keys())?
        .into_iter()
        .zip(charged.values())
    {
        *lines.entry(place).or_default() += clocks;
    }
    let mut lines: Vec<_> = lines.into_iter().collect();
    lines.sort_by_key(|(_, clocks)| std::cmp::Reverse(*clocks));
    for (place, clocks) in lines.iter().take(60) {
        println!("{:8.1} {place}", *clocks as f64 / f64::from(exchanges));
    }
    Ok(())
}

/// Innermost function and line of each address.
fn places<'a>(elf: &str, addresses: impl Iterator<Item = &'a u32>) -> std::io::Result<Vec<String>> {
    let output = Command::new("riscv64-unknown-elf-addr2line")
        .args(["-f", "-C", "-s", "-e", elf])
        .args(addresses.map(|a| format!("{a:#x}")))
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let lines: Vec<&str> = text.lines().collect();
    Ok(lines
        .chunks(2)
        .map(|pair| format!("{:40} {}", pair.get(1).unwrap_or(&""), pair[0]))
        .collect())
}
