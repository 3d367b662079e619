//! Plans for made-up computers, and what a hand makes of them.

use super::act::Hand;
use super::facts::{Board, Facts, Kind, Manager};
use super::paths::Paths;
use super::plan::{Act, Plan, Refusal, Step, Wish, is_plain, plan};
use super::record::{Record, Undo};
use crate::doctor::network::Route;
use crate::doctor::port::Coalescing;
use crate::doctor::system::System;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

const IP: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 50);
const BOARD: Board = Board {
    ip: IP,
    mac: [2, 0, 0, 0x1b, 0x2c, 0x3d],
};

/// A computer with a free port that is switched on.
fn facts(manager: Manager) -> Facts {
    let kernel = [
        ("net.ipv4.conf.eth1.rp_filter", "1"),
        ("net.ipv6.conf.eth1.disable_ipv6", "0"),
    ];
    Facts {
        interface: "eth1".into(),
        kind: Kind::Wired,
        up: true,
        addresses: Vec::new(),
        routes: Vec::new(),
        table: vec![
            route("eth0", [0, 0, 0, 0], 0),
            route("eth0", [10, 0, 0, 0], 8),
        ],
        manager,
        reads_folder: true,
        claim: None,
        connection: None,
        coalescing: Coalescing {
            adaptive: Some(true),
            usecs: Some(3),
        },
        kernel: kernel
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .into(),
        missing: Vec::new(),
        files: BTreeMap::new(),
        record: None,
    }
}

fn route(interface: &str, net: [u8; 4], bits: u32) -> Route {
    Route {
        interface: interface.into(),
        net: u32::from_be_bytes(net),
        mask: u32::MAX.checked_shl(32 - bits).unwrap_or(0),
    }
}

fn answers(boards: &[Board]) -> Wish {
    Wish {
        boards: boards.to_vec(),
        ..Wish::default()
    }
}

fn planned(facts: &Facts, wish: &Wish) -> Plan {
    plan(facts, wish).unwrap_or_else(|refusal| panic!("{refusal}"))
}

/// Commands of a plan, in order.
fn commands(plan: &Plan) -> Vec<String> {
    let acts = plan.steps.iter().filter_map(|step| step.act.as_ref());
    let runs = acts.filter_map(|act| match act {
        Act::Run(words) => Some(words.join(" ")),
        Act::Write(_) => None,
    });
    runs.collect()
}

fn undo(plan: &Plan) -> Vec<String> {
    plan.record.0.iter().map(ToString::to_string).collect()
}

/// Files of a plan, by path.
fn files(plan: &Plan) -> BTreeMap<String, String> {
    let acts = plan.steps.iter().filter_map(|step| step.act.as_ref());
    let files = acts.filter_map(|act| match act {
        Act::Write(file) => Some((file.path.clone(), file.text.clone())),
        Act::Run(_) => None,
    });
    files.collect()
}

#[test]
fn without_networkmanager_a_file_of_ifupdown_has_it_all() {
    let plan = planned(&facts(Manager::Ifupdown), &answers(&[BOARD]));
    assert_eq!(plan.address, Ipv4Addr::new(192, 168, 2, 1));
    let files = files(&plan);
    let stanza = &files["etc/network/interfaces.d/ferrocnc-eth1"];
    for line in [
        "auto eth1",
        "iface eth1 inet static",
        "    address 192.168.2.1/24",
        "    up ethtool -C eth1 adaptive-rx off rx-usecs 0 || true",
        "    up ip neigh replace 192.168.2.50 lladdr 02:00:00:1b:2c:3d nud permanent dev eth1",
        "    up nft -f /etc/ferrocnc/net-eth1.nft",
        "    down nft delete table netdev ferrocnc-eth1 || true",
    ] {
        assert!(stanza.lines().any(|it| it == line), "{line}:\n{stanza}");
    }
    assert!(!stanza.contains("gateway"), "{stanza}");
    let kernel = &files["etc/sysctl.d/60-ferrocnc-eth1.conf"];
    for line in [
        "net.ipv4.conf.eth1.rp_filter = 2",
        "net.ipv6.conf.eth1.disable_ipv6 = 1",
    ] {
        assert!(kernel.contains(line), "{kernel}");
    }
    let egress = &files["etc/ferrocnc/net-eth1.nft"];
    for part in [
        "policy drop;",
        "ip daddr 192.168.2.0/24 ip daddr != 192.168.2.255 accept",
        "udp dport 51234 accept",
    ] {
        assert!(egress.contains(part), "{egress}");
    }
    assert_eq!(files.len(), 3, "{files:?}");
    assert_eq!(
        commands(&plan),
        [
            "sysctl -q -w net.ipv4.conf.eth1.rp_filter=2",
            "sysctl -q -w net.ipv6.conf.eth1.disable_ipv6=1",
            "ifup eth1",
        ]
    );
    assert_eq!(
        undo(&plan),
        [
            "run    ifdown --force eth1",
            "remove /etc/network/interfaces.d/ferrocnc-eth1",
            "remove /etc/ferrocnc/net-eth1.nft",
            "remove /etc/sysctl.d/60-ferrocnc-eth1.conf",
            "run    ip link set eth1 up",
            "run    ethtool -C eth1 adaptive-rx on rx-usecs 3",
            "run    sysctl -q -w net.ipv6.conf.eth1.disable_ipv6=0",
            "run    sysctl -q -w net.ipv4.conf.eth1.rp_filter=1",
        ]
    );
}

#[test]
fn with_networkmanager_a_profile_has_it_and_the_old_connection_comes_back() {
    let mut facts = facts(Manager::NetworkManager);
    facts.connection = Some("Wired connection 1".into());
    let plan = planned(&facts, &answers(&[BOARD]));
    let files = files(&plan);
    let profile = &files["etc/NetworkManager/system-connections/ferrocnc-eth1.nmconnection"];
    for line in [
        "interface-name=eth1",
        "method=manual",
        "address1=192.168.2.1/24",
        "never-default=true",
        "method=disabled",
        "coalesce-adaptive-rx=0",
        "coalesce-rx-usecs=0",
    ] {
        assert!(profile.lines().any(|it| it == line), "{line}:\n{profile}");
    }
    let dispatcher = &files["etc/NetworkManager/dispatcher.d/ferrocnc-eth1"];
    assert!(dispatcher.starts_with("#!/bin/sh\n"), "{dispatcher}");
    assert!(
        dispatcher.contains("nud permanent dev eth1"),
        "{dispatcher}"
    );
    let modes: BTreeMap<_, _> = { plan.steps.iter() }
        .filter_map(|step| match &step.act {
            Some(Act::Write(file)) => Some((file.path.as_str(), file.mode)),
            Some(Act::Run(_)) | None => None,
        })
        .collect();
    let own = Paths::of("eth1");
    assert_eq!(modes[own.profile.as_str()], 0o600, "or it is not read");
    assert_eq!(modes[own.dispatcher.as_str()], 0o755, "or it is not run");
    assert_eq!(
        commands(&plan)[2..],
        [
            "nmcli connection load /etc/NetworkManager/system-connections/ferrocnc-eth1.nmconnection",
            "nmcli --wait 30 connection up id ferrocnc-eth1",
            "/etc/NetworkManager/dispatcher.d/ferrocnc-eth1 eth1 up",
        ]
    );
    let undo = undo(&plan);
    assert_eq!(
        undo[0],
        "run    /etc/NetworkManager/dispatcher.d/ferrocnc-eth1 eth1 down"
    );
    assert_eq!(undo[1], "run    nmcli connection delete id ferrocnc-eth1");
    let old = "run    nmcli --wait 0 connection up id 'Wired connection 1'";
    assert!(undo.iter().any(|step| step == old), "{undo:?}");
}

#[test]
fn the_address_is_of_the_boards_net_and_no_boards() {
    let at = |last| Board {
        ip: Ipv4Addr::new(10, 7, 0, last),
        mac: [2, 0, 0, 0, 0, last],
    };
    let mut facts = facts(Manager::Ifupdown);
    facts.table.clear();
    let address = |facts: &Facts, wish: &Wish| planned(facts, wish).address.octets();
    assert_eq!(address(&facts, &Wish::default()), [192, 168, 2, 1]);
    let named = Wish {
        board: Some(Ipv4Addr::new(10, 7, 0, 1)),
        ..Wish::default()
    };
    assert_eq!(address(&facts, &named), [10, 7, 0, 2]);
    assert_eq!(address(&facts, &answers(&[at(1), at(2)])), [10, 7, 0, 3]);
    // One that the port has is kept, unless a board has it.
    facts.addresses = vec![(Ipv4Addr::new(10, 7, 0, 9), 24)];
    assert_eq!(address(&facts, &answers(&[at(1)])), [10, 7, 0, 9]);
    assert_eq!(address(&facts, &answers(&[at(9)])), [10, 7, 0, 1]);
    let all: Vec<Board> = (1..255).map(at).collect();
    let refused = plan(&facts, &answers(&all));
    assert_eq!(refused, Err(Refusal::Full(Ipv4Addr::new(10, 7, 0, 0))));
}

#[test]
fn what_the_port_had_is_taken_away_and_put_back_in_the_other_order() {
    let mut facts = facts(Manager::Ifupdown);
    facts.addresses = vec![
        (Ipv4Addr::new(10, 1, 0, 9), 8),
        (Ipv4Addr::new(10, 1, 0, 10), 8),
    ];
    facts.routes = vec!["default via 10.1.0.1 metric 100".into()];
    facts.table.push(route("eth1", [0, 0, 0, 0], 0));
    let wish = answers(&[BOARD]);
    let refused = plan(&facts, &wish);
    assert_eq!(refused, Err(Refusal::DefaultRoute("eth1".into())));
    let forced = Wish {
        force: true,
        ..wish
    };
    let plan = planned(&facts, &forced);
    assert_eq!(
        commands(&plan)[2..5],
        [
            "ip -4 route del default via 10.1.0.1 metric 100 dev eth1",
            "ip -4 addr del 10.1.0.10/8 dev eth1",
            "ip -4 addr del 10.1.0.9/8 dev eth1",
        ]
    );
    let undo = undo(&plan);
    let at = |step: &str| undo.iter().position(|it| it.contains(step)).expect(step);
    let order = [
        "ifdown",
        "link set eth1 up",
        "addr replace 10.1.0.9/8",
        "addr replace 10.1.0.10/8",
        "route replace default",
    ];
    assert!(order.map(at).is_sorted(), "{undo:#?}");
}

type Break = fn(&mut Facts);

/// What is wrong with a port, and a word of what is said.
const REFUSED: &[(Break, &str)] = &[
    (
        |it| it.interface = "eth1; reboot".into(),
        "is not the name of a port",
    ),
    (
        |it| it.interface = "eth1.5".into(),
        "is not the name of a port",
    ),
    (
        |it| it.kind = Kind::Absent,
        "this computer has no interface \"eth1\"",
    ),
    (|it| it.kind = Kind::Loopback, "name the Ethernet port"),
    (|it| it.kind = Kind::Wireless, "eth1 is wireless"),
    (|it| it.kind = Kind::Part, "nomaster"),
    (
        |it| it.table.push(route("eth1", [0; 4], 0)),
        "default route",
    ),
    (
        |it| it.manager = Manager::Nothing,
        "sudo apt install ifupdown",
    ),
    (
        |it| it.missing = vec![("nft", "nftables"), ("ethtool", "ethtool")],
        "missing: nft, ethtool; sudo apt install nftables ethtool",
    ),
    (
        |it| it.reads_folder = false,
        "source /etc/network/interfaces.d/*",
    ),
    (
        |it| it.claim = Some("/etc/network/interfaces".into()),
        "/etc/network/interfaces sets eth1 up already",
    ),
    (
        |it| it.claim = Some("systemd-networkd".into()),
        "systemd-networkd manages eth1",
    ),
    (
        |it| {
            let path = Paths::of("eth1").egress;
            it.files = [(path, String::new())].into();
        },
        "/etc/ferrocnc/net-eth1.nft is there",
    ),
    (
        |it| {
            let path = Paths::of("eth1").profile;
            it.files = [(path, String::new())].into();
            it.record = Some(Record::default());
        },
        "sudo ferrocnc net remove eth1",
    ),
    (
        |it| it.table.push(route("wlan0", [192, 168, 2, 0], 24)),
        "192.168.2.0/24 is at wlan0, too",
    ),
];

#[test]
fn a_port_that_cannot_be_the_boards_is_refused_with_a_remedy() {
    for (break_it, says) in REFUSED {
        let mut facts = facts(Manager::Ifupdown);
        break_it(&mut facts);
        let refusal = plan(&facts, &answers(&[BOARD]))
            .expect_err(says)
            .to_string();
        assert!(refusal.contains(says), "{refusal} does not say {says}");
    }
}

#[test]
fn boards_that_cannot_be_told_apart_are_refused() {
    let facts = facts(Manager::Ifupdown);
    let twin = Board {
        mac: [2; 6],
        ..BOARD
    };
    let refused = plan(&facts, &answers(&[BOARD, twin]));
    assert_eq!(refused, Err(Refusal::Shared(IP)));
    let far = Board {
        ip: Ipv4Addr::new(192, 168, 3, 50),
        mac: [2; 6],
    };
    let both = answers(&[BOARD, far]);
    assert_eq!(plan(&facts, &both), Err(Refusal::Nets(IP, far.ip)));
    // The one that is named counts.
    let named = Wish {
        board: Some(far.ip),
        ..both
    };
    assert_eq!(planned(&facts, &named).boards, [far]);
}

#[test]
fn a_card_is_told_only_what_it_has() {
    let mut facts = facts(Manager::Ifupdown);
    facts.coalescing.adaptive = None;
    let plan = planned(&facts, &answers(&[BOARD]));
    let stanza = &files(&plan)[&Paths::of("eth1").stanza];
    assert!(stanza.contains("ethtool -C eth1 rx-usecs 0"), "{stanza}");
    facts.coalescing = Coalescing::default();
    let plan = planned(&facts, &answers(&[BOARD]));
    let stanza = &files(&plan)[&Paths::of("eth1").stanza];
    assert!(!stanza.contains("ethtool"), "{stanza}");
}

/// A computer with a root folder of its own, whose programs do nothing.
struct Made {
    root: PathBuf,
    ran: RefCell<Vec<String>>,
    /// The program that fails.
    broken: &'static str,
}

impl Made {
    fn new(broken: &'static str) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let (process, next) = (std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let root = std::env::temp_dir().join(format!("ferrocnc-net-{process}-{next}"));
        for folder in ["etc/sysctl.d", "etc/network/interfaces.d", "var/lib"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        fs::write(root.join("etc/network/interfaces.d/other"), "auto eth7\n").unwrap();
        Made {
            root,
            ran: RefCell::default(),
            broken,
        }
    }

    fn carry_out(&self, plan: &Plan) -> Result<(), super::act::Failed> {
        self.hand(|hand| hand.carry_out(plan))
    }

    fn hand<T>(&self, act: impl FnOnce(&Hand<'_>) -> T) -> T {
        let run = |words: &[String]| {
            self.ran.borrow_mut().push(words.join(" "));
            match words.first().is_some_and(|program| program == self.broken) {
                true => Err("it is broken".to_owned()),
                false => Ok(()),
            }
        };
        act(&Hand {
            root: self.root.clone(),
            run: &run,
        })
    }

    /// All files and folders, with what is in them.
    fn tree(&self) -> BTreeMap<PathBuf, Option<String>> {
        let mut tree = BTreeMap::new();
        let mut folders = vec![self.root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                tree.insert(path.clone(), fs::read_to_string(&path).ok());
                if path.is_dir() {
                    folders.push(path);
                }
            }
        }
        tree
    }

    /// The facts as they are after a setup.
    fn again(&self, mut facts: Facts) -> Facts {
        let own = Paths::of(&facts.interface);
        let read = |path: &str| fs::read_to_string(self.root.join(path)).ok();
        let present = own
            .all()
            .into_iter()
            .filter_map(|it| Some((it.to_owned(), read(it)?)));
        facts.files = present.collect();
        let record = read(&own.record).map(|text| Record::parse(&text).expect("a record"));
        facts.record = record;
        facts.addresses = vec![(Ipv4Addr::new(192, 168, 2, 1), 24)];
        facts
            .kernel
            .values_mut()
            .for_each(|value| "2".clone_into(value));
        facts
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.root);
    }
}

#[test]
fn a_setup_given_twice_changes_nothing_and_its_undo_leaves_no_file() {
    let made = Made::new("");
    let before = made.tree();
    let facts = facts(Manager::Ifupdown);
    let first = planned(&facts, &answers(&[BOARD]));
    made.carry_out(&first).expect("it works");
    let done = made.tree();
    let again = made.again(facts);
    let second = planned(&again, &answers(&[BOARD]));
    assert_eq!(second.steps, []);
    made.carry_out(&second).expect("it works");
    assert_eq!(made.tree(), done);
    let record = again.record.expect("a record");
    assert_eq!(record, first.record);
    assert_eq!(made.hand(|hand| hand.undo("eth1", &record)), [""; 0]);
    assert_eq!(made.tree(), before);
}

#[test]
fn a_setup_for_another_board_keeps_what_undoes_the_first() {
    let made = Made::new("");
    let before = made.tree();
    let facts = facts(Manager::Ifupdown);
    let first = planned(&facts, &Wish::default());
    made.carry_out(&first).expect("it works");
    let again = made.again(facts);
    let second = planned(&again, &answers(&[BOARD]));
    assert!(second.again);
    assert_eq!(second.record, first.record, "the values before the first");
    let commands = commands(&second);
    assert_eq!(
        commands.first().map(String::as_str),
        Some("ifdown --force eth1")
    );
    assert_eq!(commands.last().map(String::as_str), Some("ifup eth1"));
    made.carry_out(&second).expect("it works");
    let stanza = fs::read_to_string(made.root.join(Paths::of("eth1").stanza)).unwrap();
    assert!(stanza.contains("nud permanent"), "{stanza}");
    made.hand(|hand| hand.undo("eth1", &second.record));
    assert_eq!(made.tree(), before);
}

#[test]
fn a_setup_that_fails_in_any_step_undoes_the_steps_before_it() {
    let mut facts = facts(Manager::Ifupdown);
    facts.addresses = vec![(Ipv4Addr::new(10, 1, 0, 9), 8)];
    let plan = planned(&facts, &answers(&[BOARD]));
    for broken in ["sysctl", "ip", "ifup"] {
        let made = Made::new(broken);
        let before = made.tree();
        let failed = made.carry_out(&plan).expect_err(broken).to_string();
        assert!(failed.contains(&format!("`{broken}")), "{failed}");
        assert_eq!(made.tree(), before, "{broken}");
        // What ran, then what undoes that, and the step that failed with it.
        let runs = |step: &Step| match (&step.act, &step.undo) {
            (act, Some(Undo::Run(back))) => Some((act.is_some(), back.join(" "))),
            (_, Some(Undo::Remove(_)) | None) => None,
        };
        let fails = |step: &Step| match &step.act {
            Some(Act::Run(words)) => words[0] == broken,
            Some(Act::Write(_)) | None => false,
        };
        let at = plan.steps.iter().position(fails).expect("a step");
        let back: Vec<_> = plan.steps[..=at].iter().rev().filter_map(runs).collect();
        let there = back.iter().filter(|(acts, _)| *acts).count();
        let ran = made.ran.borrow();
        let back: Vec<_> = back.into_iter().map(|(_, back)| back).collect();
        assert_eq!(ran[there..], back, "{broken}");
    }
    // A folder that is not there.
    let made = Made::new("");
    fs::remove_dir(made.root.join("etc/sysctl.d")).unwrap();
    let before = made.tree();
    let failed = made.carry_out(&plan);
    let failed = failed.expect_err("no folder").to_string();
    assert!(
        failed.contains("/etc/sysctl.d/60-ferrocnc-eth1.conf"),
        "{failed}"
    );
    assert!(
        failed.ends_with("all steps before it are undone"),
        "{failed}"
    );
    assert_eq!(made.tree(), before);
}

#[test]
fn steps_back_that_fail_are_told_and_do_not_stop_the_others() {
    let made = Made::new("ifdown");
    let before = made.tree();
    let plan = planned(&facts(Manager::Ifupdown), &answers(&[BOARD]));
    made.carry_out(&plan).expect("it works");
    let failed = made.hand(|hand| hand.undo("eth1", &plan.record));
    assert_eq!(failed, ["`ifdown --force eth1`: it is broken"]);
    assert_eq!(made.tree(), before);
}

#[test]
fn a_record_is_read_as_it_was_written_and_a_damaged_one_says_so() {
    let record = Record(vec![
        Undo::Run(vec!["nmcli".into(), "it's \"one\" word".into()]),
        Undo::Remove("etc/x".into()),
    ]);
    assert_eq!(Record::parse(&record.to_text()), Ok(record));
    for text in [
        "",
        "{}",
        "[]",
        r#"{"undo": [{"run": []}]}"#,
        r#"{"undo": [{"run": [1]}]}"#,
    ] {
        let why = Record::parse(text).expect_err(text);
        assert!(why.contains("damaged"), "{why}");
    }
}

/// The computer of these files.
fn read(root: &Path, running: bool) -> Facts {
    let nm = if running {
        "running\n"
    } else {
        "not running\n"
    };
    let run = |program: &str, arguments: &[&str]| -> Option<String> {
        let said = match (program, arguments) {
            ("nmcli", ["-t", ..]) => nm,
            ("nmcli", _) => "Wired connection 1\n",
            ("ip", [_, "route", ..]) => {
                "default via 10.0.0.1 linkdown \n10.0.0.0/8 proto kernel scope link src 10.0.0.9 \n"
            }
            ("ip", _) => "eth1 UP 10.0.0.9/8\n",
            ("ethtool", _) => "Adaptive RX: n/a  TX: n/a\nrx-usecs:\t3\n",
            _ => return None,
        };
        Some(said.to_owned())
    };
    let system = System {
        root: root.to_owned(),
        root_uid: 0,
        run: &run,
        variable: &|_| Some("/usr/bin".into()),
        wait: &|_| {},
    };
    Facts::read(&system, "eth1").expect("facts")
}

#[test]
fn facts_are_read_from_the_files_and_programs_of_a_computer() {
    let made = Made::new("");
    let file = |path: &str, text: &str| {
        let path = made.root.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    assert_eq!(read(&made.root, false).kind, Kind::Absent);
    file("sys/class/net/eth1/mtu", "1500");
    file("sys/class/net/eth1/flags", "0x1003");
    file("sys/class/net/eth1/ifindex", "3");
    file("proc/sys/net/ipv4/conf/eth1/rp_filter", "1\n");
    file(
        "etc/network/interfaces",
        "source /etc/network/interfaces.d/*\n",
    );
    for program in ["usr/bin/ip", "usr/sbin/sysctl", "sbin/ifup", "usr/sbin/nft"] {
        file(program, "");
    }
    let facts = read(&made.root, false);
    assert_eq!((facts.kind, facts.up), (Kind::Wired, true));
    assert_eq!(facts.manager, Manager::Ifupdown);
    assert_eq!(facts.missing, [("ethtool", "ethtool")]);
    assert!(facts.reads_folder);
    assert_eq!(facts.claim, None);
    assert_eq!(facts.addresses, [(Ipv4Addr::new(10, 0, 0, 9), 8)]);
    assert_eq!(facts.routes, ["default via 10.0.0.1"]);
    assert_eq!(facts.kernel["net.ipv4.conf.eth1.rp_filter"], "1");
    assert_eq!(
        facts.kernel.len(),
        1,
        "without IPv6 it has no setting for it"
    );
    let coalescing = facts.coalescing;
    assert_eq!((coalescing.adaptive, coalescing.usecs), (None, Some(3)));

    let managed = read(&made.root, true);
    assert_eq!(managed.manager, Manager::NetworkManager);
    assert_eq!(managed.connection.as_deref(), Some("Wired connection 1"));

    file("run/systemd/netif/links/3", "ADMIN_STATE=configured\n");
    let claim = read(&made.root, false).claim;
    assert_eq!(claim.as_deref(), Some("systemd-networkd"));
    file(
        "etc/network/interfaces.d/ferrocnc-eth1",
        "iface eth1 inet static\n",
    );
    file(
        "etc/network/interfaces.d/lan",
        "auto eth1\niface eth1 inet dhcp\n",
    );
    let claim = read(&made.root, false).claim;
    assert_eq!(claim.as_deref(), Some("/etc/network/interfaces.d/lan"));

    file("sys/class/net/eth1/phy80211", "");
    assert_eq!(read(&made.root, false).kind, Kind::Wireless);
}

#[test]
fn a_name_that_can_stand_in_a_command_is_plain() {
    for name in ["eth1", "enp3s0", "enx00e04c680001", "lan_2", "a-b"] {
        assert!(is_plain(name), "{name}");
    }
    for name in [
        "",
        "-a",
        "a b",
        "eth1.5",
        "eth1:0",
        "../x",
        "$x",
        "sixteen-letters-",
    ] {
        assert!(!is_plain(name), "{name}");
    }
}
