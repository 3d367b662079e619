"""Reads board files. It is their only reader: everybody else asks the board.

A board file that cannot be built is refused with the file, the key, the value and what to do about it; nothing is
guessed and nothing that matters for safety has a default.
"""

import ipaddress
import re
import tomllib
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from . import regmap as rm


class BoardError(Exception):
    """`boards/x.toml: stepgen[2].step: "j9:3" is not a pin of this platform; its connectors are j1 to j8`"""

    def __init__(self, file, key, problem):
        super().__init__(f"{file}: {key}: {problem}" if key else f"{file}: {problem}")


@dataclass(frozen=True)
class Channels:
    """How many of each a board has."""

    stepgen: int = 0
    encoder: int = 0
    pwm: int = 0
    inputs: int = 0
    outputs: int = 0


CHANNELS_MAX = Channels(rm.MAX_STEPGEN, rm.MAX_ENCODER, rm.MAX_PWM, rm.MAX_IN, rm.MAX_OUT)


@dataclass(frozen=True)
class Platform:
    """A PCB: which ball is what."""

    name: str
    title: str
    device: str
    clock_ball: str
    clock_hz: int
    led_ball: str
    led_active_low: bool
    ethernet: dict
    pins: dict   # "j1:0" -> ball
    file: str


@dataclass
class Board:
    """A machine configuration on a platform."""

    file: str
    name: str
    platform: Platform
    sys_clk_hz: int
    mac: bytes
    ipv4: bytes
    udp_port: int
    stepgen: list = field(default_factory=list)
    encoder: list = field(default_factory=list)
    pwm: list = field(default_factory=list)
    gpio_in: list = field(default_factory=list)
    gpio_out: list = field(default_factory=list)
    ext_reset_pin: str | None = None
    ext_reset_active_low: bool = False

    @property
    def estop_mask(self):
        """Inputs whose active level closes the gate, one bit per input."""
        return sum(1 << n for n, c in enumerate(self.gpio_in) if c["estop"])

    @property
    def estop_level(self):
        """The level that stops, one bit per e-stop input: 1 is high."""
        return sum(1 << n for n, c in enumerate(self.gpio_in) if c["estop"] == "high")

    @property
    def channels(self):
        return Channels(len(self.stepgen), len(self.encoder), len(self.pwm), len(self.gpio_in), len(self.gpio_out))


# kind of channel -> (pins it must have, pins it may have, most there can be)
_KINDS = {
    "stepgen": (("step", "dir"), ("step_n", "dir_n", "index"), rm.MAX_STEPGEN),
    "encoder": (("a", "b"), ("index", "mask"), rm.MAX_ENCODER),
    "pwm": (("pin",), ("dir",), rm.MAX_PWM),
    "gpio_in": (("pin",), (), rm.MAX_IN),
    "gpio_out": (("pin",), (), rm.MAX_OUT),
}

_NAME = re.compile(r"[a-z][a-z0-9-]{0,30}")


class _Table:
    """A TOML table that knows where it is, and complains if a key is missing, wrong or not asked for."""

    def __init__(self, file, prefix, data):
        if not isinstance(data, dict):
            raise BoardError(file, prefix.rstrip("."), f"{data!r} is not a table")
        self.file, self.prefix, self.data, self.asked = file, prefix, data, set()

    def get(self, key, kind, what, required=True):
        self.asked.add(key)
        if key not in self.data:
            if required:
                raise BoardError(self.file, self.prefix + key, f"missing; write {what}")
            return None
        value = self.data[key]
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise BoardError(self.file, self.prefix + key, f"{value!r} is not {what}")
        return value

    def done(self):
        extra = sorted(set(self.data) - self.asked)
        if extra:
            raise BoardError(self.file, self.prefix + extra[0], f"unknown key; known here: {', '.join(sorted(self.asked))}")


def _load(path):
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as e:
        raise BoardError(path, "", f"cannot be read ({e.strerror}); board files live in boards/") from e
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise BoardError(path, "", f"is not TOML: {e}") from e


def read_platform(path):
    t = _Table(str(path), "", _load(path))
    name = t.get("name", str, 'the platform\'s name, as in "5a-75b-8.0"')
    if name != Path(path).stem:
        raise BoardError(t.file, "name", f"{name!r} is not the file's own name {Path(path).stem!r}; make them equal")
    clock = _Table(t.file, "clock.", t.get("clock", dict, "a table with ball and hz"))
    led = _Table(t.file, "led.", t.get("led", dict, "a table with ball and active"))
    ball = "an FPGA ball, as in \"P6\""
    balls = {}

    def claim(key, value):
        if value in balls:
            raise BoardError(t.file, key, f"ball {value!r} is already {balls[value]}; every ball has one use")
        balls[value] = key
        return value

    platform = Platform(
        name=name,
        title=t.get("title", str, "what is printed on the box"),
        device=t.get("device", str, 'the FPGA, as in "LFE5U-25F-6BG256C"'),
        clock_ball=claim("clock.ball", clock.get("ball", str, ball)),
        clock_hz=clock.get("hz", int, "the oscillator in hertz, as in 25_000_000"),
        led_ball=claim("led.ball", led.get("ball", str, ball)),
        led_active_low=_active_low(led),
        ethernet=_ethernet(t, claim, ball),
        pins=_pins(t, claim),
        file=t.file,
    )
    for table in (clock, led, t):
        table.done()
    return platform


def _active_low(table, required=True):
    active = table.get("active", str, '"low" or "high"', required)
    if active not in ("low", "high", None):
        raise BoardError(table.file, table.prefix + "active", f'{active!r} is neither "low" nor "high"')
    return active == "low"


def _ethernet(t, claim, ball):
    eth = _Table(t.file, "ethernet.", t.get("ethernet", dict, "the RGMII balls of the PHY in use"))
    out = {}
    for key, count in (("tx_clk", 1), ("rx_clk", 1), ("mdio", 1), ("mdc", 1), ("rx_ctl", 1), ("rx_data", 4), ("tx_ctl", 1), ("tx_data", 4)):
        if count == 1:
            out[key] = claim(f"ethernet.{key}", eth.get(key, str, ball))
            continue
        value = eth.get(key, list, f"{count} balls, bit 0 first")
        if len(value) != count:
            raise BoardError(t.file, f"ethernet.{key}", f"{value!r} has {len(value)} balls; RGMII has {count}")
        out[key] = " ".join(claim(f"ethernet.{key}[{i}]", v) for i, v in enumerate(value))
    eth.done()
    return out


def _pins(t, claim):
    pins = {}
    for name, balls in t.get("connectors", dict, "a table of connectors, each a list of balls").items():
        if isinstance(balls, str):
            pins[name] = claim(f"connectors.{name}", balls)
            continue
        for i, one in enumerate(balls):
            if not isinstance(one, str):
                raise BoardError(t.file, f"connectors.{name}[{i}]", f'{one!r} is not an FPGA ball, as in "P6"')
            pins[f"{name}:{i}"] = claim(f"connectors.{name}[{i}]", one)
    return pins


def read_board(path):
    """Reads a board file and its platform, and checks everything that can be checked without building it."""
    t = _Table(str(path), "", _load(path))
    name = t.get("name", str, 'the configuration\'s name, as in "mill6"')
    if name != Path(path).stem:
        raise BoardError(t.file, "name", f"{name!r} is not the file's own name {Path(path).stem!r}; make them equal")
    platforms = Path(path).parent / "platforms"
    wanted = t.get("platform", str, "the name of a file in boards/platforms, without .toml")
    if not (platforms / f"{wanted}.toml").is_file():
        known = ", ".join(sorted(p.stem for p in platforms.glob("*.toml"))) or "none"
        raise BoardError(t.file, "platform", f"{wanted!r} has no file in {platforms}; there is: {known}")
    platform = read_platform(platforms / f"{wanted}.toml")

    net = _Table(t.file, "network.", t.get("network", dict, "a table with mac, ipv4 and udp_port"))
    board = Board(
        file=t.file, name=name, platform=platform,
        sys_clk_hz=t.get("sys_clk_hz", int, "the core clock in hertz, as in 60_000_000"),
        mac=_mac(net), ipv4=_ipv4(net), udp_port=net.get("udp_port", int, "a UDP port, as in 1234"),
    )
    if not 10_000_000 <= board.sys_clk_hz <= 100_000_000:
        raise BoardError(t.file, "sys_clk_hz", f"{board.sys_clk_hz} is outside 10 to 100 MHz; 60_000_000 is what closes")
    if not 0 < board.udp_port < 65536:
        raise BoardError(t.file, "network.udp_port", f"{board.udp_port} is not a port; write 1 to 65535")
    net.done()

    used = {}
    for kind in _KINDS:
        setattr(board, kind, _channels(t, kind, platform, used))
    reset = _Table(t.file, "ext_reset.", t.get("ext_reset", dict, 'a table with pin and active, or { pin = "none", active = "high" }'))
    board.ext_reset_pin = _pin(reset, "pin", platform, used)
    board.ext_reset_active_low = _active_low(reset)
    reset.done()
    t.done()
    return board


def _mac(net):
    text = net.get("mac", str, 'a MAC address, as in "10:e2:d5:00:00:01"')
    if not re.fullmatch(r"([0-9a-f]{2}:){5}[0-9a-f]{2}", text):
        raise BoardError(net.file, "network.mac", f'{text!r} is not six bytes in lower case hex, as in "10:e2:d5:00:00:01"')
    mac = bytes.fromhex(text.replace(":", ""))
    if mac[0] & 1:
        raise BoardError(net.file, "network.mac", f"{text!r} is a group address; clear the lowest bit of its first byte")
    return mac


def _ipv4(net):
    text = net.get("ipv4", str, 'an IPv4 address, as in "192.168.2.50"')
    try:
        return ipaddress.IPv4Address(text).packed
    except ValueError as e:
        raise BoardError(net.file, "network.ipv4", f"{text!r} is not an IPv4 address, as in \"192.168.2.50\"") from e


def _channels(t, kind, platform, used):
    must, may, most = _KINDS[kind]
    tables = t.get(kind, list, f"an array of tables: [[{kind}]]", required=False) or []
    if len(tables) > most:
        raise BoardError(t.file, kind, f"{len(tables)} channels; the gateware has at most {most}")
    out, names = [], set()
    for n, data in enumerate(tables):
        c = _Table(t.file, f"{kind}[{n}].", data)
        name = c.get("name", str, 'a name, as in "x"')
        if not _NAME.fullmatch(name):
            raise BoardError(t.file, f"{kind}[{n}].name", f"{name!r} cannot be part of a HAL name; use up to 31 of a-z 0-9 -, a letter first")
        if name in names:
            raise BoardError(t.file, f"{kind}[{n}].name", f"{name!r} is already another {kind}'s name; names are unique per kind")
        names.add(name)
        # A configuration without any pin is one for simulation; `pins_missing` says so when somebody wants a bitstream.
        channel = {"name": name, **{p: _pin(c, p, platform, used) for p in must + may}}
        for pair in ("step", "dir") if kind == "stepgen" else ():
            if channel[f"{pair}_n"] and not channel[pair]:
                raise BoardError(t.file, f"{kind}[{n}].{pair}_n", f"{channel[f'{pair}_n']!r} is the inverted copy of a pin that is not there; give {pair} too")
        if kind == "gpio_in":
            channel["estop"] = _estop(c)
        out.append(channel)
        c.done()
    return out


def _estop(table):
    level = table.get("estop", str, 'the level that stops, "high" or "low"', required=False)
    if level not in ("high", "low", None):
        raise BoardError(table.file, table.prefix + "estop", f'{level!r} is neither "high" nor "low"; a normally closed contact to ground stops on "high"')
    return level


def _pin(table, key, platform, used):
    pin = table.get(key, str, 'a pin, as in "j1:0"', required=False)
    if pin in (None, "none"):
        return None
    where = table.prefix + key
    if pin not in platform.pins:
        connectors = ", ".join(sorted({p.split(":")[0] for p in platform.pins}))
        raise BoardError(table.file, where, f"{pin!r} is not a pin of {platform.name}; its connectors are {connectors}, as in \"j1:0\"")
    if pin in used:
        raise BoardError(table.file, where, f"{pin!r} is already {used[pin]}; every pin has one use")
    used[pin] = where
    return pin


def pins_missing(board):
    """Keys of the pins a bitstream needs and the file does not give. Simulation needs none."""
    return [f"{kind}[{n}].{pin}" for kind, (must, _, _) in _KINDS.items()
            for n, c in enumerate(getattr(board, kind)) for pin in must if c[pin] is None]


# The blob ---------------------------------------------------------------------------------------------------------

def blob(board):
    """The board info blob: what the board says about itself. The layout's specification is `wire::board`."""
    entries = [(1, 0, board.platform.title.encode()), (2, 0, board.name.encode())]
    for kind, (key, letter, pins) in {
        3: ("stepgen", "s", ("step", "step_n", "dir", "dir_n", "index")), 4: ("encoder", "e", ("a", "b", "index", "mask")),
        5: ("pwm", "p", ("pin", "dir")), 6: ("gpio_in", "i", ("pin", "estop")), 7: ("gpio_out", "o", ("pin",)),
    }.items():
        for n, channel in enumerate(getattr(board, key)):
            entries.append((kind, n, channel["name"].encode()))
            text = " ".join(f"{p}={channel[p]}" for p in pins if channel[p])
            if text:
                entries.append((8, n, (letter + text).encode()))
    entries += [(10, 0, board.mac), (11, 0, board.ipv4), (12, 0, board.udp_port.to_bytes(2, "big"))]
    body = b""
    for kind, channel, data in entries:
        assert len(data) < 256
        body += bytes((kind, channel, len(data), 0)) + data + bytes(-len(data) % 4)
    total = 16 + len(body)
    if total > rm.BOARD_ROM[1]:
        raise BoardError(board.file, "", f"its description takes {total} bytes and the board has {rm.BOARD_ROM[1]}; shorten the names")
    head = b"".join(w.to_bytes(4, "big") for w in (0x4642_5244, 1, total, zlib.crc32(body)))
    return head + body


def blob_words(data):
    """The blob as ROM words: each reads the same number on the CPU as it does over Etherbone."""
    return [int.from_bytes(data[i:i + 4], "big") for i in range(0, len(data), 4)]
