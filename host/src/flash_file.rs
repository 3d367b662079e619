//! A `.flash` file: the whole content of a new board's flash.
//!
//! Stubs, slot A, the golden image and the jump page, at their places; the rest is erased. It is
//! written once by JTAG and never needed again. Only a consistent file is written: both images
//! whole and for the same FPGA, and a stub at 0 that leads to slot A.

use crate::image::fpga_name;
use wire::board::crc32;
use wire::flash::{Area, Layout, PAGE, SECTOR, Slot};
use wire::images::{Meta, Stub};

/// A file that holds together.
#[derive(Clone, Debug)]
pub struct FlashFile {
    /// What lies where.
    pub layout: Layout,
    /// Of the image in slot A.
    pub image: Meta,
    /// Of the golden image.
    pub golden: Meta,
    bytes: Vec<u8>,
}

/// Why a file is no flash image; it says what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FlashFileError {
    /// A bitstream: what is loaded or sent, not what is written to offset 0.
    Bitstream,
    /// No size a flash has.
    Size(usize),
    /// No image, or a damaged one.
    Image(&'static str),
    /// The two are for different chips.
    Fpgas(u32, u32),
    /// Nothing at 0 leads to slot A.
    Stub,
    /// The last page does not lead to the golden image.
    JumpPage,
}

impl core::fmt::Display for FlashFileError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            FlashFileError::Bitstream => f.write_str(
                "it is a bitstream: write the .flash file beside it, or use ferrocnc flash load (until power-off) or ferrocnc update (over the network)",
            ),
            FlashFileError::Size(size) => write!(
                f,
                "it has {size} bytes, a flash has 2 or 4 MiB; give the .flash file that cargo xtask bitstream wrote, whole"
            ),
            FlashFileError::Image(which) => write!(
                f,
                "its {which} is missing or damaged; copy or build the file again"
            ),
            FlashFileError::Fpgas(image, golden) => write!(
                f,
                "its image is for {}, its golden image for {}; build it again",
                fpga_name(*image),
                fpga_name(*golden)
            ),
            FlashFileError::Stub => {
                f.write_str("nothing at its beginning leads to slot A; build it again")
            }
            FlashFileError::JumpPage => {
                f.write_str("its last page does not lead to the golden image; build it again")
            }
        }
    }
}

impl std::error::Error for FlashFileError {}

impl FlashFile {
    /// Takes a file's contents, or says what is wrong with them.
    pub fn parse(bytes: Vec<u8>) -> Result<FlashFile, FlashFileError> {
        let layout = u32::try_from(bytes.len()).ok().and_then(Layout::of);
        let Some(layout) = layout else {
            return Err(match bytes.starts_with(&[0xff, 0x00]) {
                true => FlashFileError::Bitstream,
                false => FlashFileError::Size(bytes.len()),
            });
        };
        let image =
            whole(&bytes, layout.slot(Slot::A)).ok_or(FlashFileError::Image("image in slot A"))?;
        let golden = whole(&bytes, layout.golden).ok_or(FlashFileError::Image("golden image"))?;
        if image.idcode != golden.idcode {
            return Err(FlashFileError::Fpgas(image.idcode, golden.idcode));
        }
        let first = (0..Layout::STUB_PAGES)
            .map(|n| layout.stub(n) as usize)
            .map(|at| &bytes[at..at + PAGE as usize])
            .find(|page| Stub::has_preamble(page));
        let slot = first
            .and_then(Stub::from_page)
            .and_then(|stub| stub.slot(&layout));
        if slot != Some(Slot::A) {
            return Err(FlashFileError::Stub);
        }
        let jump = Stub::from_page(&bytes[layout.jump_page() as usize..]);
        if jump.map(|stub| stub.target) != Some(layout.golden.start) {
            return Err(FlashFileError::JumpPage);
        }
        Ok(FlashFile {
            layout,
            image,
            golden,
            bytes,
        })
    }

    /// How many bytes.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Never.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Which pieces of a flash differ from this file. Areas that the file leaves erased (settings,
    /// slot B) are not compared: a board in use has data there.
    pub fn compare(&self, flash: &[u8]) -> Vec<(&'static str, u32)> {
        let layout = self.layout;
        let stubs = Area {
            start: Layout::STUBS,
            end: Layout::STUBS + Layout::STUB_SECTORS * SECTOR,
        };
        let jump = Area {
            start: layout.jump_page(),
            end: layout.size,
        };
        let pieces = [
            ("stubs", stubs),
            ("slot A", layout.slot_a),
            ("golden image", layout.golden),
            ("jump page", jump),
        ];
        let mut differ = Vec::new();
        for (name, area) in pieces {
            let (from, to) = (area.start as usize, area.end as usize);
            let theirs = flash.get(from..to).unwrap_or_default();
            let pages = self.bytes[from..to].chunks(PAGE as usize);
            let found = pages.enumerate().find_map(|(n, ours)| {
                let at = n * PAGE as usize;
                let theirs = theirs.get(at..at + ours.len()).unwrap_or_default();
                let blank = ours.iter().all(|byte| *byte == 0xff);
                let offset = ours
                    .iter()
                    .zip(theirs)
                    .position(|(a, b)| a != b)
                    .unwrap_or(0);
                (!blank && ours != theirs).then_some((from + at + offset) as u32)
            });
            differ.extend(found.map(|at| (name, at)));
        }
        differ
    }
}

/// The meta page of an area, if the image before it is what it says.
fn whole(bytes: &[u8], area: Area) -> Option<Meta> {
    let meta = Meta::from_page(bytes.get(area.meta() as usize..)?, area)?;
    let start = area.start as usize;
    let image = bytes.get(start..start + meta.length as usize)?;
    (crc32(image) == meta.crc).then_some(meta)
}

/// Files like the build's, for tests.
#[doc(hidden)]
pub mod sample {
    use super::*;
    use crate::image::Image;

    /// A flash with this image in slot A and that one as golden.
    pub fn file(size: u32, image: &Image, golden: &Image) -> Vec<u8> {
        let layout = Layout::of(size).expect("a size flashes have");
        let mut bytes = vec![0xff; size as usize];
        let mut put = |at: u32, part: &[u8]| {
            bytes[at as usize..at as usize + part.len()].copy_from_slice(part);
        };
        let slot = layout.slot(Slot::A);
        put(0, &Stub { target: slot.start }.to_page());
        for (area, image) in [(slot, image), (layout.golden, golden)] {
            put(area.start, &image.bytes);
            put(area.meta(), &image.meta().to_page());
        }
        let jump = Stub {
            target: layout.golden.start,
        };
        put(layout.jump_page(), &jump.to_page());
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{self, Image};

    fn file() -> Vec<u8> {
        let image =
            |build| Image::parse(&image::sample::file("mill6", "5a-75b-8.0", build, 3000)).unwrap();
        sample::file(0x20_0000, &image(1), &image(2))
    }

    #[test]
    fn a_file_that_holds_together_says_what_is_in_it() {
        let file = FlashFile::parse(file()).unwrap();
        assert_eq!((file.image.build_id, file.golden.build_id), (1, 2));
        assert_eq!(file.len(), 0x20_0000);
    }

    #[test]
    fn what_would_not_boot_is_refused_with_its_own_sentence() {
        let layout = Layout::of(0x20_0000).unwrap();
        let damaged = |at: u32| {
            let mut bytes = file();
            bytes[at as usize] ^= 0x10;
            FlashFile::parse(bytes).unwrap_err()
        };
        assert_eq!(
            damaged(layout.slot_a.start + 100),
            FlashFileError::Image("image in slot A")
        );
        assert_eq!(
            damaged(layout.slot_a.meta()),
            FlashFileError::Image("image in slot A")
        );
        assert_eq!(
            damaged(layout.golden.start + 100),
            FlashFileError::Image("golden image")
        );
        assert_eq!(damaged(18), FlashFileError::Stub);
        assert_eq!(damaged(layout.jump_page() + 18), FlashFileError::JumpPage);
        assert_eq!(
            FlashFile::parse(vec![0; 5]).unwrap_err(),
            FlashFileError::Size(5)
        );
        assert_eq!(
            FlashFile::parse(vec![0xff, 0, 5]).unwrap_err(),
            FlashFileError::Bitstream
        );
    }

    #[test]
    fn settings_and_slot_b_may_differ_and_everything_else_may_not() {
        let file = FlashFile::parse(file()).unwrap();
        let layout = file.layout;
        let mut flash = file.bytes.clone();
        assert_eq!(file.compare(&flash), []);
        flash[layout.settings as usize] = 0;
        flash[layout.slot_b.start as usize] = 0;
        assert_eq!(file.compare(&flash), []);
        flash[layout.golden.start as usize + 7] ^= 1;
        flash[18] = 0;
        assert_eq!(
            file.compare(&flash),
            [("stubs", 18), ("golden image", layout.golden.start + 7)]
        );
        assert_eq!(file.compare(&flash[..100]).len(), 4);
    }
}
