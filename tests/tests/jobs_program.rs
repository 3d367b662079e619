//! The jobs program on the Verilated board: the release image finds it behind the bitstream in the flash, puts it into the SDRAM
//! and lets it answer on the port of jobs; and without it, or with a damaged one, everything else works as ever.

use ferrocnc_tests::Machine;
use ferrocnc_tests::bench::Bench;
use ferrocnc_tests::flash::{self, Boots};
use ferrocnc_tests::wired::{golden, on_flash, program, setup};
use sim::nor::{Part, Times};
use sim::soc::SdramLines;
use wire::describe::{FEATURE_JOBS, JobsState};
use wire::flash::{Running, Slot};
use wire::images::{Role, Trailer};
use wire::jobs::{Frame, Op, Request, Status, Welcome};
use wire::map;

/// Words of a header: the CRC, the interface, the register map.
const INTERFACE_AT: usize = 4;
const ABI_AT: usize = 8;

/// A board with jobs, switched on with this behind the bitstream in its flash; its image runs from slot A.
fn board(behind: &[u8]) -> Machine {
    Machine::boot(setup(behind))
}

fn state(machine: &mut Machine) -> JobsState {
    let features = machine.read(map::DESCRIBE + 9 * 4);
    assert_ne!(features & FEATURE_JOBS, 0, "the gateware has segments");
    JobsState::of(features)
}

/// Connects to the port of jobs and says who is there.
fn hello(machine: &mut Machine) -> Option<Welcome> {
    let mut request = [0; wire::jobs::FRAME];
    let length = Request::Hello { client: 7 }.emit(1, &mut request);
    let rig = machine.rig();
    let visitor = rig.tcp_connect(wire::jobs::PORT).ok()?;
    assert_eq!(rig.segment.send(visitor, &request[..length]), length);
    let mut heard = Vec::new();
    for _ in 0..50 {
        rig.run_ms(1);
        heard.extend(rig.segment.recv(visitor));
        if let Ok(Some((frame, _))) = Frame::parse(&heard) {
            assert_eq!(frame.answer(), Some((Op::Hello, Status::Normal)));
            return Welcome::parse(frame.payload);
        }
    }
    None
}

/// Words again behind a change: the CRC made right.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let words: Vec<u32> = bytes
        .as_chunks()
        .0
        .iter()
        .map(|word| u32::from_le_bytes(*word))
        .collect();
    let crc = wire::crc::crc32_words(&words[1..]);
    bytes[..4].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// The board without jobs is the board there always was.
fn works_otherwise(machine: &mut Machine) {
    assert!(
        machine.console("status\n").contains("disarmed"),
        "the console answers"
    );
    assert!(machine.ping().is_some(), "a ping is answered");
    machine.make_ready();
    let mut command = machine.enabled_command();
    assert!(machine.exchange(&mut command).state.accepted);
}

#[test]
fn the_program_is_found_in_the_flash_and_answers_on_its_port() {
    let mut machine = board(&program());
    println!("started after {} clocks", machine.clock());
    assert_eq!(state(&mut machine), JobsState::Alive);
    let welcome = hello(&mut machine).expect("a welcome");
    assert_eq!((welcome.version, welcome.axes), (wire::jobs::VERSION, 3));
    assert_eq!(welcome.clock_hz, 60_000_000);
    let crc = welcome.program.to_le_bytes();
    assert_eq!(crc, program()[..4], "it knows its own CRC");
    assert!(
        welcome.room > 7 << 20,
        "8 MiB less the program: {}",
        welcome.room
    );
    let said = machine.console("job list\njob\nnet\n");
    let room = welcome.room;
    for line in [
        &format!("{room} of {room} bytes are free\r\n"),
        "stopped\r\nat steps 0, 0, 0, position not trusted, no machine description\r\n",
        "; refused 0\r\n",
    ] {
        assert!(said.contains(line), "{line:?} is not in {said}");
    }
    works_otherwise(&mut machine);
}

#[test]
fn without_a_whole_program_of_this_build_there_are_no_jobs_and_everything_else_works() {
    let good = program();
    let damaged = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 0x10;
        bytes
    };
    let middle = good.len() / 2;
    let boards = [
        ("none at all", Vec::new(), JobsState::Missing),
        ("one cut short", good[..middle].to_vec(), JobsState::Missing),
        ("a wrong CRC", damaged(0), JobsState::Damaged),
        (
            "a bit of its code turned over",
            damaged(middle),
            JobsState::Damaged,
        ),
        (
            "another register map",
            sealed(damaged(ABI_AT)),
            JobsState::Foreign,
        ),
        (
            "another interface",
            sealed(damaged(INTERFACE_AT)),
            JobsState::Foreign,
        ),
    ];
    let switch_on = |boards: &[(&str, Vec<u8>, JobsState)]| {
        for (what, behind, told) in boards {
            let mut machine = board(behind);
            assert_eq!(state(&mut machine), *told, "{what}");
            assert!(
                machine.rig().tcp_connect(wire::jobs::PORT).is_err(),
                "{what}: nobody answers there"
            );
            let said = machine.console("job stop\n");
            assert!(said.contains("no jobs here"), "{what}: {said}");
            works_otherwise(&mut machine);
        }
    };
    // This one begins last and takes longest.
    let (some, others) = boards.split_at(boards.len() / 2);
    std::thread::scope(|scope| {
        scope.spawn(|| switch_on(some));
        switch_on(others);
    });
}

#[test]
fn an_image_loaded_by_jtag_has_no_program() {
    let mut setup = setup(&program());
    setup.trailer.build_id ^= 1;
    let mut machine = Machine::boot(setup);
    assert_eq!(state(&mut machine), JobsState::Missing);
    works_otherwise(&mut machine);
}

#[test]
fn an_exchange_is_answered_within_a_thousand_clocks_while_the_program_waits() {
    const EXCHANGES: usize = 300;
    let mut machine = board(&program());
    assert_eq!(state(&mut machine), JobsState::Alive);
    machine.make_ready();
    let mut command = machine.enabled_command();
    for _ in 0..EXCHANGES {
        assert!(machine.exchange_and_wait(&mut command).state.accepted);
    }
    let spread = machine.turnaround_spread(EXCHANGES);
    println!("turnaround {spread:?}");
    assert!(spread.max < 1000, "{spread:?}");
}

#[test]
fn the_golden_image_has_its_program_too() {
    let mut machine = Machine::boot(golden(&program()));
    assert_eq!(state(&mut machine), JobsState::Alive);
    assert!(hello(&mut machine).is_some(), "a welcome");
    works_otherwise(&mut machine);
}

#[test]
fn an_update_brings_the_jobs_program_of_its_image_along() {
    const NEXT: u32 = 0xbbbb_0002;
    let image = flash::with_program(&flash::image(NEXT, 3), &program());
    let mut bench = Bench::new(flash::factory(Part::W25Q32JV.with(Times::QUICK), 7));
    assert_eq!(bench.bring(NEXT, &image), None);
    let nor = bench.nor().copy();
    assert_eq!(flash::boots(&nor), Boots::Slot(Slot::B, NEXT));
    let trailer = Trailer {
        build_id: NEXT,
        role: Role::Image,
    };
    let mut machine = Machine::boot(on_flash(trailer, nor));
    assert_eq!(machine.read(map::FLASH_RUNNING), Running::B.code());
    assert_eq!(state(&mut machine), JobsState::Alive);
    let welcome = hello(&mut machine).expect("a welcome");
    assert_eq!(welcome.program.to_le_bytes(), program()[..4]);
    works_otherwise(&mut machine);
}

#[test]
fn a_card_with_half_the_sdram_has_half_the_room() {
    let mut setup = setup(&program());
    setup.shorted.row = 1 << 10;
    let mut machine = Machine::boot(setup);
    assert_eq!(state(&mut machine), JobsState::Alive);
    let room = hello(&mut machine).expect("a welcome").room;
    assert!((3 << 20..4 << 20).contains(&room), "{room} of 4 MiB");
    works_otherwise(&mut machine);
}

#[test]
fn an_sdram_with_a_line_shorted_to_ground_has_no_jobs_and_everything_else_works() {
    for (what, data, row, told) in [
        ("a line of the data", 1 << 19, 0, JobsState::Damaged),
        (
            "a row's line beyond the program",
            0,
            1 << 8,
            JobsState::Sdram,
        ),
    ] {
        let mut setup = setup(&program());
        setup.shorted = SdramLines { data, row };
        let mut machine = Machine::boot(setup);
        assert_eq!(state(&mut machine), told, "{what}");
        assert!(
            machine.rig().tcp_connect(wire::jobs::PORT).is_err(),
            "{what}: nobody answers there"
        );
        works_otherwise(&mut machine);
    }
}
