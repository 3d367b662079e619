//! The commands of a 25-series flash chip over SPI. [`crate::flash`] decides what may be written,
//! and when.

use embedded_hal::spi::{Operation, SpiDevice};
use wire::flash::OpResult;

/// Commands of every 25-series chip.
pub(crate) const WRITE_STATUS: u8 = 0x01;
pub(crate) const PROGRAM: u8 = 0x02;
/// Reads from a 24-bit address on, without an end.
pub const READ: u8 = 0x03;
const STATUS: u8 = 0x05;
const WRITE_ENABLE: u8 = 0x06;
pub(crate) const ERASE_SECTOR: u8 = 0x20;
pub(crate) const UNIQUE_ID: u8 = 0x4b;
pub(crate) const JEDEC: u8 = 0x9f;
pub(crate) const ERASE_BLOCK: u8 = 0xd8;

/// Status register: an erase or a program runs.
pub(crate) const BUSY: u8 = 1;
/// Status register: everything that protects: BP bits 4:2, TB, SEC (or BP3, BP4).
pub(crate) const PROTECTION: u8 = 0x7c;

/// The flash chip on an SPI device.
#[derive(Debug)]
pub struct Nor<'s, S>(pub &'s mut S);

impl<S: SpiDevice> Nor<'_, S> {
    /// One command: the bytes sent, the data sent after them, the answer.
    pub(crate) fn command(
        &mut self,
        head: &[u8],
        data: &[u8],
        answer: &mut [u8],
    ) -> Result<(), OpResult> {
        let mut operations = [
            Operation::Write(head),
            Operation::Write(data),
            Operation::Read(answer),
        ];
        let done = self.0.transaction(&mut operations);
        done.map_err(|_| OpResult::Flash)
    }

    /// A command with an address.
    #[inline(never)]
    pub(crate) fn at(
        &mut self,
        command: u8,
        address: u32,
        data: &[u8],
        answer: &mut [u8],
    ) -> Result<(), OpResult> {
        let [_, a, b, c] = address.to_be_bytes();
        self.command(&[command, a, b, c], data, answer)
    }

    /// Its status register.
    pub(crate) fn status(&mut self) -> Result<u8, OpResult> {
        let mut status = [0];
        self.command(&[STATUS], &[], &mut status)?;
        let [status] = status;
        Ok(status)
    }

    /// Allows the next erase or program command.
    pub(crate) fn write_enable(&mut self) -> Result<(), OpResult> {
        self.command(&[WRITE_ENABLE], &[], &mut [])
    }

    /// Reads bytes.
    pub fn read(&mut self, address: u32, bytes: &mut [u8]) -> Result<(), OpResult> {
        self.at(READ, address, &[], bytes)
    }

    /// Reads big-endian words.
    #[inline(never)]
    pub(crate) fn words(&mut self, address: u32, words: &mut [u32]) -> Result<(), OpResult> {
        let length = 4 * words.len() as u32;
        let mut places = words.iter_mut();
        self.each(address, length, &mut |bytes| {
            for (bytes, word) in bytes.as_chunks().0.iter().zip(&mut places) {
                *word = u32::from_be_bytes(*bytes);
            }
        })
    }

    /// Are all these bytes erased?
    pub fn blank(&mut self, address: u32, length: u32) -> Result<bool, OpResult> {
        let mut blank = true;
        self.each(address, length, &mut |bytes| {
            blank &= bytes.iter().all(|byte| *byte == 0xff);
        })?;
        Ok(blank)
    }

    /// Reads bytes, a few at a time. One function for all that look at them: that is smaller.
    #[inline(never)]
    pub(crate) fn each(
        &mut self,
        address: u32,
        length: u32,
        look: &mut dyn FnMut(&[u8]),
    ) -> Result<(), OpResult> {
        let mut chunk = [0; 64];
        let mut done = 0;
        while done < length {
            let count = (length - done).min(chunk.len() as u32);
            let bytes = chunk.get_mut(..count as usize).unwrap_or(&mut []);
            self.read(address + done, bytes)?;
            look(bytes);
            done += count;
        }
        Ok(())
    }
}
