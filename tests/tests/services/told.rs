//! What the board tells of starts and crashes, and for how long.

use ferrocnc_tests::BenchMachine;
use ferrocnc_tests::wired::mill;
use wire::describe::{JobsState, RESET_REASON_AT, address};
use wire::exchange::Command;
use wire::{PAGE_PORT, ResetReason, map};

use crate::{becomes, state};

/// The services are loaded well before that.
pub const LOADING_MS: u64 = 800;

/// The services look at the board every 100 ms.
const LOOK_MS: u64 = 130;

/// What the status page says under this path, to a reader of a machine at rest.
pub fn page(machine: &mut BenchMachine, path: &str) -> String {
    let rig = machine.rig();
    let reader = rig.tcp_connect(PAGE_PORT).expect("the page's port");
    let mut heard = rig.tcp_talk(reader, &format!("GET {path} HTTP/1.0\r\n\r\n"));
    for _ in 0..100 {
        if rig.segment.hung_up(reader) {
            break;
        }
        heard += &rig.tcp_talk(reader, "");
    }
    // A reader that vanished would keep one of two places.
    rig.segment.close(reader);
    rig.run_ms(2);
    rig.segment.drop_connection(reader);
    let (head, content) = heard.split_once("\r\n\r\n").expect("a head");
    assert!(head.starts_with("HTTP/1.1 200 OK"), "{path}: {head}");
    content.to_owned()
}

#[test]
fn the_log_and_the_last_words_of_a_crash_outlive_restarts_of_the_firmware() {
    let mut machine = BenchMachine::boot(mill());
    machine.acquire();
    let mut command = Command::default();
    for _ in 0..LOOK_MS {
        machine.exchange_and_wait(&mut command);
    }
    machine.release();
    let before = page(&mut machine, "/log");
    let owner = "driven by 192.168.2.1";
    for line in ["firmware started: power-up", owner] {
        assert!(before.contains(line), "{line:?} is not in {before}");
    }

    // A restart on request. Before the services are there again, a crash.
    machine.write(map::SESSION_REBOOT, map::REBOOT_KEY);
    machine.run_millis(10);
    let why = machine.read(address(RESET_REASON_AT));
    assert_eq!(why, ResetReason::Requested as u32);
    assert_eq!(state(&mut machine), JobsState::Loading);
    machine.trap_cpu();
    assert_eq!(machine.read(map::PANIC), 1, "one death since power-up");
    let words = machine.panic_text();
    assert!(words.starts_with("trap: cause 2 at 0x"), "{words}");

    assert!(becomes(&mut machine, JobsState::Alive, LOADING_MS));
    let mut after = String::new();
    for _ in 0..4 {
        machine.run_millis(LOOK_MS);
        after = page(&mut machine, "/log");
        if after.contains(&words) {
            break;
        }
    }
    println!("{after}");
    // The page begins with the oldest entry.
    assert!(
        after.starts_with(&before),
        "{before}\nis not before\n{after}"
    );
    let news = &after[before.len()..];
    let started = format!("firmware started: {}", ResetReason::Trap.text());
    for line in [&started, &words] {
        assert!(news.contains(line), "{line:?} is not in {news}");
    }
}
