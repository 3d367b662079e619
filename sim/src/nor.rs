//! A serial NOR flash that behaves as its data sheet says, with power failures at any step.
//!
//! It receives and returns SPI bytes; [`spi`] connects it to `embedded-hal`, [`pins`] to four
//! wires. It programs by AND inside one page, erases whole sectors, obeys its write enable latch
//! and its protection bits, and is busy for as long as the real one. It knows nothing of what is
//! stored in it.
//!
//! **Power.** Every operation that changes cells is a number of *steps*: a program one per byte, an
//! erase [`ERASE_STEPS`], a status write one. [`Nor::cut_at`] lets the power fail at any of them.
//! The step it fails in is left half done: some bits of a byte, or a sector with some of its cells
//! discharged or charged, drawn from the cut's seed. [`Nor::power_up`] brings the power back. A
//! test that tries every cut runs once for [`Nor::steps`], then once for each of them.
//!
//! **Misuse** does what the chip does (mostly nothing) and is noted ([`Nor::misuse`]): a correct
//! driver causes none.

mod part;
pub mod pins;
pub mod spi;

pub use part::{Part, Times};

use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::Error;

/// Bytes of a page: what one program changes at most.
pub const PAGE: usize = 256;
/// Bytes of a sector: the least that can be erased.
pub const SECTOR: usize = 4096;
/// Bytes of a block.
pub const BLOCK: usize = 65536;
/// Points at which an erase can be interrupted: untouched, four degrees of being programmed to 0
/// first, four of being erased, the last with a handful of cells missing.
pub const ERASE_STEPS: u64 = 9;

/// Bits of the status registers.
mod status {
    /// Register 1: an operation runs.
    pub const BUSY: u8 = 1 << 0;
    /// Register 1: the write enable latch.
    pub const WEL: u8 = 1 << 1;
    /// Register 1: how much is protected, three bits.
    pub const BP: u8 = 7 << 2;
    /// Register 1: from the bottom instead of the top.
    pub const TB: u8 = 1 << 5;
    /// Register 1: in sectors instead of blocks.
    pub const SEC: u8 = 1 << 6;
    /// Register 1: with SRL the lock of the registers themselves; the pin /WP is not modelled
    /// (high).
    pub const SRP: u8 = 1 << 7;
    /// Register 2: the registers are locked until the next power-up.
    pub const SRL: u8 = 1 << 0;
    /// Register 2: what was to be protected is not, and the rest is.
    pub const CMP: u8 = 1 << 6;
}

/// What a driver did that the data sheet forbids or that has no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// An order to a chip that is busy; it was ignored.
    WhileBusy(u8),
    /// A change without a write enable before it; it was ignored.
    NotEnabled(u8),
    /// A change of something protected, at this address; it was ignored.
    Protected(u32),
    /// A program order went over the end of its page and continued at the page's start.
    Wrapped(u32),
    /// A program that wanted a 0 bit to become 1 at this address.
    NotErased(u32),
    /// The chip was deselected in the middle of a byte or of an address; the order was ignored.
    Incomplete(u8),
    /// An order it does not know.
    Unknown(u8),
    /// The clock moved while no chip was selected, or together with /CS.
    StrayClock,
}

/// How a page program that is cut off leaves the page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// The bytes before the cut are done, that one partly, those after it not.
    #[default]
    InOrder,
    /// All bytes were under way at once: of every byte some bits, more the later the cut.
    AllAtOnce,
}

/// When the power fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// In the step of this number ([`Nor::steps`] counts them).
    pub step: u64,
    /// Which bits are caught.
    pub seed: u64,
    /// How programs work.
    pub order: Order,
}

/// Pseudo-random numbers from a seed (xorshift64*).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Dice(u64);

impl Dice {
    fn new(seed: u64, step: u64) -> Self {
        // Neighbouring seeds and steps must not look alike; zero would stay zero.
        Dice((seed ^ step.rotate_left(32)).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// A byte of which each bit is 1 in `eighths` of 8 cases.
    fn bits(&mut self, eighths: u64) -> u8 {
        (0..8).fold(0, |byte, bit| {
            byte | u8::from(self.next() >> 32 & 7 < eighths) << bit
        })
    }
}

/// A change that has been ordered.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Change {
    /// Bytes ANDed into the cells from an address on, in the order they came.
    Program(Vec<(usize, u8)>),
    Erase(Range<usize>),
    Status([u8; 3], bool),
}

impl Change {
    fn steps(&self) -> u64 {
        match self {
            Change::Program(bytes) => bytes.len() as u64,
            Change::Erase(_) => ERASE_STEPS,
            Change::Status(..) => 1,
        }
    }
}

/// What the chip makes of the bytes since it was selected.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Talk {
    /// Bytes taken, the order first.
    taken: Vec<u8>,
    /// The byte that goes out next.
    out: Option<u8>,
    /// Where a read has come to.
    at: usize,
    /// Bytes of a program, and how many came.
    page: Vec<(usize, u8)>,
    /// The rest of the order is ignored.
    deaf: bool,
}

/// The chip.
#[derive(Debug)]
pub struct Nor {
    part: Part,
    cells: Vec<u8>,
    uid: Vec<u8>,
    /// The three status registers as they survive a power-up.
    kept: [u8; 3],
    /// As they are in force.
    live: [u8; 3],
    enabled: bool,
    volatile_enabled: bool,
    reset_enabled: bool,
    asleep: bool,
    now: u64,
    busy_until: u64,
    talk: Option<Talk>,
    /// Nanoseconds a byte takes on the bus.
    byte_time: u64,
    steps: u64,
    cut: Option<Cut>,
    dead: bool,
    misuse: Vec<Misuse>,
    erases: Vec<u32>,
    programs: u64,
    bytes_read: u64,
    file: Option<(File, PathBuf)>,
}

impl Nor {
    /// A new chip, erased, nothing protected.
    pub fn new(part: Part, uid: u64) -> Self {
        // The second half of a long one is no news.
        let uid = [uid.to_be_bytes(), (!uid).to_be_bytes()].concat()[..part.uid_bytes].to_vec();
        Nor {
            cells: vec![0xff; part.bytes],
            uid,
            kept: [0; 3],
            live: [0; 3],
            enabled: false,
            volatile_enabled: false,
            reset_enabled: false,
            asleep: false,
            now: 0,
            busy_until: 0,
            talk: None,
            // 15 MHz.
            byte_time: 533,
            steps: 0,
            cut: None,
            dead: false,
            misuse: Vec::new(),
            erases: vec![0; part.bytes / SECTOR],
            programs: 0,
            bytes_read: 0,
            file: None,
            part,
        }
    }

    /// A chip with its cells in a file, written as they change: if the simulator is killed, the
    /// file is like a chip after a power failure. A file that is not there is a new chip of this
    /// part; an existing one says by its size which part it is. Its status registers are in a file
    /// beside it, `.status`, once they are not 0.
    pub fn in_file(path: &Path, part: Part, uid: u64) -> Result<Self, Error> {
        let wrong = |source| Error::Read {
            path: path.into(),
            source,
        };
        let fresh = !path.exists();
        let mut nor = if fresh {
            Nor::new(part, uid)
        } else {
            let cells = std::fs::read(path).map_err(wrong)?;
            let part = Part::of_size(cells.len()).ok_or_else(|| {
                wrong(std::io::Error::other(format!(
                    "{} bytes; a flash of ours has {:?}",
                    cells.len(),
                    Part::ALL.map(|part| part.bytes)
                )))
            })?;
            let mut nor = Nor::new(part, uid);
            nor.cells = cells;
            nor
        };
        let status = beside(path);
        if let Ok(text) = std::fs::read_to_string(&status) {
            let bytes: Vec<u8> = text
                .split_whitespace()
                .filter_map(|hex| u8::from_str_radix(hex, 16).ok())
                .collect();
            nor.kept = bytes.try_into().map_err(|_| Error::Read {
                path: status,
                source: std::io::Error::other("not three bytes in hexadecimal"),
            })?;
            nor.live = nor.kept;
        }
        let mut file = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(path)
            .map_err(wrong)?;
        if fresh {
            file.write_all(&nor.cells).map_err(wrong)?;
        }
        nor.file = Some((file, path.into()));
        Ok(nor)
    }

    /// The same cells, registers and id in another chip, without file, cut and history: to try
    /// things with.
    pub fn copy(&self) -> Self {
        let mut nor = Nor::new(self.part, 0);
        nor.cells.copy_from_slice(&self.cells);
        nor.uid.clone_from(&self.uid);
        (nor.kept, nor.live) = (self.kept, self.kept);
        nor
    }

    // ---- from outside the circuit ---------------------------------------------------------------

    /// Which it is.
    pub fn part(&self) -> Part {
        self.part
    }

    /// What is in the cells.
    pub fn cells(&self) -> &[u8] {
        &self.cells
    }

    /// Leaves cells and status registers in files, for a board that begins with them.
    pub fn leave_in(&self, path: &Path) -> std::io::Result<()> {
        std::fs::write(path, &self.cells)?;
        self.leave_status(path)
    }

    fn leave_status(&self, path: &Path) -> std::io::Result<()> {
        let [a, b, c] = self.kept;
        std::fs::write(beside(path), format!("{a:02x} {b:02x} {c:02x}\n"))
    }

    /// Puts bytes into the cells, as a factory's programmer does.
    pub fn preload(&mut self, at: usize, bytes: &[u8]) {
        self.cells[at..at + bytes.len()].copy_from_slice(bytes);
        self.keep(at..at + bytes.len());
    }

    /// Has it protect this much (BP2:0), as a factory's programmer does.
    pub fn lock(&mut self, bits: u8) {
        self.kept[0] = bits << 2 & status::BP;
        self.live = self.kept;
        self.keep_change(&Change::Status(self.kept, false));
    }

    /// The status registers, 1 to 3, as they survive a power-up.
    pub fn registers(&self) -> [u8; 3] {
        self.kept
    }

    /// What its protection bits protect.
    pub fn protected(&self) -> Range<usize> {
        protected(self.part.bytes, self.live)
    }

    /// Its unique id, the first eight bytes.
    pub fn uid(&self) -> u64 {
        self.uid[..8]
            .iter()
            .fold(0, |id, byte| id << 8 | u64::from(*byte))
    }

    /// What was done wrongly, in order.
    pub fn misuse(&self) -> &[Misuse] {
        &self.misuse
    }

    /// Notes a misuse that a front end has seen.
    pub fn note(&mut self, misuse: Misuse) {
        self.misuse.push(misuse);
    }

    /// How often the sector at this address was erased.
    pub fn erases(&self, at: usize) -> u32 {
        self.erases[at / SECTOR]
    }

    /// Page programs so far.
    pub fn programs(&self) -> u64 {
        self.programs
    }

    /// Bytes of data read so far.
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read
    }

    /// Steps done so far.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Lets the power fail there.
    pub fn cut_at(&mut self, cut: Cut) {
        self.cut = Some(cut);
    }

    /// The power has failed: it takes no orders, and its output floats high.
    pub fn dead(&self) -> bool {
        self.dead
    }

    /// Power is back: latches and volatile bits are as after a power-up, no cut is planned, time
    /// begins again.
    pub fn power_up(&mut self) {
        self.live = self.kept;
        (self.enabled, self.volatile_enabled, self.reset_enabled) = (false, false, false);
        (self.asleep, self.dead, self.cut, self.talk) = (false, false, None, None);
        self.live[1] &= !status::SRL;
        (self.now, self.busy_until) = (0, 0);
    }

    // ---- time -----------------------------------------------------------------------------------

    /// Sets the time in nanoseconds; it never goes back.
    pub fn it_is(&mut self, now: u64) {
        self.now = self.now.max(now);
    }

    /// So many nanoseconds pass.
    pub fn pass(&mut self, nanoseconds: u64) {
        self.now += nanoseconds;
    }

    /// An operation runs.
    pub fn busy(&self) -> bool {
        self.now < self.busy_until
    }

    // ---- the bus --------------------------------------------------------------------------------

    /// /CS falls.
    pub fn select(&mut self) {
        self.talk = (!self.dead).then(Talk::default);
    }

    /// Eight clocks: the byte on its way out since before them, and a byte in. `None`: the output
    /// floats.
    pub fn byte(&mut self, byte: u8) -> Option<u8> {
        self.now += self.byte_time;
        let out = self.output();
        self.take(byte);
        out
    }

    /// The byte that goes out with the next eight clocks.
    pub fn output(&self) -> Option<u8> {
        self.talk.as_ref().and_then(|talk| talk.out)
    }

    /// Takes a byte that came in, and makes up the next one to go out.
    pub fn take(&mut self, byte: u8) {
        let Some(mut talk) = self.talk.take() else {
            return;
        };
        talk.out = None;
        if talk.taken.is_empty() {
            self.begin(byte, &mut talk);
        }
        // Long reads and programs need to know no more than that they run.
        if talk.taken.len() < 16 {
            talk.taken.push(byte);
        }
        if !talk.deaf {
            self.go_on(byte, &mut talk);
        }
        self.talk = Some(talk);
    }

    /// /CS rises, `bits` after the last whole byte: what was ordered begins.
    pub fn deselect(&mut self, bits: u8) {
        let Some(talk) = self.talk.take() else {
            return;
        };
        let Some(order) = talk.taken.first().copied().filter(|_| !talk.deaf) else {
            return;
        };
        if let Err(misuse) = self.execute(order, bits, talk) {
            self.misuse.push(misuse);
        }
    }

    /// The first byte of a talk.
    fn begin(&mut self, order: u8, talk: &mut Talk) {
        let status = matches!(order, 0x05 | 0x35 | 0x15);
        if self.busy() && !status {
            self.misuse.push(Misuse::WhileBusy(order));
            talk.deaf = true;
        }
        if self.asleep && order != 0xab {
            talk.deaf = true;
        }
        // 66h is forgotten unless 99h is next.
        self.reset_enabled &= order == 0x99;
    }

    /// Any byte of a talk, already among those taken.
    fn go_on(&mut self, byte: u8, talk: &mut Talk) {
        let (order, count) = (talk.taken[0], talk.taken.len());
        let address = || {
            let bytes = &talk.taken[1..4];
            let at = bytes.iter().fold(0, |at, b| at << 8 | usize::from(*b));
            at % self.part.bytes
        };
        match order {
            0x05 => talk.out = Some(self.status_register_1()),
            0x35 => talk.out = Some(self.live[1]),
            0x15 => talk.out = Some(self.live[2]),
            0x9f => talk.out = self.part.jedec.get(count - 1).copied(),
            0x90 if count >= 4 => {
                let id = [self.part.jedec[0], self.part.jedec[2] - 1];
                talk.out = Some(id[(count - 4) % 2]);
            }
            0xab if count >= 4 => talk.out = Some(self.part.jedec[2] - 1),
            0x4b if count >= 5 => talk.out = self.uid.get(count - 5).copied(),
            0x03 | 0x0b => {
                let dummies = usize::from(order == 0x0b);
                if count == 4 {
                    talk.at = address();
                }
                if count >= 4 + dummies {
                    talk.out = Some(self.cells[talk.at]);
                    talk.at = (talk.at + 1) % self.part.bytes;
                    self.bytes_read += 1;
                    // Keeps `count` where it is for as long as it goes on.
                    talk.taken.truncate(4 + dummies);
                }
            }
            0x02 => {
                if count == 4 {
                    talk.at = address();
                } else if count > 4 {
                    let page = talk.at / PAGE * PAGE;
                    let at = page + (talk.at + talk.page.len()) % PAGE;
                    talk.page.push((at, byte));
                    talk.taken.truncate(5);
                }
            }
            _ => {}
        }
    }

    fn status_register_1(&self) -> u8 {
        self.live[0] & !(status::BUSY | status::WEL)
            | if self.busy() { status::BUSY } else { 0 }
            | if self.enabled { status::WEL } else { 0 }
    }

    /// What an order means when /CS rises.
    fn execute(&mut self, order: u8, bits: u8, talk: Talk) -> Result<(), Misuse> {
        let taken = &talk.taken[1..];
        let whole = |wanted: bool| {
            if wanted && bits == 0 {
                Ok(())
            } else {
                Err(Misuse::Incomplete(order))
            }
        };
        let at = || {
            taken
                .iter()
                .take(3)
                .fold(0, |at, b| at << 8 | usize::from(*b))
                % self.part.bytes
        };
        let (change, time) = match order {
            // Orders that only read.
            0x05 | 0x35 | 0x15 | 0x9f | 0x90 | 0x4b | 0x03 | 0x0b | 0x5a => return Ok(()),
            0x06 | 0x04 | 0x50 => {
                whole(taken.is_empty())?;
                self.enabled = order == 0x06;
                self.volatile_enabled = order == 0x50;
                return Ok(());
            }
            0xb9 | 0xab => {
                self.asleep = order == 0xb9;
                return Ok(());
            }
            0x66 => {
                self.reset_enabled = true;
                return Ok(());
            }
            0x99 => {
                if self.reset_enabled {
                    let (cut, now) = (self.cut, self.now);
                    self.power_up();
                    (self.cut, self.now, self.busy_until) = (cut, now, now);
                }
                return Ok(());
            }
            0x02 => {
                whole(!talk.page.is_empty())?;
                if talk.page.len() > PAGE - talk.at % PAGE {
                    self.misuse.push(Misuse::Wrapped(talk.at as u32));
                }
                // Of more than a page the last bytes count.
                let skip = talk.page.len().saturating_sub(PAGE);
                (
                    Change::Program(talk.page[skip..].to_vec()),
                    self.part.times.page,
                )
            }
            0x20 | 0x52 | 0xd8 => {
                whole(taken.len() == 3)?;
                let (size, time) = match order {
                    0x20 => (SECTOR, self.part.times.sector),
                    0x52 => (BLOCK / 2, self.part.times.half_block),
                    _ => (BLOCK, self.part.times.block),
                };
                let start = at() / size * size;
                (Change::Erase(start..start + size), time)
            }
            0xc7 | 0x60 => {
                whole(taken.is_empty())?;
                (Change::Erase(0..self.part.bytes), self.part.times.chip)
            }
            0x01 | 0x31 | 0x11 => {
                whole(!taken.is_empty())?;
                let mut new = self.live;
                let first = match order {
                    0x01 => 0,
                    0x31 => 1,
                    _ => 2,
                };
                if order == 0x01 && taken.len() == 1 && self.part.short_write_clears {
                    new[1] = 0;
                }
                let room = if order == 0x01 { 2 } else { 1 };
                for (register, byte) in new[first..].iter_mut().zip(taken).take(room) {
                    *register = *byte;
                }
                new[0] &= !(status::BUSY | status::WEL);
                let volatile = self.volatile_enabled && !self.enabled;
                (Change::Status(new, volatile), self.part.times.status)
            }
            unknown => return Err(Misuse::Unknown(unknown)),
        };
        if !self.enabled && !matches!(change, Change::Status(_, true)) {
            return Err(Misuse::NotEnabled(order));
        }
        self.refuse_protected(&change)?;
        self.change(change);
        self.busy_until = self.now + time;
        (self.enabled, self.volatile_enabled) = (false, false);
        Ok(())
    }

    fn refuse_protected(&self, change: &Change) -> Result<(), Misuse> {
        let guarded = self.protected();
        let hit = match change {
            Change::Program(bytes) => bytes
                .iter()
                .map(|(at, _)| *at)
                .find(|at| guarded.contains(at)),
            Change::Erase(range) => {
                (range.start < guarded.end && guarded.start < range.end).then_some(range.start)
            }
            Change::Status(..) => (self.live[1] & status::SRL != 0).then_some(usize::MAX),
        };
        hit.map_or(Ok(()), |at| Err(Misuse::Protected(at as u32)))
    }

    /// Does it, or as much of it as there is power for.
    fn change(&mut self, change: Change) {
        let begun = self.steps;
        let cut = self
            .cut
            .filter(|cut| (begun..begun + change.steps()).contains(&cut.step));
        match &change {
            Change::Program(bytes) => {
                self.programs += 1;
                let wrong = bytes.iter().find(|(at, byte)| byte & !self.cells[*at] != 0);
                if let Some((at, _)) = wrong {
                    self.misuse.push(Misuse::NotErased(*at as u32));
                }
            }
            Change::Erase(range) => {
                for sector in &mut self.erases[range.start / SECTOR..range.end / SECTOR] {
                    *sector += 1;
                }
            }
            Change::Status(..) => {}
        }
        let Some(cut) = cut else {
            self.steps += change.steps();
            match &change {
                Change::Program(bytes) => {
                    for (at, byte) in bytes {
                        self.cells[*at] &= byte;
                    }
                }
                Change::Erase(range) => self.cells[range.clone()].fill(0xff),
                Change::Status(new, volatile) => {
                    self.live = *new;
                    if !volatile {
                        self.kept = *new;
                    }
                }
            }
            self.keep_change(&change);
            return;
        };
        let mut dice = Dice::new(cut.seed, cut.step);
        let done = cut.step - begun;
        self.steps = cut.step;
        match &change {
            Change::Program(bytes) => {
                for (n, (at, byte)) in (0..).zip(bytes) {
                    let spared = match cut.order {
                        Order::InOrder if n < done => 0,
                        Order::InOrder if n == done => dice.bits(4),
                        Order::InOrder => 0xff,
                        Order::AllAtOnce => dice.bits(8 - 8 * done / bytes.len() as u64),
                    };
                    self.cells[*at] &= byte | spared;
                }
            }
            Change::Erase(range) => {
                for cell in &mut self.cells[range.clone()] {
                    *cell = match done {
                        0 => *cell,
                        1..=4 => *cell & dice.bits(8 - 2 * done),
                        5..=7 => dice.bits(2 * (done - 4)),
                        // All but a cell in some hundred bytes.
                        _ => !(dice.bits(1) & dice.bits(1) & dice.bits(1) & dice.bits(2)),
                    };
                }
            }
            Change::Status(new, volatile) => {
                if !volatile {
                    for (register, new) in self.kept.iter_mut().zip(new) {
                        *register ^= (*register ^ new) & dice.bits(4);
                    }
                }
            }
        }
        self.keep_change(&change);
        self.dead = true;
        self.talk = None;
    }

    /// Writes what has changed to the file, if there is one.
    fn keep_change(&mut self, change: &Change) {
        match change {
            Change::Program(bytes) => {
                let low = bytes.iter().map(|(at, _)| *at).min().unwrap_or(0);
                let high = bytes.iter().map(|(at, _)| *at + 1).max().unwrap_or(0);
                self.keep(low..high);
            }
            Change::Erase(range) => self.keep(range.clone()),
            Change::Status(..) => {
                if let Some((_, path)) = &self.file
                    && let Err(error) = self.leave_status(path)
                {
                    eprintln!("sim: {}: {error}", path.display());
                }
            }
        }
    }

    fn keep(&mut self, range: Range<usize>) {
        if let Some((file, path)) = &mut self.file {
            let written = file
                .seek(SeekFrom::Start(range.start as u64))
                .and_then(|_| file.write_all(&self.cells[range]));
            // The board goes on; the file holds old bytes, as a worn-out chip would.
            if let Err(error) = written {
                eprintln!("sim: {}: {error}", path.display());
            }
        }
    }
}

/// Where the status registers of a flash in a file are.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".status");
    name.into()
}

/// What the protection bits of these registers mean on a chip of so many bytes.
fn protected(bytes: usize, registers: [u8; 3]) -> Range<usize> {
    let bp = u32::from(registers[0] & status::BP) >> 2;
    let bottom = registers[0] & status::TB != 0;
    let size = match (bp, registers[0] & status::SEC != 0) {
        (0, _) => 0,
        (7, _) => bytes,
        // 4, 8, 16, 32, 32 KiB.
        (bp, true) => (SECTOR << (bp - 1)).min(BLOCK / 2),
        // From a 64th of the largest, a block on the smaller: doubling until it is everything.
        (bp, false) => ((bytes / 64).max(BLOCK) << (bp - 1)).min(bytes),
    };
    let inverted = registers[1] & status::CMP != 0;
    match (bottom, inverted) {
        (false, false) => bytes - size..bytes,
        (false, true) => 0..bytes - size,
        (true, false) => 0..size,
        (true, true) => size..bytes,
    }
}

const _: () = assert!(status::SRP == 0x80);

#[cfg(test)]
mod tests;
