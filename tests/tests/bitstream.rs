//! The files of a build, read by the host's parsers and by a model of an ECP5 at power-up.
//!
//! `cargo xtask test bitstream` builds them and says where they are.

use std::path::PathBuf;

use ferrocnc_tests::wired;
use host::flash_file::{self, FlashFile};
use host::image::{Image, ImageError};
use sim::loader::power_up;
use wire::flash::Slot;
use wire::images::idcode_of;

/// The files of one configuration.
struct Files {
    name: String,
    image: Vec<u8>,
    golden: Vec<u8>,
    svf: String,
    flash: Vec<u8>,
}

fn files() -> Files {
    files_in("")
}

/// The same design packed with the services.
fn with_services() -> Files {
    files_in("with-services")
}

fn files_in(place: &str) -> Files {
    let folder = std::env::var_os("FERROCNC_BITSTREAM");
    let folder =
        PathBuf::from(folder.expect("FERROCNC_BITSTREAM names the folder of a built bitstream"));
    let name = folder.file_name().and_then(|name| name.to_str());
    let name = name
        .expect("the folder has the configuration's name")
        .to_owned();
    let read = |end: &str| {
        let file = folder.join(place).join(format!("{name}{end}"));
        std::fs::read(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
    };
    Files {
        image: read(".bit"),
        golden: read("-golden.bit"),
        svf: String::from_utf8(read(".svf")).expect("SVF is text"),
        flash: read(".flash"),
        name,
    }
}

fn images(files: &Files) -> (Image, Image) {
    let parse = |file: &[u8]| Image::parse(file).unwrap_or_else(|e| panic!("refused: {e}"));
    (parse(&files.image), parse(&files.golden))
}

#[test]
fn the_host_takes_both_images_for_what_they_are() {
    let files = files();
    let (image, golden) = images(&files);
    for found in [&image, &golden] {
        assert_eq!(found.configuration, files.name);
        assert_eq!(idcode_of(&found.part), Some(found.idcode));
        assert_eq!(found.version, env!("CARGO_PKG_VERSION"));
    }
    assert_eq!(image.build, golden.build, "one build");
    assert_eq!(image.platform, golden.platform);
    assert_ne!(image.bytes, golden.bytes, "their trailers differ");
}

#[test]
fn a_file_cut_anywhere_or_with_a_changed_byte_is_refused() {
    let files = files();
    let length = files.image.len();
    for cut in (0..length).step_by(4001).chain([length - 1]) {
        assert!(
            Image::parse(&files.image[..cut]).is_err(),
            "cut to {cut} bytes"
        );
    }
    let header = length - images(&files).0.bytes.len();
    for at in (header + 4..length).step_by(4001) {
        let mut damaged = files.image.clone();
        damaged[at] ^= 1;
        let error = Image::parse(&damaged).expect_err("a damaged file");
        assert!(
            matches!(error, ImageError::Crc { .. }),
            "byte {at}: {error}"
        );
    }
}

#[test]
fn the_flash_image_is_byte_for_byte_what_the_host_would_make_of_the_two() {
    let files = files();
    let (image, golden) = images(&files);
    let flash = FlashFile::parse(files.flash.clone()).unwrap_or_else(|e| panic!("refused: {e}"));
    assert_eq!(flash.image, image.meta());
    assert_eq!(flash.golden, golden.meta());
    let made = flash_file::sample::file(flash.layout.size, &image, &golden);
    let differ = made.iter().zip(&files.flash).position(|(a, b)| a != b);
    assert_eq!(differ, None, "first difference");
}

#[test]
fn an_image_with_services_fits_its_places_and_the_host_takes_it_apart() {
    let (bare, files) = (files(), with_services());
    let program = wired::program_without_jobs();
    let (image, golden) = images(&files);
    let flash = FlashFile::parse(files.flash.clone()).unwrap_or_else(|e| panic!("refused: {e}"));
    let layout = flash.layout;
    for (found, bare, area) in [
        (&image, images(&bare).0, layout.slot(Slot::A)),
        (&golden, images(&bare).1, layout.golden),
    ] {
        assert_eq!(bare.program(), 0, "a board without SDRAM");
        assert_eq!(found.program(), program.len());
        let (bitstream, services) = found.bytes.split_at(found.bytes.len() - program.len());
        assert!(services == program, "other services than were built");
        assert!(bitstream.len().is_multiple_of(4));
        assert_ne!(found.build, bare.build, "another build");
        let room = (area.meta() - area.start) as usize;
        println!("{} of {room} bytes", found.bytes.len());
        assert!(found.bytes.len() <= room);
        // What the FPGA gets is as long as without them. Only the words that say the build differ.
        assert!(bitstream.len().abs_diff(bare.bytes.len()) < 1000);
    }
    assert_eq!((flash.image, flash.golden), (image.meta(), golden.meta()));
    let made = flash_file::sample::file(layout.size, &image, &golden);
    assert!(
        made == files.flash,
        "another flash than the host would make"
    );
    // The FPGA runs it, and stops reading before the services.
    let runs = |flash: &[u8]| power_up(flash, image.idcode);
    let slot = layout.slot(Slot::A).start as usize;
    assert_eq!(runs(&files.flash).image, Some(slot));
    let mut other = files.flash.clone();
    let end = slot + image.bytes.len();
    other[end - program.len()..end].fill(0xff);
    assert_eq!(runs(&other).image, Some(slot), "without the services");
    other[slot + image.bytes.len() / 4] ^= 0x10;
    let golden = layout.golden.start as usize;
    assert_eq!(runs(&other).image, Some(golden), "a damaged bitstream");
}

#[test]
fn an_ecp5_runs_slot_a_and_golden_when_that_is_damaged_or_nothing_leads_to_it() {
    let files = files();
    let (image, _) = images(&files);
    let layout = FlashFile::parse(files.flash.clone())
        .expect("a whole file")
        .layout;
    let (slot, golden) = (
        layout.slot(Slot::A).start as usize,
        layout.golden.start as usize,
    );
    let runs = |flash: &[u8]| power_up(flash, image.idcode);

    let good = runs(&files.flash);
    assert_eq!((good.image, good.fell_back), (Some(slot), None));
    // Any byte of the image: frames, block RAMs, commands.
    for at in (slot + 20..slot + image.bytes.len() - 40).step_by(9973) {
        let mut flash = files.flash.clone();
        flash[at] ^= 0x10;
        assert_eq!(runs(&flash).image, Some(golden), "byte {at:#x} changed");
    }
    let mut cut = files.flash.clone();
    cut[slot + image.bytes.len() / 2..slot + image.bytes.len()].fill(0xff);
    assert_eq!(runs(&cut).image, Some(golden), "half written");
    let mut erased = files.flash.clone();
    erased[..0x2000].fill(0xff);
    assert_eq!(runs(&erased).image, Some(golden), "no stub");
}

#[test]
fn the_svf_loads_the_same_bytes() {
    let files = files();
    let (image, _) = images(&files);
    // Everything shifted after LSC_BITSTREAM_BURST (7A), each row last byte first and last bit
    // first.
    let (_, burst) = files.svf.split_once("TDI  (7A)").expect("a burst");
    let (burst, _) = burst.split_once("SIR\t8\tTDI  (FF)").expect("its end");
    let mut loaded = Vec::new();
    for row in burst.split("TDI  (").skip(1) {
        let (row, _) = row.split_once(')').expect("a row's end");
        let digits: Vec<u8> = row.bytes().filter(u8::is_ascii_hexdigit).collect();
        let (pairs, _) = digits.as_chunks::<2>();
        loaded.extend(pairs.iter().rev().map(|pair| {
            let text = core::str::from_utf8(pair).expect("digits");
            u8::from_str_radix(text, 16)
                .expect("hexadecimal")
                .reverse_bits()
        }));
    }
    // ecppack shifts its own comment header, too; the FPGA waits for the preamble.
    let header = loaded.strip_suffix(image.bytes.as_slice());
    let header = header.unwrap_or_else(|| panic!("{} bytes end otherwise", loaded.len()));
    assert!(header.starts_with(&[0xff, 0]) && header.len() < 100);
}
