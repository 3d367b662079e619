#!/usr/bin/env python3
"""LinuxCNC against the simulated board, in lockstep: starts both, waits for the program's end,
keeps what they recorded.

    run.py SOC FIRMWARE.elf OUT [--program FILE.ngc] [--simulator FILE]
           [--card FILE.toml --tool FERROCNC]

With --card the board is an empty card that is given this board file over the simulated wire first,
by `ferrocnc config apply`; its flash and card.json are in OUT, too.

Leaves in OUT: samples.csv (every servo period as LinuxCNC saw it), edges.bin (every step at the
pins), sim.json (the simulator's report), result.json and the logs. Uses only the standard library;
needs the driver installed.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from card import apply
from simulator import RELEASE, ROOT, Simulator

SERVO_PERIOD_NS = 1_000_000


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
    parser.add_argument("--simulator", type=Path, default=RELEASE)
    parser.add_argument("--card", type=Path, help="SOC is an image whose pins are configured: give an empty card this board file first")
    parser.add_argument("--tool", type=Path, help="the tool ferrocnc, for --card")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for old in ("samples.raw", "card.json"):
        (options.out / old).unlink(missing_ok=True)

    records = ("--report", options.out / "sim.json", "--edges", options.out / "edges.bin")
    card = ("--mode", "lockstep")
    if options.card:
        flash = options.out / "card.flash"
        flash.unlink(missing_ok=True)
        card = ("--mode", "free", "--flash", flash, "--wired", options.card)
    with Simulator(options.simulator, options.soc, options.firmware, *records, *card) as simulator:
        print(simulator.ready, flush=True)
        if options.card:
            told = apply(simulator, options.tool, options.card)
            if told["lines_before"]:
                sys.exit(f"an empty card drove {told['lines_before']} lines")
            (options.out / "card.json").write_text(json.dumps(told, indent=2) + "\n")
            print(f"{told['file']} is in force after {told['driven_s']:.3f} s of board time", flush=True)
            simulator.ask(f"mode lockstep {SERVO_PERIOD_NS}")
        mill = [sys.executable, ROOT / "host/examples/mill/run.py", "--board", simulator.board, "--out", options.out, "--lockstep"]
        if options.program:
            mill += ["--program", options.program]
        code = watch(subprocess.Popen(mill), options.out / "samples.raw")
    return code


if __name__ == "__main__":
    sys.exit(main())
