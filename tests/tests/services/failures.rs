//! The services of a moving machine panic, trap, do not return, lose their stack, store wildly.

use ferrocnc_tests::flood::Kind;
use ferrocnc_tests::services::{begins_with, broken, elf, sealed, small};
use ferrocnc_tests::wired::{program, program_without_jobs, setup, without_jobs};
use ferrocnc_tests::{BenchMachine, report_part, seed, symbol};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde_json::json;
use sim::lan_segment::CONSOLE_PORT;
use sim::rig::Setup;
use wire::describe::JobsState;
use wire::exchange::{Command, Status};
use wire::map;
use wire::regmap::{
    SDRAM_BASE, SDRAM_SIZE, WINDOW_BASE, WINDOW_SIZE, address, command, stepgen, timebase, watchdog,
};
use wire::state::State;

use crate::{EBREAK, FAST, LATE, LEASH, becomes, moving, state};

const ILLEGAL: u32 = 0;
/// `j .`
const FOR_EVER: u32 = 0x0000_006f;
/// In every call: start and turns are over at once, behind a frame the ROM is asked for ever to
/// execute a datagram of no words.
const ASKS_FOR_EVER: [u32; 12] = [
    0x0005_9663, // bnez a1, 1f
    0x0000_0513, // li a0, 0
    0x0000_8067, // ret
    0x4007_1137, // 1: lui sp, 0x40071: the ROM keeps a word on the stack
    0x0005_0413, // mv s0, a0
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
/// `csrci mstatus, 8`
const NO_INTERRUPTS: u32 = 0x3004_7073;
/// `lw t0, 1(zero)`
const MISALIGNED: u32 = 0x0010_2283;
/// `lui sp, 0x12345`: where there is no memory.
const LOST_STACK: u32 = 0x1234_5137;

/// Registers that hold what a host has set: a pulse's length, and the watchdog's time.
const SETTINGS: [u32; 2] = [
    address(stepgen::BASE, stepgen::STEPLEN),
    address(watchdog::BASE, watchdog::TIMEOUT),
];

/// The function that answers a ping.
const PING: &str = "icmpv4_reply";
/// Servo periods of a test, and the one in which the services fail.
const PERIODS: u32 = 16;
const FAILS: u32 = 5;
/// Clocks behind an answer in which there is no pass for the next exchange yet, and in which there
/// is one again behind another datagram of the owner.
const TOO_SOON: u64 = 300;
const AGAIN: u64 = 20_000;

/// The services fail at a ping while three axes move: see [`outlives_on`]. Those of the build, on a
/// board without jobs: they are there in half the time.
fn outlives_in(part: &str, what: &str, code: &[u32], late: u64) {
    let program = sealed(broken(program_without_jobs(), part, code));
    outlives_on(without_jobs(setup(&program)), what, late);
}

/// The same on a board with jobs.
fn outlives(what: &str, program: &[u8], late: u64) {
    outlives_on(setup(program), what, late);
}

/// This program fails when a ping comes, while three axes move. Every exchange with a pass is
/// answered by the gateware; one that comes too soon behind the one that met the failure has none,
/// and its answer takes `late` clocks at most.
fn outlives_on(board: Setup, what: &str, late: u64) {
    let mut machine = BenchMachine::boot(board);
    assert_eq!(state(&mut machine), JobsState::Alive, "{what}");
    let mut command = moving(&mut machine);
    let before = SETTINGS.map(|at| machine.read(at));
    let long = machine.ways().long;
    // Those were datagrams of the owner, too. They have taken the pass back.
    machine.run_clocks(AGAIN);
    let mut rng = Pcg64Mcg::seed_from_u64(seed());
    let mut past = machine.exchange_and_wait(&mut command);
    let (mut fast, mut behind) = (0, 0);
    let mut check = |command: &Command, now: Status, period: u32| {
        assert_eq!(now.state.state, State::Armed, "{what}: period {period}");
        for axis in 0..3 {
            let off = off_course(command, axis, &past, &now);
            let right = off.abs() <= 2.0;
            assert!(right, "{what}: axis {axis}, period {period}: {off} steps");
        }
        past = now;
    };
    for period in 0..PERIODS {
        if period == FAILS {
            let ping = machine.frame(Kind::PingArmed, &mut rng);
            machine.inject(ping);
            let status = machine.exchange(&mut command);
            check(&command, status, period);
            machine.run_clocks(TOO_SOON);
            let status = machine.exchange_and_wait(&mut command);
            check(&command, status, period);
            let [met, next] = machine.turnarounds(2)[..] else {
                panic!("two exchanges have two turnarounds");
            };
            fast = fast.max(u64::from(met));
            behind = u64::from(next);
            assert_eq!(machine.ways().long - long, 1, "{what}: the last one");
            machine.run_clocks(AGAIN);
            continue;
        }
        let answer = machine.period_with(&mut command, &[], 0);
        let answer = answer.unwrap_or_else(|| panic!("{what}: no answer in period {period}"));
        check(&command, answer.status, period);
        fast = fast.max(answer.turnaround);
    }
    println!("{what}: {fast} clocks with a pass, {behind} behind the failure without one");
    let figures = json!({"with_a_pass_clocks": fast, "without_clocks": behind});
    report_part("services", what, figures);
    assert!(fast <= FAST, "{what}: {fast} clocks");
    // What does not come back has all the time there is.
    let least = if late > LATE { LEASH } else { FAST + 1 };
    let right = (least..=late).contains(&behind);
    assert!(right, "{what}: {behind} clocks");
    assert_eq!(SETTINGS.map(|at| machine.read(at)), before, "{what}");
    assert!(machine.gate_open(), "{what}");
    assert_eq!(state(&mut machine), JobsState::Ended, "{what}");
    // What is left in the ROM answers now.
    let ping = machine.frame(Kind::PingArmed, &mut rng);
    machine.capture();
    for _ in 0..3 {
        machine.period_with(&mut command, std::slice::from_ref(&ping), 1);
    }
    let frames = machine.rig().take_frames();
    let echo = |frame: &Vec<u8>| frame[12..14] == [8, 0] && frame[23] == 1 && frame[34] == 0;
    assert!(frames.iter().any(echo), "{what}: the ROM's ping");
    machine.comes_to_rest(&mut command, what);
    for port in [CONSOLE_PORT, wire::PAGE_PORT, wire::jobs::PORT] {
        let refused = machine.rig().tcp_connect(port).is_err();
        assert!(refused, "{what}: port {port} does not answer any more");
    }
}

/// Steps an axis has made beyond those of its velocity, from one sample to the next.
fn off_course(command: &Command, axis: usize, past: &Status, now: &Status) -> f64 {
    let clocks = now.sample.0.wrapping_sub(past.sample.0) as f64;
    let made = now.stepgen[axis].0.since(past.stepgen[axis].0);
    made - f64::from(command.stepgen[axis].0.0) * clocks / 2f64.powi(32)
}

/// Code that loads a number into a register.
fn load(register: u32, value: u32) -> [u32; 2] {
    [
        value.wrapping_add(0x800) & !0xfff | register << 7 | 0x37, // lui
        (value & 0xfff) << 20 | register << 15 | register << 7 | 0x13, // addi
    ]
}

/// Code that stores a word.
fn store(at: u32, word: u32) -> [u32; 5] {
    const T0: u32 = 5;
    const T1: u32 = 6;
    let ([a, b], [c, d]) = (load(T0, word), load(T1, at));
    [a, b, c, d, T0 << 20 | T1 << 15 | 2 << 12 | 0x23] // sw t0, 0(t1)
}

/// Stores of broken services, then a loop: it is the guard that ends them, long before the leash.
fn stores(all: &[(u32, u32)]) -> Vec<u32> {
    let code = all.iter().flat_map(|(at, word)| store(*at, *word));
    code.chain([FOR_EVER]).collect()
}

/// `jal zero`, from the first function with `from` in its name to that with `to`.
fn jump(from: &str, to: &str) -> u32 {
    let elf = elf(&program_without_jobs());
    let [(from, _), (to, _)] = [from, to].map(|part| symbol(&elf, part));
    let way = to.wrapping_sub(from) as u32;
    (way >> 20 & 1) << 31 | (way >> 1 & 0x3ff) << 21 | (way >> 11 & 1) << 20 | way & 0xf_f000 | 0x6f
}

/// Code in a call with a frame that asks the ROM for something, with its stack here.
fn asks_on(stack: u32) -> Vec<u32> {
    const SP: u32 = 2;
    [&load(SP, stack)[..], &ASKS_FOR_EVER[4..]].concat()
}

#[test]
fn a_panic_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    // What `panic!` calls, with whatever arguments there are.
    let code = jump(PING, "panic_fmt");
    outlives_in(PING, "panic", &[code], LATE);
}

#[test]
fn a_misaligned_load_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    let program = small(&program(), &[MISALIGNED, FOR_EVER]);
    outlives("misaligned load", &program, LATE);
}

#[test]
fn a_panic_of_services_without_jobs_ends_them_and_not_the_motion() {
    let board = without_jobs(setup(&small(&program_without_jobs(), &[EBREAK])));
    outlives_on(board, "panic without jobs", LATE);
}

#[test]
fn services_with_their_stack_anywhere_ask_the_rom_for_nothing() {
    let sdram = SDRAM_BASE as u32;
    let places = [
        ("the beginning of the SDRAM", sdram + 0x10),
        ("its end", sdram + SDRAM_SIZE as u32 + 0x40),
        ("the ROM's window", WINDOW_BASE as u32 + 0x40),
        (
            "the ROM's memory",
            (WINDOW_BASE + WINDOW_SIZE) as u32 + 0x1000,
        ),
    ];
    for (what, stack) in places {
        let program = small(&program(), &asks_on(stack));
        outlives(&format!("asks with its stack in {what}"), &program, LATE);
    }
}

#[test]
fn an_illegal_instruction_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives("illegal instruction", &small(&program(), &[ILLEGAL]), LATE);
}

#[test]
fn an_endless_loop_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives_in(PING, "endless loop", &[FOR_EVER], LATE + LEASH);
}

#[test]
fn services_that_ask_the_rom_for_ever_are_ended_between_two_answers() {
    let program = begins_with(&program(), &ASKS_FOR_EVER);
    outlives("asks for ever", &program, LATE + LEASH);
}

/// [`ASKS_FOR_EVER`], behind so many turns of an empty loop.
fn asks_for_ever_after(turns: u32) -> Vec<u32> {
    let wait = [
        0x0000_0293 | turns << 20, // li t0, turns
        0xfff2_8293,               // 1: addi t0, t0, -1
        0xfe02_9ee3,               // bnez t0, 1b
    ];
    let mut code = ASKS_FOR_EVER.to_vec();
    code.splice(5..5, wait);
    code
}

/// Turns of the empty loop in which the ROM answers once.
const TURNS: u32 = 36;

/// The interrupt that ends the services may come in any clock of what the ROM does for them: it
/// keeps all registers.
#[test]
fn the_leash_harms_the_rom_in_no_clock_of_what_it_does_for_the_services() {
    for turns in (1..TURNS).step_by(2) {
        let mut machine =
            BenchMachine::boot(setup(&begins_with(&program(), &asks_for_ever_after(turns))));
        let mut command = moving(&mut machine);
        let ping = machine.frame(Kind::PingArmed, &mut Pcg64Mcg::seed_from_u64(seed()));
        machine.inject(ping);
        for _ in 0..2 {
            let status = machine.exchange_and_wait(&mut command).state;
            assert_eq!(status.state, State::Armed, "{turns} turns");
        }
        assert_eq!(state(&mut machine), JobsState::Ended, "{turns} turns");
    }
}

#[test]
fn services_that_lost_their_stack_and_trap_end_themselves_and_not_the_motion() {
    let program = small(&program(), &[LOST_STACK, EBREAK]);
    outlives("lost stack", &program, LATE);
}

#[test]
fn a_stack_overflow_in_the_services_of_a_moving_machine_ends_them_and_not_the_motion() {
    outlives_in(PING, "stack overflow", &OVERFLOW, LATE);
}

#[test]
fn a_wild_store_of_the_services_to_the_gate_ends_them_and_the_gate_stays_open() {
    let control = address(watchdog::BASE, watchdog::CONTROL);
    let code = stores(&[(control, watchdog::CONTROL_KEY_STOP)]);
    outlives("a store to the gate", &small(&program(), &code), LATE);
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
    outlives("stores to registers", &small(&program(), &code), LATE);
}

#[test]
fn a_wild_store_of_the_services_does_not_reach_the_roms_memory() {
    // Every kind of its data, down to the stack.
    let first = (WINDOW_BASE + WINDOW_SIZE) as u32;
    let code = stores(&[(first, !0), (first + 0x400, !0), (first + 0x800, !0)]);
    outlives("stores to the ROM's data", &small(&program(), &code), LATE);
}

#[test]
fn services_that_store_wildly_with_interrupts_off_are_ended_when_they_return() {
    let control = address(watchdog::BASE, watchdog::CONTROL);
    let mut code = vec![
        0x0005_9663, // bnez a1, to behind `ret`
        0x0000_0513, // li a0, 0
        0x0000_8067, // ret
        NO_INTERRUPTS,
    ];
    code.extend(store(control, watchdog::CONTROL_KEY_STOP));
    code.extend([0x0000_0513, 0x0000_8067]); // li a0, 0; ret
    let program = begins_with(&program(), &code);
    outlives("a store without interrupts", &program, LATE);
}

/// What nothing in the processor ends is what the watchdog is for.
#[test]
fn services_that_loop_with_interrupts_off_stop_the_machine_when_the_watchdog_bites() {
    let program = small(&program(), &[NO_INTERRUPTS, FOR_EVER]);
    let mut machine = BenchMachine::boot(setup(&program));
    let mut command = moving(&mut machine);
    let timeout = u64::from(machine.read(map::CONFIG_BOARD));
    // The pass, which that datagram of the owner has taken back.
    machine.run_clocks(AGAIN);
    machine.exchange_and_wait(&mut command);
    let ping = machine.frame(Kind::PingArmed, &mut Pcg64Mcg::seed_from_u64(seed()));
    machine.period_with(&mut command, &[ping], 1);
    let answers = (0..4).filter(|_| machine.period_with(&mut command, &[], 0).is_some());
    let answers = answers.count();
    assert!(answers <= 1, "a pass is for one exchange, not {answers}");
    let stop = (0..3).map(|axis| machine.soft_stop_clocks(&command, axis));
    let bound = machine.clock() + timeout + stop.max().unwrap_or(0);
    machine.run_clocks(bound + timeout - machine.clock());
    assert!(!machine.gate_open());
    assert_eq!(machine.outputs(), 0);
    let last = (0..3).filter_map(|axis| machine.last_step(axis)).max();
    assert!(last.is_some_and(|last| last < bound), "{last:?}, {bound}");
}

#[test]
fn services_that_failed_are_loaded_again_at_rest_and_three_times_at_most() {
    let mut machine = BenchMachine::boot(setup(&small(&program(), &[EBREAK])));
    for life in 0..4 {
        assert!(becomes(&mut machine, JobsState::Alive, 100), "life {life}");
        // The ping ends them, and nothing answers it.
        assert!(machine.ping().is_none(), "life {life}");
        let told = match life {
            3 => JobsState::GivenUp,
            _ => JobsState::Ended,
        };
        assert_eq!(state(&mut machine), told, "life {life}");
    }
    // They would be loaded in ten.
    machine.run_millis(60);
    assert_eq!(state(&mut machine), JobsState::GivenUp);
    assert!(machine.ping().is_some(), "the ROM's");
}

#[test]
fn services_that_fail_when_they_start_leave_a_board_that_does_everything_else() {
    let mut machine = BenchMachine::boot(setup(&begins_with(&program(), &[EBREAK])));
    // They begin four times.
    assert!(becomes(&mut machine, JobsState::GivenUp, 200));
    assert!(machine.ping().is_some());
    assert!(machine.rig().tcp_connect(CONSOLE_PORT).is_err());
    moving(&mut machine);
}
