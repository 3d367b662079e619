//! Settings and raw registers.

use super::*;

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
