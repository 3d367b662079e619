//! Starts the SDRAM; finds, copies and checks the jobs program. The program tests the rest of the
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
use wire::regmap::sdram::{
    DFII_CONTROL_CKE, DFII_CONTROL_ODT, DFII_CONTROL_RESET_N, DFII_CONTROL_SEL,
    DFII_PI0_COMMAND_CAS as CAS, DFII_PI0_COMMAND_CS as CS, DFII_PI0_COMMAND_RAS as RAS,
    DFII_PI0_COMMAND_WE as WE,
};

/// CS with RAS, CAS and WE: precharge, refresh, mode register.
const PRECHARGE: u32 = CS | WE | RAS;
const REFRESH: u32 = CS | CAS | RAS;
const MODE: u32 = CS | WE | CAS | RAS;
/// Address bit 10 with a precharge: all banks.
const ALL: u32 = 1 << 10;
/// Mode register: bursts of one word, two clocks from column to data.
const CL_2: u32 = 2 << 4;
/// Clock enable; the clock has been running for a long time.
const BY_HAND: u32 = DFII_CONTROL_CKE | DFII_CONTROL_ODT | DFII_CONTROL_RESET_N;
/// The controller does the rest.
const BY_HARDWARE: u32 = DFII_CONTROL_SEL;
/// More refreshes than any data sheet requires.
const REFRESHES: u32 = 8;
/// Clocks: 200 us at up to 125 MHz.
const REST: u32 = 25_000;

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

/// Starts the SDRAM as its data sheets require. False: there is no controller, its page reads 0.
#[inline(never)]
fn wake(board: &mut Soc) -> bool {
    // SAFETY: no other code touches these registers; every value below is a valid command.
    let regs = unsafe { Sdram::steal() };
    regs.dfii_control().write(|w| unsafe { w.bits(BY_HAND) });
    regs.dfii_pi0_baddress().write(|w| unsafe { w.bits(0) });
    for step in 0..=REFRESHES + 2 {
        // The first command requires 200 us of rest before it; between the others a few clocks
        // would be enough.
        let start = board.now_lo();
        while board.now_lo().wrapping_sub(start) < REST {}
        let (address, command) = match step {
            0 => (ALL, PRECHARGE),
            1..=REFRESHES => (0, REFRESH),
            _ => (CL_2, MODE),
        };
        regs.dfii_pi0_address()
            .write(|w| unsafe { w.bits(address) });
        regs.dfii_pi0_command()
            .write(|w| unsafe { w.bits(command) });
        regs.dfii_pi0_command_issue()
            .write(|w| unsafe { w.bits(1) });
    }
    regs.dfii_control()
        .write(|w| unsafe { w.bits(BY_HARDWARE) });
    regs.dfii_control().read().bits() == BY_HARDWARE
}
