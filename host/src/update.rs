//! Writes a new image into a board's flash over the network. At every moment a working image is
//! selected.
//!
//! ```text
//!   1  refuse what is not for this board, and a machine that is not at rest
//!   2  compare what lies in the slot, 64 KiB at a time, by the board's CRC     what is right already is left alone
//!   3  erase the meta page: the slot counts as empty from here on
//!   4  erase and write every block that differs
//!   5  verify: the board's CRC of every block, then every byte read back
//!   6  write the meta page                                                     now it counts as whole
//!   7  select the slot                                                         one byte: the old or the new
//! ```
//!
//! Only the slot that is not selected is written; the firmware enforces that, too. After an
//! interruption at any point the same command continues from there: step 2 finds the finished
//! blocks.

use crate::client::{Client, ClientError};
use crate::flash::{FlashError, Flasher, Overview, Word};
use crate::image::{Image, fpga_name};
use std::time::Duration;
use wire::board::{Kind, crc32};
use wire::flash::{Area, BLOCK, Layout, PAGE, Running, Slot};
use wire::images::{META_BYTES, Meta, idcode_of};

/// How it is to be done.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// This slot; the one that is not selected if not given.
    pub slot: Option<Slot>,
    /// Another platform's image: the operator knows better.
    pub force_platform: bool,
    /// The board's CRC is enough; not every byte is read back.
    pub quick: bool,
    /// How long a silent board is waited for.
    pub patience: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            slot: None,
            force_platform: false,
            quick: false,
            patience: crate::flash::PATIENCE,
        }
    }
}

/// What is going on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// So much of a step is done, of 1.
    Step(&'static str, f64),
    /// The board falls silent, or is back.
    Word(Word),
    /// No golden image lies in the flash: worth a warning, no obstacle.
    NoGolden,
    /// The flash does not protect the golden image, even when asked to.
    Unprotected,
}

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Where the image lies.
    pub slot: Slot,
    /// Blocks written.
    pub written: u32,
    /// Blocks that were right already.
    pub kept: u32,
    /// What runs until the next power-up.
    pub running: Running,
    /// Its build id.
    pub running_build: u32,
    /// What loads then.
    pub selected: Option<Slot>,
    /// Its build id.
    pub selected_build: u32,
}

/// Why not; it says what to do.
#[derive(Debug)]
pub enum UpdateError {
    /// The board or the way there.
    Flash(FlashError),
    /// For another FPGA.
    Fpga {
        /// The file's.
        file: u32,
        /// The board's, in its own words.
        board: String,
    },
    /// The board does not say which FPGA it has.
    UnknownFpga,
    /// For another PCB.
    Platform {
        /// The file's.
        file: String,
        /// The board's.
        board: String,
    },
    /// Longer than a slot.
    TooLong {
        /// The image.
        length: u32,
        /// The slot.
        room: u32,
    },
    /// The requested slot is the selected one.
    Selected(Slot),
    /// What was read back is not what was written.
    Differs(u32),
    /// Everything is written, and the other slot is selected still.
    NotSelected,
    /// The slot to go back to holds no image.
    Empty(Slot),
    /// No slot is selected, so there is none to go back from.
    NoSlot,
}

impl core::fmt::Display for UpdateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            UpdateError::Flash(error) => write!(f, "{error}"),
            UpdateError::Fpga { file, board } => write!(
                f,
                "the file is for {}, the board has {board}; take the file of this board's platform. Nothing was changed",
                fpga_name(*file)
            ),
            UpdateError::UnknownFpga => f.write_str(
                "the board does not say which FPGA it has, so no file can be trusted to fit; flash it by JTAG once (ferrocnc flash write). Nothing was changed",
            ),
            UpdateError::Platform { file, board } => write!(
                f,
                "the file is for the platform {file}, the board is {board}: its pins would be elsewhere; take the file of this board's platform (--force-platform if you know better). Nothing was changed"
            ),
            UpdateError::TooLong { length, room } => write!(
                f,
                "the image has {length} bytes, this board's flash has room for {room}; build it smaller. Nothing was changed"
            ),
            UpdateError::Selected(slot) => write!(
                f,
                "slot {slot} is what the board loads at power-up and is never written; leave --slot out, or name slot {}",
                slot.other()
            ),
            UpdateError::Differs(at) => write!(
                f,
                "what was read back differs from the file at {at:#08x}; give the command again; if it stays so the flash is worn out. The image selected before stays selected"
            ),
            UpdateError::NotSelected => f.write_str(
                "the image is written, but the board does not select it; look at its console (ferrocnc console). The image selected before stays selected",
            ),
            UpdateError::Empty(slot) => write!(
                f,
                "slot {slot} holds no whole image to go back to; name the file of the image that you want. Nothing was changed"
            ),
            UpdateError::NoSlot => f.write_str(
                "no slot is selected: the board loads its golden image at power-up; name the file of the image that you want. Nothing was changed",
            ),
        }
    }
}

impl std::error::Error for UpdateError {}

impl From<FlashError> for UpdateError {
    fn from(error: FlashError) -> Self {
        UpdateError::Flash(error)
    }
}

impl From<ClientError> for UpdateError {
    fn from(error: ClientError) -> Self {
        UpdateError::Flash(error.into())
    }
}

/// Brings the image into the board and selects it.
pub fn update(
    mut client: Client,
    image: &Image,
    options: &Options,
    tell: &dyn Fn(Event),
) -> Result<Report, UpdateError> {
    fits_board(&mut client, &For::of(image), options.force_platform)?;
    let (overview, layout) = survey(&mut client)?;
    let slot = match (options.slot, overview.selected) {
        (Some(slot), Some(selected)) if slot == selected => {
            return Err(UpdateError::Selected(slot));
        }
        (Some(slot), _) => slot,
        (None, Some(selected)) => selected.other(),
        (None, None) => Slot::A,
    };
    let area = layout.slot(slot);
    let (length, room) = (image.bytes.len() as u32, area.image_max());
    if length > room {
        return Err(UpdateError::TooLong { length, room });
    }
    let mut flasher = Flasher::new(client, options.patience, |word| tell(Event::Word(word)));
    flasher.may_write()?;
    let mut job = Job {
        flasher: &mut flasher,
        image,
        area,
        tell,
    };
    job.look_after_golden(layout.golden, overview.protected)?;
    let differing = job.compare()?;
    let blocks = length.div_ceil(BLOCK);
    let written = differing.len() as u32;
    job.write(&differing)?;
    job.verify(options.quick)?;
    job.seal()?;
    flasher.select(slot)?;
    let after = Overview::read(flasher.client())?;
    if after.selected != Some(slot) {
        return Err(UpdateError::NotSelected);
    }
    Ok(Report {
        slot,
        written,
        kept: blocks - written,
        running: after.running,
        running_build: after.build_id,
        selected: after.selected,
        selected_build: image.build,
    })
}

/// Selects the image in the slot that is not selected: what was selected before the last update.
/// The board itself sums it up first.
pub fn back(
    mut client: Client,
    options: &Options,
    tell: &dyn Fn(Event),
) -> Result<(Report, Meta), UpdateError> {
    let (overview, layout) = survey(&mut client)?;
    let slot = overview.selected.ok_or(UpdateError::NoSlot)?.other();
    let area = layout.slot(slot);
    let mut flasher = Flasher::new(client, options.patience, |word| tell(Event::Word(word)));
    flasher.may_write()?;
    let page = flasher.read(area.meta(), META_BYTES as u32)?;
    let meta = Meta::from_page(&page, area).ok_or(UpdateError::Empty(slot))?;
    let image = For {
        idcode: meta.idcode,
        platform: meta.platform.text(),
    };
    fits_board(flasher.client(), &image, options.force_platform)?;
    tell(Event::Step("checking and selecting", 0.0));
    flasher.select(slot)?;
    let after = Overview::read(flasher.client())?;
    if after.selected != Some(slot) {
        return Err(UpdateError::NotSelected);
    }
    let report = Report {
        slot,
        written: 0,
        kept: meta.length.div_ceil(BLOCK),
        running: after.running,
        running_build: after.build_id,
        selected: after.selected,
        selected_build: meta.build_id,
    };
    Ok((report, meta))
}

/// What an image is for.
struct For<'i> {
    idcode: u32,
    platform: &'i str,
}

impl<'i> For<'i> {
    fn of(image: &'i Image) -> Self {
        For {
            idcode: image.idcode,
            platform: &image.platform,
        }
    }
}

/// What is in the board's flash, and where.
fn survey(client: &mut Client) -> Result<(Overview, Layout), UpdateError> {
    let overview = Overview::read(client)?;
    let layout = overview.layout.ok_or(FlashError::NoFlash {
        jedec: overview.jedec,
    })?;
    Ok((overview, layout))
}

/// Asks the board what it is: the image has to be for it.
fn fits_board(
    client: &mut Client,
    image: &For<'_>,
    force_platform: bool,
) -> Result<(), UpdateError> {
    let identity = client.identify()?;
    let blob = identity.blob();
    fits(
        image,
        blob.text(Kind::Fpga, 0),
        blob.text(Kind::Platform, 0),
        force_platform,
    )
}

/// Is the image for this board?
fn fits(
    image: &For<'_>,
    fpga: Option<&str>,
    platform: Option<&str>,
    force_platform: bool,
) -> Result<(), UpdateError> {
    let board = fpga.ok_or(UpdateError::UnknownFpga)?;
    match idcode_of(board) {
        Some(idcode) if idcode == image.idcode => {}
        Some(_) => {
            return Err(UpdateError::Fpga {
                file: image.idcode,
                board: board.to_owned(),
            });
        }
        None => return Err(UpdateError::UnknownFpga),
    }
    let platform = platform.unwrap_or("unnamed");
    match platform == image.platform || force_platform {
        true => Ok(()),
        false => Err(UpdateError::Platform {
            file: image.platform.to_owned(),
            board: platform.to_owned(),
        }),
    }
}

/// One image into one slot.
struct Job<'j, 't> {
    flasher: &'j mut Flasher<'t>,
    image: &'j Image,
    area: Area,
    tell: &'j dyn Fn(Event),
}

impl Job<'_, '_> {
    fn step(&self, what: &'static str, done: usize, of: usize) {
        (self.tell)(Event::Step(what, done as f64 / of.max(1) as f64));
    }

    /// Warns if the golden image, the last fallback, is missing.
    fn look_after_golden(&mut self, golden: Area, protected: bool) -> Result<(), FlashError> {
        if self.meta_of(golden)?.is_none() {
            (self.tell)(Event::NoGolden);
        } else if !protected {
            match self.flasher.protect() {
                Ok(()) => {}
                Err(FlashError::Failed { .. }) => (self.tell)(Event::Unprotected),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn meta_of(&mut self, area: Area) -> Result<Option<Meta>, FlashError> {
        let page = self.flasher.read(area.meta(), META_BYTES as u32)?;
        Ok(Meta::from_page(&page, area))
    }

    /// The image's part in block `n`, and where it goes.
    fn block(&self, n: usize) -> (u32, &[u8]) {
        let at = n * BLOCK as usize;
        let end = (at + BLOCK as usize).min(self.image.bytes.len());
        (self.area.start + at as u32, &self.image.bytes[at..end])
    }

    fn blocks(&self) -> usize {
        self.image.bytes.len().div_ceil(BLOCK as usize)
    }

    /// Does the board count the same CRC of this block?
    fn is_right(&mut self, n: usize) -> Result<bool, FlashError> {
        let (at, bytes) = self.block(n);
        let (length, ours) = (bytes.len() as u32, crc32(bytes));
        Ok(self.flasher.crc(at, length)? == ours)
    }

    /// Blocks that are not yet as they should be.
    fn compare(&mut self) -> Result<Vec<usize>, FlashError> {
        let mut differing = Vec::new();
        for n in 0..self.blocks() {
            self.step("comparing", n, self.blocks());
            if !self.is_right(n)? {
                differing.push(n);
            }
        }
        Ok(differing)
    }

    /// Makes them so. The slot counts as empty meanwhile.
    fn write(&mut self, blocks: &[usize]) -> Result<(), FlashError> {
        if blocks.is_empty() {
            return Ok(());
        }
        self.unseal()?;
        for (done, n) in blocks.iter().enumerate() {
            let (at, bytes) = self.block(*n);
            let bytes = bytes.to_vec();
            self.step("writing", done, blocks.len());
            self.flasher.erase_block(at)?;
            let pages = bytes.len().div_ceil(PAGE as usize);
            for (page, bytes) in bytes.chunks(PAGE as usize).enumerate() {
                // An erased page says ff by itself.
                if bytes.iter().any(|byte| *byte != 0xff) {
                    self.flasher.program(at + page as u32 * PAGE, bytes)?;
                }
                if page % 16 == 0 {
                    self.step("writing", done * pages + page, blocks.len() * pages);
                }
            }
        }
        Ok(())
    }

    /// The board's own CRC, then every byte.
    fn verify(&mut self, quick: bool) -> Result<(), UpdateError> {
        for n in 0..self.blocks() {
            self.step("verifying (CRC)", n, self.blocks());
            if !self.is_right(n)? {
                return Err(UpdateError::Differs(self.block(n).0));
            }
        }
        if quick {
            return Ok(());
        }
        let bytes = &self.image.bytes;
        let pages = bytes.len().div_ceil(PAGE as usize);
        for (n, page) in bytes.chunks(PAGE as usize).enumerate() {
            if n % 16 == 0 {
                self.step("verifying (reading back)", n, pages);
            }
            let at = self.area.start + n as u32 * PAGE;
            let read = self.flasher.read(at, page.len() as u32)?;
            if let Some(offset) = read.iter().zip(page).position(|(a, b)| a != b) {
                return Err(UpdateError::Differs(at + offset as u32));
            }
        }
        Ok(())
    }

    /// Takes the meta page away, if there is anything.
    fn unseal(&mut self) -> Result<(), FlashError> {
        let meta = self.area.meta();
        let page = self.flasher.read(meta, PAGE)?;
        match page.iter().all(|byte| *byte == 0xff) {
            true => Ok(()),
            false => self.flasher.erase_sector(meta),
        }
    }

    /// Writes the meta page: from here on the slot counts as whole.
    fn seal(&mut self) -> Result<(), UpdateError> {
        let (meta, page) = (self.area.meta(), self.image.meta().to_page());
        if self.flasher.read(meta, PAGE)? == page {
            return Ok(());
        }
        self.unseal()?;
        self.flasher.program(meta, &page)?;
        match self.flasher.read(meta, PAGE)? == page {
            true => Ok(()),
            false => Err(UpdateError::Differs(meta)),
        }
    }
}
