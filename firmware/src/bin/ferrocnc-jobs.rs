//! The jobs program: what the ROM has no room for, in SDRAM. What it is to the ROM stands in [`firmware::jobs::abi`].
#![no_std]
#![no_main]

use core::arch::global_asm;
use core::slice;
use firmware::ip::{Ip, Taker, Text};
use firmware::jobs::abi::{FAILED, Header, INTERFACE, RESTLESS, Rom, START, TAKEN};
use firmware::text::Sink as _;
use litex_pac::abi;

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

/// TCP port of jobs.
const PORT: u16 = wire::jobs::PORT;

/// All there is; in `.bss`.
struct Memory {
    ip: Ip,
}

static mut MEMORY: Memory = Memory { ip: Ip::new() };

/// On the program's own stack, as [`firmware::jobs::abi::Entry`] has it.
#[unsafe(no_mangle)]
extern "C" fn jobs_main(rom: &Rom, frame: *const u8, length: usize) -> u32 {
    if frame.is_null() && length == START {
        clear();
        let Some(_size) = test() else {
            return FAILED;
        };
    }
    // SAFETY: the ROM calls once at a time, and what is called back does not call again.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    // SAFETY: the ROM says how long its frame is.
    let frame = (!frame.is_null()).then(|| unsafe { slice::from_raw_parts(frame, length) });
    memory.turn(rom, frame)
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

/// Writes a word for each address line beyond the program, other bits to each, and reads them all back; the lines before are as good
/// as the program's CRC, which was right. How many bytes of SDRAM there are, if they hold what they are given.
fn test() -> Option<usize> {
    const CACHE: usize = 0x1000;
    let word = |at: usize| (abi::SDRAM_BASE + at) as *mut u32;
    let pattern = |at: usize| 0x9e37_79b9u32.wrapping_mul(at as u32 | 1);
    let used = (&raw const __jobs_bss_end) as usize - abi::SDRAM_BASE;
    let lines = (2..abi::SDRAM_SIZE.ilog2())
        .map(|line| 1usize << line)
        .filter(|at| *at > used);
    // SAFETY: aligned, inside the SDRAM's window, and behind everything that is used but the first word, which nobody needs any
    // more: on a card with half as much it is the same as the one half-way up the window.
    unsafe {
        for at in lines.clone() {
            word(at).write_volatile(pattern(at));
        }
        word(0).write_volatile(pattern(0));
        let half = abi::SDRAM_SIZE / 2;
        // Each of these lies at a multiple of the data cache's size, and so is read from the SDRAM.
        word(CACHE).read_volatile();
        let size = if word(half).read_volatile() == pattern(0) {
            half
        } else {
            abi::SDRAM_SIZE
        };
        let good = lines
            .filter(|at| *at < size)
            .all(|at| word(at).read_volatile() == pattern(at));
        good.then_some(size)
    }
}

impl Memory {
    fn turn(&mut self, rom: &Rom, frame: Option<&[u8]>) -> u32 {
        if frame.is_some_and(|frame| !ours(frame)) {
            return 0;
        }
        self.ip.listen(PORT, 64);
        // SAFETY: both are the ROM's, and valid while it waits.
        let (us, out) = unsafe { (&*rom.us, &mut *rom.output) };
        let now = milliseconds();
        let ip = &mut self.ip;
        let mut answer = frame
            .and_then(|frame| ip.frame(frame, us, now, &mut Visitor, out))
            .or_else(|| ip.poll(us, now, &mut Visitor, out));
        while let Some(length) = answer {
            (rom.send)(rom.context, length);
            answer = ip.poll(us, now, &mut Visitor, out);
        }
        if ip.busy() { RESTLESS | TAKEN } else { TAKEN }
    }
}

/// Is this TCP, to the port of jobs?
fn ours(frame: &[u8]) -> bool {
    let ip = frame.get(12..14) == Some(&[8, 0]) && frame.get(23) == Some(&6);
    let header = frame.get(14).map_or(0, |byte| usize::from(byte & 15) * 4);
    ip && frame.get(14 + header + 2..14 + header + 4) == Some(&PORT.to_be_bytes())
}

/// Since power-up, for TCP's timers.
fn milliseconds() -> u32 {
    // SAFETY: reads the clock as the ROM does, which waits meanwhile.
    let (timebase, ident) = unsafe { (litex_pac::Timebase::steal(), litex_pac::Ident::steal()) };
    timebase.snapshot().write(|w| unsafe { w.bits(1) });
    let now = u64::from(timebase.now_hi().read().bits()) << 32
        | u64::from(timebase.now_lo().read().bits());
    (now / u64::from((ident.sys_clk_hz().read().bits() / 1000).max(1))) as u32
}

/// Whoever is connected.
struct Visitor;

impl Taker for Visitor {
    fn greet(&mut self, out: &mut Text) {
        out.put(b"jobs\r\n");
    }

    fn take(&mut self, bytes: &[u8], out: &mut Text) -> usize {
        out.put(bytes);
        bytes.len()
    }
}

/// Into the ROM's trap handler, which leaves a record and starts the board anew, its gate closed.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        // SAFETY: an instruction there is not.
        unsafe { core::arch::asm!("unimp") };
    }
}
