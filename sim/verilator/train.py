#!/usr/bin/env python3
"""Runs a Verilated SoC with its firmware from power-up on, for the compiler's profile.

    train.py LIBRARY FIRMWARE.elf

The library was compiled to count what it executes (`build.sh`), and writes the counts when this
ends. Most of what a simulated board does is what it does without a frame: the CPU's loop, and
cores that wait.
"""

import ctypes
import struct
import sys

SYS, ETH = 1, 2
SYS_CLOCKS = 300_000
ETH_PER_SYS = 125 / 60
RESET_CLOCKS = 32
LINK_1000 = 0b1101
ROM_END = 0x10_0000
PT_LOAD = 1


class Pins(ctypes.Structure):
    """The first of `struct Pins` in shim.cpp, and room for the rest."""

    _fields_ = [
        ("levels", ctypes.c_uint8 * 18),
        ("sys_rst", ctypes.c_uint8),
        ("factory", ctypes.c_uint8),
        ("link_status", ctypes.c_uint8),
        ("rest", ctypes.c_uint8 * 27),
    ]


assert ctypes.sizeof(Pins) == 48


def rom_words(elf: bytes) -> list[int]:
    """What the firmware has in the ROM, which begins at 0."""
    (table,) = struct.unpack_from("<I", elf, 28)
    size, count = struct.unpack_from("<HH", elf, 42)
    rom = bytearray()
    for n in range(count):
        kind, offset, _, place, length = struct.unpack_from("<5I", elf, table + n * size)
        if kind == PT_LOAD and length and place < ROM_END:
            rom.extend(bytes(max(0, place + length - len(rom))))
            rom[place : place + length] = elf[offset : offset + length]
    rom.extend(bytes(-len(rom) % 4))
    return list(struct.unpack(f"<{len(rom) // 4}I", rom))


def main(library: str, firmware: str) -> None:
    """Switches the board on and lets it run."""
    shim = ctypes.CDLL(library)
    shim.fc_new.restype = ctypes.c_void_p
    shim.fc_rise.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64]
    shim.fc_rom_write.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32]
    shim.fc_free.argtypes = [ctypes.c_void_p]
    soc = shim.fc_new()
    pins = Pins(sys_rst=1, link_status=LINK_1000)
    at, rise = ctypes.addressof(pins), shim.fc_rise
    rise(soc, at, SYS | ETH, 0)
    with open(firmware, "rb") as file:
        for index, word in enumerate(rom_words(file.read())):
            shim.fc_rom_write(soc, index, word)
    for _ in range(RESET_CLOCKS):
        rise(soc, at, SYS | ETH, 0)
    pins.sys_rst = 0
    due = 0.0
    for _ in range(SYS_CLOCKS):
        due += ETH_PER_SYS - 1
        rise(soc, at, SYS | ETH, 0)
        while due >= 1:
            rise(soc, at, ETH, 0)
            due -= 1
    shim.fc_free(soc)


if __name__ == "__main__":
    main(*sys.argv[1:])
