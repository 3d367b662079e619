//! Drivers of devices that boards have anywhere: the status LED, and the flash behind
//! embedded-hal's `SpiDevice`, which the flash code of the library is written against.

use core::convert::Infallible;
use embedded_hal::spi::{self, Operation, SpiDevice};
use firmware::cores::Led;
use firmware::nor::READ;

/// The status LED, which shows patterns.
pub struct StatusLed<'r>(&'r litex_pac::Led);

impl<'r> StatusLed<'r> {
    /// The board's LED.
    pub fn new(regs: &'r litex_pac::Led) -> Self {
        StatusLed(regs)
    }

    /// Shows a pattern.
    pub fn show(&mut self, pattern: Led) {
        // SAFETY: every pattern is a value of the field.
        self.0
            .pattern()
            .write(|w| unsafe { w.bits(pattern as u32) });
    }
}

/// The flash the FPGA was loaded from. A transfer has up to 32 bits: whole words, then single bytes
/// at the end.
pub struct FlashSpi(litex_pac::Flash);

impl FlashSpi {
    /// The board's flash. Chip select survives a restart of the firmware, so it is set to its idle
    /// level.
    pub fn new(regs: litex_pac::Flash) -> Self {
        let mut spi = FlashSpi(regs);
        spi.select(false);
        spi
    }

    /// Is the factory pin active?
    pub fn factory_pin(&self) -> bool {
        self.0.status().read().factory_pin().bit()
    }

    /// Reads words from this address of the flash, as they lie there. While the next one comes,
    /// which takes 128 clocks, `sum` gets the one before.
    #[inline(never)]
    pub fn stream(&mut self, address: u32, words: &mut [u32], mut sum: impl FnMut(u32)) {
        self.select(true);
        self.shift(32, u32::from(READ) << 24 | address & 0xff_ffff);
        let mut left = words.len();
        if left > 0 {
            self.start(0);
        }
        for word in words {
            let came = self.received();
            left -= 1;
            if left > 0 {
                self.start(0);
            }
            *word = came.to_be();
            sum(*word);
        }
        self.select(false);
    }

    fn select(&mut self, on: bool) {
        self.0.control().write(|w| w.select().bit(on));
    }

    /// Shifts out the upper bits of a word; the received bits are in the lower end of the result.
    #[inline(never)]
    fn shift(&mut self, bits: u32, word: u32) -> u32 {
        // SAFETY: 8 or 32.
        self.0.length().write(|w| unsafe { w.bits(bits) });
        self.start(word);
        self.received()
    }

    /// Begins to shift a word out, with the length of the transfer before.
    fn start(&mut self, word: u32) {
        // SAFETY: any word.
        self.0.data().write(|w| unsafe { w.bits(word) });
    }

    /// Waits for the end of the transfer.
    fn received(&self) -> u32 {
        while self.0.status().read().busy().bit() {}
        self.0.data().read().bits()
    }

    fn read(&mut self, bytes: &mut [u8]) {
        let (words, rest) = bytes.as_chunks_mut::<4>();
        for word in words {
            *word = self.shift(32, 0).to_be_bytes();
        }
        for byte in rest {
            *byte = self.shift(8, 0) as u8;
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<4>();
        for word in words {
            self.shift(32, u32::from_be_bytes(*word));
        }
        for byte in rest {
            self.shift(8, u32::from(*byte) << 24);
        }
    }
}

impl spi::ErrorType for FlashSpi {
    type Error = Infallible;
}

impl SpiDevice for FlashSpi {
    /// Reads and writes only: no caller sends and receives at once, or waits with the chip
    /// selected.
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.select(true);
        for operation in operations {
            match operation {
                Operation::Read(bytes) => self.read(bytes),
                Operation::Write(bytes) => self.write(bytes),
                Operation::Transfer(..) | Operation::TransferInPlace(_) | Operation::DelayNs(_) => {
                }
            }
        }
        self.select(false);
        Ok(())
    }
}
