"""Runs the tools in their order: yosys, nextpnr, ecppack. A clock that misses its constraint fails the build."""

import json
import os
import re
import sys
import time
from pathlib import Path

from . import ecp5, regmap as rm, soc as ferro, tools
from .board import BoardError, read_board

TOP = "top"


def elaborate(board, out):
    """Writes everything the tools read: top.v, top.ys, top.lpf, ROM contents. Returns the SoC."""
    out = Path(out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    soc = ecp5.BoardSoC(board)
    toolchain = soc.platform.toolchain
    toolchain._yosys_cmds.append(ecp5.ABC9)
    here = os.getcwd()
    try:  # LiteX builds in the current folder
        soc.platform.build(soc, build_dir=str(out), build_name=TOP, run=False)
    finally:
        os.chdir(here)
    (out / "csr.csv").write_text(ferro.csr_csv(soc))
    (out / "board.bin").write_bytes(soc.blob)
    return soc


def bitstream(board, out, firmware=None, seed=1, report=None):
    """Board file to top.bit. Returns the process's exit code: not 0 if a clock was missed."""
    began = time.monotonic()
    out = Path(out).resolve()
    image = read_image(firmware) if firmware else None
    (out / f"{TOP}.bit").unlink(missing_ok=True)  # a failed build leaves no bitstream, not even an older one
    soc = elaborate(board, out)
    _tool("yosys", ["-q", "-l", f"{TOP}.rpt", f"{TOP}.ys"], out, "yosys.log")
    _place(board, out, seed)
    found = _report(board, out, seed, began)
    if report:
        Path(report).parent.mkdir(parents=True, exist_ok=True)
        Path(report).write_text(json.dumps(found, indent=2) + "\n")
    missed = _print(found)
    if missed:
        for name, clock in missed.items():
            print(f"error: clock {name} reaches {clock['achieved_mhz']} MHz of {clock['required_mhz']}; try another --seed", file=sys.stderr)
        return 1
    config = f"{TOP}.config"
    if image is not None:
        config = _insert(soc, out, image)
    _tool("ecppack", ["--compress", config, f"{TOP}.bit"], out, "ecppack.log")
    print(f"{out / TOP}.bit: {(out / f'{TOP}.bit').stat().st_size} bytes, {'with ' + str(firmware) if firmware else 'no firmware: the CPU waits for an image'}")
    return 0


def _place(board, folder, seed, *more):
    """Places and routes. A missed clock is judged by who reads the report: nextpnr alone would stop before saying what it reached."""
    (folder / "nextpnr.json").unlink(missing_ok=True)
    _tool("nextpnr-ecp5", [
        "--json", f"{TOP}.json", "--lpf", f"{TOP}.lpf", "--textcfg", f"{TOP}.config", "--report", "nextpnr.json", *_device(board),
        "--seed", str(seed), "--timing-allow-fail", *ecp5.PLACER.split(), *more], folder, "nextpnr.log")


def _device(board):
    device = board.platform.device.split("-")
    return f"--{device[1].lower().replace('f', 'k')}", "--package", "CABGA256", "--speed", device[2][0]


# Firmware ---------------------------------------------------------------------------------------------------------

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


def _insert(soc, out, image):
    """Puts the image where the random words are, in the routed design: seconds, not minutes."""
    words = ferro.random_words(rm.ROM[1] // 4)
    (out / "from.hex").write_text("".join(f"{w:08x}\n" for w in words))
    (out / "to.hex").write_text("".join(f"{w:08x}\n" for w in image))
    _tool("ecpbram", ["-i", f"{TOP}.config", "-o", "firmware.config", "-f", "from.hex", "-t", "to.hex"], out, "ecpbram.log")
    return "firmware.config"


# Tools ------------------------------------------------------------------------------------------------------------

def _tool(name, args, folder, log):
    tools.run(name, args, folder, log, [ferro.RTL.resolve()])


# Reports ----------------------------------------------------------------------------------------------------------

_CELLS = {"lut4": "LUT4", "ff": "TRELLIS_FF", "ebr": "DP16KD", "dsp": "MULT18X18D", "ccu2c": "CCU2C", "lutram": "TRELLIS_DPR16X4"}


def _synthesis(path):
    """Cell counts from the last `stat` in a yosys log."""
    text = Path(path).read_text(encoding="utf-8")
    text = text[text.rfind("=== design hierarchy ===") if "=== design hierarchy ===" in text else text.rfind("=== "):]
    counts = {}
    for key, cell in _CELLS.items():
        found = re.findall(rf"^\s*(?:{cell}\s+(\d+)|(\d+)\s+(?:\S+\s+)?{cell})\s*$", text, re.M)
        counts[key] = sum(int(a or b) for a, b in found[-1:])
    return counts


def _report(board, out, seed, began):
    data = json.loads((out / "nextpnr.json").read_text())
    used = data["utilization"]
    return {
        "board": board.name, "clocks": _clocks(board, data), "seed": seed, "seconds": round(time.monotonic() - began),
        **_synthesis(out / f"{TOP}.rpt"),
        "trellis_comb": used["TRELLIS_COMB"]["used"],
        "utilization": {k: used[k] for k in ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "MULT18X18D") if k in used},
    }


def _clocks(board, data):
    clocks = {}
    for net, f in data["fmax"].items():
        # nextpnr names a clock after whichever net of it came first, so the core clock is known by what it is required to do.
        name = "eth" if "eth" in net else "sys" if abs(f["constraint"] * 1e6 - board.sys_clk_hz) < 0.01 * board.sys_clk_hz else net
        clocks[name] = {"required_mhz": round(f["constraint"], 2), "achieved_mhz": round(f["achieved"], 2)}
    return clocks


def _print(found):
    missed = {}
    for name, clock in found["clocks"].items():
        slack = clock["achieved_mhz"] / clock["required_mhz"] - 1
        print(f"{name:6} {clock['achieved_mhz']:7.2f} MHz of {clock['required_mhz']:g} ({slack:+.1%})")
        if slack < 0:
            missed[name] = clock
    for name, use in found["utilization"].items():
        print(f"{name:14} {use['used']:6} of {use['available']} ({use['used'] / use['available']:.0%})")
    print(f"seed {found['seed']}, {found['seconds']} s")
    return missed


# How big it is ----------------------------------------------------------------------------------------------------

# The same machine on the same tools: 6 step generators, 6 encoders, 6 PWM, 12 inputs, 12 outputs, 5A-75B, 40 MHz, Etherbone in
# gateware instead of a CPU. LiteX-CNC 1.3.4 was placed and routed with yosys 0.70 and nextpnr 0.11.1, one seed; Lcnc (f6c0d75) was
# elaborated and simulated, not placed.
PEERS = {
    "LiteX-CNC 1.3.4, as mill6": {"lut4": 9461, "ccu2c": 2160, "ff": 7412, "ebr": 4, "dsp": 0, "lutram": 150, "trellis_comb": 15399},
    "Lcnc f6c0d75, as mill6": None,
}
AVAILABLE = 24_288  # TRELLIS_COMB of an LFE5U-25F
_COLUMNS = (("LUT4", "lut4"), ("CCU2C", "ccu2c"), ("FF", "ff"), ("EBR", "ebr"), ("DSP", "dsp"), ("COMB", "trellis_comb"))


def bench(root, out, report=None, seed=None, document=None):
    """Synthesises and packs every core alone and the named boards, and prints what they cost. With a seed it places and routes
    the boards, too.

    COMB is what nextpnr packs: LUTs, two per carry cell and the cells it adds to get in and out of a carry chain, LUT RAM. A core
    alone is mapped for area, because nothing tells which of its paths matter; in a board the tools know.
    """
    out = Path(out).resolve()
    cores, boards = {}, {}
    sources = " ".join(str(source) for source in sorted(ferro.RTL.glob("*.sv")))
    for source in sorted(ferro.RTL.glob("*.sv")):
        folder = out / source.stem
        folder.mkdir(parents=True, exist_ok=True)
        script = f"read_verilog -sv {sources}; {ecp5.ABC9_AREA}; synth_ecp5 -top {source.stem} -json {TOP}.json; tee -o stat.txt stat"
        _tool("yosys", ["-q", "-p", script], folder, "yosys.log")
        cores[source.stem] = _synthesis(folder / "stat.txt") | _packed(folder, ("--25k", "--package", "CABGA256", "--speed", "6"))
    for name in ("none", "mill6", "max"):
        board = read_board(root / "boards" / f"{'max' if name == 'none' else name}.toml")
        if name == "none":
            for kind in ("stepgen", "encoder", "pwm", "gpio_in", "gpio_out"):
                setattr(board, kind, [])
        folder = out / name
        _bare_synthesis(ecp5.BoardSoC(board, all_pins=name == "mill6"), folder)
        boards[name] = _synthesis(folder / "stat.txt") | _packed(folder, ("--lpf", f"{TOP}.lpf", *_device(board)))
        if seed is not None and name != "none":
            _place(board, folder, seed, "--lpf-allow-unconstrained")
            boards[name]["clocks"] = _clocks(board, json.loads((folder / "nextpnr.json").read_text()))
            boards[name]["seed"] = seed
    text = "\n".join(size_tables(cores, boards)) + "\n"
    print(text)
    if document:
        Path(document).write_text(_SIZE_DOC + text, encoding="utf-8", newline="\n")
    if report:
        Path(report).parent.mkdir(parents=True, exist_ok=True)
        Path(report).write_text(json.dumps({"boards": boards, "cores": cores, "peers": PEERS, "available": AVAILABLE}, indent=2) + "\n")
    return 0


_SIZE_DOC = """<!-- Written by `cargo xtask bench gateware`; do not edit. -->
# Size

What the gateware costs on an LFE5U-25F-6 (24 288 TRELLIS_COMB, 24 288 FF, 56 EBR, 28 DSP), with the tools of
`gateware/requirements.txt`. COMB is counted after packing: LUTs, two for each carry cell and those that lead in and out of a carry
chain, four and two for each LUT RAM. It is what the placer has to find room for, and the figure to compare.

A core is measured alone; `tally`, `edges` and `gpio` are there once for all channels (16, 16, 32 + 32), each encoder has two
`debounce` inside, each encoder and each step generator a `latch` beside it. `max` has no pins on a 5A-75B: its inputs come from a
shift register behind one pad and its outputs leave as a parity through another, so that nothing is optimised away (about 40 LUTs).
It is packed, not placed: nextpnr's placer was given up in its first legalisation. Without synchronous resets the same netlist passes
that in 20 s, so what is short is not room but resets: a tile of eight flip-flops takes two different ones, and `max` has 345.

The peers' figures are of the same tools and the same channels: 6 step generators, 6 encoders, 6 PWM, 12 + 12 I/O, 40 MHz,
Etherbone in gateware and no CPU. LiteX-CNC was placed and routed once; Lcnc was elaborated and simulated, never placed.

"""


def size_tables(cores, boards):
    """The cores alone; the boards beside the peers'; the clocks, where they were routed."""
    def row(name, c):
        return f"| {name} | " + " | ".join(f"{c[key]:,}".replace(",", " ") for _, key in _COLUMNS) + " |"

    def head(what, columns):
        return [f"| {what} | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]

    columns = [name for name, _ in _COLUMNS]
    yield from head("core", columns)
    yield from (row(name, c) for name, c in cores.items())
    yield ""
    yield from head("board", columns)
    for name, what in (("none", "no channel: CPU, MAC, memories, timebase, watchdog"), ("mill6", "mill6: 6 + 6 + 6, 12 + 12"), ("max", "max: 16 + 16 + 16, 32 + 32")):
        yield row(what, boards[name])
    sets = rm.MAX_STEPGEN
    yield row("of max, per step generator + encoder + PWM + 2 inputs + 2 outputs, banks included",
              {key: round((boards["max"][key] - boards["none"][key]) / sets) for _, key in _COLUMNS})
    for name, c in PEERS.items():
        yield row(name, c) if c else f"| {name} | " + " | ".join("not measured" for _ in _COLUMNS) + " |"
    free = AVAILABLE - boards["max"]["trellis_comb"]
    yield ""
    yield f"`max` leaves {free:,} of {AVAILABLE:,} COMB free: {free / AVAILABLE:.1%}.".replace(",", " ")
    routed = {name: b for name, b in boards.items() if "clocks" in b}
    if routed:
        yield ""
        yield from head("placed and routed", ["clock", "asked, MHz", "reached, MHz", "slack", "seed"])
        for name, b in routed.items():
            for clock, f in b["clocks"].items():
                slack = f["achieved_mhz"] / f["required_mhz"] - 1
                yield f"| {name} | {clock} | {f['required_mhz']:g} | {f['achieved_mhz']:.1f} | {slack:+.1%} | {b['seed']} |"


def _packed(folder, args):
    """TRELLIS_COMB after packing: what the placer has to find room for."""
    _tool("nextpnr-ecp5", ["--json", f"{TOP}.json", "--lpf-allow-unconstrained", "--pack-only", "--write", "packed.json", *args], folder, "pack.log")
    (module,) = json.loads((folder / "packed.json").read_text())["modules"].values()
    return {"trellis_comb": sum(cell["type"] == "TRELLIS_COMB" for cell in module["cells"].values())}


def _bare_synthesis(soc, folder):
    """A board synthesised, whether or not it has pins; pins without a ball go wherever the placer puts them."""
    folder.mkdir(parents=True, exist_ok=True)
    here = os.getcwd()
    try:
        soc.platform.toolchain._yosys_cmds.append(ecp5.ABC9)
        soc.platform.build(soc, build_dir=str(folder), build_name=TOP, run=False)
    finally:
        os.chdir(here)
    lpf = (folder / f"{TOP}.lpf").read_text().splitlines(keepends=True)
    (folder / f"{TOP}.lpf").write_text("".join(line for line in lpf if 'SITE "X"' not in line))
    script = (folder / f"{TOP}.ys").read_text() + "\ntee -o stat.txt stat\n"
    (folder / f"{TOP}.ys").write_text(script)
    _tool("yosys", ["-q", f"{TOP}.ys"], folder, "yosys.log")
