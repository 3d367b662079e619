//! The contents of the windows.

use super::*;

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
        calls: [78, 79],
        ways: [80, 81],
        long_way: LongWay::Flags,
        refused: core::array::from_fn(|reason| 100 + reason as u32),
    };
    let count = 3 + Refusal::COUNT as u32;
    for word in 0..count + 9 {
        let wanted = match word {
            0..3 => 11 + word,
            _ if word < count => 100 + word - 3,
            _ if word < count + 5 => 77 + word - count,
            _ if word == count + 5 => LongWay::Flags as u32,
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
    assert_eq!(
        rig.read(wire::describe::address(wire::describe::GATE_CLOSE_AT)),
        Ok(5)
    );
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
