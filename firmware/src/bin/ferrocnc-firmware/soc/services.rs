//! Waits for the SDRAM; finds, copies, checks and calls the services, sums their code again and
//! again, and outlives them. The program tests the rest of the SDRAM: the ROM has no room for that,
//! and a right CRC shows that the program's own memory works.

use super::{ABI, Soc};
use core::arch::global_asm;
use firmware::cores::Board as _;
use firmware::machine::Machine;
use firmware::nor::Nor;
use firmware::services::abi::{self, Header};
use litex_pac::Sdram;
use wire::describe::JobsState;
use wire::images::program_length;
use wire::regmap::{self, LEASH_IRQ, SDRAM_BASE, SDRAM_SIZE, timebase};

/// Clocks until there is an SDRAM, or none: its controller starts it in 0.4 ms at 60 MHz, in clocks
/// twice as many at most at 125.
const START: u32 = 60_000;

/// The beginning of the SDRAM.
struct Room([u32; abi::ROOM / 4]);

/// Bytes of a piece: less time to read or to sum it than for a guest's frame.
const PIECE: usize = 256;

/// Copies the program, a piece at a time, and then looks at what the SDRAM has kept of it. Later,
/// because a word that has just been written may be read from the data cache, and because a row
/// that does not exist shows only when the one in its place has been written.
pub struct Loader {
    /// The program's first byte in the flash.
    from: u32,
    /// Its length in bytes; 0 before the first piece.
    length: usize,
    copied: usize,
    looked: usize,
    check: abi::Check,
    patrol: abi::Patrol,
}

impl Loader {
    /// Before the first piece.
    pub fn new() -> Self {
        Loader {
            from: 0,
            length: 0,
            copied: 0,
            looked: 0,
            check: abi::Check::new(),
            patrol: abi::Patrol::new(),
        }
    }

    /// The next piece. At the end: the program's header and the sum of its code, or the state to
    /// report.
    #[inline(never)]
    pub fn step(
        &mut self,
        machine: &mut Machine<Soc>,
    ) -> Option<Result<(Header, abi::Patrol), JobsState>> {
        // SAFETY: no program runs in the SDRAM, it is at least this large, and it is aligned.
        let room = unsafe { &mut *(SDRAM_BASE as *mut Room) };
        if self.length == 0 {
            return self.begin(machine).err().map(Err);
        }
        if self.copied < self.length {
            let at = self.from.wrapping_add(self.copied as u32);
            let words = piece(room, &mut self.copied, self.length);
            let check = &mut self.check;
            let spi = machine.board.spi();
            spi.stream(at, words, |word| check.came(word));
            self.patrol.loaded(&room.0, self.copied / 4, &self.check);
            if self.copied == self.length {
                discard_data();
            }
            return None;
        }
        self.check.kept(piece(room, &mut self.looked, self.length));
        if self.looked < self.length {
            return None;
        }
        Some(match self.check.verdict(&room.0, ABI) {
            JobsState::Alive => {
                // SAFETY: discards cached instructions, if there are any. The words are the
                // complete header of a program linked to this address.
                unsafe {
                    core::arch::asm!("fence.i");
                    Ok((*(SDRAM_BASE as *const Header), self.patrol))
                }
            }
            state => Err(state),
        })
    }

    /// Waits for the SDRAM and finds the program.
    fn begin(&mut self, machine: &mut Machine<Soc>) -> Result<(), JobsState> {
        if !wake(&mut machine.board) {
            return Err(match machine.plays_segments() {
                true => JobsState::Streamed,
                false => JobsState::None,
            });
        }
        let (start, length) = machine.image().ok_or(JobsState::Missing)?;
        let end = start + length;
        let mut nor = Nor(machine.board.spi());
        // Not in the SDRAM: what the cache keeps of it would be summed in its place.
        let mut last = [0; 2];
        let _ = nor.read(end.wrapping_sub(8), bytes(&mut last));
        let length = program_length(last).filter(|length| *length > 0);
        self.length = length.ok_or(JobsState::Missing)?;
        self.from = end.wrapping_sub(self.length as u32);
        Ok(())
    }
}

/// Nothing is read from the data cache that was read before.
fn discard_data() {
    // SAFETY: VexRiscv's own instruction. All stores have been written through.
    unsafe { core::arch::asm!(".word 0x500f", "nop", "nop", "nop", "nop", "nop") }
}

/// The next piece of a program of this length, of which so many bytes are done.
fn piece<'r>(room: &'r mut Room, done: &mut usize, length: usize) -> &'r mut [u32] {
    let count = PIECE.min(length - *done);
    let words = room.0.get_mut(*done / 4..).unwrap_or(&mut []);
    *done += count;
    words.get_mut(..count / 4).unwrap_or(&mut [])
}

/// The bytes of these words.
fn bytes(words: &mut [u32; 2]) -> &mut [u8] {
    // SAFETY: the same memory, and no more of it.
    unsafe { core::slice::from_raw_parts_mut(words.as_mut_ptr().cast(), size_of_val(words)) }
}

// The services are called with the ROM's registers saved, and what is in them is taken from there
// if they do not come back. `services_sp` is the stack pointer while they run. The guard is closed
// exactly then: it is what tells their code from the ROM's, wherever the program counter is.
//
// Every trap comes to `services_trap`. One with the guard closed ends the services, and their stack
// pointer is not used. The leash's interrupt may come while the ROM does what they asked for: it is
// enabled again by the instruction that returns to them (`services_enter`). All others are the
// ROM's own. This processor has no `mscratch`: `t0` is kept in the mask of interrupts, 0xbc0, which
// does not count until that return. A jump to the reset vector with the guard closed is no reset
// (`__pre_init`).
//
// What the ROM does for the services it does on their stack, and the guard is open then. So it is
// done only if their stack pointer is in the SDRAM, above `STACK_LEAST` bytes of it: the ROM's own
// memory is nowhere below.
//
// A store that the guard keeps back may be in the data cache, which is discarded in `services_end`
// before anything is read through it. The read of the guard's status waits for the stores before
// it, and is not cached: the ROM looks at it before it opens the guard and goes on
// (`services_enter`, `services_call`).
global_asm!(
    ".option push",
    ".option norelax",
    ".section .bss.services_sp,\"aw\",@nobits",
    ".balign 4",
    "services_sp: .zero 4",
    ".section .text.services_call,\"ax\",@progbits",
    ".type services_call, @function",
    ".global services_call",
    "services_call:",
    "    jal     t0, __riscv_save_12",
    "    la      t0, services_sp",
    "    sw      sp, 0(t0)",
    "    lui     t0, {page}",
    "    sw      zero, {guard}(t0)",
    "    csrsi   mstatus, 8",
    "    jalr    a3",
    "    csrci   mstatus, 8",
    "    lui     t0, {page}",
    "    lw      t1, {status}(t0)",
    "    bltz    t1, services_end",
    "    li      t1, {key}",
    "    sw      t1, {guard}(t0)",
    "    j       __riscv_restore_12",
    ".section .text.services_end,\"ax\",@progbits",
    ".type services_end, @function",
    ".global services_end",
    "services_end:",
    "    csrci   mstatus, 8",
    "    lui     t0, {page}",
    "    li      t1, {key}",
    "    sw      t1, {guard}(t0)",
    "    .word   0x500f", // VexRiscv: discards the data cache
    "    nop",
    "    nop",
    "    nop",
    "    nop",
    "    nop",
    "    la      t0, services_sp",
    "    lw      sp, 0(t0)",
    "    la      gp, __global_pointer$",
    "    li      a0, {dead}",
    "    j       __riscv_restore_12",
    ".section .text.services_trap,\"ax\",@progbits",
    ".balign 4",
    ".type services_trap, @function",
    ".global services_trap",
    "services_trap:",
    "    csrw    0xbc0, t0",
    "    lui     t0, {page}",
    "    lw      t0, {status}(t0)",
    "    andi    t0, t0, 1",
    "    bnez    t0, 2f",
    "    csrr    t0, mcause",
    "    bgez    t0, 1f",
    "    li      t0, 0x80",
    "    csrc    mstatus, t0",
    "    csrr    t0, 0xbc0",
    "    mret",
    "1:  csrr    t0, 0xbc0",
    "    j       _start_trap",
    "2:  j       services_end",
    ".section .text.services_enter,\"ax\",@progbits",
    ".type services_enter, @function",
    ".global services_enter",
    "services_enter:",
    "    addi    sp, sp, -16",
    "    sw      ra, 12(sp)",
    "    lui     t0, {page}",
    "    lw      t1, {status}(t0)",
    "    bltz    t1, services_end",
    "    lui     t1, {lowest}",
    "    sub     t1, sp, t1",
    "    lui     t3, {depth}",
    "    bgeu    t1, t3, services_end",
    "    li      t1, {key}",
    "    sw      t1, {guard}(t0)",
    "    jalr    t2",
    "    lw      ra, 12(sp)",
    "    addi    sp, sp, 16",
    "    csrci   mstatus, 8",
    "    lui     t0, {page}",
    "    sw      zero, {guard}(t0)",
    "    csrw    mepc, ra",
    "    lui     t0, {leash}",
    "    csrw    0xbc0, t0",
    "    li      t0, 0x1880",
    "    csrs    mstatus, t0",
    "    mret",
    // Runs at the reset vector, before the RAM is written.
    ".section .text.__pre_init,\"ax\",@progbits",
    ".type __pre_init, @function",
    ".global __pre_init",
    "__pre_init:",
    "    lui     t0, {page}",
    "    lw      t0, {status}(t0)",
    "    andi    t0, t0, 1",
    "    bnez    t0, services_end",
    "    ret",
    ".option pop",
    page = const (GUARD + 0x800) >> 12,
    guard = const GUARD as i32 - PAGE as i32,
    status = const GUARD_STATUS as i32 - PAGE as i32,
    key = const timebase::GUARD_KEY_OPEN,
    dead = const abi::DEAD,
    leash = const (1u32 << LEASH_IRQ) >> 12,
    lowest = const (SDRAM_BASE + STACK_LEAST) >> 12,
    depth = const (SDRAM_SIZE - STACK_LEAST) >> 12,
);

/// Bytes of stack, at least, for what the ROM does for the services.
const STACK_LEAST: usize = 0x4000;

/// The guard's registers, and what `lui` makes of their upper bits.
const GUARD: u32 = regmap::address(timebase::BASE, timebase::GUARD);
const GUARD_STATUS: u32 = regmap::address(timebase::BASE, timebase::GUARD_STATUS);
const PAGE: u32 = (GUARD + 0x800) & !0xfff;
const _: () = assert!((GUARD_STATUS + 0x800) & !0xfff == PAGE);
const _: () =
    assert!(timebase::GUARD_STATUS_CLOSED == 1 && timebase::GUARD_STATUS_REFUSED == 1 << 31);
/// Where an external interrupt is enabled in `mie`.
const EXTERNAL: u32 = 1 << 11;

unsafe extern "C" {
    /// Calls the entry; the result is [`abi::DEAD`] if the services did not come back.
    fn services_call(rom: &abi::Rom, frame: *const u8, length: usize, entry: abi::Entry) -> u32;
    fn services_trap();
}

/// Every trap comes to `services_trap` from now on, and the leash's interrupt is one.
pub fn watch() {
    // SAFETY: a trap handler, aligned to a word. 0xbc0 is VexRiscv's mask of external interrupts;
    // they are enabled in `mstatus` around a call only.
    unsafe {
        core::arch::asm!(
            "csrw mtvec, {trap}",
            "csrw 0xbc0, {leash}",
            "csrs mie, {external}",
            trap = in(reg) services_trap as *const (),
            leash = in(reg) 1u32 << LEASH_IRQ,
            external = in(reg) EXTERNAL,
        );
    }
}

/// Sums the next piece of the services that were loaded. False: they have changed.
#[inline(never)]
pub fn patrol(patrol: &mut abi::Patrol) -> bool {
    // SAFETY: the program lies there and does not run now; only what it never writes is read.
    let room = unsafe { &*(SDRAM_BASE as *const Room) };
    patrol.step(&room.0)
}

/// Do these bytes lie in the SDRAM, and at a word's address? The ROM does what the services ask for
/// with no other memory: their code may be what is broken.
pub fn theirs(at: usize, bytes: usize) -> bool {
    let offset = at.wrapping_sub(SDRAM_BASE);
    at.is_multiple_of(4) && offset < SDRAM_SIZE && bytes <= SDRAM_SIZE - offset
}

/// Calls the services, which have to come back within so many clocks.
pub fn call(
    entry: abi::Entry,
    rom: &abi::Rom,
    frame: *const u8,
    length: usize,
    clocks: u32,
) -> u32 {
    leash(clocks);
    // SAFETY: the entry of a program whose header was checked; it keeps the registers a function
    // has to keep, and if it ends otherwise they are restored.
    let answer = unsafe { services_call(rom, frame, length, entry) };
    leash(0);
    if answer == abi::DEAD {
        // They may have come to the reset vector, where interrupts and traps are set anew.
        watch();
    }
    answer
}

/// The interrupt after so many clocks; 0: none.
fn leash(clocks: u32) {
    // SAFETY: a register that does nothing else.
    let timebase = unsafe { litex_pac::Timebase::steal() };
    timebase.leash().write(|w| unsafe { w.bits(clocks) });
}

/// Waits until the SDRAM has been started. False: there is no controller, its page reads 0.
#[inline(never)]
fn wake(board: &mut Soc) -> bool {
    // SAFETY: the register is only read.
    let status = unsafe { Sdram::steal() };
    let start = board.now_lo();
    while !status.status().read().ready().bit() {
        if board.now_lo().wrapping_sub(start) > START {
            return false;
        }
    }
    true
}
