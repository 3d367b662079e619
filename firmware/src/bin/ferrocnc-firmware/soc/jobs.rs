//! Waits for the SDRAM; finds, copies and checks the jobs program. The program tests the rest of the
//! SDRAM: the ROM has no room for that, and a right CRC shows that the program's own memory works.

use super::{ABI, Soc};
use firmware::cores::Board as _;
use firmware::jobs::abi::{self, Header};
use firmware::machine::Machine;
use firmware::nor::Nor;
use litex_pac::Sdram;
use wire::describe::JobsState;
use wire::images::program_length;
use wire::regmap::SDRAM_BASE;

/// Clocks until there is an SDRAM, or none: its controller starts it in 0.4 ms at 60 MHz, in clocks
/// twice as many at most at 125.
const START: u32 = 60_000;

/// The beginning of the SDRAM.
struct Room([u32; abi::ROOM / 4]);

impl Room {
    fn bytes(&mut self, count: usize) -> &mut [u8] {
        // SAFETY: the same memory, with the same size.
        unsafe { core::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), count.min(abi::ROOM)) }
    }
}

/// All work at start: returns the jobs program's entry, or the state to report.
#[inline(never)]
pub fn load(machine: &mut Machine<Soc>) -> Result<abi::Entry, JobsState> {
    if !machine.plays_segments() {
        return Err(JobsState::None);
    }
    if !wake(&mut machine.board) {
        return Err(JobsState::Streamed);
    }
    let Some((start, length)) = machine.image() else {
        return Err(JobsState::Missing);
    };
    let spi = machine.board.spi();
    let (mut nor, end) = (Nor(spi), start + length);
    // SAFETY: no other code uses the SDRAM yet, it is at least this large, and it is aligned.
    let room = unsafe { &mut *(SDRAM_BASE as *mut Room) };
    let _ = nor.read(end.wrapping_sub(8), room.bytes(8));
    let [first, second, ..] = room.0;
    let Some(length) = program_length([first, second]) else {
        return Err(JobsState::Missing);
    };
    let _ = nor.read(end.wrapping_sub(length as u32), room.bytes(length));
    let words = room.0.get(..length / 4).unwrap_or(&[]);
    match abi::check(words, ABI) {
        JobsState::Alive => {
            // SAFETY: discards cached instructions, if there are any. The words are the complete
            // header of a program linked to this address.
            unsafe {
                core::arch::asm!("fence.i");
                Ok((*(SDRAM_BASE as *const Header)).entry)
            }
        }
        state => Err(state),
    }
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
