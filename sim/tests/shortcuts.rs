//! The shim's shortcuts (no falling edges, no input logic when no input moved) change no pin.
//!
//! Needs both libraries of a Verilated SoC and an image: `FERROCNC_SOC=target/sim/mill6
//! FERROCNC_FIRMWARE=... cargo test -p ferrocnc-sim --test shortcuts -- --ignored` (build the
//! second library with `build.sh ... --trace vcd`).

use sim::board::TraceWindow;
use sim::faults::{Direction, Kind};
use sim::rig::{Rig, Setup};

#[test]
#[ignore = "needs a Verilated SoC built with and without --trace"]
fn the_fast_model_and_the_plain_one_do_the_same() {
    let path = |name: &str| std::env::var(name).unwrap_or_else(|_| panic!("{name} is not set"));
    let (soc, elf) = (path("FERROCNC_SOC"), path("FERROCNC_FIRMWARE"));
    let start = |plain: bool| {
        let mut setup = Setup::new(soc.as_ref(), elf.as_ref());
        // Only the plain model can write waveforms; it is set to write them after the end of the
        // test.
        setup.trace = plain.then(|| TraceWindow {
            path: "/dev/null".into(),
            from: u64::MAX >> 1,
            clocks: 1,
        });
        let mut rig = Rig::power_up(setup).unwrap();
        rig.capture_frames();
        rig
    };
    let (mut fast, mut plain) = (start(false), start(true));
    let mut story = |name: &str, act: &mut dyn FnMut(&mut Rig)| {
        act(&mut fast);
        act(&mut plain);
        assert_eq!(fast.take_frames(), plain.take_frames(), "{name}: frames");
        assert_eq!(fast.clock(), plain.clock(), "{name}: clocks");
        assert_eq!(fast.pins(), plain.pins(), "{name}: pins");
        assert_eq!(
            fast.board.silicon().ram(),
            plain.board.silicon().ram(),
            "{name}: RAM"
        );
    };
    story("boot", &mut |rig| rig.wait_ready(3_000_000).unwrap());
    story("ping", &mut |rig| assert!(rig.ping().is_some()));
    story("inputs", &mut |rig| {
        rig.gpio_in(0x0000_0a5a);
        for _ in 0..40 {
            rig.board.plant.slip(0, 3);
            rig.board.plant.slip(3, -5);
            rig.run(100);
        }
    });
    story("registers", &mut |rig| {
        assert!(rig.read_block(wire::map::DESCRIBE, 64).is_some())
    });
    story("long", &mut |rig| {
        assert!(rig.read_block(wire::map::STATUS, 48).is_some())
    });
    story("damage", &mut |rig| {
        rig.inject_wire(vec![0x55; 40]);
        rig.faults.once(Direction::ToBoard, Kind::Corrupt(1.0));
        assert!(rig.ping().is_none());
        rig.faults.once(Direction::ToBoard, Kind::Corrupt(0.0));
    });
    story("frozen", &mut |rig| {
        rig.freeze_cpu(true);
        assert!(rig.ping().is_none());
    });
    story("thawed", &mut |rig| {
        rig.freeze_cpu(false);
        rig.run(50_000);
        assert!(rig.ping().is_some());
    });
    story("external reset", &mut |rig| {
        rig.ext_reset(true);
        rig.run(5000);
        rig.ext_reset(false);
        rig.run(5000);
    });
}
