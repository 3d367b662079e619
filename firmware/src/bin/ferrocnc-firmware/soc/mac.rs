//! LiteEth's MAC: four receive slots and two transmit slots, each for one frame.
//!
//! The slots hold frames in network order, at an offset of two bytes: a 32-bit load yields a
//! big-endian word, and everything after the Ethernet header is aligned, so the exchange swaps and
//! shifts nothing. The services work on bytes and gets its frames copied.
//!
//! Transmit slot 0 belongs to the gateware's fast path alone ([`firmware::pass`]), and its headers
//! stay in it. All other frames use slot 1.
//!
//! The filter `rx_admission.sv` is in front of the receive slots. Without a session owner the board
//! admits all frames addressed to it alone, and of all others one at a time. With an owner it
//! admits the owner's frames, and one other frame for each call of [`Mac::admit`].

use core::mem::MaybeUninit;
use core::ops::Range;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{Ordering, compiler_fence};
use firmware::block::Shape;
use firmware::net::{Datagram, Frame, PAYLOAD_WORD, Slot, Us};
use firmware::pass::{self, Expected, FLAGS_PLACE, Pass, SEQUENCE_PLACE};
use litex_pac::{Ethmac, RxAdmission};
use wire::MAX_WORDS;
use wire::regmap::{self, fast_path, rx_admission};

/// Longest frame, without FCS.
const FRAME_MAX: usize = firmware::reserve::ROOM;
/// Bytes in front of a frame in its slot; the MAC's length registers count them.
const PAD: usize = 2;
const FAST_PATH: usize = 0;
const COMMON: usize = 1;

/// A received frame, in its slot.
#[derive(Clone, Copy)]
pub struct RxFrame(*const u32);

impl Frame for RxFrame {
    #[inline(always)]
    fn word(&self, index: usize) -> u32 {
        // SAFETY: the lib reads words of frames with the length that the MAC reported, at most one
        // word beyond; a slot has 512 words, a frame 379.
        unsafe { read_volatile(self.0.add(index)) }
    }
}

/// A frame being written, in its slot.
pub struct TxSlot(*mut u32);

impl TxSlot {
    /// Where a datagram's payload lies in it: an answer that is made there is not copied.
    pub fn payload(&mut self) -> &mut [u32; MAX_WORDS] {
        const { assert!((PAYLOAD_WORD + MAX_WORDS) * 4 <= regmap::ETHMAC_SLOT_SIZE) };
        // SAFETY: memory of the slot, which takes any words; the MAC reads it after `start_common`.
        unsafe { &mut *self.0.add(PAYLOAD_WORD).cast() }
    }
}

impl Slot for TxSlot {
    #[inline(always)]
    fn put(&mut self, index: usize, word: u32) {
        // SAFETY: as in `RxFrame`: no answer is longer than a frame.
        unsafe { write_volatile(self.0.add(index), word) }
    }
}

/// A datagram as words for the server, or a frame as bytes for the services; never both at once.
pub struct Buffer([u32; FRAME_MAX.div_ceil(4)]);

impl Buffer {
    /// As words of a datagram.
    pub fn words(&mut self) -> &mut [u32; MAX_WORDS] {
        const { assert!(FRAME_MAX >= MAX_WORDS * 4) };
        match self.0.first_chunk_mut() {
            Some(words) => words,
            None => unreachable!(), // the assertion above excludes it
        }
    }

    /// As room for a frame.
    pub fn frame(&mut self) -> &mut [u8; FRAME_MAX] {
        // SAFETY: as below.
        unsafe { &mut *self.0.as_mut_ptr().cast() }
    }

    /// As bytes of a frame.
    pub fn bytes(&mut self) -> &mut [u8] {
        // SAFETY: the same memory; bytes have no alignment and no invalid values.
        unsafe { core::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), FRAME_MAX) }
    }

    /// Sends this many of these bytes as a frame, from the common slot; drops them if no frame
    /// leaves the board.
    pub fn send(&self, length: usize) {
        // SAFETY: the MAC's registers, as `Mac` uses them; one hart, and no caller holds a slot
        // over this call.
        let regs = unsafe { Ethmac::steal() };
        if !drained(&regs) {
            return;
        }
        let mut slot = Mac::tx(COMMON);
        let mut carry = 0;
        let length = length.min(FRAME_MAX);
        let words = length.div_ceil(4);
        // The bytes behind the frame may leave as its padding.
        let behind = words * 4 - length;
        for (index, word) in self.0.iter().take(words).enumerate() {
            let mut next = word.swap_bytes();
            if index + 1 == words {
                next &= u32::MAX << (behind * 8);
            }
            slot.put(index, carry << 16 | next >> 16);
            carry = next;
        }
        slot.put(words, carry << 16);
        start_common(&regs, length);
    }
}

/// Looks at the MAC before it counts as stuck: at least 5 clocks each, so 5 ms or more at 60 MHz;
/// both slots are sent in 2.5 ms at 10 Mbit/s. A PHY without a cable may stop the transmit clock;
/// the loop must go on and detect that.
const DRAIN_LOOKS: u32 = 60_000;

/// Looks at the fast path's answer before it counts as late: 1500 clocks or more, in which the
/// longest one is sent at 100 Mbit/s.
const ANSWER_LOOKS: u32 = 150;

/// Waits until the transmit queue is empty. False if it does not shrink.
fn drained(regs: &Ethmac) -> bool {
    (0..DRAIN_LOOKS).any(|_| regs.sram_reader_level().read().bits() == 0)
}

/// Sets the slot and the length of the next start.
fn aim(regs: &Ethmac, slot: u32, length: u32) {
    regs.sram_reader_slot().write(|w| unsafe { w.bits(slot) });
    regs.sram_reader_length()
        .write(|w| unsafe { w.bits(length) });
}

/// Bytes of the shortest frame without its FCS. LiteEth pads shorter ones, but behind one of its
/// last three lengths it does not begin to count anew: the next short one leaves unpadded, and is
/// dropped by what receives it.
const SHORTEST: usize = 60;
const PADDED: Range<usize> = SHORTEST - 3..SHORTEST;

/// Sends the common slot, with all that was written to it before. Behind the frame there are zeros
/// up to the end of a word.
fn start_common(regs: &Ethmac, length: usize) {
    let length = match PADDED.contains(&length) {
        true => SHORTEST,
        false => length,
    };
    compiler_fence(Ordering::Release);
    aim(regs, COMMON as u32, (length + PAD) as u32);
    regs.sram_reader_start().write(|w| unsafe { w.bits(1) });
}

/// Writes a register of the fast path.
#[inline(always)]
fn write_fast_path(word: usize, value: u32) {
    // SAFETY: a register of the map; the words are those of `regmap`.
    unsafe { write_volatile((fast_path::BASE as *mut u32).add(word), value) }
}

/// Writes an expected word of the owner's frames.
#[inline(always)]
fn expect(place: usize, word: u32) {
    // SAFETY: this page begins with 16 words of a header, and no place is higher.
    unsafe {
        write_volatile(
            (rx_admission::BASE as *mut u32).add(rx_admission::HEADER0 + place),
            word,
        )
    }
}

/// What has become of the pass.
#[inline(always)]
fn progress() -> u32 {
    // SAFETY: a register of the map; a read has no side effect.
    unsafe { read_volatile((fast_path::BASE as *const u32).add(fast_path::STATUS)) }
}

/// Writes what differs from pass to pass, and hands it out.
pub fn hand_out(pass: &Pass) {
    expect(SEQUENCE_PLACE, pass.sequence);
    expect(FLAGS_PLACE, pass.flags);
    let mut slot = Mac::tx(FAST_PATH);
    for (index, word) in pass.answer() {
        slot.put(index, word);
    }
    write_fast_path(fast_path::GATE, pass.condition());
    write_fast_path(fast_path::PASS, 1);
}

/// Takes the pass back. True if a command was executed with it.
pub fn revoke() -> bool {
    write_fast_path(fast_path::REVOKE, 1);
    executed()
}

/// Has a command been executed since the last pass?
#[inline(always)]
pub fn executed() -> bool {
    progress() & fast_path::STATUS_EXECUTED != 0
}

/// Is the answer being sent?
pub fn sending() -> bool {
    progress() & fast_path::STATUS_SENDING != 0
}

/// Waits until the fast path's answer has left. False if it does not.
pub fn answered() -> bool {
    (0..ANSWER_LOOKS).any(|_| !sending())
}

/// The MAC.
pub struct Mac {
    regs: Ethmac,
    admission: RxAdmission,
    /// The session has no owner: the next guest may come as soon as the last one's slot is free.
    open: bool,
    /// Received data that does not take the fast path.
    pub input: &'static mut Buffer,
    /// Data to be sent by the server or the services.
    pub output: &'static mut Buffer,
}

static mut INPUT: Buffer = Buffer([0; FRAME_MAX.div_ceil(4)]);
/// In the part of the RAM that the services may write. Its first contents are what was there.
#[unsafe(link_section = ".window")]
static mut OUTPUT: MaybeUninit<Window> = MaybeUninit::uninit();

/// All of that part, so that nothing else is in it.
#[repr(C)]
struct Window(
    Buffer,
    [u32; (regmap::WINDOW_SIZE - size_of::<Buffer>()) / 4],
);

impl Mac {
    /// The board's only MAC.
    pub fn new() -> Self {
        // SAFETY: `super::start` calls this once; no other code touches the MAC, its filter or the
        // buffers. Any bits are words.
        let (regs, admission, input, output) = unsafe {
            (
                Ethmac::steal(),
                RxAdmission::steal(),
                &mut *(&raw mut INPUT),
                &mut (*(&raw mut OUTPUT)).assume_init_mut().0,
            )
        };
        Mac {
            regs,
            admission,
            open: true,
            input,
            output,
        }
    }

    /// Sets our address. A frame that is not for it needs a ticket, now and whenever the session
    /// has no owner.
    pub fn address(&mut self, ours: [u32; 2]) {
        let [high, low] = ours;
        expect(0, high);
        expect(1, low);
        self.open();
    }

    /// A frame that is not the owner's needs a ticket. The owner's frames are as expected, and are
    /// answered as prepared here; a pass can be handed out. None is out now.
    pub fn guard(&mut self, owner: &Datagram, token: u32, us: &Us, shape: &Shape, boot_id: u32) {
        let expected = Expected::new(us, owner, shape.command, token);
        for (place, word) in expected.words.into_iter().enumerate() {
            expect(place, word);
        }
        for (number, run) in pass::runs(shape).into_iter().enumerate() {
            write_fast_path(fast_path::RUN0 + number, run);
        }
        write_fast_path(fast_path::IP_SUM, expected.ip_sum);
        write_fast_path(fast_path::UDP_SUM, expected.udp_sum);
        let length = pass::answer_length(shape) + PAD;
        write_fast_path(fast_path::LENGTH, length as u32);
        pass::prepare(&mut Self::tx(FAST_PATH), us, owner, shape, boot_id);
        self.admission.mode().write(|w| w.select().owner());
        self.open = false;
    }

    /// The session has no owner any more.
    pub fn open(&mut self) {
        self.admission.mode().write(|w| w.select().ours());
        self.open = true;
        self.admit();
    }

    /// Issues a ticket for one more guest, if the last one is used up.
    #[inline(always)]
    pub fn admit(&self) {
        self.admission.admit().write(|w| unsafe { w.bits(1) });
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
        let length = self.regs.sram_writer_length().read().bits() as usize - PAD;
        let base = regmap::ETHMAC_BASE + slot * regmap::ETHMAC_SLOT_SIZE;
        (RxFrame(base as *const u32), length)
    }

    /// Gives the frame's slot back.
    #[inline(always)]
    pub fn release(&mut self) {
        self.regs
            .sram_writer_ev_pending()
            .write(|w| unsafe { w.bits(1) });
    }

    /// As [`Mac::release`], for a frame that did not take the fast path.
    pub fn dismiss(&mut self) {
        self.release();
        if self.open {
            self.admit();
        }
    }

    /// Waits until all frames have been sent: 12 us for the longest frame on the wire, 1.2 ms at
    /// 10 Mbit/s. False if no frame leaves the board.
    pub fn drained(&self) -> bool {
        drained(&self.regs)
    }

    /// The common slot, as soon as it may be written; `None` if no frame leaves the board.
    pub fn slot(&self) -> Option<TxSlot> {
        self.drained().then(|| Self::tx(COMMON))
    }

    /// Sends the common slot.
    pub fn send(&mut self, length: usize) {
        start_common(&self.regs, length);
    }

    /// Copies the frame out of its slot as bytes, and frees the slot. Returns the number of bytes.
    pub fn take_bytes(&mut self) -> usize {
        let (frame, length) = self.frame();
        let length = length.min(FRAME_MAX);
        // Two slot words make a word of bytes in the right order.
        let mut carry = frame.word(0);
        for (index, word) in self.input.0.iter_mut().take(length.div_ceil(4)).enumerate() {
            let next = frame.word(index + 1);
            *word = (carry << 16 | next >> 16).swap_bytes();
            carry = next;
        }
        self.dismiss();
        length
    }

    #[inline(always)]
    fn tx(slot: usize) -> TxSlot {
        let slots = regmap::ETHMAC_BASE + regmap::ETHMAC_RX_SLOTS * regmap::ETHMAC_SLOT_SIZE;
        TxSlot((slots + slot * regmap::ETHMAC_SLOT_SIZE) as *mut u32)
    }
}
