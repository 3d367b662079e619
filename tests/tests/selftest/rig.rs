//! A board at a socket, with jumpers, and the clock of its host.

use ferrocnc_tests::flash::{CONFIGURATION, factory};
use host::address;
use host::client::{Client, ClientError, Identity};
use host::keys::Keys;
use host::selftest::loops::Loop;
use host::selftest::run::{Bench, PATIENCE, Plan, idle, run};
use host::selftest::{Finding, Report, Time, Verdict};
use sim::board_facts::BoardFacts;
use sim::model_board::Setup;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::plant::{Jumper, Plant, Sink, Source};
use sim::server::{Device, Service};
use sim::twin::Twin;
use std::collections::HashMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

pub use sim::model_board::UID;

/// Microseconds of board time in front of each datagram.
pub const BEFORE_EACH: u64 = 200;

/// A board at a socket. Dropping it ends its thread.
pub struct Board<D = Twin> {
    pub twin: Arc<Mutex<D>>,
    pub address: SocketAddr,
    pub stop: Arc<AtomicBool>,
    pub thread: Option<std::thread::JoinHandle<()>>,
    /// How fast the board's clock runs, of what it says.
    pub rate: f64,
    /// How long the host waits for one answer.
    pub patience: Duration,
}

pub fn jumper(from: Source, to: Sink) -> Jumper {
    Jumper {
        from,
        to,
        misses: 0,
    }
}

/// Step generator 0 in encoder 2, step generator 1's pins in two inputs, an output and a PWM in one
/// each.
pub fn jumpers() -> Vec<Jumper> {
    vec![
        jumper(Source::Step(0), Sink::A(2)),
        jumper(Source::Dir(0), Sink::B(2)),
        jumper(Source::Step(1), Sink::Input(0)),
        jumper(Source::Dir(1), Sink::Input(1)),
        jumper(Source::Output(3), Sink::Input(2)),
        jumper(Source::Pwm(4), Sink::Input(3)),
    ]
}

pub const LOOPS: [&str; 5] = [
    "sg-00=enc-02",
    "sg-01=in-00",
    "sg-01.dir=input.1",
    "output.3=in-02",
    "pwm-04=in-03",
];

pub fn nor() -> Nor {
    factory(Part::W25Q32JV.with(Times::QUICK), UID)
}

pub fn setup(nor: Nor, jumpers: &[Jumper]) -> Setup {
    let mut facts = BoardFacts::named(CONFIGURATION).expect("a committed board");
    facts.jobs = 3;
    let mut plant = Plant::default();
    for jumper in jumpers {
        plant.add_jumper(*jumper);
    }
    let mut setup = Setup::new(facts, plant);
    setup.flash = Shared::new(nor);
    setup
}

impl Board {
    pub fn start(setup: Setup) -> Self {
        Self::around(Twin::power_up(setup), BEFORE_EACH)
    }

    pub fn healthy() -> Self {
        Self::start(setup(nor(), &jumpers()))
    }

    pub fn with(jumpers: &[Jumper]) -> Self {
        Self::start(setup(nor(), jumpers))
    }
}

impl<D: Device + Send + 'static> Board<D> {
    pub fn around(device: D, before_each: u64) -> Self {
        let twin = Arc::new(Mutex::new(device));
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        let address = socket.local_addr().expect("its address");
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (twin, stop) = (Arc::clone(&twin), Arc::clone(&stop));
            move || pump(&socket, &twin, before_each, &stop)
        });
        let board = Board {
            twin,
            address,
            stop,
            thread: Some(thread),
            rate: 1.0,
            patience: PATIENCE,
        };
        // Whatever it does at start with its flash is over.
        pass(&mut *board.twin(), 20_000);
        board
    }

    pub fn twin(&self) -> MutexGuard<'_, D> {
        self.twin.lock().expect("the board's thread is well")
    }

    pub fn client(&self) -> Client {
        let address = address::parse(&self.address.to_string(), 0).expect("an address");
        Client::open(&address)
            .expect("a socket")
            .with_keys(Keys::default())
    }

    pub fn identity(&self) -> Identity {
        let mut client = self.client();
        let identity = client.identify().expect("a board");
        idle(&mut client, &identity).expect("at rest");
        identity
    }

    pub fn test(&self, outputs: bool, loops: &[&str]) -> Report {
        self.test_with(outputs, loops, Duration::from_secs(1), 200)
    }

    pub fn test_with(
        &self,
        outputs: bool,
        loops: &[&str],
        look: Duration,
        questions: u32,
    ) -> Report {
        let identity = self.identity();
        let parse = |text: &&str| Loop::parse(&identity, text).expect("a jumper");
        let plan = Plan {
            look,
            questions,
            flash_bytes: Some(4 << 20),
            outputs,
            loops: loops.iter().map(parse).collect(),
            steps: 200,
            patience: self.patience,
        };
        let connect = || Ok::<_, ClientError>(self.client());
        let mut time = BoardTime {
            twin: Arc::clone(&self.twin),
            rate: self.rate,
        };
        run(
            &identity,
            &plan,
            &mut Bench {
                connect: &connect,
                time: &mut time,
                tell: &|_| {},
            },
        )
    }
}

impl<D> Drop for Board<D> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

pub fn pass<D: Device>(twin: &mut D, microseconds: u64) {
    let end = twin.clock() + twin.clocks(Duration::from_micros(microseconds));
    while twin.clock() < end {
        twin.pass(end);
    }
}

/// Datagrams in, answers out; time passes in front of each datagram, and until its answer.
pub fn pump<D: Device>(socket: &UdpSocket, twin: &Mutex<D>, before_each: u64, stop: &AtomicBool) {
    socket
        .set_read_timeout(Some(Duration::from_millis(20)))
        .expect("a timeout");
    let (mut ports, mut buffer) = (HashMap::new(), [0; 2048]);
    while !stop.load(Ordering::Relaxed) {
        let Ok((length, from)) = socket.recv_from(&mut buffer) else {
            continue;
        };
        let payload = &buffer[..length];
        let next = 40_000 + ports.len() as u16;
        let port = *ports.entry(from).or_insert(next);
        let mut twin = twin.lock().expect("the test is well");
        pass(&mut *twin, before_each);
        twin.take_replies();
        twin.post(port, Service::Etherbone, payload);
        let end = twin.clock() + twin.wait_for(Service::Etherbone, payload);
        while twin.clock() < end && !twin.pass(end) {}
        let replies = twin.take_replies();
        if replies.is_empty() {
            // Such as giving the session back: done before the next client asks.
            pass(&mut *twin, 200);
        }
        for reply in replies {
            let _ = socket.send_to(&reply.payload, from);
        }
    }
}

/// The host's clock: the board's, which is `rate` times as fast as it says.
pub struct BoardTime<D> {
    pub twin: Arc<Mutex<D>>,
    pub rate: f64,
}

impl<D: Device> Time for BoardTime<D> {
    fn now(&mut self) -> Duration {
        let twin = self.twin.lock().expect("the board's thread is well");
        let hz = twin.clockwork().sys_hz as f64 * self.rate;
        Duration::from_secs_f64(twin.clock() as f64 / hz)
    }

    fn pause(&mut self, time: Duration) {
        let mut twin = self.twin.lock().expect("the board's thread is well");
        pass(&mut *twin, (time.as_secs_f64() * 1e6 * self.rate) as u64);
    }
}

/// Exactly these checks are bad, and each says this.
#[track_caller]
pub fn bad(report: &Report, expected: &[(&str, &str)]) {
    let bad = report.findings.iter().filter(|f| f.verdict == Verdict::Bad);
    let found: Vec<(&str, String)> = bad
        .map(|f| (f.check.as_str(), format!("{}; {}", f.fact, f.reason)))
        .collect();
    let checks: Vec<&str> = found.iter().map(|(check, _)| *check).collect();
    let wanted: Vec<&str> = expected.iter().map(|(check, _)| *check).collect();
    assert_eq!(checks, wanted, "{}", report.to_text());
    for ((check, said), (_, part)) in found.iter().zip(expected) {
        assert!(said.contains(part), "{check}: {said}");
    }
    for finding in &report.findings {
        let complete = finding.verdict != Verdict::Bad
            || (!finding.reason.is_empty() && !finding.remedy.is_empty());
        assert!(complete, "{finding:?}");
    }
}

pub fn finding<'r>(report: &'r Report, check: &str) -> &'r Finding {
    let found = report.findings.iter().find(|f| f.check == check);
    found.unwrap_or_else(|| panic!("no {check}: {}", report.to_text()))
}
