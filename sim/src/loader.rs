//! The configuration of an ECP5 from its flash at power-up: which image it runs, and how it found
//! it.
//!
//! ```text
//! read from 0 on --- preamble BD B3? --- commands ---- DONE ---> runs
//!                        |                  |   `----- JUMP a: read from a on, once more from the left
//!                        | none             | wrong: CRC, id, command
//!                        v                  v
//!                    read the last page of the flash, once ---> JUMP ---> golden
//! ```
//!
//! Commands, their lengths and the CRC are those of Project Trellis
//! (`libtrellis/src/Bitstream.cpp`), which real chips load. A bitstream is not expanded; a frame is
//! as long as its compression says. Any two bytes BD B3 are taken for a preamble: the data sheet
//! names these 16 bits; a real chip that checks more would only find fewer false preambles.
//!
//! It also makes bitstreams, small ones of the same commands ([`Small`]), for tests that load
//! thousands of times.

use crate::nor::PAGE;

/// Bytes from where reading begins within which the preamble must be found. The real limit is not
/// published; our flashes need no more than the two sectors of stubs.
pub const SEARCH: usize = 0x2000;
/// More jumps than any flash of ours has: a circle.
const JUMPS: usize = 8;
/// Bytes of a frame of the LFE5U-12 and -25, of which all these boards are.
const FRAME: usize = 74;
/// Bytes it is padded to when compressed: whole 64-bit words.
const PADDED: usize = FRAME.next_multiple_of(8);
/// The preamble.
const PREAMBLE: [u8; 2] = [0xbd, 0xb3];

/// Commands.
mod op {
    pub const DUMMY: u8 = 0xff;
    pub const RESET_CRC: u8 = 0x3b;
    pub const VERIFY_ID: u8 = 0xe2;
    pub const WRITE_COMP_DIC: u8 = 0x02;
    pub const PROG_CNTRL0: u8 = 0x22;
    pub const INIT_ADDRESS: u8 = 0x46;
    pub const PROG_INCR_CMP: u8 = 0xb8;
    pub const PROG_INCR_RTI: u8 = 0x82;
    pub const PROG_SED_CRC: u8 = 0xa2;
    pub const PROGRAM_SECURITY: u8 = 0xce;
    pub const PROGRAM_USERCODE: u8 = 0xc2;
    pub const EBR_ADDRESS: u8 = 0xf6;
    pub const EBR_WRITE: u8 = 0xb2;
    pub const PROGRAM_DONE: u8 = 0x5e;
    pub const SPI_MODE: u8 = 0x79;
    pub const JUMP: u8 = 0x7e;
}

/// Why something did not load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// No preamble within reach.
    NoPreamble,
    /// The flash ends in the middle.
    End,
    /// A CRC does not fit.
    Crc,
    /// For another chip.
    Id(u32),
    /// An unknown command.
    Command(u8),
    /// Jumps for ever.
    Circle,
}

/// The result of a power-up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loaded {
    /// Where the image that runs begins: what was jumped to, or 0.
    pub image: Option<usize>,
    /// Its USERCODE.
    pub usercode: u32,
    /// Where each preamble was found, in order.
    pub preambles: Vec<usize>,
    /// Why it came to the page at the end.
    pub fell_back: Option<Trouble>,
    /// Why the fallback failed, too.
    pub failed: Option<Trouble>,
}

/// Power comes to a chip with this id before a flash with these contents.
pub fn power_up(flash: &[u8], idcode: u32) -> Loaded {
    let mut loaded = Loaded {
        image: None,
        usercode: 0,
        preambles: Vec::new(),
        fell_back: None,
        failed: None,
    };
    loaded.fell_back = load(flash, 0, idcode, &mut loaded).err();
    if loaded.fell_back.is_some() {
        let page = flash.len().saturating_sub(PAGE);
        loaded.failed = load(flash, page, idcode, &mut loaded).err();
    }
    loaded
}

fn load(flash: &[u8], from: usize, idcode: u32, loaded: &mut Loaded) -> Result<(), Trouble> {
    let mut at = from;
    for _ in 0..JUMPS {
        let reach = &flash[at.min(flash.len())..flash.len().min(at + SEARCH)];
        let found = reach.windows(2).position(|pair| pair == PREAMBLE);
        let preamble = at + found.ok_or(Trouble::NoPreamble)?;
        loaded.preambles.push(preamble);
        match Reader::new(flash, preamble + 2).run(idcode)? {
            End::Jump(target) => at = target,
            End::Done { usercode } => {
                (loaded.image, loaded.usercode) = (Some(at), usercode);
                return Ok(());
            }
        }
    }
    Err(Trouble::Circle)
}

enum End {
    Jump(usize),
    Done { usercode: u32 },
}

/// CRC-16, polynomial 8005, from 0, no reflection.
fn crc16(crc: u16, byte: u8) -> u16 {
    (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| {
        crc << 1 ^ if crc & 0x8000 != 0 { 0x8005 } else { 0 }
    })
}

struct Reader<'f> {
    flash: &'f [u8],
    at: usize,
    crc: u16,
}

impl<'f> Reader<'f> {
    fn new(flash: &'f [u8], at: usize) -> Self {
        Reader { flash, at, crc: 0 }
    }

    fn raw(&mut self) -> Result<u8, Trouble> {
        let byte = self.flash.get(self.at).copied().ok_or(Trouble::End)?;
        self.at += 1;
        Ok(byte)
    }

    fn byte(&mut self) -> Result<u8, Trouble> {
        let byte = self.raw()?;
        self.crc = crc16(self.crc, byte);
        Ok(byte)
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], Trouble> {
        let mut bytes = [0; N];
        for byte in &mut bytes {
            *byte = self.byte()?;
        }
        Ok(bytes)
    }

    fn word(&mut self) -> Result<u32, Trouble> {
        self.bytes().map(u32::from_be_bytes)
    }

    fn check(&mut self) -> Result<(), Trouble> {
        let counted = std::mem::take(&mut self.crc);
        let told = u16::from_be_bytes([self.raw()?, self.raw()?]);
        if counted == told {
            Ok(())
        } else {
            Err(Trouble::Crc)
        }
    }

    /// One compressed frame: whole bytes, each by a prefix-free code (0; 10 and four bits; 11 and
    /// eight bits).
    fn compressed(&mut self) -> Result<(), Trouble> {
        let (mut left, mut buffer) = (0, 0u32);
        let mut bits = |reader: &mut Self, count: u32| -> Result<u32, Trouble> {
            while left < count {
                buffer = buffer << 8 | u32::from(reader.byte()?);
                left += 8;
            }
            left -= count;
            Ok(buffer >> left & ((1 << count) - 1))
        };
        for _ in 0..PADDED {
            if bits(self, 1)? == 1 {
                let rest = if bits(self, 1)? == 1 { 8 } else { 4 };
                bits(self, rest)?;
            }
        }
        Ok(())
    }

    fn run(&mut self, idcode: u32) -> Result<End, Trouble> {
        let mut usercode = 0;
        loop {
            let command = self.raw()?;
            if command == op::DUMMY {
                continue;
            }
            self.crc = crc16(self.crc, command);
            let [mode, high, low] = self.bytes()?;
            let count = usize::from(u16::from_be_bytes([high, low]));
            let checked = mode & 0x80 != 0;
            match command {
                op::RESET_CRC => self.crc = 0,
                op::VERIFY_ID => {
                    let id = self.word()?;
                    if id != idcode {
                        return Err(Trouble::Id(id));
                    }
                }
                op::INIT_ADDRESS | op::PROGRAM_SECURITY | op::SPI_MODE => {}
                op::PROG_CNTRL0 | op::EBR_ADDRESS | op::PROG_SED_CRC => {
                    self.word()?;
                }
                op::WRITE_COMP_DIC => {
                    self.bytes::<8>()?;
                    if checked {
                        self.check()?;
                    }
                }
                op::PROGRAM_USERCODE => {
                    usercode = self.word()?;
                    if checked {
                        self.check()?;
                    }
                    self.crc = 0;
                }
                op::PROG_INCR_RTI | op::PROG_INCR_CMP => {
                    let (each, dummies) = (mode & 0x40 == 0, usize::from(mode & 0x0f));
                    for frame in 1..=count {
                        if command == op::PROG_INCR_CMP {
                            self.compressed()?;
                        } else {
                            self.bytes::<FRAME>()?;
                        }
                        if checked && (each || frame == count) {
                            self.check()?;
                        }
                        for _ in 0..dummies {
                            self.byte()?;
                        }
                    }
                }
                op::EBR_WRITE => {
                    for _ in 0..count {
                        self.bytes::<9>()?;
                    }
                    if checked {
                        self.check()?;
                    }
                }
                op::PROGRAM_DONE => {
                    if checked {
                        self.check()?;
                    }
                    return Ok(End::Done { usercode });
                }
                op::JUMP => {
                    let [_, a, b, c] = self.bytes()?;
                    return Ok(End::Jump(u32::from_be_bytes([0, a, b, c]) as usize));
                }
                unknown => return Err(Trouble::Command(unknown)),
            }
        }
    }
}

/// A bitstream of a few frames of noise: loads, and is told from others by its USERCODE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Small {
    /// The chip it is for.
    pub idcode: u32,
    /// Its USERCODE, and where its noise is from.
    pub usercode: u32,
    /// Frames of 77 bytes.
    pub frames: u16,
}

impl Small {
    /// Its bytes, from FF FF BD B3 to the last dummy.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0xff, 0xff, 0xbd, 0xb3, 0xff, 0xff, 0xff, 0xff];
        bytes.extend([op::RESET_CRC, 0, 0, 0]);
        let mut crc = 0;
        let mut put = |bytes: &mut Vec<u8>, new: &[u8]| {
            crc = new.iter().fold(crc, |crc, byte| crc16(crc, *byte));
            bytes.extend(new);
            crc
        };
        let word = |word: u32| word.to_be_bytes();
        put(&mut bytes, &[op::VERIFY_ID, 0, 0, 0]);
        put(&mut bytes, &word(self.idcode));
        put(&mut bytes, &[op::PROG_CNTRL0, 0, 0, 0, 0x40, 0, 0, 0]);
        put(&mut bytes, &[op::INIT_ADDRESS, 0, 0, 0]);
        let [high, low] = self.frames.to_be_bytes();
        put(&mut bytes, &[op::PROG_INCR_RTI, 0x91, high, low]);
        let mut noise = u64::from(self.usercode) << 1 | 1;
        // The CRC so far counts into the first frame's; a dummy byte behind one into the next
        // one's.
        for _ in 0..self.frames {
            let frame: Vec<u8> = (0..FRAME)
                .map(|_| {
                    noise = noise
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    (noise >> 56) as u8
                })
                .collect();
            let sum = put(&mut bytes, &frame);
            put(&mut bytes, &sum.to_be_bytes());
            put(&mut bytes, &[0xff]);
        }
        bytes.extend([op::DUMMY; 12]);
        put(&mut bytes, &[op::PROGRAM_USERCODE, 0x80, 0, 0]);
        let sum = put(&mut bytes, &word(self.usercode));
        bytes.extend(sum.to_be_bytes());
        bytes.extend([op::PROGRAM_DONE, 0, 0, 0]);
        bytes.extend([op::DUMMY; 4]);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::images::Stub;

    const ID: u32 = 0x4111_1043;
    const GOLDEN: usize = 0x30_0000;

    fn image(usercode: u32) -> Vec<u8> {
        let small = Small {
            idcode: ID,
            usercode,
            frames: 4,
        };
        small.bytes()
    }

    /// A flash with these at their places, and golden after its jump.
    fn flash(parts: &[(usize, Vec<u8>)]) -> Vec<u8> {
        let mut flash = vec![0xff; 4 << 20];
        let jump = Stub {
            target: GOLDEN as u32,
        };
        let always = [
            (GOLDEN, image(9)),
            (flash.len() - PAGE, jump.to_page().to_vec()),
        ];
        for (at, bytes) in always.iter().chain(parts) {
            flash[*at..at + bytes.len()].copy_from_slice(bytes);
        }
        flash
    }

    fn stub(target: u32) -> Vec<u8> {
        Stub { target }.to_page().to_vec()
    }

    #[test]
    fn an_image_at_0_loads() {
        let loaded = power_up(&flash(&[(0, image(5))]), ID);
        assert_eq!((loaded.image, loaded.usercode), (Some(0), 5));
        assert_eq!(loaded.preambles, [2]);
    }

    #[test]
    fn the_first_live_stub_is_the_one_that_counts() {
        let mut broken = stub(0x1_0000);
        broken[Stub::SWITCH_AT] = 0;
        let parts = [
            (0, broken),
            (0x100, stub(0x10_0000)),
            (0x200, stub(0x1_0000)),
            (0x1_0000, image(1)),
            (0x10_0000, image(2)),
        ];
        let loaded = power_up(&flash(&parts), ID);
        assert_eq!((loaded.image, loaded.usercode), (Some(0x10_0000), 2));
        assert_eq!(loaded.fell_back, None);
    }

    #[test]
    fn nothing_at_0_or_something_wrong_behind_a_stub_means_golden() {
        let golden = |parts: &[(usize, Vec<u8>)]| {
            let loaded = power_up(&flash(parts), ID);
            assert_eq!(
                (loaded.image, loaded.usercode),
                (Some(GOLDEN), 9),
                "{loaded:?}"
            );
            loaded.fell_back.expect("it fell back")
        };
        assert_eq!(golden(&[]), Trouble::NoPreamble);
        assert_eq!(golden(&[(0, stub(0x1_0000))]), Trouble::NoPreamble);
        assert_eq!(golden(&[(0, stub(0))]), Trouble::Circle);
        let other = Small {
            idcode: 0x4111_2043,
            usercode: 1,
            frames: 1,
        };
        let behind = |bytes| [(0, stub(0x1_0000)), (0x1_0000, bytes)];
        assert_eq!(golden(&behind(other.bytes())), Trouble::Id(0x4111_2043));
    }

    #[test]
    fn any_byte_of_an_image_that_is_wrong_means_golden_or_does_not_matter() {
        let good = image(1);
        let (mut fell, mut same) = (0, 0);
        for at in 2..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x10;
            let loaded = power_up(&flash(&[(0, stub(0x1_0000)), (0x1_0000, bad)]), ID);
            match loaded.usercode {
                9 => fell += 1,
                // Bits without effect: unused operands, dummies before the CRC.
                1 => same += 1,
                other => panic!("byte {at}: USERCODE {other}"),
            }
        }
        assert!(same < 24 && fell > 300, "{fell} fell back, {same} loaded");
    }

    #[test]
    fn without_golden_there_is_nothing() {
        let loaded = power_up(&vec![0xff; 2 << 20], ID);
        assert_eq!(loaded.image, None);
        assert_eq!(loaded.failed, Some(Trouble::NoPreamble));
    }

    #[test]
    fn a_compressed_frame_ends_where_its_bits_do() {
        // 80 times the byte 0, then one of each kind of code.
        let mut bytes = vec![0; 10];
        bytes.extend([0b1000_0110, 0b1011_1111, 0b1111_1100]);
        bytes.extend([0; 10]);
        let mut reader = Reader::new(&bytes, 0);
        assert_eq!(reader.compressed(), Ok(()));
        assert_eq!(reader.at, 10);
        // 100001 101011 1111111111 and 77 zeros: 99 bits.
        assert_eq!(reader.compressed(), Ok(()));
        assert_eq!(reader.at, 23);
    }
}
