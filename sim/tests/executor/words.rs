//! FPGA G's protocol.

use crate::rig::*;
use ::jobs::fpgag::{Curve, Move, status};
use wire::jobs::{self, End, Request, State, Status};

const GCODE: u8 = 1;
const STATUS: u8 = 2;
const START: u8 = 3;
const STOP: u8 = 4;

fn say(rig: &mut Rig, command: u8, form: u8, words: &[u32]) -> u32 {
    let bytes: Vec<[u8; 4]> = words.iter().map(|word| word.to_le_bytes()).collect();
    let words = jobs::Words::new(&bytes);
    jobs::word(&rig.ok(&Request::Segment {
        command,
        form,
        words,
    }))
    .unwrap()
}

/// X alone: 64 * 500 steps/s^2 for so many steps, and the other way round.
fn there(steps: u16, backwards: bool) -> Move {
    Move {
        direction: 0x60 | u8::from(backwards),
        aux: 1,
        acceleration: 500,
        loops_accel: steps,
        loops_travel: 100,
        deceleration: 500,
        loops_decel: steps,
    }
}

/// Until everything that waits is done.
fn settle(rig: &mut Rig) {
    let mut last = rig.pins();
    for _ in 0..1000 {
        rig.run(50 * MS);
        // A silent client counts as gone.
        rig.report();
        if rig.pins() == last {
            return;
        }
        last = rig.pins();
    }
    panic!("moves for ever");
}

#[test]
fn moves_are_executed_to_the_exact_step() {
    let mut rig = Rig::plotter();
    assert_eq!(say(&mut rig, GCODE, 0, &there(300, false).words()), 0);
    // Word by word, as over SPI.
    for word in there(40, true).words() {
        assert_eq!(say(&mut rig, GCODE, 0, &[word]), 0);
    }
    assert_eq!(rig.pins(), [0; 3], "not before START");
    assert_eq!(say(&mut rig, START, 0, &[]), 0);
    assert_eq!(say(&mut rig, STATUS, 0, &[]), 0);
    settle(&mut rig);
    assert_eq!(rig.pins(), [700 - 180, 0, 0]);
    assert_eq!(rig.report().state, State::Running);
    // All three motors, and one that begins with the speed the one before left.
    let all = Move {
        direction: 2,
        loops_decel: 0,
        ..there(200, false)
    };
    let on = Move {
        direction: 2,
        loops_accel: 0,
        loops_decel: 200,
        ..there(0, false)
    };
    let words = [all.words(), on.words()].concat();
    assert_eq!(say(&mut rig, GCODE, 0, &words), 0);
    settle(&mut rig);
    assert_eq!(rig.pins(), [520 + 600, -600, 600]);
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.finish().end, End::Stopped);
}

#[test]
fn words_right_behind_start_wait_until_the_board_is_armed() {
    let mut rig = Rig::plotter();
    assert_eq!(say(&mut rig, START, 0, &[]), 0);
    assert_eq!(say(&mut rig, GCODE, 0, &there(300, false).words()), 0);
    assert_eq!(rig.pins(), [0; 3], "not before it is armed");
    settle(&mut rig);
    assert_eq!(rig.pins(), [700, 0, 0]);
    // The next ones find the queue that was there.
    assert_eq!(say(&mut rig, GCODE, 0, &there(40, true).words()), 0);
    settle(&mut rig);
    assert_eq!(rig.pins(), [700 - 180, 0, 0]);
    assert_eq!(rig.command(0), Status::Normal);
    assert_eq!(rig.finish().end, End::Stopped);
}

#[test]
fn stop_keeps_the_queue_and_start_goes_on() {
    let mut rig = Rig::plotter();
    say(&mut rig, GCODE, 0, &there(300, false).words());
    say(&mut rig, GCODE, 0, &there(300, true).words());
    say(&mut rig, START, 0, &[]);
    while rig.pins() == [0; 3] {
        rig.run(MS);
    }
    assert_eq!(say(&mut rig, STOP, 0, &[]), 0);
    settle(&mut rig);
    let first = rig.pins()[0];
    assert!(
        first == 700 || first == 0,
        "a move is executed whole: {first}"
    );
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [0; 3]);
}

#[test]
fn refused_words_change_nothing_and_say_why() {
    let mut rig = Rig::plotter();
    let good = there(50, false);
    let wrong = [
        Move {
            deceleration: 0,
            ..good
        }
        .words(),
        [0x0200_0000, 0, 0, 0],
        [0x0160_0001, 0x01f4_0032, 100 << 16 | 500, 50 << 16 | 7],
        // Ends at less than nothing, is faster than the machine, and leaves its limits.
        Move {
            loops_decel: 60,
            ..good
        }
        .words(),
        Move {
            acceleration: 60_000,
            ..good
        }
        .words(),
        Move {
            loops_travel: 60_000,
            direction: 0x61,
            ..good
        }
        .words(),
    ];
    for words in wrong {
        assert_eq!(
            say(&mut rig, GCODE, 0, &words),
            status::PARSE_ERROR,
            "{words:x?}"
        );
    }
    // A motor that is on its way cannot turn.
    say(
        &mut rig,
        GCODE,
        0,
        &Move {
            loops_decel: 0,
            ..good
        }
        .words(),
    );
    let turns = Move {
        direction: 0x61,
        ..good
    };
    assert_eq!(say(&mut rig, GCODE, 0, &turns.words()), status::PARSE_ERROR);
    say(
        &mut rig,
        GCODE,
        0,
        &Move {
            loops_accel: 0,
            ..good
        }
        .words(),
    );
    assert_eq!(say(&mut rig, STATUS, 0, &[]), 0, "an error is no state");
    for _ in 2..64 {
        assert_eq!(say(&mut rig, GCODE, 0, &there(5, false).words()), 0);
    }
    assert_eq!(say(&mut rig, STATUS, 0, &[]), status::FULL);
    assert_eq!(
        say(&mut rig, GCODE, 0, &there(5, false).words()),
        status::FULL
    );
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [50 + 100 + 100 + 50 + 62 * 110, 0, 0]);
    assert_eq!(say(&mut rig, STATUS, 0, &[]), 0);
}

/// Another client takes the line, or the same one comes again.
fn comes(rig: &mut Rig, client: u32) {
    rig.client = client;
    rig.connect();
}

#[test]
fn half_an_instruction_is_completed_by_the_client_that_began_it_and_by_no_other() {
    let [first, second] = [there(300, false), there(40, false)];
    let mut rig = Rig::plotter();
    comes(&mut rig, 7);
    assert_eq!(say(&mut rig, GCODE, 0, &first.words()[..2]), 0);
    // The other half of an instruction of its own, as that client believes.
    comes(&mut rig, 8);
    assert_eq!(
        say(&mut rig, GCODE, 0, &second.words()[2..]),
        status::PARSE_ERROR
    );
    // Told once; and what comes then is whole.
    assert_eq!(say(&mut rig, GCODE, 0, &second.words()), 0);
    // The first one hears that its half is gone, too.
    comes(&mut rig, 7);
    assert_eq!(
        say(&mut rig, GCODE, 0, &first.words()[2..]),
        status::PARSE_ERROR
    );
    // Its own half, over another connection, is its own.
    assert_eq!(say(&mut rig, GCODE, 0, &first.words()[..2]), 0);
    comes(&mut rig, 7);
    assert_eq!(say(&mut rig, GCODE, 0, &first.words()[2..]), 0);
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [180 + 700, 0, 0]);
}

#[test]
fn half_an_instruction_in_one_form_is_not_dropped_for_the_other_form_without_a_word() {
    let mut rig = Rig::plotter();
    let curve = Curve {
        aux: 1,
        ticks: 100,
        motors: [[0; 3]; 3],
    };
    assert_eq!(say(&mut rig, GCODE, 0, &there(40, false).words()[..3]), 0);
    assert_eq!(say(&mut rig, GCODE, 1, &curve.words()), status::PARSE_ERROR);
    assert_eq!(say(&mut rig, GCODE, 1, &curve.words()), 0);
    assert_eq!(say(&mut rig, GCODE, 0, &there(40, false).words()), 0);
}

#[test]
fn curves_of_the_final_revision_are_drawn() {
    let mut rig = Rig::plotter();
    // Velocities in 2^-31 steps a tick: 0, 30 000 by a parabola, 158 000, 286 000, and back again:
    // 0.295 steps.
    let bits = |ticks, motor: [i32; 3]| Curve {
        aux: 1,
        ticks,
        motors: [motor, motor.map(|c| -c), [0; 3]],
    };
    for _ in 0..10 {
        for curve in [
            bits(100, [0, 0, 1]),
            bits(1000, [30_000, 64, 0]),
            bits(1000, [158_000, 64, 0]),
            bits(1000, [286_000, -64, 0]),
            bits(1000, [158_000, -64, 0]),
            bits(100, [30_000, -300, 1]),
        ] {
            assert_eq!(say(&mut rig, GCODE, 1, &curve.words()), 0, "{curve:?}");
        }
    }
    let curve = Curve {
        aux: 1,
        ticks: 1000,
        motors: [[0; 3]; 3],
    };
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    // 2.95 steps each, from the middle of a step.
    assert_eq!(rig.pins(), [3, -3, 0]);
    let jump = Curve {
        motors: [[i32::MAX, 0, 0]; 3],
        ..curve
    };
    assert_eq!(say(&mut rig, GCODE, 1, &jump.words()), status::PARSE_ERROR);
    assert_eq!(say(&mut rig, GCODE, 2, &[1]), status::PARSE_ERROR);
}

#[test]
fn a_job_and_words_do_not_mix() {
    let mut rig = Rig::plotter();
    rig.start("G1 X10 F6000\nM2\n");
    let words = jobs::Words::new(&[]);
    let start = Request::Segment {
        command: START,
        form: 0,
        words,
    };
    assert_eq!(rig.status(&start), Status::NotNow);
    assert_eq!(rig.finish().end, End::Done);
    rig.ok(&start);
    rig.run(100 * MS);
    assert_eq!(
        rig.command_with(2, jobs::UNATTENDED, 0, "job"),
        Status::NotNow
    );
    // No client sends any more: the session is over after 5 s.
    rig.run(6000 * MS);
    assert_eq!(rig.report().end, End::HostLost);
}

#[test]
fn the_stop_of_the_words_stops_a_job_and_a_homing() {
    for homes in [false, true] {
        let mut rig = Rig::switched();
        assert_eq!(
            rig.command_with(11, jobs::UNATTENDED, 0, ""),
            Status::Normal
        );
        if !homes {
            rig.finish();
            rig.start("G1 X50 F6000\nM2\n");
        }
        rig.run(100 * MS);
        say(&mut rig, STOP, 0, &[]);
        assert_eq!(rig.finish().end, End::Stopped, "homes: {homes}");
    }
}

/// The plotter with X up to so many steps from home.
fn up_to(steps: i64) -> jobs::MachineConfig {
    let mut machine = plotter();
    // 80 steps/mm.
    machine.axes[0].highest = steps * 12_500;
    machine
}

#[test]
fn a_machine_sent_behind_the_first_words_is_the_one_that_counts() {
    // 700 steps wait; with the machine that comes then 80 are allowed.
    let mut rig = Rig::plotter();
    assert_eq!(say(&mut rig, GCODE, 0, &there(300, false).words()), 0);
    rig.ok(&Request::PutMachine(up_to(80)));
    assert_eq!(
        say(&mut rig, GCODE, 0, &there(30, false).words()),
        status::PARSE_ERROR
    );
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [0; 3]);
    assert_eq!(rig.finish().end, End::Limits);

    // The same for a machine that is slower: 4400 steps/s, of 1600 allowed.
    let mut rig = Rig::plotter();
    assert_eq!(say(&mut rig, GCODE, 0, &there(300, false).words()), 0);
    let mut slow = plotter();
    slow.axes[0].max_speed = 20_000_000;
    rig.ok(&Request::PutMachine(slow));
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [0; 3]);
    assert_eq!(rig.finish().end, End::Limits);

    // And a wider machine is one, too: what it allows is done.
    let mut rig = Rig::new(sim::plant::Plant::direct(0));
    rig.ok(&Request::PutMachine(up_to(80)));
    assert_eq!(
        say(&mut rig, GCODE, 0, &there(300, false).words()),
        status::PARSE_ERROR
    );
    rig.ok(&Request::PutMachine(plotter()));
    assert_eq!(say(&mut rig, GCODE, 0, &there(300, false).words()), 0);
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    assert_eq!(rig.pins(), [700, 0, 0]);
}

#[test]
fn words_that_could_not_stop_within_the_limits_are_refused() {
    let mut rig = Rig::new(sim::plant::Plant::direct(0));
    rig.ok(&Request::PutMachine(up_to(800)));
    // 4381 steps/s at its end, which takes 30 steps to stop from.
    let dry = |travel| Move {
        loops_travel: travel,
        loops_decel: 0,
        ..there(300, false)
    };
    for travel in [475, 500] {
        let words = dry(travel).words();
        assert_eq!(say(&mut rig, GCODE, 0, &words), status::PARSE_ERROR);
    }
    assert_eq!(say(&mut rig, GCODE, 0, &dry(465).words()), 0);
    say(&mut rig, START, 0, &[]);
    settle(&mut rig);
    let x = rig.pins()[0];
    assert!((785..=800).contains(&x), "{x}");
    assert_eq!(rig.finish().end, End::Underrun);
}

#[test]
fn a_limit_between_two_steps_is_not_passed_by_the_one_behind_it() {
    let mut rig = Rig::new(sim::plant::Plant::direct(0));
    let mut machine = up_to(1000);
    // 160.5 steps below home.
    machine.axes[0].lowest = -160 * 12_500 - 6250;
    rig.ok(&Request::PutMachine(machine));
    // Until positions were sampled.
    rig.run(30 * MS);
    let beyond = Move {
        loops_travel: 61,
        ..there(50, true)
    };
    assert_eq!(
        say(&mut rig, GCODE, 0, &beyond.words()),
        status::PARSE_ERROR
    );
    let within = Move {
        loops_travel: 60,
        ..beyond
    };
    assert_eq!(say(&mut rig, GCODE, 0, &within.words()), 0);
}
