//! `ferrocnc net setup` on a segment of this machine's kernel, and `ferrocnc net remove` after it.
//!
//! The port is a veth, the board a twin at the other end. `ip`, `nft` and `sysctl` are real. The
//! computer has a made-up `/etc`, `/run` and `/var/lib`. Two programs are stand-ins: an ifupdown
//! that does what a stanza with `address`, `up` and `down` says (Debian's would configure the
//! machine that runs the tests), and an `ethtool` that knows a card with coalescing, which a veth
//! has not.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use ferrocnc_tests::flash::{UID, factory};
use ferrocnc_tests::lan::{Lan, Place};
use ferrocnc_tests::{Simulator, program};
use sim::nor::Part;

const IFUP: &str = r#"#!/bin/sh -e
# ifup IF: the stanza of our file.
file=/etc/network/interfaces.d/ferrocnc-$1
grep -qx "auto $1" "$file"
ip link set "$1" up
ip addr add "$(sed -n 's/^ *address //p' "$file")" dev "$1"
sh -ec "$(sed -n 's/^ *up //p' "$file")"
"#;

const IFDOWN: &str = r#"#!/bin/sh
# ifdown --force IF
file=/etc/network/interfaces.d/ferrocnc-$2
sh -c "$(sed -n 's/^ *down //p' "$file")"
ip -4 addr flush dev "$2"
ip link set "$2" down
"#;

const ETHTOOL: &str = r#"#!/bin/sh -e
# ethtool -c IF; ethtool -C IF rx-usecs N
card=/run/card
case $1 in
-c) printf 'Adaptive RX: n/a  TX: n/a\nrx-usecs:\t%s\n' "$(cat $card)" ;;
-C) [ "$3" = rx-usecs ]; echo "$4" > $card ;;
esac
"#;

/// A computer with a port, and a folder that has its files.
struct Computer {
    place: Place,
    folder: PathBuf,
}

impl Computer {
    fn new(place: Place, name: &str) -> Self {
        let folder = format!("ferrocnc-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        let _ = std::fs::remove_dir_all(&folder);
        for made in [
            "etc/network/interfaces.d",
            "etc/sysctl.d",
            "run",
            "lib",
            "bin",
        ] {
            std::fs::create_dir_all(folder.join(made)).expect("a folder");
        }
        let computer = Computer { place, folder };
        let source = "source /etc/network/interfaces.d/*\n";
        computer.file("etc/network/interfaces", source);
        computer.file("etc/network/interfaces.d/other", "auto eth7\n");
        computer.file("run/card", "3\n");
        for (name, text) in [("ifup", IFUP), ("ifdown", IFDOWN), ("ethtool", ETHTOOL)] {
            computer.program(name, text);
        }
        let began = Instant::now();
        while !computer
            .says("ip -6 -br addr show dev eth0")
            .contains("fe80")
        {
            assert!(began.elapsed() < SLOWEST, "the link never came up");
        }
        computer
    }

    fn file(&self, path: &str, text: &str) {
        std::fs::write(self.folder.join(path), text).expect("a file");
    }

    fn program(&self, name: &str, text: &str) {
        use std::os::unix::fs::PermissionsExt;
        let path = self.folder.join("bin").join(name);
        std::fs::write(&path, text).expect("a file");
        let mode = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(path, mode).expect("a program");
    }

    /// Runs a program there: it sees the computer's own files, programs and interfaces.
    fn run(&self, program: &Path, arguments: &[&str]) -> Output {
        let mount = r#"
mount -t sysfs none /sys
mount --bind "$0/etc" /etc
mount --bind "$0/run" /run
mount --bind "$0/lib" /var/lib
PATH=$0/bin:/usr/sbin:/usr/bin:/sbin:/bin exec "$@"
"#;
        let mut command = self.place.command("unshare");
        command
            .args(["--mount", "--", "sh", "-e", "-c", mount])
            .arg(&self.folder)
            .arg(program)
            .args(arguments);
        let said = command.stdin(Stdio::null()).output();
        said.unwrap_or_else(|error| panic!("{command:?}: {error}"))
    }

    /// `ferrocnc` has to succeed.
    fn ferrocnc(&self, arguments: &[&str]) -> String {
        let said = self.run(&program("ferrocnc"), arguments);
        let (out, why) = (text(&said.stdout), text(&said.stderr));
        assert!(said.status.success(), "{arguments:?}: {out}{why}");
        out
    }

    /// `ferrocnc` has to fail; why it does.
    fn refused(&self, arguments: &[&str]) -> String {
        let said = self.run(&program("ferrocnc"), arguments);
        assert!(!said.status.success(), "{}", text(&said.stdout));
        text(&said.stderr)
    }

    fn says(&self, command: &str) -> String {
        let said = self.run(Path::new("sh"), &["-c", command]);
        assert!(said.status.success(), "{command}: {}", text(&said.stderr));
        text(&said.stdout)
    }

    /// It is as it was; a link and its address of IPv6 come up by and by.
    fn is_as(&self, before: &BTreeMap<String, String>) {
        let began = Instant::now();
        while self.state() != *before && began.elapsed() < SLOWEST {
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(self.state(), *before);
    }

    /// Everything that a setup may change.
    fn state(&self) -> BTreeMap<String, String> {
        let mut state = BTreeMap::new();
        for command in [
            "ip -4 -o addr show dev eth0",
            // A new address of IPv6 is tentative for a second.
            "ip -6 -br addr show dev eth0",
            "ip -br link show dev eth0",
            "ip -4 route show",
            "ip rule show",
            "ip neigh show nud permanent",
            RULES,
            SETTINGS,
        ] {
            state.insert(command.to_owned(), self.says(command));
        }
        let mut folders = vec![self.folder.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                let name = path.display().to_string();
                match path.is_dir() {
                    true => {
                        state.insert(name, "a folder".to_owned());
                        folders.push(path);
                    }
                    false => {
                        let text = std::fs::read_to_string(&path).expect("text");
                        state.insert(name, text);
                    }
                }
            }
        }
        state
    }
}

impl Drop for Computer {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
        for ending in ["flash", "flash.status"] {
            let _ = std::fs::remove_file(self.folder.with_extension(ending));
        }
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A twin at the end of the cable, with the factory's address.
fn board(place: &Place, computer: &Computer) -> Simulator {
    let path = computer.folder.with_extension("flash");
    let nor = factory(Part::W25Q32JV, UID);
    nor.leave_in(&path).expect("two files");
    Simulator::at(place, &path, UID)
}

/// Echo requests that a place has received.
fn echoes(place: &Place) -> u64 {
    let said = place.command("cat").arg("/proc/net/snmp").output();
    let said = text(&said.expect("cat runs").stdout);
    let mut lines = said.lines().filter(|line| line.starts_with("IcmpMsg:"));
    let (names, counts) = (lines.next().unwrap_or(""), lines.next().unwrap_or(""));
    let mut columns = names.split(' ').zip(counts.split(' '));
    let count = columns.find(|(name, _)| *name == "InType8");
    count.map_or(0, |(_, count)| count.parse().expect("a number"))
}

const BOARD: &str = "192.168.2.50";
/// Not the one that a test breaks.
const RULES: &str = "/usr/sbin/nft list ruleset";
const SETTINGS: &str = "sysctl net.ipv4.conf.eth0.rp_filter net.ipv6.conf.eth0.disable_ipv6";
/// What a busy kernel takes at most to switch a link on.
const SLOWEST: Duration = Duration::from_secs(60);

#[test]
fn a_port_is_set_up_for_the_board_and_taken_back() {
    let mut lan = Lan::new();
    // An address that it was given by hand.
    let computer = Computer::new(lan.plug(Some("10.7.0.9/16")), "net");
    let place = lan.plug(None);
    let _board = board(&place, &computer);
    let before = computer.state();

    // What is shown changes nothing.
    let shown = computer.ferrocnc(&["net", "setup", "eth0", BOARD, "--dry-run"]);
    for part in [
        "/etc/network/interfaces.d/ferrocnc-eth0",
        "ifup eth0",
        BOARD,
    ] {
        assert!(shown.contains(part), "{part}:\n{shown}");
    }
    computer.is_as(&before);

    let done = computer.ferrocnc(&["net", "setup", "eth0", BOARD, "--yes"]);
    assert!(done.contains(&format!("answers at {BOARD}:1234")), "{done}");
    let after = computer.state();
    let says = |command: &str, part: &str| {
        let said = &after[command];
        assert!(said.contains(part), "{command} does not say {part}: {said}");
    };
    says("ip -4 -o addr show dev eth0", "192.168.2.1/24");
    says("ip neigh show nud permanent", BOARD);
    says(RULES, "table netdev ferrocnc-eth0");
    says(SETTINGS, "rp_filter = 2");
    says(SETTINGS, "disable_ipv6 = 1");
    assert!(!after["ip -4 -o addr show dev eth0"].contains("10.7.0.9"));
    assert_eq!(computer.says("cat /run/card"), "0\n", "coalescing is off");

    // A ping reaches the board, one for all does not leave the port.
    let heard = echoes(&place);
    let ping = computer.run(Path::new("ping"), &["-c", "1", "-w", "60", BOARD]);
    assert!(ping.status.success(), "{}", text(&ping.stdout));
    assert_eq!(echoes(&place), heard + 1);
    let broadcast = ["-b", "-c", "1", "-W", "0.1", "192.168.2.255"];
    computer.run(Path::new("ping"), &broadcast);
    assert_eq!(echoes(&place), heard + 1);

    // Twice gives the same.
    let again = computer.ferrocnc(&["net", "setup", "eth0", BOARD, "--yes"]);
    assert!(again.contains("It is set up already."), "{again}");
    computer.is_as(&after);

    computer.ferrocnc(&["net", "remove", "eth0", "--yes"]);
    computer.is_as(&before);
    let why = computer.refused(&["net", "remove", "eth0", "--yes"]);
    assert!(why.contains("nothing to take back"), "{why}");
}

#[test]
fn a_setup_that_fails_in_the_middle_leaves_the_port_as_it_was() {
    let mut lan = Lan::new();
    let computer = Computer::new(lan.plug(Some("192.168.2.9/24")), "net-fails");
    // A firewall's program that finds an error in every rule.
    computer.program("nft", "#!/bin/sh\necho no rules today >&2\nexit 1\n");
    let before = computer.state();
    // Without an answer nothing is done.
    let why = computer.refused(&["net", "setup", "eth0"]);
    assert!(why.contains("nothing was changed; --yes"), "{why}");
    computer.is_as(&before);
    let why = computer.refused(&["net", "setup", "eth0", "--yes"]);
    assert!(why.contains("`ifup eth0` failed"), "{why}");
    assert!(why.contains("no rules today"), "{why}");
    assert!(why.contains("all steps before it are undone"), "{why}");
    computer.is_as(&before);
}

#[test]
fn a_port_that_is_not_there_or_carries_the_default_route_is_refused() {
    let mut lan = Lan::new();
    let computer = Computer::new(lan.plug(Some("10.7.0.9/16")), "net-refused");
    computer.place.ip("route add default via 10.7.0.1");
    let before = computer.state();
    let why = computer.refused(&["net", "setup", "eth0", BOARD, "--yes"]);
    assert!(why.contains("default route"), "{why}");
    let why = computer.refused(&["net", "setup", "eth5", BOARD, "--yes"]);
    assert!(why.contains("no interface \"eth5\""), "{why}");
    computer.is_as(&before);
}
