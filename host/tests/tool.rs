//! The tool `ferrocnc` against a fake board.

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod ferrocnc_tool;

use common::{FakeBoard, Time};
use ferrocnc_tool::{answer, complaint, tool};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;

fn board() -> FakeBoard {
    FakeBoard::mill6(Time::Lockstep(60_000))
}

#[test]
fn describe_tells_names_versions_and_state() {
    let board = board();
    let text = answer(&["describe", &board.text()]);
    for part in [
        "configuration mill6",
        "0xfe440c4c",
        "60 MHz",
        "disarmed",
        "spindle-on",
    ] {
        assert!(text.contains(part), "{part} missing in:\n{text}");
    }
    assert!(text.contains("exchanges  0 the fast way, 0 the long way\n"));
    board.look().knobs.ways = [3, 4, 2];
    let json = answer(&["--json", "describe", &board.text()]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["clock_hz"], 60_000_000);
    assert_eq!(json["exchanges"]["fast"], 3);
    assert_eq!(json["exchanges"]["long"], 4);
    assert_eq!(
        json["exchanges"]["last_long"],
        "an exchange before it was lost"
    );
    assert_eq!(json["stepgen"].as_array().unwrap().len(), 6);
    assert_eq!(json["stepgen"][0]["name"], "x");
    assert_eq!(json["stepgen"][0]["pins"], "step=j1:0 dir=j1:1");
}

#[test]
fn watch_shows_the_status_without_taking_the_session() {
    let board = board();
    let text = answer(&["watch", "--once", &board.text()]);
    assert!(text.contains("session free"), "{text}");
    assert!(text.contains("limit-x=0"), "{text}");
    assert!(
        text.contains("link 1000 Mbit/s, 0 frames thrown away"),
        "{text}"
    );
    board.look().knobs.ways = [70, 80, 5];
    let text = answer(&["watch", "--once", &board.text()]);
    let ways = "70 the fast way, 80 the long way (the last: its frame or";
    assert!(text.contains(ways), "{text}");
    let json = answer(&["watch", "--once", "--json", &board.text()]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["state"], "boot");
    assert_eq!(json["ways"]["fast"], 70);
    assert_eq!(json["ways"]["long"], 80);
    assert!(board.look().owner.is_none());
    assert_eq!(board.look().exchanges, 0);
}

#[test]
fn the_doctor_looks_at_this_computer_and_at_the_board_and_takes_no_session() {
    let board = board();
    board.look().knobs.ways = [3, 4000, 5];
    let file = std::env::temp_dir().join(format!("ferrocnc-doctor-{}.json", std::process::id()));
    // This computer may be bad; the report is written first.
    let arguments = ["doctor", &board.text(), "--report", file.to_str().unwrap()];
    let mill = ["--ini", "examples/mill/mill.ini"];
    let _ = tool(&[&arguments[..], &mill[..]].concat());
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let found = |check: &str| {
        let all = report["findings"].as_array().unwrap();
        let one = all.iter().find(|finding| finding["check"] == check);
        one.unwrap_or_else(|| panic!("{check} missing in {text}"))
            .clone()
    };
    assert_eq!(found("port")["fact"], "lo, this computer itself");
    assert_eq!(found("exchanges")["verdict"], "note");
    let remedy = found("exchanges")["remedy"].as_str().unwrap().to_owned();
    assert!(remedy.contains("TOS or TTL"), "{remedy}");
    for check in ["real-time kernel", "clock", "release", "refused datagrams"] {
        found(check);
    }
    // The mill of the examples is made for this board, and its pins are those that it exports.
    for check in [
        "pins in HAL files",
        "step timing",
        "e-stop",
        "names in HAL",
        "key",
    ] {
        assert_eq!(found(check)["verdict"], "good", "{}", found(check));
    }
    assert!(board.look().owner.is_none());
}

#[test]
fn a_doctor_without_a_configuration_or_a_time_says_what_to_name() {
    let said = complaint(&["doctor", "--ini", "/nowhere.ini"]);
    assert!(
        said.contains("cannot read /nowhere.ini; name the"),
        "{said}"
    );
    for seconds in ["0", "4000", "nan"] {
        let said = complaint(&["doctor", "--listen", seconds]);
        assert!(said.contains("--listen 10"), "{said}");
        let said = complaint(&["doctor", "127.0.0.1", "--ping", seconds]);
        assert!(said.contains("--ping 30"), "{said}");
    }
}

#[test]
fn a_board_without_a_log_and_a_file_without_texts_are_told_apart() {
    let board = board();
    let this = std::env::current_exe().unwrap();
    let said = complaint(&["log", &board.text(), "--elf", this.to_str().unwrap()]);
    assert!(said.contains("is it the firmware?"), "{said}");
    let said = complaint(&["log", &board.text(), "--elf", "/nowhere.elf"]);
    assert!(said.contains("--elf"), "{said}");
}

#[test]
fn a_wrong_address_is_told_in_one_sentence() {
    let said = complaint(&["describe", "127.0.0.1:port"]);
    assert!(said.contains("is not IP[:port]"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn one_console_command_gives_its_answer_without_prompts() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(b"ferrocnc> ").unwrap();
        let mut line = String::new();
        BufReader::new(stream.try_clone().unwrap())
            .read_line(&mut line)
            .unwrap();
        stream
            .write_all(b"state disarmed\r\nuptime 3 s\r\nferrocnc> ")
            .unwrap();
        line
    });
    let text = answer(&["console", &address, "-c", "status"]);
    assert_eq!(text, "state disarmed\nuptime 3 s\n");
    assert_eq!(server.join().unwrap(), "status\r\n");
}

#[test]
fn completions_and_manual_pages_name_every_command() {
    let commands = ["config", "job", "describe", "doctor", "flash", "update"];
    let bash = answer(&["completions", "bash"]);
    for command in commands {
        assert!(bash.contains(&format!("ferrocnc,{command})")), "{command}");
    }
    let folder = std::env::temp_dir().join(format!("ferrocnc-man-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    answer(&["man", folder.to_str().unwrap()]);
    let page = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap_or_default();
    let first = page("ferrocnc.1");
    let sending = page("ferrocnc-job-send.1");
    let pages = commands.map(|command| page(&format!("ferrocnc-{command}.1")));
    std::fs::remove_dir_all(&folder).unwrap();
    for (command, page) in commands.iter().zip(pages) {
        assert!(
            page.contains(&format!("ferrocnc {command}")),
            "{command}: {page}"
        );
        assert!(
            first.contains(&format!("ferrocnc\\-{command}(1)")),
            "{first}"
        );
    }
    assert!(sending.contains(".SH SYNOPSIS"), "{sending}");
    let missing = complaint(&["man", "/nonexistent"]);
    assert!(missing.contains("/nonexistent is not a folder; create it first"));
}
