#!/usr/bin/env python3
"""Prints an image's use of ROM and RAM, as text or, with --json, for `xtask bench`. It reads the
ELF without binutils."""

import json
import re
import struct
import sys
from pathlib import Path

# The linker enforces them, this script only prints the rest.
MEMORY = (Path(__file__).parent.parent / "memory.x").read_text(encoding="utf-8")
ROM, RAM = (int(size, 16) for size in re.findall("LENGTH = (0x[0-9a-f]+)", MEMORY))


def sections(path):
    with open(path, "rb") as file:
        data = file.read()
    assert data[:5] == b"\x7fELF\x01", f"{path}: not a 32-bit ELF"
    offset, = struct.unpack_from("<I", data, 32)
    size, count, names = struct.unpack_from("<HHH", data, 46)
    rows = [struct.unpack_from("<10I", data, offset + size * n) for n in range(count)]
    for name, kind, flags, _address, _at, length, *_ in rows:
        start = rows[names][4] + name
        yield data[start:data.index(b"\0", start)].decode(), flags, kind, length


def main():
    sums = dict.fromkeys(("text", "rodata", "window", "data", "bss", "uninit", "stack"), 0)
    for name, flags, _kind, length in sections(sys.argv[1]):
        if name.lstrip(".") in sums and flags & 2:
            sums[name.lstrip(".")] += length
        elif name == ".stack":
            sums["stack"] = length
    rom = sums["text"] + sums["rodata"] + sums["data"]
    ram = sums["window"] + sums["data"] + sums["bss"] + sums["uninit"]
    if "--json" in sys.argv:
        print(json.dumps({**sums, "rom": rom, "rom_size": ROM, "ram": ram, "ram_size": RAM}))
        return
    print("  ".join(f"{name} {size}" for name, size in sums.items()))
    print(f"ROM {rom} of {ROM} bytes, RAM {ram} of {RAM} bytes, {RAM - ram} left for the stack")


main()
