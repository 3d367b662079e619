//! 24 hours of model time: clients that die, return, hang up, shut their windows, and strangers
//! that forge and flood. Behind each of it a console and the line for jobs are free within their
//! limits.

use super::host::Host;
use super::rig::Board;
use smoltcp::wire::{TcpControl, TcpSeqNumber};
use std::vec::Vec;
use wire::CONSOLE_PORT;
use wire::jobs::{SILENCE_SECONDS, Status};

const DAY_MS: u64 = 24 * 3600 * 1000;
/// A console is free again so long after the last frame of clients that died.
const CONSOLE_MS: u64 = 92_000;
/// The line for jobs is.
const LINE_MS: u64 = SILENCE_SECONDS as u64 * 1000;
/// After handshakes that nothing followed.
const HANDSHAKE_MS: u64 = 250;
/// The board looks at a connection at a time, every 10 ms.
const MORE_MS: u64 = 200;

/// Numbers that a seed decides.
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: u32) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as u32 % limit
    }
}

struct Day {
    board: Board,
    dice: Dice,
    port: u16,
    /// The longest waits, consoles' and the line's, behind clients and behind handshakes.
    worst: [u64; 4],
}

impl Day {
    /// A client with a port that is new for a while, or the one of its predecessor.
    fn host(&mut self, to_jobs: bool) -> Host {
        self.port = 2_000 + (self.port + self.dice.below(2) as u16) % 50_000;
        let last = 1 + self.dice.below(30) as u8;
        let mut host = match to_jobs {
            true => Host::of_jobs(last),
            false => Host::new(last),
        };
        host.seq = TcpSeqNumber((self.dice.below(u32::MAX)) as i32);
        host.at(self.port)
    }

    /// A client does this at most, and says nothing more.
    fn dies(&mut self, to_jobs: bool) {
        let mut host = self.host(to_jobs);
        let state = self.dice.below(9);
        if !host.knocks(&mut self.board) || state == 0 {
            return;
        }
        let sent = self.board.frame(&host.nod());
        host.hear(&sent);
        let line: &[u8] = if to_jobs { b"\x01\0\0" } else { b"help\n" };
        if state == 1 {
            host.window = 0;
        }
        if state < 8 {
            let sent = self.board.frame(&host.segment(TcpControl::Psh, true, line));
            host.seq += line.len();
            if state > 3 {
                host.hear(&sent);
                self.board.frame(&host.nod());
            }
        }
        match state {
            2 | 5 => drop(self.board.frame(&host.segment(TcpControl::Fin, true, b""))),
            6 => drop(
                self.board
                    .frame(&host.segment(TcpControl::Psh, true, b"quit\n")),
            ),
            7 => host.resets(&mut self.board),
            3 | 4 => self.forged(&host),
            _ => {}
        }
    }

    /// A stranger guesses: resets, acknowledgements, data, a SYN, an end.
    fn forged(&mut self, host: &Host) {
        for _ in 0..20 {
            let mut forged = host.clone();
            let by = (self.dice.below(u32::MAX)) as i32 >> self.dice.below(31);
            forged.seq = TcpSeqNumber(host.seq.0.wrapping_add(by));
            let by = (self.dice.below(u32::MAX)) as i32 >> self.dice.below(31);
            forged.ack = TcpSeqNumber(host.ack.0.wrapping_add(by));
            let control = match self.dice.below(5) {
                0 => TcpControl::Rst,
                1 => TcpControl::Syn,
                2 => TcpControl::Fin,
                3 => TcpControl::Psh,
                _ => TcpControl::None,
            };
            let ack = self.dice.below(4) > 0;
            let length = self.dice.below(100) as usize;
            let data = [b'z'; 100];
            self.board
                .frame(&forged.segment(control, ack, &data[..length]));
        }
    }

    fn flood(&mut self) {
        for n in 0..200u16 {
            for to_jobs in [false, true] {
                let host = self.host(to_jobs).at(60_000 + n);
                self.board.frame(&host.segment(TcpControl::Syn, false, b""));
            }
            self.board.wait(u64::from(self.dice.below(2)) * 10);
        }
    }

    /// A fresh client gets in, is answered, and leaves.
    fn served(&mut self, to: u16, limit: u64) -> u64 {
        let from = self.board.ms();
        loop {
            let passed = self.board.ms() - from;
            assert!(
                passed <= limit,
                "{to}: {passed} ms, at {from} ms of the day"
            );
            let mut host = self.host(to != CONSOLE_PORT);
            host.ip = Host::new(99).ip;
            if host.enters(&mut self.board) {
                let alive = match to {
                    CONSOLE_PORT => host.is_heard(&mut self.board),
                    _ => host.greets(&mut self.board) == Some(Status::Normal),
                };
                host.leaves(&mut self.board);
                if alive {
                    return passed;
                }
            }
            self.board.wait(50);
        }
    }
}

#[test]
fn through_24_hours_a_console_and_the_line_for_jobs_are_free_within_their_limits() {
    let seed = 17;
    let mut day = Day {
        board: Board::new(),
        dice: Dice(seed),
        port: 0,
        worst: [0; 4],
    };
    let mut rounds = 0;
    while day.board.ms() < DAY_MS {
        rounds += 1;
        let flooded = day.dice.below(4) == 0;
        if flooded {
            day.flood();
        } else {
            for _ in 0..1 + day.dice.below(8) {
                let to_jobs = day.dice.below(3) == 0;
                day.dies(to_jobs);
                let pause = u64::from(day.dice.below(3) * day.dice.below(5_000));
                day.board.wait_by(pause, 50);
            }
        }
        let (line, console) = match flooded {
            // Clients of the round before may have died in front of it, too.
            true => (LINE_MS.max(HANDSHAKE_MS), CONSOLE_MS),
            false => (LINE_MS, CONSOLE_MS),
        };
        let line = day.served(wire::jobs::PORT, line + MORE_MS);
        let console = day.served(CONSOLE_PORT, console + MORE_MS);
        let at = 2 * usize::from(flooded);
        day.worst[at] = day.worst[at].max(console);
        day.worst[at + 1] = day.worst[at + 1].max(line);
        // A quiet time, at whose end all is free at once, and behind a flood 250 ms later.
        let quiet = 100_000 + u64::from(day.dice.below(1_200_000));
        day.board.wait_by(quiet, 200);
        let waits: Vec<u64> = [CONSOLE_PORT, wire::jobs::PORT]
            .map(|to| day.served(to, 0))
            .to_vec();
        assert_eq!(waits, [0, 0]);
        day.flood();
        for to in [CONSOLE_PORT, wire::jobs::PORT] {
            day.served(to, HANDSHAKE_MS + MORE_MS);
        }
    }
    std::println!(
        "seed {seed}: {rounds} rounds; longest waits, ms: {:?}",
        day.worst
    );
    assert!(
        day.worst[0] > 60_000 && day.worst[1] > 5_000,
        "nothing was ever taken"
    );
}
