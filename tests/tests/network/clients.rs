//! telnet, curl, avahi and ping at a board with a static address.

use crate::rig::*;
use ferrocnc_tests::Simulator;
use ferrocnc_tests::flash::{UID, factory, with_services};
use ferrocnc_tests::lan::arp::{Arp, Listener, Says};
use ferrocnc_tests::lan::avahi::Avahi;
use ferrocnc_tests::lan::{Lan, Place};
use serde_json::Value as Json;
use sim::nor::Part;
use std::process::Command;
use std::time::Instant;

const HOST: &str = "192.168.2.1";
const BOARD: &str = "192.168.2.50";
/// Nothing is there.
const NOWHERE: &str = "192.168.2.51";
const NAME: &str = "mill on a cable";
const LABEL: &str = "mill-on-a-cable";
const LOCAL: &str = "mill-on-a-cable.local";

fn ping(host: &Place, to: &str, seconds: u64) -> bool {
    let mut ping = host.command("ping");
    ping.args(["-n", "-c", "1", "-w", &seconds.to_string(), to]);
    run(ping).status.success()
}

/// The status page, its JSON and its log; nothing else is there, and nothing is written.
fn the_page(host: &Place) {
    let status = until("status.json", || {
        let answer = curl(host, &format!("http://{BOARD}/status.json"), &[])?;
        let status: Json = serde_json::from_str(&answer.content).map_err(|e| e.to_string())?;
        // The services begin without a name, and read it then.
        match status["board"]["name"] == "" {
            true => Err(answer.content),
            false => Ok(status),
        }
    });
    assert_eq!(status["board"]["name"], LABEL, "{status}");
    assert_eq!(status["link"]["ip"], BOARD, "{status}");
    assert_eq!(status["machine"]["state"], "disarmed", "{status}");
    let get = |path: &str, arguments: &[&str]| {
        let url = format!("http://{BOARD}{path}");
        until(path, || curl(host, &url, arguments))
    };
    let page = get("/", &[]);
    assert_eq!(page.status, 200);
    assert!(page.content.trim_end().ends_with("</script>"), "{page:?}");
    let log = get("/log", &[]);
    assert!(log.content.contains("firmware started"), "{log:?}");
    assert_eq!(get("/", &["--head"]).status, 200);
    assert_eq!(get("/nothing", &[]).status, 404);
    assert_eq!(get("/", &["--request", "POST"]).status, 405);
}

/// A session of telnet.py.
fn telnet(host: &Place, mode: &str) {
    let mut telnet: Command = host.command("python3");
    let script = ferrocnc_tests::root().join("tests/clients/telnet.py");
    telnet.arg(script).args([BOARD, "23", mode]);
    telnet.env("PATIENCE", SLOWEST.as_secs().to_string());
    let said = run(telnet);
    let why = [said.stdout, said.stderr].concat();
    assert!(said.status.success(), "{mode}: {}", text(&why));
}

/// The name, and what is offered under it.
fn the_name(host: &Place, avahi: &Avahi) {
    let address = until("avahi-resolve", || {
        let said = avahi.ask(host, "avahi-resolve", &["-4", "-n", LOCAL]);
        match text(&said.stdout).split_whitespace().nth(1) {
            Some(address) => Ok(address.to_owned()),
            None => Err(text(&said.stderr) + &avahi.said()),
        }
    });
    assert_eq!(address, BOARD);
    for (kind, port) in [("_ferrocnc._udp", "1234"), ("_http._tcp", "80")] {
        until(kind, || {
            let said = avahi.ask(host, "avahi-browse", &["-rpt", kind]);
            let said = text(&said.stdout);
            let found = said.lines().any(|line| {
                let words: Vec<&str> = line.split(';').collect();
                words.get(6..9) == Some(&[LOCAL, BOARD, port][..])
            });
            if found { Ok(()) } else { Err(said) }
        });
    }
}

/// While a host keeps the machine armed the page is busy, and a console answers.
fn while_armed(host: &Place) {
    let owner = Owner::arm(host, BOARD, 1);
    let busy = until("a busy page", || {
        curl(host, &format!("http://{BOARD}/"), &[])
    });
    assert_eq!(busy.status, 503, "{busy:?}");
    assert!(busy.head.contains("Retry-After: 2"), "{busy:?}");
    telnet(host, "armed");
    owner.ends();
}

/// From its first answer on the board answers each question for its address once, to where it came
/// from. Questions that came before, while it started or was slow, may have been lost or may be
/// answered late. It asks for no address that it has heard from, and answers for no other one.
fn judge_arp(heard: &[Arp]) {
    let board = mac();
    let asked = |ip: &str, heard: &[Arp]| {
        let question = Says::WhereIs(ip.into(), HOST.into());
        heard.iter().filter(|arp| arp.says == question).count()
    };
    let first = heard.iter().position(|arp| arp.from == board);
    let (before, then) = heard.split_at(first.expect("an answer"));
    assert!(asked(BOARD, before) >= 1, "{heard:#?}");
    let mut from_board = Vec::new();
    for arp in heard.iter().filter(|arp| arp.from == board) {
        assert_eq!(arp.says, Says::IsAt(BOARD.into(), board.clone()), "{arp:?}");
        from_board.push(arp.to.clone());
    }
    let host = heard.iter().find(|arp| arp.from != board);
    let host = host.expect("a question").from.clone();
    assert!(from_board.iter().all(|to| *to == host), "{heard:#?}");
    let fewest = 1 + asked(BOARD, then);
    let answers = fewest..fewest + asked(BOARD, before);
    assert!(answers.contains(&from_board.len()), "{heard:#?}");
    assert!(asked(BOARD, then) >= 1, "{heard:#?}");
    assert!(asked(NOWHERE, then) >= 1, "{heard:#?}");
    let answered = |arp: &Arp| matches!(&arp.says, Says::IsAt(ip, _) if ip == NOWHERE);
    assert!(!heard.iter().any(answered), "{heard:#?}");
}

/// One after the other; `armed`: also with a machine that a host keeps armed.
fn all_clients(folder: &Folder, host: &Place, armed: bool) {
    let began = Instant::now();
    let done = |what: &str| println!("{what} after {:.1} s", began.elapsed().as_secs_f64());
    let avahi = Avahi::start(host, folder.path());
    let listener = Listener::start(host, folder.path());
    assert!(ping(host, BOARD, SLOWEST.as_secs()), "no answer to a ping");
    done("ping");
    the_page(host);
    done("curl");
    telnet(host, "three");
    done("telnet");
    the_name(host, &avahi);
    done("avahi");
    if armed {
        while_armed(host);
        done("armed");
    }
    // A host that has forgotten the board, and one that asks for another.
    host.ip("neigh flush dev eth0");
    assert!(ping(host, BOARD, SLOWEST.as_secs()), "no answer to a ping");
    assert!(!ping(host, NOWHERE, 2), "something answers for {NOWHERE}");
    judge_arp(&listener.heard());
    done("ARP");
}

#[test]
fn real_clients_are_served_by_the_ip_stack_of_the_twin() {
    let folder = Folder::new("twin-network");
    let nor = factory(Part::W25Q32JV, UID);
    let flash = flash_file(&folder, nor, NAME, false).display().to_string();
    let mut lan = Lan::new();
    let host = lan.plug(Some("192.168.2.1/24"));
    let uid = format!("{UID:016x}");
    let arguments = ["--flash", &flash, "--uid", &uid];
    let _board = Simulator::on_cable(&mut lan, "mill6", &arguments);
    all_clients(&folder, &host, true);
    telnet(&host, "characters");
}

#[test]
fn real_clients_are_served_by_the_release_image_on_the_verilated_board() {
    let folder = Folder::new("rtl-network");
    let nor = with_services(Part::W25Q32JV, UID);
    let flash = flash_file(&folder, nor, NAME, false);
    let mut lan = Lan::new();
    let host = lan.plug(Some("192.168.2.1/24"));
    let mut board = Simulator::rtl_on_cable(&mut lan, &flash);
    // An armed machine is the twin's part: on this board its guests were not served in a minute,
    // and the cause is not known.
    all_clients(&folder, &host, false);
    // It says how many clocks that were.
    board.finish();
}
