"""Runs the tools in their order: elaborate, yosys, nextpnr with one seed after the other, pack. A
clock that misses its constraint fails the build, and so does one with too little slack.

The result of a stage depends only on its inputs, and a stage is skipped while they are the same:
new firmware, another address or another name of equal length in a board file goes into the existing
routed design, in seconds.
"""

import contextlib
import hashlib
import heapq
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from . import ecp5, image, netlist, regmap as rm, rgmii, settled, soc as ferro, tools
from .board import BoardError, PlatformImage, pins_missing, read_board

TOP = "top"
_GATEWARE = Path(__file__).resolve().parents[1]
_READ = re.compile(r"^(read_verilog(?: -sv)?) (/\S+)$", re.M)


class BuildError(Exception):
    """A build that failed; the text is the message."""


def elaborate(board, out, all_pins=True):
    """Writes all files for the tools: top.v, top.ys, top.lpf, ROM contents, sources. They do not
    depend on the date or the folder. Returns the SoC."""
    out = Path(out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    soc = ecp5.BoardSoC(board, all_pins=all_pins)
    toolchain = soc.platform.toolchain
    toolchain._yosys_cmds.append(ecp5.ABC9)
    here = os.getcwd()
    try:  # LiteX builds in the current folder
        soc.platform.build(soc, build_dir=str(out), build_name=TOP, run=False)
    finally:
        os.chdir(here)
    (out / f"build_{TOP}.sh").unlink()  # LiteX's idea of how to go on
    _settle(out)
    (out / "csr.csv").write_text(ferro.csr_csv(soc))
    (out / "board.bin").write_bytes(soc.blob)
    return soc


def _settle(out):
    """Removes what changes from run to run from top.v, and the machine's paths from top.ys: yosys
    names cells after the files and lines they come from."""
    top = settled.verilog((out / f"{TOP}.v").read_text(encoding="utf-8"))
    (out / f"{TOP}.v").write_text(top, encoding="utf-8", newline="\n")
    (out / "src").mkdir(exist_ok=True)

    def near(match):
        path = Path(match[2])
        if path.parent == out:
            return f"{match[1]} {path.name}"
        shutil.copyfile(path, out / "src" / path.name)
        return f"{match[1]} src/{path.name}"

    script = out / f"{TOP}.ys"
    script.write_text(_READ.sub(near, script.read_text()))
    lpf = (out / f"{TOP}.lpf").read_text().splitlines(keepends=True)
    # pins without a ball
    (out / f"{TOP}.lpf").write_text("".join(line for line in lpf if 'SITE "X"' not in line))


def place(board, folder, seed, *more, name="", cancelled=None):
    """nextpnr places, our router routes (decision 11), nextpnr checks every route, reports the
    clocks and writes the configuration. The caller judges a missed clock from the report: nextpnr
    alone would stop before it reports the clocks."""
    report = folder / f"nextpnr{name}.json"
    report.unlink(missing_ok=True)
    end = ["--textcfg", f"{TOP}{name}.config", "--report", report.name, *_device(board), "--timing-allow-fail"]
    start = ["--json", f"{TOP}.json", "--lpf", f"{TOP}.lpf", "--seed", str(seed), *ecp5.PLACER.split(), *more]
    placed, ways, clocks = f"placed{name}.json", f"ways{name}.json", f"clocks{name}.lpf"
    tools.run("nextpnr-ecp5", [*start, "--no-route", "--write", placed, *_device(board), "--timing-allow-fail"], folder, f"placing{name}.log",
              cancelled=cancelled)
    tools.route(["--chip", str(tools.chip_database(_device(board)[0][2:])), "--placed", placed, "--routed", ways, "--constraints", clocks,
                 "--clock", f"eth={rgmii.PHY.rx_clk_freq / 1e6:g}", "--clock", f"={board.sys_clk_hz / 1e6:g}"], folder, f"routing{name}.log", cancelled=cancelled)
    tools.run("nextpnr-ecp5", ["--json", ways, "--lpf", clocks, "--no-pack", "--no-place", "--router", "router1", "--write", f"routed{name}.json", *end], folder, f"nextpnr{name}.log",
              cancelled=cancelled)
    for file in (placed, ways):  # 100 MB
        (folder / file).unlink()
    return json.loads(report.read_text())


def _device(board):
    device = board.platform.device.split("-")
    return f"--{device[1].lower().replace('f', 'k')}", "--package", board.platform.package, "--speed", device[2][0]


# One board ----------------------------------------------------------------------------------------

class Design:
    """The build of one board file or image, in `folder`; `folder / "work"` keeps the result of
    every stage, and `record.json` its inputs."""

    def __init__(self, subject, root, options, watch, turn=0):
        self.subject, self.options, self.watch, self.turn = subject, options, watch, turn
        self.name = subject.name
        self.folder, self.work = root / self.name, root / self.name / "work"
        self.record = {}

    def build(self):
        """Runs all stages. Returns the report."""
        began = time.monotonic()
        for old in (self.folder / f"{self.name}{end}" for end in image.FILES):
            old.unlink(missing_ok=True)  # a failed build leaves no bitstream, not even an older one
        self.work.mkdir(parents=True, exist_ok=True)
        self.board = self.subject.read()
        self.pins = not pins_missing(self.board)
        if not self.pins and not self.options.without_pins:
            raise BoardError(self.board.file, pins_missing(self.board)[0],
                             f"has no pin ({len(pins_missing(self.board))} are missing); a configuration without pins can only be simulated")
        self.record = self._load()
        if self.options.firmware_only:
            self._must_fit()
        elif self._sources() != self.record.get("sources"):
            self._elaborate()
        if "cells" not in self.record:
            with self.watch.core((self.options.first_seed, self.turn)):
                self._stage("synthesis", self._synthesise)
        if self.record.get("flags") != self._flags() and not self.options.firmware_only:
            self.record |= {"flags": self._flags(), "seeds": {}}
            self._save()
        seed = self._search()
        found = self._report(seed)
        if self.pins and self.options.firmware:
            found["image"] = self._stage("packing", self._pack, seed)
        found["wall_seconds"] = round(time.monotonic() - began, 1)
        (self.folder / "report.json").write_text(json.dumps(found, indent=2) + "\n")
        return found

    def prove(self):
        """Unpacks the built files and compares them. Yields what was proven."""
        seed = json.loads((self.folder / "report.json").read_text())["seed"]
        design = (self.board, self.work, f"{TOP}{seed}.config", read_image(self.options.firmware), self.folder)
        yield from image.prove(*design, self._program())
        if not self.board.sdram:
            yield from image.prove_services(*design, self._services())

    # The inputs of the results

    def _load(self):
        try:
            return json.loads((self.work / "record.json").read_text())
        except (OSError, ValueError):
            return {}

    def _save(self):
        part = self.work / "record.json.part"
        part.write_text(json.dumps(self.record, indent=1) + "\n")
        part.replace(self.work / "record.json")

    def _sources(self):
        """Hash of everything an elaboration reads: our Python and Verilog, the pinned packages, the
        board without the values that are only in its description."""
        files = sorted([*_GATEWARE.glob("ferrocnc/*.py"), *_GATEWARE.glob("rtl/*.sv"), _GATEWARE / "requirements.txt"])
        sum_ = hashlib.sha256()
        for file in files:
            sum_.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
        board = {k: v for k, v in vars(self.board).items() if k not in ("file", "mac", "ipv4", "udp_port", "blob", "platform")}
        for channels in (board[k] for k in ("stepgen", "encoder", "pwm", "gpio_in", "gpio_out")):
            sum_.update(repr([{k: v for k, v in c.items() if k != "name"} for c in channels]).encode())
        sum_.update(repr(sorted((k, v) for k, v in board.items() if not isinstance(v, list))).encode())
        sum_.update(repr(self.board.lines).encode())
        sum_.update(repr(sorted((k, v) for k, v in vars(self.board.platform).items() if k != "file")).encode())
        sum_.update(repr((len(self.board.blob), self.pins, self._tools())).encode())
        return sum_.hexdigest()

    def _tools(self):
        return [tools.version("yosys"), tools.version("nextpnr-ecp5")]

    def _netlist(self):
        """Hash of everything yosys reads, and of the script that prepares its netlist for
        nextpnr."""
        files = [self.work / f"{TOP}{end}" for end in (".v", ".ys", ".lpf")]
        files += sorted(self.work.glob("*.init")) + sorted((self.work / "src").iterdir()) + [Path(netlist.__file__)]
        sum_ = hashlib.sha256(repr((self._tools(), _device(self.board), self.pins)).encode())
        for file in files:
            sum_.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
        return sum_.hexdigest()

    def _flags(self):
        """The inputs of placing and routing besides the netlist and nextpnr."""
        return ecp5.PLACER + hashlib.sha256(tools.router().read_bytes()).hexdigest()

    def _must_fit(self):
        if not self.record.get("seeds"):
            raise BuildError(f"{self.name}: there is no routed design to put firmware into; build once without --firmware-only")
        if self.record["blob_words"] != len(self.board.blob) // 4:
            raise BuildError(f"{self.name}: the board's description has grown or shrunk, and its length is part of the design; "
                             "build without --firmware-only")

    # Stages

    def _stage(self, name, run, *args):
        began = time.monotonic()
        self.watch.begin(self.name, name)
        try:
            result = run(*args)
            self.watch.end(self.name, name, time.monotonic() - began)
        except BaseException:
            self.watch.end(self.name, name, None)
            raise
        return result

    def _elaborate(self):
        # In a process of its own: LiteX keeps state in its modules, and works in the current
        # folder.
        fresh = self.work.with_name("fresh")
        shutil.rmtree(fresh, ignore_errors=True)
        command = [sys.executable, "-m", "ferrocnc", "elaborate", "--target", "board", *self.subject.arguments(), "--out", str(fresh)]
        command += [] if self.pins else ["--without-pins"]

        def run():
            done = subprocess.run(command, env=dict(os.environ, PYTHONHASHSEED="0", PYTHONPATH=str(_GATEWARE)), capture_output=True, text=True, check=False)
            if done.returncode:
                raise BuildError(f"{self.name}: cannot be elaborated\n{(done.stderr or done.stdout).strip()[-2000:]}")

        with self.watch.core((0, self.turn)):
            self._stage("elaboration", run)
        before, work, self.work = self.record.get("netlist"), self.work, fresh
        netlist, self.work = self._netlist(), work
        if netlist != before:
            shutil.rmtree(work)
            fresh.rename(work)
            self.record = {"netlist": netlist}
        self.record |= {"sources": self._sources(), "blob_words": len(self.board.blob) // 4}
        self._save()

    def _synthesise(self):
        began = time.monotonic()
        tools.run("yosys", ["-q", "-l", f"{TOP}.rpt", f"{TOP}.ys"], self.work, "yosys.log")
        self.record |= {"cells": netlist.trim(self.work / f"{TOP}.json"), "synthesis_seconds": round(time.monotonic() - began)}
        self.record["seeds"] = {}
        self._save()

    def _search(self):
        """The lowest seed that meets every clock with the required slack: the result does not
        depend on which one finishes first. Several run in parallel if there are cores for them; a
        higher one is stopped as soon as it does not matter any more."""
        seeds = range(self.options.first_seed, self.options.first_seed + self.options.seeds)
        lock, met = threading.Lock(), []

        def cancelled(seed):
            return any(other < seed for other in met)

        def one(seed):
            if cancelled(seed):
                return
            if str(seed) not in self.record["seeds"]:
                if self.options.firmware_only:
                    return
                try:
                    with self.watch.core((seed, self.turn)):
                        if cancelled(seed):
                            return
                        self._stage(f"place and route, seed {seed}", self._route, seed, lock, lambda: cancelled(seed))
                except tools.Cancelled:
                    return
            if self._slack(seed) >= self.options.slack:
                met.append(seed)

        with ThreadPoolExecutor(max(1, min(len(seeds), self.options.side_by_side))) as pool:
            list(pool.map(one, seeds))
        if not met:
            raise BuildError(self._reached())
        return min(met)

    def _route(self, seed, lock, cancelled):
        began = time.monotonic()
        try:
            data = place(self.board, self.work, seed, *([] if self.pins else ["--lpf-allow-unconstrained"]), name=str(seed), cancelled=cancelled)
        except tools.Ended:
            raise
        except tools.ToolError as e:
            found = {"failed": str(e).splitlines()[-2:]}
        else:
            found = {"clocks": _clocks(self.board, data), "utilization": {
                k: v for k, v in data["utilization"].items() if k in ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "MULT18X18D")}}
        found["seconds"] = round(time.monotonic() - began)
        with lock:
            self.record["seeds"][str(seed)] = found
            self._save()

    def _slack(self, seed):
        """Per cent of the tightest clock; -100 if it was never placed."""
        clocks = self.record["seeds"][str(seed)].get("clocks")
        return min(slack(clock) for clock in clocks.values()) * 100 if clocks else -100

    def _reached(self):
        tried = {seed: found for seed, found in self.record["seeds"].items()
                 if self.options.first_seed <= int(seed) < self.options.first_seed + self.options.seeds}
        if not tried:
            return f"{self.name}: none of these seeds has been placed and routed; build without --firmware-only"
        lines = []
        for seed, found in tried.items():
            if "clocks" in found:
                lines.append(f"  seed {seed}: " + ", ".join(_clock_text(name, clock) for name, clock in found["clocks"].items()))
            else:
                lines.append(f"  seed {seed}: not placed and routed; " + " ".join(found["failed"]))
        best = max(self._slack(seed) for seed in tried)
        what = "misses a clock" if best < 0 else f"meets every clock, but with {best:.1f} % slack where {self.options.slack:g} % are wanted"
        return f"{self.name}: the best of {len(tried)} seeds {what}:\n" + "\n".join(lines) + "\n  more seeds: --seeds"

    def _pack(self, seed):
        return image.pack(self.board, self.work, f"{TOP}{seed}.config", read_image(self.options.firmware), self.folder, self._program())

    def _program(self):
        """The services that were built with this firmware, if the board has SDRAM."""
        return self._services() if self.board.sdram else b""

    def _services(self):
        """Jobs are a part of them on boards that have jobs."""
        name = "ferrocnc-services.bin" if self.board.jobs else "ferrocnc-services-without-jobs.bin"
        path = Path(self.options.firmware).with_name(name)
        try:
            return path.read_bytes()
        except OSError as e:
            raise BuildError(f"{self.name}: the services, {path.name}, cannot be read ({e.strerror}); firmware/build.sh makes them beside the firmware") from e

    def _report(self, seed):
        found = self.record["seeds"][str(seed)]
        tried = [other for other in self.record["seeds"] if int(other) <= seed]
        return {
            "board": self.name, "platform": self.board.platform.name, "device": self.board.platform.device, "clocks": found["clocks"], "seed": seed,
            "seconds": self.record["synthesis_seconds"] + sum(self.record["seeds"][other]["seconds"] for other in tried),
            **self.record["cells"], "trellis_comb": found["utilization"]["TRELLIS_COMB"]["used"], "utilization": found["utilization"],
        }


# Progress ----------------------------------------------------------------------------------------

class Cores:
    """Hands out a number of cores, always to the lowest (seed, board): no board tries a second seed
    before each has had its first."""

    def __init__(self, count):
        self._free, self._waiting, self._changed = count, [], threading.Condition()

    @contextlib.contextmanager
    def one(self, turn):
        ticket = (*turn, threading.get_ident())
        with self._changed:
            heapq.heappush(self._waiting, ticket)
            self._changed.wait_for(lambda: self._free and self._waiting[0] == ticket)
            heapq.heappop(self._waiting)
            self._free -= 1
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._free += 1
                self._changed.notify_all()


class Watch:
    """Prints every few seconds what runs, for how long, and how long it took the last time."""

    SAY_EVERY = 5

    def __init__(self, root, jobs):
        self.file = root / "durations.json"
        self.core, self._lock = Cores(jobs).one, threading.Lock()
        self._running, self._said = {}, 0
        try:
            self.durations = json.loads(self.file.read_text())
        except (OSError, ValueError):
            self.durations = {}

    @staticmethod
    def _key(board, stage):
        return f"{board}/{stage.partition(',')[0]}"

    def begin(self, board, stage):
        with self._lock:
            self._running[board, stage] = time.monotonic()
        print(f"{board}: {stage} ({self._expected(board, stage)})", flush=True)

    def end(self, board, stage, seconds):
        with self._lock:
            self._running.pop((board, stage), None)
            if seconds is None:
                return
            self.durations[self._key(board, stage)] = round(seconds, 1)
            self.file.write_text(json.dumps(self.durations, indent=1, sort_keys=True) + "\n")
        print(f"{board}: {stage} took {seconds:.1f} s", flush=True)

    def _expected(self, board, stage):
        seconds = self.durations.get(self._key(board, stage))
        return "first time: no estimate" if seconds is None else f"took {seconds:.0f} s the last time"

    def tick(self):
        now = time.monotonic()
        with self._lock:
            running = list(self._running.items())
        if running and now - self._said > self.SAY_EVERY:
            self._said = now
            print("  ... " + "; ".join(f"{board}: {stage} {now - since:.0f} s ({self._expected(board, stage)})" for (board, stage), since in running), flush=True)


class Options:
    """The options of a build."""

    def __init__(self, firmware=None, first_seed=1, seeds=6, jobs=None, slack=5.0, firmware_only=False, without_pins=False, boards=1):
        self.firmware, self.first_seed, self.seeds, self.slack = firmware, first_seed, seeds, slack
        self.firmware_only, self.without_pins = firmware_only, without_pins
        self.jobs = jobs or os.cpu_count() or 1
        # Cores that are not needed for a board try the next seeds.
        self.side_by_side = max(1, self.jobs // min(boards, self.jobs))


def bitstreams(subjects, root, options, report=None, document=None, prove=False):
    """Builds what is asked for. Returns the process's exit code: not 0 if one of them failed."""
    if document:
        try:  # now rather than after hours
            with_table(Path(document).read_text(encoding="utf-8"), subjects[0].kind, "")
        except (BuildError, OSError) as e:
            print(f"error: {document} cannot take the table: {e}", file=sys.stderr)
            return 1
    root = Path(root).resolve()
    root.mkdir(parents=True, exist_ok=True)
    watch, found, failed, proven = Watch(root, options.jobs), {}, {}, []

    def one(subject, turn):
        design = Design(subject, root, options, watch, turn)
        try:
            found[design.name] = design.build()
            proven.extend(design.prove() if prove else ())
        except (BoardError, BuildError, tools.ToolError, ValueError) as e:
            failed[design.name] = str(e)
            print(f"{design.name}: failed", flush=True)

    with ThreadPoolExecutor(len(subjects)) as pool:
        # In reverse: the largest board is listed last, and all others should not have to wait for
        # it.
        waiting = [pool.submit(one, subject, turn) for turn, subject in enumerate(reversed(subjects))]
        while not all(future.done() for future in waiting):
            time.sleep(0.2)
            watch.tick()
        for future in waiting:
            future.result()
    found = {name: found[name] for name in (subject.name for subject in subjects) if name in found}
    print("== summary")
    for text in (*map(_summary, found.values()), *(f"PASS {text}" for text in proven)):
        print(text)
    if report and found:
        last = list(found.values())[-1] | ({"boards": list(found.values())} if len(subjects) > 1 else {})
        Path(report).parent.mkdir(parents=True, exist_ok=True)
        Path(report).write_text(json.dumps(last, indent=2) + "\n")
    if document and found:
        page = Path(document).read_text(encoding="utf-8")
        Path(document).write_text(with_table(page, subjects[0].kind, timing_table(found, failed)), encoding="utf-8", newline="\n")
    for text in failed.values():
        print(f"error: {text}", file=sys.stderr)
    return 1 if failed else 0


def slack(clock):
    return clock["achieved_mhz"] / clock["required_mhz"] - 1


def _clock_text(name, clock):
    return f"{name} {clock['achieved_mhz']:.1f} MHz of {clock['required_mhz']:g} ({slack(clock):+.1%})"


def _summary(found):
    use = ", ".join(f"{name} {found['utilization'][cell]['used']} of {found['utilization'][cell]['available']} "
                    f"({found['utilization'][cell]['used'] / found['utilization'][cell]['available']:.0%})"
                    for name, cell in (("COMB", "TRELLIS_COMB"), ("FF", "TRELLIS_FF"), ("EBR", "DP16KD"), ("DSP", "MULT18X18D")))
    lines = [
        f"{found['board']} on {found['platform']}, {found['device']}",
        "  clocks  " + ", ".join(_clock_text(name, clock) for name, clock in found["clocks"].items()),
        f"  used    {use}; LUT4 {found['lut4']}",
        f"  time    {found['wall_seconds']:g} s now; synthesis, placing and routing take {found['seconds']} s, seed {found['seed']}",
    ]
    if "image" in found:
        lines.append(f"  image   build {found['image']['build']}, {found['image']['bytes']} bytes; .bit, -golden.bit, .svf and .flash")
    return "\n".join(lines)


def timing_table(found, failed):
    """The clocks and sizes of what was built, as Markdown; below it what was not, and why."""
    head = ("configuration", "platform", "LUT4", "FF", "EBR", "DSP", "COMB", "eth, MHz", "slack", "sys, MHz", "slack", "seed", "minutes", "image, KB")
    lines = ["| " + " | ".join(head) + " |", "|---|---|" + "---:|" * (len(head) - 2)]
    for f in found.values():
        cells = [f["board"], f["platform"], *(f[k] for k in ("lut4", "ff", "ebr", "dsp", "trellis_comb"))]
        for name in ("eth", "sys"):
            clock = f["clocks"][name]
            cells += [f"{clock['achieved_mhz']:.1f} of {clock['required_mhz']:g}", f"{slack(clock):+.1%}"]
        cells += [f["seed"], f"{f['seconds'] / 60:.1f}", f"{f['image']['bytes'] / 1000:.0f}" if "image" in f else "-"]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    for text in failed.values():
        lines += ["", "**Not built.** " + text.replace("\n", "<br>")]
    return "\n".join(lines) + "\n"


def with_table(page, which, table):
    """The page with this table between its marks `<!-- which -->` and `<!-- /which -->`."""
    before, begin, rest = page.partition(f"<!-- {which} -->\n")
    _, end, after = rest.partition(f"<!-- /{which} -->\n")
    if not end:
        raise BuildError(f"the document has no marks <!-- {which} --> and <!-- /{which} -->")
    return before + begin + table + end + after


# Firmware -----------------------------------------------------------------------------------------

def read_image(path):
    """The image as ROM words, from an ELF file (what loads into the ROM) or a flat binary."""
    data = Path(path).read_bytes()
    origin, size = rm.ROM
    if data[:4] == b"\x7fELF":
        flat = bytearray(size)
        offset, entry, count = int.from_bytes(data[28:32], "little"), *(int.from_bytes(data[i:i + 2], "little") for i in (42, 44))
        for i in range(count):
            kind, at, _, address, length = (int.from_bytes(data[offset + i * entry + 4 * k:][:4], "little") for k in range(5))
            if kind != 1 or not length:
                continue
            if not origin <= address or address + length > origin + size:
                raise BoardError(path, "", f"loads {length} bytes at {address:#x}; the ROM has {size} at {origin:#x}")
            flat[address - origin:address - origin + length] = data[at:at + length]
        data = bytes(flat)
    if len(data) > size:
        raise BoardError(path, "", f"has {len(data)} bytes; the ROM has {size}")
    data += bytes(size - len(data))
    return [int.from_bytes(data[i:i + 4], "little") for i in range(0, size, 4)]


# Reports -----------------------------------------------------------------------------------------

def _clocks(board, data):
    clocks = {}
    for net, f in data["fmax"].items():
        # nextpnr names a clock after the first net it found, so the core clock is recognised by its
        # required frequency.
        name = "eth" if "eth" in net else "sys" if abs(f["constraint"] * 1e6 - board.sys_clk_hz) < 0.01 * board.sys_clk_hz else net
        clocks[name] = {"required_mhz": round(f["constraint"], 2), "achieved_mhz": round(f["achieved"], 2)}
    return clocks


# Size --------------------------------------------------------------------------------------------

# The same machine on the same tools: 6 step generators, 6 encoders, 6 PWM, 12 inputs, 12 outputs,
# 5A-75B, 40 MHz, Etherbone in gateware instead of a CPU. LiteX-CNC 1.3.4 was placed and routed with
# yosys 0.70 and nextpnr 0.11.1, one seed; Lcnc (f6c0d75) was elaborated and simulated, not placed.
PEERS = {
    "LiteX-CNC 1.3.4, as mill6": {"lut4": 9461, "ccu2c": 2160, "ff": 7412, "ebr": 4, "dsp": 0, "lutram": 150, "trellis_comb": 15399},
    "Lcnc f6c0d75, as mill6": None,
}
# The same boards before the services (3e58777): no SDRAM, guard, leash or fast path, and an IP
# stack of the firmware's own in the ROM.
BEFORE = {
    "none": {"lut4": 6480, "ccu2c": 420, "ff": 3943, "ebr": 54, "dsp": 4, "trellis_comb": 7734},
    "mill6": {"lut4": 9844, "ccu2c": 1294, "ff": 8791, "ebr": 55, "dsp": 4, "trellis_comb": 13810},
    "max": {"lut4": 14108, "ccu2c": 2414, "ff": 16468, "ebr": 55, "dsp": 4, "trellis_comb": 19906},
}
# The image that is measured.
IMAGE = "5a-75b-8.0"
AVAILABLE = 24_288  # TRELLIS_COMB of an LFE5U-25F
_COLUMNS = (("LUT4", "lut4"), ("CCU2C", "ccu2c"), ("FF", "ff"), ("EBR", "ebr"), ("DSP", "dsp"), ("COMB", "trellis_comb"))


def bench(root, out, report=None, seed=None, document=None):
    """Synthesises and packs every core alone and the named boards, and prints their sizes. With a
    seed it places and routes the boards, too.

    COMB is nextpnr's count after packing: LUTs, two per carry cell and the cells it adds to get in
    and out of a carry chain, LUT RAM. A core alone is mapped for area, because its critical paths
    are unknown; in a board the tools know them.
    """
    out = Path(out).resolve()
    cores, boards = {}, {}
    sources = " ".join(str(source) for source in sorted(ferro.RTL.glob("*.sv")))
    for source in sorted(ferro.RTL.glob("*.sv")):
        folder = out / source.stem
        folder.mkdir(parents=True, exist_ok=True)
        script = f"read_verilog -sv {sources}; {ecp5.ABC9_AREA}; synth_ecp5 -top {source.stem} -json {TOP}.json"
        tools.run("yosys", ["-q", "-p", script], folder, "yosys.log", [ferro.RTL.resolve()])
        cores[source.stem] = netlist.trim(folder / f"{TOP}.json") | _packed(folder, ("--25k", "--package", "CABGA256", "--speed", "6"))
    for name in ("none", "mill6", "max", IMAGE):
        board, folder = _measured(root, name), out / name
        _bare_synthesis(board, name in ("mill6", IMAGE), folder)
        boards[name] = netlist.trim(folder / f"{TOP}.json") | _packed(folder, ("--lpf", f"{TOP}.lpf", *_device(board)))
        if seed is not None and name != "none":
            boards[name]["clocks"] = _clocks(board, place(board, folder, seed, "--lpf-allow-unconstrained"))
            boards[name]["seed"] = seed
    text = "\n".join(size_tables(cores, boards)) + "\n"
    print(text)
    if document:
        Path(document).write_text(_SIZE_DOC + text, encoding="utf-8", newline="\n")
    if report:
        Path(report).parent.mkdir(parents=True, exist_ok=True)
        Path(report).write_text(json.dumps({"boards": boards, "cores": cores, "before": BEFORE, "peers": PEERS, "available": AVAILABLE}, indent=2) + "\n")
    return 0


def _measured(root, name):
    """The board of a row: `none` is `max` without its channels."""
    if name == IMAGE:
        return PlatformImage(name, None).read()
    board = read_board(root / "boards" / f"{'max' if name == 'none' else name}.toml")
    if name == "none":
        for kind in ("stepgen", "encoder", "pwm", "gpio_in", "gpio_out"):
            setattr(board, kind, [])
    return board


_SIZE_DOC = """<!-- Written by `cargo xtask bench gateware`; do not edit. -->
# Size

What the gateware costs on an LFE5U-25F-6 (24 288 TRELLIS_COMB, 24 288 FF, 56 EBR, 28 DSP), with the
tools of `gateware/requirements.txt`. COMB is counted after packing: LUTs, two for each carry cell
and those that lead in and out of a carry chain, four and two for each LUT RAM. It is what the
placer has to find room for, and the figure to compare.

A core is measured alone; `wide_counter`, `edges` and `gpio` are there once for all channels (16,
16, 64 + 64), each encoder has two `debounce` inside, each encoder and each step generator a `latch`
beside it. `segments` (3 axes) is on boards with jobs only. The multiplexer of an image is
`pinmux_out` and `pinmux_in`, here of 56 lines with 36 sources and 48 sinks; `crossbar` and
`truth_table` are parts of both, and `estops` is on images only. `max` has no pins on a 5A-75B: its
inputs come from a shift register behind one pad and its outputs leave as a parity through another,
so that nothing is optimised away (about 40 LUTs). It is packed here, and does not route
([timing](timing.md)).

*Before* is the same board without SDRAM, guard, leash and fast path, with an IP stack of its own
in the ROM, which then had 180 bytes left.

The peers' figures are of the same tools and the same channels: 6 step generators, 6 encoders, 6
PWM, 12 + 12 I/O, 40 MHz, Etherbone in gateware and no CPU. LiteX-CNC was placed and routed once;
Lcnc was elaborated and simulated, never placed.

"""


def size_tables(cores, boards):
    """The cores alone; the boards and the peers; the clocks of the routed ones."""
    def row(name, c):
        return f"| {name} | " + " | ".join(f"{c[key]:,}".replace(",", " ") for _, key in _COLUMNS) + " |"

    def head(what, columns):
        return [f"| {what} | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]

    columns = [name for name, _ in _COLUMNS]
    yield from head("core", columns)
    yield from (row(name, c) for name, c in cores.items())
    yield ""
    yield from head("board", columns)
    for name, what in (("none", "no channel: CPU, MAC, memories, timebase, watchdog"), ("mill6", "mill6: 6 + 6 + 6, 12 + 12"), ("max", "max: 16 + 16 + 16, 64 + 64")):
        yield row(what, boards[name])
        yield row(f"{what.partition(':')[0]}, before", BEFORE[name])
    yield row(f"{IMAGE}, the image: 8 + 8 + 8, 56 + 56, jobs, multiplexer", boards[IMAGE])
    mux = {key: cores["pinmux_out"][key] + cores["pinmux_in"][key] for _, key in _COLUMNS}
    yield row("of the image, its multiplexer alone", mux)
    sets = rm.MAX_STEPGEN
    yield row("of max, per step generator + encoder + PWM + 4 inputs + 4 outputs, banks included",
              {key: round((boards["max"][key] - boards["none"][key]) / sets) for _, key in _COLUMNS})
    for name, c in PEERS.items():
        yield row(name, c) if c else f"| {name} | " + " | ".join("not measured" for _ in _COLUMNS) + " |"
    yield ""
    for name in ("max", IMAGE):
        free = AVAILABLE - boards[name]["trellis_comb"]
        yield f"`{name}` leaves {free:,} of {AVAILABLE:,} COMB free: {free / AVAILABLE:.1%}.".replace(",", " ")
    routed = {name: b for name, b in boards.items() if "clocks" in b}
    if routed:
        yield ""
        yield from head("placed and routed", ["clock", "asked, MHz", "reached, MHz", "slack", "seed"])
        for name, b in routed.items():
            for clock, f in b["clocks"].items():
                slack = f["achieved_mhz"] / f["required_mhz"] - 1
                yield f"| {name} | {clock} | {f['required_mhz']:g} | {f['achieved_mhz']:.1f} | {slack:+.1%} | {b['seed']} |"


def _packed(folder, args):
    """TRELLIS_COMB after packing: the number of places the placer needs."""
    tools.run("nextpnr-ecp5", ["--json", f"{TOP}.json", "--lpf-allow-unconstrained", "--pack-only", "--write", "packed.json", *args], folder, "pack.log")
    (module,) = json.loads((folder / "packed.json").read_text())["modules"].values()
    return {"trellis_comb": sum(cell["type"] == "TRELLIS_COMB" for cell in module["cells"].values())}


def _bare_synthesis(board, all_pins, folder):
    """A board synthesised, with or without pins; pins without a ball go wherever the placer puts
    them."""
    elaborate(board, folder, all_pins)
    tools.run("yosys", ["-q", f"{TOP}.ys"], folder, "yosys.log")
