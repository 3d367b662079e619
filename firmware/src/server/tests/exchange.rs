//! The servo-period datagram.

use super::*;

#[test]
fn an_exchange_commits_samples_feeds_and_answers() {
    let mut rig = Rig::armed();
    rig.board.done.clear();
    rig.board.now = 0x1_2345_6789;
    let mut command = rig.command(true, true);
    command.stepgen[5] = (Velocity(-7), Accel(9));
    command.pwm[5] = PWM_ENABLE | 100;
    command.gpio_out = 0xa5;
    command.index_arm = 0x11;
    command.stepgen_index_arm = 0x22;
    command.probe_arm = 0x14;
    command.stepgen_probe_arm = 0x28;
    let status = rig.exchange_as(ALICE, &command).unwrap();
    assert_eq!(
        rig.board.done,
        [
            Change::Strobe(timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE),
            Change::Feed(command.sequence)
        ]
    );
    assert_eq!(rig.board.live[..4], [0x0011_003f, 0xa5, 0x0014_0022, 0x28]);
    assert_eq!(rig.board.live[14..16], [-7i32 as u32, 9]);
    assert_eq!(rig.board.live[41], PWM_ENABLE | 100);
    assert_eq!(status.sequence, command.sequence);
    assert_eq!(status.arrival, Clocks(0x1_2345_6789));
    assert_eq!(status.sample, Clocks::from_words(0x1000, 0x1001));
    assert_eq!(
        (status.gpio_in, status.boot_id, status.watchdog_left),
        (0x1002, 9, 300_000)
    );
    assert_eq!(
        (status.index_latched, status.stepgen_index_latched),
        (0x1003, 0x1004)
    );
    assert_eq!(
        (status.stepgen_probe_latched, status.estop),
        (0x1005, 0x1006)
    );
    assert_eq!(status.stepgen[5].1, Velocity(0x1000 + 8 + 17));
    assert_eq!(status.encoder[0].count, Count(0x1000 + 56));
    assert_eq!(status.encoder[5].edge_time, 0x1000 + 56 + 11);
    assert!(status.state.accepted && status.state.session_yours && status.state.enabled);
}

#[test]
fn with_any_number_of_channels_every_word_is_staged_and_answered_where_it_belongs() {
    for n in 0..=16u8 {
        let channels = Channels {
            stepgens: n,
            encoders: 16 - n,
            pwms: (n * 5) % 17,
            inputs: n * 4,
            outputs: 64 - n * 4,
        };
        let mut rig = Rig::with_channels(channels);
        rig.arm();
        let mut command = rig.command(true, true);
        for channel in 0..16 {
            let word = channel as i32;
            command.stepgen[channel] = (Velocity(-1 - word), Accel(100 + channel as u32));
            command.pwm[channel] = 200 + channel as u32;
        }
        command.gpio_out = 0x8765_4321_1234_5678;
        let status = rig.exchange_as(ALICE, &command).unwrap();
        let high = if channels.outputs > 32 {
            0x8765_4321
        } else {
            0
        };
        let staged = [command::GPIO_OUT, command::GPIO_OUT_HIGH].map(|word| rig.board.live[word]);
        assert_eq!(staged, [0x1234_5678, high], "{channels:?}");
        let high = if channels.inputs > 32 { 0x1058 } else { 0 };
        assert_eq!(status.gpio_in, high << 32 | 0x1002, "{channels:?}");
        for channel in 0..16 {
            let (velocity, accel) = command.stepgen[channel];
            let there = channel < usize::from(channels.stepgens);
            let staged = &rig.board.live[4 + 2 * channel..][..2];
            let wanted = [velocity.0 as u32, accel.0].map(|word| if there { word } else { 0 });
            assert_eq!(staged, wanted, "stepgen {channel}, {channels:?}");
            let word = 0x1000 + 8 + 3 * channel as u32;
            let position = Position::from_words(word, word + 1);
            let wanted = (position, Velocity(word as i32 + 2));
            assert!(!there || status.stepgen[channel] == wanted, "{channels:?}");

            let there = channel < usize::from(channels.pwms);
            let wanted = if there { command.pwm[channel] } else { 0 };
            assert_eq!(rig.board.live[36 + channel], wanted, "pwm, {channels:?}");

            let there = channel < usize::from(channels.encoders);
            let word = 0x1000 + 56 + 2 * channel as u32;
            let encoder = status.encoder[channel];
            assert!(
                !there || (encoder.count, encoder.edge_time) == (Count(word), word + 1),
                "encoder {channel}, {channels:?}"
            );
        }
    }
}

#[test]
fn a_command_block_of_another_length_is_refused() {
    let mut rig = Rig::armed();
    let before = rig.board.changes();
    for count in [1, 26, 28, 57] {
        let mut words = vec![HEADER, 0, 0x000f_0000 | count << 8, map::COMMAND];
        words.extend(vec![0; count as usize]);
        assert_eq!(rig.send(&words), Err(Refusal::BlockLength), "{count} words");
    }
    let mut words = vec![HEADER, 0, 0x000f_1b00, map::COMMAND + 4];
    words.extend([0; 27]);
    assert_eq!(rig.send(&words), Err(Refusal::BlockLength));
    words[3] = map::COMMAND - 4;
    assert_eq!(rig.send(&words), Err(Refusal::BlockLength));
    // Its last word alone reaches the window.
    words[3] = map::COMMAND - 4 * 26;
    assert_eq!(rig.send(&words), Err(Refusal::BlockLength));
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn what_ends_before_the_command_window_or_begins_behind_it_is_no_exchange() {
    let mut rig = Rig::armed();
    let mut words = vec![HEADER, 0, 0x000f_0100, 0, 1];
    for address in [map::COMMAND - 4, map::COMMAND + 0x1000] {
        words[3] = address;
        assert_eq!(rig.send(&words), Err(Refusal::Unmapped), "{address:#x}");
    }
    for address in [map::COMMAND, map::COMMAND + 0xffc] {
        words[3] = address;
        assert_eq!(rig.send(&words), Err(Refusal::BlockLength), "{address:#x}");
    }
}

#[test]
fn an_exchange_shares_its_datagram_with_nothing() {
    let mut rig = Rig::armed();
    let command = rig.command(true, true);
    let mut buffer = [0; 64];
    let request = command.emit_request(SIX, &mut buffer).unwrap().to_vec();
    let before = rig.board.changes();
    let behind = [&request[..], &[0x000f_0001, 0, 0x100]].concat();
    assert_eq!(rig.send(&behind), Err(Refusal::NotAlone));
    let mut with_read = request.clone();
    with_read[2] |= 1;
    with_read.extend([0, 0x100]);
    assert_eq!(rig.send(&with_read), Err(Refusal::NotAlone));
    let ahead = [&[HEADER, 0, 0x000f_0001, 0, 0x100], &request[2..]].concat();
    assert_eq!(rig.send(&ahead), Err(Refusal::NotAlone));
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn repeated_old_and_foreign_sequences_are_dropped_and_never_feed() {
    let mut rig = Rig::armed();
    let good = rig.command(true, true);
    rig.exchange_as(ALICE, &good).unwrap();
    let before = rig.board.changes();
    for (sequence, why) in [
        (good.sequence, Refusal::Duplicate),
        (good.sequence - 1, Refusal::Stale),
        (good.sequence.wrapping_add(1 << 31), Refusal::Stale),
    ] {
        let command = Command { sequence, ..good };
        assert_eq!(rig.exchange_as(ALICE, &command), Err(why));
    }
    let wrong_token = Command {
        token: good.token ^ 1,
        sequence: good.sequence + 1,
        ..good
    };
    assert_eq!(rig.exchange_as(ALICE, &wrong_token), Err(Refusal::NotOwner));
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn a_gap_in_the_sequence_is_fine_and_so_is_its_wrap() {
    let mut rig = Rig::armed();
    for sequence in [0x7fff_ffff, 0xffff_fffe, 0xffff_ffff, 0, 5] {
        let command = Command {
            sequence,
            ..rig.command(true, true)
        };
        assert!(rig.exchange_as(ALICE, &command).is_ok(), "{sequence:#x}");
    }
}

/// The result of a command with these bits of words of its datagram inverted.
fn with_bits(bits: &[(usize, u32)]) -> Result<(), Refusal> {
    let mut rig = Rig::armed();
    let command = rig.command(true, true);
    let mut buffer = [0; 64];
    let mut request = command.emit_request(SIX, &mut buffer).unwrap().to_vec();
    for (word, bit) in bits {
        request[*word] ^= 1 << bit;
    }
    rig.send(&request).map(drop)
}

#[test]
fn every_unknown_flag_is_refused_and_every_known_one_is_not() {
    for bit in 0..32 {
        let known = matches!(bit, 0..=2 | 16..=31);
        let wanted = if known { Ok(()) } else { Err(Refusal::Value) };
        assert_eq!(with_bits(&[(6, bit)]), wanted, "flag {bit}");
    }
    for bit in 0..32 {
        let wanted = if bit <= 20 {
            Ok(())
        } else {
            Err(Refusal::Value)
        };
        assert_eq!(
            with_bits(&[(12, bit)]),
            wanted,
            "bit {bit} behind the latch"
        );
    }
    for bit in 3..=10 {
        let both = [(6, bit), (12, 21 + bit)];
        assert_eq!(
            with_bits(&both),
            Err(Refusal::Value),
            "flag {bit} and another"
        );
    }
}

#[test]
fn the_answer_carries_the_latch_the_command_selected() {
    let mut rig = Rig::armed();
    for (latch, word) in [
        (Latch::Encoder(0), 96),
        (Latch::Encoder(15), 111),
        (Latch::Stepgen(0), 112),
        (Latch::Stepgen(5), 117),
        (Latch::Stepgen(15), 127),
    ] {
        let command = Command {
            latch,
            ..rig.command(true, true)
        };
        let status = rig.exchange_as(ALICE, &command).unwrap();
        assert_eq!(status.latch, Count(0x1000 + word), "{latch:?}");
        let looked_at = rig.read_as(BOB, map::STATUS + 4 * 14);
        assert_eq!(looked_at, Ok(0x1000 + word), "{latch:?}");
    }
}

#[test]
fn a_selection_arms_nothing_the_gateware_would_see() {
    let mut rig = Rig::armed();
    let command = Command {
        latch: Latch::Stepgen(15),
        ..rig.command(true, true)
    };
    rig.exchange_as(ALICE, &command).unwrap();
    // The register is 16 bits wide.
    assert_eq!(rig.board.live[3] as u16, 0);
}

#[test]
fn a_disarmed_machine_answers_samples_and_executes_nothing() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.board.done.clear();
    let mut command = rig.command(true, false);
    command.stepgen[0].0 = Velocity(1000);
    let status = rig.exchange_as(ALICE, &command).unwrap();
    assert_eq!(
        rig.board.done,
        [Change::Strobe(timebase::STROBE_SAMPLE), Change::Feed(1)]
    );
    assert_eq!(rig.board.live, [0; command::WORDS]);
    assert_eq!(
        (status.state.state, status.state.enabled),
        (State::Disarmed, false)
    );
}

#[test]
fn arming_commits_before_and_after_the_gate_opens() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.exchange(true, false).unwrap();
    rig.exchange(true, true).unwrap();
    rig.board.done.clear();
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        rig.board.done[..3],
        [
            Change::Strobe(timebase::STROBE_COMMIT),
            Change::Order(Control::Arm),
            Change::Strobe(timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE)
        ]
    );
    assert_eq!(
        (status.state.state, status.state.enabled),
        (State::Armed, true)
    );
}

#[test]
fn an_apply_time_is_set_before_the_strobe_and_the_next_command_replaces_it() {
    let mut rig = Rig::armed();
    rig.board.done.clear();
    let command = Command {
        apply_at: Some(Clocks(0x5_0000_0007)),
        ..rig.command(true, true)
    };
    rig.exchange_as(ALICE, &command).unwrap();
    assert_eq!(rig.board.commit_at, 0x5_0000_0007);
    assert_eq!(
        rig.board.done[0],
        Change::Strobe(timebase::STROBE_COMMIT_AT | timebase::STROBE_SAMPLE)
    );
    rig.exchange(true, true).unwrap();
    assert_eq!(
        rig.board.commit_at,
        u64::MAX,
        "an old apply time could fire into a half-staged block"
    );
}

#[test]
fn a_setting_that_may_change_while_armed_leaves_the_command_as_it_is() {
    let mut rig = Rig::armed();
    let mut command = rig.command(true, true);
    command.stepgen[0].0 = Velocity(1000);
    rig.exchange_as(ALICE, &command).unwrap();
    rig.board.done.clear();
    rig.write(map::CONFIG_PWM, 2_000).unwrap();
    let set = Change::Set(Setting::PwmPeriod(0), 2_000);
    assert_eq!(rig.board.done, [set], "and commits nothing");
    assert_eq!(rig.board.live[4], 1000);
}

#[test]
fn an_apply_time_waits_for_nothing_unless_the_machine_is_armed_already() {
    let mut rig = Rig::new();
    rig.acquire();
    let at = rig.board.commit_at;
    for (request, done) in [
        (false, &[Change::Strobe(timebase::STROBE_SAMPLE)][..]),
        (true, &[Change::Strobe(timebase::STROBE_SAMPLE)]),
        (
            true,
            &[
                Change::Strobe(timebase::STROBE_COMMIT),
                Change::Order(Control::Arm),
                Change::Strobe(timebase::STROBE_COMMIT | timebase::STROBE_SAMPLE),
            ],
        ),
    ] {
        rig.board.done.clear();
        let command = Command {
            apply_at: Some(Clocks(0x5_0000_0007)),
            ..rig.command(true, request)
        };
        rig.exchange_as(ALICE, &command).unwrap();
        assert_eq!(rig.board.done[..done.len()], *done);
        assert_eq!(rig.board.done.len(), done.len() + 1, "and feeds");
        assert_eq!(rig.board.commit_at, at);
    }
}

#[test]
fn looking_at_the_status_changes_nothing_and_shows_the_last_exchange() {
    let mut rig = Rig::armed();
    let before = rig.board.done.len();
    let words: Vec<u32> = (0..45)
        .map(|word| rig.read_as(BOB, map::STATUS + 4 * word).unwrap())
        .collect();
    assert_eq!(rig.board.done.len(), before);
    let status = Status::parse(&words, SIX).unwrap();
    assert_eq!(status.sequence, rig.sequence);
    assert!(!status.state.accepted && !status.state.session_yours && status.state.enabled);
    assert_eq!(status.encoder[5].edge_time, 0x1000 + 56 + 11);
    assert_eq!((status.gpio_in, status.estop), (0x1002, 0x1006));
    assert_eq!(rig.read_as(BOB, map::STATUS + 4 * 45), Ok(0));
}

#[test]
fn an_exchange_with_the_no_reads_flag_is_executed_silently() {
    let mut rig = Rig::armed();
    let command = rig.command(true, true);
    let mut buffer = [0; 64];
    let mut request = command.emit_request(SIX, &mut buffer).unwrap().to_vec();
    request[0] |= 0x400;
    assert_eq!(rig.send(&request), Ok(vec![]));
    assert_eq!(rig.server.session().last_sequence(), command.sequence);
}
