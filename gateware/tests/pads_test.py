"""The pads of an image alone, through the real tools: each line of the headers is packed, has a
register for its level and one for its direction, and powers up so that it does not drive."""

import json
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from litex.gen import LiteXModule  # noqa: E402
from migen import ClockDomain, Signal  # noqa: E402

from ferrocnc import build, ecp5, tools  # noqa: E402
from ferrocnc.board import PlatformImage  # noqa: E402

# Each with its own balls.
CARDS = ("5a-75b-7.0", "5a-75b-8.0", "5a-75b-8.2")


class Pads(LiteXModule):
    """Every line drives what its neighbour saw, while that one is high."""

    def __init__(self, board):
        self.platform = platform = ecp5._Platform(board, all_pins=True)
        self.cd_sys = ClockDomain(reset_less=True)
        self.comb += self.cd_sys.clk.eq(platform.request("clk"))
        platform.request("eth_clocks")
        lines = [Signal() for _ in board.lines]
        around = [*lines[1:], lines[0]]
        pads = SimpleNamespace(line_levels=around, line_drives=around, line_seen=lines, key=Signal())
        ecp5.BoardSoC._lines(self, platform, board, pads)


def registers_of(top):
    """The flip-flops of the levels and directions of all lines, as yosys has them."""
    cells = top["cells"].values()
    of = {cell["connections"]["Q"][0]: cell for cell in cells if cell["type"] == "TRELLIS_FF"}
    lines = {port["bits"][0] for name, port in top["ports"].items() if name.startswith("line")}
    pads = [cell["connections"] for cell in cells if cell["type"] == "TRELLIS_IO" and cell["connections"]["B"][0] in lines]
    return [of[pad[pin][0]] for pad in pads for pin in "IT"]


def pads_of(card):
    """The registers, and the lines that have in their pad one for the level and one for the
    direction."""
    board = PlatformImage(card, None).read()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        pads = Pads(board)
        pads.platform.build(pads, build_dir=str(folder), build_name="top", run=False)
        tools.run("yosys", ["-q", "-p", "read_verilog top.v; synth_ecp5 -top top -json top.json"], folder, "yosys.log")
        tools.run("nextpnr-ecp5", ["--json", "top.json", "--lpf", "top.lpf", "--textcfg", "top.config", *build._device(board)], folder, "nextpnr.log")
        tools.run("ecppack", ["top.config", "top.bit"], folder, "ecppack.log")
        config = (folder / "top.config").read_text()
        registers = registers_of(json.loads((folder / "top.json").read_text())["modules"]["top"])
    return registers, config.count("DATAMUX_OREG IOLDO"), config.count("TRIMUX_TSREG IOLTO")


def main():
    for card in CARDS:
        registers, levels, directions = pads_of(card)
        # The tools' database has no registers for one pad of the 5A-75B 7.0: they are in the
        # fabric.
        lines = 56 - (card == "5a-75b-7.0")
        assert (len(registers), levels, directions) == (112, lines, lines), (card, len(registers), levels, directions)
        # Not driven, with the level of the pull-up.
        assert all(register["parameters"]["REGSET"] == "SET" for register in registers), card
        print(f"PASS {card}: 56 lines are packed, {lines} with their registers in the pad, and power up undriven")


if __name__ == "__main__":
    main()
