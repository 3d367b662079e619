"""The simulated board as a program beside this one, with its control channel."""

import signal
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
RELEASE = ROOT / "target/release/ferrocnc-sim"


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Simulator:
    """Runs from `with` to the end of it; `board` is where the board answers."""

    def __init__(self, program, soc, firmware, *options):
        self.board = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        self.port = free_port(socket.SOCK_STREAM)
        self.command = [
            *(program, "--soc", soc, "--firmware", firmware, "--silence-ms", "600000", "--udp", self.board),
            *("--console", f"127.0.0.1:{free_port(socket.SOCK_STREAM)}", "--control", f"127.0.0.1:{self.port}"),
            *options,
        ]

    def __enter__(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.PIPE, text=True)
        try:
            self._connect()
        except BaseException:
            self.process.kill()
            raise
        return self

    def _connect(self):
        self.ready = self.process.stdout.readline().strip()
        if not self.ready.startswith("ready"):
            sys.exit(f"the simulated board did not start: {self.ready or 'it said nothing'}")
        self.clock_hz = int(self.ready.split("sys_clk_hz=")[1].split()[0])
        self.control = socket.create_connection(("127.0.0.1", self.port)).makefile("rw")

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()

    def ask(self, command):
        """What the board's control channel answers, by name."""
        self.control.write(command + "\n")
        self.control.flush()
        answer = self.control.readline()
        if not answer.startswith("ok"):
            sys.exit(f"the simulated board does not {command}: {answer.strip() or 'it has ended'}")
        return dict(word.split("=", 1) for word in answer.split() if "=" in word)
