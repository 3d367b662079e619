use super::*;

/// A quadrature counter as simple as can be.
#[derive(Default)]
struct QuadratureCounter {
    count: i64,
    last: (u16, u16),
    illegal: u32,
}

impl QuadratureCounter {
    fn see(&mut self, levels: Levels) {
        let now = (levels.a & 1, levels.b & 1);
        let state = |(a, b): (u16, u16)| i64::from(if b == 0 { a } else { 3 - a });
        match (state(now) - state(self.last)).rem_euclid(4) {
            1 => self.count += 1,
            3 => self.count -= 1,
            2 => self.illegal += 1,
            _ => {}
        }
        self.last = now;
    }
}

fn follow(axis: Axis, steps: &[(u64, i64)], clocks: u64) -> (QuadratureCounter, Plant) {
    let mut plant = Plant::new([axis]);
    let mut counter = QuadratureCounter::default();
    let mut steps = steps.iter().peekable();
    for clock in 0..clocks {
        if let Some((_, by)) = steps.next_if(|(at, _)| *at == clock) {
            plant.steps(u16::from(*by > 0), u16::from(*by < 0));
        }
        if clock >= plant.next() {
            plant.turn(clock);
        }
        counter.see(plant.levels());
    }
    (counter, plant)
}

#[test]
fn counts_follow_steps_both_ways() {
    let steps: Vec<_> = (0..100)
        .map(|i| (i * 10, if i < 70 { 1 } else { -1 }))
        .collect();
    let (counter, plant) = follow(Axis::direct(0), &steps, 2000);
    assert_eq!((counter.count, counter.illegal), (40, 0));
    assert_eq!(plant.encoder_count(0), Some(40));
    assert_eq!(plant.next(), u64::MAX);
}

#[test]
fn a_finer_encoder_makes_every_edge_in_between() {
    let axis = Axis {
        counts: 10,
        per_steps: 1,
        ..Axis::direct(0)
    };
    let (counter, _) = follow(axis, &[(0, 1), (100, 1), (200, -1)], 1000);
    assert_eq!((counter.count, counter.illegal), (10, 0));
}

#[test]
fn a_coarser_and_a_mirrored_encoder() {
    let axis = Axis {
        counts: -1,
        per_steps: 4,
        ..Axis::direct(0)
    };
    let steps: Vec<_> = (0..40).map(|i| (i * 10, 1)).collect();
    let (counter, _) = follow(axis, &steps, 1000);
    assert_eq!((counter.count, counter.illegal), (-10, 0));
}

#[test]
fn edges_keep_their_gap() {
    let mut plant = Plant::new([Axis {
        counts: 100,
        gap: 7,
        ..Axis::direct(0)
    }]);
    plant.steps(1, 0);
    let edges: Vec<u64> = (0..1000).filter(|clock| plant.turn(*clock)).collect();
    assert_eq!(edges.len(), 100);
    assert!(edges.windows(2).all(|w| w[1] - w[0] == 7));
}

#[test]
fn index_comes_once_per_revolution() {
    let mut plant = Plant::new([Axis {
        counts_per_rev: 8,
        gap: 1,
        ..Axis::direct(0)
    }]);
    let mut seen = vec![];
    for clock in 0..17 {
        if plant.levels().index & 1 != 0 {
            seen.push(plant.encoder_count(0).unwrap());
        }
        plant.steps(1, 0);
        plant.turn(clock);
    }
    assert_eq!(seen, [0, 8, 16]);
}

#[test]
fn wires_and_switches_reach_the_inputs() {
    let mut plant = Plant::default();
    plant.add_wire(Wire {
        output: 3,
        input: 5,
        inverted: false,
    });
    plant.add_wire(Wire {
        output: 4,
        input: 6,
        inverted: true,
    });
    plant.add_switch(Switch {
        stepgen: 1,
        at: -2,
        above: false,
        input: 9,
        inverted: false,
    });
    assert_eq!(plant.gpio_mask(), 1 << 5 | 1 << 6 | 1 << 9);
    assert_eq!(plant.levels().gpio, 1 << 6);
    plant.outputs(0x18);
    assert_eq!(plant.levels().gpio, 1 << 5);
    plant.steps(0, 2);
    assert_eq!(plant.levels().gpio, 1 << 5);
    plant.steps(0, 2);
    assert_eq!(plant.levels().gpio, 1 << 5 | 1 << 9);
}

#[test]
fn a_slipped_shaft_stays_slipped() {
    let mut plant = Plant::direct(1);
    plant.slip(0, 25);
    for clock in 0..1000 {
        plant.turn(clock);
    }
    plant.steps(1, 0);
    for clock in 1000..1100 {
        plant.turn(clock);
    }
    assert_eq!(plant.encoder_count(0), Some(26));
}

#[test]
fn an_index_reaches_encoder_and_stepgen_at_its_count() {
    let mut plant = Plant::new([Axis {
        counts_per_rev: 8,
        index_at: 3,
        ..Axis::direct(2)
    }]);
    let mut seen = vec![];
    for clock in 0..100 {
        let levels = plant.levels();
        assert_eq!(levels.index, levels.step_index);
        if levels.index == 4 {
            seen.push(plant.encoder_count(2).unwrap());
        }
        if clock % 8 == 0 {
            plant.steps(4, 0);
        }
        if clock >= plant.next() {
            plant.turn(clock);
        }
    }
    seen.dedup();
    assert_eq!(seen, [3, 11]);
}

/// A PWM of 3000 clocks at `duty` percent for `clocks`, from `start`; returns the counter and
/// the indexes seen.
fn spin(
    plant: &mut Plant,
    start: u64,
    clocks: u64,
    duty: u64,
    dir: u16,
) -> (QuadratureCounter, u32) {
    let (mut counter, mut indexes, mut index_was) = (QuadratureCounter::default(), 0, true);
    let last = plant.levels();
    counter.last = (last.a & 1, last.b & 1);
    for clock in start..start + clocks {
        match (clock - start) % 3000 {
            0 => plant.pwm(clock, u16::from(duty != 0), dir),
            n if n == duty * 30 => plant.pwm(clock, u16::from(duty == 100), dir),
            _ => {}
        }
        if clock >= plant.next() {
            plant.turn(clock);
        }
        counter.see(plant.levels());
        let index = plant.levels().index & 1 != 0;
        indexes += u32::from(index && !index_was);
        index_was = index;
    }
    (counter, indexes)
}

#[test]
fn a_spindle_follows_its_duty_and_shows_an_index_per_turn() {
    let mut plant = Plant::default();
    plant.set_clock(1_000_000);
    plant
        .parse("[[spindle]]\npwm = 0\nencoder = 0\ncounts_per_rev = 100\nmax_rps = 50\nlag_ms = 20")
        .unwrap();
    spin(&mut plant, 0, 300_000, 60, 0);
    assert!((plant.spindle_rps(0).unwrap() - 30.0).abs() < 1.5);
    let (counter, indexes) = spin(&mut plant, 300_000, 1_002_000, 60, 0);
    assert!((2990..=3020).contains(&counter.count), "{}", counter.count);
    assert!((29..=31).contains(&indexes), "{indexes}");
    assert_eq!(counter.illegal, 0);
    // Reversed it passes through zero and counts down; without pulses it comes to rest and asks
    // for no more time.
    spin(&mut plant, 1_302_000, 300_000, 60, 1);
    assert!((plant.spindle_rps(0).unwrap() + 30.0).abs() < 1.5);
    let (counter, _) = spin(&mut plant, 1_602_000, 600_000, 0, 0);
    assert!(counter.count < 0 && counter.illegal == 0);
    assert_eq!((plant.next(), plant.spindle_rps(0)), (u64::MAX, Some(0.0)));
}

#[test]
fn a_spindle_wants_its_enable() {
    let mut plant = Plant::default();
    plant.set_clock(1_000_000);
    plant
        .parse("[[spindle]]\npwm = 0\nencoder = 0\nmax_rps = 50\nenable_output = 3\nup_down = true")
        .unwrap();
    spin(&mut plant, 0, 90_000, 50, 0);
    assert_eq!(plant.encoder_count(0), Some(0));
    plant.outputs(8);
    spin(&mut plant, 90_000, 90_000, 50, 0);
    assert!(plant.encoder_count(0).unwrap() > 100);
}

#[test]
fn a_probe_closes_and_opens_at_its_position() {
    let mut plant = Plant::default();
    plant
        .parse("[[switch]]\nstepgen = 1\nat = 2\nabove = true\ninput = 6\ninverted = true")
        .unwrap();
    let mut levels = vec![];
    for (forward, backward) in [(2, 0), (2, 0), (2, 0), (0, 2), (0, 2)] {
        plant.steps(forward, backward);
        levels.push(plant.levels().gpio >> 6);
    }
    assert_eq!(levels, [1, 0, 0, 0, 1]);
}

#[test]
fn the_example_is_a_plant() {
    let mut plant = Plant::default();
    plant
        .parse(include_str!("../../plant.example.toml"))
        .unwrap();
    assert_eq!(plant.gpio_mask(), 1 << 6 | 1 << 7 | 1 << 8);
    assert_eq!(plant.spindle_rps(5), Some(0.0));
}

#[test]
fn a_plant_file_says_what_is_wrong_with_it() {
    let refused = |text: &str| Plant::default().parse(text).unwrap_err();
    assert!(refused("[[axis]]\nstepgen = 16\nencoder = 0").contains("axis.stepgen 16"));
    assert!(refused("[[axis]]\nstepgen = 0\nencoder = 0\nspeed = 1").contains("speed"));
}

#[test]
fn each_of_two_switches_at_one_input_presses_it_closed_or_open() {
    for inverted in [false, true] {
        let mut plant = Plant::default();
        for (at, above) in [(2, true), (-2, false)] {
            plant.add_switch(Switch {
                stepgen: 0,
                at,
                above,
                input: 3,
                inverted,
            });
        }
        let mut pressed = |forward, backward| {
            plant.steps(forward, backward);
            plant.steps(forward, backward);
            (plant.levels().gpio >> 3 & 1 != 0) != inverted
        };
        assert!(pressed(1, 0), "two steps up");
        assert!(!pressed(0, 1), "back again");
        assert!(pressed(0, 1), "two steps down");
    }
}
