//! `ferrocnc ui` against a fake board: which requests it answers, that its answers are the
//! commands', and that wrong input gets a reason. `tests/tests/ui` drives its pages in a browser.

#[path = "common/fake_board.rs"]
mod common;
#[path = "common/tool.rs"]
mod ferrocnc_tool;

use common::{EIGHT, FakeBoard, Time};
use ferrocnc_tool::{answer, complaint};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use wire::State;
use wire::flash::Op;

const MILL6: &str = include_str!("../../boards/mill6.toml");

/// A server; it ends with the test.
struct Ui {
    child: Child,
    /// `127.0.0.1:port`.
    host: String,
    token: String,
}

impl Ui {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
        command.args(["ui", "--no-open", "--json"]).args(arguments);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let output = child.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let address = said["address"].as_str().unwrap();
        let address = address.strip_prefix("http://").unwrap();
        let (host, rest) = address.split_once('/').unwrap();
        let (token, _) = rest.split_once('/').unwrap();
        let [host, token] = [host, token].map(str::to_owned);
        Ui { child, host, token }
    }

    /// Sends a request with these header lines; the connection behind its answer's head, and that.
    fn send(
        &self,
        method: &str,
        path: &str,
        headers: &str,
        body: &str,
    ) -> (BufReader<TcpStream>, String) {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\n{headers}Connection: close\r\nContent-Length: {length}\r\n\r\n{body}"
        )
        .unwrap();
        let mut stream = BufReader::new(stream);
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            assert_ne!(stream.read_line(&mut head).unwrap(), 0, "{head}");
        }
        (stream, head)
    }

    /// The status and the text of an answer.
    fn asked(&self, method: &str, path: &str, headers: &str, body: &str) -> (u16, String) {
        let (mut stream, head) = self.send(method, path, headers, body);
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, text)
    }

    fn host_line(&self) -> String {
        format!("Host: {}\r\n", self.host)
    }

    /// As our own page asks.
    fn get(&self, path: &str) -> (u16, String) {
        let path = format!("/{}/{path}", self.token);
        self.asked("GET", &path, &self.host_line(), "")
    }

    fn post(&self, command: &str, body: &Value) -> (u16, String) {
        self.post_as("application/json", command, &body.to_string())
    }

    fn post_as(&self, kind: &str, command: &str, body: &str) -> (u16, String) {
        let host = &self.host;
        let headers = format!("Host: {host}\r\nOrigin: http://{host}\r\nContent-Type: {kind}\r\n");
        let path = format!("/{}/api/{command}", self.token);
        self.asked("POST", &path, &headers, body)
    }

    /// Applies a file called mill6 to a board: what is told meanwhile, and the end.
    fn applies(&self, board: &str, toml: &str) -> (Vec<Value>, Value) {
        let command = format!("config/apply?board={board}&name=mill6");
        let (status, text) = self.post_as("application/octet-stream", &command, toml);
        assert_eq!(status, 200, "{text}");
        // Between the objects are the lengths of what is sent as one piece.
        let lines = text.lines().filter(|line| line.starts_with('{'));
        let mut lines: Vec<Value> = lines
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        let end = lines.pop().expect("an end");
        (lines, end)
    }
}

impl Drop for Ui {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Of an answer that must be good.
#[track_caller]
fn good((status, text): (u16, String)) -> Value {
    assert_eq!(status, 200, "{text}");
    serde_json::from_str(&text).unwrap()
}

/// The reason of a refusal.
#[track_caller]
fn refused((status, text): (u16, String)) -> String {
    assert!((400..500).contains(&status), "{status} {text}");
    text
}

/// An empty folder for one test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ferrocnc-{name}-{}", std::process::id()));
    let _none = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn board() -> FakeBoard {
    FakeBoard::mill6(Time::Lockstep(60_000))
}

#[test]
fn the_page_and_its_files_are_there_and_bring_nothing_from_elsewhere() {
    let ui = Ui::start(&[]);
    let page = ui.get("");
    assert_eq!(page.0, 200);
    assert!(page.1.contains("app.js"), "{}", page.1);
    for file in ["app.js", "style.css", "vendor/preact-htm.js"] {
        assert_eq!(ui.get(file).0, 200, "{file}");
    }
    let path = format!("/{}/", ui.token);
    let (_, head) = ui.send("GET", &path, &ui.host_line(), "");
    let head = head.to_lowercase();
    for line in [
        "default-src 'none'",
        "frame-ancestors 'none'",
        "no-referrer",
        "nosniff",
    ] {
        assert!(head.contains(line), "{line}: {head}");
    }
    for path in ["nothing.js", "api/nothing", "../Cargo.toml"] {
        assert_eq!(ui.get(path).0, 404, "{path}");
    }
}

#[test]
fn a_foreign_host_origin_or_token_is_refused() {
    let board = board();
    let ui = Ui::start(&[]);
    let asked = |headers: &str, path: &str| ui.asked("GET", path, headers, "").0;
    let before = board.look().datagrams;
    let path = format!("/{}/api/describe?board={}", ui.token, board.text());
    let apply = format!(
        "/{}/api/config/apply?board={}&name=mill6",
        ui.token,
        board.text()
    );
    let host = ui.host_line();
    let port = ui.host.rsplit(':').next().unwrap();
    // A name of the attacker's that leads to 127.0.0.1.
    assert_eq!(asked(&format!("Host: evil.example:{port}\r\n"), &path), 403);
    assert_eq!(asked("Host: 127.0.0.1\r\n", &path), 403);
    for origin in ["http://evil.example", "null", "http://127.0.0.1:1"] {
        let headers = format!("{host}Origin: {origin}\r\n");
        assert_eq!(asked(&headers, &path), 403, "{origin}");
        for path in [&path, &apply] {
            let (status, _) = ui.asked("POST", path, &headers, MILL6);
            assert_eq!(status, 403, "{origin}");
        }
    }
    let wrong = path.replace(&ui.token, &"0".repeat(ui.token.len()));
    for path in [wrong.as_str(), "/", "/api/discover", "/app.js"] {
        assert_eq!(asked(&host, path), 403, "{path}");
    }
    // Nothing of that reached the board.
    assert_eq!(board.look().datagrams, before);
    assert_eq!(asked(&host, &path), 200);
    assert_eq!(
        asked(&format!("{host}Origin: http://{}\r\n", ui.host), &path),
        200
    );
}

#[test]
fn an_answer_is_what_the_command_prints() {
    let board = board();
    let ui = Ui::start(&[&board.text()]);
    let printed = |arguments: &[&str]| -> Value {
        serde_json::from_str(&answer(&[&["--json"], arguments].concat())).unwrap()
    };
    let at = board.text();
    let described = good(ui.get(&format!("api/describe?board={at}")));
    assert_eq!(described, printed(&["describe", &at]));
    let findings = |report: &Value| -> Vec<Value> {
        let all = report["findings"].as_array().unwrap();
        all.iter().map(|it| it["check"].clone()).collect()
    };
    let report = good(ui.get(&format!("api/doctor?board={at}")));
    assert!(findings(&report).contains(&json!("exchanges")), "{report}");
    assert!(board.look().owner.is_none());
}

#[test]
fn a_board_file_is_made_checked_drawn_and_imported_as_by_the_commands() {
    let ui = Ui::start(&[]);
    let platforms = good(ui.get("api/platforms"));
    let all = platforms.as_array().unwrap();
    assert!(
        all.iter().any(|it| it["name"] == "5a-75b-8.0"),
        "{platforms}"
    );
    let wanted = json!({
        "name": "mine", "platform": "5a-75b-8.0", "stepgens": 3, "encoders": 1, "pwms": 1,
        "inputs": 2, "outputs": 2, "modified": ["j5"],
    });
    let made = good(ui.post("config/new", &wanted));
    let toml = made["toml"].as_str().unwrap();
    let text = json!({ "name": "mine", "toml": toml });
    assert_eq!(good(ui.post("config/check", &text))["ok"], true);
    let drawing = good(ui.post("config/pinout", &text));
    assert_eq!(drawing["headers"][0]["pins"].as_array().unwrap().len(), 16);

    let folder = folder("ui");
    let file = folder.join("mine.toml");
    std::fs::write(&file, toml).unwrap();
    let printed = answer(&["config", "pinout", file.to_str().unwrap(), "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&printed).unwrap(), drawing);
    let svg = folder.join("mine.svg");
    answer(&[
        "config",
        "pinout",
        file.to_str().unwrap(),
        "-o",
        svg.to_str().unwrap(),
    ]);
    let drawn = ui.post("config/svg", &text);
    assert_eq!(drawn, (200, std::fs::read_to_string(&svg).unwrap()));
    std::fs::remove_dir_all(&folder).unwrap();

    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/peers/");
    let mut imported = 0;
    for entry in std::fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        let from = match path.extension().and_then(|ending| ending.to_str()) {
            Some("ini") => "lcnc",
            Some("json") => "litexcnc",
            _ => continue,
        };
        let body = json!({
            "from": from, "file": path.file_name().unwrap().to_str(),
            "text": std::fs::read_to_string(&path).unwrap(),
        });
        let (status, said) = ui.post("config/import", &body);
        // A LinuxCNC machine's INI file is no conf.ini, and that is said.
        if status == 200 {
            let said: Value = serde_json::from_str(&said).unwrap();
            let verdict = good(ui.post(
                "config/check",
                &json!({
                    "name": said["name"], "toml": said["toml"],
                }),
            ));
            assert_eq!(verdict["ok"], true, "{verdict}");
            imported += 1;
        }
    }
    assert!(imported > 0);
}

#[test]
fn a_file_that_a_page_applies_is_in_force_and_is_read_back_byte_for_byte() {
    let board = FakeBoard::card();
    let (ui, at) = (Ui::start(&[]), board.text());
    // With what a text may lose on its way.
    let toml = format!("# Fräse\r\n\n{MILL6}\n# the end \n\n");
    let (told, end) = ui.applies(&at, &toml);
    for step in ["erasing", "writing", "restarting"] {
        let is_step = |line: &Value| line["step"] == step && line["part"].is_number();
        assert!(told.iter().any(is_step), "{step} is not in {told:?}");
    }
    assert_eq!(end["done"]["copy"], 0, "{end}");
    let said = end["text"].as_str().unwrap();
    let wanted = format!("{at} has the pins of mill6 on ");
    assert!(said.starts_with(&wanted), "{said}");
    assert_eq!(board.look().channels.stepgens, 6);
    let read = good(ui.get(&format!("api/config/read?board={at}")));
    assert_eq!(read["text"], toml);
    assert_eq!(
        (&read["in_force"], &read["note"]),
        (&json!(true), &Value::Null)
    );
    let printed = answer(&["config", "read", &at, "--json"]);
    assert_eq!(read, serde_json::from_str::<Value>(&printed).unwrap());

    // A file that is not in force is read, too, with the reason.
    board.look().pins.as_mut().unwrap().factory = true;
    board.look().power_cycle();
    let read = good(ui.get(&format!("api/config/read?board={at}")));
    assert_eq!(read["text"], toml);
    let note = read["note"].as_str().unwrap();
    assert!(note.contains("release the factory pin"), "{note}");
}

#[test]
fn what_the_commands_refuse_a_page_is_refused_in_their_words_and_nothing_is_changed() {
    let (card, fixed) = (FakeBoard::card(), board());
    let ui = Ui::start(&[]);
    let folder = folder("ui-refused");
    let file = folder.join("mill6.toml");
    // The page knows no folder.
    let in_folder = format!("{}/", folder.display());
    let sentence = |arguments: &[&str]| {
        let said = complaint(arguments).replace(&in_folder, "");
        let said = said.trim_end().trim_start_matches("ferrocnc: ");
        said.to_owned()
    };
    let refused_file = |board: &FakeBoard, toml: &str, part: &str| {
        std::fs::write(&file, toml).unwrap();
        let said = sentence(&["config", "apply", &board.text(), file.to_str().unwrap()]);
        assert!(said.contains(part), "{part} is not in {said}");
        let (told, end) = ui.applies(&board.text(), toml);
        assert_eq!(end, json!({ "error": said }));
        assert_eq!(told, [] as [Value; 0], "{part}");
    };
    let twice = MILL6.replacen("\"j1:1\"", "\"j1:0\"", 1);
    refused_file(&card, &twice, "j1:0");
    card.look().become_image(EIGHT, "5a-75b-7.0");
    refused_file(&card, MILL6, "is not the card's, which is 5a-75b-7.0");
    card.look().become_image(EIGHT, "5a-75b-8.0");
    card.look().state = State::Armed;
    refused_file(&card, MILL6, "the machine is armed");
    card.look().state = State::Disarmed;
    card.look().knobs.foreign_owner = Some("10.0.0.9:4000".parse().unwrap());
    refused_file(&card, MILL6, "driven by 10.0.0.9:4000");
    card.look().knobs.foreign_owner = None;
    refused_file(
        &fixed,
        MILL6,
        "the pins of this board are part of its image",
    );
    for (board, part) in [
        (&card, "no configuration of the pins"),
        (&fixed, "part of its image"),
    ] {
        let said = sentence(&["config", "read", &board.text()]);
        assert!(said.contains(part), "{part} is not in {said}");
        let read = refused(ui.get(&format!("api/config/read?board={}", board.text())));
        let read: Value = serde_json::from_str(&read).unwrap();
        assert_eq!(read, json!({ "error": said }));
        for op in [Op::EraseSector, Op::EraseBlock, Op::Program] {
            assert_eq!(board.look().flash.count(op), 0, "{op:?}");
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_page_applies_a_file_to_a_board_with_a_key_only_if_the_server_has_it() {
    let board = FakeBoard::card();
    let folder = folder("ui-key");
    let key = ferrocnc::keys::Key::random().unwrap();
    board.look().flash.settings.key = key.words();
    board.look().key = Some(key);
    let right = folder.join("right.key");
    ferrocnc::keys::write(&right, &key).unwrap();
    let (_, end) = Ui::start(&[]).applies(&board.text(), MILL6);
    let said = end["error"].as_str().unwrap_or_default();
    assert!(said.contains("key"), "{end}");
    assert_eq!(board.look().flash.count(Op::EraseSector), 0);
    let ui = Ui::start(&["--key", right.to_str().unwrap()]);
    let (_, end) = ui.applies(&board.text(), MILL6);
    assert_eq!(end["done"]["configuration"], "mill6", "{end}");
    assert_eq!(board.look().channels.stepgens, 6);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn what_is_wrong_gets_a_reason() {
    let ui = Ui::start(&[]);
    let wrong = good(ui.post(
        "config/check",
        &json!({ "name": "x", "toml": "name = \"x\"\nplatform = 3\n" }),
    ));
    assert_eq!(wrong["ok"], false);
    assert!(
        wrong["problem"].is_string() && wrong["line"] == 2,
        "{wrong}"
    );
    let said = refused(ui.post("config/pinout", &json!({ "name": "x", "toml": "[" })));
    assert!(said.contains("error"), "{said}");
    let said = refused(ui.post(
        "config/new",
        &json!({
            "name": "x", "platform": "none", "stepgens": 1, "encoders": 0, "pwms": 0, "inputs": 0,
            "outputs": 0, "modified": [],
        }),
    ));
    assert!(said.contains("5a-75b-8.0"), "{said}");
    let said = refused(ui.post(
        "config/import",
        &json!({
            "from": "litexcnc", "file": "a.json", "text": "{",
        }),
    ));
    assert!(said.contains("a.json"), "{said}");
    refused(ui.post("config/check", &json!({ "name": "x" })));
    refused(ui.post(
        "config/check",
        &json!({ "name": "x", "toml": "a".repeat(3 << 20) }),
    ));
    let said = refused(ui.get("api/describe?board=nowhere.invalid.:x"));
    assert!(said.contains("error"), "{said}");
    refused(ui.get("api/describe"));
    refused(ui.post("config/apply?board=127.0.0.1", &json!({})));
    refused(ui.get("api/config/read"));
    refused(ui.get("api/discover?wait=soon"));
}

#[test]
fn the_dashboard_says_a_fault_with_its_remedy_and_that_a_board_is_away_and_back() {
    let board = board();
    let ui = Ui::start(&[]);
    let path = format!("/{}/api/watch?board={}", ui.token, board.text());
    let (stream, head) = ui.send("GET", &path, &ui.host_line(), "");
    assert!(head.contains("text/event-stream"), "{head}");
    let mut lines = stream.lines().map(Result::unwrap);
    let mut next = |kind: &str, found: &dyn Fn(&Value) -> bool| loop {
        let line = lines.next().expect("the stream goes on");
        if line != format!("event: {kind}") {
            continue;
        }
        let data = lines.next().expect("data");
        let value: Value = serde_json::from_str(data.strip_prefix("data: ").unwrap()).unwrap();
        if found(&value) {
            break value;
        }
    };
    let look = next("line", &|_| true);
    assert_eq!(look["fault_remedy"], Value::Null);
    assert_eq!(look["owner"], Value::Null);
    board.look().knobs.unplugged = true;
    let away = next("away", &|_| true);
    assert!(away["error"].as_str().unwrap().contains("answer"), "{away}");
    board.look().knobs.unplugged = false;
    next("line", &|_| true);
    assert_eq!(board.look().exchanges, 0);
}

#[test]
fn an_address_or_port_that_cannot_be_is_refused_at_once() {
    let said = complaint(&["ui", "--no-open", "192.168.2.50:x"]);
    assert!(said.contains("192.168.2.50:x"), "{said}");
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let said = complaint(&["ui", "--no-open", "--port", &port]);
    assert!(said.contains(&port) && said.contains("--port"), "{said}");
}
