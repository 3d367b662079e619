use super::*;
use crate::plant::{Axis, Spindle, Switch};
use firmware::services::line_editor::PROMPT;
use wire::describe::{self, Channels};
use wire::etherbone::{HEADER, record};
use wire::exchange::{Command, Latch, REQUEST_OVERHEAD, Status};
use wire::map;
use wire::units::{Accel, Velocity};

const SIX: Channels = Channels {
    stepgens: 6,
    encoders: 6,
    pwms: 6,
    inputs: 12,
    outputs: 12,
};
const HZ: u32 = 60_000_000;
const MS: u64 = 60_000;

/// A host on port 40000 of a twin.
struct Bench {
    twin: Twin,
    command: Command,
}

impl Bench {
    fn new(plant: Plant) -> Self {
        Bench {
            twin: Twin::start(BoardFacts::plain(SIX, HZ), plant),
            command: Command::default(),
        }
    }

    fn ask(&mut self, words: &[u32]) -> Option<Vec<u32>> {
        let payload: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
        self.twin.post(40_000, Service::Etherbone, &payload);
        let until = self.twin.clock() + 3000;
        while !self.twin.pass(until) && self.twin.clock() < until {}
        let reply = self.twin.take_replies().pop()?;
        assert_eq!((reply.service, reply.port), (Service::Etherbone, 40_000));
        let (chunks, _) = reply.payload.as_chunks();
        Some(chunks.iter().map(|c| u32::from_be_bytes(*c)).collect())
    }

    fn read(&mut self, address: u32) -> u32 {
        self.ask(&[HEADER, 0, record(0, 1), 0, address])
            .expect("an answer")[4]
    }

    fn write(&mut self, address: u32, value: u32) {
        assert_eq!(self.ask(&[HEADER, 0, record(1, 0), address, value]), None);
    }

    /// One servo period.
    fn exchange(&mut self) -> Status {
        self.command.sequence += 1;
        let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
        let request = self
            .command
            .emit_request(SIX, &mut buffer)
            .expect("it fits")
            .to_vec();
        let end = self.twin.clock() + MS;
        let reply = self.ask(&request).expect("the exchange is answered");
        while self.twin.clock() < end {
            self.twin.pass(end);
        }
        Status::parse_reply(&reply, SIX).expect("a status")
    }

    fn armed(plant: Plant) -> Self {
        Self::configured(plant, &[])
    }

    /// Armed, with ordinary timings and these settings.
    fn configured(plant: Plant, settings: &[(u32, u32)]) -> Self {
        let mut bench = Bench::new(plant);
        bench.write(map::SESSION_ACQUIRE, 7);
        bench.command.token = bench.read(map::SESSION_TOKEN);
        for n in 0..6 {
            let at = map::CONFIG_STEPGEN + n * map::CONFIG_STRIDE;
            for (word, value) in [(0, 60), (1, 60), (2, 120), (3, 120), (4, 50_000_000)] {
                bench.write(at + 4 * word, value);
            }
        }
        for (address, value) in settings {
            bench.write(*address, *value);
        }
        bench.command.enable = true;
        bench.command.stepgen_enable = 0x3f;
        bench.command.stepgen = [(Velocity(0), Accel(50_000_000)); 16];
        bench.exchange();
        bench.command.enable_request = true;
        bench.exchange();
        assert!(bench.exchange().state.enabled);
        bench
    }

    fn velocity(&mut self, axis: usize, steps_per_second: f64) {
        let velocity = steps_per_second * 2f64.powi(32) / f64::from(HZ);
        self.command.stepgen[axis].0 = Velocity(velocity as i32);
    }

    fn periods(&mut self, n: usize) -> Status {
        (0..n).map(|_| self.exchange()).last().expect("a period")
    }
}

#[test]
fn it_says_what_it_is() {
    let mut bench = Bench::new(Plant::default());
    assert_eq!(bench.read(0x18), HZ);
    assert_eq!(bench.read(map::DESCRIBE_BLOB), wire::board::MAGIC);
    assert_eq!(
        bench.read(regmap::address(regmap::ident::BASE, regmap::ident::MAGIC)),
        regmap::IDENT_MAGIC
    );
}

#[test]
fn what_the_host_asks_for_happens_at_the_pins_and_at_the_encoders() {
    let mut bench = Bench::armed(Plant::direct(6));
    bench.velocity(0, 50_000.0);
    bench.velocity(1, -12_345.0);
    bench.periods(100);
    bench.velocity(0, 0.0);
    bench.velocity(1, 0.0);
    let status = bench.periods(40);
    let edges = &bench.twin.environment().edges;
    for n in 0..2 {
        let (count, pins) = ((status.stepgen[n].0.0 >> 32) as i32, edges.channel(n).count);
        assert_eq!(
            (i64::from(count), status.encoder[n].count.0 as i32),
            (pins, count)
        );
    }
    assert!(
        (edges.channel(0).count - 5000).abs() < 20,
        "{}",
        edges.channel(0).count
    );
    assert!((edges.channel(1).count + 1234).abs() < 20);
    assert_eq!(edges.violations(), []);
    let report = Device::report(&mut bench.twin);
    assert_eq!(
        report.axes[0].firmware_counts,
        Some(report.axes[0].pulses_at_pins)
    );
}

#[test]
fn silence_stops_the_machine_and_closes_the_gate() {
    let mut bench = Bench::armed(Plant::default());
    bench.velocity(0, 100_000.0);
    bench.periods(10);
    let end = bench.twin.clock() + 50 * MS;
    while bench.twin.clock() < end {
        bench.twin.pass(end);
    }
    assert_eq!(bench.twin.environment().pins().gate, 0);
    assert_eq!(bench.twin.environment().edges.violations(), []);
    let close = bench.read(regmap::address(
        regmap::watchdog::BASE,
        regmap::watchdog::LAST_CLOSE,
    ));
    assert_eq!(close, wire::GateClose::Bite as u32);
}

#[test]
fn an_index_and_a_probe_are_latched_to_the_step() {
    let mut plant = Plant::new([Axis {
        counts_per_rev: 1000,
        index_at: 333,
        ..Axis::direct(0)
    }]);
    plant.add_switch(Switch {
        stepgen: 1,
        at: -200,
        above: false,
        input: 5,
        inverted: false,
    });
    let mut bench = Bench::configured(
        plant,
        &[(
            map::CONFIG_BOARD + 4 * map::BoardConfig::Probe as u32,
            5 | map::PROBE_ENABLE,
        )],
    );
    bench.command.index_arm = 1;
    bench.command.stepgen_index_arm = 1;
    bench.command.stepgen_probe_arm = 2;
    bench.velocity(0, 20_000.0);
    bench.velocity(1, -20_000.0);
    bench.periods(40);
    let mut latched = |latch| {
        bench.command.latch = latch;
        let status = bench.exchange();
        assert_eq!(
            (
                status.index_latched,
                status.stepgen_index_latched,
                status.stepgen_probe_latched
            ),
            (1, 1, 2)
        );
        status.latch.0 as i32
    };
    assert_eq!(latched(Latch::Encoder(0)), 333);
    assert_eq!(latched(Latch::Stepgen(0)), 333);
    assert_eq!(latched(Latch::Stepgen(1)), -200);
}

#[test]
fn a_spindle_turns_as_its_pwm_says() {
    let mut plant = Plant::default();
    plant.add_spindle(Spindle {
        pwm: 0,
        up_down: false,
        encoder: 5,
        counts_per_rev: 4000,
        max_rps: 50.0,
        lag_ms: 20.0,
        enable_output: None,
        reverse_output: None,
    });
    let mut bench = Bench::configured(plant, &[(map::CONFIG_PWM, 3000)]);
    bench.command.pwm[0] = 750 << wire::exchange::PWM_FRACTION | wire::exchange::PWM_ENABLE;
    let before = bench.periods(200).encoder[5].count.0;
    let after = bench.periods(100).encoder[5].count.0;
    // A quarter of 50 revolutions per second, a tenth of a second, 4000 counts each.
    let counts = after.wrapping_sub(before) as i32;
    assert!((counts - 5000).abs() < 60, "{counts}");
}

#[test]
fn a_visitor_is_greeted_answered_and_let_go() {
    let mut twin = Twin::start(BoardFacts::plain(SIX, HZ), Plant::default());
    let visitor = twin.open(CONSOLE_PORT);
    assert_eq!(twin.heard(visitor), PROMPT.as_bytes());
    twin.type_in(visitor, b"status\nquit\n");
    let heard = String::from_utf8(twin.heard(visitor)).expect("text");
    assert!(heard.contains("disarmed"), "{heard}");
    assert!(twin.hung_up(visitor) && !twin.closed(visitor));
    twin.hang_up(visitor);
    assert!(twin.closed(visitor));
}

#[test]
fn a_board_that_starts_anew_forgets_its_session_and_its_counts_but_the_machine_stays_where_it_is() {
    for word in ["reboot", "power"] {
        let mut bench = Bench::armed(Plant::direct(6));
        let boot = bench.read(describe::address(describe::BOOT_ID_AT));
        bench.velocity(0, 50_000.0);
        bench.periods(20);
        let there = bench.twin.environment().edges.channel(0).count;
        assert!(there > 400, "{there}");
        let clock = bench.twin.clock();
        bench.twin.trouble(&word.parse().unwrap()).unwrap();
        assert_eq!(bench.twin.environment().pins().gate, 0, "{word}");
        // The firmware has not started yet.
        assert_eq!(bench.ask(&[HEADER, 0, record(0, 1), 0, 0]), None);
        bench.twin.pass(clock + STARTING);
        assert_eq!(bench.read(map::SESSION_TOKEN), 0, "{word}");
        assert_ne!(
            bench.read(describe::address(describe::BOOT_ID_AT)),
            boot,
            "{word}"
        );
        assert_eq!(bench.twin.environment().edges.channel(0).count, there);
        assert_eq!(bench.twin.environment().edges.violations(), []);
    }
}

#[test]
fn a_pulled_cable_stops_the_machine_and_the_phy_says_so() {
    let mut bench = Bench::armed(Plant::default());
    bench.velocity(0, 100_000.0);
    bench.periods(10);
    bench
        .twin
        .trouble(&"pull@1ms..60ms".parse().unwrap())
        .unwrap();
    let end = bench.twin.clock() + 50 * MS;
    while bench.twin.clock() < end {
        bench.twin.pass(end);
    }
    let pins = bench.twin.environment().pins();
    assert_eq!((pins.gate, pins.link_status), (0, 0));
    let end = bench.twin.clock() + 20 * MS;
    while bench.twin.clock() < end {
        bench.twin.pass(end);
    }
    assert_eq!(bench.twin.environment().pins().link_status, LINK_1000);
    // The session died with its watchdog: what its host still says is refused, and nothing
    // opens the gate.
    assert_eq!(bench.read(map::SESSION_TOKEN), 0);
    assert_eq!(bench.twin.environment().pins().gate, 0);
}

#[test]
fn a_frozen_cpu_answers_nothing_and_the_watchdog_bites_all_the_same() {
    let mut bench = Bench::armed(Plant::default());
    bench.twin.freeze_cpu(true);
    assert_eq!(bench.ask(&[HEADER, 0, record(0, 1), 0, 0]), None);
    let end = bench.twin.clock() + 8 * MS;
    while bench.twin.clock() < end {
        bench.twin.pass(end);
    }
    assert_eq!(bench.twin.environment().pins().gate, 0);
}

/// Exchanges that the gateware executed, and those that took the long way.
fn ways(bench: &mut Bench) -> [u32; 2] {
    [0, 4].map(|at| bench.read(wire::refusal::COUNTERS_WAYS + at))
}

#[test]
fn the_gateware_executes_what_follows_an_exchange_of_an_armed_machine() {
    let mut bench = Bench::armed(Plant::direct(6));
    let [fast, long] = ways(&mut bench);
    bench.velocity(0, 50_000.0);
    bench.periods(50);
    assert_eq!(ways(&mut bench), [fast + 50, long]);
    let report = Device::report(&mut bench.twin).board.expect("it answers");
    assert_eq!((report.fast, report.long), (fast + 50, long));
    assert_eq!(bench.twin.environment().edges.violations(), []);
}

#[test]
fn an_answer_of_the_gateware_says_what_the_firmware_s_would() {
    // The same exchange, with a pass and without one: another datagram of the owner's right in
    // front of it takes the pass back.
    let answers = [false, true].map(|long| {
        let mut bench = Bench::armed(Plant::direct(6));
        bench.velocity(0, 0.0);
        bench.command.latch = Latch::Stepgen(2);
        bench.periods(20);
        let before = ways(&mut bench);
        if long {
            let skipped = bench.command.sequence + 1;
            bench.command.sequence = skipped;
        }
        let status = bench.exchange();
        let after = ways(&mut bench);
        assert_eq!(after[usize::from(long)], before[usize::from(long)] + 1);
        assert_eq!(after[usize::from(!long)], before[usize::from(!long)]);
        status
    });
    let [fast, long] = answers;
    assert_eq!((fast.state, fast.boot_id), (long.state, long.boot_id));
    assert_eq!((fast.latch, fast.refused), (long.latch, long.refused));
    for n in 0..6 {
        assert_eq!(fast.stepgen[n], long.stepgen[n]);
        assert_eq!(fast.encoder[n].count, long.encoder[n].count);
    }
}

#[test]
fn the_gateware_answers_sooner_than_the_firmware_could() {
    let mut bench = Bench::armed(Plant::default());
    let asked = bench.twin.clock();
    bench.command.sequence += 1;
    let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
    let request = bench
        .command
        .emit_request(SIX, &mut buffer)
        .expect("it fits");
    let bytes = payload(request);
    bench.twin.post(40_000, Service::Etherbone, &bytes);
    while !bench.twin.pass(asked + 3000) {}
    assert!(
        bench.twin.clock() - asked < 120,
        "{}",
        bench.twin.clock() - asked
    );
    // The token is on the bus a clock before it takes effect.
    assert_eq!(bench.twin.fed() - asked, 7 - 1);
}

#[test]
fn an_exchange_behind_a_lost_one_takes_the_long_way_and_the_next_does_not() {
    let mut bench = Bench::armed(Plant::default());
    bench.exchange();
    let [fast, long] = ways(&mut bench);
    bench.command.sequence += 1;
    bench.exchange();
    assert_eq!(ways(&mut bench), [fast, long + 1]);
    let why = bench.read(wire::refusal::COUNTERS_WAYS + 8);
    assert_eq!(why, wire::LongWay::Sequence as u32);
    bench.exchange();
    assert_eq!(ways(&mut bench), [fast + 1, long + 1]);
}

#[test]
fn a_guest_s_question_leaves_the_pass_out() {
    let mut bench = Bench::armed(Plant::default());
    bench.exchange();
    let [fast, _] = ways(&mut bench);
    for _ in 0..10 {
        let words = [HEADER, 0, record(0, 1), 0, map::SESSION_TOKEN];
        bench
            .twin
            .post(40_001, Service::Etherbone, &payload(&words));
        // The owner's exchange is on the wire when the guest is served.
        bench.exchange();
    }
    assert_eq!(ways(&mut bench)[0], fast + 10);
}

#[test]
fn a_frozen_cpu_s_pass_is_good_for_one_command() {
    let mut bench = Bench::armed(Plant::default());
    bench.exchange();
    let [fast, _] = ways(&mut bench);
    bench.twin.freeze_cpu(true);
    bench.exchange();
    let fed = bench.twin.fed();
    let mut buffer = [0; REQUEST_OVERHEAD + wire::exchange::COMMAND_MAX];
    bench.command.sequence += 1;
    let request = bench
        .command
        .emit_request(SIX, &mut buffer)
        .expect("it fits");
    let request = request.to_vec();
    assert_eq!(bench.ask(&request), None);
    assert_eq!(bench.twin.fed(), fed);
    bench.twin.freeze_cpu(false);
    assert_eq!(ways(&mut bench)[0], fast + 1);
}
