"""The loader of board files and images: the reader's errors arrive with their own text, and an
accepted board arrives complete."""

import sys
import tempfile
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "gateware"))

from ferrocnc import banks, board, multiplexer, regmap  # noqa: E402

# The reader's own tests cover the errors (config/tests); this test checks that their text comes
# through.
WRONG = {
    "a pin used twice": ('step = "j1:2"', 'step = "j1:0"', ["stepgen[1].step", "j1:0", "already stepgen[0].step"]),
    "an unknown key": ('name = "x"\nstep', 'nam = "x"\nname = "x"\nstep', ["stepgen[0].nam", "not a known key"]),
    "a platform that does not exist": ('"5a-75b-8.0"', '"5a-75z"', ["platform", "5a-75z", "5a-75b-8.0"]),
    "not TOML": ("[network]", "[network", ["is not TOML"]),
}


def read(text):
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "platforms").symlink_to(ROOT / "boards" / "platforms")
        path = Path(folder) / "mill6.toml"
        path.write_text(text, encoding="utf-8")
        return board.read_board(path)


def refusal(text):
    try:
        read(text)
    except board.BoardError as e:
        return str(e)
    return None


def named(places):
    """The numbers of those that have a name here."""
    return {place: n for n, place in enumerate(places) if isinstance(place, str)}


def image():
    """An image has lines instead of channels with pins; its sources and inputs have the numbers of
    `wire::pins`; the services reach neither its multiplexer nor its description."""
    eight = board.read_image("5a-75b-8.0", "8/8/8")
    assert eight.name == "5a-75b-8.0" and eight.channels == board.Channels(8, 8, 8, 56, 56) and eight.jobs == 3 and eight.sdram
    assert eight.lines[0] == ("j1:0", "C4") and eight.lines[48] == ("j1:7", "N4") and (eight.key_ball, eight.key_active_low) == ("R7", True)
    assert board.PlatformImage("5a-75b-8.0", "4/2/0").name == "5a-75b-8.0-4-2-0"
    given_out = board.PlatformImage("5a-75b-8.0", None)
    assert given_out.name == "5a-75b-8.0" and given_out.read().channels == eight.channels
    for platform, channels, wanted in (("5a-75e-7.1", "8/8/8", "104 lines"), ("5a-75b-8.0", "8/8", "8/8/8"), ("5a-75z", "8/8/8", "5a-75b-8.0")):
        try:
            board.read_image(platform, channels)
            raise AssertionError(f"{platform} {channels}: not refused")
        except board.BoardError as e:
            assert wanted in str(e), e

    few = board.Channels(6, 5, 3, 56, 56)
    pads = banks.Pads(few)
    carried = multiplexer.sources(few, pads, "enabled", "heartbeat")
    assert (named(carried), len(carried)) == ({"enabled": 18, "heartbeat": 19}, 20)
    listening = multiplexer.sinks(few, pads, "reset", "factory", ["e0", "e1", "e2", "e3"])
    assert (named(listening), len(listening)) == ({"reset": 28, "factory": 29, "e0": 32, "e1": 33, "e2": 34, "e3": 35}, 36)

    kept = [at for bank in (regmap.PINMUX_OUT, regmap.PINMUX_IN) for at in range(bank.base, bank.base + regmap.CSR_PAGE, 4)]
    for place, room in banks.guard_places():
        for at in (*kept, regmap.BOARD_ROM[0], sum(regmap.BOARD_ROM) - 4):
            assert at // 4 & ~room != place, f"the services can write at {at:#x}"


def main():
    image()
    good = (ROOT / "boards" / "mill6.toml").read_text(encoding="utf-8")
    assert refusal(good) is None, refusal(good)
    for what, (old, new, wanted) in WRONG.items():
        assert good.count(old) >= 1, f"{what}: mill6.toml has no {old!r}"
        said = refusal(good.replace(old, new, 1))
        assert said, f"{what}: not refused"
        for part in ["mill6.toml:", *wanted]:
            assert part in said, f"{what}: {part!r} is not in {said!r}"

    optional = read(good.replace('safe = "low"', 'safe = "high"', 2).replace('pin = "j4:1"', 'pin = "j4:1"\ninvert = true', 1))
    assert (optional.safe_mask, optional.invert_mask) == (1, 2), "the safe level of an inverted pin is turned over with it"

    for name, channels in (("mill6", board.Channels(6, 6, 6, 12, 12)), ("max", board.CHANNELS_MAX)):
        full = board.read_board(ROOT / "boards" / f"{name}.toml")
        assert full.channels == channels, f"{name}: {full.channels}"
        # The e-stop is the last input, or the last of those an e-stop can be.
        assert full.estop_mask == full.estop_level == 1 << min(channels.inputs, regmap.WORD_PINS) - 1
        assert bool(board.pins_missing(full)) == (name == "max")
        p = full.platform
        balls = [p.clock_ball, p.led_ball, p.phy_reset, *(p.flash[k] for k in ("cs", "mosi", "miso")), *" ".join(p.ethernet.values()).split()]
        assert not set(balls) & set(p.pins.values()) and len(set(balls)) == len(balls), f"{name}: a ball with two uses"
        assert p.package == "CABGA256" and p.flash["bytes"] == 4 << 20 and p.pins["j1:7"] == p.pins["j8:7"]
        blob = board.blob(full)
        words = board.blob_words(blob)
        assert words[0] == 0x4642_5244 and words[1] == 1 and words[2] == len(blob) <= regmap.BOARD_ROM[1]
        assert words[3] == zlib.crc32(blob[16:])
    print(f"PASS board: {len(WRONG)} refusals come through; 2 boards and an image read whole")


main()
