//! Bites, releases, boards that never arm, and the state word.

use super::*;
use wire::describe;

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
    command.stepgen[0].0 = Velocity(1000);
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
    assert_eq!(
        rig.read(describe::address(describe::ABI_FIRMWARE_AT)),
        Ok(ABI)
    );
    assert_eq!(
        rig.read(describe::address(describe::ABI_FIRMWARE_AT + 1)),
        Ok(1)
    );
    assert_eq!((rig.server.abi(), rig.server.ident().abi), (ABI, 1));
    assert_eq!(
        rig.read(describe::address(describe::OBSTACLES_AT)),
        Ok(describe::OBSTACLE_ABI)
    );
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
