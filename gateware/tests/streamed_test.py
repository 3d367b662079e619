"""A board for jobs that a PC streams, as it is elaborated for simulation: with the segments core,
and without the SDRAM."""

import re
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import board, sim  # noqa: E402


def instances(text, folder):
    """The names of the cores in it, the name of every signal, and the files it uses."""
    (Path(folder) / "platforms").symlink_to(ROOT / "boards" / "platforms")
    path = Path(folder) / "plotter.toml"
    path.write_text(text, encoding="utf-8")
    manifest = sim.elaborate(board.read_board(path), Path(folder) / "out")
    top = (Path(folder) / "out" / "sim.v").read_text(encoding="utf-8")
    cores = set(re.findall(r"^(\w+) (?:#\(|\w+ ?\()", top, re.M))
    return cores, re.findall(r"sdram\w*", top), {Path(file).name for file in manifest["verilog"]}


def main():
    text = (ROOT / "boards" / "plotter.toml").read_text(encoding="utf-8")
    assert text.count("jobs = 3\n") == 1
    with tempfile.TemporaryDirectory() as folder:
        cores, signals, files = instances(text, folder)
        assert {"segments", "sdram", "sdram_chip"} <= cores and signals and "sdram_chip.sv" in files, f"plotter has {sorted(cores)}"
    with tempfile.TemporaryDirectory() as folder:
        cores, signals, files = instances(text.replace("jobs = 3\n", "jobs = 3\nsdram = false\n"), folder)
        assert "segments" in cores and not {"sdram", "sdram_chip"} & cores, f"without SDRAM it has {sorted(cores)}"
        assert not signals and "sdram_chip.sv" not in files, f"without SDRAM there are {sorted(set(signals))}"
    print("PASS streamed: the segments core without the SDRAM")


main()
