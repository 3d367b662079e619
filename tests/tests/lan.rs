//! New boards on one Ethernet segment, all with the factory's address, and the real `ferrocnc`
//! beside them.
//!
//! Each board is a twin that *is* a network interface ([`ferrocnc_tests::lan`]): it has the board's
//! hardware address, hears broadcasts and takes another address when it is told to. Needs network
//! namespaces, so root, or a kernel that lets users make them; the refusals need loopback only.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use ferrocnc_tests::flash::{self, Boots, FIRST, SECOND, UID, boots, factory};
use ferrocnc_tests::lan::dhcp::DhcpServer;
use ferrocnc_tests::lan::{Lan, Place, SILENT};
use ferrocnc_tests::{Simulator, program};
use serde_json::Value;
use sim::nor::{Nor, Part};

const UIDS: [u64; 3] = [UID, 0xd162_0c8a_1b2c_3d4f, 0x5be3_0000_0000_0001];
/// Build id of what is brought in last.
const THIRD: u32 = 0xcccc_0003;

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ferrocnc-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for the flashes");
    folder
}

/// A board's flash as the bench leaves it, in a file.
fn flash_file(folder: &Path, uid: u64) -> PathBuf {
    let path = folder.join(format!("{uid:016x}.flash"));
    let nor = factory(Part::W25Q32JV, uid);
    nor.leave_in(&path).expect("two files");
    path
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// `ferrocnc` with these arguments, run by this command.
fn ferrocnc(mut command: Command, arguments: &[&str]) -> Output {
    command
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("{command:?}: {error}"))
}

/// What a board of a busy computer takes at most.
const SLOWEST: Duration = Duration::from_secs(120);

/// Runs `ferrocnc` on this host, again while the board is silent. It has to succeed.
fn at_host(host: &Place, arguments: &[&str]) -> String {
    let began = Instant::now();
    let said = loop {
        let said = ferrocnc(host.command(program("ferrocnc")), arguments);
        let error = text(&said.stderr);
        let silent = !said.status.success() && SILENT.iter().any(|word| error.contains(word));
        if !silent || began.elapsed() > SLOWEST {
            break said;
        }
    };
    assert!(
        said.status.success(),
        "ferrocnc {arguments:?}: {}{}",
        text(&said.stdout),
        text(&said.stderr)
    );
    text(&said.stdout)
}

/// The boards that answer, by unique id. Looks again while fewer than `count` do.
fn discover(host: &Place, count: usize, arguments: &[&str]) -> Vec<Value> {
    let began = Instant::now();
    loop {
        let said = at_host(host, &[&["--json", "discover"], arguments].concat());
        let said: Value = serde_json::from_str(&said).unwrap_or_else(|e| panic!("{said}: {e}"));
        let boards = said["boards"].as_array().expect("a list");
        if boards.len() >= count || began.elapsed() > SLOWEST {
            return boards.clone();
        }
    }
}

fn values<'v>(boards: &'v [Value], key: &str) -> HashSet<&'v str> {
    boards
        .iter()
        .map(|board| {
            board[key]
                .as_str()
                .unwrap_or_else(|| panic!("no {key}: {board}"))
        })
        .collect()
}

fn uid_text(uid: u64) -> String {
    host::uid::uid_text([(uid >> 32) as u32, uid as u32])
}

#[test]
fn three_boards_with_the_factory_address_are_found_named_and_told_apart() {
    let folder = folder("three");
    let mut lan = Lan::new();
    let host = lan.plug(Some("192.168.2.1/24"));
    let places: Vec<Place> = UIDS.iter().map(|_| lan.plug(None)).collect();
    let start = || -> Vec<Simulator> {
        let each = places.iter().zip(UIDS);
        each.map(|(place, uid)| {
            let path = folder.join(format!("{uid:016x}.flash"));
            Simulator::at(place, &path, uid)
        })
        .collect()
    };
    for uid in UIDS {
        flash_file(&folder, uid);
    }
    let mut boards = start();

    let found = discover(&host, 3, &[]);
    assert_eq!(found.len(), 3, "{found:#?}");
    let uids: Vec<String> = UIDS.into_iter().map(uid_text).collect();
    let expected: HashSet<&str> = uids.iter().map(String::as_str).collect();
    assert_eq!(values(&found, "uid"), expected);
    assert_eq!(values(&found, "ip"), HashSet::from(["192.168.2.50"]));
    assert_eq!(
        values(&found, "mac").len(),
        3,
        "no two share a hardware address"
    );
    assert_eq!(values(&found, "running"), HashSet::from(["slot A"]));

    // One after the other, by unique id; the others stay where they are.
    for (n, uid) in uids.iter().enumerate() {
        let ip = format!("192.168.2.{}/24", 51 + n);
        let name = format!("axis {n}");
        at_host(&host, &["set", "--uid", uid, "--ip", &ip, "--name", &name]);
        let found = discover(&host, 3, &[]);
        assert_eq!(found.len(), 3, "{found:#?}");
        let here = found.iter().find(|board| board["uid"] == *uid);
        let here = here.unwrap_or_else(|| panic!("{uid} is gone: {found:#?}"));
        assert_eq!(here["name"], *name);
        assert_eq!(here["ip"], *ip.split('/').next().unwrap_or_default());
        let left = found.iter().filter(|board| board["ip"] == "192.168.2.50");
        assert_eq!(left.count(), 2 - n);
    }

    // Each answers at the address it reports, with the id it reports.
    let told_apart = |host: &Place| {
        for (n, uid) in uids.iter().enumerate() {
            let said = at_host(
                host,
                &["--json", "describe", &format!("192.168.2.{}", 51 + n)],
            );
            assert!(said.contains(uid.as_str()), "{said}");
        }
    };
    told_apart(&host);

    // The plugs are pulled; what was set is in force again.
    for board in &mut boards {
        board.pull_the_plug();
    }
    drop(boards);
    let _boards = start();
    told_apart(&host);
    let names = discover(&host, 3, &[]);
    assert_eq!(
        values(&names, "name"),
        HashSet::from(["axis 0", "axis 1", "axis 2"])
    );

    // A computer in another net, and one without any address there, see them all the same.
    let elsewhere = lan.plug(Some("10.7.0.9/16"));
    assert_eq!(discover(&elsewhere, 3, &[]).len(), 3);
    let nowhere = lan.plug(None);
    assert_eq!(discover(&nowhere, 3, &["--interface", "eth0"]).len(), 3);
    let _ = std::fs::remove_dir_all(&folder);
}

/// Asks for boards until the only one is where it should be.
fn wait_for_ip(host: &Place, wanted: impl Fn(&str) -> bool) -> Value {
    let began = Instant::now();
    let mut found = Vec::new();
    // The board waits 10 s of its own for a server before it falls back.
    while began.elapsed() < SLOWEST {
        found = discover(host, 1, &["--interface", "eth0"]);
        let there = |board: &Value| board["ip"].as_str().is_some_and(&wanted);
        if found.len() == 1 && there(&found[0]) {
            return found.remove(0);
        }
        std::thread::sleep(Duration::from_secs(1));
    }
    panic!("the board never came there: {found:#?}");
}

#[test]
fn a_real_dhcp_server_gives_a_board_its_address_and_without_one_it_falls_back() {
    let folder = folder("dhcp");
    let mut lan = Lan::new();
    let host = lan.plug(Some("10.7.0.1/24"));
    let place = lan.plug(None);
    let path = flash_file(&folder, UIDS[0]);
    let mut board = Simulator::at(&place, &path, UIDS[0]);
    let uid = uid_text(UIDS[0]);
    let server = DhcpServer::start(&host, &folder, "2m");
    assert_eq!(wait_for_ip(&host, |_| true)["ip"], "192.168.2.50");
    at_host(
        &host,
        &["set", "--uid", &uid, "--dhcp", "--interface", "eth0"],
    );
    let leased = wait_for_ip(&host, |ip| ip.starts_with("10.7.0.5"));
    let (ip, mac) = (&leased["ip"], &leased["mac"]);
    let (ip, mac) = (ip.as_str().expect("an IP"), mac.as_str().expect("a MAC"));
    let said = server.said();
    let acknowledged = said.lines().any(|line| {
        line.contains("DHCPACK(eth0)") && line.contains(ip) && line.to_lowercase().contains(mac)
    });
    assert!(acknowledged, "{ip} {mac} in\n{said}");
    // It is really there.
    let described = at_host(&host, &["--json", "describe", ip]);
    assert!(described.contains(&uid), "{described}");

    // Power fails, and there is no server any more: the address it had before counts.
    drop(server);
    board.pull_the_plug();
    drop(board);
    let _board = Simulator::at(&place, &path, UIDS[0]);
    wait_for_ip(&host, |ip| ip == "192.168.2.50");
    let _ = std::fs::remove_dir_all(&folder);
}

/// What is in the file, and what an FPGA would make of it.
fn boots_from(path: &Path) -> Boots {
    let nor = Nor::in_file(path, Part::W25Q32JV, 0).expect("the board's flash");
    boots(&nor)
}

#[test]
fn an_update_of_a_board_that_loses_power_again_and_again_succeeds() {
    let folder = folder("plug");
    let path = flash_file(&folder, UIDS[0]);
    let golden = std::fs::read(&path).expect("the flash")[0x30_0000..].to_vec();
    let mut lan = Lan::new();
    let host = lan.plug(Some("192.168.2.1/24"));
    let place = lan.plug(None);
    // Five blocks: enough for the plug to be pulled in the middle of something.
    let files = [SECOND, THIRD].map(|build| {
        let file = folder.join(format!("{build:08x}.bit"));
        std::fs::write(&file, flash::bit(build, 4_000)).expect("a file");
        file.display().to_string()
    });
    let mut board = Simulator::at(&place, &path, UIDS[0]);
    for pull in 0..6 {
        let mut update = host.command(program("ferrocnc"));
        update.args([
            "update",
            "--quick",
            "--patience",
            "30",
            "192.168.2.50",
            &files[pull as usize % 2],
        ]);
        let mut update = update
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("ferrocnc");
        std::thread::sleep(Duration::from_millis(150 + 170 * pull));
        board.pull_the_plug();
        let now = boots_from(&path);
        assert!(
            matches!(now, Boots::Slot(_, FIRST | SECOND | THIRD)),
            "pull {pull}: {now:?}"
        );
        let cells = std::fs::read(&path).expect("the flash");
        assert!(cells[0x30_0000..] == golden, "pull {pull}: golden");
        board = Simulator::at(&place, &path, UIDS[0]);
        // Half of the times it is waited out by the tool, half of the times the operator gives up
        // and starts again.
        if pull % 2 == 0 {
            let done = update.wait().expect("ferrocnc ends");
            println!("pull {pull}: the tool waited and ended with {done}");
        } else {
            let _ = update.kill();
            let _ = update.wait();
        }
    }
    at_host(&host, &["update", "192.168.2.50", &files[0]]);
    board.pull_the_plug();
    let now = boots_from(&path);
    assert!(matches!(now, Boots::Slot(_, SECOND)), "{now:?}");
    let _board = Simulator::at(&place, &path, UIDS[0]);
    let said = discover(&host, 1, &[]);
    assert_eq!(said[0]["build_id"], format!("{SECOND:08x}"));
    let _ = std::fs::remove_dir_all(&folder);
}

// ---- on loopback --------------------------------------------------------------------------------

/// A twin in real time behind loopback, with this flash.
fn loopback(path: &Path) -> Simulator {
    let path = path.display().to_string();
    Simulator::twin(&["--mode", "free", "--flash", &path])
}

fn update(board: &Simulator, file: &Path) -> Output {
    let address = board.udp().to_string();
    let file = file.display().to_string();
    ferrocnc(
        Command::new(program("ferrocnc")),
        &["update", &address, &file],
    )
}

#[test]
fn a_file_that_is_not_for_this_board_changes_nothing() {
    let folder = folder("refused");
    let path = flash_file(&folder, UIDS[0]);
    let before = std::fs::read(&path).expect("the flash");
    let board = loopback(&path);
    let good = flash::bit(SECOND, 14);
    let mut damaged = good.clone();
    let last = damaged.len() - 100;
    damaged[last] ^= 4;
    let image = flash::image(SECOND, 14);
    let other_platform = host::image::sample::wrap("mill6", "5a-75e-8.2", SECOND, &image);
    let small = sim::loader::Small {
        idcode: 0x4111_2043,
        usercode: SECOND,
        frames: 14,
    };
    let mut other_fpga = host::image::sample::wrap("mill6", "5a-75b-8.0", SECOND, &small.bytes());
    let at = other_fpga
        .windows(9)
        .position(|part| part == b"LFE5U-25F")
        .expect("the header names a part");
    other_fpga[at + 6..at + 8].copy_from_slice(b"45");
    for (name, contents, says) in [
        ("truncated", &good[..good.len() - 1], "cut short"),
        ("damaged", &damaged, "CRC"),
        ("other-fpga", &other_fpga, "LFE5U-45F"),
        ("other-platform", &other_platform, "5a-75e-8.2"),
        ("nothing", b"hello", "not an ECP5 bitstream"),
    ] {
        let file = folder.join(format!("{name}.bit"));
        let mut out = std::fs::File::create(&file).expect("a file");
        out.write_all(contents).expect("written");
        let said = update(&board, &file);
        let why = text(&said.stderr);
        assert!(!said.status.success(), "{name} was taken");
        assert!(why.contains(says), "{name}: {why}");
        let now = std::fs::read(&path).expect("the flash");
        assert!(now == before, "{name}: the flash has changed");
    }
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn an_update_of_an_armed_machine_is_refused_and_does_not_disturb_it() {
    let folder = folder("armed");
    let path = flash_file(&folder, UIDS[0]);
    let before = std::fs::read(&path).expect("the flash");
    let board = loopback(&path);
    let file = folder.join("second.bit");
    std::fs::write(&file, flash::bit(SECOND, 14)).expect("a file");
    let mut driver = ferrocnc_tests::driver::Driver::armed(board.udp());
    let said = std::thread::scope(|scope| {
        let tool = scope.spawn(|| update(&board, &file));
        while !tool.is_finished() {
            driver.exchange();
            std::thread::sleep(Duration::from_millis(1));
        }
        tool.join().expect("ferrocnc")
    });
    assert!(!said.status.success());
    let why = text(&said.stderr);
    assert!(why.contains("armed") || why.contains("driven"), "{why}");
    assert!(driver.exchange().state.enabled, "it is armed still");
    let now = std::fs::read(&path).expect("the flash");
    assert!(now == before);
    let _ = std::fs::remove_dir_all(&folder);
}
