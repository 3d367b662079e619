extern crate std;

use super::*;
use proptest::prelude::*;
use std::vec::Vec;

fn frame_of(request: &Request, id: u16) -> Vec<u8> {
    let mut out = [0; FRAME];
    let length = request.emit(id, &mut out);
    out[..length].to_vec()
}

fn payload_of(fill: impl FnOnce(&mut Writer)) -> Vec<u8> {
    let mut out = [0; FRAME];
    let length = answer(Op::Report.code(), Status::Normal, 1, &mut out, fill);
    let (frame, whole) = Frame::parse(&out[..length]).unwrap().unwrap();
    assert_eq!(whole, length);
    assert_eq!(frame.answer(), Some((Op::Report, Status::Normal)));
    frame.payload.to_vec()
}

/// A typical plotter.
pub fn plotter() -> MachineConfig {
    let axis = Axis {
        steps_per_km: 80_000_000,
        max_speed: 200_000_000,
        max_accel: 2_000_000_000,
        lowest: 0,
        highest: 300_000_000,
        steplen: 2000,
        stepspace: 2000,
        dirsetup: 5000,
        dirhold: 5000,
        step_invert: false,
        dir_invert: true,
        home: Some(Home {
            plus: false,
            low: true,
            input: 3,
            order: 1,
            fast: 50_000_000,
            slow: 2_000_000,
            backoff: 2_000_000,
            travel: 400_000_000,
            timeout: 30_000,
            debounce: 100,
        }),
    };
    MachineConfig {
        chord_tolerance: 10_000,
        junction_deviation: 20_000,
        tool_delay: 150_000,
        outputs: 1,
        beam: 0,
        invert: 0,
        safe: 0,
        axes: [axis; AXES],
    }
}

#[test]
fn a_frame_is_the_bytes_the_description_says() {
    let bytes = frame_of(&Request::Feed { percent: 150 }, 0x1234);
    assert_eq!(bytes[..10], [12, 0, 0x34, 0x12, 2, 0, 0, 0, 150, 0]);
    assert_eq!(bytes[10..], crc32(&bytes[..10]).to_le_bytes());
    assert_eq!(bytes.len(), OVERHEAD + 2);
}

#[test]
fn every_code_is_its_own_values_and_no_other() {
    macro_rules! every {
        ($($name:ident),+) => {$(
            let known = (0..=255).filter_map($name::from_code).map(|value| {
                assert_eq!($name::from_code(value.code()), Some(value));
            });
            assert_eq!(known.count(), $name::ALL.len(), stringify!($name));
        )+};
    }
    every!(Op, Status, JobCommand, State, End);
}

#[test]
fn the_codes_are_those_of_xypenplotter_and_one_above_them() {
    let codes = [0, 1, 2, 9, 10, 11, 12, JobCommand::Here as u8];
    let known = (0..=255u8).filter(|code| JobCommand::from_code(*code).is_some());
    assert!(known.eq(codes));
    for (state, code) in [
        (State::Stopped, 0),
        (State::Running, 1),
        (State::Paused, 10),
        (State::Calibrating, 11),
    ] {
        assert_eq!(state.code(), code);
    }
}

#[test]
fn a_machine_is_as_long_as_it_says_and_is_the_one_that_was_put() {
    let machine = plotter();
    let payload = payload_of(|payload| {
        machine.emit(payload);
    });
    assert_eq!(payload.len(), MachineConfig::BYTES);
    assert_eq!(MachineConfig::parse(&payload), Ok(machine));
    assert_eq!(machine.check(60_000_000, 4, 1), Ok(()));
    assert_eq!(machine.check(60_000_000, 64, 64), Ok(()));
}

#[test]
fn what_is_wrong_with_a_machine_is_named_with_its_axis() {
    let wrong = |change: fn(&mut MachineConfig), field, axis| {
        let mut machine = plotter();
        change(&mut machine);
        assert_eq!(
            machine.check(60_000_000, 4, 1),
            Err((field, axis)),
            "{machine:?}"
        );
        assert_eq!(Field::from_code(field as u8), Some(field));
    };
    wrong(|m| m.chord_tolerance = 999, Field::ChordTolerance, 0);
    wrong(|m| m.outputs = 2, Field::Board, 0);
    wrong(|m| m.axes[1].steps_per_km = 0, Field::Scale, 1);
    wrong(|m| m.axes[2].max_speed = 0, Field::Speed, 2);
    wrong(|m| m.axes[0].max_accel = 0, Field::Acceleration, 0);
    wrong(|m| m.axes[0].lowest = 300_000_001, Field::Limits, 0);
    wrong(|m| m.axes[1].highest = i64::MAX, Field::Limits, 1);
    wrong(|m| m.axes[1].steplen = 0, Field::StepTiming, 1);
    wrong(|m| m.axes[1].dirhold = 2_000_000, Field::StepTiming, 1);
    // 16 000 steps/s have 62.5 us each.
    wrong(|m| m.axes[1].stepspace = 61_000, Field::TooFast, 1);
    let home: fn(&mut MachineConfig) -> &mut Home = |m| m.axes[2].home.as_mut().unwrap();
    let wrong = |change: fn(&mut Home)| {
        let mut machine = plotter();
        change(home(&mut machine));
        assert_eq!(machine.check(60_000_000, 4, 1), Err((Field::Home, 2)));
    };
    wrong(|home| home.input = 4);
    wrong(|home| home.fast = 0);
    wrong(|home| home.slow = 200_000_001);
    wrong(|home| home.backoff = 0);
    wrong(|home| home.timeout = 0);
    wrong(|home| home.travel = 0);
}

#[test]
fn timings_are_never_shorter_than_asked_for() {
    assert_eq!(plotter().axes[0].timings(60_000_000), [120, 120, 300, 300]);
    let mut axis = plotter().axes[0];
    axis.steplen = 1;
    assert_eq!(axis.timings(60_000_000)[0], 1);
}

#[test]
fn an_unknown_operation_and_a_payload_of_another_are_told_apart() {
    let frame = |op, payload| Frame {
        op,
        status: 0,
        id: 1,
        payload,
    };
    let parse = |op, payload| Request::parse(&frame(op, payload));
    assert_eq!(parse(99, &[]), Err(Status::UnknownOp));
    assert_eq!(parse(Op::Hello.code(), &[0; 4]), Err(Status::Malformed));
    assert_eq!(parse(Op::Commit.code(), &[0]), Err(Status::Malformed));
    assert_eq!(parse(Op::Delete.code(), &[]), Err(Status::Name));
    assert_eq!(parse(Op::Delete.code(), b"a\n"), Err(Status::Malformed));
    assert_eq!(
        parse(Op::Delete.code(), &[b'a'; 32]),
        Err(Status::Malformed)
    );
    assert_eq!(parse(Op::Command.code(), &[2, 0, 0, 0]), Err(Status::Name));
    assert!(parse(Op::Command.code(), &[5, 0, 0, 0]).is_ok());
    assert_eq!(
        parse(Op::Segment.code(), &[1, 0, 0, 0, 1]),
        Err(Status::Malformed)
    );
    assert_eq!(
        parse(Op::PutMachine.code(), &[1; 5]),
        Err(Status::Malformed)
    );
}

#[test]
fn a_frame_that_is_none_is_garbled_and_a_part_of_one_is_awaited() {
    let bytes = frame_of(&Request::Report, 7);
    for length in 0..bytes.len() {
        assert_eq!(Frame::parse(&bytes[..length]), Ok(None), "{length} bytes");
        assert!(Frame::needs(&bytes[..length]) > length, "{length} bytes");
    }
    assert_eq!(Frame::needs(&bytes), bytes.len());
    for bit in 0..bytes.len() * 8 {
        let mut wrong = bytes.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        let parsed = Frame::parse(&wrong);
        // A length that changed to a larger one is waited for; no client sends that much.
        assert!(
            matches!(parsed, Err(Garbled) | Ok(None)),
            "bit {bit}: {parsed:?}"
        );
    }
}

fn name() -> impl Strategy<Value = Name> {
    "[ -~]{1,31}".prop_map(|text| Name::new(&text).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_asked_is_what_is_read(
        id: u16, name in name(), client in 1u32.., total in 1u32.., crc: u32, offset: u32, index: u8, code: u8, flags: u8,
        keepalive: u16, percent: u16, bytes in proptest::collection::vec(any::<u8>(), 1..=DATA),
        words in proptest::collection::vec(any::<[u8; 4]>(), 0..=WORDS),
    ) {
        for request in [
            Request::Hello { client },
            Request::Put { total, crc, name },
            Request::Data { offset, bytes: &bytes },
            Request::Commit,
            Request::List { index },
            Request::Delete { name },
            Request::GetMachine,
            Request::PutMachine(plotter()),
            Request::Command { code, flags, keepalive, name },
            Request::Report,
            Request::Segment { command: code, form: flags, words: Words::new(&words) },
            Request::Feed { percent },
            Request::Challenge,
            Request::Respond { words: [client, total, crc, offset] },
        ] {
            let mut bytes = frame_of(&request, id);
            let length = bytes.len();
            prop_assert!(length <= FRAME);
            bytes.extend([1, 2, 3]);
            let (frame, whole) = Frame::parse(&bytes).unwrap().unwrap();
            prop_assert_eq!((whole, frame.id), (length, id));
            prop_assert_eq!(Request::parse(&frame), Ok(request));
        }
    }

    #[test]
    fn what_is_answered_is_what_is_read(
        bytes: [u8; 8], small: [u16; 3], words: [u32; 6], steps: [i32; AXES], flags: [bool; 4], name in name(),
        state in proptest::sample::select(State::ALL), end in proptest::sample::select(End::ALL),
    ) {
        let [version, percent, refused] = small;
        let welcome = Welcome {
            version, axes: bytes[0], clock_hz: words[0], boot_id: words[1], room: words[2], free: words[3], program: words[4],
        };
        prop_assert_eq!(Welcome::parse(&payload_of(|payload| welcome.emit(payload))), Some(welcome));
        let entry = Entry {
            count: bytes[1], ready: flags[0], total: words[0], have: words[1], crc: words[2], instructions: words[3], name,
        };
        prop_assert_eq!(Entry::parse(&payload_of(|payload| entry.emit(payload))), Some(entry));
        let [stands, machine, attended, known] = flags;
        let report = Report {
            state, progress: bytes[2] % 101, end, stands, machine, attended, known, homed: bytes[3], axis: bytes[4], percent,
            line: words[0], elapsed: words[1], remaining: words[2], board: words[3], steps, outputs: version, refused,
            segments: words[4], name,
        };
        prop_assert_eq!(Report::parse(&payload_of(|payload| report.emit(payload))), Some(report));
    }

    #[test]
    fn a_machine_of_any_numbers_comes_back(numbers: [u32; 12], wide: [i64; 4], bits: [u8; 4]) {
        let [tolerance, deviation, delay, outputs, invert, safe, speed, fast, slow, backoff, travel, timeout] = numbers;
        let flag = |n: u8| bits[0] >> n & 1 == 1;
        let home = Home {
            plus: flag(0), low: flag(1), input: bits[1], order: bits[2], fast, slow, backoff, travel, timeout, debounce: speed,
        };
        let axis = Axis {
            steps_per_km: wide[0] as u64, max_speed: speed, max_accel: wide[1] as u64, lowest: wide[2], highest: wide[3],
            steplen: fast, stepspace: slow, dirsetup: backoff, dirhold: travel, step_invert: flag(2), dir_invert: flag(3),
            home: flag(4).then_some(home),
        };
        let machine = MachineConfig {
            chord_tolerance: tolerance, junction_deviation: deviation, tool_delay: delay, outputs, beam: speed as u16, invert, safe,
            axes: [axis; AXES],
        };
        let payload = payload_of(|payload| { machine.emit(payload); });
        prop_assert_eq!(MachineConfig::parse(&payload), Ok(machine));
        // The check of any machine must not panic.
        let _ = machine.check(60_000_000, 32, 32);
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200), op in 0u8..16) {
        let _ = Frame::parse(&bytes);
        let _ = Frame::needs(&bytes);
        let _ = Request::parse(&Frame { op, status: 0, id: 0, payload: &bytes });
        let _ = Welcome::parse(&bytes);
        let _ = Entry::parse(&bytes);
        let _ = Report::parse(&bytes);
        if let Ok(machine) = MachineConfig::parse(&bytes) {
            let _ = machine.check(60_000_000, 6, 16);
        }
    }
}
