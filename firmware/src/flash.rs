//! The SPI flash: its contents, and one operation at a time that never blocks.
//!
//! A write of the flash window's operation word calls [`Flash::start_op`]. [`Flash::poll`] does a
//! slice of the operation whenever there is time, and [`Flash::word`] is what the host reads until
//! it is done. A slice is one command to the chip, or [`SLICE`] bytes read, because frames wait for
//! it.
//!
//! Erase and program operations are refused outside of the slot that is not selected
//! ([`Layout::writable`]) and of the copy of the pins' configuration that is not in force.
//! Settings, stubs and the chip's own protection change by operations of their own, which check
//! what they write.

use crate::images::{self, Step};
use crate::nor::{
    BUSY, ERASE_BLOCK, ERASE_SECTOR, JEDEC, Nor, PROGRAM, PROTECTION, UNIQUE_ID, WRITE_STATUS,
};
use crate::settings::{self, Copies};
use embedded_hal::spi::{Operation, SpiDevice};
use wire::crc::Crc32;
use wire::flash::{Area, BLOCK, Layout, Op, OpResult, OpWord, Origin, PAGE, Running, SECTOR, Slot};
use wire::images::{META_BYTES, Meta, Trailer};
use wire::pins::{Loaded, Verdict};
use wire::settings::{Settings, WORDS};
use wire::{map, settings as layout_of};

/// Bytes read in one slice: about 0.2 ms on the softcore, a fifth of a servo period.
pub const SLICE: u32 = 256;

/// 4 s. The slowest operation of a chip is the erase of a block: 2 s (W25Q32JV, GD25Q16C data
/// sheets, maximum).
const PATIENCE_SECONDS: u64 = 4;
/// A selection takes about forty steps at most: clear a sector, erase it, write a stub. More steps
/// mean that the chip does not obey.
const STEPS_MAX: u8 = 60;

/// The state of an operation.
#[derive(Clone, Copy, Debug)]
enum Job {
    /// Only wait for the chip.
    Finish,
    /// Erased: check that it is.
    Erased(u32),
    /// Programmed: check the bytes.
    Programmed,
    /// Protected: check the status register.
    Protected,
    /// Computing a CRC.
    Crc(PartialCrc),
    /// Computing the CRC of the image to be selected.
    Image {
        slot: Slot,
        crc: PartialCrc,
        wanted: u32,
    },
    /// The selection is under way.
    Choose { slot: Slot, steps: u8 },
    /// Settings to be saved into a sector, which is erased first if necessary.
    Save { settings: Settings, copy: u32 },
    /// Saved: check the settings.
    Saved { settings: Settings, copy: u32 },
    /// Copies to be erased, the older one first.
    Forget { copy: u32, left: u8 },
}

/// A CRC of which a part is computed, and the bytes that are left.
#[derive(Clone, Copy, Debug)]
struct PartialCrc {
    at: u32,
    left: u32,
    so_far: Crc32,
}

impl PartialCrc {
    /// Of this many bytes from `at`; none of them is read yet.
    fn new(at: u32, left: u32) -> Self {
        PartialCrc {
            at,
            left,
            so_far: Crc32::new(),
        }
    }

    /// Adds the next [`SLICE`] bytes.
    fn advance<S: SpiDevice>(&mut self, nor: &mut Nor<S>) -> Result<(), OpResult> {
        let count = SLICE.min(self.left);
        nor.each(self.at, count, &mut |bytes| self.so_far.update(bytes))?;
        self.at += count;
        self.left -= count;
        Ok(())
    }
}

/// The flash and the operation that runs on it.
#[derive(Clone, Debug)]
pub struct Flash {
    jedec: u32,
    uid: [u32; 2],
    layout: Option<Layout>,
    protected: bool,
    trailer: Trailer,
    idcode: Option<u32>,
    selected: Option<Slot>,
    running: Running,
    settings: Settings,
    /// The settings without the key, for any client. They are computed once: their CRC alone takes
    /// longer than an exchange may wait for another client.
    shown: [u32; WORDS],
    origin: Origin,
    /// What became of the configuration of the pins.
    pub(crate) pins: Loaded,
    word: OpWord,
    address: u32,
    length: u32,
    crc: u32,
    buffer: [u8; PAGE as usize],
    job: Job,
    /// When an erase or program command was sent; the chip is polled until it is ready.
    waiting: Option<u64>,
}

impl Default for Flash {
    fn default() -> Self {
        Self::new()
    }
}

impl Flash {
    /// No flash.
    pub const fn new() -> Self {
        Flash {
            jedec: 0,
            uid: [0; 2],
            layout: None,
            protected: false,
            trailer: Trailer::NONE,
            idcode: None,
            selected: None,
            running: Running::Volatile,
            settings: Settings::BUILT_IN,
            shown: [0; WORDS],
            origin: Origin::BuiltIn,
            pins: Loaded {
                verdict: Verdict::Fixed,
                copy: None,
            },
            word: OpWord::IDLE,
            address: 0,
            length: 0,
            crc: 0,
            buffer: [0xff; PAGE as usize],
            job: Job::Finish,
            waiting: None,
        }
    }

    /// Identifies the chip. Waits for an operation that the last start left running.
    pub fn find<S: SpiDevice>(&mut self, spi: &mut S, trailer: Trailer) {
        self.trailer = trailer;
        if self.identify(&mut Nor(spi)).is_err() {
            self.layout = None;
        }
    }

    /// Finds the settings in force: the newest saved ones, or `built_in` if there are none or the
    /// factory pin is active.
    pub fn start<S: SpiDevice>(
        &mut self,
        spi: &mut S,
        idcode: Option<u32>,
        built_in: Settings,
        factory_pin: bool,
    ) {
        self.idcode = idcode;
        self.settings = built_in;
        let mut nor = Nor(spi);
        if let Some(layout) = self.layout {
            if let Ok(Some((settings, copy))) =
                settings::load(&mut nor, &layout).map(Copies::newest)
            {
                self.origin = if factory_pin {
                    Origin::FactoryPin
                } else {
                    self.settings = settings;
                    [Origin::Copy0, Origin::Copy1][copy as usize & 1]
                };
            } else if factory_pin {
                self.origin = Origin::FactoryPin;
            }
        }
        if self.settings.mac == [0; 6] && self.uid != [0; 2] {
            self.settings.mac = layout_of::mac_of_uid(self.uid);
        }
        self.show();
    }

    /// Not inside [`Flash::start`], which would hold stack for these words as long as the board
    /// runs.
    #[inline(never)]
    fn show(&mut self) {
        self.shown = self.settings.blanked().to_words();
    }

    fn identify<S: SpiDevice>(&mut self, nor: &mut Nor<S>) -> Result<(), OpResult> {
        // All ones: no chip answers. A chip that is busy does not tell its name either.
        let mut looks = 0u32;
        while nor.status()? & BUSY != 0 && looks < LOOKS_MAX {
            if nor.status()? == 0xff {
                return Ok(());
            }
            looks += 1;
        }
        let mut id = [0; 3];
        nor.command(&[JEDEC], &[], &mut id)?;
        let [a, b, c] = id;
        let jedec = u32::from_be_bytes([0, a, b, c]);
        if matches!(jedec, 0 | 0xff_ffff) {
            return Ok(());
        }
        self.jedec = jedec;
        let mut uid = [0; 8];
        nor.command(&[UNIQUE_ID, 0, 0, 0, 0], &[], &mut uid)?;
        let uid = u64::from_be_bytes(uid);
        if uid != u64::MAX {
            self.uid = [(uid >> 32) as u32, uid as u32];
        }
        self.layout = Layout::of_jedec(jedec);
        if let Some(layout) = self.layout {
            self.protected = is_protected(nor, &layout)?;
            self.look(nor, &layout)?;
        }
        Ok(())
    }

    /// Finds the selected slot, and with it the image that runs.
    fn look<S: SpiDevice>(&mut self, nor: &mut Nor<S>, layout: &Layout) -> Result<(), OpResult> {
        self.selected = images::selected(nor, layout)?;
        // A selection does not change the running image; so this is found out once, at start.
        let selected = match self.selected {
            Some(slot) => meta(nor, layout.slot(slot))?.map(|meta| (slot, meta.build_id)),
            None => None,
        };
        self.running = self.trailer.running(selected);
        Ok(())
    }

    /// Where the running image begins, and its length; `None` if it was loaded by JTAG, or if its
    /// slot has another build now.
    pub fn image<S: SpiDevice>(&self, spi: &mut S) -> Option<(u32, u32)> {
        let layout = self.layout?;
        let area = match self.running {
            Running::Volatile => return None,
            Running::A => layout.slot_a,
            Running::B => layout.slot_b,
            Running::Golden => layout.golden,
        };
        let meta = meta(&mut Nor(spi), area).ok()??;
        (meta.build_id == self.trailer.build_id).then_some((area.start, meta.length))
    }

    /// Its JEDEC id, 0 if there is no flash.
    pub fn jedec(&self) -> u32 {
        self.jedec
    }

    /// Its unique id.
    pub fn uid(&self) -> [u32; 2] {
        self.uid
    }

    /// The flash's layout, if it is known.
    pub fn layout(&self) -> Option<&Layout> {
        self.layout.as_ref()
    }

    /// Does the flash itself protect the golden image, and only that?
    pub fn protected(&self) -> bool {
        self.protected
    }

    /// Build id of the running image.
    pub fn build_id(&self) -> u32 {
        self.trailer.build_id
    }

    /// Which image runs.
    pub fn running(&self) -> Running {
        self.running
    }

    /// The slot that loads at the next power-up.
    pub fn selected(&self) -> Option<Slot> {
        self.selected
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Where the settings come from.
    pub fn origin(&self) -> Origin {
        self.origin
    }

    /// The operation word.
    pub fn word(&self) -> OpWord {
        self.word
    }

    /// Is an operation running?
    #[inline]
    pub fn busy(&self) -> bool {
        self.word.busy
    }

    /// Is any of these bytes among the settings? They contain the key, which is not readable.
    fn settings_touched(layout: &Layout, address: u32, length: u32) -> bool {
        let end = layout.settings + 2 * SECTOR;
        address < end && address.saturating_add(length) > layout.settings
    }

    /// May these bytes be erased and programmed? Those of a copy of the pins' configuration only if
    /// it is not the newest whole one, and where the gateware has a use for it.
    #[inline(never)]
    fn writable(&self, layout: &Layout, address: u32, length: u32) -> bool {
        let free = |copy| {
            self.pins.verdict != Verdict::Fixed
                && self.pins.copy != Some(copy)
                && layout.pins_copy(copy).contains(address, length)
        };
        layout.writable(self.selected, address, length) || free(0) || free(1)
    }

    /// A word of the flash window, by byte address. This module does not know the link and the
    /// address in force.
    pub fn read_word(&self, address: u32) -> u32 {
        let [uid_hi, uid_lo] = self.uid;
        match address {
            map::FLASH_OP => self.word.to_word(),
            map::FLASH_ADDRESS => self.address,
            map::FLASH_OP_LENGTH => self.length,
            map::FLASH_CRC => self.crc,
            map::FLASH_JEDEC => self.jedec,
            map::FLASH_UID_HI => uid_hi,
            map::FLASH_UID_LO => uid_lo,
            map::FLASH_SIZE => self.layout.map_or(0, |layout| layout.size),
            map::FLASH_RUNNING => self.running.code(),
            map::FLASH_SELECTED => self.selected.map_or(0, Slot::code),
            map::FLASH_BUILD_ID => self.trailer.build_id,
            map::FLASH_ORIGIN => self.origin.code(),
            map::FLASH_PROTECTED => u32::from(self.protected),
            map::FLASH_PINS => self.pins.to_word(),
            map::FLASH_BUFFER..map::FLASH_SETTINGS => {
                let word = (address - map::FLASH_BUFFER) as usize / 4;
                let word = self.buffer.as_chunks::<4>().0.get(word);
                word.map_or(0, |bytes| u32::from_be_bytes(*bytes))
            }
            map::FLASH_SETTINGS.. => {
                let word = (address - map::FLASH_SETTINGS) as usize / 4;
                self.shown.get(word).copied().unwrap_or(0)
            }
            _ => 0,
        }
    }

    /// May this word be written at all, and with this value? The check does not depend on the
    /// sender or the time.
    pub fn check_write(address: u32, value: u32) -> Result<(), wire::Refusal> {
        match address {
            map::FLASH_OP if Op::from_code(value).is_none() => Err(wire::Refusal::Value),
            map::FLASH_OP | map::FLASH_ADDRESS | map::FLASH_OP_LENGTH => Ok(()),
            map::FLASH_BUFFER..map::FLASH_SETTINGS => Ok(()),
            _ => Err(wire::Refusal::ReadOnly),
        }
    }

    /// Writes a word of the window. [`Flash::check_write`] has allowed it, and no operation runs.
    pub fn write_word<S: SpiDevice>(&mut self, spi: &mut S, address: u32, value: u32) {
        match address {
            map::FLASH_ADDRESS => self.address = value,
            map::FLASH_OP_LENGTH => self.length = value,
            map::FLASH_OP => {
                if let Some(op) = Op::from_code(value) {
                    self.start_op(spi, op);
                }
            }
            _ => {
                let word = (address.wrapping_sub(map::FLASH_BUFFER) / 4) as usize;
                if let Some(bytes) = self.buffer.as_chunks_mut::<4>().0.get_mut(word) {
                    *bytes = value.to_be_bytes();
                }
            }
        }
    }

    /// Starts an operation, as [`Flash::write_word`] does.
    pub fn start_op<S: SpiDevice>(&mut self, spi: &mut S, op: Op) {
        let begun = self.begin(&mut Nor(spi), op);
        self.begun(op, begun);
    }

    /// Starts to save these settings; for a caller that does not have them in the buffer.
    pub fn start_save<S: SpiDevice>(&mut self, spi: &mut S, settings: Settings) {
        let begun = self.save(&mut Nor(spi), settings);
        self.begun(Op::SaveSettings, begun);
    }

    fn begun(&mut self, op: Op, begun: Result<bool, OpResult>) {
        let result = match begun {
            Ok(true) => OpResult::Busy,
            Ok(false) => OpResult::Ok,
            Err(why) => why,
        };
        self.word = OpWord {
            busy: result == OpResult::Busy,
            result,
            op: Some(op),
        };
    }

    /// Does the next slice of the running operation. True if that was its last.
    #[inline(never)]
    pub fn poll<S: SpiDevice>(&mut self, spi: &mut S, now: u64, clock_hz: u32) -> bool {
        if !self.word.busy {
            return false;
        }
        let patience = PATIENCE_SECONDS * u64::from(clock_hz);
        self.word.result = match self.slice(&mut Nor(spi), now, patience) {
            Ok(true) => return false,
            Ok(false) => OpResult::Ok,
            Err(why) => why,
        };
        self.word.busy = false;
        self.waiting = None;
        true
    }

    /// Checks an operation and does its first step; is there more to do?
    fn begin<S: SpiDevice>(&mut self, nor: &mut Nor<S>, op: Op) -> Result<bool, OpResult> {
        let (address, length) = (self.address, self.length);
        let layout = self.known()?;
        let whole = Area {
            start: 0,
            end: layout.size,
        };
        let secret = Self::settings_touched(&layout, address, length);
        let paged = (1..=PAGE).contains(&length);
        match op {
            Op::Read => {
                let bytes = self.buffer.get_mut(..length as usize).filter(|_| paged);
                let bytes = bytes.ok_or(OpResult::Value)?;
                if !whole.contains(address, length) || secret {
                    return Err(OpResult::Address);
                }
                nor.read(address, bytes)?;
                Ok(false)
            }
            Op::Crc => {
                if !whole.contains(address, length) || secret {
                    return Err(OpResult::Address);
                }
                self.job = Job::Crc(PartialCrc::new(address, length));
                Ok(true)
            }
            Op::EraseSector | Op::EraseBlock => {
                let (size, command) = match op {
                    Op::EraseSector => (SECTOR, ERASE_SECTOR),
                    _ => (BLOCK, ERASE_BLOCK),
                };
                if !address.is_multiple_of(size) || !self.writable(&layout, address, size) {
                    return Err(OpResult::Address);
                }
                self.erase(nor, command, address)?;
                self.job = Job::Erased(address);
                Ok(true)
            }
            Op::Program => {
                if !paged {
                    return Err(OpResult::Value);
                }
                let inside = address % PAGE + length <= PAGE;
                if !inside || !self.writable(&layout, address, length) {
                    return Err(OpResult::Address);
                }
                nor.write_enable()?;
                let bytes = self.buffer.get(..length as usize).unwrap_or(&[]);
                nor.at(PROGRAM, address, bytes, &mut [])?;
                self.wait();
                self.job = Job::Programmed;
                Ok(true)
            }
            Op::Select => {
                let slot = Slot::from_code(address).ok_or(OpResult::Value)?;
                let area = layout.slot(slot);
                let meta = meta(nor, area)?.ok_or(OpResult::Image)?;
                if self.idcode.is_some_and(|ours| ours != meta.idcode) {
                    return Err(OpResult::Image);
                }
                self.job = Job::Image {
                    slot,
                    crc: PartialCrc::new(area.start, meta.length),
                    wanted: meta.crc,
                };
                Ok(true)
            }
            Op::SaveSettings => {
                let mut words = [0; layout_of::WORDS];
                for (word, bytes) in words.iter_mut().zip(self.buffer.as_chunks().0) {
                    *word = u32::from_be_bytes(*bytes);
                }
                // The buffer may contain a key, and any client may read the buffer.
                self.buffer.fill(0xff);
                let settings = Settings::parse(&words).map_err(|_| OpResult::Value)?;
                self.save(nor, settings)
            }
            Op::ForgetSettings => {
                let copy = settings::load(nor, &layout)?.older();
                self.job = Job::Forget { copy, left: 2 };
                Ok(true)
            }
            Op::Protect => {
                nor.write_enable()?;
                nor.command(&[WRITE_STATUS, layout.protect_bits() << 2], &[], &mut [])?;
                self.wait();
                self.job = Job::Protected;
                Ok(true)
            }
        }
    }

    fn known(&self) -> Result<Layout, OpResult> {
        self.layout.ok_or(if self.jedec == 0 {
            OpResult::NoFlash
        } else {
            OpResult::Flash
        })
    }

    /// Settings go to the copy that is not the newest; settings that are already saved are not
    /// written again.
    fn save<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        mut settings: Settings,
    ) -> Result<bool, OpResult> {
        let layout = self.known()?;
        let copies = settings::load(nor, &layout)?;
        let copy = copies.older();
        if let Some((newest, _)) = copies.newest() {
            settings.sequence = newest.sequence;
            if settings.keep_key {
                settings.key = newest.key;
            }
            settings.keep_key = false;
            if settings == newest {
                return Ok(false);
            }
        }
        settings.keep_key = false;
        settings.sequence = settings.sequence.wrapping_add(1);
        self.erase(nor, ERASE_SECTOR, layout.settings_copy(copy))?;
        self.job = Job::Save { settings, copy };
        Ok(true)
    }

    fn erase<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        command: u8,
        address: u32,
    ) -> Result<(), OpResult> {
        nor.write_enable()?;
        nor.at(command, address, &[], &mut [])?;
        self.wait();
        Ok(())
    }

    fn program<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        address: u32,
        bytes: &[u8],
    ) -> Result<(), OpResult> {
        nor.write_enable()?;
        nor.at(PROGRAM, address, bytes, &mut [])?;
        self.wait();
        Ok(())
    }

    fn wait(&mut self) {
        // The next slice records the time.
        self.waiting = Some(u64::MAX);
    }

    /// One slice; is there more to do?
    fn slice<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        now: u64,
        patience: u64,
    ) -> Result<bool, OpResult> {
        if self.chip_is_busy(nor, now, patience)? {
            return Ok(true);
        }
        let layout = self.known()?;
        match &mut self.job {
            Job::Finish => Ok(false),
            // A chip that protects a sector does not report it, but its first bytes show it.
            Job::Erased(address) => done(nor.blank(*address, 64)?),
            Job::Programmed => done(self.verify_page(nor)?),
            Job::Protected => {
                self.protected = is_protected(nor, &layout)?;
                done(self.protected)
            }
            Job::Crc(crc) => {
                crc.advance(nor)?;
                self.crc = crc.so_far.value();
                Ok(crc.left > 0)
            }
            Job::Image { slot, crc, wanted } => {
                crc.advance(nor)?;
                if crc.left == 0 {
                    if crc.so_far.value() != *wanted {
                        return Err(OpResult::Image);
                    }
                    self.job = Job::Choose {
                        slot: *slot,
                        steps: 0,
                    };
                }
                Ok(true)
            }
            &mut Job::Choose { slot, steps } => self.select_step(nor, &layout, slot, steps),
            &mut Job::Save { settings, copy } => {
                let mut bytes = [0; layout_of::WORDS * 4];
                wire::words_to_bytes(&settings.to_words(), &mut bytes);
                self.program(nor, layout.settings_copy(copy), &bytes)?;
                self.job = Job::Saved { settings, copy };
                Ok(true)
            }
            &mut Job::Saved { settings, copy } => {
                let newest = settings::load(nor, &layout)?.newest();
                done(newest.is_some_and(|(saved, at)| saved == settings && at == copy))
            }
            &mut Job::Forget { copy, left } => {
                if left == 0 {
                    return done(settings::load(nor, &layout)?.newest().is_none());
                }
                self.erase(nor, ERASE_SECTOR, layout.settings_copy(copy))?;
                self.job = Job::Forget {
                    copy: 1 - copy,
                    left: left - 1,
                };
                Ok(true)
            }
        }
    }

    /// Is the last erase or program command still running? A chip that takes longer than `patience`
    /// is an error.
    fn chip_is_busy<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        now: u64,
        patience: u64,
    ) -> Result<bool, OpResult> {
        let Some(since) = self.waiting else {
            return Ok(false);
        };
        let since = if since == u64::MAX { now } else { since };
        if nor.status()? & BUSY == 0 {
            self.waiting = None;
            return Ok(false);
        }
        self.waiting = Some(since);
        if now.wrapping_sub(since) < patience {
            Ok(true)
        } else {
            Err(OpResult::Flash)
        }
    }

    /// Are the programmed bytes those of the buffer?
    fn verify_page<S: SpiDevice>(&self, nor: &mut Nor<S>) -> Result<bool, OpResult> {
        let mut same = true;
        let mut rest = self.buffer.as_slice();
        nor.each(self.address, self.length, &mut |bytes| {
            let (head, tail) = rest.split_at_checked(bytes.len()).unwrap_or((&[], &[]));
            same &= head == bytes;
            rest = tail;
        })?;
        Ok(same)
    }

    /// The next command of a selection; is there more to do?
    fn select_step<S: SpiDevice>(
        &mut self,
        nor: &mut Nor<S>,
        layout: &Layout,
        slot: Slot,
        steps: u8,
    ) -> Result<bool, OpResult> {
        let step = images::next(nor, layout, slot)?;
        if steps >= STEPS_MAX {
            return Err(OpResult::Flash);
        }
        self.job = Job::Choose {
            slot,
            steps: steps + 1,
        };
        match step {
            Step::Done => {
                self.selected = Some(slot);
                return Ok(false);
            }
            Step::Program(address, bytes) => self.program(nor, address, bytes)?,
            Step::Body(address, slot) => {
                self.program(nor, address, &images::body(layout, slot))?;
            }
            Step::Erase(address) => self.erase(nor, ERASE_SECTOR, address)?,
        }
        Ok(true)
    }
}

/// How often a chip that is busy at start is polled: 300 clocks each, about 4 s.
const LOOKS_MAX: u32 = 800_000;

fn done(well: bool) -> Result<bool, OpResult> {
    if well {
        Ok(false)
    } else {
        Err(OpResult::Flash)
    }
}

fn is_protected<S: SpiDevice>(nor: &mut Nor<S>, layout: &Layout) -> Result<bool, OpResult> {
    Ok(nor.status()? & PROTECTION == layout.protect_bits() << 2)
}

fn meta<S: SpiDevice>(nor: &mut Nor<S>, area: Area) -> Result<Option<Meta>, OpResult> {
    let mut page = [0; META_BYTES];
    nor.read(area.meta(), &mut page)?;
    Ok(Meta::from_page(&page, area))
}

/// For a board without flash: it never answers.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoFlash;

impl embedded_hal::spi::ErrorType for NoFlash {
    type Error = core::convert::Infallible;
}

impl SpiDevice for NoFlash {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        for operation in operations {
            if let Operation::Read(bytes) | Operation::Transfer(bytes, _) = operation {
                bytes.fill(0xff);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
