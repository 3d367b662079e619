//! Clients of the services: consoles, the status page, and what the longest of their calls takes.

use ferrocnc_tests::flood::{KINDS, Kind};
use ferrocnc_tests::wired::mill;
use ferrocnc_tests::{BenchMachine, report_part, seed};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde_json::json;
use sim::lan_segment::CONSOLE_PORT;
use wire::describe::JobsState;
use wire::exchange::Command;
use wire::state::State;

use crate::told::page;
use crate::{FAST, LATE, moving};

/// The longest call of the services while a host moves the machine, in clocks: as in `flood`, less
/// than a third of a servo period of 1 kHz.
const LONGEST_MOVING: u32 = 18_000;
/// At any other time: what the ROM gives them while the owner's machine is at rest.
const LONGEST_AT_REST: u32 = 100_000;

#[test]
fn three_clients_have_a_console_at_once() {
    let mut machine = BenchMachine::boot(mill());
    let rig = machine.rig();
    let all: Vec<_> = (0..3)
        .map(|n| {
            let connected = rig.tcp_connect(CONSOLE_PORT);
            connected.unwrap_or_else(|error| panic!("console {n}: {error}"))
        })
        .collect();
    assert!(rig.tcp_connect(CONSOLE_PORT).is_err(), "a fourth");
    let mut heard = vec![String::new(); 3];
    for (client, line) in all.iter().zip(["status\n", "link\n", "settings\n"]) {
        rig.segment.send(*client, line.as_bytes());
        // One after the other, as hands type them.
        rig.run_ms(1);
    }
    for _ in 0..40 {
        rig.run_ms(1);
        for (client, heard) in all.iter().zip(&mut heard) {
            heard.push_str(&String::from_utf8_lossy(&rig.segment.recv(*client)));
        }
    }
    for (heard, word) in heard
        .iter()
        .zip(["session  ", "mac: no slot ", "192.168.2.50"])
    {
        assert!(heard.contains(word), "{heard}");
        assert_eq!(heard.matches("ferrocnc> ").count(), 2, "{heard}");
    }
}

/// A machine at rest has no pass: an exchange may come behind the longest call of the services.
const BEHIND_A_CALL: u64 = LONGEST_AT_REST as u64 + LATE;

/// Guests look at the consoles and send every kind of frame while an owner's machine is at rest.
fn guests_come(machine: &mut BenchMachine, command: &mut Command, lines: &[&str]) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed());
    for (line, cost) in machine.console_costs(command, lines) {
        assert!(
            cost.is_some_and(|cost| cost <= BEHIND_A_CALL),
            "{line}: {cost:?}"
        );
    }
    // A handshake that is not ended keeps a console for a quarter of a second.
    let kinds = KINDS.into_iter();
    for kind in kinds.filter(|kind| ![Kind::Tcp, Kind::TcpArmed, Kind::Mix].contains(kind)) {
        let wire = machine.frame(kind, &mut rng);
        let answer = machine.period_with(command, &[wire], 1);
        let answer = answer.unwrap_or_else(|| panic!("{kind:?}: no answer"));
        assert!(answer.turnaround <= BEHIND_A_CALL, "{kind:?}: {answer:?}");
        // A ticket for the next one, and turns for what it left.
        machine.period_with(command, &[], 0);
        machine.period_with(command, &[], 0);
    }
}

/// Servo periods of a reader of a page that says busy, of one of the whole page, and readers one of
/// which is heard.
const PERIODS: usize = 40;
const PERIODS_AT_REST: usize = 400;
const READERS: usize = 4;
/// Periods between a handshake and its request.
const BETWEEN: usize = 3;

/// A reader asks for the page while its owner exchanges, for so many periods or until it has heard
/// what is `enough`; what it heard.
fn asks_for_the_page(
    machine: &mut BenchMachine,
    command: &mut Command,
    periods: usize,
    enough: impl Fn(&[u8]) -> bool,
) -> String {
    const ASK: &str = "GET /status.json HTTP/1.0\r\n\r\n";
    let wanted = match command.enable_request {
        true => State::Armed,
        false => State::Disarmed,
    };
    let reader = machine.rig().segment.connect(wire::PAGE_PORT);
    let (mut heard, mut connected, mut asked) = (Vec::new(), 0, false);
    for period in 0..periods {
        let status = machine.exchange_and_wait(command).state;
        assert_eq!(status.state, wanted, "period {period}");
        assert_eq!(status.services, JobsState::Alive, "period {period}");
        let segment = &mut machine.rig().segment;
        // The board takes one frame of a guest in a period, and none in the next one behind a call
        // that takes longer. The last of the handshake is one: a request right behind it would come
        // again a second later, and a reader that has gone by then keeps its place.
        if connected > BETWEEN && !asked {
            asked = segment.send(reader, ASK.as_bytes()) == ASK.len();
        }
        connected += usize::from(segment.established(reader));
        heard.extend(segment.recv(reader));
        if enough(&heard) {
            println!("heard enough after {period} periods");
            break;
        }
    }
    machine.rig().segment.close(reader);
    machine.exchange_and_wait(command);
    machine.exchange_and_wait(command);
    machine.rig().segment.drop_connection(reader);
    String::from_utf8(heard).expect("text")
}

#[test]
fn the_status_page_is_read_at_rest_and_is_busy_while_the_machine_moves() {
    const LINES: [&str; 3] = ["status", "help", "settings"];
    let mut machine = BenchMachine::boot(mill());
    let [_, started] = machine.longest_calls();
    // A host owns the machine, which is at rest: its exchanges go on, and so does the page.
    machine.acquire();
    let mut command = machine.enabled_command();
    command.enable_request = false;
    let parsed = |heard: &[u8]| {
        let body = heard.windows(4).position(|end| end == b"\r\n\r\n");
        let json = body.map(|at| serde_json::from_slice::<serde_json::Value>(&heard[at + 4..]));
        json.and_then(Result::ok)
    };
    let heard = (0..READERS).find_map(|_| {
        let complete = |heard: &[u8]| parsed(heard).is_some();
        let heard = asks_for_the_page(&mut machine, &mut command, PERIODS_AT_REST, complete);
        parsed(heard.as_bytes())
    });
    let json = heard.expect("the whole page beside an owner");
    assert_eq!(json["machine"]["state"], "disarmed", "{json}");
    guests_come(&mut machine, &mut command, &LINES);
    let [at_all, at_rest] = machine.longest_calls();
    assert_eq!(at_all, 0, "no call of a machine that moves");
    machine.release();

    // Without an owner a call may take longer than with one.
    let [status, text] = ["/status.json", "/"].map(|path| page(&mut machine, path));
    let json: serde_json::Value = serde_json::from_str(&status).expect("JSON");
    assert_eq!(json["machine"]["state"], "disarmed", "{json}");
    assert!(text.trim_end().ends_with("</script>"), "{text}");

    let mut command = moving(&mut machine);
    let mut heard = String::new();
    // A frame of a guest that comes behind a turn is refused, and would come again a second later.
    for _ in 0..READERS {
        heard = asks_for_the_page(&mut machine, &mut command, PERIODS, |_| false);
        if !heard.is_empty() {
            break;
        }
    }
    assert!(heard.starts_with("HTTP/1.1 503 "), "{heard:?}");
    let busy = "busy: the machine needs the time\n";
    assert!(heard.ends_with(busy), "{heard:?}");
    let spread = machine.turnaround_spread(PERIODS);
    println!("turnaround while a page is asked for {spread:?}");
    assert!(spread.max <= FAST, "{spread:?}");

    for (line, cost) in machine.console_costs(&mut command, &LINES) {
        assert!(cost.is_some_and(|cost| cost <= FAST), "{line}: {cost:?}");
    }
    let mut rng = Pcg64Mcg::seed_from_u64(seed());
    for kind in [
        Kind::PingArmed,
        Kind::TcpArmed,
        Kind::Arp,
        Kind::Dhcp,
        Kind::Jobs,
    ] {
        for _ in 0..3 {
            let wire = machine.frame(kind, &mut rng);
            let answer = machine.period_with(&mut command, &[wire], 1);
            let answer = answer.unwrap_or_else(|| panic!("{kind:?}: no answer"));
            assert!(answer.turnaround <= FAST, "{kind:?}: {answer:?}");
            machine.period_with(&mut command, &[], 0);
        }
    }
    let [moving, other] = machine.longest_calls();
    println!(
        "longest call of the services {moving} clocks while moving, {at_rest} at rest ({started} when they had started), {other} without an owner"
    );
    let figures = json!({"moving": moving, "at_rest": at_rest, "without_owner": other});
    report_part("services", "longest_call_clocks_without_jobs", figures);
    assert!((1..=LONGEST_MOVING).contains(&moving), "{moving}");
    assert!((1..=LONGEST_AT_REST).contains(&at_rest), "{at_rest}");
}
