#!/usr/bin/env python3
"""LinuxCNC against the simulated board, in lockstep: starts both, waits for the program's end,
keeps what they recorded.

    run.py SOC FIRMWARE.elf OUT [--program FILE.ngc] [--simulator FILE]

Leaves in OUT: samples.csv (every servo period as LinuxCNC saw it), edges.bin (every step at the
pins), sim.json (the simulator's report), result.json and the logs. Uses only the standard library;
needs the driver installed.
"""

import argparse
import signal
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def watch(mill, samples):
    """Says every two seconds how far the machine's time has come; the mill's exit code."""
    while True:
        try:
            return mill.wait(2)
        except subprocess.TimeoutExpired:
            done = samples.read_text(errors="replace").count("\n") if samples.exists() else 0
            print(f"servo period {done}, about 1850 in all", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("soc")
    parser.add_argument("firmware")
    parser.add_argument("out", type=Path)
    parser.add_argument("--program", help="G-code file; the mill's own short one when not given")
    parser.add_argument("--simulator", type=Path, default=ROOT / "target/release/ferrocnc-sim")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "samples.raw").unlink(missing_ok=True)

    board = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    simulator = subprocess.Popen(
        [
            options.simulator,
            *("--soc", options.soc, "--firmware", options.firmware, "--mode", "lockstep", "--silence-ms", "600000"),
            *("--udp", board, "--console", f"127.0.0.1:{free_port(socket.SOCK_STREAM)}"),
            *("--report", options.out / "sim.json", "--edges", options.out / "edges.bin"),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        ready = simulator.stdout.readline()
        if not ready.startswith("ready"):
            sys.exit(f"the simulated board did not start: {ready.strip() or 'it said nothing'}")
        print(ready.strip(), flush=True)
        mill = [sys.executable, ROOT / "host/examples/mill/run.py", "--board", board, "--out", options.out, "--lockstep"]
        if options.program:
            mill += ["--program", options.program]
        code = watch(subprocess.Popen(mill), options.out / "samples.raw")
    finally:
        simulator.send_signal(signal.SIGTERM)
        try:
            simulator.wait(60)
        except subprocess.TimeoutExpired:
            simulator.kill()
    return code


if __name__ == "__main__":
    sys.exit(main())
