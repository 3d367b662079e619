//! The layout of the board's SPI flash, and the operations of the flash window
//! ([`crate::map::FLASH`]).
//!
//! ```text
//!               4 MiB                     2 MiB
//! stubs         0x000000, 0x001000        same                   which slot loads (`images::Stub`)
//! slot A        0x010000..0x100000        0x010000..0x0c0000     an image, its meta page in the last sector
//! slot B        0x100000..0x1f0000        0x0c0000..0x170000     the same
//! settings      0x1f0000, 0x1f1000        0x170000, 0x171000     two copies, a sector each
//! pins          0x1f2000, 0x1f8000        0x172000, 0x178000     two copies of 24 KiB (`pins`)
//! golden        0x300000..0x3ff000        0x180000..0x1ff000     as a slot; protected by the flash, too;
//!                                                                without the services in 2 MiB
//! jump page     the last 256 bytes                               to golden, when nothing at 0 loads
//! ```
//!
//! # Operations
//!
//! Write the operands, then an [`Op`] to [`crate::map::FLASH_OP`]. Read that word until
//! [`OpWord::busy`] is gone: then [`OpWord::result`] is the outcome. If the client may not start an
//! operation now, its write is refused as a datagram (`armed`, `not-owner`, `busy`, `value`); an
//! error that the operation itself finds is its result. The operands and the operation may be one
//! datagram: words take effect in order.
//!
//! `Read` and `Crc` reach everything but the settings, which contain the key. `EraseSector`,
//! `EraseBlock` and `Program` reach only the slot that is not selected, and the copy of the pins'
//! configuration that is not in force. The rest of the flash changes only by `Select`,
//! `SaveSettings`, `ForgetSettings` and `Protect`.

use crate::codes::codes;

/// The smallest part that can be erased.
pub const SECTOR: u32 = 0x1000;
/// The largest part that can be erased at once.
pub const BLOCK: u32 = 0x1_0000;
/// The largest part that can be programmed at once.
pub const PAGE: u32 = 0x100;

/// Is the copy with this number newer than the one with the other? Both were counted up modulo
/// 2^32.
pub const fn is_newer(number: u32, than: u32) -> bool {
    number.wrapping_sub(than) as i32 > 0
}

codes! {
    /// An operation of the flash.
    Op: u32 {
        /// `length` bytes (1..=256) from `address` into the buffer.
        Read = 1, "read";
        /// Erase the sector at `address`.
        EraseSector = 2, "erase a sector";
        /// Erase the 64 KiB block at `address`.
        EraseBlock = 3, "erase a block";
        /// Program `length` bytes (1..=256) of the buffer to `address`, inside one page, and read
        /// them back.
        Program = 4, "program a page";
        /// CRC-32 of `length` bytes from `address`.
        Crc = 5, "sum up";
        /// Load slot `address` ([`Slot`]) from the next power-up on, after its image was found to
        /// be whole.
        Select = 6, "select a slot";
        /// Save the [`crate::settings::Settings`] in the buffer; in force after the next start.
        SaveSettings = 7, "save settings";
        /// Forget all saved settings; built-in ones are in force after the next start.
        ForgetSettings = 8, "forget settings";
        /// Set the flash's own protection, to the golden image and nothing else.
        Protect = 9, "protect the golden image";
    }
}

codes! {
    /// The result of an operation.
    OpResult: u32 {
        /// Done.
        Ok = 0, "done";
        /// It is still running, or another one is.
        Busy = 1, "still running";
        /// The machine is armed.
        Armed = 2, "refused: the machine is armed";
        /// Outside the slots, in the selected slot, not aligned, or past its end.
        Address = 3, "refused: the address is not in the slot that may be written";
        /// A length, slot or settings out of range.
        Value = 4, "refused: a value is out of range";
        /// The flash did not obey: timeout, protected, worn out, or of an unknown kind.
        Flash = 5, "the flash did not take it: protected, worn out or of an unknown kind";
        /// Meta page, CRC or FPGA of the image are wrong.
        Image = 6, "the slot holds no whole image for this board";
        /// There is no flash.
        NoFlash = 7, "no flash answers";
        /// Settings that ask for DHCP, on a board without SDRAM.
        NoDhcp = 8, "refused: a board without SDRAM cannot ask a DHCP server; give it a static address";
    }
}

codes! {
    /// One of the two places for images.
    Slot: u32 {
        /// The lower one.
        A = 1, "A";
        /// The upper one.
        B = 2, "B";
    }
}

impl Slot {
    /// The other one.
    pub const fn other(self) -> Slot {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

codes! {
    /// The image that runs.
    Running: u32 {
        /// Loaded by JTAG: none of those in flash.
        Volatile = 0, "volatile (loaded by JTAG)";
        /// Slot A.
        A = 1, "slot A";
        /// Slot B.
        B = 2, "slot B";
        /// The golden image.
        Golden = 3, "golden";
    }
}

codes! {
    /// The source of the settings in force.
    Origin: u32 {
        /// The board information in the bitstream: nothing valid is saved.
        BuiltIn = 0, "built in";
        /// The first copy in flash.
        Copy0 = 1, "flash, copy 0";
        /// The second copy in flash.
        Copy1 = 2, "flash, copy 1";
        /// The board information: the factory pin was active at start. The saved settings stay.
        FactoryPin = 3, "built in, factory pin held";
    }
}

/// [`crate::map::FLASH_OP`] as read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OpWord {
    /// An operation runs.
    pub busy: bool,
    /// Its result; [`OpResult::Busy`] while it runs.
    pub result: OpResult,
    /// The last operation; `None` before the first.
    pub op: Option<Op>,
}

impl OpWord {
    /// Before the first operation.
    pub const IDLE: OpWord = OpWord {
        busy: false,
        result: OpResult::Ok,
        op: None,
    };

    /// As a word: busy bit 31, result bits 15:8, opcode bits 7:0.
    pub const fn to_word(self) -> u32 {
        let op = match self.op {
            Some(op) => op.code(),
            None => 0,
        };
        (self.busy as u32) << 31 | self.result.code() << 8 | op
    }

    /// From a word; `None` if it is invalid.
    pub const fn from_word(word: u32) -> Option<Self> {
        let Some(result) = OpResult::from_code(word >> 8 & 0xff) else {
            return None;
        };
        let op = Op::from_code(word & 0xff);
        if op.is_none() && word & 0xff != 0 {
            return None;
        }
        Some(OpWord {
            busy: word >> 31 != 0,
            result,
            op,
        })
    }
}

/// [`crate::map::FLASH_LINK`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkWord {
    /// Speed; down if there is no link.
    pub speed: crate::LinkSpeed,
    /// Full duplex.
    pub full_duplex: bool,
    /// Frames the MAC dropped since power-up, modulo 2^24.
    pub errors: u32,
}

impl LinkWord {
    /// As a word: speed bits 1:0, duplex bit 2, errors bits 31:8.
    pub const fn to_word(self) -> u32 {
        self.speed as u32 | (self.full_duplex as u32) << 2 | self.errors << 8
    }

    /// From a word; every word is one.
    pub const fn from_word(word: u32) -> Self {
        LinkWord {
            speed: match crate::LinkSpeed::from_code(word as u8 & 3) {
                Some(speed) => speed,
                None => crate::LinkSpeed::Down, // unreachable: two bits, four speeds
            },
            full_duplex: word >> 2 & 1 != 0,
            errors: word >> 8,
        }
    }
}

/// A piece of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// First byte.
    pub start: u32,
    /// The byte after the last.
    pub end: u32,
}

impl Area {
    /// Are these bytes, at least one, all inside?
    pub const fn contains(self, address: u32, length: u32) -> bool {
        match address.checked_add(length) {
            Some(end) => length > 0 && address >= self.start && end <= self.end,
            None => false,
        }
    }

    /// Size in bytes.
    pub const fn len(self) -> u32 {
        self.end - self.start
    }

    /// Is it empty? No area of a [`Layout`] is.
    pub const fn is_empty(self) -> bool {
        self.end == self.start
    }

    /// The address of an image's meta page: the first page of the last sector.
    pub const fn meta(self) -> u32 {
        self.end - SECTOR
    }

    /// Longest image: everything before the meta page's sector.
    pub const fn image_max(self) -> u32 {
        self.len() - SECTOR
    }
}

/// The layout of a flash of one size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Bytes of the flash.
    pub size: u32,
    /// Slot A.
    pub slot_a: Area,
    /// Slot B.
    pub slot_b: Area,
    /// The settings' first sector; the second copy is in the next.
    pub settings: u32,
    /// The golden image.
    pub golden: Area,
}

impl Layout {
    /// First byte of the stub sectors.
    pub const STUBS: u32 = 0;
    /// How many sectors of stubs there are.
    pub const STUB_SECTORS: u32 = 2;
    /// How many pages of stubs there are.
    pub const STUB_PAGES: u32 = Self::STUB_SECTORS * SECTOR / PAGE;

    /// The layout of a flash of this many bytes, if boards have this size.
    pub const fn of(size: u32) -> Option<Layout> {
        match size {
            0x40_0000 => Some(Layout {
                size,
                slot_a: Area {
                    start: 0x01_0000,
                    end: 0x10_0000,
                },
                slot_b: Area {
                    start: 0x10_0000,
                    end: 0x1f_0000,
                },
                settings: 0x1f_0000,
                golden: Area {
                    start: 0x30_0000,
                    end: 0x3f_f000,
                },
            }),
            0x20_0000 => Some(Layout {
                size,
                slot_a: Area {
                    start: 0x01_0000,
                    end: 0x0c_0000,
                },
                slot_b: Area {
                    start: 0x0c_0000,
                    end: 0x17_0000,
                },
                settings: 0x17_0000,
                golden: Area {
                    start: 0x18_0000,
                    end: 0x1f_f000,
                },
            }),
            _ => None,
        }
    }

    /// The layout of the flash with this JEDEC id: its last byte is the logarithm of the size.
    pub const fn of_jedec(jedec: u32) -> Option<Layout> {
        match jedec & 0xff {
            exponent @ 1..=31 => Layout::of(1 << exponent),
            _ => None,
        }
    }

    /// A slot.
    pub const fn slot(&self, slot: Slot) -> Area {
        match slot {
            Slot::A => self.slot_a,
            Slot::B => self.slot_b,
        }
    }

    /// The sector of a settings copy, 0 or 1.
    pub const fn settings_copy(&self, copy: u32) -> u32 {
        self.settings + (copy & 1) * SECTOR
    }

    /// The area of a copy of the pins' configuration, 0 or 1.
    pub const fn pins_copy(&self, copy: u32) -> Area {
        let start = self.settings + 2 * SECTOR + (copy & 1) * crate::pins::BYTES_MAX;
        Area {
            start,
            end: start + crate::pins::BYTES_MAX,
        }
    }

    /// Page number `n` of the stub sectors.
    pub const fn stub(&self, n: u32) -> u32 {
        Self::STUBS + n * PAGE
    }

    /// The page from which the FPGA loads if there is no live stub at 0.
    pub const fn jump_page(&self) -> u32 {
        self.size - PAGE
    }

    /// First byte the flash itself protects: the upper quarter.
    pub const fn protected(&self) -> u32 {
        self.size - self.size / 4
    }

    /// The flash's block protect bits, BP2:BP0, that protect the upper quarter.
    pub const fn protect_bits(&self) -> u8 {
        if self.size == 0x40_0000 { 0b101 } else { 0b100 }
    }

    /// May these bytes be erased and programmed? Yes in the slot that is not selected, or in either
    /// slot if none is.
    pub const fn writable(&self, selected: Option<Slot>, address: u32, length: u32) -> bool {
        let a = self.slot_a.contains(address, length);
        let b = self.slot_b.contains(address, length);
        match selected {
            Some(Slot::A) => b,
            Some(Slot::B) => a,
            None => a || b,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_overlaps_and_everything_lies_on_sectors() {
        for size in [0x20_0000, 0x40_0000] {
            let layout = Layout::of(size).unwrap();
            let stubs = Area {
                start: 0,
                end: Layout::STUB_SECTORS * SECTOR,
            };
            let settings = Area {
                start: layout.settings,
                end: layout.settings + 2 * SECTOR,
            };
            let jump = Area {
                start: layout.jump_page() / SECTOR * SECTOR,
                end: size,
            };
            let areas = [
                stubs,
                layout.slot_a,
                layout.slot_b,
                settings,
                layout.golden,
                jump,
            ];
            for copy in [0, 1] {
                let pins = layout.pins_copy(copy);
                assert!(pins.start >= settings.end && pins.end <= layout.golden.start);
                assert!(pins.start.is_multiple_of(SECTOR) && pins.end.is_multiple_of(SECTOR));
                assert!(pins.end <= layout.protected());
            }
            assert_eq!(layout.pins_copy(0).end, layout.pins_copy(1).start);
            for pair in areas.windows(2) {
                assert!(pair[0].end <= pair[1].start, "{pair:x?}");
            }
            for area in areas {
                assert!(area.start % SECTOR == 0 && area.end % SECTOR == 0 && !area.is_empty());
                assert!(area.end <= size);
            }
            for area in [layout.slot_a, layout.slot_b] {
                assert!(area.start % BLOCK == 0 && area.end % BLOCK == 0);
                assert!(area.end <= layout.protected() && settings.end <= layout.protected());
            }
            assert!(layout.golden.start >= layout.protected());
        }
    }

    #[test]
    fn the_known_chips_have_a_layout() {
        assert_eq!(Layout::of_jedec(0xef_4016).unwrap().size, 0x40_0000); // W25Q32
        assert_eq!(Layout::of_jedec(0xef_4015).unwrap().size, 0x20_0000); // W25Q16
        assert_eq!(Layout::of_jedec(0xc8_4015).unwrap().size, 0x20_0000); // GD25Q16
        for jedec in [0, 0xff_ffff, 0xef_4017, 0xef_4014, 0xef_4000, 0xef_4020] {
            assert_eq!(Layout::of_jedec(jedec), None, "{jedec:x}");
        }
    }

    #[test]
    fn only_the_slot_that_is_not_selected_may_be_written() {
        let layout = Layout::of(0x40_0000).unwrap();
        let (a, b) = (layout.slot_a.start, layout.slot_b.start);
        let may = |selected, address, length| layout.writable(selected, address, length);
        assert!(may(Some(Slot::A), b, PAGE) && !may(Some(Slot::A), a, PAGE));
        assert!(may(Some(Slot::B), a, PAGE) && !may(Some(Slot::B), b, PAGE));
        assert!(may(None, a, PAGE) && may(None, b, PAGE));
        assert!(!may(None, b - 1, 2), "not across their border");
        for address in [
            0,
            SECTOR,
            layout.settings,
            layout.golden.start,
            layout.jump_page(),
            0x28_0000,
        ] {
            assert!(!may(None, address, PAGE), "{address:x}");
        }
        assert!(!may(None, a, 0) && !may(None, u32::MAX, 2) && !may(None, b, u32::MAX));
    }

    #[test]
    fn an_op_word_survives_the_wire() {
        for (busy, result, op) in [
            (false, OpResult::Ok, None),
            (true, OpResult::Busy, Some(Op::EraseBlock)),
            (false, OpResult::Flash, Some(Op::Program)),
        ] {
            let word = OpWord { busy, result, op };
            assert_eq!(OpWord::from_word(word.to_word()), Some(word));
        }
        assert_eq!(
            OpWord::from_word(0x8000_0103).unwrap().op,
            Some(Op::EraseBlock)
        );
        assert_eq!(OpWord::from_word(0x0000_0903), None);
        assert_eq!(OpWord::from_word(0x0000_000a), None);
    }

    #[test]
    fn a_link_word_survives_the_wire() {
        let word = LinkWord {
            speed: crate::LinkSpeed::M100,
            full_duplex: true,
            errors: 0x1234,
        };
        assert_eq!(LinkWord::from_word(word.to_word()), word);
    }
}
