//! The consoles of the services on the network: three at a time, each with its own client.

use crate::lan::*;
use crate::rig::*;
use sim::lan_segment::{CONSOLE_PORT, Connection};
use sim::plant::Plant;
use wire::auth::{EXAMPLE_KEY, Purpose};
use wire::jobs::Status;

const PROMPT: &str = "ferrocnc> ";

/// A console, greeted.
fn console(lan: &mut Lan) -> Connection {
    let connection = lan.dial_at(CONSOLE_PORT, 30_000).expect("a connection");
    assert_eq!(hears(lan, connection), "");
    connection
}

/// Everything up to the next prompt, or to the end of the connection.
fn hears(lan: &mut Lan, connection: Connection) -> String {
    let mut heard = Vec::new();
    let end = lan.rig.now() + 60_000 * MS;
    while lan.rig.now() < end {
        lan.turn();
        heard.extend(lan.segment.recv(connection));
        let text = String::from_utf8_lossy(&heard);
        if let Some(text) = text.strip_suffix(PROMPT) {
            return text.to_owned();
        }
        if lan.segment.hung_up(connection) {
            return text.into_owned();
        }
    }
    panic!("no prompt behind {:?}", String::from_utf8_lossy(&heard));
}

fn asks(lan: &mut Lan, connection: Connection, line: &str) -> String {
    lan.segment
        .send(connection, format!("{line}\r\n").as_bytes());
    hears(lan, connection)
}

fn three(lan: &mut Lan) -> [Connection; 3] {
    std::array::from_fn(|_| console(lan))
}

#[test]
fn three_clients_have_a_console_each_and_a_fourth_when_one_has_gone() {
    let mut lan = Lan::of(Rig::plotter());
    let all = three(&mut lan);
    for round in 0..3 {
        for (n, client) in all.into_iter().enumerate() {
            let line = ["status", "net", "job status"][(n + round) % 3];
            let heard = asks(&mut lan, client, line);
            let word = ["disarmed", "192.168.2.50", "stopped"][(n + round) % 3];
            assert!(heard.contains(word), "{line}: {heard}");
        }
    }
    assert!(lan.dial_at(CONSOLE_PORT, 500).is_none(), "a fourth");
    assert!(asks(&mut lan, all[1], "quit").contains("bye"));
    lan.leave(all[1]);
    let fourth = console(&mut lan);
    assert!(asks(&mut lan, fourth, "status").contains("disarmed"));
    assert!(asks(&mut lan, all[0], "status").contains("disarmed"));
}

#[test]
fn half_lines_of_three_clients_do_not_mix() {
    let mut lan = Lan::of(Rig::plotter());
    let all = three(&mut lan);
    for part in ["sta", "tu", "s"] {
        for client in all {
            lan.segment.send(client, part.as_bytes());
        }
        lan.run(20 * MS);
    }
    for client in all {
        let heard = asks(&mut lan, client, "");
        assert!(heard.contains("session  "), "{heard}");
    }
}

#[test]
fn a_login_opens_nothing_for_the_other_clients() {
    let mut lan = Lan::of(Rig::keyed(Plant::direct(0)));
    let [one, two, _] = three(&mut lan);
    let heard = asks(&mut lan, one, "login");
    let digits = heard.trim().strip_prefix("challenge ").expect("one");
    let word = |at: usize| u32::from_str_radix(&digits[8 * at..8 * at + 8], 16).expect("hex");
    let head = Purpose::Login.head([word(0), word(1), word(2), word(3)]);
    let answer = firmware::auth::tag(&EXAMPLE_KEY, &head, &[]);
    let answer: String = answer.iter().map(|word| format!("{word:08x}")).collect();
    assert!(asks(&mut lan, one, &format!("login {answer}")).contains("welcome"));
    // The others ask in between.
    for _ in 0..2 {
        let refused = asks(&mut lan, two, "job delete x");
        assert!(refused.contains("has a key"), "{refused}");
        let refused = asks(&mut lan, two, "restart");
        assert!(refused.contains("has a key"), "{refused}");
        let done = asks(&mut lan, one, "job delete x");
        assert!(done.contains(Status::NoSuchJob.text()), "{done}");
    }
    // The next client in its place has to prove it again.
    asks(&mut lan, one, "quit");
    lan.leave(one);
    let next = console(&mut lan);
    let refused = asks(&mut lan, next, "job delete x");
    assert!(refused.contains("has a key"), "{refused}");
}

#[test]
fn three_consoles_and_a_client_of_jobs_get_on_over_a_wire_that_loses_frames() {
    let mut lan = Lan::of(Rig::plotter());
    // One frame of eight.
    lan.loss = 32;
    let jobs = loop {
        if let Some(connection) = lan.dial_within(9000) {
            break connection;
        }
    };
    assert_eq!(lan.hello(jobs, 9), Status::Normal);
    let all = three(&mut lan);
    for _ in 0..4 {
        for client in all {
            assert!(asks(&mut lan, client, "help").contains("good bye"));
        }
        let report = lan.ask(jobs, &wire::jobs::Request::Report).0;
        assert_eq!(report, Status::Normal);
    }
}

#[test]
fn a_client_that_vanished_leaves_its_console_to_the_next_within_two_minutes() {
    let mut lan = Lan::of(Rig::plotter());
    let all = three(&mut lan);
    for client in all {
        lan.vanish(client);
    }
    assert!(lan.dial_at(CONSOLE_PORT, 1000).is_none());
    lan.rig.turn = 40 * MS / 10;
    lan.run(120_000 * MS);
    console(&mut lan);
}

#[test]
fn a_port_without_a_listener_refuses_at_once() {
    let mut lan = Lan::of(Rig::plotter());
    console(&mut lan);
    let from = lan.rig.now();
    assert!(lan.dial_at(81, 5000).is_none());
    assert!(lan.rig.now() - from < 100 * MS);
}
