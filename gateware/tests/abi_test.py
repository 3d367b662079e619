"""The ABI number: it changes with every fact of the exchange's layout and of the register map, but
not with descriptions."""

import logging
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))
logging.disable(logging.WARNING)

from ferrocnc import board, regmap as rm, sim, soc as ferro  # noqa: E402


def main():
    soc = sim.SimSoC(board.read_board(ROOT / "boards" / "max.toml"))
    soc.finalize()
    layout = ferro.LAYOUT.read_text(encoding="utf-8")
    ours = ferro.abi_number(soc)
    assert ours == ferro.abi_number(soc, layout)
    constants = (ROOT / "wire" / "src" / "regmap.rs").read_text(encoding="utf-8")
    assert f"ABI: u32 = 0x{ours:08x};" in constants, "wire/src/regmap.rs is stale: cargo xtask regen"

    # The comment that names the generator is no fact; every other line is, and each makes a number
    # of its own.
    assert ferro.abi_number(soc, layout.replace("# ", "# not ", 1)) == ours
    lines = layout.splitlines()
    seen = {ours}
    for at, line in enumerate(lines):
        if not line.startswith("#"):
            seen.add(ferro.abi_number(soc, "\n".join(lines[:at] + lines[at + 1:])))
    facts = sum(not line.startswith("#") for line in lines)
    assert len(seen) == facts + 1, f"{facts + 1 - len(seen)} lines of the layout do not change the number"

    # The changes that once went unnoticed: the axes that follow no path, and the version.
    for was, is_now in (("stepgen_alone: 6.31:16", "stepgen_alone:"), ("\nwire ", "\nwire 1"), ("FLAG_ALONE_SHIFT 10", "FLAG_ALONE_SHIFT 11")):
        assert layout.count(was) == 1, f"{was!r} is not in layout.txt once"
        assert ferro.abi_number(soc, layout.replace(was, is_now)) != ours, f"{was!r} does not count"

    # In the map a register's description does not count, but its name does.
    gpio = rm.GPIO
    for change, counts in (({"doc": "Other words."}, False), ({"name": "renamed"}, True)):
        regs = (replace(gpio.regs[0], **change),) + gpio.regs[1:]
        rm.BANKS = tuple(replace(b, regs=regs) if b.name == gpio.name else b for b in rm.BANKS)
        assert (ferro.abi_number(soc) != ours) == counts, f"{change}"
    print(f"PASS abi: {facts} facts of the exchange's layout, each in the number")


main()
