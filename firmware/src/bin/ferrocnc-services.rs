//! The services: the functions the ROM has no room for, and those that may fail while the machine
//! goes on, in SDRAM. Their interface to the ROM is in [`firmware::services::abi`].
#![no_std]
#![no_main]
#![expect(
    clippy::deref_addrof,
    reason = "its remedy, a reference to a `static mut`, is an error of the compiler's"
)]

use core::arch::global_asm;
use core::mem::MaybeUninit;
use core::slice;
use firmware::machine::{Lease, VISIT_WORDS, Verb, Verdict};
use firmware::net::Us;
use firmware::services::abi::{
    FAILED, FRAME_MAX, Header, INTERFACE, MORE, RESTLESS, ROOM, Rom, START,
};
use firmware::services::journal;
use firmware::services::memory::{self, Cells};
use firmware::services::port::Place;
use firmware::services::{Network, PORTS, Program};
use jobs::Outside;
use wire::MAX_WORDS;
use wire::regmap::{self, CSR_PAGE, SDRAM_BASE, SDRAM_SIZE};

/// Shorter frames end in zeros.
const SHORTEST: usize = 60;

/// The log begins so many bytes behind the program, and outlives its restart: the test of the SDRAM
/// writes to addresses that are powers of two, and no other code writes there.
const LOG_AT: usize = 0x1000;
const _: () = assert!((ROOM + LOG_AT + journal::BYTES) < 2 * ROOM && ROOM.is_power_of_two());

global_asm!(include_str!("saves.s"));

// The ROM's stack pointer is saved here, and the program's own stack is used. The ROM has saved its
// own registers, in case this does not return.
global_asm!(
    ".section .text.services_entry",
    ".global services_entry",
    "services_entry:",
    "    la      t0, __services_stack",
    "    sw      ra, -4(t0)",
    "    sw      sp, -8(t0)",
    "    addi    sp, t0, -16",
    "    call    services_main",
    "    la      t0, __services_stack",
    "    lw      ra, -4(t0)",
    "    lw      sp, -8(t0)",
    "    ret",
);

unsafe extern "C" {
    safe fn services_entry(rom: &Rom, frame: *const u8, length: usize) -> u32;
    static mut __services_bss: u32;
    static mut __services_clear_end: u32;
    static mut __services_bss_end: u32;
    static __services_fixed_end: u32;
}

#[unsafe(no_mangle)]
#[unsafe(link_section = ".services.header")]
static SERVICES_HEADER: Header = Header {
    crc: 0,
    interface: INTERFACE,
    abi: regmap::ABI,
    entry: services_entry,
    ports: PORTS,
    // SAFETY: the linker's; nothing reads through it.
    fixed_end: unsafe { &__services_fixed_end },
};

/// The program's state, initialised from [`START`] on.
#[unsafe(link_section = ".uninit")]
static mut PROGRAM: MaybeUninit<Program<'static>> = MaybeUninit::uninit();
/// The CRC-32 of the program, and the bytes of the SDRAM behind its room.
static mut MEMORY: (u32, usize) = (0, 0);
/// The memory of its sockets.
#[unsafe(link_section = ".uninit")]
static mut PLACE: MaybeUninit<Place<'static>> = MaybeUninit::uninit();

/// Room for the answers of the board's own server.
static mut ANSWER: [u32; MAX_WORDS] = [0; MAX_WORDS];

/// Runs on the program's own stack; its contract is [`firmware::services::abi::Entry`].
#[unsafe(no_mangle)]
extern "C" fn services_main(rom: &Rom, frame: *const u8, length: usize) -> u32 {
    let mut rom = Calls(rom);
    // SAFETY: the ROM makes one call at a time, and the callbacks do not call again.
    let place = unsafe { &mut *(&raw mut PROGRAM) };
    if frame.is_null() && length >= START {
        return start(length - START, &mut rom);
    }
    // SAFETY: the ROM makes no call before START, and none after a START that FAILED.
    let program = unsafe { place.assume_init_mut() };
    let restless = if frame.is_null() {
        program.poll(&mut rom)
    } else {
        // SAFETY: the ROM gives the frame's length. An answer is written to another place.
        let frame = unsafe { slice::from_raw_parts(frame, length) };
        program.frame(frame, &mut rom);
        // A turn says what the jobs have to do.
        true
    };
    u32::from(restless) * RESTLESS
}

/// A piece of the beginning.
fn start(piece: usize, rom: &mut Calls) -> u32 {
    // SAFETY: only these calls use them, one at a time; they are read behind their piece.
    let (memory, place, program) = unsafe {
        (
            &mut *(&raw mut MEMORY),
            &mut *(&raw mut PLACE),
            &mut *(&raw mut PROGRAM),
        )
    };
    match piece {
        0 => {
            clear();
            // SAFETY: the first word is the image's CRC, which was right. The test below
            // overwrites it.
            let crc = unsafe { (SDRAM_BASE as *const u32).read_volatile() };
            let used = (&raw const __services_bss_end) as usize - SDRAM_BASE;
            let size = memory::size(&mut Sdram, used, SDRAM_SIZE);
            let Some(size) = size.and_then(|size| size.checked_sub(ROOM)) else {
                return FAILED;
            };
            *memory = (crc, size);
            MORE
        }
        1 => {
            place.write(Place::new());
            MORE
        }
        _ => {
            let (crc, size) = *memory;
            // SAFETY: from the end of the program to the SDRAM's end; no other code uses it.
            let memory = unsafe { slice::from_raw_parts_mut((SDRAM_BASE + ROOM) as *mut u8, size) };
            let (log, memory) = memory.split_at_mut((LOG_AT + journal::BYTES).min(size));
            let (_, log) = log.split_at_mut(LOG_AT.min(log.len()));
            // SAFETY: it was written in the piece before, and this is the only reference.
            let place = unsafe { place.assume_init_mut() };
            match Program::new(memory, log, place, crc, rom) {
                Some(it) => {
                    program.write(it);
                    0
                }
                None => FAILED,
            }
        }
    }
}

/// Clears the memory that is not in the image, but for what the beginning writes.
fn clear() {
    let (mut at, end) = (&raw mut __services_bss, &raw mut __services_clear_end);
    while at < end {
        // SAFETY: the linker's bounds of `.bss`, which is not in use yet.
        unsafe {
            at.write_volatile(0);
            at = at.add(1);
        }
    }
}

/// The SDRAM after the program; it is not in use yet.
struct Sdram;

impl Cells for Sdram {
    fn write(&mut self, at: usize, value: u32) {
        // SAFETY: aligned, inside the SDRAM's window, and after all memory in use except for the
        // first word, which is not needed any more.
        unsafe { ((SDRAM_BASE + at) as *mut u32).write_volatile(value) }
    }

    fn read(&mut self, at: usize) -> u32 {
        // SAFETY: aligned, and inside the SDRAM's window.
        unsafe { ((SDRAM_BASE + at) as *const u32).read_volatile() }
    }
}

/// The board, through the ROM's callbacks.
struct Calls<'a>(&'a Rom);

impl Outside for Calls<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let words = (self.0.datagram)(self.0.context, request.as_ptr(), request.len(), reply);
        usize::try_from(words).unwrap_or(0)
    }

    fn ask(&mut self, request: &[u32], reply: &mut [u32]) -> usize {
        // SAFETY: the ROM makes one call at a time, and its callback makes none; this is the only
        // place that uses it.
        let room = unsafe { &mut *(&raw mut ANSWER) };
        self.ask_in(room, request, reply)
    }

    fn read_segments(&mut self, word: usize) -> u32 {
        // SAFETY: a page of registers, for every word; a read changes nothing.
        unsafe { segments(word).read_volatile() }
    }

    fn write_segments(&mut self, word: usize, value: u32) {
        // SAFETY: a page of registers, for every word; only this program writes them.
        unsafe { segments(word).write_volatile(value) }
    }

    fn now(&mut self) -> u64 {
        // SAFETY: reads the clock as the ROM does, which waits meanwhile.
        let timebase = unsafe { litex_pac::Timebase::steal() };
        timebase.snapshot().write(|w| unsafe { w.bits(1) });
        let high = u64::from(timebase.now_hi().read().bits());
        high << 32 | u64::from(timebase.now_lo().read().bits())
    }
}

impl Network for Calls<'_> {
    fn send_frame(&mut self, frame: &[u8]) {
        // SAFETY: the ROM's buffer, which no other code uses while the ROM waits.
        let room = unsafe { &mut *self.0.output };
        if let Some(room) = room.get_mut(..frame.len()) {
            room.copy_from_slice(frame);
            (self.0.send)(self.0.context, frame.len());
        }
    }

    fn send_with<R>(&mut self, length: usize, write: impl FnOnce(&mut [u8]) -> R) -> R {
        // SAFETY: as above. It is not the buffer of the frame that came.
        let room = unsafe { &mut *self.0.output };
        if let Some(short) = room.first_chunk_mut::<SHORTEST>() {
            *short = [0; SHORTEST];
        }
        let (frame, _) = room.split_at_mut(length.min(FRAME_MAX));
        let result = write(frame);
        (self.0.send)(self.0.context, length.min(FRAME_MAX));
        result
    }

    fn console(&mut self, visitor: usize, verb: Verb, words: &mut [u32; VISIT_WORDS]) -> Verdict {
        Verdict::from_code((self.0.console)(
            self.0.context,
            visitor,
            verb as u32,
            words,
        ))
    }

    fn leased(&mut self, lease: Option<Lease>) {
        let Lease {
            ip,
            prefix,
            gateway,
        } = lease.unwrap_or_default();
        (self.0.leased)(self.0.context, ip, prefix.into(), gateway);
    }

    fn moving(&mut self) -> bool {
        self.0.moving
    }

    fn us(&mut self) -> Us {
        // SAFETY: valid while the ROM waits.
        unsafe { *self.0.us }
    }
}

fn segments(word: usize) -> *mut u32 {
    (regmap::segments::BASE + word % (CSR_PAGE / 4) * 4) as *mut u32
}

/// Traps into the ROM's handler, which ends this call and makes no other: the machine goes on.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        // SAFETY: it traps and does nothing else.
        unsafe { core::arch::asm!("ebreak") };
    }
}
