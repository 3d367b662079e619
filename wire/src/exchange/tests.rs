use super::*;

const SIX: Channels = Channels {
    stepgens: 6,
    encoders: 6,
    pwms: 6,
    inputs: 12,
    outputs: 12,
};
const MOST: Channels = Channels {
    stepgens: 16,
    encoders: 16,
    pwms: 16,
    inputs: 64,
    outputs: 64,
};

fn command() -> Command {
    let mut command = Command {
        token: 0x1234_5678,
        sequence: u32::MAX,
        enable: true,
        apply_at: Some(Clocks(1 << 40 | 7)),
        stepgen_enable: 0x3f,
        index_arm: 0x21,
        probe_arm: 0x8001,
        stepgen_index_arm: 0x12,
        stepgen_probe_arm: 0xffff,
        latch: Latch::Stepgen(15),
        gpio_out: 0xa5,
        ..Command::default()
    };
    command.stepgen[5] = (Velocity(-i32::MAX), Accel(u32::MAX));
    command.pwm[5] = PWM_ENABLE | 1234;
    command
}

#[test]
fn a_six_axis_command_is_27_words_and_its_status_45() {
    assert_eq!((command_words(SIX), status_words(SIX)), (27, 45));
}

#[test]
fn a_command_survives_the_wire() {
    for channels in [SIX, MOST] {
        let mut buffer = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let request = command().emit_request(channels, &mut buffer).unwrap();
        let packet = etherbone::Packet::new_checked(request).unwrap();
        let record = packet.records().next().unwrap();
        assert_eq!(record.write_base, map::COMMAND);
        assert_eq!(Command::parse(record.writes, channels), Ok(command()));
    }
}

#[test]
fn pins_behind_the_first_word_cost_a_word_only_where_a_board_has_them() {
    let with = |inputs, outputs| {
        let channels = Channels {
            inputs,
            outputs,
            ..SIX
        };
        (command_words(channels), status_words(channels))
    };
    assert_eq!(with(0, 0), (27, 45));
    assert_eq!(with(32, 32), (27, 45));
    assert_eq!(with(33, 32), (27, 46));
    assert_eq!(with(32, 33), (28, 45));
    assert_eq!(with(64, 64), (28, 46));
}

#[test]
fn every_pin_has_its_own_bit_on_the_wire() {
    for n in 0..64 {
        let one = Command {
            gpio_out: 1 << n,
            ..command()
        };
        let mut buffer = [0; REQUEST_OVERHEAD + COMMAND_MAX];
        let words = one.emit_request(MOST, &mut buffer).unwrap();
        let back = Command::parse(&words[REQUEST_OVERHEAD..], MOST).unwrap();
        assert_eq!(back.gpio_out, 1 << n);

        let mut status = Status::parse(&[0; STATUS_MAX][..status_words(MOST)], MOST).unwrap();
        status.gpio_in = 1 << n;
        let mut buffer = [0; STATUS_MAX];
        let words = status.emit(MOST, &mut buffer).unwrap();
        assert_eq!(Status::parse(words, MOST), Ok(status));
    }
}

#[test]
fn a_command_block_for_another_board_is_refused() {
    let words = [0; COMMAND_MAX];
    assert_eq!(Command::parse(&words[..26], SIX), Err(Refusal::BlockLength));
    assert_eq!(Command::parse(&words[..28], SIX), Err(Refusal::BlockLength));
}

#[test]
fn a_status_survives_the_wire() {
    let mut status = Status::parse(&[0; STATUS_MAX][..status_words(MOST)], MOST).unwrap();
    status.state.state = State::Faulted;
    status.state.reason = FaultReason::ExternalReset;
    status.state.accepted = true;
    status.arrival = Clocks(u64::MAX);
    status.stepgen[15] = (Position(i64::MIN), Velocity(-1));
    status.encoder[15].count = Count(u32::MAX);
    status.encoder[15].errors = 255;
    status.encoder[15].edge_time = 0xff_ffff;
    status.rate_limited = 0x8000;
    status.probe_latched = 1;
    status.illegal = 2;
    status.stepgen_index_latched = 4;
    status.stepgen_probe_latched = 8;
    status.estop = 16;
    status.latch = Count(u32::MAX);
    status.state.estop = true;
    let mut words = [0; STATUS_MAX];
    assert_eq!(
        Status::parse(status.emit(MOST, &mut words).unwrap(), MOST),
        Ok(status)
    );
}

#[test]
fn every_flag_of_the_state_word_has_its_bit() {
    let nothing = StateWord::from_word(0).unwrap();
    assert_eq!(
        (nothing.state, nothing.reason),
        (State::Boot, FaultReason::None)
    );
    type Set = fn(&mut StateWord);
    let flags: [(u32, Set); 13] = [
        (0, |word| word.state = State::Disarmed),
        (6, |word| word.speed = LinkSpeed::M10),
        (8, |word| word.reason = FaultReason::Watchdog),
        (12, |word| word.services = JobsState::Alive),
        (16, |word| word.position_trusted = true),
        (17, |word| word.enabled = true),
        (18, |word| word.session_yours = true),
        (19, |word| word.bitten = true),
        (20, |word| word.external_reset = true),
        (21, |word| word.accepted = true),
        (22, |word| word.link = true),
        (23, |word| word.estop = true),
        (24, |word| word.link_errors = 1),
    ];
    let mut all = nothing;
    for (bit, set) in flags {
        let mut word = nothing;
        set(&mut word);
        set(&mut all);
        assert_eq!(word.to_word(), 1 << bit, "{word:?}");
        assert_eq!(StateWord::from_word(1 << bit), Ok(word));
    }
    assert_eq!(all.to_word(), 0x01ff_1141);
    assert_eq!(StateWord::from_word(0x01ff_1141), Ok(all));
}

#[test]
fn every_word_of_a_status_is_where_the_table_says() {
    let mut words: [u32; STATUS_MAX] = core::array::from_fn(|at| 0x0101_0100 * at as u32 + 1);
    words[0] = 0;
    let status = Status::parse(&words[..status_words(SIX)], SIX).unwrap();
    assert_eq!(
        status.arrival,
        Clocks(u64::from(words[3]) << 32 | u64::from(words[2]))
    );
    assert_eq!(
        status.sample,
        Clocks(u64::from(words[5]) << 32 | u64::from(words[4]))
    );
    assert_eq!(
        (status.watchdog_left, status.refused),
        (words[6], Count(words[7]))
    );
    let (position, velocity) = status.stepgen[1];
    assert_eq!(
        (position, velocity),
        (
            Position::from_words(words[18], words[19]),
            Velocity(words[20] as i32)
        )
    );
    let encoder = status.encoder[1];
    assert_eq!(
        (encoder.count, encoder.edge_time),
        (Count(words[35]), words[36] & 0xff_ffff)
    );
    assert_eq!(encoder.errors, (words[36] >> 24) as u8);
    assert_eq!(status.encoder[6], EncoderStatus::default(), "there are six");
    let mut back = [0; STATUS_MAX];
    assert_eq!(status.emit(SIX, &mut back), Some(&words[..45]));
    assert_eq!(status.emit(SIX, &mut back[..44]), None);
    for length in [44, 46] {
        assert_eq!(
            Status::parse(&words[..length], SIX),
            Err(Refusal::BlockLength)
        );
    }
}

#[test]
fn every_word_of_a_command_is_where_the_table_says() {
    let mut words: [u32; 27] = core::array::from_fn(|at| 0x0101_0100 * at as u32 + 1);
    words[2] = FLAG_APPLY_TIME | 0xa55a << FLAG_ALONE_SHIFT;
    words[8] &= 0x1f_ffff;
    let command = Command::parse(&words, SIX).unwrap();
    assert_eq!((command.enable, command.enable_request), (false, false));
    assert_eq!(
        command.apply_at,
        Some(Clocks::from_words(words[3], words[4]))
    );
    assert_eq!(
        command.stepgen[1],
        (Velocity(words[11] as i32), Accel(words[12]))
    );
    assert_eq!((command.pwm[0], command.pwm[5]), (words[21], words[26]));
    let mut back = [0; REQUEST_OVERHEAD + 27];
    assert_eq!(
        command.emit_request(SIX, &mut back[..REQUEST_OVERHEAD + 26]),
        None
    );
    let request = command.emit_request(SIX, &mut back).unwrap();
    assert_eq!(
        request[..4],
        [etherbone::HEADER, 0, 0x000f_1b00, map::COMMAND]
    );
    assert_eq!(request[4..], words);
    for (flag, enable) in [(FLAG_ENABLE, true), (FLAG_ENABLE_REQUEST, false)] {
        words[2] = flag;
        let command = Command::parse(&words, SIX).unwrap();
        assert_eq!((command.enable, command.enable_request), (enable, !enable));
        assert_eq!(command.apply_at, None);
        // Without an apply time, the words are 0 on the wire.
        assert_eq!(
            command.emit_request(SIX, &mut back).unwrap()[6..9],
            [flag, 0, 0]
        );
    }
}

#[test]
fn an_answer_is_one_record_with_its_sequence_number_as_base() {
    let mut words = [0; 4 + 45];
    words[..4].copy_from_slice(&[etherbone::HEADER, 0, 0x000f_2d00, 77]);
    words[5] = 77;
    assert_eq!(Status::parse_reply(&words, SIX).unwrap().sequence, 77);
    words[5] = 78;
    assert_eq!(Status::parse_reply(&words, SIX), Err(Refusal::Value));
    words[5] = 77;
    let mut two = [0; 4 + 45 + 3];
    two[..49].copy_from_slice(&words);
    two[49] = 0x000f_0100;
    assert_eq!(Status::parse_reply(&two, SIX), Err(Refusal::NotAlone));
}

#[test]
fn every_latch_has_its_code_and_every_code_its_latch() {
    for code in 0..32 {
        assert_eq!(Latch::from_code(code).code(), code);
    }
    assert_eq!(Latch::Encoder(3).code(), 3);
    assert_eq!(Latch::Stepgen(3).code(), 19);
}

#[test]
fn a_state_this_version_does_not_know_is_refused_not_guessed() {
    assert_eq!(StateWord::from_word(0x0000_00ff), Err(Refusal::Value));
    assert_eq!(StateWord::from_word(0x0000_ff00), Err(Refusal::Value));
}

#[test]
fn sequence_numbers_are_judged_right_across_their_wrap() {
    assert_eq!(judge_sequence(1, 0), Ok(()));
    assert_eq!(judge_sequence(0, u32::MAX), Ok(()));
    assert_eq!(judge_sequence(7, 7), Err(Refusal::Duplicate));
    assert_eq!(judge_sequence(u32::MAX, 0), Err(Refusal::Stale));
    assert_eq!(judge_sequence(0x8000_0000, 0), Err(Refusal::Stale));
}
