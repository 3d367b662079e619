//! Runs every committed input through its target, without libFuzzer: the corpora, and all earlier
//! findings.

use std::collections::BTreeSet;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use targets::{EXPLAIN, TARGETS, seeds};

/// `fuzz/`.
fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("it lies in fuzz/")
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect()
}

/// libFuzzer names its own findings by a SHA-1; those are not committed.
fn is_committed(name: &str) -> bool {
    name.len() != 40
}

fn inputs(kind: &str, target: &str) -> Vec<PathBuf> {
    let folder = folder().join(kind).join(target);
    let names = names(&folder);
    let names = names.iter().filter(|name| is_committed(name));
    names.map(|name| folder.join(name)).collect()
}

#[test]
fn no_target_finds_anything_in_the_inputs_that_are_committed() {
    EXPLAIN.store(true, Relaxed);
    let mut found = Vec::new();
    for (target, body) in TARGETS {
        for kind in ["corpus", "regressions"] {
            for input in inputs(kind, target) {
                let data = fs::read(&input).expect("a committed input can be read");
                if catch_unwind(AssertUnwindSafe(|| body(&data))).is_err() {
                    found.push(format!("{target}: {}", input.display()));
                }
            }
        }
    }
    assert!(found.is_empty(), "findings:\n{}", found.join("\n"));
}

/// `cargo xtask fuzz --replay FILE`
#[test]
#[ignore = "by hand, with FERROCNC_FUZZ_TARGET and FERROCNC_FUZZ_INPUT"]
fn one_input_by_hand() {
    EXPLAIN.store(true, Relaxed);
    let given = |name| std::env::var(name).unwrap_or_else(|_| panic!("{name} is not set"));
    let data = fs::read(given("FERROCNC_FUZZ_INPUT")).expect("an input");
    targets::run(&given("FERROCNC_FUZZ_TARGET"), &data);
}

#[test]
fn every_target_has_inputs_of_its_own_and_none_is_large() {
    for (target, _) in TARGETS {
        let inputs = inputs("corpus", target);
        assert!(inputs.len() >= 3, "fuzz/corpus/{target} has {inputs:?}");
        for input in inputs {
            let length = fs::metadata(&input).expect("it is there").len();
            assert!(length < 16 * 1024, "{} has {length} bytes", input.display());
        }
    }
    let known: BTreeSet<String> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    for kind in ["corpus", "regressions"] {
        let others: Vec<String> = names(&folder().join(kind))
            .into_iter()
            .filter(|name| !known.contains(name) && name != "README.md")
            .collect();
        assert!(
            others.is_empty(),
            "fuzz/{kind} has inputs for no target: {others:?}"
        );
    }
}

#[test]
fn every_target_has_its_binary_and_every_binary_its_target() {
    let manifest = fs::read_to_string(folder().join("Cargo.toml")).expect("fuzz/Cargo.toml");
    let sources: BTreeSet<String> = names(&folder().join("fuzz_targets"))
        .iter()
        .map(|name| name.trim_end_matches(".rs").to_owned())
        .collect();
    let targets: BTreeSet<String> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(sources, targets);
    for target in &targets {
        assert!(
            manifest.contains(&format!(
                "name = \"{target}\"\npath = \"fuzz_targets/{target}.rs\""
            )),
            "fuzz/Cargo.toml has no [[bin]] {target}"
        );
        let source = folder().join("fuzz_targets").join(format!("{target}.rs"));
        let source = fs::read_to_string(source).expect("a source");
        assert!(
            source.contains(&format!("::{target}(data)")),
            "{target} calls another's body"
        );
    }
}

fn seed(target: &str, name: &str) -> Vec<u8> {
    let mut all = seeds::all().into_iter();
    let found = all.find(|(of, called, _)| (*of, *called) == (target, name));
    found.unwrap_or_else(|| panic!("no seed {name}")).2
}

#[test]
fn scripts_for_the_server_do_what_they_are_called() {
    use wire::{FaultReason as Why, State};
    for (name, state, reason) in [
        ("armed_and_moving", State::Armed, Why::None),
        ("host_falls_silent", State::Faulted, Why::Watchdog),
        ("host_disables", State::Disarmed, Why::HostDisable),
        ("link_goes_down", State::Faulted, Why::LinkDown),
        ("external_reset_and_back", State::Armed, Why::None),
        ("stranger_tries", State::Armed, Why::None),
        ("given_back_in_motion", State::Faulted, Why::SessionLost),
        ("acquired_again_in_motion", State::Faulted, Why::SessionLost),
        ("timed_commit", State::Armed, Why::None),
        ("configured_then_armed", State::Armed, Why::None),
        ("stale_and_foreign_commands", State::Disarmed, Why::None),
    ] {
        let mut bench = targets::server::script(&seed("server", name));
        let safety = bench.machine.server.safety();
        assert_eq!((safety.state(), safety.reason()), (state, reason), "{name}");
        if name.contains("mov") || name.contains("motion") {
            assert!(
                bench.machine.board.model_board.environment().edges.pulses() > 0,
                "{name}"
            );
        }
    }
    let told = targets::server::script(&seed("server", "given_settings"));
    assert!(told.machine.server.wants_restart());
    let asked = targets::server::script(&seed("server", "restart_asked_for"));
    assert!(asked.machine.server.wants_restart());
}

#[test]
fn conversations_about_jobs_end_as_they_are_called() {
    for (name, end) in [
        ("sent_started_and_drawn", "ended last: done"),
        ("paused_gone_on_and_stopped", "ended last: stopped"),
        ("switches_are_looked_for", "calibrating"),
        ("an_estop_in_mid_job", "ended last: e-stop"),
        ("its_starter_hangs_up", "ended last: host lost"),
    ] {
        let status = targets::jobs::script(&seed("jobs", name));
        assert!(status.contains(end), "{name}: {status}");
    }
}

#[test]
fn scripts_of_frames_do_what_they_are_called() {
    let script = |name| targets::frames::script(&seed("frames", name));
    for name in [
        "raw_read",
        "read_with_options",
        "discovery_to_all",
        "ping",
        "arp_request",
        "a_segment_for_a_closed_port",
    ] {
        assert_eq!(script(name).sent, 1, "{name}");
    }
    for name in [
        "fragment",
        "total_length_off",
        "cut_short",
        "one_byte_wrong",
        "runt",
    ] {
        assert_eq!(script(name).sent, 0, "{name}");
    }
    assert_eq!(script("on_the_fast_path").ways, [3, 3]);
    assert_eq!(script("the_fast_path_and_damage").ways, [2, 1]);
    // ARP, ping, two handshakes and a DHCP server beside a machine that moves; and long frames.
    assert_eq!(script("moving_among_guests").beside, [5, 0]);
    assert_eq!(script("moving_and_a_long_frame").beside, [0, 2]);
    assert!(script("a_page_is_asked_for").sent >= 3);
    assert!(script("a_name_is_asked_for").sent >= 1);
    assert!(script("console_says_hello").sent >= 3);
    assert!(script("console_dies").visited);
    assert!(!script("console_is_reset").visited);
}

#[test]
fn the_committed_seeds_are_those_that_are_written_down() {
    let write = std::env::var_os("FERROCNC_WRITE_SEEDS").is_some();
    for (target, name, data) in seeds::all() {
        let folder = folder().join("corpus").join(target);
        if write {
            fs::create_dir_all(&folder).expect("a folder");
            fs::write(folder.join(name), &data).expect("a seed");
        }
        let found = fs::read(folder.join(name)).unwrap_or_default();
        assert!(
            found == data,
            "fuzz/corpus/{target}/{name} is stale: FERROCNC_WRITE_SEEDS=1 cargo test -p ferrocnc-fuzz-targets"
        );
    }
}
