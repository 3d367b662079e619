//! A job is executed when the services fail.

use ferrocnc_tests::BenchMachine;
use ferrocnc_tests::drawing;
use ferrocnc_tests::services::{broken, sealed};
use ferrocnc_tests::wired::{Wired, program, setup};
use host::job::program::{Dialect, Program};
use wire::describe::JobsState;
use wire::state::{FaultReason, State};

use crate::{EBREAK, state};

const MS: u64 = 60_000;
/// mm/s, and mm/s^2: a stop takes a twentieth of a second.
const SPEED: f64 = 100.0;
const ACCELERATION: f64 = 2_000.0;
/// Steps of the first axis on its way.
const EDGES: u64 = 400;
/// More than what the queue holds, and the time of the watchdog.
const QUEUE_MS: u64 = 150;

#[test]
fn a_job_whose_services_fail_in_mid_motion_ends_with_each_axis_braking_in_its_own_way() {
    let code = sealed(broken(program(), "icmpv4_reply", &[EBREAK]));
    let mut wired = Wired::around(BenchMachine::boot(setup(&code)));
    let mut machine = drawing::machine();
    for axis in [&mut machine.x, &mut machine.y] {
        (axis.speed, axis.acceleration) = (SPEED, ACCELERATION);
    }
    wired.judge(&machine);
    let text = b"M3\nG1 X80 Y40 F12000\nG1 X0 Y0\nM5\nM2\n";
    let program = Program::from_gcode(text, Dialect::default().dwell);
    let mut program = program.unwrap_or_else(|error| panic!("{error}"));
    program.name = "under way".to_owned();
    let started = wired.with(|board| {
        board.put_machine(&machine.to_board())?;
        board.send(&program.name, &program.to_job(), |_, _| ())?;
        board.start(&program.name, None)
    });
    started.unwrap_or_else(|error| panic!("{error}"));
    for _ in 0..300 {
        if wired.machine.edges(0) > EDGES {
            break;
        }
        wired.run(MS);
    }
    let edges = wired.machine.edges(0);
    assert!(wired.machine.gate_open() && edges > EDGES, "{edges} edges");
    assert!(wired.machine.ping().is_none(), "the services answer a ping");

    // The queue runs empty, or the watchdog bites.
    let failed = wired.machine.clock();
    let mut moving = wired.steps();
    let mut rest = None;
    for _ in 0..QUEUE_MS + 100 {
        wired.machine.rig().run(MS);
        let now = wired.steps();
        if now == moving && !wired.machine.gate_open() {
            rest = Some(wired.machine.clock() - failed);
            break;
        }
        moving = now;
    }
    println!(
        "at rest {rest:?} clocks behind the failure, {:?}",
        wired.steps()
    );
    let rest = rest.expect("the axes come to rest");
    let longest = (QUEUE_MS + (1e3 * SPEED / ACCELERATION) as u64) * MS;
    assert!(rest <= longest, "{rest} clocks, {longest} are allowed");
    assert_eq!(wired.machine.outputs() & 1, 0, "the pen is up");
    assert_eq!(wired.machine.timing_violations(), 0);

    // What the ROM has counted is what left the pins, and it says why it stopped.
    let stood = wired.steps();
    wired.machine.acquire();
    let mut command = wired.machine.enabled_command();
    command.enable_request = false;
    let status = wired.machine.exchange_and_wait(&mut command);
    assert_eq!(status.state.state, State::Faulted, "{:?}", status.state);
    assert_eq!(status.state.reason, FaultReason::Watchdog);
    assert!(status.state.position_trusted, "{:?}", status.state);
    assert_eq!(state(&mut wired.machine), JobsState::Ended);
    for (axis, stood) in stood.into_iter().enumerate() {
        let told = status.stepgen[axis].0.pulses();
        assert_eq!(told, stood, "axis {axis}");
    }
    assert_eq!(wired.steps(), stood, "nothing moves any more");
}
