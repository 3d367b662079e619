//! A board on a segment, and the host beside it.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use ferrocnc_tests::bench::{Bench, Went};
use ferrocnc_tests::flash::UID;
use ferrocnc_tests::lan::Place;
use sim::nor::Nor;
use wire::Name;
use wire::settings::{Settings, mac_of_uid};

/// A client of a board waits so long on a busy computer.
pub const SLOWEST: Duration = Duration::from_secs(600);

/// A folder of this test's own, empty; gone with this.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let folder = format!("ferrocnc-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        Folder(folder)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// This flash in a file, for a board with this name that asks a DHCP server or does not.
pub fn flash_file(folder: &Folder, nor: Nor, name: &str, dhcp: bool) -> PathBuf {
    let mut bench = Bench::new(nor);
    let settings = Settings {
        name: Name::new(name).expect("a name"),
        dhcp,
        ..Settings::BUILT_IN
    };
    assert_eq!(bench.save(&settings), Went::OK);
    let path = folder.path().join("board.flash");
    bench.nor().leave_in(&path).expect("two files");
    path
}

/// The MAC address of a board with [`UID`].
pub fn mac() -> String {
    host::uid::mac_text(mac_of_uid([(UID >> 32) as u32, UID as u32]))
}

/// [`UID`] as the tool writes it.
pub fn uid_text() -> String {
    host::uid::uid_text([(UID >> 32) as u32, UID as u32])
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs a client to its end.
pub fn run(mut command: Command) -> Output {
    let said = command.stdin(Stdio::null()).output();
    said.unwrap_or_else(|error| panic!("{command:?}: {error}"))
}

/// Asks again until there is an answer.
pub fn until<T>(what: &str, mut ask: impl FnMut() -> Result<T, String>) -> T {
    let began = Instant::now();
    loop {
        match ask() {
            Ok(answer) => return answer,
            Err(why) => assert!(began.elapsed() < SLOWEST, "{what}: {why}"),
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// An answer over HTTP: status, head, content.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub content: String,
}

/// What curl hears from this address; an error is curl's.
pub fn curl(host: &Place, url: &str, arguments: &[&str]) -> Result<Answer, String> {
    let mut curl = host.command("curl");
    curl.args(["--silent", "--show-error", "--include", "--max-time", "120"]);
    // A board whose services are being loaded does not answer; this computer would ask again after
    // 1, 2, 4, .. 64 s.
    curl.args(["--connect-timeout", "5"]);
    curl.args(arguments).arg(url);
    let said = run(curl);
    if !said.status.success() {
        return Err(text(&said.stderr));
    }
    let said = text(&said.stdout);
    let (head, content) = said.split_once("\r\n\r\n").ok_or("no head")?;
    let status = head.split(' ').nth(1).and_then(|code| code.parse().ok());
    Ok(Answer {
        status: status.ok_or_else(|| head.to_owned())?,
        head: head.to_owned(),
        content: content.to_owned(),
    })
}

/// A host that keeps a board armed; it ends with this.
pub struct Owner(Child);

impl Owner {
    /// Exchanges with the board so many milliseconds apart, of this computer's.
    pub fn arm(host: &Place, board: &str, period_ms: u64) -> Self {
        let mut owner = host.service(env!("CARGO_BIN_EXE_hold-armed"));
        owner
            .arg(format!("{board}:1234"))
            .arg(period_ms.to_string());
        let mut process = owner
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{owner:?}: {error}"));
        let mut line = String::new();
        let said = process.stdout.as_mut().expect("it is piped");
        BufReader::new(said).read_line(&mut line).expect("a line");
        assert_eq!(line, "armed\n");
        Owner(process)
    }

    /// It ends its exchanges; it was armed all the time.
    pub fn ends(mut self) {
        drop(self.0.stdin.take());
        let mut said = String::new();
        let out = self.0.stdout.as_mut().expect("it is piped");
        out.read_to_string(&mut said).expect("its last words");
        assert_eq!(said, "still armed\n");
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
