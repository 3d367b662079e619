//! The configuration of a board's pins over the network: what the image has, the file in force, and
//! a new one in its place ([`wire::pins`]).
//!
//! ```text
//!   1  refuse a board with fixed pins, and a machine that is not at rest
//!   2  find the newest whole copy by the board's CRC         the other one is written
//!   3  erase its sectors, the first one first                 it counts as none from here on
//!   4  write every page but the first, and sum them up
//!   5  write the first page, and sum up the whole             now it counts, from the next start on
//!   6  restart the board, and ask which copy is in force
//!   7  write the same over the copy before                    a worn page brings no old file back
//! ```
//!
//! At every moment one whole copy is there, the old or the new one. After an interruption the same
//! command begins again.

use crate::address::Address;
use crate::client::{Client, ClientError};
use crate::flash::{FlashError, Flasher, Overview, Word};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};
use wire::board::crc32;
use wire::describe::{self, FEATURE_PINS};
use wire::flash::{Area, Layout, Origin, PAGE, SECTOR, is_newer};
use wire::pins::{Built, GENERATION_AT, HEAD_WORDS, Head, Loaded, Verdict};
use wire::regmap::{address, ident};
use wire::{map, words_from_bytes};

/// 300 ms: the board is asked this long at one address, then at the other.
const QUESTION: Duration = Duration::from_millis(300);
/// What is left to do when the configuration is written and nothing is known of its restart.
const AGAIN: &str = "give the command again: the second copy is not written yet";
/// Bytes in front of what the CRC is of.
const UNSUMMED: u32 = 4 * GENERATION_AT as u32;

/// What a board with configurable pins says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facts {
    /// Its channels and lines.
    pub built: Built,
    /// CRC-32 of its platform's name.
    pub platform: u32,
    /// The cores' clock.
    pub clock_hz: u32,
    /// As its description has them.
    pub features: u32,
    /// What became of the stored configuration.
    pub loaded: Loaded,
}

/// Why it did not work; it says what to do.
#[derive(Debug)]
pub enum PinsError {
    /// The board or the way there.
    Flash(FlashError),
    /// Its pins are part of its image.
    Fixed(Address),
    /// Nothing whole is stored.
    Missing(Address),
    /// What was read is no text in a configuration.
    Nonsense,
    /// What was read back is not what was written.
    Differs(u32),
    /// It has not come back after the restart.
    Gone {
        /// Where it was.
        address: Address,
        /// Where the new file has it, if that is elsewhere.
        moved: Option<SocketAddrV4>,
        /// How long it was waited for.
        waited: Duration,
    },
    /// It is back and does not use what was written.
    Unused(Loaded),
    /// It is in force, and the copy before could not be written over.
    Second {
        /// Where the board is now, if that is elsewhere.
        moved: Option<SocketAddrV4>,
        /// Why not.
        why: Box<PinsError>,
    },
}

impl core::fmt::Display for PinsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            PinsError::Flash(error) => write!(f, "{error}"),
            PinsError::Fixed(address) => write!(
                f,
                "{address}: the pins of this board are part of its image; build this board file and update the board (ferrocnc update), or update it with an image whose pins are configured. Nothing was changed"
            ),
            PinsError::Missing(address) => write!(
                f,
                "{address}: no configuration of the pins is stored on this board; ferrocnc config apply writes one"
            ),
            PinsError::Nonsense => f.write_str(
                "the stored configuration holds no text that this version can read; update the tool",
            ),
            PinsError::Differs(at) => write!(
                f,
                "what was read back differs from the file at {at:#08x}; give the command again; if it stays so the flash is worn out. The configuration in force stays so"
            ),
            PinsError::Gone {
                address,
                moved: None,
                waited,
            } => write!(
                f,
                "the configuration is written and the board was told to restart, but {address} has not answered for {:.0} s; power it off and on, then {AGAIN}",
                waited.as_secs_f64()
            ),
            PinsError::Gone {
                address,
                moved: Some(moved),
                waited,
            } => write!(
                f,
                "the configuration is written and the board was told to restart, but it has answered neither at {address} nor, as the file has it, at {moved} for {:.0} s; give this computer an address in that net (ferrocnc discover shows the board), then {AGAIN}",
                waited.as_secs_f64()
            ),
            PinsError::Unused(loaded) => write!(
                f,
                "the configuration is written, and the board does not use it: {}; {}, then {AGAIN}",
                loaded.verdict, remedy(loaded.verdict)
            ),
            PinsError::Second { moved, why } => {
                f.write_str("the configuration is in force")?;
                if let Some(moved) = moved {
                    write!(f, ", the board is at {moved} now, as the file has it")?;
                }
                write!(
                    f,
                    ", but its second copy is not written, so give the command again ({why})"
                )
            }
        }
    }
}

/// What the operator can do about a configuration that is not in force.
pub const fn remedy(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::InForce => "restart the board",
        Verdict::Missing => "give it one: ferrocnc config apply BOARD FILE.toml",
        Verdict::FactoryPin => "release the factory pin or the button and restart the board",
        Verdict::Platform | Verdict::Built | Verdict::Counts => {
            "apply a board file for the image that the card has now: ferrocnc config apply BOARD FILE.toml"
        }
        Verdict::Output | Verdict::Input => {
            "apply the board file again with this version: ferrocnc config apply BOARD FILE.toml"
        }
        Verdict::Refused => "restart the board; if it stays so, update it with another image",
        Verdict::Fixed => "build the board file and update the board",
    }
}

impl std::error::Error for PinsError {}

impl From<FlashError> for PinsError {
    fn from(error: FlashError) -> Self {
        PinsError::Flash(error)
    }
}

impl From<ClientError> for PinsError {
    fn from(error: ClientError) -> Self {
        PinsError::Flash(error.into())
    }
}

impl Facts {
    /// Asks the board; refused if its pins are fixed.
    pub fn read(client: &mut Client) -> Result<Self, PinsError> {
        let words = client.read(&[
            describe::address(describe::FEATURES_AT),
            describe::address(describe::CLOCK_HZ_AT),
            address(ident::BASE, ident::CHANNELS0),
            address(ident::BASE, ident::PINS),
            address(ident::BASE, ident::PLATFORM),
            map::FLASH_PINS,
        ])?;
        let [features, clock_hz, channels, lines, platform, loaded] = words[..] else {
            return Err(FlashError::Nonsense.into());
        };
        if features & FEATURE_PINS == 0 {
            return Err(PinsError::Fixed(client.address().clone()));
        }
        let built = Built {
            lines: lines.try_into().map_err(|_| FlashError::Nonsense)?,
            ..Built::from_word(channels)
        };
        Ok(Facts {
            built,
            platform,
            clock_hz,
            features,
            loaded: Loaded::from_word(loaded).ok_or(FlashError::Nonsense)?,
        })
    }
}

/// What is going on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// So much of a step is done, of 1.
    Step(&'static str, f64),
    /// The board falls silent, or is back.
    Word(Word),
}

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// The copy that was written.
    pub copy: u32,
    /// Its generation.
    pub generation: u32,
    /// Its bytes.
    pub bytes: usize,
    /// From the restart to the first answer.
    pub restarted_in: Duration,
    /// Where the board is now, if that is elsewhere.
    pub moved: Option<SocketAddrV4>,
}

/// A whole copy.
#[derive(Clone, Copy, Debug)]
struct Whole {
    copy: u32,
    generation: u32,
    bytes: u32,
}

/// The two copies of a board at rest.
pub struct Copies<'t> {
    flasher: Flasher<'t>,
    tell: &'t dyn Fn(Event),
    patience: Duration,
    overview: Overview,
    layout: Layout,
    /// In force, whether whole or not: never written.
    loaded: Loaded,
    found: [Option<Whole>; 2],
}

impl<'t> Copies<'t> {
    /// Looks at both copies. Refused if the machine is not at rest, or another host drives it.
    pub fn open(
        mut client: Client,
        facts: &Facts,
        patience: Duration,
        tell: &'t dyn Fn(Event),
    ) -> Result<Self, PinsError> {
        let overview = Overview::read(&mut client)?;
        let layout = overview.layout.ok_or(FlashError::NoFlash {
            jedec: overview.jedec,
        })?;
        let mut flasher = Flasher::new(client, patience, |word| tell(Event::Word(word)));
        flasher.may_write()?;
        let mut found = [None; 2];
        for (copy, place) in (0..).zip(&mut found) {
            *place = whole(&mut flasher, layout.pins_copy(copy), copy)?;
        }
        Ok(Copies {
            flasher,
            tell,
            patience,
            overview,
            layout,
            loaded: facts.loaded,
            found,
        })
    }

    /// The newest whole one.
    fn newest(&self) -> Option<&Whole> {
        let [first, second] = &self.found;
        match (first, second) {
            (Some(a), Some(b)) => {
                let newer = is_newer(b.generation, a.generation);
                Some(if newer { b } else { a })
            }
            (first, second) => first.as_ref().or(second.as_ref()),
        }
    }

    /// The one in force, or the newest whole one if none is.
    fn in_force(&self) -> Option<&Whole> {
        let loaded = self.loaded.copy.and_then(|n| self.found.get(n as usize));
        match loaded {
            Some(whole) => whole.as_ref(),
            None => self.newest(),
        }
    }

    /// The generation that a new one has to have.
    pub fn next_generation(&self) -> u32 {
        self.newest().map_or(1, |it| it.generation.wrapping_add(1))
    }

    /// The bytes of the one in force.
    pub fn read(&mut self) -> Result<Vec<u8>, PinsError> {
        let Some(Whole { copy, bytes, .. }) = self.in_force().copied() else {
            let address = self.flasher.client().address().clone();
            return Err(PinsError::Missing(address));
        };
        let start = self.layout.pins_copy(copy).start;
        let mut all = Vec::with_capacity(bytes as usize);
        for at in (0..bytes).step_by(PAGE as usize) {
            (self.tell)(Event::Step("reading", f64::from(at) / f64::from(bytes)));
            let length = PAGE.min(bytes - at);
            all.extend(self.flasher.read(start + at, length)?);
        }
        Ok(all)
    }

    /// Writes a configuration with [`Copies::next_generation`], restarts the board, and waits until
    /// it says that the new one is in force. `network` is the address that its description has.
    pub fn write(mut self, bytes: &[u8], network: SocketAddrV4) -> Result<Report, PinsError> {
        // Written over: never the one in force, never the only whole one.
        let kept = self.loaded.copy.or_else(|| self.newest().map(|it| it.copy));
        let copy = kept.map_or(0, |kept| 1 - kept);
        let (generation, area) = (self.next_generation(), self.layout.pins_copy(copy));
        self.replace(area, bytes)?;
        let (restarted_in, loaded, moved) = self.restart(network)?;
        let wanted = Loaded {
            verdict: Verdict::InForce,
            copy: Some(copy),
        };
        if loaded != wanted {
            return Err(PinsError::Unused(loaded));
        }
        let before = self.layout.pins_copy(1 - copy);
        self.follow(moved)
            .and_then(|()| self.replace(before, bytes))
            .map_err(|why| PinsError::Second {
                moved,
                why: Box::new(why),
            })?;
        Ok(Report {
            copy,
            generation,
            bytes: bytes.len(),
            restarted_in,
            moved,
        })
    }

    /// Goes on where the board is after its restart, if it may still be written to.
    fn follow(&mut self, moved: Option<SocketAddrV4>) -> Result<(), PinsError> {
        if let Some(socket) = moved {
            let tell = self.tell;
            let client = self.flasher.client().elsewhere(&at(socket))?;
            self.flasher = Flasher::new(client, self.patience, |word| tell(Event::Word(word)));
        }
        Ok(self.flasher.may_write()?)
    }

    fn step(&self, what: &'static str, done: usize, of: usize) {
        (self.tell)(Event::Step(what, done as f64 / of.max(1) as f64));
    }

    /// Writes a copy, its first page last.
    fn replace(&mut self, area: Area, bytes: &[u8]) -> Result<(), PinsError> {
        let sectors = bytes.len().div_ceil(SECTOR as usize);
        for n in 0..sectors {
            self.step("erasing", n, sectors);
            self.flasher.erase_sector(area.start + n as u32 * SECTOR)?;
        }
        let first = bytes.len().min(PAGE as usize);
        let (head, rest) = bytes.split_at(first);
        let pages = rest.len().div_ceil(PAGE as usize);
        for (n, page) in rest.chunks(PAGE as usize).enumerate() {
            self.step("writing", n, pages);
            self.flasher
                .program(area.start + (n as u32 + 1) * PAGE, page)?;
        }
        self.sum(area.start + PAGE, rest)?;
        self.flasher.program(area.start, head)?;
        self.sum(area.start, bytes)
    }

    /// Compares the board's CRC with ours.
    fn sum(&mut self, at: u32, bytes: &[u8]) -> Result<(), PinsError> {
        if bytes.is_empty() || self.flasher.crc(at, bytes.len() as u32)? == crc32(bytes) {
            return Ok(());
        }
        Err(PinsError::Differs(at))
    }

    /// Restarts the board: how long that took, what it made of its configuration, and where it is.
    fn restart(
        &mut self,
        network: SocketAddrV4,
    ) -> Result<(Duration, Loaded, Option<SocketAddrV4>), PinsError> {
        let before = self.flasher.client().read(&ALIVE)?;
        let moved = self.elsewhere(network);
        let mut other = match moved {
            // Without a way there it is only asked here: it is written, and must be restarted.
            Some(socket) => Client::open(&at(socket)).ok(),
            None => None,
        }
        .map(|client| client.with_patience(QUESTION));
        self.step("restarting", 0, 1);
        let since = Instant::now();
        self.flasher.restart();
        while since.elapsed() < self.patience {
            if let Ok(words) = self.flasher.client().read(&ALIVE)
                && let Some(loaded) = restarted(&before, &words)?
            {
                return Ok((since.elapsed(), loaded, None));
            }
            if let Some(client) = &mut other
                && let Ok(words) = client.read(&ALIVE)
                && let Some(loaded) = restarted(&before, &words)?
            {
                return Ok((since.elapsed(), loaded, moved));
            }
            // A board that answers at once is not asked without end.
            std::thread::sleep(Duration::from_millis(20));
        }
        Err(PinsError::Gone {
            address: self.flasher.client().address().clone(),
            moved,
            waited: since.elapsed(),
        })
    }

    /// Where the board will be if that is elsewhere: the file's address is in force as long as none
    /// is saved.
    fn elsewhere(&self, network: SocketAddrV4) -> Option<SocketAddrV4> {
        let built_in = match self.overview.origin {
            Origin::BuiltIn | Origin::FactoryPin => true,
            Origin::Copy0 | Origin::Copy1 => false,
        };
        let port = self.overview.settings.ok().map(|settings| settings.port);
        let same = *network.ip() == self.overview.ip && port == Some(network.port());
        (built_in && !same && *network.ip() != Ipv4Addr::UNSPECIFIED).then_some(network)
    }
}

/// Which start of which board this is, and what it made of its configuration.
const ALIVE: [u32; 4] = [
    describe::address(describe::BOOT_ID_AT),
    map::FLASH_UID_HI,
    map::FLASH_UID_LO,
    map::FLASH_PINS,
];

/// What the board made of its configuration, if it is the same board after another start.
fn restarted(before: &[u32], now: &[u32]) -> Result<Option<Loaded>, FlashError> {
    let (&[boot, ref uid @ .., _], &[new_boot, ref new_uid @ .., loaded]) = (before, now) else {
        return Err(FlashError::Nonsense);
    };
    if boot == new_boot || uid != new_uid {
        return Ok(None);
    }
    let loaded = Loaded::from_word(loaded).ok_or(FlashError::Nonsense)?;
    Ok(Some(loaded))
}

fn at(socket: SocketAddrV4) -> Address {
    Address {
        text: socket.to_string(),
        socket,
    }
}

/// The copy, if it is whole by the board's own CRC.
fn whole(flasher: &mut Flasher<'_>, area: Area, copy: u32) -> Result<Option<Whole>, FlashError> {
    // What says of the head how long the whole is, is in its first page.
    let page = flasher.read(area.start, PAGE)?;
    let mut words = [0; HEAD_WORDS];
    let _ = words_from_bytes(&page, &mut words);
    let head = Head(words);
    let Some(bytes) = head.bytes() else {
        return Ok(None);
    };
    let sum = flasher.crc(area.start + UNSUMMED, bytes - UNSUMMED)?;
    Ok((sum == head.crc()).then_some(Whole {
        copy,
        generation: head.generation(),
        bytes,
    }))
}
