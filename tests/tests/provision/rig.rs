//! Boards with a flash, and a power cut at every step.

use ferrocnc_tests::bench::{Bench, KEY};
use ferrocnc_tests::flash::{self, factory};
pub use ferrocnc_tests::flash::{SECOND, UID};
use sim::nor::{Cut, Nor, Order, Part, Times};
use std::ops::Range;
use wire::Name;
use wire::settings::{Settings, mac_of_uid};

/// The chips with short times, because ten thousand erases of 45 ms each would take too long.
pub fn parts() -> [Part; 3] {
    Part::ALL.map(|part| part.with(Times::QUICK))
}

pub fn board(part: Part) -> Bench {
    Bench::new(factory(part, UID))
}

pub fn settings(last_octet: u32, name: &str) -> Settings {
    Settings {
        ip: 0xc0a8_0200 + last_octet,
        name: Name::new(name).expect("a name"),
        key: KEY,
        ..Settings::default()
    }
}

/// All that can be compared after a save: the board numbers them itself, does not show the key, and
/// makes a hardware address where none is given.
pub fn seen(settings: &Settings) -> Settings {
    Settings {
        sequence: 0,
        keep_key: false,
        mac: match settings.mac {
            mac if mac == mac_of_uid([(UID >> 32) as u32, UID as u32]) => [0; 6],
            mac => mac,
        },
        ..settings.blanked()
    }
}

/// Does `job` on copies of this flash, each time with the power failing one step later, in `seeds`
/// ways each; hands what is left to `judge`. How many cuts there were.
pub fn cut_everywhere<R>(
    nor: &Nor,
    seeds: Range<u64>,
    job: impl Fn(&mut Bench) -> R,
    judge: impl Fn(Bench, Cut),
) -> u64 {
    let mut whole = Bench::new(nor.copy());
    let begun = whole.nor().steps();
    job(&mut whole);
    let steps = whole.nor().steps() - begun;
    assert!(steps > 0, "nothing was written, so nothing can be cut");
    let mut cuts = 0;
    for step in 0..steps {
        for seed in seeds.clone() {
            let order = match seed % 2 {
                0 => Order::InOrder,
                _ => Order::AllAtOnce,
            };
            let mut bench = Bench::new(nor.copy());
            let cut = Cut {
                step: bench.nor().steps() + step,
                seed,
                order,
            };
            bench.cut_at(cut);
            job(&mut bench);
            assert!(bench.nor().dead(), "{cut:?} of {steps} steps never came");
            judge(bench, cut);
            cuts += 1;
        }
    }
    cuts
}

/// `target/reports/cuts.json`: how often the power was cut, by what was cut.
pub fn report_cuts(what: &str, cuts: u64) {
    println!("{cuts} cuts in {what}");
    ferrocnc_tests::report_part("cuts", what, cuts.into());
}

pub fn golden_of(nor: &Nor) -> Vec<u8> {
    let layout = flash::layout(nor);
    nor.cells()[layout.golden.start as usize..].to_vec()
}
