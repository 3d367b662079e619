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
    device = board.platform.device.split("-")
    (out / "nextpnr.json").unlink(missing_ok=True)
    # A missed clock is judged here, where it can be reported: nextpnr alone would stop before saying what it reached.
    _tool("nextpnr-ecp5", [
        "--json", f"{TOP}.json", "--lpf", f"{TOP}.lpf", "--textcfg", f"{TOP}.config", "--report", "nextpnr.json",
        f"--{device[1].lower().replace('f', 'k')}", "--package", "CABGA256", "--speed", device[2][0],
        "--seed", str(seed), "--timing-allow-fail", *ecp5.PLACER.split()], out, "nextpnr.log")
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
    clocks = {}
    for net, f in data["fmax"].items():
        # nextpnr names a clock after whichever net of it came first, so the core clock is known by what it is required to do.
        name = "eth" if "eth" in net else "sys" if abs(f["constraint"] * 1e6 - board.sys_clk_hz) < 0.01 * board.sys_clk_hz else net
        clocks[name] = {"required_mhz": round(f["constraint"], 2), "achieved_mhz": round(f["achieved"], 2)}
    used = data["utilization"]
    return {
        "board": board.name, "clocks": clocks, "seed": seed, "seconds": round(time.monotonic() - began),
        **_synthesis(out / f"{TOP}.rpt"),
        "trellis_comb": used["TRELLIS_COMB"]["used"],
        "utilization": {k: used[k] for k in ("TRELLIS_COMB", "TRELLIS_FF", "TRELLIS_RAMW", "DP16KD", "MULT18X18D") if k in used},
    }


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


def bench(root, out, report=None):
    """Synthesises and packs every core alone and the named boards, and prints what they cost.

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
        cores[source.stem] = _synthesis(folder / "stat.txt") | _packed(folder)
    for name in ("mill6", "max", "none"):
        board = read_board(root / "boards" / f"{'max' if name == 'none' else name}.toml")
        if name == "none":
            for kind in ("stepgen", "encoder", "pwm", "gpio_in", "gpio_out"):
                setattr(board, kind, [])
        _bare_synthesis(ecp5.BoardSoC(board, all_pins=False), out / name)
        boards[name] = _synthesis(out / name / "stat.txt") | _packed(out / name)
    for line in size_tables(cores, boards):
        print(line)
    if report:
        Path(report).parent.mkdir(parents=True, exist_ok=True)
        Path(report).write_text(json.dumps({"boards": boards, "cores": cores, "peers": PEERS}, indent=2) + "\n")
    return 0


def size_tables(cores, boards):
    """Two tables: the cores, alone; the boards, beside the peers'."""
    def row(name, c):
        return f"| {name} | " + " | ".join(str(c[key]) for _, key in _COLUMNS) + " |"

    head = " | ".join(name for name, _ in _COLUMNS)
    yield f"| core | {head} |"
    yield "|---" * (len(_COLUMNS) + 1) + "|"
    for name, c in cores.items():
        yield row(name, c)
    yield f"| board | {head} |"
    yield "|---" * (len(_COLUMNS) + 1) + "|"
    for name, what in (("none", "no channel: CPU, MAC, memories, timebase, watchdog"), ("mill6", "mill6: 6 + 6 + 6, 12 + 12"), ("max", "max: 16 + 16 + 16, 32 + 32")):
        yield row(what, boards[name])
    sets = rm.MAX_STEPGEN
    each = {key: round((boards["max"][key] - boards["none"][key]) / sets) for _, key in _COLUMNS}
    yield row("each stepgen + encoder + PWM + 2 inputs + 2 outputs of max, banks included", each)
    for name, c in PEERS.items():
        yield row(name, c) if c else f"| {name} | " + " | ".join("not measured" for _ in _COLUMNS) + " |"
    used = boards["max"]["trellis_comb"]
    yield f"| max leaves free of {AVAILABLE} COMB | | | | | | {AVAILABLE - used} ({1 - used / AVAILABLE:.1%}) |"


def _packed(folder):
    """TRELLIS_COMB after packing: what the placer has to find room for."""
    args = ["--json", f"{TOP}.json", "--lpf-allow-unconstrained", "--pack-only", "--write", "packed.json", "--25k", "--package", "CABGA256", "--speed", "6"]
    if (folder / f"{TOP}.lpf").exists():
        args += ["--lpf", f"{TOP}.lpf"]
    _tool("nextpnr-ecp5", args, folder, "pack.log")
    cells = json.loads((folder / "packed.json").read_text())["modules"][TOP if (folder / f"{TOP}.lpf").exists() else folder.name]["cells"]
    return {"trellis_comb": sum(cell["type"] == "TRELLIS_COMB" for cell in cells.values())}


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
