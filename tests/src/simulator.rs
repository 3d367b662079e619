//! Starts the simulator as a separate program.

use crate::{flash, lan, parts, program, root};

/// The simulator as a separate program with real sockets; it ends with the test.
pub struct Simulator {
    child: std::process::Child,
    udp: std::net::SocketAddr,
    console: Option<std::net::SocketAddr>,
    control: Option<std::net::SocketAddr>,
}

/// A line for the control channel of a simulator that is there; the answer.
pub fn control(at: std::net::SocketAddr, command: &str) -> String {
    use std::io::{BufRead as _, Write as _};
    let stream = std::net::TcpStream::connect(at).expect("the simulator listens");
    let mut stream = std::io::BufReader::new(stream);
    let told = writeln!(stream.get_mut(), "{command}");
    told.expect("the simulator listens");
    let mut answer = String::new();
    stream.read_line(&mut answer).expect("it answers");
    assert!(answer.starts_with("ok"), "{command}: {answer}");
    answer
}

impl Simulator {
    /// The RTL board on free ports, with these further arguments; waits until it answers.
    pub fn start(arguments: &[&str]) -> Self {
        let (soc, firmware) = parts();
        let (soc, firmware) = (soc.display().to_string(), firmware.display().to_string());
        let board = ["--soc", &soc, "--firmware", &firmware];
        Self::spawn(&[&board, arguments].concat())
    }

    /// The twin of the same board: the firmware's library on models of the cores.
    pub fn twin(arguments: &[&str]) -> Self {
        Self::twin_of("mill6", arguments)
    }

    /// The twin of another one.
    pub fn twin_of(board: &str, arguments: &[&str]) -> Self {
        let board = ["--backend", "model", "--board", board];
        Self::spawn(&[&board, arguments].concat())
    }

    fn spawn(arguments: &[&str]) -> Self {
        let udp = std::net::UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
        let udp = udp.expect("a free UDP port");
        let tcp = || std::net::TcpListener::bind("127.0.0.1:0").and_then(|it| it.local_addr());
        let [console, control] = [tcp(), tcp()].map(|at| at.expect("a free TCP port"));
        let mut command = std::process::Command::new(program("ferrocnc-sim"));
        command
            .args(["--udp", &udp.to_string(), "--console", &console.to_string()])
            .args(["--control", &control.to_string()])
            // A host that waits for its processor must not count as dead.
            .args(["--silence-ms", "600000"])
            .args(arguments);
        Self::run(command, udp, Some(control))
    }

    /// A twin that is a place's `eth0`, with this flash and unique id.
    pub fn at(place: &lan::Place, flash: &std::path::Path, uid: u64) -> Self {
        let mut command = place.command(program("ferrocnc-sim"));
        command
            .args(["--backend", "model", "--board", flash::CONFIGURATION])
            .args(["--mode", "free"])
            .args(["--udp", "0.0.0.0:1234", "--discovery", "0.0.0.0:51234"])
            .args(["--console", "0.0.0.0:23", "--interface", "eth0"])
            .args(["--uid", &format!("{uid:016x}"), "--flash"])
            .arg(flash);
        let udp = std::net::SocketAddr::from(([0, 0, 0, 0], 1234));
        Self::run(command, udp, None)
    }

    /// A twin of this board whose cable ends in this segment, with a flash of its own and these
    /// further arguments: its IP stack is the board's.
    pub fn on_cable(lan: &mut lan::Lan, board: &str, arguments: &[&str]) -> Self {
        let (tap, mut command) = lan.tap(program("ferrocnc-sim"));
        command
            .args(["--backend", "model", "--board", board, "--tap", &tap])
            .args(arguments);
        Self::run(command, ([0, 0, 0, 0], 1234).into(), None)
    }

    /// The Verilated board at the end of such a cable, with what is in this flash.
    pub fn rtl_on_cable(lan: &mut lan::Lan, flash: &std::path::Path) -> Self {
        let (soc, firmware) = parts();
        let (tap, mut command) = lan.tap(program("ferrocnc-sim"));
        command
            .arg("--soc")
            .arg(soc)
            .arg("--firmware")
            .arg(firmware);
        command.args(["--tap", &tap, "--flash"]).arg(flash);
        Self::run(command, ([0, 0, 0, 0], 1234).into(), None)
    }

    fn run(
        mut command: std::process::Command,
        udp: std::net::SocketAddr,
        control: Option<std::net::SocketAddr>,
    ) -> Self {
        use std::io::BufRead;
        let mut child = command
            .stdout(std::process::Stdio::piped())
            .stdin(std::process::Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let stdout = child.stdout.take().expect("its output is piped");
        let mut ready = String::new();
        std::io::BufReader::new(stdout)
            .read_line(&mut ready)
            .expect("its first line");
        assert!(
            ready.contains("ready"),
            "the simulator said {ready:?} instead of being ready"
        );
        let console = { ready.split_whitespace() }.find_map(|word| word.strip_prefix("console="));
        Simulator {
            child,
            udp,
            console: console.and_then(|at| at.parse().ok()),
            control,
        }
    }

    /// Kills it at any point, like a loss of power.
    pub fn pull_the_plug(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Ends it as SIGTERM does, so that it writes its report, and waits until it has.
    pub fn finish(&mut self) {
        let _ = std::process::Command::new("kill")
            .arg(self.child.id().to_string())
            .status();
        let _ = self.child.wait();
    }

    /// LinuxCNC with the example mill on this board, in lockstep; what it says goes to `run.log` in
    /// the run's folder.
    pub fn linuxcnc(&self, out: &std::path::Path) -> std::process::Command {
        let log = std::fs::File::create(out.join("run.log")).expect("a log");
        let mut run = std::process::Command::new("python3");
        run.arg(root().join("host/examples/mill/run.py"))
            .args(["--board", &self.udp().to_string(), "--lockstep", "--out"])
            .arg(out)
            .stdin(std::process::Stdio::null())
            .stdout(log.try_clone().expect("its log"))
            .stderr(log);
        run
    }

    /// Where its board listens for datagrams.
    pub fn udp(&self) -> std::net::SocketAddr {
        self.udp
    }

    /// Where its consoles are.
    pub fn console(&self) -> std::net::SocketAddr {
        self.console.expect("it says where they are")
    }

    /// Where its control channel is.
    pub fn control(&self) -> std::net::SocketAddr {
        self.control.expect("no place of a network has one")
    }

    /// A field of what the control answers.
    pub fn told(&self, command: &str, name: &str) -> String {
        let said = control(self.control(), command);
        let begins = format!("{name}=");
        let word = said
            .split_whitespace()
            .find_map(|word| word.strip_prefix(&*begins));
        word.unwrap_or_else(|| panic!("no {name} in {said}"))
            .to_owned()
    }

    /// Pulses at the pins of the first motor.
    pub fn steps(&self) -> i64 {
        let counts = self.told("counts", "counts");
        let first = counts.split(',').next();
        first.and_then(|n| n.parse().ok()).expect("a count")
    }

    /// The outputs are live.
    pub fn is_open(&self) -> bool {
        self.told("pins", "gate") == "1"
    }

    /// So many milliseconds of the board's time pass without a host.
    pub fn run_ms(&self, millis: u64) {
        control(self.control(), &format!("run-ms {millis}"));
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
