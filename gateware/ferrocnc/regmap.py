"""The register map: the only place where an address is written by hand.

Every board has this map. A channel owns a fixed page whether or not a board has the channel: absent
ones read 0 and ignore writes. So there is one PAC, one `memory.x` and one firmware binary;
`export.py` turns this file into `pac/soc.svd`, `wire/src/regmap.rs`, `docs/registers.md` and the
ABI number, and `banks.py` turns it into logic.

A page is 0x800 bytes, a register one 32-bit word; within a page the order of the list is the order
of the addresses.
"""

from dataclasses import dataclass, field as _f

# Memory -------------------------------------------------------------------------------------------

CSR_BASE = 0xF000_0000
CSR_PAGE = 0x800
CSR_ADDRESS_WIDTH = 16

ROM = (0x0000_0000, 0xF000)  # 60 KiB, 27 EBR: the image
# In words: see `onchip`.
ROM_PARTS = (14 * 1024, 1024)
ROM_TRAILER = 0x10  # the ROM's last bytes, which the linker does not use: the bitstream's trailer
RAM = (0x1000_0000, 0x4800)  # 18 KiB, 9 EBR: the window of the services, data, bss, stack
RAM_PARTS = (4096, 512)
ETHMAC = (0x8000_0000, 0x3000)  # 4 receive slots, then 2 transmit slots, 2 KiB each; uncached
BOARD_ROM = (0x9000_0000, 0x1000)  # the board info blob; uncached
# 8 MiB, on boards with SDRAM: the services, their data, the jobs; cached.
SDRAM_RAM = (0x4000_0000, 0x80_0000)
# The beginning of the RAM, which the services may write while the guard is closed.
WINDOW = (RAM[0], 0x600)
# Uncached, and nothing is there: LiteX wants an address for what answers where nothing is.
NOTHING = 0xE000_0000
TRAILER_MAGIC = 0x4654_524C  # "FTRL"; the words of a trailer: magic, build, role, 0
ROLE_IMAGE = 1
ROLE_GOLDEN = 2
ETHMAC_RX_SLOTS = 4
ETHMAC_TX_SLOTS = 2
ETHMAC_SLOT = 0x800
# Words of a frame's head that `rx_admission` compares: 0 to 17 without 5 and 12.
HEADER_PLACES = 16
LEASH_IRQ = 31  # the leash's line among the CPU's interrupts; no other is used

# Channels -----------------------------------------------------------------------------------------

MAX_STEPGEN = 16
MAX_ENCODER = 16
MAX_PWM = 16
MAX_IN = 64
MAX_OUT = 64
# Inputs and outputs of a word. Those behind the first word have registers of their own, and no job
# controls them; a board file's e-stop inputs are in the first.
WORD_PINS = 32

# LiteX's own pages, by LiteX's names --------------------------------------------------------------

LITEX_PAGES = {"ctrl": 0, "identifier_mem": 1, "ethmac": 3, "ethphy": 4}

MAGIC = 0x4643_6E43  # "FCnC"

# Keys of watchdog.control: words that are not written by accident.
ARM = 0x4152_4D31  # "ARM1"
SOFT = 0x534F_4654  # "SOFT"
STOP = 0x5354_4F50  # "STOP"
CLEAR = 0x434C_5231  # "CLR1"

OPEN = 0x4F50_4E21  # "OPN!": the key of timebase.guard


@dataclass(frozen=True)
class Field:
    """Bits of a register. `values` maps names to (number, sentence) where the bits are an
    enumeration."""

    name: str
    lsb: int
    width: int
    doc: str
    values: tuple = ()


@dataclass(frozen=True)
class Reg:
    """One 32-bit word. `access` is "ro", "rw" or "wo" (a wo register reads 0)."""

    name: str
    access: str
    doc: str
    fields: tuple = ()
    reset: int = 0


@dataclass(frozen=True)
class Bank:
    """One page. Banks of the same `kind` have the same registers and share one register block in
    the PAC."""

    name: str
    page: int
    kind: str
    doc: str
    regs: tuple = _f(default_factory=tuple)

    @property
    def base(self):
        return CSR_BASE + self.page * CSR_PAGE

    def offset(self, name):
        return 4 * [r.name for r in self.regs].index(name)


def mask(reg):
    """The bits that mean something: those of its fields, or all."""
    return sum((1 << f.width) - 1 << f.lsb for f in reg.fields) or 0xFFFF_FFFF


def _bit(name, lsb, doc):
    return Field(name, lsb, 1, doc)


# The pages ----------------------------------------------------------------------------------------

# On boards with SDRAM only; `soc` compares it with what was built.
SDRAM = Bank("sdram", 5, "sdram", "The SDRAM's controller, which starts the SDRAM by itself after "
    "power-up and after a reset of the system. Boards without SDRAM do not have it: the page reads "
    "0.", (
    Reg("status", "ro", "State of the SDRAM.", (
        _bit("ready", 0, "1: it has been started, 0.4 ms after power-up or a reset at 60 MHz."),
    )),
))

IDENT = Bank("ident", 8, "ident", "The gateware's identity. Constant; the firmware reads it at "
    "boot before anything else.", (
    Reg("magic", "ro", "Always 0x46436e43 (\"FCnC\"): this is FerroCNC gateware and this map "
        "applies."),
    Reg("abi", "ro", "ABI number: first 32 bits of the SHA-256 of the normalised register map and "
        "of the exchange's layout. "
        "Firmware compares it with its own; unequal never arms."),
    Reg("gateware_version", "ro", "Gateware version: major in bits 31:16, minor in 15:8, patch in "
        "7:0.", (
        Field("patch", 0, 8, "Patch version, a count."),
        Field("minor", 8, 8, "Minor version, a count."),
        Field("major", 16, 16, "Major version, a count."),
    )),
    Reg("sys_clk_hz", "ro", "Frequency of the core clock in hertz; the unit of every time and rate "
        "in this map."),
    Reg("channels0", "ro", "How many channels of motion this board has, one count per byte.", (
        Field("stepgen", 0, 8, "Number of step generators."),
        Field("encoder", 8, 8, "Number of encoder counters."),
        Field("pwm", 16, 8, "Number of PWM generators."),
    )),
    Reg("channels1", "ro", "How many digital inputs and outputs this board has, one count per "
        "byte.", (
        Field("inputs", 0, 8, "Number of general purpose inputs."),
        Field("outputs", 8, 8, "Number of general purpose outputs."),
    )),
    Reg("features", "ro", "Optional parts present, one bit each.", (
        _bit("jobs", 0, "1: the board executes jobs; `segments` is there."),
        _bit("readback", 1, "1: `pads` and `timebase.eth_beats` are there. 0 in gateware from "
            "before them."),
        _bit("pins", 2, "1: a pin's function is configured: `pinmux_out` and `pinmux_in` are "
            "there, the board info can be written, and inputs and outputs have the numbers of "
            "their pins."),
    )),
    Reg("board_rom_words", "ro", "Length of the board info blob at 0x90000000 in 32-bit words."),
    Reg("pins", "ro", "Header lines behind the multiplexer, a count; 0 without one."),
    Reg("platform", "ro", "CRC-32 of the name of the platform the image is for; 0 without a "
        "multiplexer."),
))

TIMEBASE = Bank("timebase", 9, "timebase", "The 64-bit wall clock and the two strobes that make "
    "all channels act on one clock.", (
    Reg("now_lo", "ro", "Low word of the wall clock, in clocks since power-up, as caught by the "
        "last write to `snapshot`."),
    Reg("now_hi", "ro", "High word of the wall clock, in units of 2^32 clocks, as caught by the "
        "last write to `snapshot`."),
    Reg("snapshot", "wo", "Writing any value catches the wall clock in `now_lo` and `now_hi`, both "
        "on the same clock."),
    Reg("arrival_lo", "ro", "Low word of the wall clock, in clocks, when the frame now presented "
        "by the MAC was complete in its slot."),
    Reg("arrival_hi", "ro", "High word of the wall clock, in units of 2^32 clocks, when the frame "
        "now presented was complete in its slot."),
    Reg("commit_at_lo", "rw", "Low word of the apply time, in clocks: the wall clock at which a "
        "timed commit happens."),
    Reg("commit_at_hi", "rw", "High word of the apply time, in units of 2^32 clocks."),
    Reg("strobe", "wo", "Makes things happen on one clock for all channels; bits may be written "
        "together.", (
        _bit("commit", 0, "1: every staged command takes effect, one clock after this write."),
        _bit("sample", 1, "1: every status word is caught, one clock after this write."),
        _bit("commit_at", 2, "1: commit when the wall clock reaches `commit_at` (at once if that "
            "has passed). Replaces a pending one."),
    )),
    Reg("status", "ro", "What the timebase is waiting for.", (
        _bit("pending", 0, "1: a timed commit is waiting for its clock."),
    )),
    Reg("eth_beats", "ro", "The PHY's receive clock, in units of 4 of its clocks since power-up, a "
        "count, as caught by the last write to `snapshot`: "
        "on the same clock as `now_lo`, so two looks give the ratio of both clocks."),
    Reg("leash", "wo", "Clocks until the CPU is interrupted, in bits 23:0, counted from this "
        "write; the interrupt stays until the next write. 0: none."),
    Reg("guard", "wo", "The guard on the CPU's data bus. Closed, stores reach only the SDRAM, "
        "`segments`, `snapshot`, this register and the first bytes of the RAM; "
        "any other one, and a read where there is nothing, is answered, has no effect and "
        "interrupts as the leash does.", (
        Field("key", 0, 32, "The key word opens it, any other word closes it.", (
            ("open", OPEN, "Open it."),
        )),
    )),
    Reg("guard_status", "ro", "State of the guard.", (
        _bit("closed", 0, "1: it is closed."),
        _bit("refused", 31, "1: it has refused an access since it was closed last."),
    )),
    Reg("guard_at", "ro", "Address of the first access the guard has refused; anything if there "
        "was none."),
))

WATCHDOG = Bank("watchdog", 10, "watchdog", "The gate every output passes, and the watchdog that "
    "closes it when the tokens stop. Needs no CPU.", (
    Reg("timeout", "rw", "Clocks without a new token until the watchdog bites. 0 bites at once."),
    Reg("grace", "rw", "Longest soft stop in clocks: when it has passed the gate closes whether or "
        "not the motors stand."),
    Reg("token", "wo", "Feeds the watchdog if the value differs from the last one written; a "
        "repeat is ignored. A count, no unit."),
    Reg("control", "wo", "Commands to the gate, each a key word; any other value is ignored.", (
        Field("key", 0, 32, "Which command, as a key word.", (
            ("arm", ARM, "Open the gate and wake the watchdog; only while closed, not bitten, no "
                "external reset or e-stop latched or present."),
            ("soft", SOFT, "Bring all step generators to rest, each at its stop_accel, then close "
                "the gate."),
            ("stop", STOP, "Close the gate now."),
            ("clear", CLEAR, "Forget a bite, an external reset and an e-stop; only while the gate "
                "is closed and neither the reset pin nor an e-stop input is active."),
        )),
    )),
    Reg("status", "ro", "What the gate and the watchdog are doing now, one bit each.", (
        _bit("gate", 0, "1: the gate is open, outputs are live."),
        _bit("stopping", 1, "1: a soft stop is running."),
        _bit("bitten", 2, "1: the watchdog has bitten. Latched; a token does not clear it."),
        _bit("reset_latched", 3, "1: the external reset pin has been active. Latched."),
        _bit("reset_pin", 4, "1: the external reset pin is active now."),
        _bit("armed", 5, "1: the watchdog is awake and counting."),
        _bit("estop_latched", 6, "1: an e-stop input has been active. Latched; `status.estop` says "
            "which."),
        _bit("estop_now", 7, "1: an e-stop input is active now."),
    )),
    Reg("remaining", "ro", "Clocks left until the watchdog bites, if nothing feeds it."),
    Reg("last_token", "ro", "The last token written. A count, no unit."),
    Reg("bites", "ro", "How often the watchdog has bitten since power-up, a count."),
    Reg("last_close", "ro", "Why the gate closed last; survives a reset of the CPU.", (
        Field("reason", 0, 4, "Which reason, a number.", (
            ("never", 0, "It has not been open since power-up."),
            ("bite", 1, "The watchdog has bitten; its soft stop is done or its grace is over."),
            ("ext_reset", 2, "The external reset pin."),
            ("stop", 3, "The stop key."),
            ("soft", 4, "A soft stop on request is done or its grace is over."),
            ("estop", 5, "An e-stop input."),
            ("sys_reset", 6, "A reset of the system."),
        )),
    )),
))

_GPIO_WORD = (  # of both words of inputs and outputs
    Reg("in_now", "ro", "Level of each input after its debounce, one bit per input."),
    Reg("safe", "rw", "Level each output takes while the gate is closed, one bit per output, "
        "before inversion."),
    Reg("invert_out", "rw", "1 inverts the output at the pin, one bit per output; applies to the "
        "safe level too."),
    Reg("out_now", "ro", "Level each output pin carries now, one bit per output."),
    Reg("raw_now", "ro", "Level of each input pin two clocks ago (synchronised, not debounced), "
        "one bit per input."),
)

GPIO = Bank("gpio", 11, "gpio", "The first 32 digital inputs and outputs, one bit per pin. Outputs "
    "are set in `command.gpio_out`.", _GPIO_WORD + (
    Reg("estop_mask", "ro", "1: this input is an e-stop input, one bit per input. A fact of the "
        "board file."),
    Reg("estop_level", "ro", "Level that stops, one bit per e-stop input: 1 high, 0 low. A fact of "
        "the board file."),
    Reg("probe", "rw", "Which input is the probe of every encoder and step generator. The probe is "
        "not debounced.", (
        Field("input", 0, 6, "Number of the input."),
        _bit("enable", 8, "1: the probe follows the input; 0: it is inactive."),
        _bit("invert", 9, "1: the probe is active while the input is low."),
    )),
))

DEBOUNCE = Bank("debounce", 13, "debounce", "How long an input must be stable before it counts. "
    "E-stop inputs stop before their debounce.", tuple(
    Reg(f"in{n}", "rw", f"Time input {n} must keep a new level, in units of 32 clocks; 0 follows "
        "within 33 clocks.", (Field("visits", 0, 16, "Time in units of 32 clocks."),))
    for n in range(MAX_IN)))

GPIO_HIGH = Bank("gpio_high", 69, "gpio_high", "Digital inputs and outputs 32 to 63, one bit per "
    "pin: bit 0 is pin 32. Outputs are set in `command.gpio_out_high`. Boards with fewer pins read "
    "0.", _GPIO_WORD)

LED = Bank("led", 12, "led", "The board's one LED.", (
    Reg("pattern", "rw", "What the LED shows; blinking patterns repeat about once a second.", (
        Field("select", 0, 3, "Which pattern, a number.", (
            ("off", 0, "Dark."),
            ("on", 1, "Lit."),
            ("slow", 2, "One long blink per second."),
            ("fast", 3, "Four blinks per second."),
            ("double", 4, "Two short blinks per second."),
            ("triple", 5, "Three short blinks per second."),
            ("heartbeat", 6, "Two short blinks and a long pause."),
            ("flicker", 7, "As fast as the eye can follow."),
        )),
    )),
))

FLASH = Bank("flash", 64, "flash", "The wires to the configuration flash, raw: SPI mode 0, most "
    "significant bit first, f_clk / 4.", (
    Reg("control", "rw", "The flash's chip select. Survives a reset: firmware deselects first.", (
        _bit("select", 0, "1: CS is low. It rises no earlier than a transfer's end, and stays high "
            "for 4 clocks at least."),
    )),
    Reg("data", "rw", "Writing starts a transfer of `length` bits, bit 31 first; ignored while "
        "busy or not selected. Reads what came in, the last bit in "
        "bit 0; above it what has not been sent of the word written, so 0 if that was 0."),
    Reg("length", "rw", "How many bits a transfer has.", (Field("bits", 0, 6,
        "Bits, 1 to 32; 0 is taken as 32."),)),
    Reg("status", "ro", "The transfer, and a pin that is only looked at while starting.", (
        _bit("busy", 0, "1: a transfer is running or waits for CS."),
        _bit("factory_pin", 1, "1: the factory pin is active now."),
    )),
))

RX_ADMISSION = Bank("rx_admission", 65, "rx_admission", "Which frames may occupy a receive slot: a "
    "frame that is not the owner's needs a ticket.", tuple(
    Reg(f"header{n}", "wo", f"Word {n + (n > 4) + (n > 10)} of the owner's frames, as a receive "
        "slot reads. Write it between frames: a frame that passes meanwhile may be lost; no unit.")
    for n in range(HEADER_PLACES)) + (
    Reg("mode", "rw", "Which words of a frame are compared. A frame that differs in one is a "
        "guest, and so is a frame of less than 59 bytes without FCS.", (
        Field("select", 0, 2, "Which words, a number.", (
            ("none", 0, "None: there are no guests."),
            ("ours", 1, "0 and 1: a frame to another MAC address is a guest."),
            ("owner", 3, "0 to 3, 7 and 9: a frame that is not the owner's is a guest. An ARP "
                "frame between the two MAC addresses is the owner's."),
        )),
    )),
    Reg("admit", "wo", "Writing any value issues a ticket, if there is none: the next guest with a "
        "right FCS that finds a slot free is taken, and uses it up."),
    Reg("refused", "ro", "Guests discarded because there was no ticket, a count since power-up."),
))


# Sources of the outputs and sinks of the inputs: `wire::pins` has their numbers.
_ROUTES = tuple(
    Reg(f"route{n}", "wo", f"Routes {4 * n} to {4 * n + 3}, a byte each, the first one lowest: bits "
        "6:0 the source, 124 to 127 for none, bit 7 inverts. Takes 16 clocks; only while the gate "
        "is closed and `status.idle`.") for n in range(32))
_ROUTED = (
    _bit("idle", 0, "1: no route is being written."),
    _bit("refused", 1, "1: the last word had no effect: the gate was open, or a route was being "
        "written."),
)

PINMUX_OUT = Bank("pinmux_out", 70, "pinmux_out", "What each header line carries if it is an "
    "output (docs/cores/pinmux.md). Boards without a multiplexer do not have it.", _ROUTES + tuple(
    Reg(f"{name}{n}", "wo", f"{prose}, of lines {32 * n} to {32 * n + 31}, one bit per line.")
    for name, prose in (
        ("safe", "Levels while the gate is closed"),
        ("keeps", "1: the level stays as it was when the gate closed"),
        ("drives", "1: the line is driven; 0: it is an input"),
    ) for n in range(4)) + (
    Reg("status", "ro", "State of the outputs.", _ROUTED + (
        _bit("live", 2, "1: lines carry their sources."),
    )),
))

PINMUX_IN = Bank("pinmux_in", 71, "pinmux_in", "Which header line each input of a core listens "
    "to. Boards without a multiplexer do not have it.", _ROUTES + (
    Reg("status", "ro", "State of the inputs.", _ROUTED + (
        _bit("ready", 2, "1: a route was written, and all of the last word's are complete."),
    )),
))

FAST_PATH = Bank("fast_path", 68, "fast_path", "Executes the owner's next command without the CPU, "
    "and answers it. Firmware says what its frame must look like (here and in "
    "`rx_admission.header0` to `header15`), and hands out a pass for it. Change nothing here "
    "while a pass is out or an answer is being sent.", tuple(
    Reg(f"run{n}", "wo", f"Run {n}, a number of words. Runs 0 to 3 say where words of the frame "
        "go, from its word 18 on; runs 4 to 15 what the answer consists of.", (
        Field("register", 0, 10, "First word: page less 8 in bits 9:7, word in bits 6:0. With "
            "`skip` the word of the transmit slot at which the answer goes on."),
        Field("count", 10, 6, "Words less 1. With `skip` clocks less 1."),
        _bit("skip", 16, "1: no words, but clocks."),
        _bit("select", 17, "1: bits 20:16 of `command.probe_arms` are added to the word's number "
            "by OR: the latch that was asked for."),
        _bit("end", 18, "1: the last run."),
    )) for n in range(16)) + (
    Reg("ip_sum", "wo", "Ones' complement sum of words 4, 7 and 8 of the frame, a number.", (
        Field("sum", 0, 16, "Sum of the halves."),)),
    Reg("udp_sum", "wo", "Ones' complement sum of the UDP pseudo header and both ports, a "
        "number.", (Field("sum", 0, 16, "Sum of the halves."),)),
    Reg("length", "wo", "Length of the answer in transmit slot 0.", (
        Field("bytes", 0, 11, "Bytes without FCS, with the two in front of the frame."),)),
    Reg("gate", "wo", "Under which condition the command is executed, and how.", (
        Field("status", 0, 8, "What `watchdog.status` must read."),
        _bit("executes", 8, "1: the command is committed; 0: only sampled and answered."),
        _bit("timed", 9, "1: committed when the wall clock reaches words 18 and 19."),
    )),
    Reg("pass", "wo", "Writing any value hands out a pass for one command, whose frame begins "
        "later, and clears `executed`."),
    Reg("revoke", "wo", "Writing any value takes the pass back. What `status` reads next is "
        "final."),
    Reg("status", "ro", "What has become of the pass.", (
        _bit("executed", 0, "1: a command has been executed since the last pass, which it has "
            "used up."),
        _bit("out", 1, "1: a pass is out."),
        _bit("sending", 2, "1: the answer is being sent: transmit slot 0 must not be written."),
    )),
))


JOB_AXES_MAX = 7
JOB_SEGMENTS = 64

SEGMENTS = Bank("segments", 66, "segments", "Motion segments for jobs: a FIFO, and what plays it "
    "into the first step generators. Boards without jobs do not have it.", tuple(
    [Reg("clocks", "wo", "Duration of the segment being written, in clocks of the path, 64 at "
        "least."),
     Reg("aux", "wo", "Outputs and tag of the segment being written.", (
         Field("outputs", 0, 16, "Level of output n and of output n + 16, where `mask` lets it, "
             "from the segment's first clock on."),
         Field("tag", 16, 16, "Comes back in `current`; no unit."),
     ))] +
    [reg for n in range(JOB_AXES_MAX) for reg in (
        Reg(f"axis{n}_velocity", "wo", f"Signed velocity of step generator {n} towards the end of "
            "the segment being written; one unit is f_clk / 2^32 steps per second."),
        Reg(f"axis{n}_accel", "wo", "Acceleration that leads there; one unit is f_clk^2 / 2^56 "
            "steps per second squared, 0 is no limit."),
    )] + [
    Reg("push", "wo", "Writing any value pushes the segment written, if it is complete and there "
        "is room; otherwise nothing changes and `status.refused` says why."),
    Reg("control", "wo", "Commands, a number; any other value is ignored.", (
        Field("command", 0, 2, "Which command, a number.", (
            ("start", 1, "Play the segments: when all step generators of the job stand, the first "
                "begins. Refused unless one waits, the gate is open and no end has to be cleared."),
            ("quit", 2, "Bring the step generators to rest, each at its stop_accel, and discard "
                "the segments."),
            ("clear", 3, "Clear `refused` and, while idle, `reason` and the waiting segments."),
        )),
    )),
    Reg("pace", "rw", "How fast the time of the path passes, in 1/65536; 65536 or more is 1, 0 "
        "pauses.", (Field("scale", 0, 17, "Clocks of the path per clock, in 1/65536."),)),
    Reg("slew", "rw", "How fast the pace changes while playing, in 2^-32 per clock; 0 is at once."),
    Reg("beam", "rw", "Outputs of a segment that are low unless the axes are on their way: not in "
        "a pause, not in a stop, not after the end.", (Field("outputs", 0, 16,
            "One bit per output of `aux`."),)),
    Reg("mask", "rw", "Outputs that follow the segments instead of `command.gpio_out`, one bit per "
        "output."),
    Reg("status", "ro", "What the core does now.", (
        Field("level", 0, 8, "Complete segments that wait, a count."),
        Field("state", 8, 2, "What it does, a number.", (
            ("idle", 0, "Nothing: the step generators follow the bus."),
            ("settle", 1, "Waits for the step generators to stand, before the first segment."),
            ("play", 2, "Plays, or stands in a pause."),
            ("halt", 3, "Brings the step generators to rest."),
        )),
        Field("reason", 12, 3, "Why it ended last, a number. From 2 on the FIFO stays empty and "
            "nothing starts until `clear`.", (
            ("none", 0, "It has not ended since it started, or this was cleared."),
            ("done", 1, "There was no segment left, and all velocities were 0."),
            ("underrun", 2, "There was no complete segment in time, and some velocity was not 0."),
            ("quit", 3, "The command."),
            ("halted", 4, "The watchdog's soft stop."),
            ("closed", 5, "The gate closed."),
        )),
        Field("refused", 16, 5, "What was refused since `clear`, one bit each: 0 a push without "
            "room, 1 one with a word missing, 2 one shorter than 64 clocks, "
              "3 one with the gate closed or an end to be cleared, 4 a start."),
        _bit("stands", 24, "1: the pace is 0, path time is stopped."),
        _bit("held", 25, "1: since the start a pulse has had to wait for its pins' times, and has "
            "held the time of the path."),
    )),
    Reg("begun", "ro", "Segments begun since power-up, a count: the job's sign of life, and its "
        "progress."),
    Reg("left", "ro", "Clocks of the path left of the present segment, less 1; 2^32 - 1 in its "
        "last and when there is none."),
    Reg("current", "ro", "The segment begun last.", (
        Field("outputs", 0, 16, "Outputs as they are now, `beam` considered."),
        Field("tag", 16, 16, "Its tag."),
    )),
    Reg("pace_now", "ro", "The pace now, while it slews to `pace`, in 1/65536."),
    Reg("shape", "ro", "What was built.", (
        Field("axes", 0, 8, "Axes, a count: step generators 0 and up."),
        Field("segments", 8, 8, "Room for so many segments, a count."),
    )),
]))

PADS = Bank("pads", 67, "pads", "Levels at the pads that the board drives, as their own input "
    "buffers see them two clocks ago: with the gate open or closed, shorted or not. "
            "What is behind a pad is not seen: a buffer on the card, its supply, the header. A pin "
            "the board file does not have reads 0.", (
    Reg("step", "ro", "Pads of the step generators, one bit per pin.", (
        Field("step", 0, 16, "Bit n: the pad of STEP n."),
        Field("dir", 16, 16, "Bit n: the pad of DIR n."),
    )),
    Reg("step_n", "ro", "Pads of the inverted copies for differential lines, one bit per pin.", (
        Field("step", 0, 16, "Bit n: the pad of the inverted STEP n."),
        Field("dir", 16, 16, "Bit n: the pad of the inverted DIR n."),
    )),
    Reg("pwm", "ro", "Pads of the PWM generators, one bit per pin.", (
        Field("pwm", 0, 16, "Bit n: the first pad of PWM n."),
        Field("dir", 16, 16, "Bit n: the second pad of PWM n."),
    )),
    Reg("outputs", "ro", "Pads of the first 32 outputs, one bit per output; `gpio.out_now` is what "
        "drives them. On an image the header lines 0 to 31, driven or not."),
    Reg("outputs_high", "ro", "Pads of outputs 32 to 63, one bit per output; `gpio_high.out_now` "
        "is what drives them. On an image the header lines from 32 on."),
))


def _command():
    regs = [
        Reg("enables", "rw", "Which step generators follow their command and which encoders wait "
            "for an index; staged until the commit strobe.", (
            Field("stepgen", 0, 16, "Bit n: step generator n follows its velocity; 0 brings it to "
                "rest at its stop_accel."),
            Field("encoder_index", 16, 16, "Bit n: encoder n latches its count at the next index "
                "pulse; 0 clears its latched flag."),
        )),
        Reg("gpio_out", "rw", "Level of each of the first 32 outputs, one bit per output, before "
            "inversion; staged until the commit strobe."),
        Reg("arms", "rw", "Which step generators wait for an index and which encoders for the "
            "probe; staged until the commit strobe.", (
            Field("stepgen_index", 0, 16, "Bit n: step generator n latches its pulses at the next "
                "index pulse; 0 clears its latched flag."),
            Field("encoder_probe", 16, 16, "Bit n: encoder n latches its count when the probe "
                "becomes active; 0 clears its latched flag."),
        )),
        Reg("probe_arms", "rw", "Which step generators wait for the probe; staged until the commit "
            "strobe.", (
            Field("stepgen_probe", 0, 16, "Bit n: step generator n latches its pulses when the "
                "probe becomes active; 0 clears its latched flag."),
        )),
    ]
    for n in range(MAX_STEPGEN):
        regs += [
            Reg(f"stepgen{n}_velocity", "rw", f"Signed velocity of step generator {n}; one unit is "
                "f_clk / 2^32 steps per second. "
                "Staged until the commit strobe; -2^31 is taken as -(2^31-1)."),
            Reg(f"stepgen{n}_accel", "rw", f"Acceleration limit of step generator {n}; one unit is "
                "f_clk^2 / 2^56 steps per second squared, "
                "0 is no limit. Staged until the commit strobe."),
        ]
    for n in range(MAX_PWM):
        regs.append(Reg(f"pwm{n}_width", "rw", f"Width, enable and direction of PWM {n}. Staged "
            "until the commit strobe, applied at the next period edge.", (
            Field("width", 0, 29, "Time the output is active in each period, in 1/256 clock; the "
                "period or more is 100 %. The fraction counts with dither only. "
                  "PDM: bits 24:8 are the density in 1/65536; 65536 or more is constantly active."),
            _bit("enable", 30, "1: the output works; 0: it rests at its inactive level."),
            _bit("direction", 31, "1: reverse; the level of the direction output, or which of the "
                "two outputs carries the pulses."),
        )))
    regs.append(Reg("gpio_out_high", "rw", "Level of outputs 32 to 63, one bit per output, before "
        "inversion; staged until the commit strobe."))
    return tuple(regs)


def _status():
    regs = [
        Reg("sample_lo", "ro", "Low word of the wall clock, in clocks, at the last sample strobe."),
        Reg("sample_hi", "ro", "High word of the wall clock, in units of 2^32 clocks, at the last "
            "sample strobe."),
        Reg("gpio_in", "ro", "Level of each of the first 32 inputs after its debounce at the last "
            "sample strobe, one bit per input."),
        Reg("flags0", "ro", "One bit per channel, at the last sample strobe.", (
            Field("encoder_index", 0, 16, "Bit n: encoder n has latched its count at an index; "
                "stays until its arm bit goes 0."),
            Field("limited", 16, 16, "Bit n: step generator n had to wait for its timing since the "
                "sample before."),
        )),
        Reg("flags1", "ro", "One bit per channel, at the last sample strobe.", (
            Field("stepgen_index", 0, 16, "Bit n: step generator n has latched its pulses at an "
                "index; stays until its arm bit goes 0."),
            Field("encoder_probe", 16, 16, "Bit n: encoder n has latched its count at the probe; "
                "stays until its arm bit goes 0."),
        )),
        Reg("flags2", "ro", "One bit per channel, at the last sample strobe.", (
            Field("stepgen_probe", 0, 16, "Bit n: step generator n has latched its pulses at the "
                "probe; stays until its arm bit goes 0."),
            Field("illegal", 16, 16, "Bit n: encoder n has seen A and B change on one clock since "
                "the sample before."),
        )),
        Reg("estop", "ro", "Which e-stop inputs have been active since the last clear, one bit per "
            "input, at the last sample strobe. On an image its four e-stops, bits 3:0."),
        Reg("left", "ro", "Clocks the watchdog had left at the last sample strobe; as "
            "`watchdog.remaining`."),
    ]
    for n in range(MAX_STEPGEN):
        regs += [
            Reg(f"stepgen{n}_position_lo", "ro", f"Fraction of the position of step generator {n} "
                "at the last sample strobe, in 2^-32 steps, biased by half a step."),
            Reg(f"stepgen{n}_position_hi", "ro", f"Pulses emitted by step generator {n} at the "
                "last sample strobe, in steps, signed."),
            Reg(f"stepgen{n}_velocity", "ro", f"Velocity of step generator {n} at the last sample "
                "strobe, signed; one unit is f_clk / 2^32 steps per second."),
        ]
    for n in range(MAX_ENCODER):
        regs += [
            Reg(f"encoder{n}_count", "ro", f"Count of encoder {n} at the last sample strobe, in "
                "counts of its mode, signed."),
            Reg(f"encoder{n}_edge", "ro", f"The last counted edge of encoder {n}, and what could "
                "not be counted.", (
                Field("edge_time", 0, 24, "Low 24 bits of the wall clock, in clocks, at the last "
                    "counted edge before the sample strobe."),
                Field("errors", 24, 8, "Illegal transitions (A and B changed on one clock) since "
                    "power-up, a count modulo 256."),
            )),
        ]
    regs.append(Reg("gpio_in_high", "ro", "Level of inputs 32 to 63 after their debounce at the "
        "last sample strobe, one bit per input."))
    # The latches begin at a multiple of 32 words: selecting one is an OR (`fast_path.run0`).
    regs += [Reg(f"reserved{n}", "ro", "Reads 0; no unit.") for n in range(7)]
    regs += [Reg(f"encoder{n}_latch", "ro", f"Count of encoder {n} at its latched index or probe, "
        "signed. Live, not sampled; holds while a flag is up.") for n in range(MAX_ENCODER)]
    regs += [Reg(f"stepgen{n}_latch", "ro", f"Pulses emitted by step generator {n} at its latched "
        "index or probe, signed. Live, not sampled; holds while a flag is up.")
        for n in range(MAX_STEPGEN)]
    return tuple(regs)


COMMAND = Bank("command", 14, "command", "Staged commands, contiguous: writing them changes "
    "nothing until the commit strobe.", _command())
STATUS = Bank("status", 15, "status", "The last sample, contiguous: all words but the latches are "
    "of one clock, complete 18 clocks after the strobe, and reading changes nothing.", _status())

STEPGEN_REGS = (
    Reg("steplen", "rw", "Shortest time STEP stays active, in clocks, 13 bits; 0 is taken as 1.", (
        Field("clocks", 0, 13, "Time in clocks."),)),
    Reg("stepspace", "rw", "Shortest time STEP stays inactive, in clocks, 13 bits; 0 is taken as "
        "1.", (Field("clocks", 0, 13, "Time in clocks."),)),
    Reg("dirsetup", "rw", "Shortest time from an edge of DIR to the next rise of STEP, in clocks, "
        "16 bits.", (Field("clocks", 0, 16, "Time in clocks."),)),
    Reg("dirhold", "rw", "Shortest time from the fall of STEP to an edge of DIR, in clocks, 16 "
        "bits.", (Field("clocks", 0, 16, "Time in clocks."),)),
    Reg("stop_accel", "rw", "Deceleration of a soft stop; one unit is f_clk^2 / 2^56 steps per "
        "second squared, 0 stops at once."),
    Reg("mode", "rw", "What the two pins carry, and their polarity.", (
        _bit("step_invert", 0, "1: the STEP pin is active low."),
        _bit("dir_invert", 1, "1: the DIR pin is turned over."),
        Field("kind", 2, 2, "What the pins carry, a number.", (
            ("step_dir", 0, "STEP pulses and a DIR level."),
            ("up_down", 1, "Forward pulses on STEP, backward pulses on DIR."),
            ("quadrature", 2, "A on STEP and B on DIR; A leads forwards; each step is one edge."),
        )),
        _bit("index_invert", 4, "1: the index pin is active low."),
    )),
)
ENCODER_REGS = (
    Reg("mode", "rw", "How edges are counted and what the index does.", (
        Field("select", 0, 3, "Counting mode, a number.", (
            ("x4", 0, "Quadrature, every edge of A and B."),
            ("x2", 1, "Quadrature, the edges of A."),
            ("x1", 2, "Quadrature, one edge of A per period."),
            ("counter", 3, "Every rise of A counts up; B is not used."),
            ("step_dir", 4, "Every rise of A counts, down while B is 1."),
            ("up_down", 5, "Every rise of A counts up, every rise of B down."),
        )),
        _bit("index_invert", 4, "1: the index pin is active low."),
        _bit("mask_enable", 5, "1: the index counts only while the mask pin is active."),
        _bit("mask_invert", 6, "1: the mask pin is active low."),
        _bit("clear_on_index", 7, "1: a latched index sets the count to 0."),
    )),
    Reg("filter", "rw", "How long a level of A, B or index must stay before it counts, in clocks, "
        "0 to 255.", (Field("clocks", 0, 8, "Time in clocks."),)),
)
PWM_REGS = (
    Reg("period", "rw", "Length of a period, or of a PDM bit, in clocks, 21 bits; 0 is off (PDM: "
        "1). Taken at the next period edge.", (Field("clocks", 0, 21, "Time in clocks."),)),
    Reg("mode", "rw", "What the pins carry, and their polarity.", (
        _bit("invert", 0, "1: the outputs are active low."),
        Field("kind", 1, 2, "What the pins carry, a number.", (
            ("pwm", 0, "Pulses on the output, direction beside them."),
            ("up_down", 1, "Pulses on the output while positive, on the direction pin while "
                "negative."),
            ("pdm", 2, "Pulse density on the output, direction beside it."),
        )),
        _bit("dither", 3, "1: the width's fraction is spread over 256 periods."),
        _bit("swap", 4, "1: the two pins change places."),
    )),
)

STEPGEN = tuple(Bank(f"stepgen{n}", 16 + n, "stepgen", "Timing, kind and polarity of step "
    f"generator {n}. Set while the gate is closed.", STEPGEN_REGS) for n in range(MAX_STEPGEN))
ENCODER = tuple(Bank(f"encoder{n}", 32 + n, "encoder", "Counting mode and filter of encoder "
    f"{n}.", ENCODER_REGS) for n in range(MAX_ENCODER))
PWM = tuple(Bank(f"pwm{n}", 48 + n, "pwm", f"Period, kind and polarity of PWM {n}.", PWM_REGS)
    for n in range(MAX_PWM))

BANKS = (SDRAM, IDENT, TIMEBASE, WATCHDOG, GPIO, LED, DEBOUNCE, COMMAND, STATUS) + STEPGEN + (
    ENCODER) + PWM + (FLASH, RX_ADMISSION, SEGMENTS, PADS, FAST_PATH, GPIO_HIGH, PINMUX_OUT, PINMUX_IN)


def check():
    """Refuses a map that cannot be one: overlapping pages, duplicate names, fields that overlap,
    empty prose."""
    pages = list(LITEX_PAGES.values()) + [b.page for b in BANKS]
    assert len(set(pages)) == len(pages), "two banks on one page"
    for bank in BANKS:
        assert bank.doc.endswith("."), f"{bank.name}: describe it in a sentence"
        assert 4 * len(bank.regs) <= CSR_PAGE, f"{bank.name}: does not fit its page"
        names = [r.name for r in bank.regs]
        assert len(set(names)) == len(names), f"{bank.name}: duplicate register name"
        for reg in bank.regs:
            assert reg.access in ("ro", "rw", "wo"), f"{bank.name}.{reg.name}: access"
            assert reg.doc.endswith("."), f"{bank.name}.{reg.name}: describe it in a sentence"
            used = 0
            for f in reg.fields:
                mask = ((1 << f.width) - 1) << f.lsb
                assert f.doc.endswith(".") and mask < 1 << 32 and not used & mask, (
                    f"{bank.name}.{reg.name}.{f.name}")
                used |= mask


check()
