//! A card whose pins are configured: the Verilated image of the 5A-75B 8.0 with 8 step generators,
//! encoders and PWMs, and a flash with the configuration of a board file, or without one.

use ferrocnc_config::import::Imported;
use ferrocnc_config::source::Folder;
use ferrocnc_config::{Board, pins, read_board};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::plug::Plug;
use sim::rig::Setup;
use wire::pins::Built;

use crate::{flash, parts, root};

/// The image, in the folder of the simulated boards.
pub const IMAGE: &str = "5a-75b-8.0";
/// What it was built with.
pub const BUILT: Built = Built {
    stepgens: 8,
    encoders: 8,
    pwms: 8,
    lines: 56,
};

/// A board file of `boards/`, and its text.
pub fn file(name: &str) -> (Board, String) {
    let path = root().join("boards").join(format!("{name}.toml"));
    let board = read_board(&path).unwrap_or_else(|error| panic!("{error}"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{error}"));
    (board, text)
}

/// What `ferrocnc config import` makes of a JSON of LiteX-CNC, at the address the benches ask.
pub fn imported(json: &str) -> (Board, String) {
    let text = std::fs::read_to_string(root().join(json)).unwrap_or_else(|e| panic!("{json}: {e}"));
    let platforms = Folder::default();
    let text = text.replace("10.0.0.10", "192.168.2.50");
    let import = ferrocnc_config::import::litexcnc(json, &text, "imported", &platforms);
    let Imported { board, toml, .. } = import.unwrap_or_else(|error| panic!("{error}"));
    (board, toml)
}

/// The configuration of a board file for the image.
pub fn configuration((board, text): &(Board, String), generation: u32) -> Vec<u8> {
    pins::configuration(board, text, BUILT, generation).unwrap_or_else(|error| panic!("{error}"))
}

/// The chip of a new card.
pub fn new_chip() -> Nor {
    flash::factory(Part::W25Q32JV.with(Times::QUICK), flash::UID)
}

/// A chip with this as a copy of the configuration.
pub fn chip(copy: u32, configuration: &[u8]) -> Nor {
    let mut nor = new_chip();
    let area = flash::layout(&nor).pins_copy(copy);
    nor.preload(area.start as usize, configuration);
    nor
}

/// A card with this chip, wired as a board file says.
pub fn setup(chip: Nor, wired: &Board) -> Setup {
    let (fixed, firmware) = parts();
    let mut setup = Setup::new(&fixed.with_file_name(IMAGE), &firmware);
    setup.flash = Some(Shared::new(chip));
    setup.plug = Some(Plug::of(wired));
    setup
}

/// A card that has the configuration of a board file, and is wired so.
pub fn configured(file: &(Board, String)) -> Setup {
    setup(chip(0, &configuration(file, 1)), &file.0)
}
