//! The description of a board without its gateware: the information blob and the clock.
//!
//! The crate `config` reads the board files. The twin carries some of `boards/` and reads any other
//! that is named with its path; for boards that have no file this module reads what elaboration
//! wrote into `target/sim/NAME`.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ferrocnc_config::source::Folder;
use wire::board::{Blob, HEADER_LEN, Kind, MAGIC, VERSION, crc32};
use wire::describe::Channels;

use crate::error::Error;
use crate::soc::Manifest;

/// A board's facts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardFacts {
    /// The blob.
    pub blob: Vec<u8>,
    /// Hertz.
    pub clock_hz: u32,
    /// How many of each.
    pub channels: Channels,
    /// Inputs that stop the machine, one bit each.
    pub estop_mask: u32,
    /// The level at which they do.
    pub estop_level: u32,
    /// Axes of its jobs; 0 without any.
    pub jobs: u8,
    /// Its gateware uses the SDRAM: it has services, and executes jobs by itself.
    pub sdram: bool,
}

/// The board files that the twin carries.
const BUILT_IN: [(&str, &str); 5] = [
    (
        "75b_v8_14o11i6s6e6p",
        include_str!("../../boards/75b_v8_14o11i6s6e6p.toml"),
    ),
    ("max", include_str!("../../boards/max.toml")),
    ("mill6", include_str!("../../boards/mill6.toml")),
    ("plotter", include_str!("../../boards/plotter.toml")),
    ("wide", include_str!("../../tests/boards/wide.toml")),
];

impl BoardFacts {
    /// The board of this name: one of the board files carried here, or what elaboration left in
    /// `target/sim/NAME`. A name that ends with `.toml` is a board file.
    pub fn named(name: &str) -> Result<Self, Error> {
        if name.ends_with(".toml") {
            let board = ferrocnc_config::read_board(Path::new(name));
            return Self::of_board(name, board);
        }
        // Tests start thousands of boards.
        static PARSED: [OnceLock<BoardFacts>; BUILT_IN.len()] =
            [const { OnceLock::new() }; BUILT_IN.len()];
        let mut built_in = BUILT_IN.iter().zip(&PARSED);
        let Some(((_, text), parsed)) = built_in.find(|((known, _), _)| *known == name) else {
            let folder = elaborated(name);
            if folder.join("board.bin").is_file() {
                return Self::read(&folder);
            }
            return Err(Error::Board {
                name: name.into(),
                why: format!(
                    "there is no {}, and it is not one of {:?}; name a board file with its path (mill.toml), or give --channels and --clock",
                    folder.join("board.bin").display(),
                    BUILT_IN.map(|(known, _)| known)
                ),
            });
        };
        if let Some(parsed) = parsed.get() {
            return Ok(parsed.clone());
        }
        let read = Self::from_file(name, text)?;
        Ok(parsed.get_or_init(|| read).clone())
    }

    /// The board that a board file of `boards/` describes.
    fn from_file(name: &str, text: &str) -> Result<Self, Error> {
        let file = format!("boards/{name}.toml");
        let board = ferrocnc_config::Board::read(&file, name, text, &Folder::default());
        Self::of_board(name, board)
    }

    /// The board that a board file describes, if it could be read.
    fn of_board(
        name: &str,
        board: Result<ferrocnc_config::Board, ferrocnc_config::Error>,
    ) -> Result<Self, Error> {
        let refused = |error: ferrocnc_config::Error| Error::Board {
            name: name.into(),
            why: error.to_string(),
        };
        let board = board.map_err(refused)?;
        let blob = ferrocnc_config::blob::blob(&board).map_err(refused)?;
        Ok(BoardFacts {
            jobs: board.jobs as u8,
            sdram: board.sdram,
            ..Self::parse(name, blob, board.sys_clk_hz.into())?
        })
    }

    /// The board with `board.bin` and `manifest.json` in this folder.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let manifest = Manifest::read(folder)?;
        let path = folder.join("board.bin");
        let blob = std::fs::read(&path).map_err(|source| Error::Read {
            path: path.clone(),
            source,
        })?;
        Self::parse(&path.display().to_string(), blob, manifest.sys_clk_hz)
    }

    /// A board without a board file: so many stepgens, encoders, PWMs, inputs and outputs.
    pub fn plain(channels: Channels, clock_hz: u32) -> Self {
        let mut body = Vec::new();
        let mut entry = |kind: u8, channel: u8, text: &str| {
            body.extend([kind, channel, text.len() as u8, 0]);
            body.extend(text.bytes());
            body.resize(body.len().next_multiple_of(4), 0);
        };
        entry(1, 0, "twin");
        entry(2, 0, "twin");
        let c = channels;
        let counts = [
            (3, c.stepgens),
            (4, c.encoders),
            (5, c.pwms),
            (6, c.inputs),
            (7, c.outputs),
        ];
        for (kind, count) in counts {
            for n in 0..count {
                entry(kind, n, &n.to_string());
            }
        }
        let head = [
            MAGIC,
            VERSION,
            (HEADER_LEN + body.len()) as u32,
            crc32(&body),
        ];
        let mut blob: Vec<u8> = head.iter().flat_map(|word| word.to_be_bytes()).collect();
        blob.extend(body);
        BoardFacts {
            blob,
            clock_hz,
            channels,
            estop_mask: 0,
            estop_level: 0,
            jobs: 0,
            sdram: true,
        }
    }

    fn parse(name: &str, blob: Vec<u8>, clock_hz: u64) -> Result<Self, Error> {
        let wrong = |why: String| Error::Board {
            name: name.into(),
            why,
        };
        let checked = Blob::new_checked(&blob).map_err(|e| wrong(e.to_string()))?;
        let mut channels = Channels::default();
        let (mut estop_mask, mut estop_level) = (0, 0);
        for entry in checked.entries() {
            match entry.kind {
                Kind::Stepgen => channels.stepgens += 1,
                Kind::Encoder => channels.encoders += 1,
                Kind::Pwm => channels.pwms += 1,
                Kind::Input => channels.inputs += 1,
                Kind::Output => channels.outputs += 1,
                Kind::Pins => {
                    let text = std::str::from_utf8(entry.value).unwrap_or_default();
                    let level = text.strip_prefix('i').and_then(|pins| {
                        pins.split(' ').find_map(|pin| pin.strip_prefix("estop="))
                    });
                    if let Some(level) = level {
                        estop_mask |= 1 << (entry.channel & 31);
                        estop_level |= u32::from(level == "high") << (entry.channel & 31);
                    }
                }
                Kind::Board
                | Kind::Configuration
                | Kind::Mac
                | Kind::Ipv4
                | Kind::Port
                | Kind::Fpga
                | Kind::Platform => {}
            }
        }
        Ok(BoardFacts {
            clock_hz: u32::try_from(clock_hz).map_err(|e| wrong(e.to_string()))?,
            channels,
            estop_mask,
            estop_level,
            jobs: 0,
            sdram: true,
            blob,
        })
    }

    /// The blob as the words of its ROM.
    pub fn words(&self) -> Vec<u32> {
        let chunks = self.blob.chunks(4);
        chunks
            .map(|c| c.iter().fold(0, |word, byte| word << 8 | u32::from(*byte)))
            .collect()
    }
}

/// Where elaboration puts a board's simulation: `sim/NAME` in the folder of cargo that this program
/// lies below. A path of the checkout, compiled in, would make each checkout's packages different.
fn elaborated(name: &str) -> PathBuf {
    let folder = Path::new("sim").join(name);
    let program = std::env::current_exe().unwrap_or_default();
    let mut above = program.ancestors().skip(1).map(|at| at.join(&folder));
    let found = above.find(|at| at.join("board.bin").is_file());
    found.unwrap_or_else(|| Path::new("target").join(folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boards_carried_here_can_be_read() {
        for (name, _) in BUILT_IN {
            let facts = BoardFacts::named(name).unwrap();
            assert!(
                facts.channels.stepgens >= 3 && facts.clock_hz >= 40_000_000,
                "{facts:?}"
            );
            assert_eq!(BoardFacts::named(name).unwrap(), facts);
        }
    }

    #[test]
    fn a_plain_board_describes_itself() {
        let channels = Channels {
            stepgens: 6,
            encoders: 6,
            pwms: 6,
            inputs: 12,
            outputs: 12,
        };
        let plain = BoardFacts::plain(channels, 60_000_000);
        let read = BoardFacts::parse("plain", plain.blob.clone(), 60_000_000).unwrap();
        assert_eq!(read, plain);
        assert_eq!(plain.words()[0], MAGIC);
    }
}
