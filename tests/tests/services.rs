//! The services fail while the machine moves: the Verilated board with a program that panics, or
//! meets an instruction that is none, when a ping comes; or their SDRAM rots. And three consoles at
//! once.
//!
//! Panics cannot be excluded here as in the ROM's image (`image`): smoltcp has some 90 places that
//! may panic, and other ones with each release. These tests are in that list's place.

use ferrocnc_tests::flood::Kind;
use ferrocnc_tests::services::{Part, broken, sealed};
use ferrocnc_tests::wired::{program, setup};
use ferrocnc_tests::{BenchMachine, seed};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use sim::lan_segment::CONSOLE_PORT;
use sim::soc::SdramLines;
use wire::describe::{self, FEATURES_AT, JobsState};
use wire::exchange::{Command, Status};
use wire::map;
use wire::regmap::{WINDOW_BASE, WINDOW_SIZE, address, command, stepgen, timebase, watchdog};
use wire::state::State;
use wire::units::{Accel, Velocity};

/// As in `flood`: no call of the services may cost more.
const BOUND: u64 = 18_000;
/// Clocks the ROM gives them while an owner moves the machine.
const LEASH: u64 = 20_000;
/// What `panic!` is in them.
const EBREAK: u32 = 0x0010_0073;
const ILLEGAL: u32 = 0;
/// `j .`
const FOR_EVER: u32 = 0x0000_006f;
/// In place of `services_main`: start and turns are over at once, behind a frame the ROM is asked
/// for ever to execute a datagram of no words.
const ASKS_FOR_EVER: [u32; 11] = [
    0x0005_9663, // bnez a1, 1f
    0x0000_0513, // li a0, 0
    0x0000_8067, // ret
    0x0005_0413, // 1: mv s0, a0
    0x0004_2503, // 2: lw a0, 0(s0): the context
    0x0004_0593, // mv a1, s0
    0x0000_0613, // li a2, 0
    0x4007_06b7, // lui a3, 0x40070: room for an answer
    0x0044_2303, // lw t1, 4(s0): Rom::datagram
    0x0003_00e7, // jalr t1
    0xfe9f_f06f, // j 2b
];
/// Calls itself with 4 KiB of stack, past its own stack, data and code, and out of the SDRAM.
const OVERFLOW: [u32; 4] = [
    0x0000_12b7, // lui t0, 1
    0x4051_0133, // 1: sub sp, sp, t0
    0x0011_2023, // sw ra, 0(sp)
    0xff9f_f0ef, // jal 1b
];
/// `lui sp, 0x12345`: where there is no memory.
const LOST_STACK: u32 = 0x1234_5137;

/// Registers that hold what a host has set: a pulse's length, and the watchdog's time.
const SETTINGS: [u32; 2] = [
    address(stepgen::BASE, stepgen::STEPLEN),
    address(watchdog::BASE, watchdog::TIMEOUT),
];

/// While the services start, which is one call of some milliseconds, a read has no answer.
fn state(machine: &mut BenchMachine) -> JobsState {
    let rig = machine.rig();
    let word = (0..20).find_map(|_| rig.read_word(map::DESCRIBE + 9 * 4));
    JobsState::of(word.expect("the board answers"))
}

fn moving(machine: &mut BenchMachine) -> Command {
    machine.make_ready();
    let mut command = machine.enabled_command();
    for (n, (velocity, accel)) in command.stepgen.iter_mut().take(3).enumerate() {
        *velocity = Velocity::from_hz(20e3 * (n as f64 - 1.4), machine.clock_hz());
        *accel = Accel::from_steps(1e8, machine.clock_hz());
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    command
}

/// The services fail at a ping while three axes move; the owner's answer takes so many clocks at
/// most.
fn outlives(what: &str, code: &[u32], bound: u64) {
    outlives_in("icmpv4_reply", what, code, bound);
}

/// The same with the code in this function. Returns the machine, at rest.
fn outlives_in(part: &str, what: &str, code: &[u32], bound: u64) -> BenchMachine {
    let mut machine = BenchMachine::boot(setup(&sealed(broken(program(), part, code))));
    assert_eq!(state(&mut machine), JobsState::Alive, "{what}");
    let mut command = moving(&mut machine);
    let before = SETTINGS.map(|at| machine.read(at));
    let (mut worst, mut rng) = (0, Pcg64Mcg::seed_from_u64(seed()));
    let mut past = machine.exchange_and_wait(&mut command);
    for period in 0..30 {
        let frames = match period {
            5 => vec![machine.frame(Kind::PingArmed, &mut rng)],
            _ => Vec::new(),
        };
        let answer = machine.period_with(&mut command, &frames, frames.len());
        let answer = answer.unwrap_or_else(|| panic!("{what}: no answer in period {period}"));
        assert_eq!(answer.status.state.state, State::Armed, "{what}");
        worst = worst.max(answer.turnaround);
        for axis in 0..3 {
            let off = off_course(&command, axis, &past, &answer.status);
            assert!(
                off.abs() <= 2.0,
                "{what}: axis {axis}, period {period}: {off} steps"
            );
        }
        past = answer.status;
    }
    println!("{what}: {worst} clocks");
    assert_eq!(SETTINGS.map(|at| machine.read(at)), before, "{what}");
    assert!(worst <= bound, "{what}: {worst} clocks");
    assert!(machine.gate_open(), "{what}");
    assert_eq!(state(&mut machine), JobsState::Ended, "{what}");
    for (velocity, _) in &mut command.stepgen {
        *velocity = Velocity(0);
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    let status = machine.exchange_and_wait(&mut command);
    for axis in 0..3 {
        let told = status.stepgen[axis].0.pulses();
        assert_eq!(told, machine.pulses(axis), "{what}: axis {axis}");
        assert!(machine.edges(axis) > 0, "{what}: axis {axis} moved");
    }
    assert_eq!(machine.timing_violations(), 0);
    // What is left in the ROM answers now.
    machine.run_millis(200);
    assert!(machine.ping().is_some(), "{what}: the ROM's ping");
    for port in [CONSOLE_PORT, wire::jobs::PORT] {
        let refused = machine.rig().tcp_connect(port).is_err();
        assert!(refused, "{what}: port {port} does not answer any more");
    }
    machine
}

/// Steps an axis has made beyond those of its velocity, from one sample to the next.
fn off_course(command: &Command, axis: usize, past: &Status, now: &Status) -> f64 {
    let clocks = now.sample.0.wrapping_sub(past.sample.0) as f64;
    let made = now.stepgen[axis].0.since(past.stepgen[axis].0);
    made - f64::from(command.stepgen[axis].0.0) * clocks / 2f64.powi(32)
}

/// Code that stores a word.
fn store(at: u32, word: u32) -> [u32; 5] {
    const T0: u32 = 5;
    const T1: u32 = 6;
    let upper =
        |register: u32, value: u32| value.wrapping_add(0x800) & !0xfff | register << 7 | 0x37;
    let lower =
        |register: u32, value: u32| (value & 0xfff) << 20 | register << 15 | register << 7 | 0x13;
    [
        upper(T0, word),
        lower(T0, word),
        upper(T1, at),
        lower(T1, at),
        T0 << 20 | T1 << 15 | 2 << 12 | 0x23, // sw t0, 0(t1)
    ]
}

/// Stores of broken services, then a loop: it is the guard that ends them, long before the leash.
fn stores(all: &[(u32, u32)]) -> Vec<u32> {
    let code = all.iter().flat_map(|(at, word)| store(*at, *word));
    code.chain([FOR_EVER]).collect()
}

#[test]
fn a_panic_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives("panic", &[EBREAK], BOUND);
}

#[test]
fn an_illegal_instruction_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives("illegal instruction", &[ILLEGAL], BOUND);
}

#[test]
fn an_endless_loop_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives("endless loop", &[FOR_EVER], BOUND + LEASH);
}

#[test]
fn services_that_ask_the_rom_for_ever_are_ended_between_two_answers() {
    let bound = BOUND + LEASH;
    outlives_in("services_main", "asks for ever", &ASKS_FOR_EVER, bound);
}

#[test]
fn services_that_lost_their_stack_and_trap_end_themselves_and_not_the_motion() {
    outlives("lost stack", &[LOST_STACK, EBREAK], BOUND);
}

#[test]
fn a_stack_overflow_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives("stack overflow", &OVERFLOW, BOUND);
}

#[test]
fn a_wild_store_of_the_services_to_the_gate_ends_them_and_the_gate_stays_open() {
    let control = address(watchdog::BASE, watchdog::CONTROL);
    let code = stores(&[(control, watchdog::CONTROL_KEY_STOP)]);
    outlives("a store to the gate", &code, BOUND);
}

#[test]
fn wild_stores_of_the_services_change_no_velocity_and_no_setting() {
    let velocity = address(command::BASE, command::STEPGEN0_VELOCITY);
    let strobe = address(timebase::BASE, timebase::STROBE);
    let code = stores(&[
        (velocity, 0x0800_0000),
        (strobe, timebase::STROBE_COMMIT),
        (SETTINGS[0], 0x1234),
        (SETTINGS[1], 0),
    ]);
    outlives("stores to registers", &code, BOUND);
}

#[test]
fn a_wild_store_of_the_services_does_not_reach_the_roms_memory() {
    // Every kind of its data, down to the stack.
    let first = (WINDOW_BASE + WINDOW_SIZE) as u32;
    let code = stores(&[(first, !0), (first + 0x400, !0), (first + 0x800, !0)]);
    outlives("stores to the ROM's data", &code, BOUND);
}

#[test]
fn services_that_store_wildly_with_interrupts_off_are_ended_when_they_return() {
    let control = address(watchdog::BASE, watchdog::CONTROL);
    let mut code = vec![
        0x0005_9663, // bnez a1, 1f
        0x0000_0513, // li a0, 0
        0x0000_8067, // ret
        0x3004_7073, // 1: csrci mstatus, 8
    ];
    code.extend(store(control, watchdog::CONTROL_KEY_STOP));
    code.extend([0x0000_0513, 0x0000_8067]); // li a0, 0; ret
    outlives_in("services_main", "a store without interrupts", &code, BOUND);
}

#[test]
fn services_that_failed_are_loaded_again_at_rest_and_three_times_at_most() {
    let code = sealed(broken(program(), "icmpv4_reply", &[EBREAK]));
    let mut machine = BenchMachine::boot(setup(&code));
    for life in 0..4 {
        let alive = (0..60).any(|_| {
            machine.run_millis(10);
            state(&mut machine) == JobsState::Alive
        });
        assert!(alive, "life {life}");
        // The ping ends them, and nothing answers it.
        assert!(machine.ping().is_none(), "life {life}");
        let told = match life {
            3 => JobsState::GivenUp,
            _ => JobsState::Ended,
        };
        assert_eq!(state(&mut machine), told, "life {life}");
    }
    machine.run_millis(300);
    assert_eq!(state(&mut machine), JobsState::GivenUp);
    assert!(machine.ping().is_some(), "the ROM's");
}

/// Runs until the services are in this state. The board answers no read while they start.
fn becomes(machine: &mut BenchMachine, wanted: JobsState, millis: u64) -> bool {
    (0..millis / 5).any(|_| {
        machine.run_millis(5);
        let features = machine.rig().read_word(describe::address(FEATURES_AT));
        features.map(JobsState::of) == Some(wanted)
    })
}

/// Clients ask for the services while three axes move, and `rots` spoils the SDRAM before each
/// period: every exchange is answered in time, the machine stays armed, every pulse is counted.
/// Returns what became of the services, and the slowest answer.
fn moves_on(
    machine: &mut BenchMachine,
    what: &str,
    rng: &mut Pcg64Mcg,
    mut rots: impl FnMut(&mut BenchMachine, u32, &mut Pcg64Mcg),
) -> (JobsState, u64) {
    const CLIENTS: [Kind; 4] = [Kind::PingArmed, Kind::TcpArmed, Kind::Discovery, Kind::Tcp];
    let mut command = moving(machine);
    let (mut worst, mut told) = (0, JobsState::None);
    let before: Vec<_> = (0..3).map(|axis| machine.edges(axis)).collect();
    for period in 0..48 {
        rots(machine, period, rng);
        let frames = [machine.frame(CLIENTS[period as usize % CLIENTS.len()], rng)];
        let answer = machine.period_with(&mut command, &frames, 1);
        let answer = answer.unwrap_or_else(|| panic!("{what}: no answer in period {period}"));
        assert_eq!(answer.status.state.state, State::Armed, "{what}: {period}");
        worst = worst.max(answer.turnaround);
        told = answer.status.state.services;
    }
    assert!(worst <= BOUND + LEASH, "{what}: {worst} clocks");
    assert!(machine.gate_open(), "{what}");
    assert_eq!(state(machine), told, "{what}: what HAL shows");
    for (velocity, _) in &mut command.stepgen {
        *velocity = Velocity(0);
    }
    for _ in 0..5 {
        machine.exchange_and_wait(&mut command);
    }
    let status = machine.exchange_and_wait(&mut command);
    for (axis, before) in before.into_iter().enumerate() {
        let pulses = status.stepgen[axis].0.pulses();
        assert_eq!(pulses, machine.pulses(axis), "{what}: axis {axis}");
        assert!(machine.edges(axis) > before, "{what}: axis {axis} moved");
    }
    assert_eq!(machine.timing_violations(), 0, "{what}");
    machine.release();
    (told, worst)
}

/// Longest wait until a bit that has turned over is noticed while no host owns the board.
const SWEEP_MS: u64 = 300;
/// The services are loaded well before that.
const LOADING_MS: u64 = 800;

#[test]
fn bits_that_turn_over_in_the_services_of_a_moving_machine_end_them_at_most() {
    let code = program();
    let mut machine = BenchMachine::boot(setup(&code));
    let seed = seed();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    // A part, bits that turn over, and the periods between two times.
    let lives = [
        (Part::Data, 40, 4),
        (Part::Code, 100, 4),
        (Part::Code, 4000, 20),
        (Part::Data, 4000, 20),
    ];
    for (life, (part, bits, every)) in (0..).zip(lives) {
        let alive = state(&mut machine) == JobsState::Alive;
        let what = format!("life {life}, {bits} bits of {part:?}, seed {seed}");
        assert!(
            alive || becomes(&mut machine, JobsState::Alive, LOADING_MS),
            "{what}: loaded"
        );
        let words = part.words(&code);
        let rots = |machine: &mut BenchMachine, period: u32, rng: &mut Pcg64Mcg| {
            if period % every == every / 2 {
                machine.turn_over(&words, bits, rng);
            }
        };
        let (told, worst) = moves_on(&mut machine, &what, &mut rng, rots);
        println!("{what}: {}, slowest answer {worst} clocks", told.text());
        let ended = match life {
            3 => JobsState::GivenUp,
            _ => JobsState::Ended,
        };
        if told == JobsState::Alive {
            // They went on. Nothing notices data; code is noticed at rest.
            machine.turn_over(&Part::Code.words(&code), 1, &mut rng);
            assert!(becomes(&mut machine, ended, SWEEP_MS), "{what}: noticed");
        } else {
            assert_eq!(told, ended, "{what}");
        }
    }
    machine.run_millis(LOADING_MS);
    assert_eq!(state(&mut machine), JobsState::GivenUp);
    assert!(machine.ping().is_some(), "the ROM's");
    moving(&mut machine);
}

#[test]
fn a_bit_of_the_services_that_turns_over_at_rest_is_noticed_and_they_are_loaded_again() {
    let code = program();
    let mut machine = BenchMachine::boot(setup(&code));
    let seed = seed();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    machine.turn_over(&Part::Code.words(&code), 1, &mut rng);
    let begun = machine.clock();
    let noticed = becomes(&mut machine, JobsState::Ended, SWEEP_MS);
    println!("noticed after {} clocks", machine.clock() - begun);
    assert!(noticed, "seed {seed}");
    // Not while a host owns the board.
    machine.acquire();
    let mut command = Command::default();
    for _ in 0..20 {
        let status = machine.exchange_and_wait(&mut command);
        assert_eq!(status.state.services, JobsState::Ended);
    }
    machine.release();
    assert!(becomes(&mut machine, JobsState::Alive, LOADING_MS));
    assert!(machine.console("status\n").contains("services ready"));
}

#[test]
fn an_sdram_that_dies_while_the_machine_moves_ends_the_services_and_not_the_motion() {
    let lines = |data, high| SdramLines { data, high, row: 0 };
    for (what, lines) in [
        ("all of it reads 0", lines(u32::MAX, 0)),
        ("a line is shorted to the supply", lines(0, 1 << 6)),
    ] {
        let mut machine = BenchMachine::boot(setup(&program()));
        let mut rng = Pcg64Mcg::seed_from_u64(seed());
        let dies = |machine: &mut BenchMachine, period: u32, _: &mut Pcg64Mcg| {
            if period == 7 {
                assert!(machine.rig().board.silicon().short_sdram(lines));
            }
        };
        let (told, worst) = moves_on(&mut machine, what, &mut rng, dies);
        println!("{what}: {}, slowest answer {worst} clocks", told.text());
        assert_eq!(told, JobsState::Ended, "{what}");
        // They are loaded again, and are not what is in the flash.
        let noticed = becomes(&mut machine, JobsState::Damaged, LOADING_MS);
        assert!(noticed, "{what}");
        assert!(machine.ping().is_some(), "{what}: the ROM's ping");
        let refused = machine.rig().tcp_connect(CONSOLE_PORT).is_err();
        assert!(refused, "{what}: no console");
        moving(&mut machine);
    }
}

#[test]
fn services_that_fail_when_they_start_leave_a_board_that_does_everything_else() {
    let code = sealed(broken(program(), "services_main", &[EBREAK]));
    let mut machine = BenchMachine::boot(setup(&code));
    assert_eq!(state(&mut machine), JobsState::Ended);
    assert!(machine.ping().is_some());
    assert!(machine.rig().tcp_connect(CONSOLE_PORT).is_err());
    moving(&mut machine);
}

#[test]
fn three_clients_have_a_console_at_once() {
    let mut machine = BenchMachine::boot(setup(&program()));
    let rig = machine.rig();
    let all: Vec<_> = (0..3)
        .map(|n| {
            let connected = rig.tcp_connect(CONSOLE_PORT);
            connected.unwrap_or_else(|error| panic!("console {n}: {error}"))
        })
        .collect();
    assert!(rig.tcp_connect(CONSOLE_PORT).is_err(), "a fourth");
    let mut heard = vec![String::new(); 3];
    for (client, line) in all.iter().zip(["status\n", "job status\n", "settings\n"]) {
        rig.segment.send(*client, line.as_bytes());
        // One after the other, as hands type them.
        rig.run_ms(1);
    }
    for _ in 0..40 {
        rig.run_ms(1);
        for (client, heard) in all.iter().zip(&mut heard) {
            heard.push_str(&String::from_utf8_lossy(&rig.segment.recv(*client)));
        }
    }
    for (heard, word) in heard.iter().zip(["session  ", "stopped", "192.168.2.50"]) {
        assert!(heard.contains(word), "{heard}");
        assert_eq!(heard.matches("ferrocnc> ").count(), 2, "{heard}");
    }
}

#[test]
fn the_status_page_is_read_at_rest_and_is_busy_while_the_machine_moves() {
    const ASK: &str = "GET /status.json HTTP/1.0\r\n\r\n";
    let mut machine = BenchMachine::boot(setup(&program()));
    let rig = machine.rig();
    let reader = rig.tcp_connect(wire::PAGE_PORT).expect("the page's port");
    let mut heard = rig.tcp_talk(reader, ASK);
    for _ in 0..100 {
        if rig.segment.hung_up(reader) {
            break;
        }
        heard += &rig.tcp_talk(reader, "");
    }
    let (head, json) = heard.split_once("\r\n\r\n").expect("a head");
    assert!(head.starts_with("HTTP/1.1 200 OK"), "{head}");
    let json: serde_json::Value = serde_json::from_str(json).expect("JSON");
    assert_eq!(json["machine"]["state"], "disarmed", "{json}");
    machine.rig().segment.drop_connection(reader);

    let mut command = moving(&mut machine);
    let reader = machine.rig().segment.connect(wire::PAGE_PORT);
    let (mut heard, mut connected, mut asked) = (Vec::new(), false, false);
    for period in 0..60 {
        let status = machine.exchange_and_wait(&mut command);
        assert_eq!(status.state.state, State::Armed, "period {period}");
        let segment = &mut machine.rig().segment;
        // The board takes one frame of a guest in a period. The last of the handshake is one, and a
        // request right behind it would come again a second later.
        if connected && !asked {
            asked = segment.send(reader, ASK.as_bytes()) == ASK.len();
        }
        connected = segment.established(reader);
        heard.extend(segment.recv(reader));
    }
    let heard = String::from_utf8(heard).expect("text");
    assert!(heard.starts_with("HTTP/1.1 503 "), "{heard:?}");
    assert!(
        heard.ends_with("busy: the machine needs the time\n"),
        "{heard:?}"
    );
    let spread = machine.turnaround_spread(60);
    println!("turnaround while a page is asked for {spread:?}");
    assert!(spread.max <= BOUND, "{spread:?}");
}
