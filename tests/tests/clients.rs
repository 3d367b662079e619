//! Other projects' programs against the board: ping, a console session, LiteX's RemoteClient.

use ferrocnc_tests::{BenchMachine, Simulator, wired};
use std::path::Path;
use std::process::Command;

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
