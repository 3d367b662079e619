//! What tcpdump sees of ARP on a segment.

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::Place;

/// tcpdump at a place; gone with this.
#[derive(Debug)]
pub struct Listener {
    process: Child,
    heard: PathBuf,
}

/// An ARP message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arp {
    /// MAC address of the frame's sender.
    pub from: String,
    /// MAC address the frame is for.
    pub to: String,
    /// What it says.
    pub says: Says,
}

/// A question or an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Says {
    /// Which MAC address has this IP address? Asked by the second one.
    WhereIs(String, String),
    /// This IP address is at this MAC address.
    IsAt(String, String),
}

impl Arp {
    /// A line of `tcpdump -n -e`.
    fn parse(line: &str) -> Option<Self> {
        let (head, message) = line.split_once(": ")?;
        let mut head = head.split([' ', ',']).skip(1).filter(|word| *word != ">");
        let [from, to] = [head.next()?, head.next()?].map(str::to_owned);
        let words: Vec<&str> = message.split([' ', ',']).collect();
        let word = |n: usize| words.get(n).map(|word| (*word).to_owned());
        let after = |what: &str| word(words.iter().position(|word| *word == what)? + 1);
        let says = match words.first().copied()? {
            "Request" => Says::WhereIs(word(2)?, after("tell")?),
            "Reply" => Says::IsAt(word(1)?, after("is-at")?),
            _ => return None,
        };
        Some(Arp { from, to, says })
    }
}

impl Listener {
    /// Listens at a place's `eth0` from now on. What it hears goes into a file in this folder.
    pub fn start(place: &Place, folder: &Path) -> Self {
        let heard = folder.join("arp.txt");
        let errors = folder.join("tcpdump.log");
        let file = |path: &Path| std::fs::File::create(path).expect("a file for what it says");
        let mut tcpdump = place.service("tcpdump");
        tcpdump
            .args(["-i", "eth0", "-n", "-e", "-l", "--immediate-mode"])
            .args(["-Z", "root", "arp"]);
        let process = tcpdump
            .stdin(Stdio::null())
            .stdout(file(&heard))
            .stderr(file(&errors))
            .spawn()
            .unwrap_or_else(|error| panic!("{tcpdump:?}: {error} (Debian's tcpdump)"));
        let listener = Listener { process, heard };
        let began = Instant::now();
        let says = || std::fs::read_to_string(&errors).unwrap_or_default();
        while !says().contains("listening on") {
            let waited = began.elapsed();
            assert!(waited < Duration::from_secs(60), "tcpdump: {}", says());
            std::thread::sleep(Duration::from_millis(10));
        }
        listener
    }

    /// All messages until now.
    pub fn heard(&self) -> Vec<Arp> {
        let text = std::fs::read_to_string(&self.heard).unwrap_or_default();
        // The last line may not be whole yet.
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
        whole
            .lines()
            .map(|line| Arp::parse(line).unwrap_or_else(|| panic!("{line:?}")))
            .collect()
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
