//! A board on the bench for the tests in this crate: the Verilated SoC with the release image, and
//! a host that speaks the protocol the way the driver does.
//!
//! [`BenchMachine`] arranges in one line what a test needs (started, acquired, armed) and asks one
//! thing at a time. `FERROCNC_SOC` and `FERROCNC_FIRMWARE`, set by `cargo xtask test`, name the
//! board and the image.

pub mod bench;
pub mod card;
pub mod drawing;
pub mod driver;
pub mod flash;
pub mod flood;
pub mod hal;
pub mod image;
pub mod lan;
pub mod mill;
pub mod pins;
pub mod plotter;
pub mod services;
mod simulator;
pub mod stops;
mod ways;
pub mod wired;

pub use sim::figures::report_part;
pub use sim::stimulus::{from_environment, seed};
pub use simulator::{Simulator, control};

use sim::edges;
use sim::firmware::Image;
use sim::lan_segment::{BOARD_PORT, Datagram, HOST_IP};
use sim::rig::{RIG_PORT, Setup};
use sim::soc::Silicon;
use sim::{Rig, exchange::Spread};
use std::path::PathBuf;
use wire::describe::{Channels, Describe, FEATURES_AT, JobsState};
use wire::exchange::{Command, Status};
use wire::refusal::COUNTERS_WAYS;
use wire::regmap::command;
use wire::state::State;
use wire::units::{Accel, Clocks, Velocity};
use wire::{LongWay, Refusal, map, regmap};

/// UDP port of a host that owns nothing.
pub const STRANGER: u16 = 50_505;

/// One servo period, as everywhere in LinuxCNC's examples.
const PERIOD_MS: u64 = 1;

/// Step timing of the armed machine, ns: an ordinary drive's.
const STEPLEN_NS: u64 = 1_000;
const STEPSPACE_NS: u64 = 1_000;
const DIRSETUP_NS: u64 = 2_000;
const DIRHOLD_NS: u64 = 2_000;
/// Deceleration of a soft stop, steps/s^2.
pub const STOP_ACCEL: f64 = 1e8;
/// Watchdog timeout, ns: five missed 1 kHz periods, hostmot2's default.
const WATCHDOG_NS: u64 = 5_000_000;
/// The services have been loaded long before that.
const LOADING_MS: u32 = 1000;
/// Longest soft stop, ns.
const GRACE_NS: u64 = 10_000_000;

/// A board with the release image, and the host that may own it.
pub struct BenchMachine {
    rig: Rig,
    describe: Describe,
    token: u32,
    sequence: u32,
    image: Image,
}

/// Exchanges since the start of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ways {
    /// Executed and answered by the gateware.
    pub fast: u32,
    /// By the firmware.
    pub long: u32,
    /// Why the last of these.
    pub why: LongWay,
}

/// A board and an image to run it with, from the environment.
pub fn parts() -> (PathBuf, PathBuf) {
    let from = |name: &str| {
        let value = std::env::var_os(name);
        PathBuf::from(
            value
                .unwrap_or_else(|| panic!("{name} is not set; run this as `cargo xtask test soc`")),
        )
    };
    (from("FERROCNC_SOC"), from("FERROCNC_FIRMWARE"))
}

/// The workspace's folder.
pub fn root() -> &'static std::path::Path {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the crate lies in the workspace")
}

/// A board's description of itself.
pub fn description<S: Silicon>(rig: &mut Rig<S>) -> Describe {
    let words = rig
        .read_block(map::DESCRIBE, wire::describe::WORDS as u32)
        .expect("the board describes itself");
    let words = words.try_into().expect("as many words as were asked for");
    Describe::parse(&words).unwrap_or_else(|error| panic!("{error}"))
}

/// Where pictures are left: in the folder `FERROCNC_REPORTS` says, else in `target/reports`.
pub fn reports() -> PathBuf {
    let folder = std::env::var_os("FERROCNC_REPORTS").map(PathBuf::from);
    folder.unwrap_or_else(|| root().join("target/reports"))
}

/// Writes figures to `NAME.json` in the folder `FERROCNC_REPORTS`, if that is set.
pub fn report(name: &str, figures: &serde_json::Value) {
    if let Some(folder) = std::env::var_os("FERROCNC_REPORTS") {
        let path = PathBuf::from(folder).join(format!("{name}.json"));
        let text = serde_json::to_string_pretty(figures).expect("figures are JSON");
        std::fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
}

/// Bytes from hexadecimal digits; spaces are for the reader.
pub fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text
        .chars()
        .filter_map(|c| c.to_digit(16))
        .map(|d| d as u8)
        .collect();
    digits
        .chunks(2)
        .map(|pair| pair[0] << 4 | pair[1])
        .collect()
}

/// Words as they lie on the wire.
pub fn to_bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

/// The whole words of what lay on the wire.
pub fn to_words(bytes: &[u8]) -> Vec<u32> {
    bytes
        .as_chunks::<4>()
        .0
        .iter()
        .map(|chunk| u32::from_be_bytes(*chunk))
        .collect()
}

/// What was asked while the services started is answered when they have; otherwise the next request
/// would take that for its answer.
pub fn take_late_answers(rig: &mut Rig, millis: u64) {
    rig.run_ms(millis);
    rig.take_datagrams();
}

/// Lets a board load its services, if it has some: it does while no host owns it.
pub fn wait_for_services(rig: &mut Rig) {
    let loading = |rig: &mut Rig| {
        let features = rig.read_word(map::DESCRIBE + 4 * FEATURES_AT as u32);
        features.is_none_or(|word| JobsState::of(word) == JobsState::Loading)
    };
    for _ in 0..LOADING_MS {
        if !loading(rig) {
            break;
        }
        rig.run_ms(1);
    }
}

impl BenchMachine {
    /// A board that has just started.
    pub fn start() -> Self {
        let (soc, firmware) = parts();
        Self::boot(Setup::new(&soc, &firmware))
    }

    /// A board set up like this that has just started.
    pub fn boot(setup: Setup) -> Self {
        let firmware = setup.firmware.clone();
        let mut rig = Rig::boot(setup).unwrap_or_else(|error| panic!("{error}"));
        let image = Image::read(&firmware, rig.board.silicon().rom_words())
            .unwrap_or_else(|error| panic!("{error}"));
        wait_for_services(&mut rig);
        take_late_answers(&mut rig, 2);
        let describe = description(&mut rig);
        BenchMachine {
            rig,
            describe,
            token: 0,
            sequence: 0,
            image,
        }
    }

    /// A board that is armed by us and moves nothing.
    pub fn armed() -> Self {
        let mut machine = Self::start();
        machine.make_ready();
        machine
    }

    /// An armed board with its first stepgen at `velocity` steps/s for so many servo periods.
    pub fn turning(velocity: f64, periods: u32) -> (Self, Command) {
        let mut machine = Self::armed();
        let mut command = machine.enabled_command();
        let velocity = Velocity::from_hz(velocity, machine.clock_hz());
        command.stepgen[0] = (velocity, Accel::UNLIMITED);
        for _ in 0..periods {
            machine.exchange_and_wait(&mut command);
        }
        (machine, command)
    }

    /// The board, its cable and the hosts on it.
    pub fn rig(&mut self) -> &mut Rig {
        &mut self.rig
    }

    /// Acquires, configures and arms.
    pub fn make_ready(&mut self) {
        self.acquire();
        self.configure();
        let mut command = self.enabled_command();
        self.rearm(&mut command);
    }

    /// Takes the session.
    pub fn acquire(&mut self) {
        self.write(map::SESSION_ACQUIRE, 0x1234_5678);
        self.token = self.read(map::SESSION_TOKEN);
        assert_ne!(self.token, 0, "the session was not granted");
        self.sequence = self.read(map::SESSION_LAST_SEQ);
    }

    /// Gives the session back. The machine should be at rest.
    pub fn release(&mut self) {
        self.write(map::SESSION_RELEASE, self.token);
    }

    /// Writes step timings and watchdog of an ordinary machine, and gives them to the check at the
    /// pins.
    pub fn configure(&mut self) {
        let clocks = |ns| Clocks::from_nanos_ceil(ns, self.describe.clock_hz).0;
        let timing = edges::Timing {
            steplen: clocks(STEPLEN_NS),
            stepspace: clocks(STEPSPACE_NS),
            dirsetup: clocks(DIRSETUP_NS),
            dirhold: clocks(DIRHOLD_NS),
        };
        let (timeout, grace) = (clocks(WATCHDOG_NS) as u32, clocks(GRACE_NS) as u32);
        let stop = Accel::from_steps(STOP_ACCEL, self.clock_hz());
        for n in 0..u32::from(self.describe.channels.stepgens) {
            let block = [
                timing.steplen,
                timing.stepspace,
                timing.dirsetup,
                timing.dirhold,
            ]
            .map(|c| c as u32);
            let base = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            self.rig.write_words(base, &block);
            self.rig
                .write_words(base + 4 * map::StepgenConfig::StopAccel as u32, &[stop.0]);
            self.rig.board.edges.set_timing(n as usize, timing);
        }
        self.rig.write_words(map::CONFIG_BOARD, &[timeout, grace]);
        assert_eq!(
            self.read(map::CONFIG_BOARD),
            timeout,
            "the watchdog's timeout was not taken"
        );
    }

    /// A command that allows motion and asks for none.
    pub fn enabled_command(&self) -> Command {
        Command {
            enable: true,
            enable_request: true,
            stepgen_enable: u16::MAX,
            ..Command::default()
        }
    }

    /// Asks to arm with a rising edge, and waits until it happened.
    pub fn rearm(&mut self, command: &mut Command) {
        for request in [false, false, true, true, true] {
            command.enable_request = request;
            self.exchange_and_wait(command);
        }
        let status = self.exchange_and_wait(command);
        assert_eq!(
            status.state.state,
            State::Armed,
            "arming failed: {:?}",
            status.state
        );
        assert!(self.gate_open());
    }

    /// All velocities are 0 from now on, and all axes come to rest. What was asked for is what was
    /// done: each axis has moved, and every pulse the board tells of was at the pins, in time.
    pub fn comes_to_rest(&mut self, command: &mut Command, what: &str) {
        for (velocity, _) in &mut command.stepgen {
            *velocity = Velocity(0);
        }
        for _ in 0..5 {
            self.exchange_and_wait(command);
        }
        let status = self.exchange_and_wait(command);
        for axis in 0..usize::from(self.channels().stepgens) {
            let told = status.stepgen[axis].0.pulses();
            assert_eq!(told, self.pulses(axis), "{what}: axis {axis}");
            assert!(self.edges(axis) > 0, "{what}: axis {axis} moved");
        }
        assert_eq!(self.timing_violations(), 0, "{what}");
    }

    // ---- datagrams ------------------------------------------------------------------------------

    /// Sends a datagram from our port and waits for its answer.
    pub fn ask(&mut self, datagram: &[u8]) -> Option<Vec<u8>> {
        self.ask_from(RIG_PORT, datagram)
    }

    /// Sends a datagram from this port and waits for its answer.
    pub fn ask_from(&mut self, port: u16, datagram: &[u8]) -> Option<Vec<u8>> {
        self.rig
            .request((HOST_IP, port), BOARD_PORT, datagram)
            .map(|reply| reply.payload)
    }

    /// As [`BenchMachine::ask`], in words.
    pub fn ask_words(&mut self, words: &[u32]) -> Option<Vec<u32>> {
        self.ask(&to_bytes(words)).map(|bytes| to_words(&bytes))
    }

    /// Sends datagrams with nothing but the inter-frame gap between them; all answers.
    pub fn ask_back_to_back(&mut self, datagrams: &[Vec<u8>]) -> Vec<Vec<u8>> {
        self.rig.take_datagrams();
        for datagram in datagrams {
            self.rig.post((HOST_IP, RIG_PORT), BOARD_PORT, datagram);
        }
        self.rig.run_ms(1);
        self.rig
            .take_datagrams()
            .into_iter()
            .map(|(datagram, _)| datagram.payload)
            .collect()
    }

    /// Sends a datagram and waits for nothing but the time to handle it.
    pub fn tell_from(&mut self, port: u16, datagram: &[u8]) {
        self.rig.post((HOST_IP, port), BOARD_PORT, datagram);
        self.rig.run(4_000);
        self.rig.take_datagrams();
    }

    /// Reads one word.
    pub fn read(&mut self, address: u32) -> u32 {
        self.rig
            .read_word(address)
            .unwrap_or_else(|| panic!("no answer to a read of {address:#010x}"))
    }

    /// Writes one word.
    pub fn write(&mut self, address: u32, value: u32) {
        self.rig.write_words(address, &[value]);
    }

    /// Everything a datagram could have changed: configuration, session, staged commands, gate.
    pub fn registers(&mut self) -> Vec<u32> {
        let mut addresses = vec![
            map::SESSION_OWNER_IP,
            map::SESSION_OWNER_PORT,
            map::SESSION_LAST_SEQ,
        ];
        let channels = self.describe.channels;
        let blocks = [
            (
                map::CONFIG_STEPGEN,
                u32::from(channels.stepgens),
                map::STEPGEN_CONFIG_WORDS,
            ),
            (
                map::CONFIG_PWM,
                u32::from(channels.pwms),
                map::PWM_CONFIG_WORDS,
            ),
            (
                map::CONFIG_ENCODER,
                u32::from(channels.encoders),
                map::ENCODER_CONFIG_WORDS,
            ),
            (map::CONFIG_BOARD, 1, map::BOARD_CONFIG_WORDS),
        ];
        for (base, count, words) in blocks {
            for n in 0..count {
                addresses.extend((0..words).map(|word| base + n * map::CONFIG_STRIDE + 4 * word));
            }
        }
        // The command bank as the bus sees it.
        addresses.extend((0..command::WORDS).map(|word| regmap::address(command::BASE, word)));
        let mut words = Vec::new();
        for chunk in addresses.chunks(64) {
            words.extend(self.rig.read_words(chunk).expect("an answer to a read"));
        }
        words.push(u32::from(self.gate_open()));
        words
    }

    /// How many datagrams were refused for this reason.
    pub fn refusals(&mut self, reason: Refusal) -> u32 {
        self.read(map::COUNTERS_REFUSED + 4 * reason.index() as u32)
    }

    /// Exchanges since the start by the way they took, read in one datagram.
    ///
    /// # Panics
    ///
    /// If there are more or fewer of them than the board says there were exchanges.
    pub fn ways(&mut self) -> Ways {
        let at = COUNTERS_WAYS;
        let words = self
            .rig
            .read_words(&[map::COUNTERS + 8, at, at + 4, at + 8])
            .expect("the counters");
        let [exchanges, fast, long, why] = words[..] else {
            panic!("four words were asked for");
        };
        assert_eq!(fast + long, exchanges, "{fast} fast, {long} long");
        let why = LongWay::from_code(why).expect("a known reason");
        Ways { fast, long, why }
    }

    /// Text of the last panic.
    pub fn panic_text(&mut self) -> String {
        let length = self.read(map::PANIC + 4).min(map::PANIC_TEXT_LEN);
        let words = self
            .rig
            .read_block(map::PANIC_TEXT, length.div_ceil(4))
            .expect("the panic text");
        String::from_utf8_lossy(&to_bytes(&words)[..length as usize]).into_owned()
    }

    // ---- the exchange ---------------------------------------------------------------------------

    /// A command as the bytes of its datagram, token and sequence number as they stand in it.
    pub fn command_bytes(&self, command: &Command) -> Vec<u8> {
        let mut buffer = [0; wire::MAX_WORDS];
        to_bytes(
            command
                .emit_request(self.describe.channels, &mut buffer)
                .expect("room for the request"),
        )
    }

    /// The same, with our token and the next sequence number.
    pub fn next_command_bytes(&mut self, command: &mut Command) -> Vec<u8> {
        self.sequence = self.sequence.wrapping_add(1);
        (command.token, command.sequence) = (self.token, self.sequence);
        self.command_bytes(command)
    }

    /// One exchange with the next sequence number.
    pub fn exchange(&mut self, command: &mut Command) -> Status {
        let bytes = self.next_command_bytes(command);
        let reply = self
            .rig
            .exchange(&bytes)
            .expect("an answer to the exchange");
        let status = Status::parse_reply(&reply.words(), self.describe.channels);
        let status =
            status.unwrap_or_else(|error| panic!("the status block is malformed: {error}"));
        assert_eq!(status.sequence, command.sequence);
        status
    }

    /// One exchange, then the rest of the servo period.
    pub fn exchange_and_wait(&mut self, command: &mut Command) -> Status {
        let end = self.clock() + self.rig.clocks(std::time::Duration::from_millis(PERIOD_MS));
        let status = self.exchange(command);
        self.rig.run(end.saturating_sub(self.clock()));
        status
    }

    /// Turnarounds of the last exchanges, clocks from the last request byte to the first reply
    /// byte.
    pub fn turnarounds(&self, last: usize) -> Vec<u32> {
        let all = &self.rig.meter.turnarounds;
        all[all.len().saturating_sub(last)..].to_vec()
    }

    /// Smallest, median and largest of [`BenchMachine::turnarounds`].
    pub fn turnaround_spread(&self, last: usize) -> Spread {
        Spread::of(&self.turnarounds(last)).unwrap_or_default()
    }

    /// Smallest, median and largest of the last exchanges from their first byte in to the last byte
    /// of the answer out, clocks.
    pub fn total_spread(&self, last: usize) -> Spread {
        let all = &self.rig.meter.totals;
        Spread::of(&all[all.len().saturating_sub(last)..]).unwrap_or_default()
    }

    // ---- time, pins, faults ---------------------------------------------------------------------

    /// Clocks since power-up.
    pub fn clock(&self) -> u64 {
        self.rig.clock()
    }

    /// The board's clock, Hz.
    pub fn clock_hz(&self) -> f64 {
        f64::from(self.describe.clock_hz)
    }

    /// What the board has.
    pub fn channels(&self) -> Channels {
        self.describe.channels
    }

    /// What it has besides the channels.
    pub fn features(&self) -> u32 {
        self.describe.features
    }

    /// Lets milliseconds of board time pass in silence.
    pub fn run_millis(&mut self, millis: u64) {
        self.rig.run_ms(millis);
    }

    /// Lets clocks pass in silence.
    pub fn run_clocks(&mut self, clocks: u64) {
        self.rig.run(clocks);
    }

    /// From now on this goes wrong; [`sim::faults`] says how it is said.
    pub fn trouble(&mut self, plan: &str) {
        let plan = plan
            .parse()
            .unwrap_or_else(|error| panic!("{plan}: {error}"));
        self.rig
            .trouble(&plan)
            .unwrap_or_else(|error| panic!("{error}"));
    }

    /// Pulses at an axis' pins, signed.
    pub fn pulses(&self, axis: usize) -> i64 {
        self.rig.board.edges.channel(axis).count
    }

    /// Pulses at an axis' pins, either way.
    pub fn edges(&self, axis: usize) -> u64 {
        self.rig.board.edges.channel(axis).pulses
    }

    /// When an axis' STEP last rose.
    pub fn last_step(&self, axis: usize) -> Option<u64> {
        self.rig.board.edges.channel(axis).last_rise
    }

    /// The first of them.
    pub fn broken_rules(&self) -> &[edges::Violation] {
        self.rig.board.edges.violations()
    }

    /// What is seen at the step generators' pins.
    pub fn edge_watch(&mut self) -> &mut edges::EdgeWatch {
        &mut self.rig.board.edges
    }

    /// Broken rules of step timing so far.
    pub fn timing_violations(&self) -> u64 {
        self.rig.board.edges.violation_count()
    }

    /// Clocks a soft stop from this command's velocity takes.
    pub fn soft_stop_clocks(&self, command: &Command, axis: usize) -> u64 {
        let velocity = command.stepgen[axis].0.to_hz(self.clock_hz()).abs();
        (velocity / STOP_ACCEL * self.clock_hz()).ceil() as u64
    }

    /// Whether outputs are live.
    pub fn gate_open(&self) -> bool {
        self.rig.pins().gate != 0
    }

    /// Levels at the general outputs.
    pub fn outputs(&self) -> u64 {
        self.rig.pins().gpio_out
    }

    /// Clocks a PWM pin is high in its present cycle; counted over one period of 12 000 clocks.
    pub fn pwm_high(&mut self, channel: usize) -> u32 {
        (0..12_000)
            .map(|_| {
                self.rig.run(1);
                u32::from(self.rig.pins().pwm_out >> channel & 1)
            })
            .sum()
    }

    /// Stops the CPU's clock; everything else runs on.
    pub fn freeze_cpu(&mut self) {
        self.rig.freeze_cpu(true);
    }

    /// Raises the external reset pin; how many clocks until the gate is closed and every output at
    /// its safe level.
    pub fn external_reset_until_safe(&mut self) -> u64 {
        let raised = self.clock();
        self.rig.ext_reset(true);
        while (self.gate_open() || self.outputs() != 0) && self.clock() < raised + 1000 {
            self.rig.run(1);
        }
        self.clock() - raised
    }

    /// Levels at the general inputs.
    pub fn inputs(&mut self, levels: u64) {
        self.rig.gpio_in(levels);
    }

    /// Puts these levels at the inputs; how many clocks until the gate is closed and every output
    /// at its safe level.
    pub fn inputs_until_safe(&mut self, levels: u64) -> u64 {
        let raised = self.clock();
        self.rig.gpio_in(levels);
        while (self.gate_open() || self.outputs() != 0) && self.clock() < raised + 1000 {
            self.rig.run(1);
        }
        self.clock() - raised
    }

    /// A bit flips in the instruction memory: the next discovery runs into an illegal instruction.
    /// Once the gate has closed the memory is as it was, as after a soft error. Not a ping: on a
    /// board with services that is theirs, and what traps in them closes no gate.
    pub fn trap_cpu(&mut self) {
        let mut broken = self.image.words.clone();
        let (start, end) = symbol(&parts().1, "9discovery4here");
        for word in &mut broken[start / 4..end / 4] {
            *word = 0;
        }
        self.rig.board.silicon().load_rom(&broken);
        let question = self.discovery(7);
        self.rig.take_datagrams();
        self.rig.inject_wire(question);
        self.run_millis(10);
        let told = self.rig.take_datagrams();
        let answers = |(it, _): &(Datagram, _)| it.from.1 == wire::DISCOVERY_PORT;
        assert!(!told.iter().any(answers), "a trapped CPU answers nothing");
        assert!(!self.gate_open(), "the trap must have closed the gate");
        let whole = self.image.words.clone();
        self.rig.board.silicon().load_rom(&whole);
    }

    /// Round trip of a ping in clocks.
    pub fn ping(&mut self) -> Option<u64> {
        self.rig.ping()
    }

    /// Pings with this payload. The frame that answers, or `None`.
    pub fn ping_with(&mut self, payload: &[u8]) -> Option<Vec<u8>> {
        self.rig.capture_frames();
        self.rig.take_frames();
        self.rig.ping_with(payload)?;
        self.rig.take_frames().pop()
    }

    /// One session on the console.
    pub fn console(&mut self, text: &str) -> String {
        self.rig
            .tcp_console(text)
            .unwrap_or_else(|error| panic!("{error}"))
    }

    /// Bytes of stack the board has ever used, as its console tells it.
    ///
    /// # Panics
    ///
    /// When the console does not tell.
    pub fn stack_used(&mut self) -> u32 {
        let heard = self.console("status\r\n");
        let mut lines = heard.lines().map(str::trim_start);
        let line = lines.find(|line| line.starts_with("stack"));
        let mut numbers = line
            .into_iter()
            .flat_map(|line| line.split(|c: char| !c.is_ascii_digit()));
        numbers
            .find_map(|digits| digits.parse().ok())
            .unwrap_or_else(|| panic!("no stack in {heard}"))
    }
}

/// Address range of the first function with `part` in its name.
pub fn symbol(elf: &std::path::Path, part: &str) -> (usize, usize) {
    use object::{Object, ObjectSymbol};
    let bytes = std::fs::read(elf).unwrap_or_else(|error| panic!("{}: {error}", elf.display()));
    let file =
        object::File::parse(&*bytes).unwrap_or_else(|error| panic!("{}: {error}", elf.display()));
    let found = file
        .symbols()
        .find(|s| s.size() > 0 && s.name().is_ok_and(|name| name.contains(part)));
    let found = found.unwrap_or_else(|| panic!("{} has no function {part}", elf.display()));
    (
        found.address() as usize,
        (found.address() + found.size()) as usize,
    )
}

/// The address of this symbol.
fn place(elf: &std::path::Path, name: &str) -> usize {
    use object::{Object, ObjectSymbol};
    let bytes = std::fs::read(elf).unwrap_or_else(|error| panic!("{}: {error}", elf.display()));
    let file =
        object::File::parse(&*bytes).unwrap_or_else(|error| panic!("{}: {error}", elf.display()));
    let found = file.symbols().find(|symbol| symbol.name() == Ok(name));
    let found = found.unwrap_or_else(|| panic!("{} has no {name}", elf.display()));
    found.address() as usize
}

/// A program of this workspace, built beside the tests, or in the folder `FERROCNC_PROGRAMS` names.
pub fn program(name: &str) -> PathBuf {
    let folder = std::env::var_os("FERROCNC_PROGRAMS").map(PathBuf::from);
    let built = || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/tests");
    folder.unwrap_or_else(built).join(name)
}
