//! 24 hours of model time, and six ways to leave a console without a word. Behind each of them all
//! three consoles are free within its limit, and not before: no forged segment ends a connection,
//! and none keeps the place of a client that is gone.

use super::host::{Host, segment_of};
use super::rig::Board;
use smoltcp::wire::{TcpControl, TcpSeqNumber};
use std::vec::Vec;

const DAY_MS: u64 = 24 * 3600 * 1000;
/// A console is free again so long after the last frame of a client that died.
const GONE_MS: u64 = 92_000;
/// After a handshake that nothing followed.
const HANDSHAKE_MS: u64 = 250;
/// The test looks every 200 ms, and the board asks and answers in turns.
const MORE_MS: u64 = 400;

/// How three clients leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// They say nothing more.
    Idle,
    /// They never end their handshakes.
    HalfOpen,
    /// With windows that are shut in front of an answer.
    ZeroWindow,
    /// Behind minutes in which they only ask whether the board is there.
    KeepAlive,
    /// Strangers send resets in their names, before and afterwards.
    ForgedReset,
    /// Strangers send acknowledgements, and data with them.
    ForgedAck,
}

const WAYS: [Way; 6] = [
    Way::Idle,
    Way::HalfOpen,
    Way::ZeroWindow,
    Way::KeepAlive,
    Way::ForgedReset,
    Way::ForgedAck,
];

impl Way {
    /// When the consoles are free again, ms behind the clients' last frames.
    fn free(self) -> core::ops::RangeInclusive<u64> {
        match self {
            Way::HalfOpen => HANDSHAKE_MS - 50..=HANDSHAKE_MS + MORE_MS,
            _ => GONE_MS - 2_000..=GONE_MS + MORE_MS,
        }
    }
}

struct Day {
    board: Board,
    dice: u64,
    port: u16,
}

impl Day {
    fn below(&mut self, limit: u32) -> u32 {
        let factor = 6_364_136_223_846_793_005;
        let next = self.dice.wrapping_mul(factor);
        self.dice = next.wrapping_add(1_442_695_040_888_963_407);
        (self.dice >> 33) as u32 % limit
    }

    /// Three clients with ports of their own.
    fn three(&mut self, first: u8) -> [Host; 3] {
        self.port = 2_000 + (self.port + 3) % 50_000;
        [0, 1, 2].map(|n| {
            let mut host = Host::new(first + n).at(self.port + u16::from(n));
            host.seq = TcpSeqNumber(self.below(u32::MAX) as i32);
            host
        })
    }

    /// They ask for minutes whether the board is there, and answer when it asks.
    fn keep_alive(&mut self, hosts: &[Host; 3]) {
        for _ in 0..30 + self.below(200) {
            for (_, frame) in self.board.wait_by(1_000, 100) {
                let port = segment_of(&frame).expect("TCP").host;
                let host = hosts.iter().find(|host| host.port == port);
                self.board.frame(&host.expect("a client").nod());
            }
            let host = &hosts[self.below(3) as usize];
            let mut asks = host.clone();
            asks.seq = TcpSeqNumber(host.seq.0.wrapping_sub(1));
            // With a byte that the board has, or without.
            let byte = [b'x'; 1];
            let data = &byte[..self.below(2) as usize];
            let said = self
                .board
                .frame(&asks.segment(TcpControl::None, true, data));
            let answer = segment_of(&said[0]).expect("TCP");
            assert_eq!(answer.ack, Some(host.seq));
            assert!(answer.data.is_empty());
        }
        assert!(!Host::new(90).knocks(&mut self.board), "three at a time");
        // The limit counts from here for all of them.
        for host in hosts {
            self.board.frame(&host.nod());
        }
    }

    /// Segments in the names of these clients, with numbers near theirs and far away.
    fn forge(&mut self, hosts: &[Host; 3], way: Way) {
        let control = match way {
            Way::ForgedReset => TcpControl::Rst,
            Way::ForgedAck => [TcpControl::None, TcpControl::Psh][self.below(2) as usize],
            _ => return,
        };
        for host in hosts {
            let mut forged = host.clone();
            // Never the very numbers: those are the client's.
            let by = 1 + (self.below(i32::MAX as u32 - 1) >> self.below(31)) as i32;
            if self.below(2) == 0 || way == Way::ForgedReset {
                forged.seq = TcpSeqNumber(host.seq.0.wrapping_add(by));
            }
            if way == Way::ForgedAck {
                forged.ack = TcpSeqNumber(host.ack.0.wrapping_add(by));
            }
            let ack = way == Way::ForgedAck || self.below(2) == 0;
            let data = if control == TcpControl::Psh {
                &b"quit\n"[..]
            } else {
                b""
            };
            self.board.frame(&forged.segment(control, ack, data));
        }
    }

    /// Three clients come, and leave in this way.
    fn leave(&mut self, way: Way) -> [Host; 3] {
        let mut hosts = self.three(1);
        for host in &mut hosts {
            if way == Way::HalfOpen {
                assert!(host.knocks(&mut self.board), "a console is free");
                continue;
            }
            assert!(host.enters(&mut self.board), "a console is free");
            assert!(host.is_heard(&mut self.board));
        }
        match way {
            Way::KeepAlive => self.keep_alive(&hosts),
            Way::ZeroWindow => {
                for host in &mut hosts {
                    host.window = 0;
                    let line = host.segment(TcpControl::Psh, true, b"help\n");
                    self.board.frame(&line);
                }
            }
            Way::ForgedReset | Way::ForgedAck => {
                for _ in 0..20 {
                    self.forge(&hosts, way);
                }
                for host in &mut hosts {
                    assert!(host.is_heard(&mut self.board), "{way:?}: it was there");
                }
            }
            Way::Idle | Way::HalfOpen => {}
        }
        hosts
    }

    /// After how many milliseconds the next client gets in.
    fn free_after(&mut self, way: Way, gone: &[Host; 3]) -> u64 {
        let from = self.board.ms();
        loop {
            let passed = self.board.ms() - from;
            assert!(
                passed <= *way.free().end(),
                "{way:?}: {passed} ms, at {from} ms"
            );
            self.forge(gone, way);
            let [mut next, ..] = self.three(90);
            if next.enters(&mut self.board) && next.is_heard(&mut self.board) {
                next.leaves(&mut self.board);
                return passed;
            }
            let step = if way == Way::HalfOpen { 50 } else { 200 };
            self.board.wait_by(step, 50);
        }
    }
}

#[test]
fn through_24_hours_all_consoles_are_free_within_the_limit_of_each_way_to_leave_them() {
    let seed = 24;
    let mut day = Day {
        board: Board::new(),
        dice: seed,
        port: 0,
    };
    let mut spans: [Vec<u64>; WAYS.len()] = Default::default();
    while day.board.ms() < DAY_MS {
        let n = day.below(WAYS.len() as u32) as usize;
        let way = WAYS[n];
        let gone = day.leave(way);
        let passed = day.free_after(way, &gone);
        assert!(way.free().contains(&passed), "{way:?}: {passed} ms");
        spans[n].push(passed);
        // All three places are.
        day.board.wait_by(MORE_MS, 50);
        let mut all = day.three(40);
        for host in &mut all {
            assert!(host.enters(&mut day.board), "{way:?}: not all are free");
        }
        for host in &mut all {
            assert!(host.is_heard(&mut day.board) && host.leaves(&mut day.board));
        }
        let quiet = 1_000 + u64::from(day.below(200_000));
        day.board.wait_by(quiet, 500);
    }
    for (way, spans) in WAYS.iter().zip(spans) {
        let (least, most) = (spans.iter().min(), spans.iter().max());
        std::println!("{way:?}: {} times, {least:?} to {most:?} ms", spans.len());
        assert!(spans.len() >= 50, "{way:?}: {} times", spans.len());
    }
}
