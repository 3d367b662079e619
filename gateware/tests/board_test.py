"""The board reader: what it refuses, and that it says where, what and what to do."""

import sys
import tempfile
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import board, regmap  # noqa: E402

# what is wrong -> (replace this in mill6.toml, by this, what the message must contain)
WRONG = {
    "a pin used twice": ('step = "j1:2"', 'step = "j1:0"', ['stepgen[1].step', '"j1:0"'.strip('"'), "already stepgen[0].step"]),
    "a pin that is not there": ('step = "j1:0"', 'step = "j9:0"', ["stepgen[0].step", "j9:0", "j1, j2"]),
    "a key nobody knows": ('name = "x"\nstep', 'nam = "x"\nname = "x"\nstep', ["stepgen[0].nam", "unknown key"]),
    "a missing key": ("udp_port = 1234", "", ["network.udp_port", "missing", "1234"]),
    "a port out of range": ("udp_port = 1234", "udp_port = 70000", ["network.udp_port", "70000"]),
    "a wrong address": ('"192.168.2.50"', '"192.168.2.500"', ["network.ipv4", "192.168.2.500"]),
    "a group MAC": ('"10:e2', '"11:e2', ["network.mac", "group"]),
    "a clock nobody reaches": ("60_000_000", "600_000_000", ["sys_clk_hz", "600000000"]),
    "a number for a name": ('name = "x"\nstep', 'name = 7\nstep', ["stepgen[0].name", "7"]),
    "a name HAL cannot have": ('name = "x"\nstep', 'name = "X axis"\nstep', ["stepgen[0].name", "X axis"]),
    "two of one name": ('name = "y"\nstep', 'name = "x"\nstep', ["stepgen[1].name", "already"]),
    "a platform nobody has": ('"5a-75b-8.0"', '"5a-75z"', ["platform", "5a-75z", "5a-75b-8.0"]),
    "a polarity that is none": ('active = "low"', 'active = "maybe"', ["ext_reset.active", "maybe"]),
    "an e-stop level that is none": ('estop = "high"', 'estop = "yes"', ["gpio_in[11].estop", "yes", '"high"', '"low"']),
    "an e-stop output": ('pin = "j5:5"', 'pin = "j5:5"\nestop = "high"', ["gpio_out[11].estop", "unknown key", "pin"]),
    "a copy of no pin": ('dir = "j1:1"', 'dir_n = "j1:1"', ["stepgen[0].dir_n", "j1:1", "give dir"]),
    "a mask pin used twice": ('index = "j6:2"', 'mask = "j6:1"', ["encoder[0].mask", "j6:1", "already encoder[0].b"]),
    "an index pin that is not there": ('dir = "j1:1"', 'dir = "j1:1"\nindex = "j0:1"', ["stepgen[0].index", "j0:1"]),
    "not TOML": ("[network]", "[network", ["is not TOML"]),
    "another file's name": ('name = "mill6"', 'name = "mill7"', ["name", "mill7", "mill6"]),
}


def read(text):
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "platforms").symlink_to(ROOT / "boards" / "platforms")
        path = Path(folder) / "mill6.toml"
        path.write_text(text, encoding="utf-8")
        return board.read_board(path)


def describe(text):
    return board.blob(read(text))


def refusal(text):
    try:
        read(text)
    except board.BoardError as e:
        return str(e)
    return None


def main():
    good = (ROOT / "boards" / "mill6.toml").read_text(encoding="utf-8")
    assert refusal(good) is None, refusal(good)
    for what, (old, new, wanted) in WRONG.items():
        assert good.count(old) >= 1, f"{what}: mill6.toml has no {old!r}"
        said = refusal(good.replace(old, new, 1))
        assert said, f"{what}: not refused"
        for part in ["mill6.toml", *wanted]:
            assert part in said, f"{what}: {part!r} is not in {said!r}"

    optional = good.replace('step = "j1:0"\ndir = "j1:1"', 'step = "j1:0"\nstep_n = "j5:4"\ndir = "j1:1"\ndir_n = "j5:5"\nindex = "bus:6"')
    optional = optional.replace('pin = "j5:4"', "").replace('pin = "j5:5"', "").replace('pin = "bus:6"', "").replace('index = "j6:2"', 'index = "j6:2"\nmask = "bus:5"')
    optional = optional.replace('pin = "bus:5"', "")
    said = describe(optional)
    for part in (b"sstep=j1:0 step_n=j5:4 dir=j1:1 dir_n=j5:5 index=bus:6", b"ea=j6:0 b=j6:1 index=j6:2 mask=bus:5", b"ipin=bus:7 estop=high"):
        assert part in said, f"the blob does not say {part!r}"

    for name, channels in (("mill6", board.Channels(6, 6, 6, 12, 12)), ("max", board.CHANNELS_MAX)):
        full = board.read_board(ROOT / "boards" / f"{name}.toml")
        assert full.channels == channels, f"{name}: {full.channels}"
        assert full.estop_mask == full.estop_level == 1 << channels.inputs - 1
        blob = board.blob(full)
        words = board.blob_words(blob)
        assert words[0] == 0x4642_5244 and words[1] == 1 and words[2] == len(blob) <= regmap.BOARD_ROM[1]
        assert words[3] == zlib.crc32(blob[16:])
        at, kinds = 16, []
        while at < len(blob):
            kinds.append((blob[at], blob[at + 1]))
            at += 4 + (blob[at + 2] + 3) // 4 * 4
        assert at == len(blob) and (3, channels.stepgen - 1) in kinds and (12, 0) in kinds
    print(f"PASS board: {len(WRONG)} wrong files refused with file, key, value and remedy; 2 boards and their blobs read back")


main()
