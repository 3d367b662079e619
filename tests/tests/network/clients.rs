//! telnet, curl, avahi and ping at a board with a static address, and at one with a leased one.

use crate::leases::{kinds, leased};
use crate::rig::*;
use ferrocnc_tests::flash::{UID, factory, with_services};
use ferrocnc_tests::lan::arp::{Arp, Listener, Says};
use ferrocnc_tests::lan::avahi::Avahi;
use ferrocnc_tests::lan::dhcp::DhcpServer;
use ferrocnc_tests::lan::{Lan, Place, SILENT};
use ferrocnc_tests::{Simulator, program};
use serde_json::{Value as Json, json};
use sim::nor::Part;
use std::process::Command;
use std::time::Instant;

/// The addresses of a segment.
struct Net {
    host: &'static str,
    board: String,
    /// Nothing is there.
    nowhere: &'static str,
}

const NAME: &str = "mill on a cable";
const LABEL: &str = "mill-on-a-cable";
const LOCAL: &str = "mill-on-a-cable.local";

fn ping(host: &Place, to: &str, seconds: u64) -> bool {
    let mut ping = host.command("ping");
    ping.args(["-n", "-c", "1", "-w", &seconds.to_string(), to]);
    run(ping).status.success()
}

/// The status page, its JSON and its log; nothing else is there, and nothing is written.
fn the_page(host: &Place, board: &str) {
    let status = until("status.json", || {
        let answer = curl(host, &format!("http://{board}/status.json"), &[])?;
        let status: Json = serde_json::from_str(&answer.content).map_err(|e| e.to_string())?;
        // The services begin without a name, and read it then.
        match status["board"]["name"] == "" {
            true => Err(answer.content),
            false => Ok(status),
        }
    });
    assert_eq!(status["board"]["name"], LABEL, "{status}");
    assert_eq!(status["link"]["ip"], board, "{status}");
    assert_eq!(status["machine"]["state"], "disarmed", "{status}");
    let get = |path: &str, arguments: &[&str]| {
        let url = format!("http://{board}{path}");
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
fn telnet(host: &Place, board: &str, mode: &str) {
    let mut telnet: Command = host.command("python3");
    let script = ferrocnc_tests::root().join("tests/clients/telnet.py");
    telnet.arg(script).args([board, "23", mode]);
    telnet.env("PATIENCE", SLOWEST.as_secs().to_string());
    let said = run(telnet);
    let why = [said.stdout, said.stderr].concat();
    assert!(said.status.success(), "{mode}: {}", text(&why));
}

/// The name, and what is offered under it.
fn the_name(host: &Place, board: &str, avahi: &Avahi) {
    let address = until("avahi-resolve", || {
        let said = avahi.ask(host, "avahi-resolve", &["-4", "-n", LOCAL]);
        match text(&said.stdout).split_whitespace().nth(1) {
            Some(address) => Ok(address.to_owned()),
            None => Err(text(&said.stderr) + &avahi.said()),
        }
    });
    assert_eq!(address, board);
    for (kind, port) in [("_ferrocnc._udp", "1234"), ("_http._tcp", "80")] {
        until(kind, || {
            let said = avahi.ask(host, "avahi-browse", &["-rpt", kind]);
            let said = text(&said.stdout);
            let found = said.lines().any(|line| {
                let words: Vec<&str> = line.split(';').collect();
                words.get(6..9) == Some(&[LOCAL, board, port][..])
            });
            if found { Ok(()) } else { Err(said) }
        });
    }
}

/// `ferrocnc --json` with these arguments on this host, again while the board is silent.
fn tool(host: &Place, arguments: &[&str]) -> Json {
    until("ferrocnc", || {
        let mut tool = host.command(program("ferrocnc"));
        tool.arg("--json").args(arguments);
        let said = run(tool);
        let why = text(&said.stderr);
        if said.status.success() {
            return serde_json::from_str(&text(&said.stdout)).map_err(|e| e.to_string());
        }
        assert!(SILENT.iter().any(|it| why.contains(it)), "{why}");
        Err(why)
    })
}

/// The tool is told the board's name instead of its address. It waits for three seconds, which the
/// Verilated board does not keep on a busy computer.
fn the_tool(host: &Place) {
    let described = tool(host, &["describe", LOCAL]);
    assert_eq!(described["uid"], uid_text(), "{described}");
}

/// `ferrocnc discover` behind a firewall that lets no broadcast out, and behind one that lets none
/// in: the name's way is left. Where that is shut, too, the tool finds nothing. It listens for so
/// many milliseconds.
fn discovered_by_its_name(host: &Place, board: &str, wait: &str) {
    let firewall = |rule: &str| {
        let mut iptables = host.command("iptables");
        iptables.args(rule.split(' '));
        let said = run(iptables);
        assert!(said.status.success(), "{rule}: {}", text(&said.stderr));
    };
    for chain in ["OUTPUT", "INPUT"] {
        firewall(&format!("-A {chain} -p udp -d 255.255.255.255 -j DROP"));
        let found = tool(host, &["discover", "--wait", wait]);
        let here = &found["boards"][0];
        assert_eq!(here["uid"], uid_text(), "{chain}: {found}");
        assert_eq!((&here["ip"], &here["name"]), (&json!(board), &json!(NAME)));
        assert_eq!(here["mac"], mac(), "{found}");
    }
    firewall("-A INPUT -p udp --sport 5353 -j DROP");
    firewall("-D OUTPUT 1");
    let found = tool(host, &["discover", "--wait", wait]);
    assert_eq!(found, json!({ "boards": [] }));
    firewall("-F INPUT");
}

/// While a host keeps the machine armed the page is busy, and a console answers.
fn while_armed(host: &Place, board: &str, period_ms: u64) {
    let owner = Owner::arm(host, board, period_ms);
    let busy = until("a busy page", || {
        curl(host, &format!("http://{board}/"), &[])
    });
    assert_eq!(busy.status, 503, "{busy:?}");
    assert!(busy.head.contains("Retry-After: 2"), "{busy:?}");
    telnet(host, board, "armed");
    owner.ends();
}

/// From its first answer on the board answers each question for its address once, to where it came
/// from. Questions that came before, while it started or was slow, may have been lost or may be
/// answered late. It asks for no address that it has heard from, and answers for no other one.
fn judge_arp(net: &Net, heard: &[Arp]) {
    let board = mac();
    let asked = |ip: &str, heard: &[Arp]| {
        let question = Says::WhereIs(ip.into(), net.host.into());
        heard.iter().filter(|arp| arp.says == question).count()
    };
    let first = heard.iter().position(|arp| arp.from == board);
    let (before, then) = heard.split_at(first.expect("an answer"));
    assert!(asked(&net.board, before) >= 1, "{heard:#?}");
    let mut from_board = Vec::new();
    for arp in heard.iter().filter(|arp| arp.from == board) {
        assert_eq!(
            arp.says,
            Says::IsAt(net.board.clone(), board.clone()),
            "{arp:?}"
        );
        from_board.push(arp.to.clone());
    }
    let host = heard.iter().find(|arp| arp.from != board);
    let host = host.expect("a question").from.clone();
    assert!(from_board.iter().all(|to| *to == host), "{heard:#?}");
    let fewest = 1 + asked(&net.board, then);
    let answers = fewest..fewest + asked(&net.board, before);
    assert!(answers.contains(&from_board.len()), "{heard:#?}");
    assert!(asked(&net.board, then) >= 1, "{heard:#?}");
    assert!(asked(net.nowhere, then) >= 1, "{heard:#?}");
    let answered = |arp: &Arp| matches!(&arp.says, Says::IsAt(ip, _) if ip == net.nowhere);
    assert!(!heard.iter().any(answered), "{heard:#?}");
}

/// One after the other. At the end a host keeps the machine armed, with so many milliseconds of
/// this computer between two exchanges: a guest is served behind one of them.
fn all_clients(folder: &Folder, host: &Place, net: &Net, period_ms: u64) {
    let board = &net.board;
    let began = Instant::now();
    let done = |what: &str| println!("{what} after {:.1} s", began.elapsed().as_secs_f64());
    let avahi = Avahi::start(host, folder.path());
    let listener = Listener::start(host, folder.path());
    // A DHCP server has told the kernel where its client is.
    host.ip("neigh flush dev eth0");
    assert!(ping(host, board, SLOWEST.as_secs()), "no answer to a ping");
    done("ping");
    the_page(host, board);
    done("curl");
    telnet(host, board, "three");
    done("telnet");
    the_name(host, board, &avahi);
    done("avahi");
    // A host that has forgotten the board, and one that asks for another.
    host.ip("neigh flush dev eth0");
    assert!(ping(host, board, SLOWEST.as_secs()), "no answer to a ping");
    let nowhere = net.nowhere;
    assert!(!ping(host, nowhere, 2), "something answers for {nowhere}");
    judge_arp(net, &listener.heard());
    done("ARP");
    // From now on a guest's frame may be lost.
    while_armed(host, board, period_ms);
    done("armed");
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
    let net = Net {
        host: "192.168.2.1",
        board: "192.168.2.50".to_owned(),
        nowhere: "192.168.2.51",
    };
    all_clients(&folder, &host, &net, 1);
    telnet(&host, &net.board, "characters");
    the_tool(&host);
    discovered_by_its_name(&host, &net.board, "500");
}

/// Some 100 ms are a servo period of 1 kHz for the Verilated board. At 1 ms its CPU does nothing
/// but exchanges, and no guest is served.
const RTL_PERIOD_MS: u64 = 100;

/// So long the tool listens there: mDNS lets a responder wait for 20 to 120 ms of its time.
const RTL_LISTENS_MS: &str = "40000";

/// What a client says to a server, and hears, to have its first lease.
const BEGINS: [&str; 4] = ["DHCPDISCOVER", "DHCPOFFER", "DHCPREQUEST", "DHCPACK"];

/// The Verilated board, as soon as it has a lease of this server.
fn leased_board(folder: &Folder, lan: &mut Lan, server: &DhcpServer) -> (Simulator, String) {
    let nor = with_services(Part::W25Q32JV, UID);
    let flash = flash_file(folder, nor, NAME, true);
    let began = Instant::now();
    let simulator = Simulator::rtl_on_cable(lan, &flash);
    let board = until("a lease", || leased(&server.said()).ok_or(server.said()));
    let seconds = began.elapsed().as_secs_f64();
    println!("dnsmasq's lease of {board} after {seconds:.1} s");
    (simulator, board)
}

#[test]
fn real_clients_are_served_by_the_release_image_on_the_verilated_board_at_a_leased_address() {
    let folder = Folder::new("rtl-network");
    let mut lan = Lan::new();
    let host = lan.plug(Some("10.7.0.1/24"));
    let server = DhcpServer::start(&host, folder.path(), "2m");
    let (mut simulator, board) = leased_board(&folder, &mut lan, &server);
    let said = server.said();
    assert_eq!(kinds(&said), BEGINS, "{said}");
    let net = Net {
        host: "10.7.0.1",
        board,
        nowhere: "10.7.0.99",
    };
    all_clients(&folder, &host, &net, RTL_PERIOD_MS);
    // It says how many clocks that were.
    simulator.finish();
}

/// dnsmasq's shortest time to a renewal is two seconds: four minutes of the Verilated board.
#[test]
#[ignore = "named: cargo xtask test clients"]
fn the_verilated_board_renews_its_lease_beside_a_console_and_the_tool() {
    let folder = Folder::new("rtl-renewal");
    let mut lan = Lan::new();
    let host = lan.plug(Some("10.7.0.1/24"));
    let server = DhcpServer::that_is_asked_often(&host, folder.path(), "1h");
    let began = Instant::now();
    let (mut simulator, board) = leased_board(&folder, &mut lan, &server);
    let done = |what: &str| println!("{what} after {:.1} s", began.elapsed().as_secs_f64());
    telnet(&host, &board, "characters");
    done("telnet's keys");
    let said = until("a renewal", || {
        let said = server.said();
        match kinds(&said).len() >= BEGINS.len() + 2 {
            true => Ok(said),
            false => Err(said),
        }
    });
    done("renewed");
    // The board has its name 2 s after power-up: it asks first whether another one has it.
    the_tool(&host);
    done("describe by the name");
    discovered_by_its_name(&host, &board, RTL_LISTENS_MS);
    done("discover by the name");
    let all = kinds(&said);
    assert!(all.starts_with(&BEGINS), "{said}");
    for renewal in all[BEGINS.len()..].chunks_exact(2) {
        assert_eq!(renewal, ["DHCPREQUEST", "DHCPACK"], "{said}");
    }
    assert_eq!(leased(&said), Some(board), "{said}");
    simulator.finish();
}
