//! A real DHCP server on a segment.

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use super::Place;

/// dnsmasq at a place; gone with this.
#[derive(Debug)]
pub struct DhcpServer {
    process: Child,
    said: PathBuf,
}

impl DhcpServer {
    /// Gives out 10.7.0.50 to 10.7.0.59 for so long (dnsmasq's words: `2m`, its shortest). What it
    /// says goes into a file in this folder.
    pub fn start(place: &Place, folder: &Path, lease: &str) -> Self {
        Self::with(place, folder, lease, &[])
    }

    /// The same, but a client renews its lease after two seconds, dnsmasq's shortest time.
    pub fn that_is_asked_often(place: &Place, folder: &Path, lease: &str) -> Self {
        Self::with(place, folder, lease, &["--dhcp-option=option:T2,3"])
    }

    fn with(place: &Place, folder: &Path, lease: &str, arguments: &[&str]) -> Self {
        let said = folder.join("dnsmasq.log");
        let mut dnsmasq = place.service("dnsmasq");
        dnsmasq
            .args(["--keep-in-foreground", "--conf-file=/dev/null", "--port=0"])
            .args(["--user=", "--group=", "--pid-file=", "--leasefile-ro"])
            .arg("--interface=eth0")
            .arg(format!("--dhcp-range=10.7.0.50,10.7.0.59,{lease}"))
            .arg("--dhcp-script=/bin/true")
            .arg("--log-facility=-")
            .arg("--log-dhcp")
            .args(arguments);
        let log = std::fs::File::create(&said).expect("a file for what it says");
        let process = dnsmasq
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap_or_else(|error| panic!("{dnsmasq:?}: {error} (Debian's dnsmasq-base)"));
        DhcpServer { process, said }
    }

    /// What it has said.
    pub fn said(&self) -> String {
        std::fs::read_to_string(&self.said).unwrap_or_default()
    }
}

impl Drop for DhcpServer {
    fn drop(&mut self) {
        // Killing `nsenter` kills the server: it became it.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
