//! The self-test of a new board, on the twin: a healthy board is found healthy, and each defect is
//! found as itself. What the gateware does for it (pads, the Ethernet clock) on the Verilated board
//! as well, with the release image.
//!
//! The board is behind a real socket and its time passes with its datagrams only. The host's clock
//! is the board's times a rate the test chooses, so nothing here depends on this computer's clock
//! or on how busy it is.

use std::collections::HashMap;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use ferrocnc_tests::flash::{self, CONFIGURATION, factory};
use ferrocnc_tests::parts;
use host::address;
use host::client::{Client, ClientError, Identity};
use host::keys::Keys;
use host::selftest::loops::Loop;
use host::selftest::run::{Bench, PATIENCE, Plan, idle, run};
use host::selftest::{Finding, Report, Time, Verdict};
use sim::card::Card;
use sim::desk::Setup;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part, Times};
use sim::pads::{Fault, Pad};
use sim::plant::{Jumper, Plant, Sink, Source};
use sim::rig::{self, Rig};
use sim::server::{Device, Service};
use sim::twin::Twin;
use sim::world::Output;
use wire::map;
use wire::settings::{Settings, mac_of_uid};

const UID: u64 = 0xd162_0c8a_1b2c_3d4e;
/// Microseconds of board time in front of each datagram.
const BEFORE_EACH: u64 = 200;

/// A board behind a socket. Dropping it ends its thread.
struct Board<D = Twin> {
    twin: Arc<Mutex<D>>,
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
    /// How fast the board's clock runs, of what it says.
    rate: f64,
    /// How long the host waits for one answer.
    patience: Duration,
}

fn jumper(from: Source, to: Sink) -> Jumper {
    Jumper {
        from,
        to,
        misses: 0,
    }
}

/// Step generator 0 in encoder 2, step generator 1's pins in two inputs, an output and a PWM in one
/// each.
fn jumpers() -> Vec<Jumper> {
    vec![
        jumper(Source::Step(0), Sink::A(2)),
        jumper(Source::Dir(0), Sink::B(2)),
        jumper(Source::Step(1), Sink::Input(0)),
        jumper(Source::Dir(1), Sink::Input(1)),
        jumper(Source::Output(3), Sink::Input(2)),
        jumper(Source::Pwm(4), Sink::Input(3)),
    ]
}

const LOOPS: [&str; 5] = [
    "sg-00=enc-02",
    "sg-01=in-00",
    "sg-01.dir=input.1",
    "output.3=in-02",
    "pwm-04=in-03",
];

fn nor() -> Nor {
    factory(Part::W25Q32JV.with(Times::QUICK), UID)
}

fn setup(nor: Nor, jumpers: &[Jumper]) -> Setup {
    let mut card = Card::named(CONFIGURATION).expect("a committed board");
    card.jobs = 3;
    let mut plant = Plant::default();
    for jumper in jumpers {
        plant.add_jumper(*jumper);
    }
    let mut setup = Setup::new(card, plant);
    setup.flash = Shared::new(nor);
    setup
}

impl Board {
    fn start(setup: Setup) -> Self {
        Self::around(Twin::power_up(setup), BEFORE_EACH)
    }

    fn healthy() -> Self {
        Self::start(setup(nor(), &jumpers()))
    }

    fn with(jumpers: &[Jumper]) -> Self {
        Self::start(setup(nor(), jumpers))
    }
}

impl<D: Device + Send + 'static> Board<D> {
    fn around(device: D, before_each: u64) -> Self {
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

    fn twin(&self) -> MutexGuard<'_, D> {
        self.twin.lock().expect("the board's thread is well")
    }

    fn client(&self) -> Client {
        let address = address::parse(&self.address.to_string(), 0).expect("an address");
        Client::open(&address)
            .expect("a socket")
            .with_keys(Keys::default())
    }

    fn identity(&self) -> Identity {
        let mut client = self.client();
        let identity = client.identify().expect("a board");
        idle(&mut client, &identity).expect("at rest");
        identity
    }

    fn test(&self, outputs: bool, loops: &[&str]) -> Report {
        self.test_with(outputs, loops, Duration::from_secs(1), 200)
    }

    fn test_with(&self, outputs: bool, loops: &[&str], look: Duration, questions: u32) -> Report {
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

fn pass<D: Device>(twin: &mut D, microseconds: u64) {
    let end = twin.clock() + twin.clocks(Duration::from_micros(microseconds));
    while twin.clock() < end {
        twin.pass(end);
    }
}

/// Datagrams in, answers out; time passes in front of each datagram, and until its answer.
fn pump<D: Device>(socket: &UdpSocket, twin: &Mutex<D>, before_each: u64, stop: &AtomicBool) {
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
struct BoardTime<D> {
    twin: Arc<Mutex<D>>,
    rate: f64,
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
fn bad(report: &Report, expected: &[(&str, &str)]) {
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

#[test]
fn a_healthy_board_with_all_its_jumpers_is_found_healthy() {
    let board = Board::healthy();
    let report = board.test(true, &LOOPS);
    println!("{}", report.to_text());
    bad(&report, &[]);
    let good = |check: &str| {
        let of = |f: &&host::selftest::Finding| f.check == check;
        let finding = report.findings.iter().find(of);
        finding.unwrap_or_else(|| panic!("no {check}")).verdict == Verdict::Good
    };
    for check in [
        "gateware and firmware",
        "start",
        "gate",
        "flash",
        "flash slot A",
        "flash golden",
        "phy",
        "frames thrown away",
        "traffic",
        "system clock",
        "ethernet clock",
        "output pads",
        "output 0 out-00",
        "output stepgen 0 sg-00 STEP",
        "output stepgen 5 sg-05 DIR",
        "output pwm 4 pwm-04",
    ] {
        assert!(good(check), "{check}: {}", report.to_text());
    }
    for jumper in LOOPS {
        assert!(good(&format!("loop {jumper}")), "{}", report.to_text());
    }
    assert!(good("output 3 out-03"), "{}", report.to_text());
}

#[test]
fn an_input_that_follows_an_output_without_a_jumper_named_is_told() {
    let report = Board::healthy().test(true, &[]);
    bad(&report, &[]);
    let coupled = report
        .findings
        .iter()
        .find(|f| f.check == "output 3 out-03");
    let coupled = coupled.expect("output 3");
    assert_eq!(coupled.verdict, Verdict::Note);
    assert!(coupled.fact.contains("input 2 follows it"), "{coupled:?}");
}

#[test]
fn nothing_is_armed_that_was_not_asked_for() {
    let board = Board::healthy();
    let report = board.test(false, &[]);
    bad(&report, &[]);
    let mut twin = board.twin();
    let events = twin.world_mut().take_events();
    assert_eq!(events, [], "the gate stayed closed");
    assert_eq!(twin.world().edges.channel(0).count, 0);
}

#[test]
fn a_test_leaves_the_board_disarmed_free_and_set_as_it_was() {
    let board = Board::healthy();
    let settings: Vec<u32> = (0..8)
        .map(|n| map::CONFIG_STEPGEN + 4 * n)
        .chain((0..6).map(|n| map::CONFIG_ENCODER + n * map::CONFIG_STRIDE))
        .chain((0..5).map(|n| map::CONFIG_BOARD + 4 * n))
        .chain((0..11).map(|n| map::CONFIG_DEBOUNCE + 4 * n))
        .collect();
    let before = board.client().read(&settings).expect("settings");
    bad(&board.test(false, &LOOPS), &[]);
    let after = board.client().read(&settings).expect("settings");
    assert_eq!(before, after);
    let owner = board
        .client()
        .read(&[map::SESSION_OWNER_IP])
        .expect("an answer");
    assert_eq!(owner, [0]);
    let mut twin = board.twin();
    assert_eq!(twin.world_mut().pins().gate, 0);
    let gate = twin.world_mut().take_events();
    let opened = gate.iter().filter(|e| e.output == Output::Gate && e.level);
    assert_eq!(
        opened.count(),
        LOOPS.len(),
        "it was armed once for each part"
    );
    // Step generator 1 spoke quadrature: its pins rest where they are, and move when it speaks
    // steps again.
    let edges = &twin.world_mut().edges;
    let broken = edges.violations().iter().filter(|v| v.channel != 1);
    assert_eq!(broken.count(), 0, "{:?}", edges.violations());
    drop(twin);

    // The outputs are two parts: the general ones, and those of step generators and PWMs.
    bad(&board.test(true, &LOOPS), &[]);
    let after = board.client().read(&settings).expect("settings");
    assert_eq!(before, after);
    let mut twin = board.twin();
    let pins = *twin.world_mut().pins();
    assert_eq!((pins.gate, pins.pwm_out), (0, 0));
    let gate = twin.world_mut().take_events();
    let opened = gate.iter().filter(|e| e.output == Output::Gate && e.level);
    assert_eq!(opened.count(), 2 + LOOPS.len());
}

#[test]
fn a_report_holds_no_key_no_mac_and_no_unique_id() {
    let board = Board::healthy();
    let report = board.test(true, &LOOPS);
    let text = report.to_text() + &report.to_json().to_string();
    let text = text.to_lowercase();
    let bytes =
        |bytes: &[u8]| -> Vec<String> { bytes.iter().map(|b| format!("{b:02x}")).collect() };
    let mac = bytes(&mac_of_uid([(UID >> 32) as u32, UID as u32]));
    let uid = bytes(&UID.to_be_bytes());
    let ip = board.client().read(&[map::FLASH_IP]).expect("its address")[0];
    for secret in [
        mac.join(":"),
        mac.concat(),
        uid.concat(),
        "d162-0c8a".to_owned(),
        std::net::Ipv4Addr::from(ip).to_string(),
        "127.0.0.1".to_owned(),
    ] {
        assert!(!text.contains(&secret), "{secret}: {text}");
    }
}

#[test]
fn a_bad_sdram_is_found() {
    let mut setup = setup(nor(), &[]);
    setup.sdram = false;
    bad(
        &Board::start(setup).test(false, &[]),
        &[("sdram", "failed its test")],
    );
}

#[test]
fn a_flash_that_is_not_there_or_of_another_kind_is_found() {
    for (jedec, said) in [
        ([0xff, 0xff, 0xff], "no flash answers"),
        ([0, 0, 0], "no flash answers"),
        ([0xef, 0x40, 0x18], "of an unknown kind"),
        ([0xef, 0x40, 0x15], "this platform has 4 MiB"),
    ] {
        let mut nor = nor();
        if jedec == [0xef, 0x40, 0x15] {
            nor = factory(Part::W25Q16JV.with(Times::QUICK), UID);
        } else {
            let part = Part {
                jedec,
                ..Part::W25Q32JV.with(Times::QUICK)
            };
            let cells = nor.cells().to_vec();
            nor = Nor::new(part, UID);
            nor.preload(0, &cells);
        }
        let report = Board::start(setup(nor, &[])).test(false, &[]);
        bad(&report, &[("flash", said)]);
    }
}

#[test]
fn a_bit_that_fell_over_in_an_image_is_found() {
    let mut nor = nor();
    let golden = flash::layout(&nor).golden.start as usize;
    let byte = nor.cells()[golden + 100] ^ 4;
    nor.preload(golden + 100, &[byte]);
    let report = Board::start(setup(nor, &[])).test(false, &[]);
    bad(&report, &[("flash golden", "its meta page says")]);

    // In the selected one, the FPGA has found it first.
    let mut nor = self::nor();
    let slot = flash::layout(&nor).slot_a.start as usize;
    let byte = nor.cells()[slot + 100] ^ 4;
    nor.preload(slot + 100, &[byte]);
    let report = Board::start(setup(nor, &[])).test(false, &[]);
    let expected = [
        ("flash image that runs", "did not load"),
        ("flash slot A", "its meta page says"),
    ];
    bad(&report, &expected);
}

#[test]
fn a_cable_that_loses_or_damages_frames_is_found() {
    let trouble = |words: &str| {
        let board = Board::healthy();
        let identity = board.identity();
        drop(identity);
        let plan = words.parse().expect("a plan");
        board.twin().trouble(&plan).expect("trouble");
        board.test(false, &[])
    };
    let lost = trouble("from-board:loss=2% seed=7");
    bad(&lost, &[("traffic", "were lost")]);
    let damaged = trouble("to-board:corrupt=2% seed=7");
    bad(
        &damaged,
        &[
            ("frames thrown away", "MAC damaged"),
            ("traffic", "were lost"),
        ],
    );
}

#[test]
fn a_clock_with_the_wrong_crystal_is_found_and_one_with_a_tolerable_one_is_not() {
    let clock = |rate| {
        let mut board = Board::healthy();
        board.rate = rate;
        board.test(false, &[])
    };
    bad(&clock(1.0001), &[]);
    bad(
        &clock(0.8),
        &[("system clock", "another crystal or divider")],
    );
    bad(
        &clock(1.04),
        &[("system clock", "another crystal or divider")],
    );
}

#[test]
fn an_output_that_is_stuck_and_a_jumper_that_is_missing_are_found() {
    let mut stuck = jumpers();
    stuck[4].from = Source::Stuck(true);
    let report = Board::with(&stuck).test(false, &LOOPS);
    bad(&report, &[("loop output.3=in-02", "stays high")]);
    stuck[4].from = Source::Stuck(false);
    let report = Board::with(&stuck).test(false, &LOOPS);
    bad(&report, &[("loop output.3=in-02", "stays low")]);

    let missing = &jumpers()[2..];
    let report = Board::with(missing).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "no pulse arrives")]);

    // Only STEP is there: no pulse is lost, and that DIR is not seen is said.
    let mut alone = jumpers();
    alone[1].from = Source::Stuck(false);
    let report = Board::with(&alone).test(false, &LOOPS[..1]);
    bad(&report, &[]);
    let said = report.to_text();
    assert!(said.contains("DIR does not arrive at B"), "{said}");
}

#[test]
fn crossed_jumpers_are_found() {
    let mut crossed = jumpers();
    (crossed[4].to, crossed[5].to) = (crossed[5].to, crossed[4].to);
    let report = Board::with(&crossed).test(false, &LOOPS[3..]);
    let expected = [
        ("loop output.3=in-02", "at input 3 instead"),
        ("loop pwm-04=in-03", "at input 2 instead"),
    ];
    bad(&report, &expected);

    let mut other = jumpers();
    (other[0].to, other[1].to) = (Sink::A(5), Sink::B(5));
    let report = Board::with(&other).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "encoder 5 counted")]);

    let mut turned = jumpers();
    (turned[0].to, turned[1].to) = (Sink::B(2), Sink::A(2));
    let report = Board::with(&turned).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "STEP arrives at B")]);
}

#[test]
fn an_encoder_that_misses_steps_is_found() {
    let mut weak = jumpers();
    weak[0].misses = 50;
    let report = Board::with(&weak).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "steps are missing")]);
}

#[test]
fn a_board_held_by_its_external_reset_is_not_driven_and_says_so() {
    let board = Board::healthy();
    board.twin().world_mut().ext_reset(true);
    let report = board.test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "external reset")]);
}

#[test]
fn a_board_that_falls_silent_leaves_a_report_of_what_was_seen_before() {
    let board = Board::healthy();
    let identity = board.identity();
    board.twin().freeze_cpu(true);
    let connect = || Ok::<_, ClientError>(board.client().with_patience(Duration::from_millis(400)));
    let mut time = BoardTime {
        twin: Arc::clone(&board.twin),
        rate: 1.0,
    };
    let report = run(
        &identity,
        &Plan::default(),
        &mut Bench {
            connect: &connect,
            time: &mut time,
            tell: &|_| {},
        },
    );
    bad(&report, &[("answers", "stopped answering")]);
    let text = report.to_text();
    assert!(
        text.contains("configuration") && !text.contains("127.0.0.1"),
        "{text}"
    );
}

#[test]
fn a_board_with_a_key_that_is_not_here_is_looked_at_and_not_driven() {
    let mut nor = nor();
    let settings = Settings {
        sequence: 1,
        key: [1, 2, 3, 4],
        ..Settings::default()
    };
    let at = flash::layout(&nor).settings as usize;
    nor.preload(at, &ferrocnc_tests::to_bytes(&settings.to_words()));
    let report = Board::start(setup(nor, &jumpers())).test(false, &LOOPS[..1]);
    bad(&report, &[("loop sg-00=enc-02", "the board has a key")]);
    let skipped = report.findings.iter().find(|f| f.check == "flash images");
    assert_eq!(skipped.expect("told").verdict, Verdict::Skipped);
}

#[test]
fn a_board_in_use_is_left_alone() {
    let board = Board::healthy();
    let mut owner = board.client();
    owner.acquire().expect("the session");
    let mut client = board.client();
    let identity = client.identify().expect("a board");
    let refused = idle(&mut client, &identity).expect_err("it is owned");
    assert!(refused.to_string().contains("is driven by"), "{refused}");
}

// ---- pads and clocks ------------------------------------------------------------------------------------------------------

fn finding<'r>(report: &'r Report, check: &str) -> &'r Finding {
    let found = report.findings.iter().find(|f| f.check == check);
    found.unwrap_or_else(|| panic!("no {check}: {}", report.to_text()))
}

#[test]
fn each_pad_that_is_stuck_or_shorted_is_found_as_itself() {
    let low = "driven high, its pad reads low; shorted to ground";
    let high = "driven low, its pad reads high; shorted to a supply";
    let defects = [
        (Fault::Low(Pad::Output(2)), vec![("output 2 out-02", low)]),
        (
            Fault::High(Pad::Output(5)),
            vec![
                ("output pads", "not as they are driven at rest: 5 out-05"),
                ("output 5 out-05", high),
            ],
        ),
        (
            Fault::Short(Pad::Output(1), Pad::Output(4)),
            vec![
                (
                    "output 1 out-01",
                    "not when output 4 out-04 is driven the same way",
                ),
                (
                    "output 4 out-04",
                    "not when output 1 out-01 is driven the same way",
                ),
            ],
        ),
        (
            Fault::Low(Pad::Step(2)),
            vec![("output stepgen 2 sg-02 STEP", low)],
        ),
        (
            Fault::High(Pad::Dir(5)),
            vec![("output stepgen 5 sg-05 DIR", high)],
        ),
        (
            Fault::Short(Pad::Step(3), Pad::Dir(4)),
            vec![
                ("output stepgen 3 sg-03 STEP", low),
                ("output stepgen 4 sg-04 DIR", low),
            ],
        ),
        (Fault::Low(Pad::Pwm(1)), vec![("output pwm 1 pwm-01", low)]),
        (
            Fault::High(Pad::Pwm(0)),
            vec![("output pwm 0 pwm-00", high)],
        ),
    ];
    for (fault, expected) in defects {
        let board = Board::with(&[]);
        board.twin().world_mut().pads(fault);
        bad(&board.test(true, &[]), &expected);
    }
}

#[test]
fn a_pad_that_follows_another_is_found() {
    // Output 4 rests high: where two fight the low one wins, so it goes with output 1.
    let board = Board::with(&[]);
    let safe = map::CONFIG_BOARD + 4 * map::BoardConfig::GpioSafe as u32;
    let mut client = board.client();
    let session = client.acquire().expect("the session");
    client
        .write_then_read(safe, &[1 << 4], &[safe])
        .expect("a setting");
    client.release(&session);
    board
        .twin()
        .world_mut()
        .pads(Fault::Short(Pad::Output(1), Pad::Output(4)));
    let report = board.test(true, &[]);
    let expected = [
        ("output pads", "not as they are driven at rest: 4 out-04"),
        (
            "output 1 out-01",
            "that of output 4 out-04 with it; the two are shorted",
        ),
        ("output 4 out-04", "driven high, its pad reads low"),
    ];
    bad(&report, &expected);
}

#[test]
fn a_pad_is_said_to_be_the_fpgas_own() {
    let board = Board::with(&[]);
    let report = board.test(true, &[]);
    for check in [
        "output pads",
        "output 0 out-00",
        "output stepgen 0 sg-00 STEP",
    ] {
        let fact = &finding(&report, check).fact;
        assert!(
            fact.contains("behind") && fact.contains("not seen"),
            "{fact}"
        );
    }
}

#[test]
fn an_ethernet_clock_that_is_off_is_found_and_so_is_which_of_three_it_is() {
    let test = |eth_ppm: i32, rate: f64| {
        let mut setup = setup(nor(), &[]);
        setup.eth_ppm = eth_ppm;
        let mut board = Board::start(setup);
        board.rate = rate;
        board.test(false, &[])
    };
    let tolerable = test(-80, 1.0);
    bad(&tolerable, &[]);
    assert!(
        finding(&tolerable, "ethernet clock")
            .fact
            .starts_with("-80."),
        "{}",
        tolerable.to_text()
    );
    bad(
        &test(5_000, 1.0),
        &[("ethernet clock", "so it is this one")],
    );
    // The host and the Ethernet agree that the board is slow.
    let slow = [
        ("system clock", "another crystal"),
        ("ethernet clock", "so it is the board's"),
    ];
    bad(&test(10_000, 0.99), &slow);
    // The same for the host, and it is the host: the board and the Ethernet agree.
    bad(
        &test(0, 0.99),
        &[("system clock", "another crystal or divider")],
    );
}

#[test]
fn a_link_at_100_has_the_clock_of_100() {
    let board = Board::healthy();
    board.twin().world_mut().link(0b1011);
    let report = board.test(false, &[]);
    bad(&report, &[]);
    let fact = &finding(&report, "ethernet clock").fact;
    assert!(fact.contains("of 25 MHz"), "{fact}");
}

#[test]
fn gateware_without_read_back_is_told_as_such_and_tested_as_far_as_it_goes() {
    let mut setup = setup(nor(), &jumpers());
    setup.readback = false;
    let report = Board::start(setup).test(true, &LOOPS);
    bad(&report, &[]);
    for check in ["ethernet clock", "output pads"] {
        let skipped = finding(&report, check);
        assert_eq!(skipped.verdict, Verdict::Skipped);
        assert!(skipped.remedy.contains("flash it anew"), "{skipped:?}");
    }
    assert!(
        finding(&report, "output 0 out-00")
            .fact
            .contains("the pad is not read")
    );
    assert!(!report.to_text().contains("STEP"), "{}", report.to_text());
}

// ---- the same on the Verilated board ----------------------------------------------------------------------------------------

/// Board time per time of its host: a tenth, so that pauses meant for networks cost less. The
/// board's own clocks do not know.
const HURRY: f64 = 0.1;

impl Board<Rig> {
    fn verilated() -> Self {
        let (soc, firmware) = parts();
        let rig = Rig::boot(rig::Setup::new(&soc, &firmware));
        let rig = rig.unwrap_or_else(|error| panic!("{error}"));
        let mut board = Self::around(rig, 50);
        board.rate = HURRY;
        // It is this computer's time that the host waits, and a Verilated board needs much of that.
        board.patience = Duration::from_secs(5);
        board
    }

    /// The findings about outputs that are bad, and the Ethernet clock's.
    fn pads(&self) -> (Vec<String>, Finding) {
        let report = self.test_with(true, &[], Duration::ZERO, 5);
        let mut about = report
            .findings
            .iter()
            .filter(|f| f.check.starts_with("output"));
        assert!(about.clone().count() > 10, "{}", report.to_text());
        let bad = about.by_ref().filter(|f| f.verdict == Verdict::Bad);
        let bad = bad.map(|f| format!("{}: {}; {}", f.check, f.fact, f.reason));
        (bad.collect(), finding(&report, "ethernet clock").clone())
    }
}

#[test]
fn the_verilated_board_reads_its_pads_and_counts_its_ethernet_clock() {
    let board = Board::verilated();
    let (bad, ethernet) = board.pads();
    assert_eq!(bad, [""; 0]);
    assert_eq!(ethernet.verdict, Verdict::Good, "{ethernet:?}");
    // Both clocks of the simulation are exact: what is left is the counting.
    assert!(
        ethernet.fact.starts_with("+0.") || ethernet.fact.starts_with("-0."),
        "{ethernet:?}"
    );
    for (fault, expected) in [
        (Fault::Low(Pad::Output(2)), &["output 2"][..]),
        (
            Fault::Short(Pad::Step(0), Pad::Pwm(3)),
            &["output stepgen 0", "output pwm 3"],
        ),
    ] {
        board.twin().world_mut().pads(fault);
        let (bad, _) = board.pads();
        assert_eq!(bad.len(), expected.len(), "{fault:?}: {bad:?}");
        for (said, check) in bad.iter().zip(expected) {
            assert!(said.starts_with(check), "{fault:?}: {said}");
        }
    }
}
