//! Which client may do what, and when.

use super::*;

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
    let read = |rig: &mut Rig, peer, count: u32| {
        let mut words = vec![0x4e6f_1044, 0, 0x000f_0000 | count, 7];
        words.extend((0..count).map(|n| map::STATUS + 4 * n));
        rig.send_as(peer, &words).map(|reply| reply.len())
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
