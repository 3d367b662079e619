"""Loads the output of `ferrocnc-config export` for a board file, and of `export-platform` for an
image. The crate `config` is the only reader of `boards/*.toml`: it checks the files, and all other
programs ask it for the board.
"""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

from . import regmap as rm

ROOT = Path(__file__).resolve().parents[2]


class BoardError(Exception):
    """`boards/x.toml:12:8: stepgen[2].step: "j9:3" is not a pin of 5a-75b-8.0; its headers are j1
    to j8`"""

    def __init__(self, file, key="", problem=""):
        super().__init__(": ".join(str(part) for part in (file, key, problem) if part))


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
    package: str       # "CABGA256" or "CABGA381"
    clock_ball: str
    clock_hz: int
    led_ball: str
    led_active_low: bool
    ethernet: dict     # the RGMII balls of the PHY in use
    phy_reset: str | None  # the ball of the reset both PHYs share: never to be driven low
    flash: dict        # cs, mosi, miso: balls; bytes
    sdram: dict | None  # chip; clk, we, ras, cas, ba, a, dq: balls
    pins: dict         # "j1:0" -> ball; a shared line has a name on every header
    file: str


@dataclass
class Board:
    """A machine configuration on a platform. A pin a channel does not have is None. Or an image:
    `lines`, and how many channels are `built`."""

    file: str
    name: str
    platform: Platform
    sys_clk_hz: int
    phy: int
    mac: bytes | None  # None: the board makes one of its flash's serial number
    ipv4: bytes
    udp_port: int
    stepgen: list = field(default_factory=list)
    encoder: list = field(default_factory=list)
    pwm: list = field(default_factory=list)
    gpio_in: list = field(default_factory=list)
    gpio_out: list = field(default_factory=list)
    ext_reset_pin: str | None = None
    ext_reset_active_low: bool = False
    factory_pin: str | None = None  # may be the ext_reset pin: it is only looked at during start-up
    factory_active_low: bool = True
    safe_mask: int = 0    # what `gpio.safe` holds at power-up: before inversion
    invert_mask: int = 0  # what `gpio.invert_out` holds at power-up
    missing: list = field(default_factory=list)
    blob: bytes = b""
    jobs: int = 0         # axes of a job, step generators 0 and up; 0: the board executes none
    lines: list = field(default_factory=list)  # of an image: (name, ball) of every header line, by number
    key_ball: str | None = None  # the button, which an image watches
    key_active_low: bool = True
    built: dict = field(default_factory=dict)  # stepgen, encoder, pwm of an image
    sdram: bool = False   # the services run in the card's SDRAM; without it a PC streams the jobs

    @property
    def estop_mask(self):
        """Inputs that close the gate with their active level, one bit per input."""
        return sum(1 << n for n, c in enumerate(self.gpio_in) if c["estop"])

    @property
    def estop_level(self):
        """The level that stops, one bit per e-stop input: 1 is high."""
        return sum(1 << n for n, c in enumerate(self.gpio_in) if c["estop"] == "high")

    @property
    def channels(self):
        if self.lines:
            return Channels(**self.built, inputs=len(self.lines), outputs=len(self.lines))
        return Channels(len(self.stepgen), len(self.encoder), len(self.pwm), len(self.gpio_in), len(self.gpio_out))


def _reader():
    """The command that reads board files: the one we are told of, one built now, or, without cargo,
    the one that was built."""
    told, built = os.environ.get("FERROCNC_CONFIG"), ROOT / "target" / "debug" / "ferrocnc-config"
    if told:
        return [told]
    if shutil.which("cargo"):
        return ["cargo", "run", "-q", "-p", "ferrocnc-config", "--"]
    return [str(built)]


def read_board(path, **network):
    """Reads a board file and its platform; everything that can be checked without building it has
    been checked. `ip`, `port` and `mac` stand in for what the file says."""
    path = Path(path)
    # As the file is named from the root, so that an error is the same wherever it is seen.
    shown = path.resolve().relative_to(ROOT) if path.resolve().is_relative_to(ROOT) else path
    instead = [text for key, value in network.items() for text in (f"--{key}", str(value))]
    return _board(_ask(shown, "export", str(shown), *instead))


def read_image(platform, channels=None):
    """The image of a platform, with so many channels ("4/2/0": step generators, encoders, PWM
    generators), or with those of an image that is given out."""
    return _board(_ask(platform, "export-platform", platform, *_channels(channels)))


def _channels(channels):
    return ["--channels", channels] if channels else []


class BoardFile:
    """A board file as the subject of a build: `network` stands in for what it says."""

    kind = "board files"

    def __init__(self, path, network):
        self.path, self.network = Path(path), network
        self.name = self.path.stem

    def read(self):
        return read_board(self.path, **self.network)

    def arguments(self):
        """What `elaborate` is told."""
        return ["--board", str(self.path), *(text for key, value in self.network.items() for text in (f"--{key}", value))]


class PlatformImage:
    """The image of a platform as the subject of a build."""

    kind = "images"

    def __init__(self, platform, channels):
        self.platform, self.channels = platform, channels
        self._board = read_image(platform, channels)
        self.name = self._board.name

    def read(self):
        return self._board

    def arguments(self):
        """What `elaborate` is told."""
        return ["--platform", self.platform, *_channels(self.channels)]


def _ask(what, *command):
    """What the reader says, on its standard output."""
    try:
        run = subprocess.run([*_reader(), *command], cwd=ROOT, capture_output=True, text=True, check=False, encoding="utf-8")
    except OSError as e:
        raise BoardError(what, "", f"cannot be read: {e.filename} does not run ({e.strerror}); install Rust, or set FERROCNC_CONFIG") from e
    if run.returncode:
        raise BoardError(run.stderr.strip() or f"{what}: the reader ended with {run.returncode}")
    return json.loads(run.stdout)


def _board(said):
    p = said["platform"]
    return Board(
        file=said["file"], name=said["name"], sys_clk_hz=said["sys_clk_hz"], phy=said["phy"],
        platform=Platform(
            name=p["name"], title=p["title"], device=p["device"], package=p["package"], clock_ball=p["clock"]["ball"], clock_hz=p["clock"]["hz"],
            led_ball=p["led"]["ball"], led_active_low=p["led"]["active_low"], ethernet=p["ethernet"], phy_reset=p["phy_reset"], flash=p["flash"],
            sdram=p["sdram"], pins=p["pins"], file=p["file"]),
        mac=bytes(said["mac"]) if said["mac"] else None, ipv4=bytes(said["ipv4"]), udp_port=said["udp_port"],
        stepgen=said["stepgen"], encoder=said["encoder"], pwm=said["pwm"], gpio_in=said["gpio_in"], gpio_out=said["gpio_out"],
        ext_reset_pin=said["ext_reset"]["pin"], ext_reset_active_low=said["ext_reset"]["active_low"],
        factory_pin=said["factory"]["pin"], factory_active_low=said["factory"]["active_low"],
        safe_mask=said["safe_mask"], invert_mask=said["invert_mask"], missing=said["missing_pins"], jobs=said["jobs"], sdram=said["sdram"], blob=bytes.fromhex(said["blob"]),
        **_image(said))


def _image(said):
    """What only an image has."""
    if "lines" not in said:
        return {}
    return {
        "lines": [(line["name"], line["ball"]) for line in said["lines"]],
        "key_ball": said["key"]["ball"], "key_active_low": said["key"]["active_low"], "built": said["built"],
    }


def pins_missing(board):
    """Keys of the pins a bitstream needs and the file does not give. Simulation needs none."""
    return board.missing


def blob(board):
    """The board info blob: what the board says about itself. The layout's specification is
    `wire::board`."""
    return board.blob


def blob_words(data):
    """The blob as ROM words: each reads the same number on the CPU as it does over Etherbone."""
    return [int.from_bytes(data[i:i + 4], "big") for i in range(0, len(data), 4)]
