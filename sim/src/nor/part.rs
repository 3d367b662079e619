//! The kinds of flash chips on our boards, and how long they are busy.

/// How long the chip is busy, nanoseconds: typical figures of the data sheets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// A page program.
    pub page: u64,
    /// Erase of 4 KiB.
    pub sector: u64,
    /// Erase of 32 KiB.
    pub half_block: u64,
    /// Erase of 64 KiB.
    pub block: u64,
    /// Erase of everything.
    pub chip: u64,
    /// A write of the status registers.
    pub status: u64,
}

impl Times {
    /// Three reads of the status register: for tests in which nothing else happens meanwhile.
    pub const QUICK: Times = Times {
        page: 4_000,
        sector: 4_000,
        half_block: 4_000,
        block: 4_000,
        chip: 4_000,
        status: 4_000,
    };
}

/// A kind of chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// As printed on it.
    pub name: &'static str,
    /// Manufacturer, type, capacity: the answer to 9Fh.
    pub jedec: [u8; 3],
    /// Bytes.
    pub bytes: usize,
    /// Bytes of its unique id.
    pub uid_bytes: usize,
    /// A status write of one byte also clears the second register.
    pub short_write_clears: bool,
    /// How long it takes for everything.
    pub times: Times,
}

impl Part {
    /// Winbond, 4 MiB: on most Colorlight boards.
    pub const W25Q32JV: Part = Part {
        name: "W25Q32JV",
        jedec: [0xef, 0x40, 0x16],
        bytes: 4 << 20,
        uid_bytes: 8,
        short_write_clears: false,
        times: Times {
            page: 400_000,
            sector: 45_000_000,
            half_block: 120_000_000,
            block: 150_000_000,
            chip: 10_000_000_000,
            status: 10_000_000,
        },
    };
    /// Winbond, 2 MiB.
    pub const W25Q16JV: Part = Part {
        name: "W25Q16JV",
        jedec: [0xef, 0x40, 0x15],
        bytes: 2 << 20,
        times: Times {
            chip: 5_000_000_000,
            ..Self::W25Q32JV.times
        },
        ..Self::W25Q32JV
    };
    /// GigaDevice, 2 MiB: on newer boards.
    pub const GD25Q16C: Part = Part {
        name: "GD25Q16C",
        jedec: [0xc8, 0x40, 0x15],
        bytes: 2 << 20,
        uid_bytes: 16,
        short_write_clears: true,
        times: Times {
            page: 600_000,
            sector: 50_000_000,
            half_block: 150_000_000,
            block: 250_000_000,
            chip: 7_000_000_000,
            status: 5_000_000,
        },
    };
    /// All there are.
    pub const ALL: [Part; 3] = [Self::W25Q32JV, Self::W25Q16JV, Self::GD25Q16C];

    /// The same chip with other times.
    pub const fn with(self, times: Times) -> Part {
        Part { times, ..self }
    }

    /// The smallest chip of our list that holds so many bytes exactly.
    pub fn of_size(bytes: usize) -> Option<Part> {
        Self::ALL.into_iter().find(|part| part.bytes == bytes)
    }
}
