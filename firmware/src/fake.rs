//! A board in memory for tests: it records what was written, and answers what the test prepared.

use crate::cores::*;
use crate::pass::Pass;
use crate::postmortem::Boot;
use crate::server::Server;
use crate::session::Peer;
use crate::{log, postmortem};
use std::collections::HashMap;
use std::vec::Vec;
use wire::describe::{Channels, FEATURE_JOBS};
use wire::etherbone::{HEADER, record};
use wire::exchange::{COMMAND_HEAD, Command, REQUEST_OVERHEAD, STATUS_MAX, Status, command_word};
use wire::flash::Layout;
use wire::images::Trailer;
use wire::pins::{Built, NONE, SOURCE};
use wire::regmap::{
    self, command, ident, pinmux_in, pinmux_out, segments, status, timebase, watchdog,
};
use wire::settings::{self, Settings};
use wire::{MAX_WORDS, Refusal, ResetReason, map};

pub const SIX: Channels = Channels {
    stepgens: 6,
    encoders: 6,
    pwms: 6,
    inputs: 12,
    outputs: 12,
};
pub const ALICE: Peer = Peer {
    ip: 0xc0a8_0201,
    port: 40_000,
};
pub const BOB: Peer = Peer {
    ip: 0xc0a8_0203,
    port: 1234,
};
pub const ABI: u32 = 0xab1a_b1ab;
pub const CLOCK: u32 = 60_000_000;
pub const BOOT: Boot = Boot {
    id: 9,
    reset: ResetReason::Requested,
};

/// Every change a machine could see.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    Strobe(u32),
    Feed(u32),
    Order(Control),
    Set(Setting, u32),
    Csr(u32, u32),
}

#[derive(Clone, Debug)]
pub struct Notebook {
    pub now: u64,
    pub staged: [u32; command::WORDS],
    pub live: [u32; command::WORDS],
    pub latched: [u32; status::WORDS],
    /// The status of the segments core.
    pub segments: u32,
    /// Registers that were read raw.
    pub asked: Vec<u32>,
    pub commit_at: u64,
    pub gate: u32,
    pub pin: bool,
    pub estop: bool,
    pub close: u32,
    pub led: Led,
    pub done: Vec<Change>,
    /// By the address of their register.
    settings: HashMap<usize, u32>,
    pub ring: log::Ring<64>,
    pub record: postmortem::Record,
    pub chip: Chip,
    pub trailer: [u32; 4],
    pub factory: bool,
    pub link: Link,
    /// Parts of its stack that were never used.
    pub free_stack: u32,
    /// The pass that is out.
    pub pass: Option<Pass>,
    /// A command was executed since the last pass.
    pub used: bool,
    /// The fast path's answer is on its way.
    pub sending: bool,
    /// Its transmit slot.
    pub slot: [u32; 128],
    /// The multiplexer of the pins.
    pub mux: Mux,
    /// The board information that was written.
    pub described: Vec<u32>,
}

/// The multiplexer of an image, as its registers show it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mux {
    /// Header lines, and the number of the platform.
    pub ident: (u32, u32),
    /// The words of the outputs, and those of the inputs.
    pub out: HashMap<usize, u32>,
    pub inputs: HashMap<usize, u32>,
    /// All words in the order they came, by address.
    pub log: Vec<(u32, u32)>,
    /// So many words are taken, then none.
    pub takes: Option<usize>,
    /// Looks until the last word is complete.
    looks: u32,
    refused: bool,
    /// The line of the factory pin is active.
    pub factory_line: bool,
}

impl Mux {
    /// The lines that are driven, and the route of each.
    pub fn driven(&self) -> Vec<(u8, u8)> {
        let word = |at: usize| self.out.get(&at).copied().unwrap_or(0);
        let drives = |line: u8| word(pinmux_out::DRIVES0 + usize::from(line / 32));
        let route = |line: u8| word(line as usize / 4).to_le_bytes()[line as usize % 4];
        let lines = (0..128u8).filter(|line| drives(*line) >> (line % 32) & 1 == 1);
        lines.map(|line| (line, route(line))).collect()
    }

    fn write(&mut self, address: u32, value: u32, open: bool) {
        assert_eq!(self.looks, 0, "{address:x} while a word is being written");
        self.looks = 3;
        self.refused = open || self.takes == Some(0);
        if self.refused {
            return;
        }
        self.takes = self.takes.map(|left| left - 1);
        self.log.push((address, value));
        let inputs = address as usize >= pinmux_in::BASE;
        let (base, words) = match inputs {
            true => (pinmux_in::BASE, &mut self.inputs),
            false => (pinmux_out::BASE, &mut self.out),
        };
        let word = (address as usize - base) / 4;
        let known = if inputs {
            pinmux_in::STATUS
        } else {
            pinmux_out::STATUS
        };
        assert!(word < known, "no word {word}");
        words.insert(word, value);
    }

    fn status(&mut self) -> u32 {
        self.looks = self.looks.saturating_sub(1);
        u32::from(self.looks == 0) | u32::from(self.refused) << 1
    }

    /// Is the factory pin active on the line that it was routed to?
    fn factory(&self, sink: u8) -> bool {
        let word = self.inputs.get(&usize::from(sink / 4));
        let route = word.map_or(NONE, |word| word.to_le_bytes()[usize::from(sink % 4)]);
        self.factory_line && route & SOURCE != NONE
    }
}

/// What the image of the tests has: 56 lines, 8 channels of each kind.
pub const EIGHT: Built = Built {
    stepgens: 8,
    encoders: 8,
    pwms: 8,
    lines: 56,
};

impl Notebook {
    pub fn new() -> Self {
        Notebook {
            now: 1_000,
            staged: [0; command::WORDS],
            live: [0; command::WORDS],
            latched: core::array::from_fn(|word| 0x1000 + word as u32),
            segments: 0,
            asked: Vec::new(),
            commit_at: 0,
            gate: 0,
            pin: false,
            estop: false,
            close: 0,
            led: Led::Off,
            done: Vec::new(),
            settings: HashMap::new(),
            ring: log::Ring::new(),
            record: postmortem::Record::EMPTY,
            chip: Chip::new(0x40_0000),
            trailer: [0; 4],
            factory: false,
            link: Link {
                status: 0b1101,
                errors: 0,
            },
            free_stack: 0,
            pass: None,
            used: false,
            sending: false,
            slot: [0; 128],
            mux: Mux::default(),
            described: Vec::new(),
        }
    }

    /// Number of changes that took effect; samples and staged words do not count.
    pub fn changes(&self) -> usize {
        self.done
            .iter()
            .filter(|change| **change != Change::Strobe(timebase::STROBE_SAMPLE))
            .count()
    }

    /// A command of the owner comes to the gateware. True if it is executed with the pass, as
    /// `fast_path.sv` does; if not, it is the firmware's.
    pub fn comes(&mut self, command: &Command) -> bool {
        let gate = self.gate();
        let mut buffer = [0; MAX_WORDS];
        let request = command.emit_request(SIX, &mut buffer).unwrap();
        let block = &request[REQUEST_OVERHEAD..];
        let (sequence, flags) = (block[command_word::SEQUENCE], block[command_word::FLAGS]);
        let like = |pass: &Pass| (pass.sequence, pass.flags, pass.gate) == (sequence, flags, gate);
        let Some(pass) = self.pass.filter(like) else {
            return false;
        };
        self.commit_at = u64::from(block[command_word::APPLY_HI]) << 32
            | u64::from(block[command_word::APPLY_LO]);
        self.staged[..4].copy_from_slice(&block[command_word::ENABLES..][..4]);
        self.staged[command::STEPGEN0_VELOCITY..][..12]
            .copy_from_slice(&block[COMMAND_HEAD..][..12]);
        self.staged[command::PWM0_WIDTH..][..6].copy_from_slice(&block[COMMAND_HEAD + 12..][..6]);
        self.strobe(match (pass.executes, pass.timed()) {
            (false, _) => timebase::STROBE_SAMPLE,
            (true, false) => timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE,
            (true, true) => timebase::STROBE_COMMIT_AT | timebase::STROBE_SAMPLE,
        });
        self.done.push(Change::Feed(sequence));
        (self.pass, self.used) = (None, true);
        true
    }

    pub fn bite(&mut self) {
        self.gate = 0b00_0100;
    }
}

/// Bite, external reset, e-stop.
const LATCHED: u32 = 0b0100_1100;

impl Board for Notebook {
    type Spi = Chip;

    fn spi(&mut self) -> &mut Chip {
        &mut self.chip
    }
    fn trailer(&mut self) -> [u32; 4] {
        self.trailer
    }
    fn factory_pin(&mut self) -> bool {
        self.factory || self.mux.factory(EIGHT.factory())
    }
    fn stack(&mut self, part: u32) -> Option<(u32, u32)> {
        (part >= self.free_stack).then_some((100, 100 + 2048 * self.free_stack))
    }
    fn link(&mut self) -> Link {
        self.link
    }
    fn now(&mut self) -> u64 {
        self.now
    }
    fn now_lo(&mut self) -> u32 {
        self.now as u32
    }
    fn arrival_lo(&mut self) -> u32 {
        self.now as u32
    }
    fn arrival_hi(&mut self) -> u32 {
        (self.now >> 32) as u32
    }
    fn stage(&mut self, word: usize, value: u32) {
        self.staged[word] = value;
    }
    fn staged(&mut self, word: usize) -> u32 {
        self.staged[word]
    }
    fn latched(&mut self, word: usize) -> u32 {
        self.latched[word]
    }
    fn commit_at(&mut self, at: u64) {
        self.commit_at = at;
    }
    fn strobe(&mut self, strobes: u32) {
        if strobes & timebase::STROBE_COMMIT != 0 {
            self.live = self.staged;
        }
        self.done.push(Change::Strobe(strobes));
    }
    fn watchdog_left(&mut self) -> u32 {
        300_000
    }
    fn feed(&mut self, token: u32) {
        self.done.push(Change::Feed(token));
    }
    fn hand_out(&mut self, pass: &Pass) {
        (self.pass, self.used) = (Some(*pass), false);
        for (word, value) in pass.answer() {
            self.slot[word] = value;
        }
    }
    fn revoke(&mut self) -> bool {
        self.pass = None;
        self.used
    }
    fn executed(&mut self) -> bool {
        self.used
    }
    fn sending(&mut self) -> bool {
        self.sending
    }
    fn prepared(&mut self, word: usize) -> u32 {
        self.slot[word]
    }
    fn gate(&mut self) -> Gate {
        // A pin closes the gate and latches; while it is active its second bit is up.
        if self.pin {
            self.gate = self.gate & !0b10_0011 | 0b1000;
        }
        if self.estop {
            self.gate = self.gate & !0b10_0011 | 0b100_0000;
        }
        Gate(self.gate | u32::from(self.pin) << 4 | u32::from(self.estop) << 7)
    }
    fn last_close(&mut self) -> u32 {
        self.close
    }
    fn control(&mut self, order: Control) {
        self.done.push(Change::Order(order));
        match order {
            Control::Arm if self.gate & LATCHED == 0 && !self.pin && !self.estop => {
                self.gate = Gate::LIVE.0;
            }
            Control::Arm => {}
            Control::SoftStop => self.gate |= 0b10,
            Control::Close => self.gate &= LATCHED,
            Control::Clear if !self.pin && !self.estop => self.gate &= !LATCHED,
            Control::Clear => {}
        }
    }
    fn setting(&mut self, which: Setting) -> u32 {
        self.settings.get(&which.address()).copied().unwrap_or(0)
    }
    fn set(&mut self, which: Setting, value: u32) {
        self.settings.insert(which.address(), value);
        self.done.push(Change::Set(which, value));
    }
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        let field = map::StepgenConfig::StopAccel;
        self.set(Setting::Stepgen(stepgen as u8, field), value);
    }
    fn csr_read(&mut self, address: u32) -> u32 {
        const OUT: u32 = regmap::address(pinmux_out::BASE, pinmux_out::STATUS);
        const IN: u32 = regmap::address(pinmux_in::BASE, pinmux_in::STATUS);
        const LINES: u32 = regmap::address(ident::BASE, ident::PINS);
        const PLATFORM: u32 = regmap::address(ident::BASE, ident::PLATFORM);
        match address {
            OUT | IN => return self.mux.status(),
            LINES => return self.mux.ident.0,
            PLATFORM => return self.mux.ident.1,
            _ => self.asked.push(address),
        }
        let word = |base: usize| (address as usize).wrapping_sub(base) / 4;
        if let Some(value) = self.latched.get(word(status::BASE)) {
            return *value;
        }
        match word(watchdog::BASE) {
            watchdog::STATUS => return self.gate().0,
            watchdog::LAST_CLOSE => return self.close,
            _ => {}
        }
        let status = regmap::address(segments::BASE, segments::STATUS);
        // The segments core reads idle by default.
        let state = if address == status { self.segments } else { 0 };
        address ^ 0x5555_0000 | state
    }
    fn csr_write(&mut self, address: u32, value: u32) {
        if address as usize >= pinmux_out::BASE {
            let open = self.gate().open();
            return self.mux.write(address, value, open);
        }
        self.settings.insert(address as usize, value);
        self.done.push(Change::Csr(address, value));
    }
    fn blob(&mut self, word: usize) -> u32 {
        let written = self.described.get(word).copied();
        written.unwrap_or(0xb10b_0000 + word as u32)
    }
    fn describe(&mut self, word: usize, value: u32) {
        match self.described.get_mut(word) {
            Some(place) => *place = value,
            None => {
                assert_eq!(word, self.described.len(), "in order");
                self.described.push(value);
            }
        }
    }
    fn led(&mut self, pattern: Led) {
        self.led = pattern;
    }
    fn log(&mut self, read: log::Read) -> u32 {
        self.ring.read(read)
    }
    fn panic(&mut self, offset: u32) -> u32 {
        self.record.word(offset)
    }
    fn rename_boot(&mut self, seed: u32) -> u32 {
        self.record.rename(seed)
    }
}

/// A flash chip, as detailed as a test of our own commands needs: it executes a command at once,
/// stays busy for a few polls, ANDs programmed bytes, and protects the upper quarter if commanded.
#[derive(Clone)]
pub struct Chip {
    pub cells: Vec<u8>,
    pub jedec: [u8; 3],
    pub uid: [u8; 8],
    pub status: u8,
    pub looks: u32,
    /// Ignores commands.
    pub stuck: bool,
    enabled: bool,
    pub writes: Vec<(u8, u32)>,
}

impl core::fmt::Debug for Chip {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Chip({:x?})", self.jedec)
    }
}

impl Chip {
    pub fn new(size: usize) -> Self {
        Chip {
            cells: vec![0xff; size],
            jedec: [0xef, 0x40, size.trailing_zeros() as u8],
            uid: [1, 2, 3, 4, 5, 6, 7, 8],
            status: 0,
            looks: 0,
            stuck: false,
            enabled: false,
            writes: Vec::new(),
        }
    }

    pub fn put(&mut self, at: u32, bytes: &[u8]) {
        self.cells[at as usize..][..bytes.len()].copy_from_slice(bytes);
    }

    fn change(&mut self, command: u8, at: usize, data: &[u8]) {
        let guarded = self.status & 0x7c != 0 && at >= self.cells.len() / 4 * 3;
        assert!(self.looks == 0, "told to {command:x} while busy");
        assert!(
            core::mem::take(&mut self.enabled),
            "{command:x} without write enable"
        );
        self.writes.push((command, at as u32));
        self.looks = 3;
        if self.stuck || guarded {
            return;
        }
        match command {
            0x01 => self.status = data[0],
            0x02 => {
                assert!(!data.is_empty() && at % 256 + data.len() <= 256);
                for (cell, byte) in self.cells[at..].iter_mut().zip(data) {
                    *cell &= byte;
                }
            }
            0x20 => self.cells[at & !0xfff..][..0x1000].fill(0xff),
            0xd8 => self.cells[at & !0xffff..][..0x10000].fill(0xff),
            _ => unreachable!(),
        }
    }
}

impl embedded_hal::spi::ErrorType for Chip {
    type Error = core::convert::Infallible;
}

impl embedded_hal::spi::SpiDevice for Chip {
    fn transaction(
        &mut self,
        operations: &mut [embedded_hal::spi::Operation<'_, u8>],
    ) -> Result<(), Self::Error> {
        use embedded_hal::spi::Operation;
        let mut sent = Vec::new();
        let mut read = 0;
        for operation in operations.iter_mut() {
            match operation {
                Operation::Write(bytes) => sent.extend_from_slice(bytes),
                Operation::Read(bytes) => {
                    let at = sent.get(1..4).map_or(0, |a| {
                        usize::from(a[0]) << 16 | usize::from(a[1]) << 8 | usize::from(a[2])
                    });
                    for byte in bytes.iter_mut() {
                        *byte = match sent[0] {
                            0x9f => self.jedec[read],
                            0x4b => self.uid[read],
                            0x05 => self.status | u8::from(self.looks > 0),
                            0x03 => self.cells[at + read],
                            other => panic!("read after {other:x}"),
                        };
                        read += 1;
                    }
                }
                _ => panic!("an operation the firmware does not use"),
            }
        }
        match *sent {
            [0x05] => self.looks = self.looks.saturating_sub(1),
            [0x06] => self.enabled = true,
            [0x01, status] => self.change(0x01, 0, &[status]),
            [command @ (0x02 | 0x20 | 0xd8), a, b, c, ref data @ ..] => {
                let at = usize::from(a) << 16 | usize::from(b) << 8 | usize::from(c);
                self.change(command, at, data);
            }
            _ => assert!(read > 0, "{sent:x?}"),
        }
        Ok(())
    }
}

/// A server on this board, and a host that talks to it.
#[derive(Clone, Debug)]
pub struct Rig {
    pub server: Server,
    pub board: Notebook,
    pub sequence: u32,
}

impl Rig {
    pub fn new() -> Self {
        Rig::with_abi(ABI)
    }

    pub fn with_abi(gateware: u32) -> Self {
        Rig::of(gateware, SIX, 0)
    }

    /// A board that can play segments.
    pub fn with_segments() -> Self {
        Rig::of(ABI, SIX, FEATURE_JOBS)
    }

    /// The same, with these settings in its flash.
    pub fn with_settings(settings: &Settings) -> Self {
        let mut board = Notebook::new();
        let mut bytes = [0; 4 * settings::WORDS];
        wire::words_to_bytes(&settings.to_words(), &mut bytes);
        let layout = Layout::of(board.chip.cells.len() as u32).expect("a size of boards");
        board.chip.put(layout.settings, &bytes);
        let mut rig = Rig::on(board, ABI, SIX, FEATURE_JOBS);
        let trailer = Trailer::from_words(rig.board.trailer);
        let (flash, chip) = (&mut rig.server.flash, &mut rig.board.chip);
        flash.find(chip, trailer);
        flash.start(chip, None, Settings::BUILT_IN, false);
        rig
    }

    /// A board of this build with these channels.
    pub fn with_channels(channels: Channels) -> Self {
        Rig::of(ABI, channels, 0)
    }

    fn of(gateware: u32, channels: Channels, features: u32) -> Self {
        Rig::on(Notebook::new(), gateware, channels, features)
    }

    fn on(board: Notebook, gateware: u32, channels: Channels, features: u32) -> Self {
        let ident = Ident {
            abi: gateware,
            version: 0x00_01_00,
            clock_hz: CLOCK,
            channels,
            features,
            blob_words: 3,
        };
        let mut rig = Rig {
            server: Server::new(ident, ABI, BOOT),
            board,
            sequence: 0,
        };
        rig.server.start(&mut rig.board);
        rig
    }

    pub fn send_as(&mut self, peer: Peer, words: &[u32]) -> Result<Vec<u32>, Refusal> {
        let mut reply = [0; MAX_WORDS];
        self.server
            .datagram(&mut self.board, words, peer, &mut reply)
            .map(<[u32]>::to_vec)
    }

    pub fn send(&mut self, words: &[u32]) -> Result<Vec<u32>, Refusal> {
        self.send_as(ALICE, words)
    }

    pub fn read_as(&mut self, peer: Peer, address: u32) -> Result<u32, Refusal> {
        let reply = self.send_as(peer, &[HEADER, 0, record(0, 1), 0x77, address])?;
        assert_eq!(reply[..4], [HEADER, 0, record(1, 0), 0x77]);
        Ok(reply[4])
    }

    pub fn read(&mut self, address: u32) -> Result<u32, Refusal> {
        self.read_as(ALICE, address)
    }

    pub fn write_as(&mut self, peer: Peer, address: u32, value: u32) -> Result<(), Refusal> {
        let reply = self.send_as(peer, &[HEADER, 0, record(1, 0), address, value])?;
        assert!(reply.is_empty(), "a write was answered");
        Ok(())
    }

    pub fn write(&mut self, address: u32, value: u32) -> Result<(), Refusal> {
        self.write_as(ALICE, address, value)
    }

    pub fn acquire(&mut self) -> u32 {
        self.write(map::SESSION_ACQUIRE, 7).unwrap();
        self.sequence = 0;
        self.read(map::SESSION_TOKEN).unwrap()
    }

    /// The next command, with Alice's token and everything enabled.
    pub fn command(&mut self, enable: bool, enable_request: bool) -> Command {
        self.sequence += 1;
        Command {
            token: self.server.session().token_for(ALICE),
            sequence: self.sequence,
            enable,
            enable_request,
            stepgen_enable: 0x3f,
            ..Command::default()
        }
    }

    pub fn exchange_as(&mut self, peer: Peer, command: &Command) -> Result<Status, Refusal> {
        let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
        let channels = self.server.ident().channels;
        let request = command.emit_request(channels, &mut buffer).unwrap();
        let reply = self.send_as(peer, request)?;
        assert!(reply.len() <= 4 + STATUS_MAX);
        Ok(Status::parse_reply(&reply, channels).unwrap())
    }

    pub fn exchange(&mut self, enable: bool, request: bool) -> Result<Status, Refusal> {
        let command = self.command(enable, request);
        self.exchange_as(ALICE, &command)
    }

    /// A machine armed by Alice.
    pub fn armed() -> Self {
        let mut rig = Rig::new();
        rig.arm();
        rig
    }

    pub fn arm(&mut self) {
        self.acquire();
        self.exchange(true, false).unwrap();
        self.exchange(true, true).unwrap();
        let status = self.exchange(true, true).unwrap();
        assert!(status.state.enabled, "{status:?}");
    }
}
