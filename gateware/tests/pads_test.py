"""The pads of an image alone, through the real tools: each line of the headers is packed, with a
register for its level and one for its direction."""

import re
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


def pads_of(card):
    board = PlatformImage(card, None).read()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        pads = Pads(board)
        pads.platform.build(pads, build_dir=str(folder), build_name="top", run=False)
        tools.run("yosys", ["-q", "-p", "read_verilog top.v; synth_ecp5 -top top -json top.json"], folder, "yosys.log")
        tools.run("nextpnr-ecp5", ["--json", "top.json", "--lpf", "top.lpf", "--textcfg", "top.config", *build._device(board)], folder, "nextpnr.log")
        tools.run("ecppack", ["top.config", "top.bit"], folder, "ecppack.log")
        config = (folder / "top.config").read_text()
    directions = len(re.findall(r"TRIMUX_TSREG IOLTO", config))
    return len(board.lines), directions


def main():
    for card in CARDS:
        lines, directions = pads_of(card)
        # The tools' database has no register for one pad of the 5A-75B 7.0: it is in the fabric.
        assert (lines, directions) == (56, 55 if card == "5a-75b-7.0" else 56), (card, lines, directions)
        print(f"PASS {card}: {lines} lines are packed, {directions} with registers in their pad")


if __name__ == "__main__":
    main()
