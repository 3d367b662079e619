#!/usr/bin/env python3
"""Makes the services from its ELF file: the bytes from the SDRAM's first on, length and magic
after them, the CRC in front. The layout is defined in `firmware::services::abi`."""

import struct
import sys
import zlib
from pathlib import Path

MAGIC, ORIGIN, ROOM = 0x424F4A46, 0x4000_0000, 512 * 1024


def image(elf):
    """The bytes at ORIGIN."""
    assert elf[:5] == b"\x7fELF\x01", "not a 32-bit ELF"
    table, = struct.unpack_from("<I", elf, 28)
    size, count = struct.unpack_from("<HH", elf, 42)
    out = bytearray()
    for n in range(count):
        kind, at, _, address, length, *_ = struct.unpack_from("<8I", elf, table + size * n)
        if kind == 1 and length:
            end = address - ORIGIN + length
            assert address >= ORIGIN and end <= ROOM, f"a segment at {address:#x} is outside of the program's room"
            out.extend(bytes(max(0, end - len(out))))
            out[address - ORIGIN:end] = elf[at:at + length]
    return bytes(out)


def complete(data):
    """Adds the last words, which locate the program, and the CRC of all words but the first, each
    highest byte first."""
    data = bytearray(data + bytes(-len(data) % 4))
    data += struct.pack("<2I", len(data) + 8, MAGIC)
    words = struct.unpack(f"<{len(data) // 4 - 1}I", data[4:])
    struct.pack_into("<I", data, 0, zlib.crc32(struct.pack(f">{len(words)}I", *words)))
    return bytes(data)


def main():
    elf, out = map(Path, sys.argv[1:3])
    data = complete(image(elf.read_bytes()))
    if not out.exists() or out.read_bytes() != data:
        out.write_bytes(data)
    print(f"services {len(data)} bytes of {ROOM}, with .bss and stack after them")


if __name__ == "__main__":
    main()
