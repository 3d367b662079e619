"""Packs a routed design: firmware and board information into its memories, then the files a board
is flashed and updated with.

    NAME.bit         the image: `ferrocnc update`, `ferrocnc flash load`
    NAME-golden.bit  the same, marked as the golden one by its trailer
    NAME.svf         the image for other JTAG tools, until power-off
    NAME.flash       the complete contents of a new board's flash: `ferrocnc flash write`

The services of a board with SDRAM follow the bitstream in all files but the SVF; the length and the
CRC of an image include them. A golden image for a flash of 2 MiB has none: its place is two thirds
of a slot, and what it is for (exchange, Etherbone, discovery, update, ARP, ping) is in the ROM.

Nothing in them depends on the date, the folder or the machine. `wire::flash`, `wire::images` and
`host::image` define the meaning of the bytes, and parse these files in the test level `bitstream`.
"""

import hashlib
import re
import shutil
import zlib

from . import VERSION, regmap as rm, soc as ferro, tools
from .board import BoardError

PREAMBLE = bytes.fromhex("ffffbdb3")
_VERIFY_ID = bytes.fromhex("e2000000")
_PAGE, _SECTOR = 0x100, 0x1000
_META_MAGIC, _META_VERSION = 0x4649_4D47, 1  # "FIMG"
_STUBS = 0
# Flash size: slot A, golden (first byte, byte after the last).
_LAYOUTS = {
    0x40_0000: ((0x01_0000, 0x10_0000), (0x30_0000, 0x3F_F000)),
    0x20_0000: ((0x01_0000, 0x0C_0000), (0x18_0000, 0x1F_F000)),
}
# Flash size: the golden image has the services, too.
_GOLDEN_SERVES = {0x40_0000: True, 0x20_0000: False}
FILES = (".bit", "-golden.bit", ".svf", ".flash")
_ROLES = {rm.ROLE_IMAGE: "", rm.ROLE_GOLDEN: "-golden"}


def pack(board, work, routed, firmware, out, program=b""):
    """Writes the four files into `out` from the routed text configuration `work / routed`, the
    ROM's words and the services. Returns their part of the report."""
    missing = [name for name in ("cs", "mosi", "miso", "bytes") if name not in board.platform.flash]
    if missing or board.platform.flash["bytes"] not in _LAYOUTS:
        raise BoardError(board.platform.file, "flash", "needs cs, mosi, miso and bytes; images are made for flashes of 2 and 4 MiB")
    build = build_id(_memories(board, work, routed, firmware, 0, 0, "unsigned.config") + program)
    part = re.search(r"^\.comment Part: (\S+)$", (work / routed).read_text(), re.M)[1]
    images = {}
    for role, suffix in _ROLES.items():
        name = f"packed{suffix}"
        _memories(board, work, routed, firmware, build, role, f"{name}.config")
        svf = ["--svf", f"{name}.svf"] if role == rm.ROLE_IMAGE else []
        tools.run("ecppack", ["--compress", *svf, f"{name}.config", f"{name}.bit"], work, "ecppack.log")
        services = program_of(board, role, program)
        images[role] = with_program(body((work / f"{name}.bit").read_bytes()), services)
        check_room(board, role, images[role], services)
    for role, suffix in _ROLES.items():
        _write(out / f"{board.name}{suffix}.bit", header(board, part, build, images[role]) + images[role])
    _write(out / f"{board.name}.svf", (work / "packed.svf").read_bytes())
    _write(out / f"{board.name}.flash", flash(board, build, images[rm.ROLE_IMAGE], images[rm.ROLE_GOLDEN]))
    return {"build": f"{build:08x}", "bytes": len(images[rm.ROLE_IMAGE]), "crc": f"{zlib.crc32(images[rm.ROLE_IMAGE]):08x}"}


def _write(path, data):
    """Writes all of it or nothing: an existing file is complete."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


# Memories -----------------------------------------------------------------------------------------

def trailer(build, role):
    return [rm.TRAILER_MAGIC, build, role, 0]


def rom(firmware, build, role):
    """The ROM's contents: the firmware, then the trailer in its last words."""
    kept = len(firmware) - rm.ROM_TRAILER // 4
    return firmware[:kept] + trailer(build, role)


def build_id(config):
    """First 32 bits of the SHA-256 over the routed design with its firmware, and the services:
    two different builds have different ids."""
    return int.from_bytes(hashlib.sha256(config).digest()[:4], "big")


def _memories(board, work, routed, firmware, build, role, name):
    """Replaces the random words with ROM and board ROM. Returns the configuration, which is `work /
    name`."""
    first, second = ferro.place_words()
    words = rom(firmware, build, role) + ferro.board_words(board.blob)
    for file, content in (("from.hex", first + second), ("to.hex", words)):
        (work / file).write_text("".join(f"{word:08x}\n" for word in content), newline="\n")
    tools.run("ecpbram", ["-i", routed, "-o", name, "-f", "from.hex", "-t", "to.hex"], work, "ecpbram.log")
    return (work / name).read_bytes()


# A block RAM's 2048 bytes of eight bits, or 9 in the wider shapes, as ecpbram splits them: width of
# a port, bits of a word of the text configuration, columns of 512 bits.
_SHAPES = ((1, 8, 32), (2, 8, 32), (4, 8, 32), (9, 9, 36), (18, 9, 36), (36, 9, 36))


def columns(words):
    """A block RAM's contents as columns of 512 bits: ((width of a port, column), bits)."""
    for width, bits, columns in _SHAPES:
        for column in range(columns):
            at = [row * width + column % width + column // width * 512 * width for row in range(512)]
            yield (width, column), sum((words[bit // bits] >> bit % bits & 1) << row for row, bit in enumerate(at))


def _bram_words(config):
    """{block RAM: its words} of a text configuration."""
    found = {}
    for match in re.finditer(r"^\.bram_init (\d+)\n((?:[0-9a-f ]+\n)+)", config, re.M):
        found[int(match[1])] = [int(word, 16) for word in match[2].split()]
    return found


def contents(routed, config):
    """ROM and board ROM in a configuration: (words, words). The random words in the routed design
    tell the place of each column of 512 bits; `config` may come from anywhere, for example from
    unpacking a finished bitstream."""
    first, second = ferro.place_words()
    pattern = first + second
    where = {}
    for block in range(len(pattern) // 512):
        rows = pattern[block * 512:][:512]
        for bit in range(32):
            where[sum((word >> bit & 1) << row for row, word in enumerate(rows))] = block, bit
    words, seen = [0] * len(pattern), set()
    there = _bram_words(config)
    for bram, before in _bram_words(routed).items():
        places = {place: where[column] for place, column in columns(before) if column in where}
        if not places:
            continue
        for place, column in columns(there[bram]):
            if place in places and places[place] not in seen:
                block, bit = places[place]
                seen.add(places[place])
                for row in range(512):
                    words[block * 512 + row] |= (column >> row & 1) << bit
    absent = len(where) - len(seen)
    if absent:
        raise ValueError(f"{absent} of {len(where)} columns of the ROMs are nowhere in the routed design")
    return words[:len(first)], words[len(first):]


# Files --------------------------------------------------------------------------------------------

def body(file):
    """A bitstream file's bytes from the preamble on."""
    at = file.find(PREAMBLE)
    if at < 0:
        raise ValueError("a bitstream without a preamble")
    return file[at:]


def with_program(data, program):
    """An image: a bitstream, and at its end, where the ROM looks for it, the services of a
    board with SDRAM."""
    return data + b"\xff" * (-len(data) % 4) + program if program else data


def program_of(board, role, program):
    """The services in the image of this role."""
    return program if role == rm.ROLE_IMAGE or _GOLDEN_SERVES[board.platform.flash["bytes"]] else b""


def idcode(data):
    """The FPGA's id in the bitstream."""
    at = data.index(_VERIFY_ID) + len(_VERIFY_ID)
    return int.from_bytes(data[at:at + 4], "big")


def header(board, part, build, data):
    """The comment header: what the file is, and how to check that it is complete."""
    lines = (
        "FerroCNC {}.{}.{}".format(*VERSION), f"Board: {board.name}", f"Platform: {board.platform.name}", f"Part: {part}",
        f"Build: {build:08x}", f"Length: {len(data)}", f"CRC-32: {zlib.crc32(data):08x}",
    )
    return b"\xff\0" + b"".join(line.encode("ascii") + b"\0" for line in lines) + b"\xff"


def _name(text):
    data = text.encode("ascii")
    if len(data) > 32:
        raise ValueError(f"{text}: longer than 32 characters")
    return data.ljust(32, b"\0")


def meta_page(board, build, data):
    """The meta page of an image."""
    words = (_META_MAGIC, _META_VERSION, len(data), zlib.crc32(data), build, idcode(data))
    page = b"".join(word.to_bytes(4, "big") for word in words) + _name(board.name) + _name(board.platform.name)
    page += zlib.crc32(page).to_bytes(4, "big")
    return page.ljust(_PAGE, b"\xff")


def jump_page(target):
    """A bitstream of nothing but a JUMP, as libtrellis' `generate_jump` makes it: preamble, control
    register 0 := 0, JUMP with the flash's slow read (03) and the address."""
    page = b"\xff" * 16 + PREAMBLE + b"\xff" * 4 + bytes.fromhex("22000000 00000000 7e000000 03") + target.to_bytes(3, "big")
    return page.ljust(_PAGE, b"\xff")


def room(board, role):
    """Bytes of the place of an image in the flash."""
    start, end = _LAYOUTS[board.platform.flash["bytes"]][role == rm.ROLE_GOLDEN]
    return end - start - _SECTOR


def check_room(board, role, data, program=b""):
    """Refuses an image that does not fit into its place in the flash."""
    most = room(board, role)
    missing = len(data) - most
    if missing <= 0:
        return
    name = f"{board.name}{_ROLES[role]}.bit"
    problem = f"{name} has {len(data)} bytes; its place in the flash of {board.platform.name} has {most}, {missing} too few"
    if program and missing <= len(program) and not board.lines:
        problem += f"; with sdram = false in the board file it is without the services, {len(program)} bytes, and fits"
        if board.jobs:
            problem += "; without jobs in the board file the services are shorter, and may fit"
    raise BoardError(board.file, "", problem)


def flash(board, build, image, golden):
    """The whole flash: a stub to slot A, slot A, the golden image, the page the FPGA reads if there
    is no live stub at 0. Slot B and the settings are left erased."""
    size = board.platform.flash["bytes"]
    out = bytearray(b"\xff" * size)
    slot, last = _LAYOUTS[size]
    pages = [(_STUBS, jump_page(slot[0])), (size - _PAGE, jump_page(last[0]))]
    for role, (start, end), data in ((rm.ROLE_IMAGE, slot, image), (rm.ROLE_GOLDEN, last, golden)):
        check_room(board, role, data)
        pages += [(start, data), (end - _SECTOR, meta_page(board, build, data))]
    for at, data in pages:
        out[at:at + len(data)] = data
    return bytes(out)


# Proof --------------------------------------------------------------------------------------------

def prove(board, work, routed, firmware, out, program=b""):
    """Unpacks the finished files and compares: the block RAMs contain the firmware with its trailer
    and the board's own description, and packing the routed design again gives the same bytes.
    Yields what was proven."""
    said = (work / routed).read_text()
    files = [f"{board.name}{end}" for end in FILES]
    before = {name: (out / name).read_bytes() for name in files}
    build = None
    for role, suffix in _ROLES.items():
        name = f"{board.name}{suffix}.bit"
        services = program_of(board, role, program)
        (work / "unpack.bit").write_bytes(before[name].removesuffix(services))
        if not before[name].endswith(services):
            raise ValueError(f"{name}: does not end with the services")
        tools.run("ecpunpack", ["unpack.bit", "unpacked.config"], work, "ecpunpack.log")
        found, blob = contents(said, (work / "unpacked.config").read_text())
        build = found[-3]
        _same(name, "the firmware", found, rom(firmware, build, role))
        _same(name, "the board's description", blob, ferro.board_words(board.blob))
        if f"Build: {build:08x}\0".encode() not in before[name][:400]:
            raise ValueError(f"{name}: its header does not say build {build:08x}, as its trailer does")
        yield f"{name}: unpacked, its ROM holds the firmware word for word, its trailer says build {build:08x}, role {role}"
    elsewhere = work.parent / "packed" / "once-more"
    shutil.rmtree(elsewhere, ignore_errors=True)
    elsewhere.mkdir(parents=True)
    shutil.copyfile(work / routed, elsewhere / routed)
    pack(board, elsewhere, routed, firmware, elsewhere, program)
    for name in files:
        if (elsewhere / name).read_bytes() != before[name]:
            raise ValueError(f"{name}: packed again, in another folder, it has other bytes")
    shutil.rmtree(elsewhere.parent)
    yield f"{board.name}: packed again in another folder, all {len(files)} files have the same bytes"
    _same_jump(work)
    yield "a jump page is byte for byte what ecpmulti writes"


def prove_services(board, work, routed, firmware, out, program):
    """Packs the routed design of a board without SDRAM with the services, as that of another board,
    into `out / "with-services"`: the test level `bitstream` reads those files, too. Yields what was
    proven."""
    folder, scratch = out / "with-services", work.parent / "packed"
    for empty in (folder, scratch):
        shutil.rmtree(empty, ignore_errors=True)
        empty.mkdir(parents=True)
    shutil.copyfile(work / routed, scratch / routed)
    pack(board, scratch, routed, firmware, folder, program)
    for role, suffix in _ROLES.items():
        name = f"{board.name}{suffix}.bit"
        found = body((folder / name).read_bytes())
        bitstream = body((scratch / f"packed{suffix}.bit").read_bytes())
        services = program_of(board, role, program)
        _same(name, "the bitstream and the services", found, with_program(bitstream, services))
        yield f"{name}: packed with {len(services)} bytes of services, {len(found)} of {room(board, role)} bytes"
    shutil.rmtree(scratch)


def _same_jump(work):
    """Compares with ecpmulti's own jump page. It requires three images, which it unpacks, and knows
    flashes by megabits."""
    golden, size = 0x20_0000, 0x40_0000
    tools.run("ecpmulti", ["--input", "unpack.bit", "--golden", "unpack.bit", "--goldenaddr", hex(golden), "--input", "unpack.bit",
                           "--address", "0x300000", "--flashsize", str(size >> 17), "multi.bin"], work, "ecpmulti.log")
    theirs = (work / "multi.bin").read_bytes()[size - _PAGE:]
    ours = jump_page(golden)
    if not theirs or ours[:len(theirs)] != theirs or ours[len(theirs):].strip(b"\xff"):
        raise ValueError(f"ecpmulti's jump page is {theirs.hex()}, ours {ours.hex()}")


def _same(name, what, found, wanted):
    differ = [n for n, (a, b) in enumerate(zip(found, wanted, strict=True)) if a != b]
    if differ:
        n = differ[0]
        raise ValueError(f"{name}: {what} inside differs in {len(differ)} words, first at byte {4 * n:#x}: {found[n]:08x}, not {wanted[n]:08x}")
