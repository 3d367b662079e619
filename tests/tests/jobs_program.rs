//! The services on the Verilated board: the release image finds them after the bitstream in the
//! flash, loads them into the SDRAM, and they answer on the jobs port. Without them, or with
//! damaged ones, everything else works.

use ferrocnc_tests::bench::Bench;
use ferrocnc_tests::flash::{self, Boots};
use ferrocnc_tests::services::{beginning, sealed};
use ferrocnc_tests::wired::{golden, mill, on_flash, program, setup};
use ferrocnc_tests::{BenchMachine, report_part};
use serde_json::json;
use sim::exchange::Spread;
use sim::lan_segment::Connection;
use sim::nor::{Part, Times};
use sim::soc::SdramLines;
use wire::describe::{FEATURE_JOBS, JobsState};
use wire::flash::{Running, Slot};
use wire::images::{Role, Trailer};
use wire::jobs::{FRAME, Frame, Op, Request, Status, Welcome};
use wire::{LongWay, map};

/// An exchange with a pass: the gateware answers.
const FAST: u64 = 20;
/// One without, while nothing else is to be done: the firmware answers.
const LATE: u64 = 5_000;
/// Words of a header: the CRC, the interface, the register map.
const INTERFACE_AT: usize = 4;
const ABI_AT: usize = 8;

/// A board with jobs, switched on with this behind the bitstream in its flash; its image runs from
/// slot A.
fn board(behind: &[u8]) -> BenchMachine {
    BenchMachine::boot(setup(behind))
}

fn features(machine: &mut BenchMachine) -> u32 {
    machine.read(wire::describe::address(wire::describe::FEATURES_AT))
}

fn services(machine: &mut BenchMachine) -> JobsState {
    JobsState::of(features(machine))
}

/// The same on a board with jobs.
fn state(machine: &mut BenchMachine) -> JobsState {
    assert_ne!(features(machine) & FEATURE_JOBS, 0, "it has segments");
    services(machine)
}

/// Says all of these in one go; the answers, in their order.
fn pipelined(
    machine: &mut BenchMachine,
    visitor: Connection,
    requests: &[Request],
) -> Vec<(Op, Status, Vec<u8>)> {
    let (mut said, mut out) = (Vec::new(), [0; FRAME]);
    for (id, request) in (1..).zip(requests) {
        let length = request.emit(id, &mut out);
        said.extend(&out[..length]);
    }
    let rig = machine.rig();
    assert_eq!(rig.segment.send(visitor, &said), said.len());
    let (mut heard, mut answers) = (Vec::new(), Vec::new());
    for _ in 0..50 {
        rig.run_ms(1);
        heard.extend(rig.segment.recv(visitor));
        while let Ok(Some((frame, length))) = Frame::parse(&heard) {
            let (op, status) = frame.answer().expect("an answer");
            answers.push((op, status, frame.payload.to_vec()));
            heard.drain(..length);
        }
        if answers.len() >= requests.len() {
            break;
        }
    }
    answers
}

/// Connects to the port of jobs and says Hello.
fn hello(machine: &mut BenchMachine) -> Option<(Connection, Welcome)> {
    let visitor = machine.rig().tcp_connect(wire::jobs::PORT).ok()?;
    let answers = pipelined(machine, visitor, &[Request::Hello { client: 7 }]);
    let [(Op::Hello, Status::Normal, welcome)] = &answers[..] else {
        return None;
    };
    Some((visitor, Welcome::parse(welcome)?))
}

/// A job that only ends, as bytes.
fn empty_job() -> Vec<u8> {
    let mut writer = jobs::job::Writer::new("x");
    let mut bytes = writer.header().to_vec();
    writer.finish(|block| bytes.extend(block));
    bytes
}

/// A board with its services does everything else, too.
fn works_otherwise(machine: &mut BenchMachine) {
    assert!(
        machine.console("status\n").contains("disarmed"),
        "the console answers"
    );
    works_for_its_host(machine);
}

/// A board without its services has no console, and works for its host.
fn works_without_services(machine: &mut BenchMachine) {
    assert!(
        machine.rig().tcp_connect(wire::CONSOLE_PORT).is_err(),
        "the port of the console does not answer"
    );
    works_for_its_host(machine);
}

/// Ping and exchange are answered, and the machine can be enabled.
fn works_for_its_host(machine: &mut BenchMachine) {
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
    let (visitor, welcome) = hello(&mut machine).expect("a welcome");
    assert_eq!((welcome.version, welcome.axes), (wire::jobs::VERSION, 3));
    assert_eq!(welcome.clock_hz, 60_000_000);
    let crc = welcome.program.to_le_bytes();
    assert_eq!(crc, program()[..4], "it knows its own CRC");
    assert!(
        welcome.room > 7 << 20,
        "8 MiB less the program: {}",
        welcome.room
    );
    // An upload of which no answer is waited for: the commit comes before the job was read through.
    let (job, name) = (empty_job(), wire::Name::new("x").expect("a name"));
    let upload = [
        Request::Put {
            total: job.len() as u32,
            crc: wire::crc::crc32(&job),
            name,
        },
        Request::Data {
            offset: 0,
            bytes: &job,
        },
        Request::Commit,
        Request::Delete { name },
    ];
    let answers = pipelined(&mut machine, visitor, &upload);
    let answers: Vec<_> = answers.iter().map(|answer| (answer.0, answer.1)).collect();
    let normal = [Op::Put, Op::Data, Op::Commit, Op::Delete].map(|op| (op, Status::Normal));
    assert_eq!(answers, normal);
    // The line is taken, and stop is taken beside it.
    let caller = machine.rig().tcp_connect(wire::jobs::PORT);
    let caller = caller.expect("a second connection");
    let stop = Request::Command {
        code: wire::jobs::JobCommand::Stop.code(),
        flags: 0,
        keepalive: 0,
        name: wire::Name::EMPTY,
    };
    let answers = pipelined(&mut machine, caller, &[Request::Hello { client: 8 }, stop]);
    let answers: Vec<_> = answers.iter().map(|answer| (answer.0, answer.1)).collect();
    assert_eq!(
        answers,
        [(Op::Hello, Status::Busy), (Op::Command, Status::Normal)]
    );
    let answers = pipelined(&mut machine, visitor, &[Request::Report]);
    assert_eq!(answers.len(), 1, "the other one is still there");
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
    let damaged = |program: &[u8], at: usize| {
        let mut bytes = program.to_vec();
        bytes[at] ^= 0x10;
        bytes
    };
    let middle = good.len() / 2;
    // What is looked at before the program runs is the same for a short one. It runs if it is
    // right.
    let short = beginning(&good);
    let boards = [
        ("none at all", Vec::new(), JobsState::Missing),
        ("one cut short", good[..middle].to_vec(), JobsState::Missing),
        ("a wrong CRC", damaged(&short, 0), JobsState::Damaged),
        (
            "a bit of its code turned over",
            damaged(&short, short.len() / 2),
            JobsState::Damaged,
        ),
        (
            "another register map",
            sealed(damaged(&short, ABI_AT)),
            JobsState::Foreign,
        ),
        (
            "another interface",
            sealed(damaged(&short, INTERFACE_AT)),
            JobsState::Foreign,
        ),
    ];
    for (what, behind, told) in boards {
        let mut machine = board(&behind);
        assert_eq!(state(&mut machine), told, "{what}");
        assert!(
            machine.rig().tcp_connect(wire::jobs::PORT).is_err(),
            "{what}: the port of jobs does not answer"
        );
        works_without_services(&mut machine);
    }
}

#[test]
fn an_image_loaded_by_jtag_has_no_program() {
    let mut setup = setup(&program());
    setup.trailer.build_id ^= 1;
    let mut machine = BenchMachine::boot(setup);
    assert_eq!(state(&mut machine), JobsState::Missing);
    works_without_services(&mut machine);
}

#[test]
fn the_gateware_answers_every_exchange_with_a_pass_while_the_services_wait() {
    // Each fourth one comes behind a lost one, and has none.
    const EXCHANGES: usize = 60;
    let mut machine = BenchMachine::boot(mill());
    assert_eq!(services(&mut machine), JobsState::Alive);
    machine.make_ready();
    let mut command = machine.enabled_command();
    machine.exchange_and_wait(&mut command);
    let before = machine.ways();
    // That was a datagram of the owner, too. It has taken the pass back.
    machine.run_millis(1);
    let (mut fast, mut long) = (Vec::new(), Vec::new());
    for n in 0..EXCHANGES {
        let lost = n % 4 == 3;
        if lost {
            machine.next_command_bytes(&mut command);
        }
        assert!(machine.exchange_and_wait(&mut command).state.accepted);
        let way = if lost { &mut long } else { &mut fast };
        way.extend(machine.turnarounds(1));
    }
    let ways = machine.ways();
    assert_eq!(ways.long - before.long, long.len() as u32);
    assert_eq!(ways.why, LongWay::Sequence);
    let [fast, long] = [fast, long].map(|all| Spread::of(&all).expect("there were some"));
    println!("turnaround with a pass {fast:?}, without one {long:?}");
    let figures = json!({"with_a_pass": fast, "without": long});
    report_part("services", "turnaround_clocks_while_services_wait", figures);
    assert!(fast.max <= FAST, "{fast:?}");
    assert!((FAST + 1..=LATE).contains(&long.max), "{long:?}");
}

#[test]
#[ignore = "named: cargo xtask test soc"]
fn the_golden_image_has_its_program_too() {
    let mut machine = BenchMachine::boot(golden(&program()));
    assert_eq!(state(&mut machine), JobsState::Alive);
    assert!(hello(&mut machine).is_some(), "a welcome");
    works_otherwise(&mut machine);
}

#[test]
#[ignore = "named: cargo xtask test soc"]
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
    let mut machine = BenchMachine::boot(on_flash(trailer, nor));
    assert_eq!(machine.read(map::FLASH_RUNNING), Running::B.code());
    assert_eq!(state(&mut machine), JobsState::Alive);
    let (_, welcome) = hello(&mut machine).expect("a welcome");
    assert_eq!(welcome.program.to_le_bytes(), program()[..4]);
    works_otherwise(&mut machine);
}

#[test]
#[ignore = "named: cargo xtask test soc"]
fn a_card_with_half_the_sdram_has_half_the_room() {
    let mut setup = setup(&program());
    setup.shorted.row = 1 << 10;
    let mut machine = BenchMachine::boot(setup);
    assert_eq!(state(&mut machine), JobsState::Alive);
    let room = hello(&mut machine).expect("a welcome").1.room;
    assert!((3 << 20..4 << 20).contains(&room), "{room} of 4 MiB");
    works_otherwise(&mut machine);
}

#[test]
fn an_sdram_with_a_line_shorted_to_ground_has_no_jobs_and_everything_else_works() {
    let line = |data, row| SdramLines { data, row, high: 0 };
    // What a line of the data does shows without the rest of the program, which tests the rest of
    // the SDRAM.
    for (what, mut board, lines, told) in [
        (
            "a line of the data",
            setup(&beginning(&program())),
            line(1 << 19, 0),
            JobsState::Damaged,
        ),
        (
            "a row's line beyond the program",
            mill(),
            line(0, 1 << 8),
            JobsState::Sdram,
        ),
    ] {
        board.shorted = lines;
        let mut machine = BenchMachine::boot(board);
        assert_eq!(services(&mut machine), told, "{what}");
        assert!(
            machine.rig().tcp_connect(wire::jobs::PORT).is_err(),
            "{what}: the port of jobs does not answer"
        );
        works_without_services(&mut machine);
    }
}
