//! Records as Etherbone has them: golden vectors, limits, all or nothing.

use super::*;

// ---- Golden vectors (LiteEth, LiteX RemoteClient) -----------------------------------------------

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

// ---- Behaviours on which LiteEth trips ----------------------------------------------------------

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

// ---- All or nothing -----------------------------------------------------------------------------

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
