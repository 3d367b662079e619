//! A machine tool without LinuxCNC: the real driver with a HAL in a Vec, the twin, and between them
//! a socket with a fault injector for every datagram. A servo period takes some 50 us, and nothing
//! in it depends on the wall clock, so the same plan gives the same run every time.
//!
//! ```text
//!   Motion (position-cmd)  ->  host::Driver  ->  UDP on loopback  ->  sim::faults  ->  firmware  ->  cores  ->  pins
//!   following error        <-                <-                   <-               <-            <-
//! ```
//!
//! [`Owner`] is the same without the driver: a host that speaks the protocol itself, for commands
//! that the driver would not send, and for tests with a million exchanges.

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use host::address;
use host::client::{Client, ClientError};
use host::driver::Driver;
use host::fence::Fenced;
use host::hal::fake::FakeHal;
use host::link::Link;
use sim::board_facts::BoardFacts;
use sim::environment::{Output, PinEvent};
use sim::faults::Plan;
use sim::model_board::Setup;
use sim::plant::Plant;
use sim::server::{Device, Service};
use sim::twin::Twin;
use wire::describe::Channels;
use wire::exchange::{Command, Status};
use wire::units::{Accel, Velocity};
use wire::{Refusal, Request, etherbone, map};

/// A servo period, ns.
pub const PERIOD_NS: i64 = 1_000_000;
/// Steps per unit of every axis.
pub const SCALE: f64 = 1000.0;
/// Units/s^2 that Motion asks for, and what the stepgens may do: a tenth more, as is usual.
pub const MAX_ACCEL: f64 = 500.0;
/// Axes that move.
pub const AXES: [&str; 3] = ["x", "y", "z"];
/// Outputs that are on while the machine is: they must fall with the gate.
const OUTPUTS: [&str; 2] = [
    "ferrocnc.0.gpio.drive-enable.out",
    "ferrocnc.0.gpio.spindle-reverse.out",
];

/// The board of the mill.
pub fn facts() -> BoardFacts {
    BoardFacts::named("mill6").expect("a committed board")
}

/// What LinuxCNC's motion controller does, as far as a driver can tell: a commanded place that
/// moves with bounded velocity and acceleration while the machine is on, and follows the feedback
/// while it is off.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    on: bool,
    place: [f64; 3],
    velocity: [f64; 3],
    /// Units per second that are asked for.
    feed: [f64; 3],
    /// Back and forth around the place where it began: amplitude and period in seconds.
    swing: Option<([f64; 3], f64, u64)>,
    periods: u64,
    /// The largest distance between command and feedback while the machine was on, units.
    pub ferror: f64,
}

impl Motion {
    fn period(&mut self, enabled: bool, feedback: [f64; 3]) {
        self.periods += 1;
        if !enabled {
            *self = Motion {
                place: feedback,
                ferror: self.ferror,
                ..Motion::default()
            };
            return;
        }
        if !self.on {
            // One period late, as motion is.
            self.on = true;
            self.place = feedback;
            return;
        }
        for axis in 0..3 {
            let error = self.place[axis] - feedback[axis];
            self.ferror = self.ferror.max(error.abs());
            let wanted = match self.swing {
                Some((amplitude, seconds, began)) => {
                    let w = 2.0 * std::f64::consts::PI / seconds;
                    let t = (self.periods - began) as f64 * 1e-3;
                    amplitude[axis] * w * (w * t).sin()
                }
                None => self.feed[axis],
            };
            let reach = MAX_ACCEL * 1e-3;
            self.velocity[axis] += (wanted - self.velocity[axis]).clamp(-reach, reach);
            self.place[axis] += self.velocity[axis] * 1e-3;
        }
    }
}

/// Driver, cable, board.
pub struct Mill {
    driver: Option<Fenced>,
    /// What LinuxCNC would see.
    pub hal: FakeHal,
    /// The board.
    pub twin: Twin,
    /// What LinuxCNC's motion controller does.
    pub motion: Motion,
    socket: UdpSocket,
    end: u64,
    /// Does something to an answer on its way to the host.
    pub meddle: Option<fn(&mut Vec<u8>)>,
}

/// Serves a twin at a socket while a driver loads, for as long as that takes.
fn serve(twin: &mut Twin, socket: &UdpSocket, meddle: Option<fn(&mut Vec<u8>)>, done: &AtomicBool) {
    let mut buffer = [0; 2048];
    while !done.load(Ordering::Relaxed) {
        let Ok((length, from)) = socket.recv_from(&mut buffer) else {
            continue;
        };
        twin.post(from.port(), Service::Etherbone, &buffer[..length]);
        let until = twin.clock() + 3000;
        while twin.clock() < until && !twin.pass(until) {}
        deliver(twin, socket, meddle);
    }
}

fn deliver(twin: &mut Twin, socket: &UdpSocket, meddle: Option<fn(&mut Vec<u8>)>) {
    for mut reply in twin.take_replies() {
        if let Some(meddle) = meddle {
            meddle(&mut reply.payload);
        }
        // A host that is gone refuses it; a real board would not notice that either.
        let _ = socket.send_to(
            &reply.payload,
            SocketAddr::from(([127, 0, 0, 1], reply.port)),
        );
    }
}

impl Mill {
    /// A board that is switched on, without a driver.
    pub fn board(setup: Setup) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let wait = Some(Duration::from_millis(1));
        socket.set_read_timeout(wait).expect("a socket that waits");
        Mill {
            driver: None,
            hal: FakeHal::new(),
            twin: Twin::power_up(setup),
            motion: Motion::default(),
            socket,
            end: 0,
            meddle: None,
        }
    }

    /// A board with nothing wired to it but encoders on its motors.
    pub fn setup() -> Setup {
        Setup::new(facts(), Plant::direct(6))
    }

    /// As `loadrt` does it: look, check, take the session, export pins.
    pub fn load(&mut self) -> Result<(), ClientError> {
        let at = self.socket.local_addr().expect("its address");
        let address = address::parse(&at.to_string(), 1234).expect("an address");
        let (twin, socket, meddle) = (&mut self.twin, &self.socket, self.meddle);
        let done = AtomicBool::new(false);
        let mut hal = FakeHal::new();
        let loaded = std::thread::scope(|scope| {
            scope.spawn(|| serve(twin, socket, meddle, &done));
            let loaded = (|| {
                let mut client = Client::open(&address)?;
                let identity = client.identify()?;
                client.check(&identity)?;
                client.acquire()?;
                Ok((client, identity))
            })();
            done.store(true, Ordering::Relaxed);
            loaded
        });
        let (client, identity) = loaded?;
        let link = Link::new(client.into_socket()).expect("a link");
        let say = hal.messenger();
        let driver = Driver::export(&mut hal, 0, address, &identity, link, say);
        self.driver = Some(Fenced::new(driver.expect("pins"), hal.messenger()));
        self.hal = hal;
        self.settings();
        self.end = self.twin.clock();
        Ok(())
    }

    /// A HAL file's worth of `setp`.
    fn settings(&mut self) {
        // An answer that has not come by now never will: the board's time stands still while we
        // look.
        self.setp("packet-read-timeout", 100_000);
        for axis in AXES {
            self.setp(&format!("stepgen.{axis}.position-scale"), SCALE);
            self.setp(&format!("stepgen.{axis}.maxaccel"), 1.1 * MAX_ACCEL);
            for name in ["steplen", "stepspace"] {
                self.setp(&format!("stepgen.{axis}.{name}"), 1000u32);
            }
            for name in ["dirsetup", "dirhold"] {
                self.setp(&format!("stepgen.{axis}.{name}"), 2000u32);
            }
        }
    }

    /// A mill that is on and stands.
    pub fn on() -> Self {
        Self::on_with(Self::setup())
    }

    /// As [`Mill::on`], with this board.
    pub fn on_with(setup: Setup) -> Self {
        let mut mill = Self::board(setup);
        mill.load().unwrap_or_else(|error| panic!("{error}"));
        mill.switch_on();
        assert!(mill.enabled(), "{:?}", mill.hal.said());
        mill
    }

    /// A mill that cuts: x at 40, y at -25, z at 10 units/s, 40 000 steps a second and less.
    pub fn cutting() -> Self {
        let mut mill = Self::on();
        mill.feed([40.0, -25.0, 10.0]);
        mill.run(200);
        mill.nothing_is_wrong();
        mill
    }

    /// The operator's two switches. A rising edge of `enable-request` is a new one each time.
    pub fn switch_on(&mut self) {
        self.setp("enable", true);
        self.setp("enable-request", false);
        // A board that has just come back is asked for ten times a second.
        self.run(250);
        self.setp("enable-request", true);
        self.run(8);
    }

    /// Sets a pin or parameter of the board.
    pub fn setp<T: host::hal::Value>(&self, name: &str, value: T) {
        self.hal.set(&format!("ferrocnc.0.{name}"), value);
    }

    /// Reads one.
    pub fn getp<T: host::hal::Value>(&self, name: &str) -> T {
        self.hal.get(&format!("ferrocnc.0.{name}"))
    }

    /// LinuxCNC believes that the machine is on.
    pub fn enabled(&self) -> bool {
        self.getp("enabled")
    }

    /// Where LinuxCNC believes the axes to be, units.
    pub fn feedback(&self) -> [f64; 3] {
        AXES.map(|axis| self.getp(&format!("stepgen.{axis}.position-fb")))
    }

    /// What the board counts, pulses, as LinuxCNC sees it.
    pub fn counts(&self) -> [i32; 3] {
        AXES.map(|axis| self.getp(&format!("stepgen.{axis}.counts")))
    }

    /// What came out at the pins, pulses.
    pub fn pulses(&self) -> [i64; 3] {
        [0, 1, 2].map(|n| self.twin.environment().edges.channel(n).count)
    }

    /// Pulses either way: does anything move at all?
    pub fn motion_at_pins(&self) -> u64 {
        self.twin.environment().edges.pulses()
    }

    /// Outputs are live.
    pub fn gate(&self) -> bool {
        self.twin.environment().pins().gate != 0
    }

    /// Levels of the general outputs.
    pub fn outputs(&self) -> u64 {
        self.twin.environment().pins().gpio_out
    }

    /// All outputs are at their safe level.
    pub fn all_safe(&self) -> bool {
        let pins = self.twin.environment().pins();
        (pins.gate, pins.gpio_out, pins.pwm_out, pins.step) == (0, 0, 0, 0)
    }

    /// When the gate closed, of everything since the last call.
    pub fn closed_at(&mut self) -> Option<u64> {
        let events = self.twin.environment_mut().take_events();
        let closed = |event: &&PinEvent| event.output == Output::Gate && !event.level;
        events.iter().rfind(closed).map(|event| event.clock)
    }

    /// Units per second that the program asks for.
    pub fn feed(&mut self, feed: [f64; 3]) {
        self.motion.swing = None;
        self.motion.feed = feed;
    }

    /// A program without an end: back and forth, amplitudes in units, seconds for there and back.
    pub fn swing(&mut self, amplitude: [f64; 3], seconds: f64) {
        self.motion.swing = Some((amplitude, seconds, self.motion.periods));
    }

    /// From now on this goes wrong.
    pub fn trouble(&mut self, plan: &str) {
        let plan: Plan = plan.parse().unwrap_or_else(|error| panic!("{error}"));
        self.twin.trouble(&plan).expect("a twin can do all of it");
    }

    /// So many servo periods.
    pub fn run(&mut self, periods: u64) {
        for _ in 0..periods {
            self.period();
        }
    }

    /// One servo period: `read`, motion, `write`, and the board's millisecond.
    pub fn period(&mut self) {
        if let Some(driver) = &mut self.driver {
            driver.read(PERIOD_NS);
            let (enabled, feedback) = (self.enabled(), self.feedback());
            self.motion.period(enabled, feedback);
            for (n, axis) in AXES.iter().enumerate() {
                self.setp(&format!("stepgen.{axis}.enable"), self.motion.on);
                let place = self.motion.place[n];
                self.setp(&format!("stepgen.{axis}.position-cmd"), place);
            }
            for output in OUTPUTS {
                self.hal.set(output, self.motion.on);
            }
            if let Some(driver) = &mut self.driver {
                driver.write(PERIOD_NS);
            }
        }
        self.board_period();
    }

    /// The board's millisecond alone: the host does not come to its turn.
    pub fn board_period(&mut self) {
        self.socket.set_nonblocking(true).expect("a socket");
        let mut buffer = [0; 2048];
        while let Ok((length, from)) = self.socket.recv_from(&mut buffer) {
            self.twin
                .post(from.port(), Service::Etherbone, &buffer[..length]);
        }
        self.end = self.end.max(self.twin.clock())
            + self.twin.clocks(Duration::from_nanos(PERIOD_NS as u64));
        while self.twin.clock() < self.end {
            if self.twin.pass(self.end) {
                deliver(&mut self.twin, &self.socket, self.meddle);
            }
        }
        self.socket.set_nonblocking(false).expect("a socket");
    }

    /// LinuxCNC exits as it should.
    pub fn unload(&mut self) {
        if let Some(mut driver) = self.driver.take() {
            driver.release();
        }
    }

    /// LinuxCNC is killed.
    pub fn kill(&mut self) {
        self.driver = None;
    }

    /// Something in the servo thread does this to the driver.
    pub fn guard(&mut self, work: impl FnOnce(&mut Driver)) {
        if let Some(driver) = &mut self.driver {
            driver.guard(work);
        }
    }

    /// A datagram of another host, and the answer to it if there is one within a tenth of a
    /// millisecond.
    pub fn stranger(&mut self, port: u16, payload: &[u8]) -> Option<Vec<u8>> {
        self.twin.post(port, Service::Etherbone, payload);
        let until = self.twin.clock() + 6000;
        let mut answer = None;
        while self.twin.clock() < until {
            self.twin.pass(until);
            for reply in self.twin.take_replies() {
                if reply.port == port {
                    answer = Some(reply.payload);
                }
            }
        }
        answer
    }

    /// A word of the board, read by a host without the session.
    pub fn look(&mut self, address: u32) -> u32 {
        let request = words(&[etherbone::HEADER, 0, etherbone::record(0, 1), 0, address]);
        let answer = self
            .stranger(50_505, &request)
            .expect("every host may read");
        u32::from_be_bytes(answer[16..20].try_into().expect("a word"))
    }

    /// How many datagrams were refused for this reason.
    pub fn refusals(&mut self, reason: Refusal) -> u32 {
        self.look(map::COUNTERS_REFUSED + 4 * reason.index() as u32)
    }

    /// Must hold in every case: every pulse at the pins was legal, and while the machine is on its
    /// position is the reported one.
    pub fn nothing_is_wrong(&self) {
        let edges = &self.twin.environment().edges;
        assert_eq!(edges.violations(), [], "illegal pulses at the pins");
        assert!(
            self.enabled() && self.gate(),
            "it should be on: {:?}",
            self.hal.said()
        );
    }

    /// Stands, is off, all outputs safe, LinuxCNC knows.
    pub fn is_stopped_for_good(&mut self) {
        assert_eq!(
            self.twin.environment().edges.violations(),
            [],
            "illegal pulses at the pins"
        );
        assert!(!self.enabled(), "LinuxCNC believes it is on");
        assert!(
            self.all_safe(),
            "outputs are live: {:?}",
            self.twin.environment().pins()
        );
        let before = self.motion_at_pins();
        self.run(20);
        assert_eq!(self.motion_at_pins(), before, "it moves while it is off");
    }

    /// The machine is off, or on at the reported position.
    pub fn all_settled(&mut self) {
        self.feed([0.0; 3]);
        self.run(200);
        self.all_agree([0; 3]);
    }

    /// LinuxCNC, the board and the pins agree on where everything is.
    pub fn all_agree(&self, offset: [i64; 3]) {
        for (n, axis) in AXES.iter().enumerate() {
            let at_pins = self.pulses()[n] - offset[n];
            let feedback = self.feedback()[n] * SCALE;
            // Half a step is what a position between two steps may differ from a count.
            assert!(
                (feedback - at_pins as f64).abs() <= 1.0,
                "{axis}: LinuxCNC says {feedback} steps, the pins {at_pins}"
            );
        }
    }
}

/// Big-endian, as on the wire.
pub fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}

/// A host that speaks the protocol itself.
pub struct Owner {
    /// The board.
    pub twin: Twin,
    /// The next command; sequence and token are seen to.
    pub command: Command,
    channels: Channels,
    port: u16,
}

impl Owner {
    /// Of this board, with nothing acquired.
    pub fn of(twin: Twin) -> Self {
        Owner {
            twin,
            command: Command::default(),
            channels: facts().channels,
            port: 40_000,
        }
    }

    /// Armed, stands. Timeout and grace in clocks, the deceleration of a soft stop as the register
    /// has it.
    pub fn armed(twin: Twin, timeout: u32, grace: u32, stop: [Accel; 3]) -> Self {
        let mut owner = Self::of(twin);
        owner.write(map::SESSION_ACQUIRE, &[7]);
        owner.command.token = owner.read(map::SESSION_TOKEN);
        owner.command.sequence = owner.read(map::SESSION_LAST_SEQ);
        for (n, stop) in stop.iter().enumerate() {
            let at = map::CONFIG_STEPGEN + n as u32 * map::CONFIG_STRIDE;
            owner.write(at, &[60, 60, 120, 120, stop.0]);
        }
        owner.write(map::CONFIG_BOARD, &[timeout, grace]);
        let taken = [0, 4].map(|at| owner.read(map::CONFIG_BOARD + at));
        assert_eq!(
            taken,
            [timeout, grace],
            "the board did not take its watchdog's times"
        );
        owner.command.enable = true;
        owner.command.stepgen_enable = 0x3f;
        owner.rearm();
        owner
    }

    /// A rising edge.
    pub fn rearm(&mut self) {
        for request in [false, true, true] {
            self.command.enable_request = request;
            self.exchange().expect("an answer");
        }
        let status = self.exchange().expect("an answer");
        assert!(status.state.enabled, "{:?}", status.state);
    }

    /// What axis n is to do.
    pub fn velocity(&mut self, axis: usize, steps_per_second: f64, accel: Accel) {
        let hz = f64::from(facts().clock_hz);
        self.command.stepgen[axis] = (Velocity::from_hz(steps_per_second, hz), accel);
    }

    /// A datagram, and the answer if one comes before `until`.
    pub fn ask(&mut self, payload: &[u8]) -> Option<Vec<u8>> {
        self.twin.post(self.port, Service::Etherbone, payload);
        let until = self.twin.clock() + 3000;
        while self.twin.clock() < until && !self.twin.pass(until) {}
        self.twin.take_replies().pop().map(|reply| reply.payload)
    }

    /// A word of the board.
    pub fn read(&mut self, address: u32) -> u32 {
        let answer = self.ask(&words(&[
            etherbone::HEADER,
            0,
            etherbone::record(0, 1),
            0,
            address,
        ]));
        let answer = answer.expect("an answer to a read");
        u32::from_be_bytes(answer[16..20].try_into().expect("a word"))
    }

    /// Words into the board.
    pub fn write(&mut self, address: u32, values: &[u32]) {
        let mut buffer = [0; wire::MAX_WORDS];
        let request = Request::new(&mut buffer).write(address, values).words();
        assert_eq!(self.ask(&words(request.expect("room"))), None);
    }

    /// The command as it stands, as a datagram, with the next sequence number.
    pub fn request(&mut self) -> Vec<u8> {
        self.command.sequence = self.command.sequence.wrapping_add(1);
        let mut buffer = [0; wire::MAX_WORDS];
        words(
            self.command
                .emit_request(self.channels, &mut buffer)
                .expect("room"),
        )
    }

    /// One exchange, without the rest of the period.
    pub fn exchange_now(&mut self) -> Option<Status> {
        let request = self.request();
        let answer = self.ask(&request)?;
        let (chunks, _) = answer.as_chunks();
        let answer: Vec<u32> = chunks.iter().map(|c| u32::from_be_bytes(*c)).collect();
        Some(Status::parse_reply(&answer, self.channels).unwrap_or_else(|error| panic!("{error}")))
    }

    /// One exchange and the millisecond it is in.
    pub fn exchange(&mut self) -> Option<Status> {
        let end = self.twin.clock() + u64::from(facts().clock_hz) / 1000;
        let status = self.exchange_now();
        self.pass(end - self.twin.clock());
        status
    }

    /// Clocks pass.
    pub fn pass(&mut self, clocks: u64) {
        let end = self.twin.clock() + clocks;
        while self.twin.clock() < end {
            self.twin.pass(end);
        }
    }
}
