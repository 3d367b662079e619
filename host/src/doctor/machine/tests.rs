//! The mill of the examples, with one thing wrong at a time.

use super::*;
use crate::doctor::system::System;
use crate::finding::Verdict::{Bad, Good, Skipped};
use std::fs;
use std::sync::atomic::{AtomicU32, Ordering};

const HAL: &str = include_str!("../../../examples/mill/mill.hal");
const INI: &str = include_str!("../../../examples/mill/mill.ini");
const REST: &str = include_str!("../../../examples/mill/machine.inc");

/// Reads a configuration of these three files.
fn read(hal: &str, ini: &str, rest: &str) -> Files {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let n = NEXT.fetch_add(1, Ordering::Relaxed);
    let name = format!("ferrocnc-doctor-ini-{}-{n}", std::process::id());
    let root = std::env::temp_dir().join(name);
    fs::create_dir_all(root.join("mill")).unwrap();
    let library = "usr/share/linuxcnc/hallib";
    fs::create_dir_all(root.join(library)).unwrap();
    for (name, text) in [
        ("mill/mill.hal", hal),
        ("mill/mill.ini", ini),
        ("mill/machine.inc", rest),
        (&format!("{library}/shared.hal"), "setp shared.0.in 1\n"),
    ] {
        fs::write(root.join(name), text).unwrap();
    }
    let system = System {
        root: root.clone(),
        ..System::real()
    };
    let files = Files::read(&system, "mill/mill.ini").expect("a file");
    fs::remove_dir_all(&root).unwrap();
    files
}

/// The board has what the HAL file names.
fn pins(files: &Files) -> Vec<Pin> {
    let all = files.named().into_iter();
    let ours = all.filter(|name| name.starts_with("ferrocnc."));
    ours.map(|name| Pin {
        name: name.to_owned(),
        logical: String::new(),
        direction: match name.ends_with(".in") || name.ends_with("enabled") {
            true => Direction::Out,
            false => Direction::In,
        },
    })
    .collect()
}

#[test]
fn the_mill_of_the_examples_is_in_order() {
    let files = read(HAL, INI, REST);
    let findings = examine(&files, Some(&pins(&files)));
    for finding in &findings {
        assert_eq!(finding.verdict, Good, "{finding:?}");
    }
    assert_eq!(findings.len(), 9);
    let machine = Configured { files: &files };
    assert_eq!(machine.axes().len(), 3, "joints with stepgens");
}

/// What stands in a file, what does instead, the check that tells of it, and a word of its fact.
type Mistake = (&'static str, &'static str, &'static str, &'static str);

/// One of each.
const MISTAKES: &[Mistake] = &[
    (
        "addf ferrocnc.0.read         servo-thread",
        "",
        "order of the functions",
        "no read or no write",
    ),
    (
        "addf ferrocnc.0.read         servo-thread\naddf not-enabled             servo-thread\naddf motion-command-handler  servo-thread",
        "addf motion-command-handler servo-thread\naddf ferrocnc.0.read servo-thread\naddf not-enabled servo-thread",
        "order of the functions",
        "ferrocnc.0.read comes after",
    ),
    (
        "ferrocnc.0.stepgen.x.position-cmd",
        "ferrocnc.0.stepgen.xx.position-cmd",
        "pins in HAL files",
        "stepgen.xx.position-cmd",
    ),
    (
        "net x-cmd ",
        "net x-cmd joint.7.motor-pos-cmd",
        "writers of signals",
        "x-cmd by joint.0.motor-pos-cmd and joint.7.motor-pos-cmd",
    ),
    (
        "STEPLEN = 2000",
        "STEPLEN = 90000",
        "step timing",
        "joint 0 needs 24000",
    ),
    (
        "DIRHOLD = 5000",
        "DIRHOLD = 1000000",
        "step timing",
        "dirhold",
    ),
    (
        "STEPGEN_MAXACCEL = 1600",
        "STEPGEN_MAXACCEL = 900",
        "the stepgens' reserve",
        "maxaccel 900",
    ),
    (
        "FERROR = 0.5\n",
        "FERROR = 0.5\nBACKLASH = 0.1\nSTEPGEN_MAXACCEL = 1500\n",
        "the stepgens' reserve",
        "below 2 x",
    ),
    (
        "MIN_FERROR = 0.05",
        "MIN_FERROR = 0.001",
        "following error",
        "MIN_FERROR is below",
    ),
    (
        "FERROR = 0.5\n",
        "FERROR = 0.01\n",
        "following error",
        "below MIN_FERROR",
    ),
    (
        "HOME_SEARCH_VEL = 0",
        "HOME_SEARCH_VEL = 5",
        "homing",
        "without HOME_LATCH_VEL",
    ),
    (
        "HOME = 0\n",
        "HOME = 500\n",
        "homing",
        "outside -200 to 200",
    ),
    (
        "HOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 0",
        "HOME_SEARCH_VEL = 5\nHOME_LATCH_VEL = 1\nHOME_OFFSET = -190",
        "homing",
        "leads away",
    ),
    (
        "WATCHDOG_NS = 5000000",
        "WATCHDOG_NS = 1500000",
        "watchdog and servo period",
        "1500000",
    ),
    (
        "=> iocontrol.0.emc-enable-in",
        "=>",
        "e-stop",
        "does not reach",
    ),
    (
        "=> ferrocnc.0.enable\n",
        "\n",
        "e-stop",
        "ferrocnc.0.enable",
    ),
];

#[test]
fn every_mistake_is_named_by_its_check_with_a_remedy() {
    let board = pins(&read(HAL, INI, REST));
    for (from, to, check, fact) in MISTAKES {
        let (hal, rest) = (HAL.replacen(from, to, 1), REST.replacen(from, to, 1));
        assert!(hal != HAL || rest != REST, "{from} is in neither file");
        let findings = examine(&read(&hal, INI, &rest), Some(&board));
        let finding = findings.iter().find(|it| it.check == *check);
        let finding = finding.unwrap_or_else(|| panic!("{check}"));
        assert_eq!(finding.verdict, Bad, "{finding:?}");
        assert!(
            finding.fact.contains(fact),
            "{finding:?} does not say {fact}"
        );
        assert!(!finding.remedy.is_empty() && !finding.reason.is_empty());
        let others = findings.iter().filter(|it| it.verdict == Bad).count();
        assert_eq!(others, 1, "{from}: {findings:?}");
    }
}

#[test]
fn a_stop_may_reach_linuxcnc_through_components() {
    let through = HAL.replace(
        "=> iocontrol.0.emc-enable-in not-enabled.in",
        "=> and2.0.in0 not-enabled.in\nnet chain and2.0.out => iocontrol.0.emc-enable-in",
    );
    let files = read(&through, INI, REST);
    let finding = Configured { files: &files }.estop();
    assert_eq!(finding.verdict, Good, "{finding:?}");
}

#[test]
fn a_board_is_not_read_after_another_one_was_written() {
    let two = HAL.replace(
        "addf ferrocnc.0.write        servo-thread",
        "addf ferrocnc.0.write servo-thread\naddf ferrocnc.1.read servo-thread\naddf ferrocnc.1.write servo-thread",
    );
    let two = two.replace("motion-command-handler", "motion-handler-of-mine");
    let files = read(&two, INI, REST);
    let finding = Configured { files: &files }.order();
    assert_eq!(finding.verdict, Bad, "{finding:?}");
    assert!(finding.fact.contains("after another one"), "{finding:?}");
}

#[test]
fn a_file_of_linuxcncs_own_library_is_read() {
    for name in ["shared.hal", "LIB:shared.hal"] {
        let files = read(HAL, &format!("{INI}\n[HAL]\nHALFILE = {name}\n"), REST);
        assert_eq!(files.value("shared.0.in"), Some(1.0), "{name}");
        assert!(files.unread.is_empty(), "{name}");
    }
}

#[test]
fn joints_that_lead_elsewhere_are_not_taken_for_good() {
    let files = read(&HAL.replace(".position-cmd", ".elsewhere"), INI, REST);
    let findings = examine(&files, None);
    let axes = findings.iter().find(|it| it.check == "axes");
    assert_eq!(axes.map(|it| it.verdict), Some(Skipped));
    assert!(!findings.iter().any(|it| it.check == "step timing"));
}

#[test]
fn what_is_not_read_is_told() {
    let ini = format!("{INI}\n[HAL]\nHALFILE = more.tcl x\nHALFILE = none.hal\n");
    let findings = examine(&read(HAL, &ini, REST), None);
    let skipped = |check: &str| {
        let finding = findings.iter().find(|it| it.check == check).expect(check);
        assert_eq!(finding.verdict, Skipped);
        finding.fact.clone()
    };
    assert_eq!(skipped("other files"), "more.tcl, none.hal");
    skipped("pins in HAL files");
}
