//! `ferrocnc machine` in a folder of its own: what it asks, writes and leaves alone.

use std::fs;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("machine-{name}"));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("a folder");
        Folder(folder)
    }

    /// A folder with the mill of the samples.
    fn with_mill(name: &str) -> Self {
        let folder = Folder::new(name);
        folder.does("machine new --from mill");
        folder
    }

    /// Runs the tool with these words, and answers what it asks.
    fn run(&self, words: &str, answers: &str) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
        command.current_dir(&self.0).args(words.split_whitespace());
        let pipes = [Stdio::piped(), Stdio::piped(), Stdio::piped()];
        let [input, output, errors] = pipes;
        let child = command.stdin(input).stdout(output).stderr(errors).spawn();
        let mut child = child.expect("the tool starts");
        let mut input = child.stdin.take().expect("its input");
        // It may have ended before it was asked.
        let _ = input.write_all(answers.as_bytes());
        drop(input);
        child.wait_with_output().expect("it ends")
    }

    /// Runs it and wants success; what it has said.
    fn does(&self, words: &str) -> String {
        let done = self.run(words, "");
        let said = String::from_utf8_lossy(&done.stdout).into_owned();
        let errors = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{words}: {said}{errors}");
        said
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.0.join(name)).unwrap_or_default()
    }

    fn names(&self) -> Vec<String> {
        let files = fs::read_dir(&self.0).expect("the folder");
        let name = |file: fs::DirEntry| file.file_name().to_string_lossy().into_owned();
        let mut names: Vec<String> = files.flatten().map(name).collect();
        names.sort();
        names
    }
}

#[test]
fn nothing_is_written_before_the_answer_is_yes() {
    let folder = Folder::with_mill("asks");
    let asked = folder.run("machine write", "no\n");
    let said = String::from_utf8_lossy(&asked.stdout);
    assert!(
        asked.status.success() && said.contains("+++ mill.ini"),
        "{said}"
    );
    assert_eq!(folder.names(), ["machine.toml"]);

    assert!(folder.run("machine write", "yes\n").status.success());

    let files = [
        "custom.hal",
        "custom_postgui.hal",
        "ferrocnc.hal",
        "machine.toml",
        "mill-wiring.md",
        "mill.ini",
        "mill.svg",
        "mill.toml",
        "tool.tbl",
    ];
    assert_eq!(folder.names(), files);
    assert_eq!(folder.does("machine write"), "nothing changes\n");
}

#[test]
fn it_is_written_though_nothing_reads_what_is_said() {
    let folder = Folder::with_mill("deaf");
    let mut command = Command::new(env!("CARGO_BIN_EXE_ferrocnc"));
    command
        .current_dir(&folder.0)
        .args(["machine", "write", "--yes"]);
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let done = command.stdout(writer).status().expect("the tool starts");
    assert!(
        done.success() && folder.names().len() == 9,
        "{:?}",
        folder.names()
    );
}

#[test]
fn the_board_file_it_writes_can_be_built() {
    let folder = Folder::with_mill("board");
    folder.does("machine write --yes");
    let said = folder.does("config check mill.toml");
    assert!(said.contains("mill.toml: ok"), "{said}");
}

#[test]
fn the_difference_is_shown_and_your_files_are_left_alone() {
    let folder = Folder::with_mill("keeps");
    folder.does("machine write --yes");
    fs::write(folder.0.join("custom.hal"), "# mine\n").expect("a file");
    let text = folder
        .read("machine.toml")
        .replacen("speed = 50", "speed = 40", 1);
    fs::write(folder.0.join("machine.toml"), text).expect("a file");

    let said = folder.does("machine write --yes");

    assert!(
        said.contains("-MAX_VELOCITY = 50\n+MAX_VELOCITY = 40\n"),
        "{said}"
    );
    assert_eq!(folder.read("custom.hal"), "# mine\n");
    assert!(folder.read("mill.ini").contains("MAX_VELOCITY = 40\n"));
}

#[test]
fn every_finding_is_said_and_the_exit_code_tells() {
    let folder = Folder::with_mill("findings");
    let text = folder
        .read("machine.toml")
        .replace("speed = 50", "speed = 5000");
    fs::write(folder.0.join("machine.toml"), text).expect("a file");
    let done = folder.run("machine check", "");
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(!done.status.success());
    assert!(
        said.contains("axis[0].speed") && said.contains("axis[1].speed"),
        "{said}"
    );
    let done = folder.run("--json machine check", "");
    let told: serde_json::Value = serde_json::from_slice(&done.stdout).expect("JSON");
    assert_eq!(told["findings"][0]["key"], "axis[0].speed");
    assert_eq!(told["ok"], false);
    let done = folder.run("machine write --yes", "");
    assert!(!done.status.success());
    assert_eq!(folder.names(), ["machine.toml"]);
}

#[test]
fn json_does_not_ask_and_says_what_it_wrote() {
    let folder = Folder::with_mill("json");
    assert!(!folder.run("--json machine write", "yes\n").status.success());
    let said = folder.does("--json machine write --yes");
    let told: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(
        (&told["written"], &told["ok"]),
        (&true.into(), &true.into())
    );
    assert_eq!(told["files"].as_array().map(Vec::len), Some(8));
}

#[test]
fn a_machine_that_is_there_is_not_overwritten() {
    let folder = Folder::with_mill("force");
    let done = folder.run("machine new --from lathe", "");
    assert!(!done.status.success() && folder.read("machine.toml").contains("name = \"mill\""));
    folder.does("machine new --from lathe --force --name small --address 10.0.0.9");
    let text = folder.read("machine.toml");
    assert!(text.contains("name = \"small\"") && text.contains("address = \"10.0.0.9\""));
}

#[test]
fn a_new_machine_is_made_of_answers() {
    let folder = Folder::new("answers");
    let answers = format!("router\nwood\n\ngmoccapy\n{}", "\n".repeat(80));
    let done = folder.run("machine new", &answers);
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let text = folder.read("machine.toml");
    assert!(
        text.contains("name = \"wood\"") && text.contains("gui = \"gmoccapy\""),
        "{text}"
    );
    folder.does("machine write --yes");
    assert!(folder.read("wood.ini").contains("DISPLAY = gmoccapy\n"));
}
