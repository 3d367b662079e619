//! Their SDRAM turns bits over, dies while the machine moves, or is dead when the board starts.

use ferrocnc_tests::flood::Kind;
use ferrocnc_tests::services::{Part, judged_by, small};
use ferrocnc_tests::wired::{golden, mill, program, program_without_jobs, setup};
use ferrocnc_tests::{BenchMachine, report_part, seed};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use sim::lan_segment::CONSOLE_PORT;
use sim::soc::SdramLines;
use wire::describe::JobsState;
use wire::exchange::Command;
use wire::flash::Running;
use wire::map;
use wire::state::State;

use crate::told::LOADING_MS;
use crate::update::{answers_without_services, is_brought_an_image};
use crate::{EBREAK, FAST, becomes, moving, state};

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
    let mut worst = 0;
    let before: Vec<_> = (0..3).map(|axis| machine.edges(axis)).collect();
    for period in 0..48 {
        rots(machine, period, rng);
        let frames = [machine.frame(CLIENTS[period as usize % CLIENTS.len()], rng)];
        let answer = machine.period_with(&mut command, &frames, 1);
        let answer = answer.unwrap_or_else(|| panic!("{what}: no answer in period {period}"));
        assert_eq!(answer.status.state.state, State::Armed, "{what}: {period}");
        worst = worst.max(answer.turnaround);
    }
    assert!(worst <= FAST, "{what}: {worst} clocks");
    assert!(machine.gate_open(), "{what}");
    machine.comes_to_rest(&mut command, what);
    for (axis, before) in before.into_iter().enumerate() {
        assert!(machine.edges(axis) > before, "{what}: axis {axis} moved");
    }
    // They may end between two answers; while a host owns the board none are loaded.
    let before = state(machine);
    let shown = machine.exchange_and_wait(&mut command).state.services;
    let told = state(machine);
    let right = [before, told].contains(&shown);
    assert!(
        right,
        "{what}: HAL shows {shown:?} between {before:?} and {told:?}"
    );
    machine.release();
    (told, worst)
}

/// Longest wait until a bit that has turned over is noticed while no host owns the board.
const SWEEP_MS: u64 = 300;

#[test]
fn bits_that_turn_over_in_the_services_of_a_moving_machine_end_them_at_most() {
    let code = program_without_jobs();
    let mut machine = BenchMachine::boot(mill());
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
        report_part(
            "services",
            &format!("{bits} bits of {part:?}"),
            worst.into(),
        );
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
    assert_eq!(state(&mut machine), JobsState::GivenUp);
    assert!(machine.ping().is_some(), "the ROM's");
    moving(&mut machine);
}

#[test]
fn a_bit_of_the_services_that_turns_over_at_rest_is_noticed_and_they_are_loaded_again() {
    let code = program_without_jobs();
    let mut machine = BenchMachine::boot(mill());
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
#[ignore = "named: cargo xtask test soc"]
fn an_sdram_that_dies_while_the_machine_moves_ends_the_services_and_not_the_motion() {
    let lines = |data, high| SdramLines { data, high, row: 0 };
    for (what, lines) in [
        ("all of it reads 0", lines(u32::MAX, 0)),
        ("a line is shorted to the supply", lines(0, 1 << 6)),
    ] {
        let mut machine = BenchMachine::boot(mill());
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

/// What is summed is what the SDRAM has kept, and not what came from the flash.
#[test]
fn a_line_that_is_low_wherever_the_header_is_low_too_starts_no_program() {
    let (good, line) = (1..)
        .find_map(|times| {
            let good = small(&program(), &vec![EBREAK; times]);
            let set = judged_by(&good).iter().fold(0, |set, word| set | word);
            (set != u32::MAX).then(|| (good, set.trailing_ones()))
        })
        .expect("a line");
    let mut setup = setup(&good);
    setup.shorted = SdramLines {
        data: 1 << line,
        high: 0,
        row: 0,
    };
    let mut machine = BenchMachine::boot(setup);
    assert_eq!(state(&mut machine), JobsState::Damaged, "line {line}");
    answers_without_services(&mut machine, "a line that is low");
}

#[test]
fn a_board_whose_sdram_is_dead_when_it_starts_does_all_that_needs_none_and_takes_an_update() {
    let lines = |data, high| SdramLines { data, high, row: 0 };
    let good = small(&program(), &[EBREAK]);
    for (what, lines, setup, runs) in [
        ("reads 0", lines(u32::MAX, 0), setup(&good), Running::A),
        ("reads 1", lines(0, u32::MAX), setup(&good), Running::A),
        (
            "golden, reads 0",
            lines(u32::MAX, 0),
            golden(&good),
            Running::Golden,
        ),
    ] {
        let mut setup = setup;
        setup.shorted = lines;
        let flash = setup.flash.clone().expect("a flash");
        let mut machine = BenchMachine::boot(setup);
        assert_eq!(machine.read(map::FLASH_RUNNING), runs.code(), "{what}");
        assert_eq!(state(&mut machine), JobsState::Damaged, "{what}");
        answers_without_services(&mut machine, what);
        is_brought_an_image(&mut machine, &flash, what);
    }
}
