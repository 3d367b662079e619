//! A board's flash as it is first written, with images small enough for thousands of writes.
//!
//! The images are bitstreams that the FPGA's own loader ([`sim::loader`]) takes, with their build
//! id as USERCODE, so that the model of an ECP5, not our own code, decides what loads after a power
//! cut.

use sim::loader::{self, Small, Trouble};
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part};
use sim::rig::{Rig, Setup};
use std::net::Ipv4Addr;
use wire::Name;
use wire::crc::crc32;
use wire::flash::{Area, Layout, Slot};
use wire::images::{Meta, Role, Stub, Trailer};

pub use sim::model_board::{IDCODE, UID};

/// Build id of the image a new board runs, in slot A.
pub const FIRST: u32 = 0xaaaa_0001;
/// Build id of an image that is brought in.
pub const SECOND: u32 = 0xbbbb_0002;
/// Build id of a new board's golden image.
pub const GOLDEN: u32 = 0x601d_601d;
/// The configuration and the platform of these tests. Its file gives it no hardware address: each
/// board makes its own.
pub const CONFIGURATION: &str = "75b_v8_14o11i6s6e6p";
/// See [`CONFIGURATION`].
pub const PLATFORM: &str = "5a-75b-8.0";

/// An image of this build and so many frames of 77 bytes.
pub fn image(build: u32, frames: u16) -> Vec<u8> {
    let small = Small {
        idcode: IDCODE,
        usercode: build,
        frames,
    };
    small.bytes()
}

/// The same image followed by the services, as packing puts them there.
pub fn with_program(image: &[u8], program: &[u8]) -> Vec<u8> {
    let mut image = image.to_vec();
    image.resize(image.len().next_multiple_of(4), 0xff);
    image.extend(program);
    image
}

/// What the build left for the SDRAM of a board with jobs.
pub fn program() -> Vec<u8> {
    built("ferrocnc-services.bin")
}

/// What it left for a board without.
pub fn program_without_jobs() -> Vec<u8> {
    built("ferrocnc-services-without-jobs.bin")
}

fn built(name: &str) -> Vec<u8> {
    let path = crate::parts().1.with_file_name(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// What its meta page says.
pub fn meta(image: &[u8], build: u32) -> Meta {
    let name = |text| Name::new(text).unwrap_or_default();
    Meta {
        length: image.len() as u32,
        crc: crc32(image),
        build_id: build,
        idcode: IDCODE,
        configuration: name(CONFIGURATION),
        platform: name(PLATFORM),
    }
}

/// The file such an image comes in.
pub fn bit(build: u32, frames: u16) -> Vec<u8> {
    host::image::sample::wrap(CONFIGURATION, PLATFORM, build, &image(build, frames))
}

/// What lies where in this chip.
pub fn layout(nor: &Nor) -> Layout {
    Layout::of(nor.part().bytes as u32).expect("a size boards have")
}

fn put(nor: &mut Nor, area: Area, image: &[u8], meta: &Meta) {
    nor.preload(area.start as usize, image);
    nor.preload(area.meta() as usize, &meta.to_page());
}

/// A flash as the bench leaves it: [`FIRST`] in slot A and selected, [`GOLDEN`] protected, the rest
/// erased.
pub fn factory(part: Part, uid: u64) -> Nor {
    let mut nor = Nor::new(part, uid);
    let layout = layout(&nor);
    let (first, golden) = (image(FIRST, 3), image(GOLDEN, 3));
    put(&mut nor, layout.slot_a, &first, &meta(&first, FIRST));
    put(&mut nor, layout.golden, &golden, &meta(&golden, GOLDEN));
    let stub = |target| Stub { target }.to_page();
    nor.preload(0, &stub(layout.slot_a.start));
    nor.preload(layout.jump_page() as usize, &stub(layout.golden.start));
    nor.lock(layout.protect_bits());
    nor
}

/// The same with the services after the image in slot A.
pub fn with_services(part: Part, uid: u64) -> Nor {
    followed_by(part, uid, &program_without_jobs())
}

/// The same with this program after the image in slot A.
pub fn followed_by(part: Part, uid: u64, program: &[u8]) -> Nor {
    let mut nor = factory(part, uid);
    let area = layout(&nor).slot_a;
    let image = with_program(&image(FIRST, 3), program);
    put(&mut nor, area, &image, &meta(&image, FIRST));
    nor
}

/// What runs after a power-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boots {
    /// The image of this build in a slot.
    Slot(Slot, u32),
    /// The golden image, and why.
    Golden(Option<Trouble>),
    /// Nothing does.
    Nothing,
}

/// Switches the FPGA on.
pub fn boots(nor: &Nor) -> Boots {
    let layout = layout(nor);
    let loaded = loader::power_up(nor.cells(), IDCODE);
    let Some(at) = loaded.image else {
        return Boots::Nothing;
    };
    let slot = [Slot::A, Slot::B]
        .into_iter()
        .find(|slot| layout.slot(*slot).start as usize == at);
    match slot {
        Some(slot) => Boots::Slot(slot, loaded.usercode),
        None => {
            assert_eq!(
                (at, loaded.usercode),
                (layout.golden.start as usize, GOLDEN)
            );
            Boots::Golden(loaded.fell_back)
        }
    }
}

/// Power comes to a Verilated board with this flash that is expected at this address, and runs
/// [`FIRST`].
pub fn power_up(flash: &Shared, ip: Ipv4Addr, factory_pin: bool) -> Rig {
    flash.chip().power_up();
    let (soc, firmware) = crate::parts();
    let mut setup = Setup::new(&soc, &firmware);
    setup.flash = Some(flash.clone());
    setup.board_ip = ip;
    setup.factory = factory_pin;
    setup.trailer = Trailer {
        build_id: FIRST,
        role: Role::Image,
    };
    Rig::boot(setup).unwrap_or_else(|error| panic!("{error}"))
}
