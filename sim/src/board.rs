//! The board's two clocks, its GMII bytes and everything that watches or drives its pins, one
//! rising edge at a time.
//!
//! Time is counted in *ticks*, the largest unit of which both clock periods are whole multiples (at
//! 60 and 125 MHz: 2/3 ns, 25 ticks to a sys clock and 12 to an Ethernet clock), so the clocks
//! never drift. Callers use sys clocks.
//!
//! It handles frames as bytes with times; [`crate::lan_segment`] knows their contents.

use std::collections::VecDeque;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::environment::PinEnvironment;
use crate::error::Error;
use crate::gmii::{Collector, Feeder, Sent, Transfer};
use crate::plant::Plant;
use crate::soc::{ETH, SYS, Silicon};

/// The Ethernet clock of a gigabit PHY, one byte per cycle.
pub const ETH_CLK_HZ: u64 = 125_000_000;

/// How the two clocks divide time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clockwork {
    /// Frequency of the sys clock.
    pub sys_hz: u64,
    /// Ticks in a sys clock period.
    pub sys_period: u64,
    /// Ticks in an Ethernet clock period.
    pub eth_period: u64,
}

impl Clockwork {
    /// For a sys clock of `sys_hz`.
    pub fn new(sys_hz: u64) -> Self {
        let (mut a, mut b) = (sys_hz.max(1), ETH_CLK_HZ);
        while b != 0 {
            (a, b) = (b, a % b);
        }
        Clockwork {
            sys_hz: sys_hz.max(1),
            sys_period: ETH_CLK_HZ / a,
            eth_period: sys_hz.max(1) / a,
        }
    }

    /// Ticks in a second.
    pub fn tick_hz(&self) -> u64 {
        self.sys_period * self.sys_hz
    }

    /// Ticks as sys clocks, rounded up: a limit held by the rounded figure is held by the true one.
    pub fn clocks(&self, ticks: u64) -> u64 {
        ticks.div_ceil(self.sys_period)
    }

    /// Ticks as picoseconds.
    pub fn picoseconds(&self, ticks: u64) -> u64 {
        (u128::from(ticks) * 1_000_000_000_000 / u128::from(self.tick_hz())) as u64
    }

    /// Ticks as microseconds.
    pub fn microseconds(&self, ticks: u64) -> u64 {
        (u128::from(ticks) * 1_000_000 / u128::from(self.tick_hz())) as u64
    }

    /// Sys clocks in a number of nanoseconds, rounded to the nearest.
    pub fn clocks_in_ns(&self, ns: u64) -> u64 {
        ((u128::from(ns) * u128::from(self.sys_hz) + 500_000_000) / 1_000_000_000) as u64
    }
}

/// Why [`Board::run_until`] came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The requested time has passed.
    Time,
    /// The board finished sending a frame: see [`Board::take_transfer`].
    Frame,
}

/// When and where to write waveforms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TraceWindow {
    /// The file.
    pub path: PathBuf,
    /// First sys clock.
    pub from: u64,
    /// How many clocks.
    pub clocks: u64,
}

/// A board: silicon, clocks, and the environment at its pins.
#[derive(Debug)]
pub struct Board<S> {
    silicon: S,
    environment: PinEnvironment,
    clockwork: Clockwork,
    now: u64,
    next_sys: u64,
    next_eth: u64,
    clock: u64,
    /// The same time, for callbacks from inside the silicon.
    time: Arc<AtomicU64>,
    feeder: Feeder,
    collector: Collector,
    sent: VecDeque<Sent>,
    received: VecDeque<Transfer>,
    trace: Option<TraceWindow>,
    tracing: bool,
}

impl<S: Silicon> Board<S> {
    /// Put silicon on a board. Nothing runs yet; see [`Self::reset`].
    pub fn new(silicon: S, sys_hz: u64, plant: Plant) -> Self {
        let clockwork = Clockwork::new(sys_hz);
        Board {
            silicon,
            environment: PinEnvironment::new(plant, sys_hz),
            clockwork,
            now: 0,
            next_sys: clockwork.sys_period,
            next_eth: clockwork.eth_period,
            clock: 0,
            time: Arc::default(),
            feeder: Feeder::default(),
            collector: Collector::default(),
            sent: VecDeque::new(),
            received: VecDeque::new(),
            trace: None,
            tracing: false,
        }
    }

    /// Hold reset for 32 clocks; `prepare` gets the silicon after the first of them (the place to
    /// fill its ROM).
    pub fn reset(&mut self, prepare: impl FnOnce(&mut S)) {
        self.environment.pins.sys_rst = 1;
        self.run_until(self.clock + 1);
        prepare(&mut self.silicon);
        let end = self.clock + 31;
        while self.run_until(end) != Stop::Time {}
        self.environment.pins.sys_rst = 0;
    }

    /// The silicon itself.
    pub fn silicon(&mut self) -> &mut S {
        &mut self.silicon
    }

    /// Sys clocks since power-up.
    pub fn clock(&self) -> u64 {
        self.clock
    }

    /// A clock on the wall: sys clocks since power-up, for a device that the silicon calls while
    /// time passes.
    pub fn time(&self) -> Arc<AtomicU64> {
        self.time.clone()
    }

    /// Ticks since power-up.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// How time is divided.
    pub fn clockwork(&self) -> Clockwork {
        self.clockwork
    }

    /// Stop or start the CPU's clock; everything else runs on.
    pub fn freeze_cpu(&mut self, frozen: bool) {
        self.environment.pins.cpu_freeze = frozen.into();
    }

    /// Queue bytes for the board's receiver, preamble and FCS included ([`crate::gmii::encode`]).
    pub fn feed(&mut self, wire: Vec<u8>) -> u64 {
        self.feeder.push(wire)
    }

    /// Nothing is being received and nothing is queued.
    pub fn feeder_idle(&self) -> bool {
        self.feeder.idle()
    }

    /// A frame the receiver has been fed in full.
    pub fn take_sent(&mut self) -> Option<Sent> {
        self.sent.pop_front()
    }

    /// A frame the board has sent in full.
    pub fn take_transfer(&mut self) -> Option<Transfer> {
        self.received.pop_front()
    }

    /// Write waveforms of a window of time. Needs the SoC loaded with tracing.
    pub fn trace(&mut self, window: TraceWindow) {
        self.trace = Some(window);
    }

    /// Run to the sys clock `until`, but not past the end of a frame from the board.
    pub fn run_until(&mut self, until: u64) -> Stop {
        if self.trace.is_some() {
            return self.run_traced(until);
        }
        self.run_plain(until)
    }

    fn run_plain(&mut self, until: u64) -> Stop {
        while self.clock < until {
            if self.step() {
                return Stop::Frame;
            }
        }
        Stop::Time
    }

    fn run_traced(&mut self, until: u64) -> Stop {
        while self.clock < until {
            let Some(window) = &self.trace else {
                return self.run_plain(until);
            };
            let end = window.from + window.clocks;
            if !self.tracing && self.clock >= window.from {
                if let Err(e) = self.silicon.trace_open(&window.path) {
                    eprintln!("sim: {e}");
                    self.trace = None;
                    continue;
                }
                self.tracing = true;
            } else if self.tracing && self.clock >= end {
                self.silicon.trace_close();
                self.tracing = false;
                self.trace = None;
                continue;
            }
            let next = if self.tracing { end } else { window.from };
            if self.run_plain(until.min(next.max(self.clock + 1))) == Stop::Frame {
                return Stop::Frame;
            }
        }
        Stop::Time
    }

    /// One rising edge of whichever clock comes next, or of both. True when the board finished a
    /// frame.
    #[inline]
    fn step(&mut self) -> bool {
        let (sys, eth) = (
            self.next_sys <= self.next_eth,
            self.next_eth <= self.next_sys,
        );
        let mut clocks = 0;
        self.now = self.next_sys.min(self.next_eth);
        if sys {
            clocks |= SYS;
            self.next_sys += self.clockwork.sys_period;
        }
        if eth {
            clocks |= ETH;
            self.next_eth += self.clockwork.eth_period;
        }
        let time_ps = if self.tracing {
            self.clockwork.picoseconds(self.now)
        } else {
            0
        };
        self.silicon
            .rise(&mut self.environment.pins, clocks, time_ps);
        if sys {
            self.clock += 1;
            self.time.store(self.clock, Ordering::Relaxed);
            self.environment.observe(self.clock);
        }
        eth && self.after_eth()
    }

    #[inline]
    fn after_eth(&mut self) -> bool {
        if !self.feeder.idle() {
            self.sent.extend(self.feeder.edge(self.now));
            let byte = self.feeder.byte();
            self.environment.pins.gmii_rx_dv = byte.is_some().into();
            self.environment.pins.gmii_rx_data = byte.unwrap_or(0);
        }
        if self.environment.pins.gmii_tx_en != 0 || self.collector.active() {
            let done = self.collector.edge(
                self.now,
                self.environment.pins.gmii_tx_en != 0,
                self.environment.pins.gmii_tx_data,
            );
            if let Some(transfer) = done {
                self.received.push_back(transfer);
                return true;
            }
        }
        false
    }

    /// Finish waveforms and edge files.
    pub fn finish(&mut self) -> Result<u64, Error> {
        if self.tracing {
            self.silicon.trace_close();
            self.tracing = false;
            self.trace = None;
        }
        self.environment.edges.finish_recording()
    }
}

/// A board's pins are its environment's: `board.edges`, `board.plant`, `board.pins()`.
impl<S> Deref for Board<S> {
    type Target = PinEnvironment;

    fn deref(&self) -> &PinEnvironment {
        &self.environment
    }
}

impl<S> DerefMut for Board<S> {
    fn deref_mut(&mut self) -> &mut PinEnvironment {
        &mut self.environment
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::environment::Output;
    use crate::gmii::encode;
    use crate::soc::Pins;

    /// Silicon in Rust: sends every received byte back four Ethernet clocks later, steps channel 0
    /// every 10 sys clocks backward unless input 0 is high, shows input 1 at output 1, closes its
    /// gate on ext_reset, and counts a 7-of-20 PWM.
    #[derive(Debug, Default)]
    pub(crate) struct Toy {
        delay: [(u8, u8); 4],
        clock: u64,
        pub(crate) mute: bool,
    }

    impl Silicon for Toy {
        fn rise(&mut self, pins: &mut Pins, clocks: u32, _: u64) {
            if clocks & ETH != 0 {
                let out = self.delay[3];
                self.delay.rotate_right(1);
                self.delay[0] = (pins.gmii_rx_dv, pins.gmii_rx_data);
                (pins.gmii_tx_en, pins.gmii_tx_data) = if self.mute { (0, 0) } else { out };
            }
            if clocks & SYS != 0 {
                if pins.sys_rst != 0 {
                    self.clock = 0;
                    return;
                }
                self.clock += 1;
                pins.gate = u8::from(pins.ext_reset == 0);
                pins.dir = (!pins.gpio_in & 1) as u16;
                pins.step = u16::from(self.clock % 10 >= 5) & u16::from(pins.gate);
                pins.gpio_out = pins.gpio_in & 2;
                pins.pwm_out = u16::from(self.clock % 20 < 7) << 2;
            }
        }
    }

    fn board(hz: u64) -> Board<Toy> {
        let mut board = Board::new(Toy::default(), hz, Plant::direct(2));
        board.reset(|_| {});
        board
    }

    #[test]
    fn periods_are_whole_ticks() {
        assert_eq!(
            Clockwork::new(60_000_000),
            Clockwork {
                sys_hz: 60_000_000,
                sys_period: 25,
                eth_period: 12
            }
        );
        assert_eq!(
            Clockwork::new(50_000_000),
            Clockwork {
                sys_hz: 50_000_000,
                sys_period: 5,
                eth_period: 2
            }
        );
        let c = Clockwork::new(60_000_000);
        assert_eq!(
            (c.tick_hz(), c.clocks(25), c.clocks(26)),
            (1_500_000_000, 1, 2)
        );
        assert_eq!(
            (
                c.clocks_in_ns(1_000_000),
                c.microseconds(1_500_000),
                c.picoseconds(3)
            ),
            (60_000, 1000, 2000)
        );
    }

    #[test]
    fn both_clocks_keep_their_rates() {
        #[derive(Default)]
        struct Count(u64, u64);
        impl Silicon for Count {
            fn rise(&mut self, _: &mut Pins, clocks: u32, _: u64) {
                self.0 += u64::from(clocks & SYS != 0);
                self.1 += u64::from(clocks & ETH != 0);
            }
        }
        let mut board = Board::new(Count::default(), 60_000_000, Plant::default());
        assert_eq!(board.run_until(60_000), Stop::Time);
        assert_eq!((board.silicon().0, board.silicon().1), (60_000, 125_000));
    }

    #[test]
    fn a_frame_comes_back_with_its_times() {
        let mut board = board(60_000_000);
        let id = board.feed(encode(&[0xab; 80]));
        assert_eq!(board.run_until(10_000), Stop::Frame);
        let sent = board.take_sent().unwrap();
        let back = board.take_transfer().unwrap();
        assert_eq!(sent.id, id);
        assert_eq!(back.wire, encode(&[0xab; 80]));
        // Driven after one edge, taken by the next, out four later: five edges from the first byte
        // to its echo.
        assert_eq!(back.first - sent.first, 5 * 12);
        assert_eq!(back.last - back.first, (8 + 80 + 4) * 12);
        assert_eq!(board.run_until(20_000), Stop::Time);
    }

    #[test]
    fn pulses_at_pins_turn_the_encoder() {
        let mut board = board(60_000_000);
        board.gpio_in(1);
        board.run_until(32 + 1000);
        assert_eq!(board.edges.channel(0).count, 100);
        assert_eq!(board.plant.encoder_count(0), Some(100));
        board.gpio_in(0);
        board.run_until(32 + 1000 + 400);
        assert_eq!(board.edges.channel(0).count, 60);
        assert_eq!(board.plant.encoder_count(0), Some(60));
    }

    #[test]
    fn the_gate_is_logged_and_pwm_measured() {
        let mut board = board(60_000_000);
        board.run_until(100);
        board.ext_reset(true);
        board.run_until(200);
        let gates: Vec<_> = board
            .take_events()
            .iter()
            .map(|e| (e.output, e.level))
            .collect();
        assert_eq!(gates, [(Output::Gate, true), (Output::Gate, false)]);
        let cycle = board.pwm_cycle(2);
        assert_eq!((cycle.high, cycle.period), (Some(7), Some(20)));
        assert_eq!(board.edges.violations(), []);
    }

    #[test]
    fn wires_go_round_through_the_silicon() {
        let mut board = board(60_000_000);
        board.plant.add_wire(crate::plant::Wire {
            output: 1,
            input: 7,
            inverted: false,
        });
        board.settle();
        board.gpio_in(2);
        board.run_until(40);
        assert_eq!(board.pins().gpio_in, 2 | 1 << 7);
    }

    #[test]
    fn tracing_without_a_writer_only_complains() {
        let mut board = board(60_000_000);
        board.trace(TraceWindow {
            path: "none.fst".into(),
            from: 50,
            clocks: 10,
        });
        assert_eq!(board.run_until(100), Stop::Time);
        assert_eq!(board.clock(), 100);
    }
}
