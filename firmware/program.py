#!/usr/bin/env python3
"""Makes the services from its ELF file: the bytes from the SDRAM's first on, length and magic
after them, the CRC in front. The layout is defined in `firmware::services::abi`."""

import struct
import sys
import zlib
from pathlib import Path


def symbols(elf):
    """The names of the ELF that `build.rs` makes for this script, without `__services_`."""
    assert elf[:5] == b"\x7fELF\x01", "not a 32-bit ELF"
    table, = struct.unpack_from("<I", elf, 32)
    size, count = struct.unpack_from("<HH", elf, 46)
    sections = [struct.unpack_from("<10I", elf, table + size * n) for n in range(count)]
    found = {}
    for _, kind, _, _, at, length, link, *_ in sections:
        if kind != 2:
            continue
        names = sections[link][4]
        for entry in range(at, at + length, 16):
            name, value = struct.unpack_from("<2I", elf, entry)
            name = elf[names + name:elf.index(b"\0", names + name)]
            for wanted in ("origin", "room", "magic"):
                if name == b"__services_" + wanted.encode():
                    found[wanted] = value
    return found["origin"], found["room"], found["magic"]


def image(elf, origin, room):
    """The bytes at the origin."""
    table, = struct.unpack_from("<I", elf, 28)
    size, count = struct.unpack_from("<HH", elf, 42)
    out = bytearray()
    for n in range(count):
        kind, at, _, address, length, *_ = struct.unpack_from("<8I", elf, table + size * n)
        if kind == 1 and length:
            end = address - origin + length
            assert address >= origin and end <= room, f"a segment at {address:#x} is outside of the program's room"
            out.extend(bytes(max(0, end - len(out))))
            out[address - origin:end] = elf[at:at + length]
    return bytes(out)


def complete(data, magic):
    """Adds the last words, which locate the program, and the CRC of all words but the first, each
    highest byte first."""
    data = bytearray(data + bytes(-len(data) % 4))
    data += struct.pack("<2I", len(data) + 8, magic)
    words = struct.unpack(f"<{len(data) // 4 - 1}I", data[4:])
    struct.pack_into("<I", data, 0, zlib.crc32(struct.pack(f">{len(words)}I", *words)))
    return bytes(data)


def main():
    elf, out = map(Path, sys.argv[1:3])
    elf = elf.read_bytes()
    origin, room, magic = symbols(elf)
    data = complete(image(elf, origin, room), magic)
    if not out.exists() or out.read_bytes() != data:
        out.write_bytes(data)
    print(f"{out.stem} {len(data)} bytes of {room}, with .bss and stack after them")


if __name__ == "__main__":
    main()
