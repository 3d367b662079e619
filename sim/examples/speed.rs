//! Measures how fast this computer simulates a board: `cargo run --release -p ferrocnc-sim
//! --example speed -- SOC_DIR [ELF] [CLOCKS]`.
//!
//! Without an ELF the CPU sits in a one-instruction loop; with one, the firmware boots and idles.

use std::path::PathBuf;
use std::time::Instant;

use sim::board::Board;
use sim::firmware::Image;
use sim::plant::Plant;
use sim::soc::{Manifest, Soc};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let dir = PathBuf::from(arguments.next().ok_or("which SoC directory?")?);
    let elf = arguments
        .next()
        .filter(|path| path != "-")
        .map(PathBuf::from);
    let clocks: u64 = arguments.next().map_or(Ok(3_000_000), |n| n.parse())?;
    let mut soc = Soc::load(&dir, false)?;
    let words = match elf {
        Some(path) => Image::read(&path, soc.rom_words())?.words,
        // j .
        None => vec![0x0000_006f; 64],
    };
    let mut board = Board::new(soc, Manifest::read(&dir)?.sys_clk_hz, Plant::direct(16));
    board.reset(|soc| soc.load_rom(&words));
    for _ in 0..3 {
        let (from, started) = (board.clock(), Instant::now());
        while board.clock() < from + clocks {
            board.run_until(from + clocks);
            while board.take_transfer().is_some() {}
        }
        let kcycles = clocks as f64 / started.elapsed().as_secs_f64() / 1e3;
        println!(
            "{kcycles:.0} kcycle/s, gate {}, {} pulses",
            board.pins().gate,
            board.edges.pulses()
        );
    }
    Ok(())
}
