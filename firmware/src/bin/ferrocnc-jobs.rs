//! The jobs program: what the ROM has no room for, in SDRAM. What it is to the ROM stands in [`firmware::jobs::abi`].
#![no_std]
#![no_main]

use core::arch::global_asm;
use core::mem::MaybeUninit;
use core::slice;
use firmware::jobs::abi::{
    FAILED, Header, INTERFACE, LINE, RESTLESS, ROOM, Rom, START, TAKEN, TEXT, TEXT_MAX, TRUSTED,
};
use firmware::jobs::memory::{self, Cells};
use firmware::jobs::{Jobs, Outside};
use firmware::net::Us;
use litex_pac::abi;
use wire::MAX_WORDS;
use wire::jobs::PORT;

const _: () = assert!(abi::SDRAM_BASE == 0x4000_0000 && firmware::jobs::abi::ROOM == 512 * 1024);

// The ROM's stack ends here: the caller's is put by, and the program's own taken.
global_asm!(
    ".section .text.jobs_entry",
    ".global jobs_entry",
    "jobs_entry:",
    "    la      t0, __jobs_stack",
    "    sw      ra, -4(t0)",
    "    sw      sp, -8(t0)",
    "    addi    sp, t0, -16",
    "    call    jobs_main",
    "    la      t0, __jobs_stack",
    "    lw      ra, -4(t0)",
    "    lw      sp, -8(t0)",
    "    ret",
);

unsafe extern "C" {
    safe fn jobs_entry(rom: &Rom, frame: *const u8, length: usize) -> u32;
    static mut __jobs_bss: u32;
    static mut __jobs_bss_end: u32;
}

#[unsafe(no_mangle)]
#[unsafe(link_section = ".jobs.header")]
static JOBS_HEADER: Header = Header {
    crc: 0,
    interface: INTERFACE,
    abi: abi::ABI,
    entry: jobs_entry,
};

/// All there is; in `.bss`, and something from [`START`] on.
static mut JOBS: MaybeUninit<Jobs<'static>> = MaybeUninit::uninit();

/// On the program's own stack, as [`firmware::jobs::abi::Entry`] has it.
#[unsafe(no_mangle)]
extern "C" fn jobs_main(rom: &Rom, frame: *const u8, length: usize) -> u32 {
    let mut rom = Calls(rom);
    // SAFETY: the ROM calls once at a time, and what is called back does not call again.
    let place = unsafe { &mut *(&raw mut JOBS) };
    if frame.is_null() && length == START {
        return match start(&mut rom) {
            Some(jobs) => {
                place.write(jobs);
                0
            }
            None => FAILED,
        };
    }
    // SAFETY: the ROM calls nothing before START, and nothing behind one that FAILED.
    let jobs = unsafe { place.assume_init_mut() };
    if length & LINE != 0 {
        // SAFETY: the ROM says how long its line is, and does not touch it while it waits. Nothing is sent meanwhile, so nobody else
        // writes where the answer goes.
        let (line, room) = unsafe {
            (
                slice::from_raw_parts(frame, length % LINE),
                &mut *rom.0.output,
            )
        };
        let (room, _) = room.split_at_mut(TEXT_MAX);
        let written = jobs.line(line, length & TRUSTED != 0, room, &mut rom);
        return (written as u32) << TEXT | RESTLESS;
    }
    let mut answer = 0;
    if !frame.is_null() {
        // SAFETY: the ROM says how long its frame is. It is not where an answer is written to.
        let frame = unsafe { slice::from_raw_parts(frame, length) };
        if !ours(frame) {
            return 0;
        }
        jobs.frame(frame, &mut rom);
        answer |= TAKEN;
    }
    if jobs.poll(&mut rom) {
        answer |= RESTLESS;
    }
    answer
}

/// `None` if the SDRAM is not what it should be, or the board is none with jobs.
fn start(rom: &mut Calls) -> Option<Jobs<'static>> {
    clear();
    // SAFETY: the first word is the image's CRC, which was right. The test below takes its place.
    let program = unsafe { (abi::SDRAM_BASE as *const u32).read_volatile() };
    let used = (&raw const __jobs_bss_end) as usize - abi::SDRAM_BASE;
    let memory = memory::size(&mut Sdram, used, abi::SDRAM_SIZE)?.checked_sub(ROOM)?;
    // SAFETY: behind the program, to the SDRAM's end: nobody else's.
    let memory = unsafe { slice::from_raw_parts_mut((abi::SDRAM_BASE + ROOM) as *mut u8, memory) };
    Jobs::new(memory, program, rom)
}

/// Everything that is not in the image is zero.
fn clear() {
    let (mut at, end) = (&raw mut __jobs_bss, &raw mut __jobs_bss_end);
    while at < end {
        // SAFETY: the linker's bounds of `.bss`, which nobody uses yet.
        unsafe {
            at.write_volatile(0);
            at = at.add(1);
        }
    }
}

/// The SDRAM behind the program: it is nobody's yet.
struct Sdram;

impl Cells for Sdram {
    fn write(&mut self, at: usize, value: u32) {
        // SAFETY: aligned, inside the SDRAM's window, and behind everything that is used but the first word, which nobody needs any more.
        unsafe { ((abi::SDRAM_BASE + at) as *mut u32).write_volatile(value) }
    }

    fn read(&mut self, at: usize) -> u32 {
        // SAFETY: aligned, and inside the SDRAM's window.
        unsafe { ((abi::SDRAM_BASE + at) as *const u32).read_volatile() }
    }
}

/// The board, as the ROM lets it be reached.
struct Calls<'a>(&'a Rom);

impl Outside for Calls<'_> {
    fn datagram(&mut self, request: &[u32], reply: &mut [u32; MAX_WORDS]) -> usize {
        let words = (self.0.datagram)(self.0.context, request.as_ptr(), request.len(), reply);
        usize::try_from(words).unwrap_or(0)
    }

    fn send_frame(&mut self, frame: &[u8]) {
        // SAFETY: the ROM's, and nobody else's while it waits.
        let room = unsafe { &mut *self.0.output };
        if let Some(room) = room.get_mut(..frame.len()) {
            room.copy_from_slice(frame);
            (self.0.send)(self.0.context, frame.len());
        }
    }

    fn read_segments(&mut self, word: usize) -> u32 {
        // SAFETY: a page of registers, whatever the word; reading changes nothing.
        unsafe { segments(word).read_volatile() }
    }

    fn write_segments(&mut self, word: usize, value: u32) {
        // SAFETY: a page of registers, whatever the word; only this program writes them.
        unsafe { segments(word).write_volatile(value) }
    }

    fn now(&mut self) -> u64 {
        // SAFETY: reads the clock as the ROM does, which waits meanwhile.
        let timebase = unsafe { litex_pac::Timebase::steal() };
        timebase.snapshot().write(|w| unsafe { w.bits(1) });
        let high = u64::from(timebase.now_hi().read().bits());
        high << 32 | u64::from(timebase.now_lo().read().bits())
    }

    fn us(&mut self) -> Us {
        // SAFETY: valid while the ROM waits.
        unsafe { *self.0.us }
    }
}

fn segments(word: usize) -> *mut u32 {
    (abi::CSR_SEGMENTS + word % (abi::CSR_PAGE / 4) * 4) as *mut u32
}

/// Is this TCP, to the port of jobs?
fn ours(frame: &[u8]) -> bool {
    let ip = frame.get(12..14) == Some(&[8, 0]) && frame.get(23) == Some(&6);
    let header = frame.get(14).map_or(0, |byte| usize::from(byte & 15) * 4);
    ip && frame.get(14 + header + 2..14 + header + 4) == Some(&PORT.to_be_bytes())
}

/// Into the ROM's trap handler, which leaves a record and starts the board anew, its gate closed.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        // SAFETY: an instruction there is not.
        unsafe { core::arch::asm!("unimp") };
    }
}
