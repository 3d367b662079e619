//! LiteEth's MAC: two receive slots, two transmit slots, one frame at a time each.
//!
//! The slots hold frames in network order: a 32-bit load yields a big-endian word, so the exchange
//! never swaps a byte. The IP stack, which thinks in bytes, gets its frames copied.
//!
//! Transmit slot 0 belongs to the fast lane alone, its headers stay in it; slot 1 is everybody's.

use core::ptr::{read_volatile, write_volatile};
use firmware::net::{Frame, Slot};
use litex_pac::{Ethmac, abi};
use smoltcp::phy::{Device, DeviceCapabilities, Medium, RxToken, TxToken};
use smoltcp::time::Instant;

/// Longest frame, without FCS.
const FRAME_MAX: usize = 1514;
const LANE: usize = 0;
const COMMON: usize = 1;

/// A received frame, in its slot.
#[derive(Clone, Copy)]
pub struct RxFrame(*const u32);

impl Frame for RxFrame {
    #[inline(always)]
    fn word(&self, index: usize) -> u32 {
        // SAFETY: the lib reads words of frames whose length the MAC told, at most one word beyond;
        // a slot is 512 words, a frame 379.
        unsafe { read_volatile(self.0.add(index)) }
    }
}

/// A frame being written, in its slot.
pub struct TxSlot(*mut u32);

impl Slot for TxSlot {
    #[inline(always)]
    fn put(&mut self, index: usize, word: u32) {
        // SAFETY: as `RxFrame`: no answer is longer than a frame.
        unsafe { write_volatile(self.0.add(index), word) }
    }
}

/// The MAC.
pub struct Mac {
    regs: Ethmac,
    /// A frame waiting for the IP stack, copied out of its slot.
    stack_frame: &'static mut [u8; FRAME_MAX],
    stack_length: usize,
    sent: u32,
}

static mut STACK_FRAME: [u8; FRAME_MAX] = [0; FRAME_MAX];

impl Mac {
    /// The one MAC there is.
    pub fn new() -> Self {
        // SAFETY: `super::start` calls this once; nobody else touches the MAC or the buffer.
        let (regs, stack_frame) = unsafe { (Ethmac::steal(), &mut *(&raw mut STACK_FRAME)) };
        Mac {
            regs,
            stack_frame,
            stack_length: 0,
            sent: 0,
        }
    }

    /// Is there a frame?
    #[inline(always)]
    pub fn pending(&self) -> bool {
        self.regs.sram_writer_ev_pending().read().bits() != 0
    }

    /// The frame, and its length in bytes without FCS.
    #[inline(always)]
    pub fn frame(&self) -> (RxFrame, usize) {
        let slot = self.regs.sram_writer_slot().read().bits() as usize;
        let length = self.regs.sram_writer_length().read().bits() as usize;
        let base = abi::ETHMAC_BASE + slot * abi::ETHMAC_SLOT_SIZE;
        (RxFrame(base as *const u32), length)
    }

    /// Gives the frame's slot back.
    #[inline(always)]
    pub fn release(&mut self) {
        self.regs
            .sram_writer_ev_pending()
            .write(|w| unsafe { w.bits(1) });
    }

    /// Has everything left, the lane's slot among it?
    #[inline(always)]
    pub fn lane_idle(&self) -> bool {
        self.regs.sram_reader_level().read().bits() == 0
    }

    /// Waits until the lane's slot may be written: 12 us for the longest frame on the wire.
    pub fn wait_lane(&self) {
        while !self.lane_idle() {}
    }

    /// The lane's slot.
    #[inline(always)]
    pub fn lane_slot(&self) -> TxSlot {
        Self::tx(LANE)
    }

    /// Sends the lane's slot.
    #[inline(always)]
    pub fn send_lane(&mut self, length: usize) {
        self.start(LANE, length);
    }

    /// The common slot, as soon as it may be written.
    pub fn slot(&self) -> TxSlot {
        self.wait_lane();
        Self::tx(COMMON)
    }

    /// Sends the common slot.
    pub fn send(&mut self, length: usize) {
        self.start(COMMON, length);
    }

    /// Copies the frame out of its slot for the IP stack, and gives the slot back.
    pub fn take_for_stack(&mut self) {
        let (frame, length) = self.frame();
        let length = length.min(FRAME_MAX);
        for (index, chunk) in self
            .stack_frame
            .chunks_mut(4)
            .take(length.div_ceil(4))
            .enumerate()
        {
            for (byte, from) in chunk.iter_mut().zip(frame.word(index).to_be_bytes()) {
                *byte = from;
            }
        }
        self.stack_length = length;
        self.release();
    }

    /// How many frames the IP stack sent since it was last asked.
    pub fn sent_for_stack(&mut self) -> u32 {
        core::mem::take(&mut self.sent)
    }

    /// Frames dropped: no slot free, wrong preamble, wrong CRC.
    pub fn errors(&self) -> [u32; 3] {
        [
            self.regs.sram_writer_errors().read().bits(),
            self.regs.rx_datapath_preamble_errors().read().bits(),
            self.regs.rx_datapath_crc_errors().read().bits(),
        ]
    }

    #[inline(always)]
    fn tx(slot: usize) -> TxSlot {
        let slots = abi::ETHMAC_BASE + abi::ETHMAC_RX_SLOTS * abi::ETHMAC_SLOT_SIZE;
        TxSlot((slots + slot * abi::ETHMAC_SLOT_SIZE) as *mut u32)
    }

    #[inline(always)]
    fn start(&mut self, slot: usize, length: usize) {
        self.regs
            .sram_reader_slot()
            .write(|w| unsafe { w.bits(slot as u32) });
        self.regs
            .sram_reader_length()
            .write(|w| unsafe { w.bits(length as u32) });
        self.regs
            .sram_reader_start()
            .write(|w| unsafe { w.bits(1) });
    }
}

impl Device for Mac {
    type RxToken<'a> = Received<'a>;
    type TxToken<'a> = Transmit<'a>;

    fn receive(&mut self, _now: Instant) -> Option<(Received<'_>, Transmit<'_>)> {
        let length = core::mem::take(&mut self.stack_length);
        let bytes = self
            .stack_frame
            .get(..length)
            .filter(|bytes| !bytes.is_empty())?;
        Some((Received(bytes), Transmit(&self.regs, &mut self.sent)))
    }

    fn transmit(&mut self, _now: Instant) -> Option<Transmit<'_>> {
        Some(Transmit(&self.regs, &mut self.sent))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = FRAME_MAX;
        capabilities.max_burst_size = Some(1);
        capabilities
    }
}

/// A frame for the IP stack.
pub struct Received<'a>(&'a [u8]);

impl RxToken for Received<'_> {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(self.0)
    }
}

/// A frame from the IP stack.
pub struct Transmit<'a>(&'a Ethmac, &'a mut u32);

static mut TRANSMIT: [u8; FRAME_MAX] = [0; FRAME_MAX];

impl TxToken for Transmit<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, f: F) -> R {
        // SAFETY: a token borrows the one `Mac`, so there is one token, and `consume` ends with it.
        let buffer = unsafe { &mut *(&raw mut TRANSMIT) };
        let length = length.min(FRAME_MAX);
        let bytes = buffer.get_mut(..length).unwrap_or(&mut []);
        let result = f(bytes);
        while self.0.sram_reader_level().read().bits() != 0 {}
        let mut slot = Mac::tx(COMMON);
        for (index, chunk) in bytes.chunks(4).enumerate() {
            let mut word = [0; 4];
            for (to, byte) in word.iter_mut().zip(chunk) {
                *to = *byte;
            }
            slot.put(index, u32::from_be_bytes(word));
        }
        self.0
            .sram_reader_slot()
            .write(|w| unsafe { w.bits(COMMON as u32) });
        self.0
            .sram_reader_length()
            .write(|w| unsafe { w.bits(length as u32) });
        self.0.sram_reader_start().write(|w| unsafe { w.bits(1) });
        *self.1 += 1;
        result
    }
}
