#!/usr/bin/env python3
"""Runs a Verilated SoC with its firmware from power-up on, for the compiler's profile.

    PYTHONPATH=gateware train.py LIBRARY FIRMWARE.elf

The library was compiled to count what it executes (`build.sh`), and writes the counts when this
ends. Most of what a simulated board does is what it does without a frame: the CPU's loop, and
cores that wait.
"""

import ctypes
import sys

from ferrocnc.build import read_image

RESET_CLOCKS = 32
CLOCKS = 300_000


def main(library: str, firmware: str) -> None:
    """Switches the board on and lets it run."""
    shim = ctypes.CDLL(library)
    shim.fc_new.restype = ctypes.c_void_p
    soc = ctypes.c_void_p(shim.fc_new())
    # The first clock edge fills the ROM with what was elaborated.
    shim.fc_let_run(soc, 1, 1)
    for index, word in enumerate(read_image(firmware)):
        shim.fc_rom_write(soc, index, ctypes.c_uint32(word))
    shim.fc_let_run(soc, RESET_CLOCKS, 1)
    shim.fc_let_run(soc, CLOCKS, 0)
    shim.fc_free(soc)


if __name__ == "__main__":
    main(*sys.argv[1:])
