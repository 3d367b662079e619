#!/usr/bin/env python3
"""Writes what the twin knows of a board where nothing has been elaborated: NAME/board.bin and NAME/manifest.json.

The crate `config` stays the only reader of board files; this needs Python and cargo, and no tool of the gateware.

    python3 sim/boards/regen.py [--out DIR] [NAME...]
"""

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc.board import blob, read_board  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=ROOT / "sim" / "boards")
    parser.add_argument("names", nargs="*", default=["75b_v8_14o11i6s6e6p", "max", "mill6"])
    args = parser.parse_args()
    for name in args.names:
        board = read_board(ROOT / "boards" / f"{name}.toml")
        folder = args.out / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "board.bin").write_bytes(blob(board))
        manifest = {"board": board.name, "sys_clk_hz": board.sys_clk_hz, "generator": "sim/boards/regen.py, do not edit"}
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", newline="\n")


if __name__ == "__main__":
    main()
