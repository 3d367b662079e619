//! What an exchange waits for, and what it takes itself.

use crate::{BenchMachine, parts, symbol};
use sim::lan_segment::{BOARD_PORT, HOST_IP};
use sim::rig::RIG_PORT;
use wire::exchange::Command;

/// Ethernet, IPv4 and UDP headers, preamble and FCS.
const AROUND: usize = 14 + 20 + 8 + 8 + 4;
/// Nanoseconds of a byte on the wire.
const BYTE_NS: u64 = 8;
/// More than any exchange takes.
const LONGEST: u64 = 60_000;

/// The turnaround of an exchange, in clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// From its last byte on until the firmware takes its frame; 0 if it had a pass.
    pub waits: u64,
    /// From then on until the first byte of the answer.
    pub takes: u64,
}

impl BenchMachine {
    /// Clocks of a datagram of so many bytes on the wire.
    pub fn clocks_on_wire(&self, bytes: usize) -> u64 {
        let ns = (bytes + AROUND) as f64 * BYTE_NS as f64;
        (ns * 1e-9 * self.clock_hz()) as u64
    }

    /// One exchange, looked at clock by clock.
    ///
    /// # Panics
    ///
    /// If it is not answered.
    pub fn exchange_in_parts(&mut self, command: &mut Command) -> Parts {
        let (frame, _) = symbol(&parts().1, "3App5frame");
        let bytes = self.next_command_bytes(command);
        self.rig.take_datagrams();
        self.rig.post((HOST_IP, RIG_PORT), BOARD_PORT, &bytes);
        let end = self.clock() + LONGEST;
        let received = self.clock() + self.clocks_on_wire(bytes.len());
        let mut taken = None;
        while self.clock() < end {
            self.rig.run(1);
            let here = self.rig.board.silicon().pc() == Some(frame as u32);
            if taken.is_none() && here && self.clock() >= received {
                taken = Some(self.clock() - received);
            }
            if let Some((_, timing)) = self.rig.take_datagrams().pop() {
                let turnaround = timing.expect("an answer to the exchange").turnaround;
                let waits = taken.unwrap_or(0);
                return Parts {
                    waits,
                    takes: turnaround - waits,
                };
            }
        }
        panic!("no answer");
    }
}
