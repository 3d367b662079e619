//! Settings: saved, reported by discovery, and reset.

use crate::rig::*;
use ferrocnc_tests::bench::{Bench, Went};
use ferrocnc_tests::flash::{FIRST, factory};
use wire::discovery::{Body, Message};
use wire::flash::{Op, OpResult, Origin, Running};
use wire::map;
use wire::settings::{Settings, mac_of_uid};

#[test]
fn settings_are_in_force_after_a_power_cycle_and_the_newest_win() {
    for part in parts() {
        let mut bench = board(part);
        for n in 1..8 {
            let new = settings(n, &format!("mill {n}"));
            assert_eq!(bench.save(&new), Went::OK);
            bench = bench.power_cycle();
            assert_eq!(seen(&bench.settings()), seen(&new));
            let origin = bench.read(map::FLASH_ORIGIN);
            assert!(origin == Origin::Copy0.code() || origin == Origin::Copy1.code());
        }
        assert_eq!(bench.op(Op::ForgetSettings, 0, 0, &[]), Went::OK);
        bench = bench.power_cycle();
        assert_eq!(bench.read(map::FLASH_ORIGIN), Origin::BuiltIn.code());
        assert_eq!(bench.settings().ip, 0xc0a8_0232);
        assert_eq!(bench.nor().misuse(), []);
    }
}

#[test]
fn the_factory_pin_sets_saved_settings_aside_and_does_not_erase_them() {
    let mut bench = board(parts()[0]);
    let saved = settings(77, "lost");
    assert_eq!(bench.save(&saved), Went::OK);
    bench = bench.power_cycle_with_factory_pin();
    assert_eq!(bench.read(map::FLASH_ORIGIN), Origin::FactoryPin.code());
    assert_eq!(bench.settings().ip, 0xc0a8_0232);
    bench = bench.power_cycle();
    assert_eq!(seen(&bench.settings()), seen(&saved));
}

#[test]
fn settings_survive_the_plug_at_every_step_of_a_save() {
    let mut cuts = 0;
    for part in parts() {
        // The first save, the second, one onto an old copy, and forgetting.
        let mut bench = board(part);
        for saves in 0..4 {
            let old = bench.settings();
            let new = settings(100 + saves, "new");
            let nor = bench.nor().copy();
            cuts += cut_everywhere(
                &nor,
                0..6,
                |bench| bench.save(&new),
                |bench, cut| {
                    let mut bench = bench.power_cycle();
                    let now = seen(&bench.settings());
                    assert!(
                        now == seen(&old) || now == seen(&new),
                        "{} save {saves}, {cut:?}: {now:?}",
                        part.name
                    );
                    // And it can be set again.
                    let third = settings(200, "third");
                    assert_eq!(bench.save(&third), Went::OK, "{cut:?}");
                    let mut bench = bench.power_cycle();
                    assert_eq!(seen(&bench.settings()), seen(&third), "{cut:?}");
                },
            );
            assert_eq!(bench.save(&settings(saves + 1, "old")), Went::OK);
            bench = bench.power_cycle();
        }
    }
    report_cuts("saves", cuts);
}

#[test]
fn forgetting_settings_survives_the_plug_at_every_step() {
    let mut bench = board(parts()[0]);
    let built_in = bench.settings();
    for n in 1..3 {
        assert_eq!(bench.save(&settings(n, "saved")), Went::OK);
    }
    bench = bench.power_cycle();
    let saved = bench.settings();
    let nor = bench.nor().copy();
    let cuts = cut_everywhere(
        &nor,
        0..20,
        |bench| bench.op(Op::ForgetSettings, 0, 0, &[]),
        |bench, cut| {
            let mut bench = bench.power_cycle();
            let now = seen(&bench.settings());
            assert!(
                now == seen(&saved) || now == seen(&built_in),
                "{cut:?}: older settings came back: {now:?}"
            );
        },
    );
    report_cuts("forgetting", cuts);
}

#[test]
fn settings_told_by_discovery_survive_the_plug_at_every_step() {
    let bench = board(parts()[0]);
    let nor = bench.nor().copy();
    let new = settings(9, "told");
    let set = Message {
        nonce: 1,
        uid: [(UID >> 32) as u32, UID as u32],
        body: Body::Set(new),
    };
    let cuts = cut_everywhere(
        &nor,
        0..4,
        |bench| bench.discover(&set),
        |bench, cut| {
            let mut bench = bench.power_cycle();
            let now = seen(&bench.settings());
            assert!(
                now == seen(&new) || now.ip == 0xc0a8_0232,
                "{cut:?}: {now:?}"
            );
        },
    );
    report_cuts("a Set of discovery", cuts);
}

#[test]
fn settings_that_no_board_can_use_are_refused() {
    let mut bench = board(parts()[0]);
    for bad in [
        Settings {
            ip: 0,
            ..settings(1, "")
        },
        Settings {
            prefix: 31,
            ..settings(1, "")
        },
        Settings {
            port: 0,
            ..settings(1, "")
        },
        Settings {
            mac: [1, 0, 0, 0, 0, 0],
            ..settings(1, "")
        },
    ] {
        assert_eq!(bench.save(&bad), Went::Done(OpResult::Value), "{bad:?}");
    }
    let mut torn = settings(1, "").to_words();
    torn[4] ^= 1;
    let went = bench.op(Op::SaveSettings, 0, 0, &torn);
    assert_eq!(went, Went::Done(OpResult::Value));
    assert_eq!(bench.nor().programs(), 0);
}

#[test]
fn three_boards_with_one_address_are_told_apart_and_named_one_by_one() {
    let part = parts()[0];
    let uids = [0x11, 0x22, 0x33].map(|n| UID + n);
    let mut boards = uids.map(|uid| Bench::new(factory(part, uid)));
    let halves = |uid: u64| [(uid >> 32) as u32, uid as u32];
    let mut macs = std::collections::HashSet::new();
    for (bench, uid) in boards.iter_mut().zip(uids) {
        let answer = bench.present();
        assert_eq!((answer.nonce, answer.uid), (77, halves(uid)));
        let Body::Here(here) = answer.body else {
            panic!("{answer:?}");
        };
        assert_eq!((here.ip, here.port), (0xc0a8_0232, 1234));
        assert_eq!((here.running, here.build_id), (Running::A, FIRST));
        macs.insert(here.mac);
    }
    let expected: std::collections::HashSet<_> =
        uids.into_iter().map(halves).map(mac_of_uid).collect();
    assert_eq!(macs, expected, "each has a hardware address of its own");
    // Each is told in turn, and every board receives it.
    for (n, uid) in (0u32..).zip(uids) {
        let new = settings(101 + n, &format!("axis {n}"));
        let set = Message {
            nonce: 1000 + n,
            uid: halves(uid),
            body: Body::Set(new),
        };
        for (bench, own) in boards.iter_mut().zip(uids) {
            let answer = bench.discover(&set);
            let expected = (own == uid).then_some(Message {
                body: Body::Done(OpResult::Ok),
                ..set
            });
            assert_eq!(answer, expected, "board {own:x} told what is for {uid:x}");
        }
    }
    // They have restarted by themselves.
    for (n, bench) in (0u32..).zip(&mut boards) {
        bench.pass(200);
        let Body::Here(here) = bench.present().body else {
            panic!("no answer");
        };
        assert_eq!(here.ip, 0xc0a8_0200 + 101 + n);
        assert_eq!(here.name.text(), format!("axis {n}"));
    }
}
