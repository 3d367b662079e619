//! A board in process, for tests.
//!
//! Every call that waits for the board advances simulated time until the answer is out or a bounded
//! time has passed; nothing else moves time. So a test is a sequence of calls with exact clocks:
//!
//! ```no_run
//! # fn main() -> Result<(), sim::Error> {
//! let mut rig = sim::Rig::start("target/sim/mill6".as_ref(), "firmware.elf".as_ref())?;
//! let word = rig.read_word(wire::map::DESCRIBE);
//! rig.freeze_cpu(true);
//! rig.run_ms(10);
//! assert_eq!(rig.pins().gate, 0);
//! # Ok(()) }
//! ```

use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use wire::images::Trailer;
use wire::{MAX_WORDS, Request};

use crate::board::{Board, Stop, TraceWindow};
use crate::edges::Recorder;
use crate::error::Error;
use crate::exchange::{Meter, Timing, is_request};
use crate::faults::{Act, Cargo, Direction, Kind, OneWay, Plan, Script};
use crate::firmware::Image;
use crate::gmii::{self, Transfer};
use crate::lan_segment::{
    BOARD_IP, BOARD_PORT, CONSOLE_PORT, Connection, Datagram, Echo, Endpoint, HOST_IP, LanSegment,
};
use crate::nor::pins::Wires;
use crate::nor::spi::Shared;
use crate::plant::Plant;
use crate::plug::Plug;
use crate::report::{Counters, FrameCounts, Report, Seen};
use crate::soc::{LINK_1000, Manifest, Pins, SdramLines, Silicon, Soc};

pub use ::firmware::services::line_editor::PROMPT;

/// Source port of [`Rig::exchange`] and the register helpers.
pub const RIG_PORT: u16 = 39_999;

/// How to start a board. `Setup::new(..)` is right for most; change fields, then [`Rig::boot`].
#[derive(Clone, Debug)]
pub struct Setup {
    /// Directory of `libferrocnc_soc.so` and `manifest.json`.
    pub soc_dir: PathBuf,
    /// Firmware image.
    pub firmware: PathBuf,
    /// Address at which the board is expected.
    pub board_ip: Ipv4Addr,
    /// The machine at its pins.
    pub plant: Plant,
    /// The flash at its wires; without one there is no answer there.
    pub flash: Option<Shared>,
    /// The factory pin is held.
    pub factory: bool,
    /// What packing would have written at the end of the ROM.
    pub trailer: Trailer,
    /// Lines of the SDRAM that are shorted to ground; needs a board with one.
    pub shorted: SdramLines,
    /// What is wired to the headers of a card whose pins are configured.
    pub plug: Option<Plug>,
    /// Waveforms of a window of time.
    pub trace: Option<TraceWindow>,
    /// Longest wait for the first answer, sys clocks. 3 000 000 are 50 ms of board time: start-up
    /// is a few.
    pub boot_clocks: u64,
}

impl Setup {
    /// The firmware `elf` on the SoC in `soc_dir`, an encoder on every motor.
    pub fn new(soc_dir: &Path, elf: &Path) -> Self {
        Setup {
            soc_dir: soc_dir.into(),
            firmware: elf.into(),
            board_ip: BOARD_IP,
            plant: Plant::direct(16),
            flash: None,
            factory: false,
            trailer: Trailer::NONE,
            shorted: SdramLines::default(),
            plug: None,
            trace: None,
            boot_clocks: 3_000_000,
        }
    }
}

/// Datagrams without an answer, after which a host asks for the board's hardware address.
const SILENT: u32 = 10;

/// A frame on its way to the board, and the request in it if it is one.
#[derive(Clone, Debug)]
struct Outgoing {
    wire: Vec<u8>,
    request: Option<(Endpoint, Vec<u8>, usize)>,
}

impl Cargo for Outgoing {
    fn wire_bytes(&self) -> usize {
        self.wire.len()
    }
    fn damage(&mut self, bit: u64) -> bool {
        turn_over(&mut self.wire, bit)
    }
}

impl Cargo for Transfer {
    fn wire_bytes(&self) -> usize {
        self.wire.len()
    }
    fn damage(&mut self, bit: u64) -> bool {
        turn_over(&mut self.wire, bit)
    }
}

/// One bit after the preamble; without the preamble there would be no frame.
fn turn_over(wire: &mut [u8], bit: u64) -> bool {
    if let Some(frame) = wire.get_mut(gmii::PREAMBLE.len()..)
        && !frame.is_empty()
    {
        let bit = bit as usize % (8 * frame.len());
        frame[bit / 8] ^= 1 << (bit % 8);
    }
    true
}

/// A board's answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// The UDP payload.
    pub payload: Vec<u8>,
    /// How long it took; `None` when it fits no request.
    pub timing: Option<Timing>,
}

impl Reply {
    /// The payload as big-endian words; a ragged end is dropped.
    pub fn words(&self) -> Vec<u32> {
        self.payload
            .chunks_exact(4)
            .map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]))
            .collect()
    }
}

/// A board, its cable and the hosts on it.
#[derive(Debug)]
pub struct Rig<S = Soc> {
    /// The board, its pins, edges and plant.
    pub board: Board<S>,
    /// The virtual Ethernet.
    pub segment: LanSegment,
    /// Measurements of exchanges.
    pub meter: Meter,
    /// What is going wrong between host and board; see [`Rig::trouble`].
    pub faults: Script,
    to_board: OneWay<Outgoing>,
    from_board: OneWay<Transfer>,
    /// Frames passed.
    pub frames: FrameCounts,
    /// Longest wait for an answer, sys clocks; see [`Self::wait_for`]. The default is 60 000: a
    /// millisecond at 60 MHz.
    pub patience: u64,
    captured: Option<Vec<Vec<u8>>>,
    /// The hosts of [`Self::segment`] hear the board.
    hosts: bool,
    inbox: Vec<(Datagram, Option<Timing>)>,
    busy: Duration,
    busy_clocks: u64,
    next_poll: u64,
    ping_seq: u16,
    /// Frames the board had sent when it was asked, and how often it was since.
    unheard: (u64, u32),
}

impl Rig<Soc> {
    /// Start a board and wait until it answers. See [`Setup`] for more choices.
    pub fn start(soc_dir: &Path, elf: &Path) -> Result<Self, Error> {
        Self::boot(Setup::new(soc_dir, elf))
    }

    /// Start a board as `setup` says and wait until it answers UDP.
    pub fn boot(setup: Setup) -> Result<Self, Error> {
        let boot_clocks = setup.boot_clocks;
        let mut rig = Self::power_up(setup)?;
        rig.wait_ready(boot_clocks)?;
        Ok(rig)
    }

    /// Start a board and return as soon as its reset is over.
    pub fn power_up(setup: Setup) -> Result<Self, Error> {
        let manifest = Manifest::read(&setup.soc_dir)?;
        let mut soc = Soc::load(&setup.soc_dir, setup.trace.is_some())?;
        if let Some(plug) = setup.plug {
            soc.plug_in(Box::new(plug));
        }
        let rom_words = soc.rom_words();
        let mut image = Image::read(&setup.firmware, rom_words)?;
        if setup.trailer != Trailer::NONE {
            image.trailer(setup.trailer, rom_words);
        }
        let mut board = Board::new(soc, manifest.sys_clk_hz, setup.plant);
        board.factory(setup.factory);
        if let Some(flash) = setup.flash {
            let (time, clockwork) = (board.time(), board.clockwork());
            let mut wires = Wires::new(flash);
            let device = move |cs_n, sck, mosi| {
                let ticks = time.load(Ordering::Relaxed) * clockwork.sys_period;
                wires.set(clockwork.picoseconds(ticks) / 1000, cs_n, sck, mosi)
            };
            board.silicon().attach_spi(Box::new(device));
        }
        if let Some(window) = setup.trace {
            board.trace(window);
        }
        board.reset(|soc| {
            soc.load_rom(&image.words);
            let done = soc.short_sdram(setup.shorted);
            assert!(
                done || setup.shorted == SdramLines::default(),
                "there is no SDRAM"
            );
        });
        Ok(Self::around(board, setup.board_ip))
    }
}

impl<S: Silicon> Rig<S> {
    /// Plug a cable into a board that is out of reset.
    pub fn around(board: Board<S>, board_ip: Ipv4Addr) -> Self {
        Rig {
            faults: Script::new(board.clockwork().sys_hz),
            board,
            segment: LanSegment::new(board_ip),
            meter: Meter::default(),
            to_board: OneWay::new(Direction::ToBoard),
            from_board: OneWay::new(Direction::FromBoard),
            frames: FrameCounts::default(),
            patience: 60_000,
            captured: None,
            hosts: true,
            inbox: Vec::new(),
            busy: Duration::ZERO,
            busy_clocks: 0,
            next_poll: 0,
            ping_seq: 0,
            unheard: (0, 0),
        }
    }

    /// Ask the board for its address and then for its first describe word until it answers both.
    pub fn wait_ready(&mut self, clocks: u64) -> Result<(), Error> {
        let (end, frames) = (self.clock() + clocks, self.frames.from_board);
        // Ask every 20 000 clocks (a third of a millisecond): seldom enough not to fill the MAC of
        // a CPU still starting.
        let pause = 20_000;
        let mut asked = 0;
        while self.clock() < end {
            if self.segment.board_mac().is_none() {
                let frame = self.segment.arp_request(HOST_IP);
                self.inject_frame(&frame);
                let until = self.clock() + pause;
                self.run_while(until, |rig| rig.segment.board_mac().is_none());
                continue;
            }
            asked += 1;
            if self.read_word(wire::map::DESCRIBE).is_some() {
                // More questions may wait in the other receive slots. The firmware answers one, and
                // loads a piece of the services, in less than 40 000 clocks.
                let mut waits = asked > 1;
                while waits {
                    self.run(2 * pause);
                    waits = !self.take_datagrams().is_empty();
                }
                return Ok(());
            }
        }
        Err(Error::Silent {
            ip: self.segment.board_ip(),
            clocks,
            frames: self.frames.from_board - frames,
        })
    }

    // ---- time -----------------------------------------------------------------------------------

    /// Sys clocks since power-up.
    pub fn clock(&self) -> u64 {
        self.board.clock()
    }

    /// Let `clocks` sys clocks pass.
    pub fn run(&mut self, clocks: u64) {
        let until = self.clock() + clocks;
        self.run_while(until, |_| true);
    }

    /// Let milliseconds of board time pass.
    pub fn run_ms(&mut self, ms: u64) {
        self.run(self.clocks(Duration::from_millis(ms)));
    }

    /// A duration in sys clocks.
    pub fn clocks(&self, time: Duration) -> u64 {
        self.board.clockwork().clocks_in_ns(time.as_nanos() as u64)
    }

    /// Run to the sys clock `until`, or as long as `wanted` says after each frame; true when time
    /// ran out.
    pub fn run_while(&mut self, until: u64, mut wanted: impl FnMut(&mut Self) -> bool) -> bool {
        while self.clock() < until {
            if self.advance(until) && !wanted(self) {
                return false;
            }
        }
        true
    }

    /// Run to the sys clock `until` or to the end of the next frame from the board, whichever comes
    /// first, and let the segment do its work. True when something may have changed on the segment.
    pub fn advance(&mut self, until: u64) -> bool {
        self.flush();
        let tcp = self.segment.has_connections();
        // TCP timers are milliseconds; a poll each 1000 clocks is plenty.
        let until = if tcp {
            until.min(self.clock() + 1000)
        } else {
            until
        };
        let cable = self.to_board.next().min(self.from_board.next());
        let trouble = self.faults.next(self.clock()).min(cable);
        let until = until.min(trouble.max(self.clock() + 1));
        let (before, started) = (self.clock(), Instant::now());
        let stop = self.board.run_until(until);
        self.busy += started.elapsed();
        self.busy_clocks += self.clock() - before;
        while let Some(sent) = self.board.take_sent() {
            self.meter.sent(sent);
        }
        let now = self.clock();
        while let Some(transfer) = self.board.take_transfer() {
            self.frames.from_board += 1;
            self.from_board.enter(&mut self.faults, now, transfer);
        }
        if now >= trouble {
            self.suffer();
        }
        self.hand_over();
        let mut stop = stop;
        while let Some(transfer) = self.from_board.due(now) {
            stop = Stop::Frame;
            match gmii::decode(&transfer.wire) {
                Ok(frame) => {
                    if let Some(captured) = &mut self.captured {
                        captured.push(frame.to_vec());
                    }
                    if self.hosts {
                        self.segment.receive(frame, transfer.first, transfer.last);
                    }
                }
                Err(_) => self.frames.malformed_from_board += 1,
            }
        }
        if stop == Stop::Frame || (tcp && self.clock() >= self.next_poll) {
            self.next_poll = self.clock() + 1000;
            let clockwork = self.board.clockwork();
            self.segment.poll(clockwork.microseconds(self.board.now()));
            while let Some(mut datagram) = self.segment.take_datagram() {
                let from = Direction::FromBoard;
                self.faults.cut(from, now, &mut datagram.payload);
                let times = (datagram.first, datagram.last, datagram.wire_len);
                let timing = self
                    .meter
                    .reply(datagram.to, &datagram.payload, times, |ticks| {
                        clockwork.clocks(ticks)
                    });
                self.inbox.push((datagram, timing));
            }
            self.flush();
            return true;
        }
        false
    }

    /// Hands over the frames that have arrived by now; returns the number of the last one.
    fn hand_over(&mut self) -> Option<u64> {
        let mut last = None;
        while let Some(Outgoing { wire, request }) = self.to_board.due(self.board.clock()) {
            let id = self.inject_wire(wire);
            if let Some((from, payload, wire_len)) = request {
                self.meter.request(id, from, &payload, wire_len);
            }
            last = Some(id);
        }
        self.frames.dropped = self.faults.counts.lost;
        last
    }

    /// Applies the due faults of the board itself.
    fn suffer(&mut self) {
        while let Some(act) = self.faults.due(self.board.clock()) {
            match act {
                Act::Link(up) => self.board.link(if up { LINK_1000 } else { 0 }),
                Act::Freeze(frozen) => self.board.freeze_cpu(frozen),
                Act::Reboot(_) => self.reboot(),
            }
        }
    }

    /// Starts these faults now.
    pub fn trouble(&mut self, plan: &Plan) -> Result<(), String> {
        if plan.rules.iter().any(|rule| rule.kind == Kind::Power) {
            return Err("power: the Verilated board keeps its RAM; use reboot here, or power with --backend model".into());
        }
        self.faults.follow(plan, self.board.clock());
        self.suffer();
        Ok(())
    }

    /// The whole board restarts, as its reset makes it.
    pub fn reboot(&mut self) {
        self.board.reset(|_| {});
    }

    /// Frames of the segment's own stack go out.
    fn flush(&mut self) {
        while let Some(frame) = self.segment.take_frame() {
            self.inject_frame(&frame);
        }
    }

    /// Simulated sys clocks per second of the machine's time, in thousands, over everything run so
    /// far.
    pub fn kcycles_per_second(&self) -> f64 {
        self.busy_clocks as f64 / self.busy.as_secs_f64().max(1e-9) / 1e3
    }

    // ---- frames ---------------------------------------------------------------------------------

    /// Send a frame (destination MAC .. payload) to the board; preamble, padding and FCS are added.
    /// `None` when a fault lost it or made it late.
    pub fn inject_frame(&mut self, frame: &[u8]) -> Option<u64> {
        self.send(frame, None)
    }

    fn send(&mut self, frame: &[u8], request: Option<(Endpoint, Vec<u8>, usize)>) -> Option<u64> {
        let wire = gmii::encode(frame);
        let now = self.board.clock();
        let outgoing = Outgoing { wire, request };
        self.to_board.enter(&mut self.faults, now, outgoing);
        self.hand_over()
    }

    /// Send bytes exactly as given: the caller is the PHY. For runts, bad checksums and worse.
    pub fn inject_wire(&mut self, wire: Vec<u8>) -> u64 {
        self.frames.to_board += 1;
        self.board.feed(wire)
    }

    /// Keep every well-formed frame from the board from now on.
    pub fn capture_frames(&mut self) {
        self.captured.get_or_insert_default();
    }

    /// The cable ends with the caller: frames are kept, and the hosts of [`Self::segment`] do not
    /// hear them.
    pub fn unplug_hosts(&mut self) {
        self.capture_frames();
        self.hosts = false;
    }

    /// Did [`Self::unplug_hosts`] happen?
    pub fn unplugged(&self) -> bool {
        !self.hosts
    }

    /// The frames kept since the last call.
    pub fn take_frames(&mut self) -> Vec<Vec<u8>> {
        self.captured
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }

    // ---- UDP ------------------------------------------------------------------------------------

    /// As a PC's neighbour table does: a board that has been silent for [`SILENT`] datagrams is
    /// asked for its hardware address again, which another configuration may have changed.
    pub(crate) fn ask_again(&mut self) {
        let heard = self.frames.from_board;
        self.unheard = match self.unheard {
            (before, count) if before == heard => (heard, count + 1),
            _ => (heard, 0),
        };
        if self.unheard.1 > SILENT {
            self.unheard.1 = 0;
            let request = self.segment.arp_request(HOST_IP);
            self.inject_frame(&request);
        }
    }

    /// Put a datagram on the wire and return at once.
    pub fn post(&mut self, from: Endpoint, port: u16, payload: &[u8]) {
        let mut payload = payload.to_vec();
        let now = self.board.clock();
        self.faults.cut(Direction::ToBoard, now, &mut payload);
        let frame = self.segment.udp(from, port, &payload);
        let wire_len = frame.len().max(gmii::MIN_FRAME) + 8 + 4;
        self.send(&frame, Some((from, payload, wire_len)));
    }

    /// Put a broadcast datagram on the wire and return at once.
    pub fn broadcast(&mut self, from: Endpoint, port: u16, payload: &[u8]) {
        let frame = self.segment.broadcast(from, port, payload);
        self.inject_frame(&frame);
    }

    /// Datagrams from the board that were not yet taken.
    pub fn take_datagrams(&mut self) -> Vec<(Datagram, Option<Timing>)> {
        std::mem::take(&mut self.inbox)
    }

    /// Longest wait for the answer to `payload`: [`Self::patience`] and 200 clocks for each of its
    /// bytes, since a read of 255 words takes the firmware milliseconds by itself. An exchange is
    /// short and gets `patience` alone, because a wait without an answer must not make the watchdog
    /// bite.
    pub fn wait_for(&self, payload: &[u8]) -> u64 {
        self.patience
            + if is_request(payload) {
                0
            } else {
                200 * payload.len() as u64
            }
    }

    /// Send a datagram from any host and wait for the board's answer to it, at most
    /// [`Self::wait_for`] clocks.
    pub fn request(&mut self, from: Endpoint, port: u16, payload: &[u8]) -> Option<Reply> {
        self.inbox.retain(|(datagram, _)| datagram.to != from);
        self.post(from, port, payload);
        let until = self.clock() + self.wait_for(payload);
        self.run_while(until, |rig| {
            !rig.inbox.iter().any(|(datagram, _)| datagram.to == from)
        });
        let at = self
            .inbox
            .iter()
            .position(|(datagram, _)| datagram.to == from)?;
        let (datagram, timing) = self.inbox.remove(at);
        Some(Reply {
            payload: datagram.payload,
            timing,
        })
    }

    /// Send a payload to the board's Etherbone port from the default host's `src_port`; the payload
    /// of the answer.
    pub fn send_udp(&mut self, src_port: u16, payload: &[u8]) -> Option<Vec<u8>> {
        self.request((HOST_IP, src_port), BOARD_PORT, payload)
            .map(|reply| reply.payload)
    }

    /// One exchange (or any other Etherbone datagram), with its timing.
    pub fn exchange(&mut self, payload: &[u8]) -> Option<Reply> {
        self.request((HOST_IP, RIG_PORT), BOARD_PORT, payload)
    }

    /// One exchange as LinuxCNC makes it: send, take the reply, and let the rest of the servo
    /// period pass.
    pub fn servo_period(&mut self, payload: &[u8], period_clocks: u64) -> Option<Reply> {
        let end = self.clock() + period_clocks;
        let reply = self.exchange(payload);
        self.run_while(end, |_| true);
        reply
    }

    /// Read words over Etherbone, at most 255; `None` when the board does not answer as asked.
    pub fn read_words(&mut self, addresses: &[u32]) -> Option<Vec<u32>> {
        let mut words = [0; MAX_WORDS];
        let request = Request::new(&mut words).read(0, addresses).words()?;
        let reply = self.exchange(&bytes(request))?.words();
        // Packet header, record header, return base.
        (reply.len() == 4 + addresses.len()).then(|| reply[4..].to_vec())
    }

    /// Read one word over Etherbone.
    pub fn read_word(&mut self, address: u32) -> Option<u32> {
        self.read_words(&[address]).map(|words| words[0])
    }

    /// Read `count` consecutive words over Etherbone.
    pub fn read_block(&mut self, base: u32, count: u32) -> Option<Vec<u32>> {
        let mut words = Vec::new();
        while (words.len() as u32) < count {
            let at = words.len() as u32;
            let addresses: Vec<u32> = (at..count.min(at + 64)).map(|i| base + 4 * i).collect();
            words.extend(self.read_words(&addresses)?);
        }
        Some(words)
    }

    /// Read a block as a guest: at most [`wire::GUEST_READS`] words a datagram. A board with an
    /// owner that has fallen silent hands out one ticket every 3 ms, so each datagram waits longer
    /// than that. Any frame in between uses the ticket up, so a datagram without an answer is sent
    /// again, as every client does.
    pub fn read_block_as_guest(&mut self, base: u32, count: u32) -> Option<Vec<u32>> {
        const ATTEMPTS: usize = 4;
        let a_while = 4 * self.board.clockwork().sys_hz / 1000;
        let mut words = Vec::new();
        while (words.len() as u32) < count {
            let at = base + 4 * words.len() as u32;
            let some = (count - words.len() as u32).min(wire::GUEST_READS as u32);
            words.extend((0..ATTEMPTS).find_map(|_| {
                self.run(a_while);
                self.read_block(at, some)
            })?);
        }
        Some(words)
    }

    /// Write words over Etherbone (no answer is expected: writes have none), and give the board a
    /// tenth of a millisecond.
    pub fn write_words(&mut self, base: u32, values: &[u32]) {
        let mut words = [0; MAX_WORDS];
        let request = Request::new(&mut words).write(base, values).words();
        let request = request.expect("words for one record");
        self.post((HOST_IP, RIG_PORT), BOARD_PORT, &bytes(request));
        self.run(6000);
    }

    // ---- ICMP and TCP ---------------------------------------------------------------------------

    /// Ping the board; round trip in sys clocks, request's first byte to reply's first byte.
    pub fn ping(&mut self) -> Option<u64> {
        self.ping_with(b"FerroCNC")
    }

    /// The same with this payload, which the answer has to have.
    pub fn ping_with(&mut self, payload: &[u8]) -> Option<u64> {
        self.ping_seq += 1;
        let (ident, seq_no) = (0x4643, self.ping_seq);
        let frame = self.segment.echo_request(HOST_IP, ident, seq_no, payload);
        // Answers to earlier pings may still be queued.
        while self.segment.take_echo().is_some() {}
        let started = self.board.now();
        self.inject_frame(&frame);
        let mut answer = None;
        let until = self.clock() + self.patience;
        self.run_while(until, |rig| {
            let ours = |e: &Echo| (e.ident, e.seq_no, &e.payload[..]) == (ident, seq_no, payload);
            answer = std::iter::from_fn(|| rig.segment.take_echo()).find(ours);
            answer.is_none()
        });
        answer.map(|echo| self.board.clockwork().clocks(echo.first - started))
    }

    /// Run until a TCP connection to the board is up.
    pub fn tcp_connect(&mut self, port: u16) -> Result<Connection, Error> {
        let connection = self.segment.connect(port);
        self.next_poll = 0;
        let until = self.clock() + 20 * self.patience;
        while self.clock() < until && !self.segment.established(connection) {
            self.advance(until);
        }
        if self.segment.established(connection) {
            Ok(connection)
        } else {
            self.segment.drop_connection(connection);
            Err(Error::Tcp { port })
        }
    }

    /// Send text and gather what comes back until the board has been silent for 3 ms of its time
    /// (at most 50): it looks after TCP once a millisecond.
    pub fn tcp_talk(&mut self, connection: Connection, text: &str) -> String {
        self.tcp_talk_until(connection, text, 3, |_| false)
    }

    /// The same with a console, until it waits for a line: the answer to one line, or the greeting.
    pub fn tcp_say(&mut self, console: Connection, line: &str) -> String {
        let prompt = PROMPT.as_bytes();
        self.tcp_talk_until(console, line, 25, |heard| heard.ends_with(prompt))
    }

    /// The same with so many milliseconds of silence, or until `enough`.
    fn tcp_talk_until(
        &mut self,
        connection: Connection,
        text: &str,
        silence: u64,
        enough: impl Fn(&[u8]) -> bool,
    ) -> String {
        let mut out = text.as_bytes();
        let mut heard = Vec::new();
        let quiet = self.clocks(Duration::from_millis(silence));
        let end = self.clock() + self.clocks(Duration::from_millis(50));
        let mut last = self.clock();
        while self.clock() < end && self.clock() < last + quiet && !enough(&heard) {
            let sent = self.segment.send(connection, out);
            out = &out[sent..];
            self.next_poll = 0;
            self.advance(self.clock() + 500);
            let bytes = self.segment.recv(connection);
            if !bytes.is_empty() || !out.is_empty() {
                last = self.clock();
            }
            heard.extend(bytes);
        }
        String::from_utf8_lossy(&heard).into_owned()
    }

    /// One session on the debug console: connect, say `text`, return everything the board said,
    /// hang up. It is enough when there is a prompt behind each line; while a board has an owner
    /// that is silent, it looks after guests only once in 10 ms.
    pub fn tcp_console(&mut self, text: &str) -> Result<String, Error> {
        let connection = self.tcp_connect(CONSOLE_PORT)?;
        let prompts = 1 + text.matches('\n').count();
        let heard = self.tcp_talk_until(connection, text, 25, |heard| {
            String::from_utf8_lossy(heard).matches(PROMPT).count() >= prompts
        });
        self.segment.close(connection);
        self.run(self.clocks(Duration::from_millis(1)));
        self.segment.drop_connection(connection);
        Ok(heard)
    }

    // ---- pins -----------------------------------------------------------------------------------

    /// All pins as they stand.
    pub fn pins(&self) -> &Pins {
        self.board.pins()
    }

    /// Stop or start the CPU's clock.
    pub fn freeze_cpu(&mut self, frozen: bool) {
        self.board.freeze_cpu(frozen);
    }

    /// Drive the external reset pin.
    pub fn ext_reset(&mut self, high: bool) {
        self.board.ext_reset(high);
    }

    /// Drive the general inputs.
    pub fn gpio_in(&mut self, levels: u64) {
        self.board.gpio_in(levels);
    }

    /// Stream every step into a file; [`Self::finish`] closes it.
    pub fn record_edges(&mut self, path: &Path) -> Result<(), Error> {
        let recorder = Recorder::create(path, self.board.clockwork().sys_hz)?;
        self.board.edges.record(recorder);
        Ok(())
    }

    /// Close edge and waveform files.
    pub fn finish(&mut self) -> Result<u64, Error> {
        self.board.finish()
    }

    /// Everything worth reporting. Asks the board for its own counters, which takes a little
    /// simulated time; a board that is dead or frozen leaves them out.
    pub fn report(&mut self) -> Report {
        let own = match self.hosts {
            true => Counters::gather(|base, words| self.read_block_as_guest(base, words)),
            false => None,
        };
        Report::of(
            &Seen {
                backend: "rtl",
                environment: &self.board,
                clockwork: self.board.clockwork(),
                clocks: self.clock(),
                kcycles_per_second: self.kcycles_per_second(),
                meter: &self.meter,
                frames: self.frames,
            },
            own,
        )
    }
}

fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|w| w.to_be_bytes()).collect()
}

#[cfg(test)]
mod tests;
