use super::*;
use crate::cores::Setting;
use crate::fake::*;
use proptest::prelude::*;
use wire::describe::Channels;
use wire::exchange::{Command, Latch, PWM_ENABLE, STATUS_MAX, Status};
use wire::map::{BoardConfig, StepgenConfig};
use wire::regmap::{command, timebase};
use wire::units::{Accel, Clocks, Count, Position, StepRate};
use wire::{FaultReason, State};

const HEADER: u32 = 0x4e6f_1044;

// ---- Golden vectors (LiteEth, LiteX RemoteClient) ------------------------------------------------

#[test]
fn a_probe_is_echoed() {
    let reply = Rig::new().send(&[0x4e6f_1144, 0, 0x1234_5678]);
    assert_eq!(reply, Ok(vec![0x4e6f_1244, 0, 0x1234_5678]));
}

#[test]
fn two_words_are_read_under_the_callers_own_return_address() {
    let reply = Rig::new().send(&[HEADER, 0, 0x000f_0002, 0xdead_beef, 0x100, 0x104]);
    assert_eq!(
        reply,
        Ok(vec![
            HEADER,
            0,
            0x000f_0200,
            0xdead_beef,
            0xb10b_0000,
            0xb10b_0001
        ])
    );
}

#[test]
fn the_golden_write_lands_nowhere_because_that_address_is_read_only() {
    let mut rig = Rig::new();
    let reply = rig.send(&[HEADER, 0, 0x000f_0200, 0x20, 0x1122_3344, 0x5566_7788]);
    assert_eq!(reply, Err(Refusal::ReadOnly));
}

#[test]
fn a_write_is_executed_and_not_answered() {
    let mut rig = Rig::new();
    rig.acquire();
    let steplen = map::CONFIG_STEPGEN;
    assert_eq!(
        rig.send(&[HEADER, 0, 0x000f_0200, steplen, 60, 61]),
        Ok(vec![])
    );
    assert_eq!(rig.read(steplen), Ok(60));
    assert_eq!(rig.read(steplen + 4), Ok(61));
}

#[test]
fn a_read_with_the_no_reads_flag_is_not_answered() {
    let reply = Rig::new().send(&[0x4e6f_1444, 0, 0x000f_0001, 0x77, 0x100]);
    assert_eq!(reply, Ok(vec![]));
}

#[test]
fn an_empty_record_is_refused_and_harmless() {
    assert_eq!(
        Rig::new().send(&[HEADER, 0, 0x000f_0000, 0]),
        Err(Refusal::Padded)
    );
}

// ---- Behaviours on which LiteEth trips --------------------------------------------------------------

#[test]
fn the_answer_depends_on_no_port() {
    // The transport answers to `peer`; the port must not matter to the server.
    for port in [1, 1234, 65_535] {
        assert!(Rig::new().read_as(Peer { port, ..BOB }, 0).is_ok());
    }
}

#[test]
fn version_and_widths_are_checked() {
    let mut rig = Rig::new();
    assert_eq!(
        rig.send(&[0xdead_1044, 0, 0x000f_0001, 0, 0]),
        Err(Refusal::Magic)
    );
    assert_eq!(
        rig.send(&[0x4e6f_2044, 0, 0x000f_0001, 0, 0]),
        Err(Refusal::Version)
    );
    assert_eq!(
        rig.send(&[0x4e6f_1011, 0, 0x000f_0001, 0, 0]),
        Err(Refusal::Width)
    );
    assert_eq!(rig.send(&[0x4e6f_1244, 0, 1]), Err(Refusal::ProbeReply));
    assert_eq!(rig.server.counters().refused_total, 4);
}

#[test]
fn partial_byte_enables_are_refused() {
    let mut rig = Rig::new();
    rig.acquire();
    let words = [HEADER, 0, 0x0003_0100, map::CONFIG_STEPGEN, 60];
    assert_eq!(rig.send(&words), Err(Refusal::ByteEnable));
}

#[test]
fn crooked_addresses_are_refused() {
    let mut rig = Rig::new();
    rig.acquire();
    for low in 1..4 {
        assert_eq!(rig.read(low), Err(Refusal::Alignment));
        assert_eq!(
            rig.write(map::CONFIG_STEPGEN + low, 60),
            Err(Refusal::Alignment)
        );
    }
}

#[test]
fn an_address_in_no_window_is_refused_and_counted() {
    let mut rig = Rig::new();
    for address in [
        0x2000,
        0x0001_0040,
        0x0008_0000,
        0x8000_0000,
        0xefff_fffc,
        0xf002_0000,
    ] {
        assert_eq!(rig.read(address), Err(Refusal::Unmapped), "{address:#x}");
    }
    assert_eq!(
        rig.read(map::COUNTERS_REFUSED + 4 * Refusal::Unmapped.index() as u32),
        Ok(6)
    );
}

#[test]
fn a_record_may_write_and_read() {
    let mut rig = Rig::new();
    let reply = rig.send(&[
        HEADER,
        0,
        0x000f_0101,
        map::SESSION_ACQUIRE,
        7,
        0xaa,
        map::SESSION_TOKEN,
    ]);
    let token = rig.server.session().token_for(ALICE);
    assert_ne!(token, 0);
    assert_eq!(reply, Ok(vec![HEADER, 0, 0x000f_0100, 0xaa, token]));
}

#[test]
fn several_records_are_executed_in_order_and_answered_in_one_packet() {
    let mut rig = Rig::new();
    rig.acquire();
    let steplen = map::CONFIG_STEPGEN;
    let reply = rig.send(&[
        HEADER,
        0,
        0x000f_0001,
        1,
        steplen,
        0x000f_0100,
        steplen,
        77,
        0x000f_0001,
        2,
        steplen,
    ]);
    assert_eq!(
        reply,
        Ok(vec![HEADER, 0, 0x000f_0100, 1, 0, 0x000f_0100, 2, 77])
    );
}

#[test]
fn padding_behind_a_record_executes_nothing() {
    let mut rig = Rig::new();
    rig.acquire();
    let before = rig.board.changes();
    assert_eq!(
        rig.send(&[HEADER, 0, 0x000f_0100, map::CONFIG_STEPGEN, 60, 0]),
        Err(Refusal::Padded)
    );
    assert_eq!(
        rig.send(&[HEADER, 0, 0x000f_0001, 0, 0x100, 0]),
        Err(Refusal::Padded)
    );
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn a_truncated_write_touches_nothing_and_the_next_datagram_is_itself() {
    let mut rig = Rig::new();
    rig.acquire();
    let before = rig.board.changes();
    assert_eq!(
        rig.send(&[HEADER, 0, 0x000f_0300, map::CONFIG_STEPGEN, 60]),
        Err(Refusal::Truncated)
    );
    assert_eq!(rig.board.changes(), before);
    assert_eq!(rig.read(0x100), Ok(0xb10b_0000));
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn a_truncated_read_is_not_waited_for() {
    let mut rig = Rig::new();
    assert_eq!(
        rig.send(&[HEADER, 0, 0x000f_0003, 0, 0x100]),
        Err(Refusal::Truncated)
    );
    assert_eq!(rig.read(0x100), Ok(0xb10b_0000));
}

#[test]
fn the_longest_read_fits_and_a_longer_answer_is_refused() {
    let mut rig = Rig::new();
    let mut words = vec![HEADER, 0, 0x000f_00ff, 5];
    words.extend([0x100; 255]);
    assert_eq!(rig.send(&words).unwrap().len(), 4 + 255);
    words.extend([0x000f_00ff, 5]);
    words.extend([0x100; 255]);
    assert_eq!(rig.send(&words), Err(Refusal::Oversized));
}

#[test]
fn an_empty_datagram_is_refused() {
    assert_eq!(Rig::new().send(&[]), Err(Refusal::Short));
}

#[test]
fn two_datagrams_back_to_back_are_two_datagrams() {
    let mut rig = Rig::new();
    assert_eq!(rig.read(0x100), Ok(0xb10b_0000));
    assert_eq!(rig.read(0x104), Ok(0xb10b_0001));
}

proptest! {
    #[test]
    fn no_words_whatever_panic_or_change_anything_without_the_session(
        words in proptest::collection::vec(prop_oneof![
            any::<u32>(), Just(HEADER), Just(0x000f_0101), Just(0x000f_1b00), Just(map::COMMAND),
            Just(map::CONFIG), Just(map::SERVICE + 0x8000), Just(map::SESSION_RELEASE),
        ], 0..40)
    ) {
        let mut rig = Rig::new();
        let before = rig.board.changes();
        let mut framed = vec![HEADER, 0];
        framed.extend(&words);
        for datagram in [&words, &framed] {
            let _ = rig.send_as(BOB, datagram);
        }
        prop_assert!(rig.server.session().owner().is_some() || rig.board.changes() == before);
        prop_assert!(rig.read(0x100).is_ok());
    }
}

// ---- All or nothing ---------------------------------------------------------------------------------

#[test]
fn a_bad_last_word_stops_the_first_record_too() {
    let mut rig = Rig::new();
    rig.acquire();
    let before = rig.board.changes();
    let steplen = map::CONFIG_STEPGEN;
    for (bad, why) in [
        ([0x000f_0100, 0x0008_0000, 1], Refusal::Unmapped),
        ([0x000f_0100, map::STATUS, 1], Refusal::ReadOnly),
        ([0x000f_0100, steplen, 0], Refusal::Value),
        ([0x000f_0001, 0, 0x0008_0000], Refusal::Unmapped),
    ] {
        let words = [&[HEADER, 0, 0x000f_0100, steplen, 60], &bad[..]].concat();
        assert_eq!(rig.send(&words), Err(why));
    }
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn a_write_that_runs_past_the_end_of_the_address_space_is_refused() {
    let mut rig = Rig::new();
    rig.acquire();
    let words = [HEADER, 0, 0x000f_0200, 0xffff_fffc, 1, 2];
    assert_eq!(rig.send(&words), Err(Refusal::Unmapped));
}

#[test]
fn one_datagram_may_acquire_and_configure() {
    let mut rig = Rig::new();
    let reply = rig.send(&[
        HEADER,
        0,
        0x000f_0100,
        map::SESSION_ACQUIRE,
        7,
        0x000f_0101,
        map::CONFIG_STEPGEN,
        60,
        5,
        map::CONFIG_STEPGEN,
    ]);
    assert_eq!(reply.unwrap().last(), Some(&60));
}

// ---- Permissions
// ---------------------------------------------------------------------------------------

#[test]
fn a_stranger_reads_everything_and_changes_nothing() {
    let mut rig = Rig::armed();
    let token = rig.read(map::SESSION_TOKEN).unwrap();
    let before = rig.board.changes();
    for address in [
        0,
        map::STATUS,
        map::COUNTERS,
        map::CONFIG,
        map::LOG,
        map::PANIC,
        map::SERVICE,
    ] {
        assert!(rig.read_as(BOB, address).is_ok(), "{address:#x}");
    }
    assert_eq!(rig.read_as(BOB, map::SESSION_TOKEN), Ok(0));
    for (address, value) in [
        (map::SESSION_ACQUIRE, 7),
        (map::SESSION_RELEASE, token),
        (map::SESSION_REBOOT, map::REBOOT_KEY),
        (map::CONFIG_PWM, 3000),
        (map::SERVICE + 11 * 0x800 + 4, 0),
    ] {
        assert_eq!(
            rig.write_as(BOB, address, value),
            Err(Refusal::NotOwner),
            "{address:#x}"
        );
    }
    let mut command = rig.command(true, true);
    command.token = token;
    assert_eq!(rig.exchange_as(BOB, &command), Err(Refusal::NotOwner));
    assert_eq!(rig.board.changes(), before);
}

#[test]
fn while_the_machine_is_armed_a_guest_asks_for_little_at_once() {
    let read = |rig: &mut Rig, who, count: u32| {
        let mut words = vec![0x4e6f_1044, 0, 0x000f_0000 | count, 7];
        words.extend((0..count).map(|n| map::STATUS + 4 * n));
        rig.send_as(who, &words).map(|reply| reply.len())
    };
    let most = wire::GUEST_READS as u32;
    let mut rig = Rig::armed();
    assert_eq!(read(&mut rig, BOB, most), Ok(4 + wire::GUEST_READS));
    assert_eq!(read(&mut rig, BOB, most + 1), Err(Refusal::Oversized));
    assert_eq!(
        read(&mut rig, ALICE, 200),
        Ok(204),
        "the owner knows its time"
    );
    let mut probe = vec![0x4e6f_1144, 0];
    probe.resize(100, 0);
    assert_eq!(rig.send_as(BOB, &probe), Err(Refusal::Oversized));
    assert_eq!(
        read(&mut Rig::new(), BOB, 200),
        Ok(204),
        "a machine at rest has time for any client"
    );
}

#[test]
fn without_a_session_no_client_configures() {
    assert_eq!(
        Rig::new().write(map::CONFIG_STEPGEN, 60),
        Err(Refusal::NotOwner)
    );
    assert_eq!(
        Rig::new().write(map::SERVICE + 4, 1),
        Err(Refusal::NotOwner)
    );
}

#[test]
fn a_wrong_token_releases_nothing() {
    let mut rig = Rig::new();
    let token = rig.acquire();
    assert_eq!(
        rig.write(map::SESSION_RELEASE, token ^ 1),
        Err(Refusal::NotOwner)
    );
    assert_eq!(rig.write(map::SESSION_RELEASE, token), Ok(()));
    assert_eq!(rig.read(map::SESSION_OWNER_IP), Ok(0));
}

#[test]
fn no_client_takes_over_a_machine_in_any_state_while_its_owner_is_there() {
    let disarmed = || {
        let mut rig = Rig::new();
        rig.acquire();
        rig
    };
    let stopping = || {
        let mut rig = Rig::armed();
        rig.exchange(false, false).unwrap();
        rig
    };
    let faulted = || {
        let mut rig = Rig::armed();
        rig.board.estop = true;
        rig.server.poll(&mut rig.board);
        rig
    };
    for (state, mut rig) in [
        (State::Disarmed, disarmed()),
        (State::Armed, Rig::armed()),
        (State::Stopping, stopping()),
        (State::Faulted, faulted()),
    ] {
        assert_eq!(rig.server.safety().state(), state);
        let token = rig.read(map::SESSION_TOKEN).unwrap();
        let before = rig.board.changes();
        let other_port = Peer {
            port: ALICE.port + 1,
            ..ALICE
        };
        for stranger in [BOB, other_port] {
            let refused = rig.write_as(stranger, map::SESSION_ACQUIRE, 7);
            assert_eq!(refused, Err(Refusal::NotOwner), "{state}");
            let refused = rig.write_as(stranger, map::SESSION_RELEASE, token);
            assert_eq!(refused, Err(Refusal::NotOwner), "{state}");
        }
        assert_eq!(
            rig.board.changes(),
            before,
            "{state}: the board was changed"
        );
        assert_eq!(rig.read(map::SESSION_TOKEN), Ok(token), "{state}");
        assert_eq!(rig.server.safety().state(), state);
    }
}

#[test]
fn a_token_of_an_earlier_session_is_invalid_and_feeds_nothing() {
    let mut rig = Rig::armed();
    let first = rig.read(map::SESSION_TOKEN).unwrap();
    rig.board.bite();
    rig.server.poll(&mut rig.board);
    let fed = |rig: &Rig| {
        let feeds = |change: &&Change| matches!(change, Change::Feed(_));
        rig.board.done.iter().filter(feeds).count()
    };
    let before = fed(&rig);
    // Without a session, then with her own new one, then with another client's.
    for owner in [None, Some(ALICE), Some(BOB)] {
        if let Some(owner) = owner {
            rig.server.session = crate::session::Session::new();
            rig.board.now += 1;
            rig.write_as(owner, map::SESSION_ACQUIRE, 7).unwrap();
        }
        let command = wire::exchange::Command {
            token: first,
            sequence: 1_000,
            ..Default::default()
        };
        for sender in [ALICE, BOB] {
            let refused = rig.exchange_as(sender, &command);
            assert_eq!(refused, Err(Refusal::NotOwner), "{owner:?}");
            let refused = rig.write_as(sender, map::SESSION_RELEASE, first);
            assert_eq!(refused, Err(Refusal::NotOwner), "{owner:?}");
        }
    }
    assert_eq!(fed(&rig), before);
}

#[test]
fn the_same_nonce_again_gives_another_token() {
    let mut rig = Rig::new();
    let mut tokens = Vec::new();
    for _ in 0..100 {
        rig.board.now += 1;
        let token = rig.acquire();
        assert!(!tokens.contains(&token));
        tokens.push(token);
    }
}

#[test]
fn a_token_is_made_of_the_boot_id_and_of_what_only_the_owner_proved() {
    for key in [None, Some([0xfeed_0001, 2, 3, 4])] {
        let mut rig = Rig::new();
        rig.server.auth.lock(key.unwrap_or_default());
        let challenge = *rig.server.auth.challenge(ALICE);
        let head = Purpose::Acquire.head(challenge);
        let answer = key.map(|key| crate::auth::tag(&key, &head, &[7]));
        let mut words = vec![HEADER, 0, 0x000f_0400, map::SESSION_RESPONSE];
        words.extend(answer.unwrap_or_default());
        words.extend([0x000f_0100, map::SESSION_ACQUIRE, 7]);
        assert_eq!(rig.send(&words), Ok(vec![]));
        let [secret, ..] = answer.unwrap_or_default();
        let mut wanted = Session::new();
        wanted
            .acquire(ALICE, 7, BOOT.id ^ secret, rig.board.now)
            .unwrap();
        let token = rig.read(map::SESSION_TOKEN);
        assert_eq!(token, Ok(wanted.token_for(ALICE)), "{key:?}");
    }
}

#[test]
fn every_client_sees_the_owner_and_its_last_command() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.exchange(true, false).unwrap();
    rig.exchange(true, false).unwrap();
    assert_eq!(rig.read_as(BOB, map::SESSION_LAST_SEQ), Ok(2));
    assert_eq!(rig.read_as(BOB, map::SESSION_OWNER_IP), Ok(ALICE.ip));
    assert_eq!(
        rig.read_as(BOB, map::SESSION_OWNER_PORT),
        Ok(u32::from(ALICE.port))
    );
}

#[test]
fn a_silent_owner_loses_an_idle_machine_after_three_seconds() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.server.poll(&mut rig.board);
    rig.board.now += 3 * u64::from(CLOCK) - 1;
    rig.server.poll(&mut rig.board);
    assert_eq!(
        rig.write_as(BOB, map::SESSION_ACQUIRE, 7),
        Err(Refusal::NotOwner)
    );
    rig.board.now += 1;
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.write_as(BOB, map::SESSION_ACQUIRE, 7), Ok(()));
}

#[test]
fn an_owner_that_keeps_talking_keeps_it() {
    let mut rig = Rig::new();
    rig.acquire();
    for _ in 0..10 {
        rig.exchange(true, false).unwrap();
        rig.server.poll(&mut rig.board);
        rig.board.now += 2 * u64::from(CLOCK);
        rig.server.poll(&mut rig.board);
    }
    assert!(rig.server.session().is_owner(ALICE));
}

#[test]
fn a_restart_needs_the_owner_or_no_owner_and_is_refused_while_armed() {
    let mut rig = Rig::armed();
    assert_eq!(
        rig.write(map::SESSION_REBOOT, map::REBOOT_KEY),
        Err(Refusal::Armed)
    );
    let mut rig = Rig::new();
    assert_eq!(rig.write(map::SESSION_REBOOT, 1), Err(Refusal::Value));
    assert!(!rig.server.wants_restart());
    assert_eq!(rig.write(map::SESSION_REBOOT, map::REBOOT_KEY), Ok(()));
    assert!(rig.server.wants_restart());
}

// ---- Configuration ---------------------------------------------------------------------------------------

#[test]
fn while_armed_only_what_is_safe_live_can_change() {
    let mut rig = Rig::armed();
    for address in [
        map::CONFIG_STEPGEN,
        map::CONFIG_STEPGEN + 16,
        map::CONFIG_STEPGEN + 20,
        map::CONFIG_PWM + 4,
        map::CONFIG_ENCODER + 4,
        map::CONFIG_BOARD,
        map::CONFIG_BOARD + 8,
        map::CONFIG_BOARD + 16,
        map::CONFIG_DEBOUNCE,
    ] {
        assert_eq!(rig.write(address, 1), Err(Refusal::Armed), "{address:#x}");
    }
    assert_eq!(
        rig.write(map::SERVICE + 16 * 0x800, 60),
        Err(Refusal::Armed)
    );
    assert_eq!(rig.write(map::CONFIG_PWM, 3000), Ok(()));
}

#[test]
fn a_setting_out_of_range_is_refused_and_the_old_one_stays() {
    let mut rig = Rig::new();
    rig.acquire();
    rig.write(map::CONFIG_STEPGEN, 60).unwrap();
    assert_eq!(rig.write(map::CONFIG_STEPGEN, 8_192), Err(Refusal::Value));
    assert_eq!(rig.read(map::CONFIG_STEPGEN), Ok(60));
}

#[test]
fn a_setting_of_a_channel_that_is_not_there_is_refused() {
    let mut rig = Rig::new();
    rig.acquire();
    assert_eq!(
        rig.write(map::CONFIG_STEPGEN + 6 * map::CONFIG_STRIDE, 1),
        Err(Refusal::Unmapped)
    );
}

#[test]
fn acquiring_an_armed_machine_again_stops_it_and_configures_nothing_in_the_same_breath() {
    let mut rig = Rig::armed();
    let words = [
        HEADER,
        0,
        0x000f_0100,
        map::SESSION_ACQUIRE,
        8,
        0x000f_0100,
        map::CONFIG_STEPGEN,
        60,
    ];
    assert_eq!(rig.send(&words), Err(Refusal::Armed));
    assert!(rig.server.safety().state() == State::Armed);
    rig.write(map::SESSION_ACQUIRE, 8).unwrap();
    assert_eq!(rig.server.safety().state(), State::Stopping);
}

#[test]
fn raw_registers_are_readable_by_all_and_the_scratch_one_writable_by_the_owner() {
    let mut rig = Rig::new();
    assert_eq!(
        rig.read(map::SERVICE + 0x800),
        Ok((map::SERVICE + 0x800) ^ 0x5555_0000)
    );
    rig.acquire();
    rig.write(map::SERVICE + 4, 5).unwrap();
    assert_eq!(
        rig.board.done.last(),
        Some(&Change::Csr(map::SERVICE + 4, 5))
    );
    let watchdog_control = map::SERVICE + 10 * 0x800 + 12;
    assert_eq!(
        rig.write(watchdog_control, 0x4152_4d31),
        Err(Refusal::ReadOnly)
    );
}

// ---- Segments ---------------------------------------------------------------------------------------------

/// A board with jobs streamed by a PC, armed by Alice, and the number of her next datagram.
fn streamed() -> (Rig, u32) {
    let mut rig = Rig::new();
    rig.server.jobs(JobsState::Streamed);
    rig.arm();
    let last = rig.read(map::SESSION_SEGMENTS).unwrap();
    (rig, last.wrapping_add(1))
}

/// A whole session, with an exchange in motion, until the machine is at rest; whether the segments
/// core was read, and written.
fn meets_segments(mut rig: Rig) -> (bool, bool) {
    let page = |address: u32| (map::SEGMENTS..map::SEGMENTS + 0x800).contains(&address);
    rig.arm();
    rig.exchange(true, true).unwrap();
    rig.server.hold_path(&mut rig.board);
    let owner = rig.server.session().token_for(ALICE);
    rig.write(map::SESSION_RELEASE, owner).unwrap();
    rig.board.gate = 0;
    rig.server.poll(&mut rig.board);
    assert!(rig.server.safety().at_rest());
    let written = |change: &Change| matches!(change, Change::Csr(address, _) if page(*address));
    let (asked, done) = (&rig.board.asked, &rig.board.done);
    (
        asked.iter().any(|address| page(*address)),
        done.iter().any(written),
    )
}

#[test]
fn a_board_without_the_segments_core_is_neither_asked_for_it_nor_told_anything() {
    assert_eq!(meets_segments(Rig::new()), (false, false));
    assert_eq!(meets_segments(Rig::with_segments()), (true, true));
}

/// Two segments' words, a push behind each, and what is wanted to be known then.
fn two_segments(number: u32) -> Vec<u32> {
    let mut words = vec![HEADER, 0, 0x000f_0100, map::SESSION_SEGMENTS, number];
    for n in 0..2 {
        words.extend([0x000f_0800, map::SEGMENTS, 6000 + n, 1, 2, 3, 4, 5, 6, 7]);
        words.extend([0x000f_0100, map::SEGMENTS + 64, 0]);
    }
    words.extend([0x000f_0001, 0x99, map::SEGMENTS + 88]);
    words
}

fn written(rig: &mut Rig) -> Vec<(u32, u32)> {
    let done = core::mem::take(&mut rig.board.done);
    let csr = done.into_iter().filter_map(|change| match change {
        Change::Csr(address, value) => Some((address - map::SEGMENTS, value)),
        Change::Strobe(_) | Change::Feed(_) | Change::Order(_) | Change::Set(..) => None,
    });
    csr.collect()
}

#[test]
fn the_owner_of_a_streamed_board_writes_segments_while_it_is_armed_each_datagram_once_and_in_order()
{
    let (mut rig, number) = streamed();
    written(&mut rig);
    let status = (map::SEGMENTS + 88) ^ 0x5555_0000;
    let answer = Ok(vec![HEADER, 0, 0x000f_0100, 0x99, status]);
    assert_eq!(rig.send(&two_segments(number)), answer);
    let pushed: Vec<u32> = written(&mut rig).iter().map(|(at, _)| *at).collect();
    let one = [0, 4, 8, 12, 16, 20, 24, 28, 64];
    assert_eq!(pushed, [one, one].concat());
    assert_eq!(rig.read(map::SESSION_SEGMENTS), Ok(number));
    for (again, why) in [
        (number, Refusal::Stale),
        (number.wrapping_sub(1), Refusal::Stale),
        (number.wrapping_add(2), Refusal::Stale),
    ] {
        assert_eq!(rig.send(&two_segments(again)), Err(why));
    }
    assert_eq!(written(&mut rig), []);
    assert_eq!(rig.send(&two_segments(number.wrapping_add(1))), answer);
    assert_eq!(rig.server.safety().state(), State::Armed);
}

#[test]
fn words_for_the_segments_without_a_number_in_front_of_them_are_refused() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    assert_eq!(rig.write(map::SEGMENTS, 6000), Err(Refusal::ReadOnly));
    // The number after the words it belongs to.
    let words = [
        HEADER,
        0,
        0x000f_0100,
        map::SEGMENTS,
        6000,
        0x000f_0100,
        map::SESSION_SEGMENTS,
        number,
    ];
    assert_eq!(rig.send(&words), Err(Refusal::ReadOnly));
    assert_eq!(rig.read(map::SESSION_SEGMENTS), Ok(number.wrapping_sub(1)));
    assert_eq!(written(&mut rig), []);
}

#[test]
fn what_the_segments_say_is_no_more_writable_than_other_registers() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    for word in 22..40 {
        let to = map::SEGMENTS + 4 * word;
        let words = [
            HEADER,
            0,
            0x000f_0100,
            map::SESSION_SEGMENTS,
            number,
            0x000f_0100,
            to,
            1,
        ];
        assert_eq!(rig.send(&words), Err(Refusal::ReadOnly), "word {word}");
    }
    assert_eq!(written(&mut rig), []);
}

#[test]
fn only_the_owner_writes_segments_and_every_client_reads_them() {
    let (mut rig, number) = streamed();
    written(&mut rig);
    assert_eq!(
        rig.send_as(BOB, &two_segments(number)[..5]),
        Err(Refusal::NotOwner)
    );
    assert_eq!(
        rig.write_as(BOB, map::SEGMENTS, 6000),
        Err(Refusal::ReadOnly)
    );
    let status = map::SEGMENTS + 88;
    assert_eq!(rig.read_as(BOB, status), Ok(status ^ 0x5555_0000));
    assert_eq!(written(&mut rig), []);
    // Datagrams on their way when the session ended do not belong to the next one.
    rig.board.bite();
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.send(&two_segments(number)), Err(Refusal::NotOwner));
    rig.board.now += 1;
    rig.acquire();
    written(&mut rig);
    assert_eq!(rig.send(&two_segments(number)), Err(Refusal::Stale));
    assert_eq!(written(&mut rig), []);
}

#[test]
fn a_board_that_executes_jobs_by_itself_or_none_takes_no_segments() {
    for state in JobsState::ALL
        .iter()
        .filter(|state| **state != JobsState::Streamed)
    {
        let mut rig = Rig::new();
        rig.server.jobs(*state);
        rig.arm();
        let number = rig.read(map::SESSION_SEGMENTS).unwrap().wrapping_add(1);
        written(&mut rig);
        assert_eq!(
            rig.send(&two_segments(number)),
            Err(Refusal::ReadOnly),
            "{state:?}"
        );
        assert_eq!(
            rig.write(map::SEGMENTS + 68, 1),
            Err(Refusal::ReadOnly),
            "{state:?}"
        );
        assert_eq!(written(&mut rig), [], "{state:?}");
        let status = map::SEGMENTS + 88;
        assert_eq!(rig.read(status), Ok(status ^ 0x5555_0000), "{state:?}");
    }
}

// ---- The exchange ---------------------------------------------------------------------------------------

#[test]
fn an_exchange_commits_samples_feeds_and_answers() {
    let mut rig = Rig::armed();
    rig.board.done.clear();
    rig.board.now = 0x1_2345_6789;
    let mut command = rig.command(true, true);
    command.stepgen[5] = (StepRate(-7), Accel(9));
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
    assert_eq!(status.stepgen[5].1, StepRate(0x1000 + 8 + 17));
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
            ..SIX
        };
        let mut rig = Rig::with_channels(channels);
        rig.arm();
        let mut command = rig.command(true, true);
        for channel in 0..16 {
            let word = channel as i32;
            command.stepgen[channel] = (StepRate(-1 - word), Accel(100 + channel as u32));
            command.pwm[channel] = 200 + channel as u32;
        }
        let status = rig.exchange_as(ALICE, &command).unwrap();
        for channel in 0..16 {
            let (rate, accel) = command.stepgen[channel];
            let there = channel < usize::from(channels.stepgens);
            let staged = &rig.board.live[4 + 2 * channel..][..2];
            let wanted = [rate.0 as u32, accel.0].map(|word| if there { word } else { 0 });
            assert_eq!(staged, wanted, "stepgen {channel}, {channels:?}");
            let word = 0x1000 + 8 + 3 * channel as u32;
            let position = Position::from_words(word, word + 1);
            let wanted = (position, StepRate(word as i32 + 2));
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
        (Latch::Encoder(0), 88),
        (Latch::Encoder(15), 103),
        (Latch::Stepgen(0), 104),
        (Latch::Stepgen(5), 109),
        (Latch::Stepgen(15), 119),
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
    command.stepgen[0].0 = StepRate(1000);
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
fn nothing_is_rehearsed_while_a_timed_commit_waits() {
    let mut rig = Rig::armed();
    assert!(rig.server.may_rehearse());
    let command = Command {
        apply_at: Some(Clocks(0x5_0000_0007)),
        ..rig.command(true, true)
    };
    rig.exchange_as(ALICE, &command).unwrap();
    assert!(!rig.server.may_rehearse());
    rig.exchange(true, true).unwrap();
    assert!(rig.server.may_rehearse());
}

#[test]
fn a_setting_that_may_change_while_armed_leaves_the_command_as_it_is() {
    let mut rig = Rig::armed();
    let mut command = rig.command(true, true);
    command.stepgen[0].0 = StepRate(1000);
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

// ---- Stops ----------------------------------------------------------------------------------------------

#[test]
fn a_bite_kills_the_session_and_recovery_needs_resync_and_edge() {
    let mut rig = Rig::armed();
    rig.board.bite();
    assert_eq!(rig.exchange(true, true), Err(Refusal::NotOwner));
    assert_eq!(rig.read(map::SESSION_OWNER_IP), Ok(0));
    assert_eq!(rig.server.safety().reason(), FaultReason::Watchdog);
    rig.acquire();
    for _ in 0..3 {
        let status = rig.exchange(true, true).unwrap();
        assert_eq!(
            (status.state.state, status.state.bitten),
            (State::Faulted, true)
        );
    }
    rig.exchange(true, false).unwrap();
    rig.exchange(true, true).unwrap();
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        (status.state.state, status.state.bitten),
        (State::Armed, false)
    );
}

#[test]
fn the_trust_after_a_bite_counts_from_the_last_look_at_the_running_machine() {
    const GRACE: u32 = 1_000;
    for looked in [false, true] {
        let mut rig = Rig::new();
        rig.board
            .set(Setting::Board(BoardConfig::WatchdogGrace), GRACE);
        rig.arm();
        rig.board.now += 1_000_000;
        if looked {
            rig.server.poll(&mut rig.board);
        }
        rig.board.now += u64::from(GRACE) - 1;
        rig.board.bite();
        rig.server.poll(&mut rig.board);
        assert_eq!(rig.server.safety().state(), State::Faulted);
        assert_eq!(rig.server.safety().position_trusted(), looked);
    }
}

#[test]
fn after_a_bite_another_host_may_take_over() {
    let mut rig = Rig::armed();
    rig.board.bite();
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.write_as(BOB, map::SESSION_ACQUIRE, 5), Ok(()));
}

#[test]
fn at_rest_nothing_stale_waits_behind_the_gate() {
    let mut rig = Rig::with_segments();
    rig.arm();
    let mut command = rig.command(true, true);
    command.stepgen[0].0 = StepRate(1000);
    rig.exchange_as(ALICE, &command).unwrap();
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.board.live[4], 1000);
    rig.board.bite();
    rig.board.done.clear();
    rig.server.poll(&mut rig.board);
    rig.server.poll(&mut rig.board);
    assert_eq!(rig.board.live, [0; command::WORDS]);
    // Word 21 of the segments core: no output follows a job any more.
    let mask = Change::Csr(map::SEGMENTS + 84, 0);
    let done = rig.board.done.iter();
    assert_eq!(done.filter(|change| **change == mask).count(), 1);
}

#[test]
fn releasing_the_session_of_an_armed_machine_stops_it_softly() {
    let mut rig = Rig::armed();
    let token = rig.read(map::SESSION_TOKEN).unwrap();
    rig.write(map::SESSION_RELEASE, token).unwrap();
    assert_eq!(
        rig.board.done.last(),
        Some(&Change::Order(Control::SoftStop))
    );
    assert_eq!(rig.server.safety().state(), State::Stopping);
}

#[test]
fn a_board_of_another_abi_describes_itself_and_never_arms() {
    let mut rig = Rig::with_abi(1);
    rig.acquire();
    for request in [false, true, true, false, true, true] {
        let status = rig.exchange(true, request).unwrap();
        assert_eq!(status.state.reason, FaultReason::AbiMismatch);
        assert!(!status.state.enabled);
    }
    assert_eq!(rig.read(4 * 2), Ok(ABI));
    assert_eq!(rig.read(4 * 3), Ok(1));
    assert_eq!((rig.server.abi(), rig.server.ident().abi), (ABI, 1));
    assert_eq!(rig.read(4 * 15), Ok(wire::describe::OBSTACLE_ABI));
}

#[test]
fn the_short_way_to_a_state_word_says_what_the_long_one_says() {
    for mut rig in [Rig::new(), Rig::armed(), Rig::with_abi(1)] {
        for gate in (0..256).map(Gate) {
            assert_eq!(
                rig.server.state_word(gate),
                rig.server.state(gate, false).to_word()
            );
        }
        rig.board.bite();
        rig.server.poll(&mut rig.board);
        let gate = rig.board.gate();
        assert_eq!(
            rig.server.state_word(gate),
            rig.server.state(gate, false).to_word()
        );
    }
}

// ---- Windows --------------------------------------------------------------------------------------------

#[test]
fn every_window_ends_where_the_map_says() {
    let mut rig = Rig::new();
    let windows = [
        (map::DESCRIBE, 0x2000),
        (map::SESSION, 0x40),
        (map::CONFIG, 0x1000),
        (map::COMMAND, 0x1000),
        (map::STATUS, 0x400),
        (map::COUNTERS, 0x1000),
        (map::LOG, map::LOG_RING + 0x1000 - map::LOG),
        (
            map::PANIC,
            map::PANIC_TEXT + map::PANIC_TEXT_LEN - map::PANIC,
        ),
        (map::FLASH, map::FLASH_LEN),
    ];
    let inside = |address: u32| {
        let mut each = windows.iter();
        each.any(|(start, length)| (*start..start + length).contains(&address))
    };
    for (start, length) in windows {
        let end = start + length;
        for address in [start, start + 4, end - 4, end, end + 4] {
            let readable = rig.read_as(BOB, address).map(drop);
            let wanted = if inside(address) {
                Ok(())
            } else {
                Err(Refusal::Unmapped)
            };
            assert_eq!(readable, wanted, "{address:#x}");
            assert_eq!(rig.read_as(BOB, address + 2), Err(Refusal::Alignment));
        }
    }
}

#[test]
fn an_onlooker_finds_every_word_of_the_status_where_the_owner_does() {
    for n in [0u8, 1, 6, 15, 16] {
        let channels = Channels {
            stepgens: n,
            encoders: 16 - n,
            ..SIX
        };
        let mut rig = Rig::with_channels(channels);
        rig.arm();
        rig.board.now = 0x1_2345_6789;
        assert_eq!(rig.send(&[]), Err(Refusal::Short));
        let mut status = rig.exchange(true, true).unwrap();
        assert_eq!(status.refused, Count(1));
        (status.state.accepted, status.state.session_yours) = (false, false);
        let mut words = [0; STATUS_MAX];
        let words = status.emit(channels, &mut words).unwrap();
        for (word, wanted) in (0u32..).zip(words) {
            let seen = rig.read_as(BOB, map::STATUS + 4 * word);
            assert_eq!(seen, Ok(*wanted), "word {word}, {channels:?}");
        }
        for behind in words.len() as u32..words.len() as u32 + 3 {
            assert_eq!(rig.read_as(BOB, map::STATUS + 4 * behind), Ok(0));
        }
    }
}

#[test]
fn the_counters_window_has_a_word_for_each_counter_and_zeros_behind() {
    let mut rig = Rig::new();
    rig.server.counters = Counters {
        frames_rx: 11,
        frames_tx: 12,
        exchanges: 13,
        refused_total: 14,
        cuts: 77,
        refused: core::array::from_fn(|reason| 100 + reason as u32),
    };
    let count = 3 + Refusal::COUNT as u32;
    for word in 0..count + 3 {
        let wanted = match word {
            0..3 => 11 + word,
            _ if word < count => 100 + word - 3,
            _ if word == count => 77,
            _ => 0,
        };
        assert_eq!(rig.read_as(BOB, map::COUNTERS + 4 * word), Ok(wanted));
    }
}

#[test]
fn the_blob_is_as_long_as_the_gateware_says() {
    let mut rig = Rig::new();
    for word in 0..5 {
        let wanted = if word < 3 { 0xb10b_0000 + word } else { 0 };
        assert_eq!(rig.read_as(BOB, map::DESCRIBE_BLOB + 4 * word), Ok(wanted));
    }
}

#[test]
fn the_description_is_one_the_host_understands() {
    let mut rig = Rig::new();
    rig.acquire();
    let words: [u32; 18] = core::array::from_fn(|word| rig.read(4 * word as u32).unwrap());
    let describe = wire::describe::Describe::parse(&words).unwrap();
    assert_eq!(
        (describe.channels, describe.clock_hz, describe.boot_id),
        (SIX, CLOCK, 9)
    );
    assert_eq!(describe.firmware_version, crate::VERSION);
    assert!(describe.state.session_yours && describe.obstacles == 0);
    assert_eq!(
        (describe.reset_reason, describe.gate_close),
        (wire::ResetReason::Requested, GateClose::Never)
    );
    rig.board.close = GateClose::EStop as u32;
    assert_eq!(rig.read(4 * 17), Ok(5));
    assert_eq!(rig.read(0xfc), Ok(0));
    assert_eq!(rig.read(0x108), Ok(0xb10b_0002));
    assert_eq!(rig.read(0x10c), Ok(0), "behind the blob");
}

#[test]
fn the_flash_window_says_what_the_link_and_the_address_are() {
    let mut rig = Rig::new();
    rig.server.ip = 0xc0a8_02aa;
    rig.board.link = crate::cores::Link {
        status: 0b1011,
        errors: 0x1234,
    };
    for _ in 0..4 {
        rig.server.look_at_link(&mut rig.board);
    }
    let link = rig.server.link().word();
    assert_eq!((link.speed, link.errors), (wire::LinkSpeed::M100, 0x1234));
    assert_eq!(rig.read_as(BOB, map::FLASH_LINK), Ok(link.to_word()));
    assert_eq!(rig.read_as(BOB, map::FLASH_IP), Ok(0xc0a8_02aa));
}

#[test]
fn counters_count() {
    let mut rig = Rig::armed();
    assert_eq!(rig.read(map::COUNTERS + 8), Ok(3));
    let _ = rig.send(&[]);
    assert_eq!(rig.read(map::COUNTERS_REFUSED), Ok(1));
    assert_eq!(rig.exchange(true, true).unwrap().refused.0, 1);
}

#[test]
fn log_and_obituary_can_be_read() {
    let mut rig = Rig::new();
    rig.board.ring.push(b"hello, machine");
    let _ = rig.board.record.boot(0);
    rig.board.record.die(wire::ResetReason::Panic, |out| {
        out.text("boom");
    });
    assert_eq!(rig.read(map::LOG), Ok(14));
    assert_eq!(rig.read(map::LOG + 4), Ok(64));
    assert_eq!(rig.read(map::LOG + 8), Ok(9));
    for (word, text) in (0..).zip([b"hell", b"o, m", b"achi"]) {
        let seen = rig.read(map::LOG_RING + 4 * word);
        assert_eq!(seen.map(u32::to_be_bytes), Ok(*text));
    }
    assert_eq!(rig.read(map::PANIC), Ok(1));
    assert_eq!(rig.read(map::PANIC + 4), Ok(4));
    assert_eq!(
        rig.read(map::PANIC_TEXT).map(u32::to_be_bytes),
        Ok(*b"boom")
    );
}

#[test]
fn a_board_without_an_owner_is_sampled_a_hundred_times_a_second_and_one_with_an_owner_is_not() {
    let mut rig = Rig::new();
    let period = u64::from(CLOCK / 100);
    let sampled = |rig: &mut Rig, now: u64| {
        rig.board.now = now;
        rig.board.done.clear();
        rig.server.poll(&mut rig.board);
        rig.board
            .done
            .contains(&Change::Strobe(timebase::STROBE_SAMPLE))
    };
    assert!(!sampled(&mut rig, period - 1));
    assert!(sampled(&mut rig, period));
    assert!(!sampled(&mut rig, period + 1));
    assert!(!sampled(&mut rig, 2 * period - 1));
    assert!(sampled(&mut rig, 2 * period));
    rig.acquire();
    assert!(!sampled(&mut rig, 4 * period));
}

#[test]
fn a_link_that_goes_down_stops_a_host_and_not_a_job() {
    for (owner, state) in [(ALICE, State::Stopping), (Peer::INSIDE, State::Armed)] {
        let mut rig = Rig::new();
        rig.write_as(owner, map::SESSION_ACQUIRE, 7).unwrap();
        for (sequence, request) in [(1, false), (2, true), (3, true)] {
            let command = Command {
                token: rig.server.session().token_for(owner),
                sequence,
                ..rig.command(true, request)
            };
            rig.exchange_as(owner, &command).unwrap();
        }
        for _ in 0..4 {
            rig.server.look_at_link(&mut rig.board);
        }
        assert_eq!(rig.server.safety().state(), State::Armed, "the link is up");
        rig.board.link.status = 0;
        for _ in 0..4 {
            rig.server.look_at_link(&mut rig.board);
        }
        assert_eq!(rig.server.safety().state(), state, "{owner:?}");
    }
}

#[test]
fn the_led_tells_the_states_apart() {
    let mut rig = Rig::new();
    let shows = |rig: &mut Rig, led: Led| {
        rig.server.poll(&mut rig.board);
        assert_eq!(rig.board.led, led);
    };
    shows(&mut rig, Led::Heartbeat);
    rig.server.counters_mut().frames_rx += 1;
    shows(&mut rig, Led::Slow);
    rig.board.now += 3 * u64::from(CLOCK) - 1;
    shows(&mut rig, Led::Slow);
    rig.board.now += 1;
    shows(&mut rig, Led::Heartbeat);
    rig.server.counters_mut().frames_rx += 1;
    shows(&mut rig, Led::Slow);
    rig.acquire();
    shows(&mut rig, Led::Double);
    rig.arm();
    shows(&mut rig, Led::On);
    rig.exchange(false, true).unwrap();
    shows(&mut rig, Led::Flicker);
    rig.board.gate = 0;
    shows(&mut rig, Led::Double);
    rig.arm();
    rig.board.bite();
    shows(&mut rig, Led::Fast);
    rig.board.estop = true;
    shows(&mut rig, Led::Triple);
    rig.board.estop = false;
    shows(&mut rig, Led::Triple);
}

#[test]
fn an_e_stop_keeps_the_session_and_comes_back_by_the_documented_way_only() {
    let mut rig = Rig::armed();
    rig.board.estop = true;
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        (status.state.state, status.state.reason),
        (State::Faulted, FaultReason::EStop)
    );
    assert!(status.state.estop && !status.state.enabled && !status.state.position_trusted);
    for _ in 0..2 {
        // An edge while the input is still active clears nothing.
        rig.exchange(true, false).unwrap();
        rig.exchange(true, true).unwrap();
        let status = rig.exchange(true, true).unwrap();
        assert_eq!(status.state.state, State::Faulted);
    }
    rig.board.estop = false;
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        (status.state.state, status.state.estop),
        (State::Faulted, true),
        "released is not forgotten"
    );
    rig.exchange(true, false).unwrap();
    rig.exchange(true, true).unwrap();
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(status.state.state, State::Faulted, "not without a resync");
    rig.acquire();
    rig.exchange(true, false).unwrap();
    rig.exchange(true, true).unwrap();
    let status = rig.exchange(true, true).unwrap();
    assert_eq!(
        (status.state.state, status.state.reason, status.state.estop),
        (State::Armed, FaultReason::None, false)
    );
}

#[test]
fn a_board_restarted_under_a_hung_cpu_still_knows_why_it_stopped() {
    for (close, reason) in [
        (GateClose::Never, FaultReason::None),
        (GateClose::Bite, FaultReason::Watchdog),
        (GateClose::EStop, FaultReason::EStop),
    ] {
        let mut rig = Rig::new();
        rig.board.close = close as u32;
        let ident = *rig.server.ident();
        rig.server = Server::new(ident, ABI, BOOT);
        rig.server.start(&mut rig.board);
        assert_eq!(rig.server.safety().reason(), reason, "{close}");
    }
}

#[test]
fn only_the_board_settings_are_named_board() {
    // The match in `config` has a wildcard over word numbers; this pins its last arm.
    let setting = config::setting_at(map::CONFIG_BOARD + 16, SIX);
    assert_eq!(setting, Some(Setting::Board(BoardConfig::Probe)));
    let setting = config::setting_at(map::CONFIG_STEPGEN + 20, SIX);
    assert_eq!(setting, Some(Setting::Stepgen(0, StepgenConfig::Mode)));
}
