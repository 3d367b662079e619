//! An Ethernet segment of this machine's kernel, made for one test: network namespaces on a bridge.
//!
//! ```text
//!   Lan            a namespace with nothing but a bridge
//!    |-- Place     "host":    eth0, where `ferrocnc` runs
//!    |-- Place     "board 0": eth0, where a twin with --interface eth0 runs
//!    |-- tap1      the cable of a board whose network is frames: --tap tap1
//!    `-- ...
//! ```
//!
//! It has no name outside the processes that hold it, so it ends with the test, even after a crash;
//! the machine's own network is never touched. It needs root, or a kernel that lets users make user
//! namespaces; where neither is given the test fails and says so.

pub mod arp;
pub mod avahi;
pub mod dhcp;

use std::process::{Child, Command, Stdio};

/// Part of every error message of this module.
const NEEDS: &str = "this test makes network namespaces (Debian's iproute2 and util-linux): run it as root, \
                     or on a kernel that allows user namespaces";

/// What `ferrocnc` says of a board that is silent: the same command again does no harm. It gives up
/// after seconds of this computer, in which a simulated board may not have run at all.
pub const SILENT: [&str; 4] = [
    "no answer from",
    "does not answer",
    "has not answered",
    "is not an IPv4 address or a known host name",
];

/// A namespace, held by a process that does nothing.
#[derive(Debug)]
pub struct Place {
    holder: Child,
    users: bool,
}

impl Place {
    /// A process that `unshare` puts into a new network namespace.
    fn hold(mut unshare: Command, users: bool) -> Self {
        // `cat` ends with its input, so it ends with this process, even after a crash.
        unshare
            .arg("cat")
            .stdin(Stdio::piped())
            .stdout(Stdio::null());
        let holder = unshare
            .spawn()
            .unwrap_or_else(|error| panic!("{unshare:?}: {error}; {NEEDS}"));
        let place = Place { holder, users };
        let namespace = |pid| std::fs::read_link(format!("/proc/{pid}/ns/net")).ok();
        let ours = namespace(std::process::id());
        let parent = |pid: u32| namespace(pid).is_some_and(|it| Some(it) != ours);
        // A millisecond usually; ten seconds are a machine that will not do it.
        for _ in 0..2_000 {
            if parent(place.holder.id()) && place.runs_cat() {
                return place;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        panic!("no network namespace came up; {NEEDS}");
    }

    /// `unshare` and `nsenter` have done their work and become `cat`.
    fn runs_cat(&self) -> bool {
        let name = std::fs::read_to_string(format!("/proc/{}/comm", self.holder.id()));
        name.is_ok_and(|name| name.trim() == "cat")
    }

    /// A command that will run here.
    pub fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--target", &self.holder.id().to_string(), "--net"]);
        if self.users {
            command.args(["--user", "--preserve-credentials"]);
        }
        command.arg("--").arg(program);
        command
    }

    /// A command that will run here, and ends when the thread that starts it does, even after a
    /// crash of this process.
    pub fn service(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = self.command("setpriv");
        command.args(["--pdeathsig", "KILL", "--"]).arg(program);
        command
    }

    /// Runs `ip` here.
    pub fn ip(&self, arguments: &str) {
        let mut ip = self.command("ip");
        ip.args(arguments.split(' '));
        let said = ip
            .output()
            .unwrap_or_else(|error| panic!("{ip:?}: {error}; {NEEDS}"));
        let why = String::from_utf8_lossy(&said.stderr);
        assert!(said.status.success(), "{ip:?}: {why}{NEEDS}");
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = self.holder.kill();
        let _ = self.holder.wait();
    }
}

/// A bridge that places are plugged into.
#[derive(Debug)]
pub struct Lan {
    bridge: Place,
    plugged: u32,
}

impl Default for Lan {
    fn default() -> Self {
        Self::new()
    }
}

impl Lan {
    /// A segment without hosts.
    pub fn new() -> Self {
        let user = Command::new("id").arg("-u").output();
        let users = user.is_ok_and(|user| !user.stdout.starts_with(b"0"));
        let mut unshare = Command::new("unshare");
        if users {
            unshare.arg("--map-root-user");
        }
        unshare.arg("--net");
        let bridge = Place::hold(unshare, users);
        bridge.ip("link add br0 type bridge");
        bridge.ip("link set br0 up");
        Lan { bridge, plugged: 0 }
    }

    /// A new TAP interface on it, and a command that runs this program where it is: in the place of
    /// the bridge, which has no address.
    pub fn tap(&mut self, program: impl AsRef<std::ffi::OsStr>) -> (String, Command) {
        let name = format!("tap{}", self.plugged);
        self.plugged += 1;
        self.bridge.ip(&format!("tuntap add dev {name} mode tap"));
        self.bridge.ip(&format!("link set {name} master br0 up"));
        (name, self.bridge.service(program))
    }

    /// A new place on it. Its `eth0` is up and has this address, or none.
    pub fn plug(&mut self, address: Option<&str>) -> Place {
        let mut unshare = self.bridge.command("unshare");
        unshare.arg("--net");
        let place = Place::hold(unshare, self.bridge.users);
        let (port, pid) = (self.plugged, place.holder.id());
        self.plugged += 1;
        self.bridge.ip(&format!(
            "link add port{port} type veth peer name eth0 netns {pid}"
        ));
        self.bridge
            .ip(&format!("link set port{port} master br0 up"));
        place.ip("link set lo up");
        if let Some(address) = address {
            place.ip(&format!("address add {address} dev eth0"));
        }
        place.ip("link set eth0 up");
        place
    }
}
