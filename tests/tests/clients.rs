//! Other projects' programs against the board: ping, a console session, LiteX's RemoteClient.

use ferrocnc_tests::flash::{FIRST, SECOND, UID, factory, followed_by};
use ferrocnc_tests::hal::out;
use ferrocnc_tests::services::small;
use ferrocnc_tests::{BenchMachine, Simulator, control, wired};
use host::client::Client;
use host::driver::Driver;
use host::hal::fake::FakeHal;
use host::link::Link;
use sim::nor::Part;
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use wire::describe::JobsState;
use wire::images::{Role, Trailer};

#[test]
fn a_ping_is_answered() {
    let mut machine = BenchMachine::start();
    let clocks = machine.ping().expect("an echo reply");
    println!("ping: {clocks} clocks there and back");
}

#[test]
fn a_console_session_answers_and_changes_nothing() {
    let mut machine = BenchMachine::boot(wired::mill());
    let before = machine.registers();
    let heard = machine
        .console("help\r\nstatus\r\nnet\r\nstepgen\r\nencoder\r\nwatchdog\r\nregs\r\nnonsense\r\n");
    for word in ["status", "disarmed", "192.168.2.50"] {
        assert!(
            heard.to_lowercase().contains(word),
            "the console never said {word:?}:\n{heard}"
        );
    }
    assert_eq!(machine.registers(), before);
}

#[test]
fn the_console_takes_one_visitor_after_the_other() {
    let mut machine = BenchMachine::boot(wired::mill());
    for visit in 0..3 {
        let heard = machine.console("net\r\n");
        assert!(
            heard.contains("192.168.2.50:1234"),
            "visit {visit}:\n{heard}"
        );
        let heard = machine.console("quit\r\n");
        assert!(
            heard.contains("bye"),
            "visit {visit}, leaving politely:\n{heard}"
        );
    }
}

/// Debian's telnet against a twin's console.
fn telnet(mode: &str) {
    let twin = Simulator::twin(&["--mode", "free"]);
    let console = twin.console();
    let out = Command::new("python3")
        .arg(ferrocnc_tests::root().join("tests/clients/telnet.py"))
        .args([&console.ip().to_string(), &console.port().to_string(), mode])
        .output()
        .expect("Python is there");
    let said = [out.stdout, out.stderr].concat();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&said));
}

#[test]
fn a_telnet_client_that_negotiates_edits_its_line_on_the_board() {
    telnet("characters");
}

#[test]
fn a_telnet_client_that_does_not_negotiate_sends_lines() {
    telnet("lines");
}

#[test]
fn three_clients_have_a_console_each_and_a_fourth_when_one_has_gone() {
    use std::io::{Read as _, Write as _};
    use std::net::TcpStream;
    let twin = Simulator::twin(&["--mode", "free"]);
    let dial = || TcpStream::connect(twin.console()).expect("the twin listens");
    let hears = |mut client: &TcpStream| {
        let (mut heard, mut piece) = (Vec::new(), [0; 512]);
        while !heard.ends_with(b"ferrocnc> ") {
            match client.read(&mut piece).expect("a connection") {
                0 => break,
                length => heard.extend(&piece[..length]),
            }
        }
        String::from_utf8(heard).expect("ASCII")
    };
    let all = [dial(), dial(), dial()];
    for client in &all {
        assert_eq!(hears(client), "ferrocnc> ");
    }
    // Half lines of all three before any of them ends.
    for part in ["pw", "m ", "0\n"] {
        for mut client in &all {
            client.write_all(part.as_bytes()).expect("a connection");
        }
    }
    for client in &all {
        let heard = hears(client);
        assert!(heard.starts_with("0: period "), "{heard}");
    }
    assert_eq!(hears(&dial()), "", "there is no fourth");
    (&all[1]).write_all(b"quit\n").expect("a connection");
    assert_eq!(hears(&all[1]), "bye\r\n");
    assert_eq!(hears(&dial()), "ferrocnc> ");
}

#[test]
fn litex_remote_client_reads_the_identifier_and_a_status_word() {
    let simulator = Simulator::start(&["--mode", "free"]);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the workspace");
    let manifest = std::fs::read_to_string(ferrocnc_tests::parts().0.join("manifest.json"))
        .expect("the board's manifest");
    let manifest: serde_json::Value = serde_json::from_str(&manifest).expect("JSON");
    let csr_csv = manifest["csr_csv"]
        .as_str()
        .expect("where its registers are listed");
    let out = Command::new(root.join("target/venv/bin/python"))
        .arg(root.join("tests/clients/remote_client.py"))
        .arg(simulator.udp().to_string())
        .arg(csr_csv)
        .output()
        .expect("the Python environment that `cargo xtask setup` makes");
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(
        out.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let found = said
        .lines()
        .find(|line| line.starts_with('{'))
        .expect("what it found");
    let found: serde_json::Value = serde_json::from_str(found).expect("JSON");
    let identifier = found["identifier"].as_str().unwrap_or_default();
    assert!(identifier.contains("FerroCNC"), "identifier {identifier:?}");
}

/// The ELF of the firmware as packing leaves it beside an image of this build.
fn elf_of(build_id: u32, file: &Path) {
    let role = Role::Image;
    let trailer = Trailer { build_id, role }.to_words();
    let mut bytes = std::fs::read(ferrocnc_tests::parts().1).expect("the firmware's ELF");
    bytes.extend(trailer.iter().flat_map(|word| word.to_le_bytes()));
    std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
    std::fs::write(file, bytes).expect("a file");
}

#[test]
fn the_log_is_read_with_the_elf_of_the_running_build_and_no_other() {
    let folder = out("elf");
    let flash = folder.join("flash.bin");
    let nor = factory(Part::W25Q32JV, UID);
    std::fs::write(&flash, nor.cells()).expect("the chip's cells");
    elf_of(FIRST, &folder.join("images/first/first.elf"));
    elf_of(SECOND, &folder.join("images/second/second.elf"));
    let flash = flash.display().to_string();
    let twin = Simulator::twin(&["--mode", "free", "--flash", &flash]);
    let log = |arguments: &[&str]| -> (bool, String) {
        let mut tool = Command::new(ferrocnc_tests::program("ferrocnc"));
        tool.current_dir(&folder)
            .args(["log", &twin.udp().to_string()]);
        let output = tool.args(arguments).output().expect("the tool runs");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.success(), said)
    };
    let (ok, said) = log(&["--elf-dir", "images"]);
    assert!(ok && !said.contains("build"), "{said}");
    let (ok, said) = log(&["--elf", "images/second/second.elf"]);
    let both = "second.elf is the firmware of build bbbb0002, but the board runs build aaaa0001";
    assert!(!ok && said.contains(both), "{said}");
    let (ok, said) = log(&["--elf-dir", "images/second"]);
    let none = "the board runs build aaaa0001, and no ELF of this build is in images/second, ";
    assert!(!ok && said.contains(none), "{said}");
}

#[test]
fn the_log_of_the_release_image_is_text_again_in_the_tool() {
    let simulator = Simulator::start(&["--mode", "free"]);
    let out = Command::new(ferrocnc_tests::program("ferrocnc"))
        .args(["--json", "log", &simulator.udp().to_string(), "--elf"])
        .arg(ferrocnc_tests::parts().1)
        .output()
        .expect("the tool runs; `cargo xtask test clients` builds it");
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    let frames: Vec<serde_json::Value> = said
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert!(!frames.is_empty(), "not even its start");
    // As `defmt::info!` has it in the firmware, with the numbers of this board.
    let text = frames[0]["text"].as_str().unwrap_or_default();
    let boot = text
        .strip_prefix("boot ")
        .and_then(|rest| rest.strip_suffix(", reset 0"));
    assert!(
        boot.is_some_and(|id| u32::from_str_radix(id, 16).is_ok()),
        "{said}"
    );
    for frame in &frames {
        assert_eq!(frame["level"], "info", "{said}");
        assert!(
            frame["timestamp"].is_string(),
            "without the board's time:\n{said}"
        );
    }
}

/// Servo periods until a machine is armed, a connection of a client has reached the board, and the
/// tool has heard all it asked for.
const PATIENCE: usize = 500;

/// LinuxCNC's driver at the Verilated board, whose time is that of its exchanges.
struct Shop {
    hal: FakeHal,
    driver: Driver,
    simulator: SocketAddr,
}

impl Shop {
    fn open(simulator: &Simulator) -> Self {
        let mut hal = FakeHal::new();
        let address = host::address::parse(&simulator.udp().to_string(), 1234);
        let address = address.expect("an address");
        let mut client = Client::open(&address).expect("a socket");
        let identity = client.identify().expect("a board");
        client.acquire().expect("the session");
        let link = Link::new(client.into_socket()).expect("a link");
        let say = hal.messenger();
        let driver = Driver::export(&mut hal, 0, address, &identity, link, say);
        // The board's time stands still while this computer is busy.
        hal.set("ferrocnc.0.packet-read-timeout", 2_000_000_000);
        hal.set("ferrocnc.0.enable", true);
        let driver = driver.expect("pins");
        Shop {
            hal,
            driver,
            simulator: simulator.control(),
        }
    }

    fn enabled(&self) -> bool {
        self.hal.get("ferrocnc.0.enabled")
    }

    fn services(&self) -> JobsState {
        let code: u32 = self.hal.get("ferrocnc.0.services");
        let known = JobsState::ALL.iter().find(|state| state.code() == code);
        *known.expect("a known state")
    }

    /// Servo periods until it is so.
    fn until(&mut self, what: &str, mut so: impl FnMut(&Self) -> bool) {
        for _ in 0..PATIENCE {
            if so(self) {
                return;
            }
            self.driver.read(1_000_000);
            self.driver.write(1_000_000);
            // It asks for its session and does not wait for the answer, and a question makes the
            // one before void: a busy simulator answers here when it has done with the last one.
            std::thread::sleep(Duration::from_millis(2));
            control(self.simulator, "stats");
        }
        let number = |pin: &str| self.hal.get::<u32>(&format!("ferrocnc.0.{pin}"));
        let seen = [
            "state",
            "fault-reason",
            "packet-error-total",
            "refused-total",
        ]
        .map(number);
        let said = self.hal.said();
        panic!("{what}: not in {PATIENCE} periods: {seen:?}, {said:?}");
    }

    /// What the tool says meanwhile.
    fn tool(&mut self, arguments: &[&str]) -> String {
        let mut tool = Command::new(ferrocnc_tests::program("ferrocnc"));
        tool.arg("--json").args(arguments).stdin(Stdio::null());
        let said = std::thread::spawn(move || tool.output().expect("the tool runs"));
        self.until(arguments[0], |_| said.is_finished());
        let said = said.join().expect("its words");
        let why = String::from_utf8_lossy(&said.stderr);
        assert!(said.status.success(), "{arguments:?}: {why}");
        String::from_utf8(said.stdout).expect("text")
    }
}

#[test]
fn a_failure_of_the_services_is_named_at_the_hal_pin_in_describe_and_in_the_log() {
    const EBREAK: u32 = 0x0010_0073;
    let flash = out("services-failed").join("board.flash");
    let program = small(&wired::program(), &[EBREAK]);
    let nor = followed_by(Part::W25Q32JV, UID, &program);
    std::fs::write(&flash, nor.cells()).expect("the chip's cells");
    let flash = flash.display().to_string();
    let simulator = Simulator::start(&["--mode", "lockstep", "--flash", &flash]);
    simulator.run_ms(60);
    let board = simulator.udp().to_string();
    let mut shop = Shop::open(&simulator);
    assert_eq!(shop.services(), JobsState::Alive);
    let mut periods = 0;
    shop.until("armed", |shop| {
        // An edge that comes too early is none: there is another one.
        periods += 1;
        let request = periods % 40 >= 20;
        shop.hal.set("ferrocnc.0.enable-request", request);
        shop.enabled()
    });

    // The first frame of a connection ends them.
    let console = simulator.console();
    let caller = std::thread::spawn(move || drop(std::net::TcpStream::connect(console)));
    shop.until("ended", |shop| shop.services() == JobsState::Ended);
    let _ = caller.join();
    let described = shop.tool(&["describe", &board]);
    let described: serde_json::Value = serde_json::from_str(&described).expect("JSON");
    assert_eq!(described["services"], JobsState::Ended.text());
    let elf = ferrocnc_tests::parts().1.display().to_string();
    let log = shop.tool(&["log", &board, "--elf", &elf]);
    // As `defmt::error!` has it in the firmware, with the cause and place of the trap. The core
    // knows no `ebreak`: it is an illegal instruction.
    let place = "services failed: cause 2 at 4000004c";
    let frames = log.lines().map(|line| -> serde_json::Value {
        serde_json::from_str(line).expect("a frame of the log as JSON")
    });
    let failed: Vec<_> = frames.filter(|frame| frame["text"] == place).collect();
    assert_eq!(failed.len(), 1, "{log}");
    assert_eq!(failed[0]["level"], "error", "{log}");
    assert!(shop.enabled(), "{:?}", shop.hal.said());
    assert_eq!(shop.services(), JobsState::Ended, "it has an owner");
}
