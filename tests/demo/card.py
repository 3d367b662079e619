#!/usr/bin/env python3
"""A card whose pins are configured gets another board file, and its pins are checked at the pads.

    card.py SOC FIRMWARE.elf OUT FILE.toml --tool FERROCNC [--wired FILE.toml] [--json REPORT.json]

The card is the flash that run.py left in OUT. It is wired as FILE.toml says, or as --wired says,
which must then fail. `ferrocnc config apply` gives it the file over the simulated wire; the driver
in LinuxCNC's HAL arms it and moves each function alone; the simulator says what its pads do. Needs
the driver installed, and nothing else of LinuxCNC running.
"""

import argparse
import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

from simulator import RELEASE, ROOT, Simulator

# A pin's place among the lines of its header; 3 is ground. The shared lines come last.
OWN = (0, 1, 2, 4, 5, 6)
SHARED = 7
HEADERS = 8
# What the tables of a board file call the pins that the board drives.
DRIVEN = {"stepgen": ("step", "dir", "step_n", "dir_n"), "pwm": ("pin", "dir"), "gpio_out": ("pin",)}
# By the chip's data sheet, as it is simulated: bytes, and how long it is busy with them.
SECTOR, ERASE_S = 4096, 45e-3
PAGE, PROGRAM_S = 256, 0.4e-3
# Exchanges until what was ordered is at the pads and what is there has been reported.
EXCHANGES = 3
STEPS_PER_S = 20_000
# Board time that `config apply` may take until its file drives the lines.
APPLIED_S = 3.0
# Of this computer's time, for one exchange.
PATIENCE_S = 120
# Shorter than LinuxCNC's: each is simulated.
PERIOD_NS = 200_000


def line(pin):
    header, number = pin[1:].split(":")
    number = int(number)
    return len(OWN) * HEADERS + number - SHARED if number >= SHARED else len(OWN) * (int(header) - 1) + OWN.index(number)


def lines_to_drive(board):
    """The header lines that a board file drives, one bit each."""
    pins = (channel.get(key) for table, keys in DRIVEN.items() for channel in board.get(table, ()) for key in keys)
    return sum(1 << line(pin) for pin in pins if pin)


def apply(simulator, tool, file):
    """`ferrocnc config apply`; the board's time until every line of the file is driven."""
    wanted, clock_hz = lines_to_drive(tomllib.loads(file.read_text())), simulator.clock_hz
    before, frames = simulator.ask("pins"), simulator.ask("stats")["frames"]
    begun, since, driven = int(before["clock"]), time.monotonic(), None
    # Its patience is in this computer's time, of which a simulated board needs much.
    command = [tool, "--json", "config", "apply", "--patience", "900", simulator.board, file]
    told = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        while told.poll() is None:
            pins = simulator.ask("pins")
            if int(pins["drives"], 16) != wanted:
                driven = None
            elif driven is None:
                driven = int(pins["clock"])
            time.sleep(0.01)
    finally:
        told.kill()  # if the simulator has ended before it
    said = told.stdout.read()
    if told.returncode:
        sys.exit(f"ferrocnc config apply {file.name} failed: {said}")
    pins = simulator.ask("pins")
    if int(pins["drives"], 16) != wanted:
        sys.exit(f"{file.name} is to drive the lines {wanted:#x}, and the card drives {pins['drives']}")
    ended, size = int(pins["clock"]), json.loads(said)["bytes"]
    if int(before["drives"], 16) == wanted:
        driven = ended  # The same lines as before do not tell; the board's own word does.
    sent, received = (int(b) - int(a) for a, b in zip(frames.split("/"), simulator.ask("stats")["frames"].split("/")))
    return {
        "file": file.name,
        "bytes": size,
        "lines_before": int(before["drives"], 16).bit_count(),
        "lines_driven": wanted.bit_count(),
        "begun_clock": begun,
        "ended_clock": ended,
        "driven_s": ((driven or ended) - begun) / clock_hz,
        "answered_s": (ended - begun) / clock_hz,
        "flash_busy_s": math.ceil(size / SECTOR) * ERASE_S + math.ceil(size / PAGE) * PROGRAM_S,
        "frames_to_board": sent,
        "frames_from_board": received,
        "wall_s": time.monotonic() - since,
    }


def in_words(told):
    return (
        f"{told['file']}: {told['bytes']} bytes over the simulated wire; {told['driven_s']:.3f} s of board time from the start of "
        f"`config apply` until all {told['lines_driven']} lines of the file are driven ({told['lines_before']} were before), "
        f"{told['flash_busy_s']:.3f} s of it the flash is busy by its data sheet; "
        f"armed by the driver after {told['armed_s']:.3f} s; {told['frames_to_board']} frames to the board; {told['wall_s']:.0f} s of this computer"
    )


def too_slow(told):
    if told["driven_s"] >= APPLIED_S:
        yield f"{told['file']}: its lines are driven after {told['driven_s']:.3f} s of board time, not within {APPLIED_S} s"


def _mill():
    """The program that runs the mill, which has the name of one beside this one."""
    spec = importlib.util.spec_from_file_location("mill", ROOT / "host/examples/mill/run.py")
    mill = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mill)
    return mill


class Hal:
    """A HAL session with the driver and a thread, against a board in lockstep."""

    def __init__(self, board):
        self.environment = dict(os.environ, LC_ALL="C")
        if os.geteuid() == 0:
            self.environment.setdefault("RTAPI_UID", "1000")
            self.environment.setdefault("RTAPI_FIFO_PATH", f"/tmp/ferrocnc_rtapi_fifo_{os.getpid()}")
        self.board = board

    def __enter__(self):
        try:
            self.run(
                f"loadrt threads name1=servo period1={PERIOD_NS}",
                f"loadrt ferrocnc boards={self.board}",
                "addf ferrocnc.0.read servo",
                "addf ferrocnc.0.write servo",
                "setp ferrocnc.0.packet-read-timeout 2000000000",
                "start",
            )
        except BaseException:
            self.end()
            raise
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        subprocess.run(["halrun", "-U"], env=self.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        fifo = self.environment.get("RTAPI_FIFO_PATH", "")
        if fifo.endswith(f"_{os.getpid()}") and os.path.exists(fifo):
            os.remove(fifo)

    def run(self, *commands):
        # A file and no pipe: the realtime process that the first command starts keeps it open.
        with tempfile.TemporaryFile("w+") as said:
            text = "\n".join(commands) + "\n"
            done = subprocess.run(["halcmd", "-f"], input=text, stdout=said, stderr=subprocess.STDOUT, text=True, env=self.environment, timeout=120)
            said.seek(0)
            if done.returncode:
                sys.exit(f"HAL refused: {said.read()}")
            return said.read().split()

    def set(self, **levels):
        self.run(*(f"setp ferrocnc.0.{name} {level}" for name, level in levels.items()))

    def get(self, names):
        return self.run(*(f"getp ferrocnc.0.{name}" for name in names)) if names else []


class Check:
    """Each function of a board file alone, at the pads of a card that is armed."""

    def __init__(self, simulator, hal, board):
        self.simulator, self.hal = simulator, hal
        names = {table: [channel["name"] for channel in board.get(table, ())] for table in ("stepgen", "encoder", "pwm", "gpio_in", "gpio_out")}
        self.inputs, self.outputs = names["gpio_in"], names["gpio_out"]
        self.pwms, self.stepgens, self.encoders = names["pwm"], names["stepgen"], names["encoder"]
        self.wrong, self.checked = [], 0

    def pass_exchanges(self):
        """Lets the board's time pass; what its pads do then."""
        answered = int(self.simulator.ask("stats")["answered"])
        until, end = answered + EXCHANGES, time.monotonic() + PATIENCE_S
        while answered < until:
            if time.monotonic() > end:
                sys.exit(f"the driver has had no answer for {PATIENCE_S} s; has LinuxCNC's rtapi_app ended?")
            time.sleep(0.02)
            before, answered = answered, int(self.simulator.ask("stats")["answered"])
            if answered > before:
                end = time.monotonic() + PATIENCE_S
        return self.simulator.ask("pins")

    def expect(self, what, found, wanted):
        self.checked += 1
        if found != wanted:
            self.wrong.append(f"{what}: {found} instead of {wanted}")

    def arm(self):
        self.pass_exchanges()
        self.hal.set(enable=1)
        self.pass_exchanges()
        self.hal.set(**{"enable-request": 1})
        pins = self.pass_exchanges()
        self.expect("gate", pins["gate"], "1")
        return int(pins["clock"])

    def levels(self):
        """Outputs, and at the same time inputs: no line is both."""
        for n in range(max(len(self.outputs), len(self.inputs))):
            self.hal.set(**{f"gpio.{name}.out": int(k == n) for k, name in enumerate(self.outputs)})
            self.simulator.ask(f"gpio-in {1 << n if n < len(self.inputs) else 0:#x}")
            pins = self.pass_exchanges()
            if n < len(self.outputs):
                self.expect(f"output {self.outputs[n]}", int(pins["gpio_out"], 16), 1 << n)
            if n < len(self.inputs):
                seen = self.hal.get([f"gpio.{name}.in" for name in self.inputs])
                high = [name for name, level in zip(self.inputs, seen) if level == "TRUE"]
                self.expect(f"input {self.inputs[n]}", high, [self.inputs[n]])
        self.hal.set(**{f"gpio.{name}.out": 0 for name in self.outputs})
        self.simulator.ask("gpio-in 0")

    def duties(self):
        for n in range(len(self.pwms)):
            self.hal.set(**{f"pwm.{name}.{pin}": int(k == n) for k, name in enumerate(self.pwms) for pin in ("enable", "value")})
            pins = self.pass_exchanges()
            self.expect(f"PWM {self.pwms[n]}", int(pins["pwm"], 16), 1 << n)
        self.hal.set(**{f"pwm.{name}.enable": 0 for name in self.pwms})

    def steps(self):
        """Each axis forwards and backwards; an encoder is on each motor."""
        counts = self.counts()
        for n, name in enumerate(self.stepgens):
            self.hal.set(**{f"stepgen.{name}.control-type": 1, f"stepgen.{name}.maxaccel": 0, f"stepgen.{name}.enable": 1})
            encoder = self.encoders[n] if n < len(self.encoders) else None
            for sign in (1, -1):
                self.hal.set(**{f"stepgen.{name}.velocity-cmd": sign * STEPS_PER_S})
                self.pass_exchanges()
                self.hal.set(**{f"stepgen.{name}.velocity-cmd": 0})
                self.pass_exchanges()
                before, counts = counts, self.counts()
                moved = [now - then for now, then in zip(counts, before)]
                told = self.hal.get([f"stepgen.{name}.counts"] + ([f"encoder.{encoder}.rawcounts"] if encoder else []))
                self.expect(f"axes that move with {name}", [k for k, steps in enumerate(moved) if steps], [n])
                self.expect(f"way of {name}", math.copysign(1, moved[n]), sign)
                self.expect(f"place of {name}", counts[n], int(told[0]))
                if encoder:
                    self.expect(f"encoder {encoder}", int(told[1]), counts[n])

    def counts(self):
        return [int(count) for count in self.simulator.ask("counts")["counts"].split(",")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("soc")
    parser.add_argument("firmware")
    parser.add_argument("out", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--tool", type=Path, required=True)
    parser.add_argument("--wired", type=Path, help="wire the card as this other board file says")
    parser.add_argument("--simulator", type=Path, default=RELEASE)
    parser.add_argument("--json", type=Path, help="add what was measured to this report")
    options = parser.parse_args()
    _mill().sweep()  # refuses if there is a session that is not ours
    since = time.monotonic()
    board = tomllib.loads(options.file.read_text())
    card = ("--flash", options.out / "card.flash", "--wired", options.wired or options.file, "--mode", "free")
    with Simulator(options.simulator, options.soc, options.firmware, *card) as simulator:
        told = apply(simulator, options.tool, options.file)
        simulator.ask(f"mode lockstep {PERIOD_NS}")
        with Hal(simulator.board) as hal:
            check = Check(simulator, hal, board)
            told["armed_s"] = (check.arm() - told["begun_clock"]) / simulator.clock_hz
            check.wrong += too_slow(told)
            check.levels()
            check.duties()
            check.steps()
    told |= {"checked": check.checked, "wrong": check.wrong, "all_s": time.monotonic() - since}
    print(in_words(told))
    print(
        f"{len(check.outputs)} outputs, {len(check.pwms)} PWMs, {len(check.stepgens)} step generators, {len(check.inputs)} inputs, "
        f"{len(check.encoders)} encoders of it, each alone, in {told['all_s']:.0f} s with the start and "
        f"`config apply`: {check.checked} checks at the pads, {len(check.wrong)} wrong"
    )
    if options.json:
        report = json.loads(options.json.read_text())
        report["second_file"] = told
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    for wrong in check.wrong:
        print(f"WRONG: {wrong}")
    return 1 if check.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
