"""Bitstream builds without the tools: the choice of the seed, the failures of a build, the layout
of the files."""

import contextlib
import io
import re
import sys
import tempfile
import threading
import time
import zlib
from pathlib import Path
from types import SimpleNamespace

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import build, image, regmap as rm, soc, tools  # noqa: E402
from ferrocnc.board import BoardError, BoardFile  # noqa: E402

TESTS = []


def test(function):
    TESTS.append(function)
    return function


def search(reached, seeds=4, at_once=2, slack=5.0, seconds=None):
    """The result of a search over seeds that reach these (eth, sys): the seed, or the error."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        options = build.Options(seeds=seeds, jobs=at_once, slack=slack)
        design = build.Design(BoardFile("boards/x.toml", {}), Path(folder), options, build.Watch(Path(folder), at_once))
        design.work.mkdir(parents=True)
        design.record = {"seeds": {}}

        def route(seed, lock, cancelled):
            until = time.monotonic() + (seconds or {}).get(seed, 0)
            while time.monotonic() < until:
                if cancelled():
                    raise tools.Cancelled
                time.sleep(0.005)
            eth, sys_ = reached[seed]
            with lock:
                design.record["seeds"][str(seed)] = {"clocks": {
                    "eth": {"required_mhz": 125, "achieved_mhz": eth}, "sys": {"required_mhz": 60, "achieved_mhz": sys_}}}

        design._route = route
        try:
            return design._search(), sorted(map(int, design.record["seeds"]))
        except build.BuildError as e:
            return str(e), None


@test
def a_table_takes_the_place_of_the_one_before_and_leaves_the_rest_of_the_page():
    page = "# Timing\n<!-- images -->\n| old |\n<!-- /images -->\nmore\n"
    assert build.with_table(page, "images", "| new |\n") == page.replace("old", "new")
    try:
        build.with_table(page, "board files", "| new |\n")
        raise AssertionError("a page without marks is written")
    except build.BuildError as e:
        assert "board files" in str(e)


@test
def the_lowest_seed_with_enough_slack_is_taken_in_any_order_of_finish():
    good, bad = (140, 70), (140, 60.5)
    for at_once in (1, 2, 4):
        seed, _ = search({1: bad, 2: good, 3: good, 4: good}, at_once=at_once, seconds={2: 0.1})
        assert seed == 2, f"{at_once} at once: {seed}"
    seed, tried = search({1: good, 2: good, 3: good, 4: good}, at_once=2, seconds={1: 0.02, 2: 60})
    assert (seed, tried) == (1, [1]), "what no longer matters is ended"


@test
def cores_go_to_first_seeds_of_all_boards_before_any_second_one():
    cores, order, gate = build.Cores(1), [], threading.Event()

    def work(turn):
        with cores.one(turn):
            gate.wait()
            order.append(turn)

    turns = [(1, 0), (2, 0), (1, 2), (3, 1), (1, 1), (2, 1)]
    threads = [threading.Thread(target=work, args=(turn,)) for turn in turns]
    for thread in threads:
        thread.start()
        while not (cores._waiting or not cores._free):  # each is in the queue before the next
            time.sleep(0.001)
        time.sleep(0.01)
    gate.set()
    for thread in threads:
        thread.join()
    assert order == sorted(turns), order


@test
def a_missed_clock_fails_and_says_what_was_reached():
    said, _ = search({n: (124.9, 70 + n) for n in range(1, 5)})
    assert "misses a clock" in said and "seed 3: eth 124.9 MHz of 125 (-0.1%), sys 73.0 MHz of 60 (+21.7%)" in said, said


@test
def too_little_slack_fails_and_less_can_be_asked_for():
    reached = {n: (130, 62 + n / 10) for n in range(1, 5)}
    said, _ = search(reached)
    assert "meets every clock, but with 4.0 % slack where 5 % are wanted" in said, said
    assert search(reached, slack=3.5)[0] == 2
    assert search(reached, slack=0)[0] == 1


def board(size, name="x", jobs=0):
    return SimpleNamespace(name=name, jobs=jobs, lines=[], file="boards/x.toml", platform=SimpleNamespace(name="p", file="p.toml", flash={"bytes": size}))


def body(length, seed=0):
    return image.PREAMBLE + bytes.fromhex("ffffffff 3b000000 e2000000 41111043") + bytes((n * 7 + seed) % 251 for n in range(length - 20))


@test
def stubs_images_meta_pages_and_the_jump_page_lie_where_the_board_looks():
    for size, slot, last in ((4 << 20, 0x1_0000, 0x30_0000), (2 << 20, 0x1_0000, 0x18_0000)):
        a, b = body(400_000), body(300_000, 1)
        flash = image.flash(board(size), 0x89AB_CDEF, a, b)
        assert len(flash) == size
        assert flash[:40].hex() == "ff" * 16 + "ffffbdb3ffffffff" + "2200000000000000" + "7e00000003" + f"{slot:06x}"
        assert flash[-256:-216].hex() == "ff" * 16 + "ffffbdb3ffffffff" + "2200000000000000" + "7e00000003" + f"{last:06x}"
        assert flash[slot:slot + len(a)] == a and flash[last:last + len(b)] == b
        for data, meta in ((a, {4 << 20: 0xF_F000, 2 << 20: 0xB_F000}[size]), (b, {4 << 20: 0x3F_E000, 2 << 20: 0x1F_E000}[size])):
            page = flash[meta:meta + 256]
            assert page[:24].hex() == f"46494d4700000001{len(data):08x}{zlib.crc32(data):08x}89abcdef41111043"
            assert page[24:88] == b"x".ljust(32, b"\0") + b"p".ljust(32, b"\0")
            assert page[88:92] == zlib.crc32(page[:88]).to_bytes(4, "big") and page[92:] == b"\xff" * 164
        used = {n >> 12 for n, byte in enumerate(flash) if byte != 0xFF}
        assert not used & set(range({4 << 20: 0x100, 2 << 20: 0xC0}[size], last >> 12)), "slot B and the settings are erased"


@test
def the_layouts_are_those_of_wire_flash():
    text = (ROOT / "wire" / "src" / "flash.rs").read_text(encoding="utf-8")
    for size, areas in image._LAYOUTS.items():
        (said,) = re.findall(rf"{size:#08x} => Some\(Layout \{{(.*?)\n            \}}\)", text.replace("0x40_0000 =>", "0x400000 =>").replace(
            "0x20_0000 =>", "0x200000 =>"), re.S)
        for name, area in zip(("slot_a", "golden"), areas):
            start, end = re.search(rf"{name}: Area \{{\s*start: (\S+),\s*end: (\S+),", said).groups()
            assert (int(start, 0), int(end, 0)) == area, f"{size:#x}: {name}"


def refused(board, role, data, program=b""):
    """Why there is no room for this image; nothing if there is."""
    try:
        image.check_room(board, role, data, program)
    except BoardError as e:
        return str(e)
    return ""


@test
def an_image_too_long_for_its_place_is_refused_with_the_bytes_and_the_way_out():
    for size, rooms in ((4 << 20, (0xE_F000, 0xF_E000)), (2 << 20, (0xA_F000, 0x7_E000))):
        for role, name, room in zip((rm.ROLE_IMAGE, rm.ROLE_GOLDEN), ("x.bit", "x-golden.bit"), rooms):
            program, bitstream = bytes(70_000), body(room - 60_000)
            whole = image.with_program(bitstream, program)
            assert not refused(board(size), role, body(room))
            assert not refused(board(size), role, image.with_program(body(room - 70_000), program), program)
            said = refused(board(size), role, whole, program)
            for part in ("boards/x.toml", f"{name} has {room + 10_000} bytes", f"of p has {room}, 10000 too few", "sdram = false", "70000 bytes, and fits"):
                assert part in said, f"{part!r} is not in {said!r}"
            assert "without jobs" not in said, said
            said = refused(board(size, jobs=3), role, whole, program)
            assert "without jobs in the board file the services are shorter" in said, said
            # Without the services it would not fit, either: no advice that does not help.
            said = refused(board(size), role, image.with_program(body(room + 4), program), program)
            assert "70004 too few" in said and "sdram" not in said, said
            images = [body(100), body(100)]
            images[role == rm.ROLE_GOLDEN] = body(room + 1)
            try:
                image.flash(board(size), 1, *images)
            except BoardError as e:
                assert f"{room}, 1 too few" in str(e), e
            else:
                raise AssertionError("not refused")


@test
def the_cards_with_2_mib_of_flash_have_services_in_two_slots_and_a_golden_image_without():
    # As long as the longer of today's two: its bitstream, and the services.
    bitstream, program = body(460_000), bytes(163_848)
    for name in ("75b_v6_14o11i6s6e6p", "75b_v6_26o23i6p"):
        text = (ROOT / "boards" / f"{name}.toml").read_text(encoding="utf-8")
        assert "5a-75b-6.1" in text and "sdram" not in text and "jobs" not in text, name
    for size, serves in ((2 << 20, False), (4 << 20, True)):
        for role, has in ((rm.ROLE_IMAGE, True), (rm.ROLE_GOLDEN, serves)):
            services = image.program_of(board(size), role, program)
            assert services == (program if has else b""), (size, role)
            assert not refused(board(size), role, image.with_program(bitstream, services), services), (size, role)
    # With them it would not fit.
    assert refused(board(2 << 20), rm.ROLE_GOLDEN, image.with_program(bitstream, program), program)


def config(words, shape):
    """A text configuration with these 32-bit words in its block RAMs, 36 columns of 512 bits each,
    or 32."""
    width, bits, columns = shape
    rows = [words[n:n + 512] for n in range(0, len(words), 512)]
    todo = [[row >> bit & 1 for row in block] for block in rows for bit in range(32)]
    text, n = "", 0
    while todo:
        ram = [0] * 2048
        for column in range(columns):
            for row, value in enumerate(todo.pop(0) if todo else [0] * 512):
                at = row * width + column % width + column // width * 512 * width
                ram[at // bits] |= value << at % bits
        text += f".bram_init {n}\n" + "".join(" ".join(f"{w:03x}" for w in ram[k:k + 8]) + "\n" for k in range(0, 2048, 8)) + "\n"
        n += 1
    return text


@test
def what_was_put_into_block_rams_is_found_again_whatever_their_shape():
    first, second = soc.place_words()
    content = [n * 0x9E37_79B1 & 0xFFFF_FFFF for n in range(len(first) + len(second))]
    for shape in (image._SHAPES[0], image._SHAPES[-1]):
        found = image.contents(config(first + second, shape), config(content, shape))
        assert found[0] + found[1] == content, shape
    short = config(first + second, image._SHAPES[0]).rsplit(".bram_init", 2)[0]
    try:
        image.contents(short, short)
    except ValueError as e:
        assert "nowhere in the routed design" in str(e)
    else:
        raise AssertionError("a missing block RAM was not noticed")


@test
def the_trailer_takes_the_roms_last_words_and_leaves_the_rest():
    firmware = list(range(rm.ROM[1] // 4))
    packed = image.rom(firmware, 0x1234_5678, 2)
    assert packed[-4:] == [0x4654_524C, 0x1234_5678, 2, 0] and packed[:-4] == firmware[:-4]


def main():
    assert threading.active_count() == 1
    for function in TESTS:
        function()
    print(f"PASS bitstream: {len(TESTS)} tests of seeds, slack and where things lie")


main()
