//! A card whose pins are configured, with the release image on the Verilated board: every function
//! of a board file is at its pin, without a build, and nothing else is driven.

use ferrocnc_config::{Board, Class, Level};
use ferrocnc_tests::{BenchMachine, card};
use wire::describe::{BOOT_ID_AT, FEATURE_PINS, OBSTACLE_PINS, OBSTACLES_AT, address};
use wire::exchange::{Command, PWM_ENABLE, PWM_FRACTION};
use wire::map;
use wire::pins::{Loaded, Verdict};
use wire::units::{Accel, Velocity};

/// 0.2 ms at 60 MHz: a 5 kHz PWM.
const PERIOD: u32 = 12_000;

/// What the card says became of its configuration.
fn loaded(machine: &mut BenchMachine) -> Loaded {
    Loaded::from_word(machine.read(map::FLASH_PINS)).expect("a known verdict")
}

/// The lines that the card drives, one bit each.
fn driven(machine: &mut BenchMachine) -> u64 {
    machine.rig().pins().header_drives
}

/// The lines of every pin of a file that its board drives.
fn lines_to_drive(board: &Board) -> u64 {
    let mut lines = 0;
    for class in Class::ALL {
        let drives = class.pins().iter().filter(|(_, _, drives)| *drives);
        for (key, _, _) in drives {
            for pin in board.of(class).iter().filter_map(|it| it.pin(key)) {
                lines |= 1 << board.platform.line(pin).expect("a line of the headers");
            }
        }
    }
    lines
}

/// The line of a channel with one pin, as a bit.
fn bit(board: &Board, class: Class, n: usize) -> u64 {
    let pin = board.of(class)[n].pin("pin").expect("it has a pin");
    1 << board.platform.line(pin).expect("a line of the headers")
}

/// Levels of the inputs at which no e-stop is active.
fn quiet(board: &Board) -> u64 {
    let inputs = (0..).zip(board.of(Class::Input));
    let low = inputs.filter(|(_, input)| input.estop == Some(Level::Low));
    low.map(|(n, _)| 1 << n).sum()
}

#[test]
fn a_card_without_a_configuration_describes_no_channels_and_drives_nothing() {
    let (mill, _) = card::file("mill6");
    let mut machine = BenchMachine::boot(card::setup(card::new_chip(), &mill));
    let missing = Loaded {
        verdict: Verdict::Missing,
        copy: None,
    };
    assert_eq!(loaded(&mut machine), missing);
    assert_eq!(machine.channels(), wire::describe::Channels::default());
    assert_ne!(machine.features() & FEATURE_PINS, 0);
    machine.acquire();
    let mut command = machine.enabled_command();
    command.gpio_out = u64::MAX;
    for request in [false, true, true, true] {
        command.enable_request = request;
        machine.exchange_and_wait(&mut command);
        assert_eq!(driven(&mut machine), 0);
    }
}

#[test]
fn every_function_of_the_mill_is_at_its_pin() {
    let (board, mut machine, mut command) = functions_of(card::file("mill6"));
    stops(&board, &mut machine, &mut command);
}

#[test]
fn every_function_of_two_files_of_lcnc_is_at_its_pin() {
    for name in ["75b_v8_14o11i6s6e6p", "75b_v8_26o23i6p"] {
        functions_of(card::file(name));
    }
}

#[test]
fn every_function_of_an_import_of_litexcnc_is_at_its_pin() {
    functions_of(card::imported("config/tests/samples/six_axis.json"));
}

#[test]
fn a_restart_of_the_firmware_lets_go_of_no_line_and_steps_no_axis() {
    let (board, mut machine) = started(card::file("mill6"));
    let boot = address(BOOT_ID_AT);
    let before = machine.read(boot);
    let lines = lines_to_drive(&board);
    machine.write(map::SESSION_REBOOT, map::REBOOT_KEY);
    let from = machine.clock();
    // Ten times what it takes from the reset to the first answer.
    while machine.clock() < from + 3_000_000 {
        machine.run_clocks(50);
        assert_eq!(driven(&mut machine), lines, "{}", machine.clock() - from);
        assert_eq!(machine.outputs(), board.safe_mask() ^ board.invert_mask());
    }
    assert_ne!(machine.read(boot), before, "it has restarted");
    for axis in 0..board.of(Class::Stepgen).len() {
        assert_eq!(machine.edges(axis), 0, "axis {axis}");
    }
    assert_eq!(loaded(&mut machine).verdict, Verdict::InForce);
}

#[test]
fn a_damaged_configuration_and_one_for_another_card_drive_nothing_and_the_card_does_not_arm() {
    let file = card::file("mill6");
    let mill = &file.0;
    let mut foreign = card::configuration(&file, 1);
    // Another platform; the CRC is right again.
    foreign[4 * 6] ^= 1;
    let crc = wire::crc::crc32(&foreign[16..]);
    foreign[12..16].copy_from_slice(&crc.to_be_bytes());
    let mut machine = BenchMachine::boot(card::setup(card::chip(1, &foreign), mill));
    let expected = Loaded {
        verdict: Verdict::Platform,
        copy: Some(1),
    };
    assert_eq!(loaded(&mut machine), expected);
    let obstacles = machine.read(address(OBSTACLES_AT));
    assert_eq!(obstacles & OBSTACLE_PINS, OBSTACLE_PINS);
    machine.acquire();
    let mut command = machine.enabled_command();
    for request in [false, true, true, true] {
        command.enable_request = request;
        let status = machine.exchange_and_wait(&mut command);
        assert!(!status.state.enabled && !machine.gate_open());
        assert_eq!(driven(&mut machine), 0);
    }

    // A bit that has turned over since it was written: as if there were none.
    let mut damaged = card::configuration(&file, 1);
    damaged[200] ^= 0x10;
    let mut machine = BenchMachine::boot(card::setup(card::chip(0, &damaged), mill));
    assert_eq!(loaded(&mut machine).verdict, Verdict::Missing);
    assert_eq!(driven(&mut machine), 0);
}

#[test]
fn with_the_button_held_at_power_up_nothing_is_driven() {
    let mut setup = card::configured(&card::file("mill6"));
    setup.factory = true;
    let mut machine = BenchMachine::boot(setup);
    assert_eq!(loaded(&mut machine).verdict, Verdict::FactoryPin);
    assert_eq!(driven(&mut machine), 0);
    assert_eq!(machine.channels().stepgens, 0);
}

/// A card with this configuration, described, at its safe levels, acquired and configured.
fn started(file: (Board, String)) -> (Board, BenchMachine) {
    let mut machine = BenchMachine::boot(card::configured(&file));
    let (board, _) = file;
    let name = &board.name;
    machine.inputs(quiet(&board));
    let in_force = Loaded {
        verdict: Verdict::InForce,
        copy: Some(0),
    };
    assert_eq!(loaded(&mut machine), in_force, "{name}");
    let channels = machine.channels();
    let motion = [channels.stepgens, channels.encoders, channels.pwms];
    let theirs = board.channels();
    assert_eq!(motion, [theirs.stepgens, theirs.encoders, theirs.pwms]);
    assert_eq!(driven(&mut machine), lines_to_drive(&board), "{name}");
    let safe = board.safe_mask() ^ board.invert_mask();
    assert_eq!(machine.outputs(), safe, "{name}: safe levels");
    machine.acquire();
    machine.configure();
    for n in 0..u32::from(channels.pwms) {
        machine.write(map::CONFIG_PWM + n * map::CONFIG_STRIDE, PERIOD);
    }
    (board, machine)
}

/// A card with this configuration, armed, each of whose functions but the stops has been at its
/// pin.
fn functions_of(file: (Board, String)) -> (Board, BenchMachine, Command) {
    let (board, mut machine) = started(file);
    let mut command = machine.enabled_command();
    machine.rearm(&mut command);
    step_generators_and_encoders(&board, &mut machine, &mut command);
    pwms(&board, &mut machine, &mut command);
    outputs(&board, &mut machine, &mut command);
    inputs(&board, &mut machine, &mut command);
    (board, machine, command)
}

/// Each axis moves forth and back alone: its pulses are at its pins, its encoder counts them, and
/// an index on the way is latched.
fn step_generators_and_encoders(board: &Board, machine: &mut BenchMachine, command: &mut Command) {
    let count = board.of(Class::Stepgen).len();
    let speed = Velocity::from_hz(100e3, machine.clock_hz());
    for axis in 0..count {
        let before: Vec<u64> = (0..count).map(|n| machine.edges(n)).collect();
        command.stepgen[axis] = (speed, Accel::UNLIMITED);
        machine.exchange_and_wait(command);
        machine.exchange_and_wait(command);
        (command.index_arm, command.stepgen_index_arm) = (1 << axis, 1 << axis);
        command.stepgen[axis].0 = Velocity(-speed.0);
        for _ in 0..3 {
            machine.exchange_and_wait(command);
        }
        command.stepgen[axis].0 = Velocity(0);
        machine.exchange_and_wait(command);
        let status = machine.exchange_and_wait(command);
        let pulses = machine.pulses(axis);
        assert!(pulses < -50, "axis {axis}: {pulses}");
        assert_eq!(status.stepgen[axis].0.pulses(), pulses, "axis {axis}");
        for (n, edges) in before.iter().enumerate() {
            assert_eq!(machine.edges(n) != *edges, n == axis, "axis {axis}: {n}");
        }
        if let Some(encoder) = board.of(Class::Encoder).get(axis) {
            let told = status.encoder[axis];
            let counted = (told.count.0 as i32, told.errors);
            assert_eq!(counted, (pulses as i32, 0), "encoder {axis}");
            let index = encoder.pin("index").is_some();
            assert_eq!(status.index_latched >> axis & 1 != 0, index, "{axis}");
        }
        let index = board.of(Class::Stepgen)[axis].pin("index").is_some();
        let latched = status.stepgen_index_latched >> axis & 1 != 0;
        assert_eq!(latched, index, "index of axis {axis}");
        (command.index_arm, command.stepgen_index_arm) = (0, 0);
    }
    let broken = machine.broken_rules().to_vec();
    assert_eq!(machine.timing_violations(), 0, "{broken:?}");
}

/// Each PWM alone is on for a quarter of its period at its pin.
fn pwms(board: &Board, machine: &mut BenchMachine, command: &mut Command) {
    for n in 0..board.of(Class::Pwm).len() {
        command.pwm = [0; _];
        command.pwm[n] = PWM_ENABLE | PERIOD / 4 << PWM_FRACTION;
        machine.exchange_and_wait(command);
        machine.exchange_and_wait(command);
        for other in 0..board.of(Class::Pwm).len() {
            let high = machine.pwm_high(other);
            let expected = if other == n { PERIOD / 4 } else { 0 };
            assert_eq!(high, expected, "PWM {n} at the pin of {other}");
            machine.exchange_and_wait(command);
        }
    }
    command.pwm = [0; _];
}

/// Each output alone is at its pin.
fn outputs(board: &Board, machine: &mut BenchMachine, command: &mut Command) {
    for n in 0..board.of(Class::Output).len() {
        command.gpio_out = bit(board, Class::Output, n);
        machine.exchange_and_wait(command);
        let expected = 1 << n ^ board.invert_mask();
        assert_eq!(machine.outputs(), expected, "output {n}");
    }
    command.gpio_out = 0;
}

/// Each input alone is in the status block, under the number of its line.
fn inputs(board: &Board, machine: &mut BenchMachine, command: &mut Command) {
    let ours: u64 = (0..board.of(Class::Input).len())
        .map(|n| bit(board, Class::Input, n))
        .sum();
    let at_rest = machine.exchange_and_wait(command).gpio_in;
    for (n, input) in board.of(Class::Input).iter().enumerate() {
        if input.estop.is_some() {
            continue;
        }
        machine.inputs(quiet(board) ^ 1 << n);
        machine.exchange_and_wait(command);
        let status = machine.exchange_and_wait(command);
        let changed = (status.gpio_in ^ at_rest) & ours;
        assert_eq!(changed, bit(board, Class::Input, n), "input {n}");
    }
    machine.inputs(quiet(board));
}

/// Each e-stop input closes the gate and says which it was; so does the external reset.
fn stops(board: &Board, machine: &mut BenchMachine, command: &mut Command) {
    let inputs = board.of(Class::Input).iter().enumerate();
    let estops: Vec<usize> = inputs
        .filter(|(_, input)| input.estop.is_some())
        .map(|(n, _)| n)
        .collect();
    for (k, n) in estops.iter().enumerate() {
        machine.inputs(quiet(board) ^ 1 << n);
        let clocks = until_closed(machine);
        assert!(clocks <= 8, "e-stop {k}: {clocks} clocks");
        let status = machine.exchange_and_wait(command);
        assert_eq!(status.estop, 1 << k, "e-stop {k}");
        machine.inputs(quiet(board));
        machine.run_clocks(100);
        // Its position may be another one.
        machine.acquire();
        machine.rearm(command);
    }
    machine.rig().ext_reset(true);
    let clocks = until_closed(machine);
    assert!(clocks <= 8, "external reset: {clocks} clocks");
}

/// Clocks until the gate is closed, at most 100.
fn until_closed(machine: &mut BenchMachine) -> u64 {
    let from = machine.clock();
    assert!(machine.gate_open(), "it was open");
    while machine.gate_open() && machine.clock() < from + 100 {
        machine.run_clocks(1);
    }
    machine.clock() - from
}
