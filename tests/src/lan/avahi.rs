//! avahi at a place: a real resolver of names, with a bus and files of its own.
//!
//! The daemon keeps its socket and its process id in `/run`, and its clients look for the system's
//! bus: here `/run` is empty, and the bus is one of this test's. So an avahi of this machine is
//! neither asked nor disturbed.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use super::Place;

const BUS: &str = r#"<!DOCTYPE busconfig PUBLIC "-//freedesktop//DTD D-Bus Bus Configuration 1.0//EN"
 "http://www.freedesktop.org/standards/dbus/1.0/busconfig.dtd">
<busconfig>
  <type>system</type>
  <listen>unix:path=FOLDER/bus</listen>
  <auth>EXTERNAL</auth>
  <policy context="default">
    <allow user="*"/><allow own="*"/><allow send_destination="*"/><allow eavesdrop="true"/>
  </policy>
</busconfig>
"#;
const DAEMON: &str = "[server]\nhost-name=client\nuse-ipv6=no\nallow-interfaces=eth0\n\
                      [publish]\ndisable-publishing=yes\n";
/// In its own mount and process namespaces: all of it ends with the first process.
const START: &str = "mount -t tmpfs none /run && mkdir /run/avahi-daemon \
    && { dbus-daemon --nofork --nopidfile --config-file=\"$1/bus.conf\" & } \
    && while [ ! -S \"$1/bus\" ]; do sleep 0.05; done \
    && exec avahi-daemon --no-drop-root --no-chroot --no-rlimits --file=\"$1/avahi.conf\"";

/// The daemon; gone with this.
#[derive(Debug)]
pub struct Avahi {
    process: Child,
    folder: PathBuf,
}

impl Avahi {
    /// Starts it at a place that has an address.
    pub fn start(place: &Place, folder: &Path) -> Self {
        let write = |name: &str, text: &str| {
            let text = text.replace("FOLDER", &folder.display().to_string());
            std::fs::write(folder.join(name), text).expect("a file");
        };
        write("bus.conf", BUS);
        write("avahi.conf", DAEMON);
        let log = std::fs::File::create(folder.join("avahi.log")).expect("a log");
        let mut start = place.service("unshare");
        start
            .args(["--mount", "--pid", "--fork", "--kill-child", "--"])
            .args(["sh", "-c", START, "sh"])
            .arg(folder);
        let process = start
            .env("DBUS_SYSTEM_BUS_ADDRESS", bus(folder))
            .stdin(Stdio::null())
            .stdout(log.try_clone().expect("a log"))
            .stderr(log)
            .spawn()
            .unwrap_or_else(|error| panic!("{start:?}: {error}"));
        Avahi {
            process,
            folder: folder.into(),
        }
    }

    /// One of its clients, `avahi-resolve` or `avahi-browse`, at the same place.
    pub fn ask(&self, place: &Place, client: &str, arguments: &[&str]) -> Output {
        let mut ask: Command = place.command(client);
        ask.args(arguments)
            .env("DBUS_SYSTEM_BUS_ADDRESS", bus(&self.folder))
            .stdin(Stdio::null())
            .output()
            .unwrap_or_else(|error| panic!("{client}: {error} (Debian's avahi-utils)"))
    }

    /// What the daemon has said.
    pub fn said(&self) -> String {
        std::fs::read_to_string(self.folder.join("avahi.log")).unwrap_or_default()
    }
}

fn bus(folder: &Path) -> String {
    format!("unix:path={}/bus", folder.display())
}

impl Drop for Avahi {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
