//! A simulated board: a process of `ferrocnc-sim` with the models of the cores.

use anyhow::{Context, Result, bail};
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

/// It is killed when dropped.
pub struct Simulated {
    child: Child,
    /// Its UDP port at 127.0.0.1.
    pub port: u16,
}

impl Simulated {
    /// Starts this simulator, with these arguments, on free ports, and waits until it answers.
    pub fn start(mut simulator: Command, arguments: &[&str]) -> Result<Self> {
        let port = UdpSocket::bind("127.0.0.1:0")?.local_addr()?.port();
        let mut child = simulator
            .args(["--backend", "model", "--udp", &format!("127.0.0.1:{port}")])
            .args(["--console", "127.0.0.1:0"])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .context("cannot start the simulated board")?;
        let out = child.stdout.take();
        let board = Simulated { child, port };
        let mut ready = String::new();
        BufReader::new(out.context("no output of the simulated board")?).read_line(&mut ready)?;
        match ready.starts_with("ready") {
            true => Ok(board),
            false => bail!("the simulated board said {ready:?}"),
        }
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        // Already gone is gone.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
