"""CSR banks around the cores: the only place where a register of `regmap.py` is connected to its
signal.

The cores (`gateware/rtl`) know no bus; this file knows no motion. One slave on LiteX's CSR bus
carries pages 8 and up:

    bus  --> write pipeline --> staging and settings registers, mirrors --> cores
         <-- gates <-- live words | what the sample caught | wide counters | mirrors  <-- cores

* Writes take effect one clock after the bus cycle, so that address decoding is not in the cores'
  timing paths. The CPU cannot notice: its next access is two clocks later.
* Eight words are read through one register (their gate), which stores the OR of the addressed ones:
  0 if none is addressed. All gates are joined by OR. No gate has a reset: all flip-flops of a tile
  share one, and with a reset of their own for so many words the placer ran out of tiles (decision
  8).
* Words that every channel has, and of which one is read at a time, are in LUT RAM: totals, samples
  and latches (`wide_counter`). Settings and staged commands are read back from one block RAM
  (`mirror`). A register reads as many bits as it has.
* Words that change every clock and must belong to one clock for all channels (fraction and velocity
  of a step generator) are stored in flip-flops by the sample strobe.
* Registers of absent channels are never created: they read 0 and ignore writes.
* The fast path writes and reads pages 8 to 15 between the accesses of the CPU, which waits.
"""

from functools import reduce
from operator import or_
from types import SimpleNamespace

from migen import Array, Case, Cat, ClockSignal, Constant, If, Instance, Memory, Mux, Replicate, Signal
from litex.gen import LiteXModule
from litex.soc.interconnect import csr_bus

from . import VERSION, multiplexer, regmap as rm

_WORD_BITS = (rm.CSR_PAGE // 4).bit_length() - 1
_LOW = 4  # an address is decoded in two halves, so that a register costs one LUT
# Bits of a register's number in the fast path: pages 8 to 15, of each the first 128 words.
_FAST_BITS = 10
_GATE = 8  # words behind one gate: two to a LUT, and one LUT more to join four of those


class FabricBus(LiteXModule):
    """Decodes pages 8 and up. `storage` and `pulse` create written signals, `live` and `reads` read
    ones, `mirror` both.

    A read has two clocks:

        clk      _/‾\\_/‾\\_/‾\\_/‾\\_
        coming   --X A X-----------
        address  ------X A X-------
        A's gate   --------X word X---    all others are 0
        dat_r      --------X word X---    OR of all gates
    """

    def __init__(self):
        self.bus = csr_bus.Interface(data_width=32, address_width=rm.CSR_ADDRESS_WIDTH)
        # The word address from the bus master, of a write: `bus.adr` is the same one after the
        # bridge's state, and half a clock later. And the one it will have in the next clock, of a
        # read. Both whether or not they are for this slave: a read has no side effect, so an
        # unintended one does no harm.
        self.adr, self.coming = Signal(rm.CSR_ADDRESS_WIDTH), Signal(rm.CSR_ADDRESS_WIDTH)
        # A word that the fast path stages, and one that it gathers in the next clock. The CPU waits
        # meanwhile.
        self.stages, self.to, self.staged = Signal(), Signal(_FAST_BITS), Signal(32)
        self.gathers_next, self.source_next = Signal(), Signal(_FAST_BITS)
        # In flip-flops: between the fast path's choice and a word behind its gate lie 16 ns.
        address = Signal(rm.CSR_ADDRESS_WIDTH, reset_less=True)
        self.word = address[:_WORD_BITS]
        self.page = address[_WORD_BITS:]
        self.we = Signal()
        self.data = Signal(32, reset_less=True)
        self.we_word = Signal(_WORD_BITS, reset_less=True)
        self.we_page = Signal(rm.CSR_ADDRESS_WIDTH - _WORD_BITS, reset_less=True)
        self._decoded = {}
        self._words = []     # (hit, value)
        self._mirrored = []  # (read hit, write hit, width)
        self._places = []    # (page, word) of each
        self._gates = []

        # # #

        written = Mux(self.stages, _fast_address(self.to), self.adr)
        self.sync += [
            address.eq(Mux(self.gathers_next, _fast_address(self.source_next), self.coming)),
            self.we.eq(self.bus.we | self.stages),
            self.data.eq(Mux(self.stages, self.staged, self.bus.dat_w)),
            Cat(self.we_word, self.we_page).eq(written),
        ]

    def _is(self, kind, value, number):
        """`value == number`, decoded once for all users."""
        if (kind, number) not in self._decoded:
            hit = self._decoded[kind, number] = Signal(name=f"{kind}_{number}")
            self.comb += hit.eq(value == number)
        return self._decoded[kind, number]

    def _both(self, kind, value, number):
        low = (1 << _LOW) - 1
        return self._is(f"{kind}_high", value[_LOW:], number >> _LOW) & self._is(f"{kind}_low", value[:_LOW], number & low)

    def read_hit(self, page, word):
        """High while this word is addressed."""
        return self._both("page", self.page, page) & self._both("word", self.word, word)

    def write_hit(self, page, word):
        """High for one clock when this word is written; `data` is the written word."""
        return self.we & self._both("we_page", self.we_page, page) & self._both("we_word", self.we_word, word)

    def page_hit(self, page):
        """High while this page is addressed."""
        return self._both("page", self.page, page)

    def write_page(self, page, words):
        """High for one clock when one of the first `words` words of the page is written."""
        return self.we & self._both("we_page", self.we_page, page) & (self.we_word < words)

    def pulse(self, bank, name):
        """High for one clock when the register is written; `self.data` is the written word."""
        strobe = Signal()
        self.comb += strobe.eq(self.write_hit(bank.page, bank.offset(name) // 4))
        return strobe

    def storage(self, bank, name, width=32, data=None, reset=0):
        """The last written value, `reset` at power-up. Keeps its value through a reset of the CPU:
        the firmware writes it at boot."""
        signal = Signal(width, reset=reset, reset_less=True, name=f"{bank.name}_{name}")
        self.sync += If(self.write_hit(bank.page, bank.offset(name) // 4), signal.eq(self.data if data is None else data))
        return signal

    def reads(self, hit, value):
        """`value` is read while `hit`."""
        self._words.append((hit, value))

    def live(self, bank, name, value):
        """Makes `value` readable as this register."""
        self.reads(self.read_hit(bank.page, bank.offset(name) // 4), Constant(value, 32) if isinstance(value, int) else value)

    def mirror_settings(self, banks, channels, widths):
        """The settings of every channel of a kind read back as written: {register: width}."""
        if not channels:
            return
        first = banks[0].page
        assert first % 16 == 0
        for name, width in widths.items():
            word = banks[0].offset(name) // 4
            hits = []
            for kind, page, at in (("page", self.page, self.word), ("we_page", self.we_page, self.we_word)):
                hit = self._is(f"{kind}_high", page[_LOW:], first >> _LOW) & self._both(kind.replace("page", "word"), at, word)
                hits.append(hit & (page[:_LOW] < channels) if channels < 16 else hit)
            self._mirrored.append((*hits, width))
            self._places += [(banks[n].page, word) for n in range(channels)]

    def mirror_words(self, bank, first, words, width=32):
        """`words` words of one page from `first` on read back as written."""
        if not words:
            return
        hits = []
        for kind, page, at in (("page", self.page, self.word), ("we_page", self.we_page, self.we_word)):
            hit = Signal()
            self.comb += hit.eq(self._both(kind, page, bank.page) & (at >= first) & (at < first + words))
            hits.append(hit)
        self._mirrored.append((*hits, width))
        self._places += [(bank.page, first + n) for n in range(words)]

    def _mirror(self):
        """One block RAM for all of them. It reads every clock; its word is used if a mirrored
        register was addressed, with as many bits as the register has."""
        def at(page, word):
            return Mux(page[4:6] != 0, Cat(word[:3], page[:6]), Cat(word[:6], page[0]))

        def number(page, word):
            return page << 3 | word & 7 if page >> 4 & 3 else (page & 1) << 6 | word & 63

        assert len({number(*place) for place in self._places}) == len(self._places), "two registers share a word of the mirror"
        value = Signal(32)
        self.specials += Instance("mirror",
            i_clk=ClockSignal("sys"), i_we=self.we & reduce(or_, [write for _, write, _ in self._mirrored]),
            i_write_at=at(self.we_page, self.we_word), i_data=self.data, i_read_at=at(self.page, self.word), o_value=value)
        bits, low = [], 0
        for width in sorted({width for _, _, width in self._mirrored}):
            wide = Signal(reset_less=True)
            self.sync += wide.eq(reduce(or_, [read for read, _, w in self._mirrored if w >= width]))
            bits += [bit & wide for bit in value[low:width]]
            low = width
        return Cat(*bits)

    def do_finalize(self):
        words = sorted(self._words, key=lambda word: -len(word[1]))
        for first in range(0, len(words), _GATE):
            group = words[first:first + _GATE]
            gate = Signal(max(len(value) for _, value in group), reset_less=True)
            self.sync += gate.eq(reduce(or_, [Replicate(hit, len(value)) & value for hit, value in group]))
            self._gates.append(gate)
        if self._mirrored:
            self._gates.append(self._mirror())
        self.comb += self.bus.dat_r.eq(reduce(or_, self._gates))


def _fast_address(number):
    """The word address of a register that the fast path calls by this number."""
    return Cat(number[:7], Constant(0, _WORD_BITS - 7), number[7:], Constant(1, 1))


def guard_places():
    """Where the services may write: (word address, words less 1) of each."""
    snapshot, guard = (rm.TIMEBASE.base + rm.TIMEBASE.offset(name) for name in ("snapshot", "guard"))
    start, size = rm.WINDOW
    places = [rm.SDRAM_RAM, (rm.SEGMENTS.base, rm.CSR_PAGE), (snapshot, 4), (guard, 4), (start, size // 3 * 2), (start + size // 3 * 2, size // 3)]
    for at, size in places:
        assert size & size - 1 == 0 and at % size == 0, f"{at:#x}, {size:#x} bytes: not a power of two, or not at a multiple of it"
    return [(at // 4, size // 4 - 1) for at, size in places]


# Signals of `Pads` that leave the chip and are read back.
DRIVEN = ("step", "dir", "step_n", "dir_n", "pwm", "pwm_dir", "outputs")


class Pads:
    """The signals of a board's pins, one bit per channel, after the platform's polarity has been
    dealt with. On an image these are between the cores and the multiplexer, and its pins are
    `lines`."""

    def __init__(self, channels, lines=None):
        self.step = Signal(max(1, channels.stepgen))
        self.dir = Signal(max(1, channels.stepgen))
        self.step_n = Signal(max(1, channels.stepgen))
        self.dir_n = Signal(max(1, channels.stepgen))
        self.step_index = Signal(max(1, channels.stepgen))
        self.enc_a = Signal(max(1, channels.encoder))
        self.enc_b = Signal(max(1, channels.encoder))
        self.enc_i = Signal(max(1, channels.encoder))
        self.enc_mask = Signal(max(1, channels.encoder))
        self.pwm = Signal(max(1, channels.pwm))
        self.pwm_dir = Signal(max(1, channels.pwm))
        self.inputs = Signal(max(1, channels.inputs))
        self.outputs = Signal(max(1, channels.outputs))
        # What is at the pads of those that are driven.
        for name in DRIVEN:
            setattr(self, f"{name}_seen", Signal(len(getattr(self, name))))
        self.ext_reset = Signal()
        self.factory = Signal()  # 1 is active
        self.spi_cs_n = Signal()
        self.spi_clk = Signal()
        self.spi_mosi = Signal()
        self.spi_miso = Signal()
        self.led = Signal()
        self.gate = Signal()
        if lines:
            # To the registers in the pads; what is at the pads; the button's pad.
            self.line_levels, self.line_drives, self.line_seen = Signal(lines.count), Signal(lines.count), Signal(lines.count)
            self.key = Signal(reset=int(lines.key_active_low))


class Cores(LiteXModule):
    """All cores of one board and their banks. `arrival` is the wall clock of the frame the MAC
    presents. `words` is the stream into the receive slots, `answer` the way to transmit slot 0.
    While `hold`, the bus master must not access the registers. With `lines`
    (`multiplexer.Lines`) the pins are configured at run time."""

    def __init__(self, channels, sys_clk_hz, rom_words, ext_reset_active_low=False, estop_mask=0, estop_level=0,
                 safe_mask=0, invert_mask=0, jobs=0, lines=None):
        self.pads = pads = Pads(channels, lines)
        self.lines = lines
        self.abi = Signal(32)            # constant; the SoC knows it once its map is final
        self.frame_done = Signal()       # MAC: a frame is complete in `frame_slot`
        self.frame_slot = Signal(max=rm.ETHMAC_RX_SLOTS)
        self.frame_pending = Signal()    # MAC: presents the frame in `pending_slot`
        self.pending_slot = Signal(max=rm.ETHMAC_RX_SLOTS)
        self.eth_beat = Signal()         # PHY: a clock per 4 clocks of its receive clock
        # A word on its way into the receive slots, as a slot reads. With the last one: all four
        # bytes are the frame's, the FCS is wrong. `room`: the frame has found a slot free.
        self.words = SimpleNamespace(
            **{name: Signal(name=f"words_{name}") for name in ("valid", "last", "whole", "bad", "room")}, data=Signal(32, name="words_data"))
        self.refuse = Signal()           # with the last word: discard the frame
        self.take = Signal()             # a clock later: the frame has been executed, discard it
        # Transmit slot 0: it can be sent now; it is waiting or being sent. Send `length` bytes of
        # it. Write `put` to its word `put_at`.
        self.answer = SimpleNamespace(
            **{name: Signal(name=f"answer_{name}") for name in ("free", "sending", "send", "puts")},
            length=Signal(11, name="answer_length"), put_at=Signal(7, name="answer_put_at"), put=Signal(32, name="answer_put"))
        self.hold = Signal()
        self.fabric = fabric = FabricBus()
        self.bus = fabric.bus
        self.jobs = jobs                 # axes of a job: step generators 0 and up; 0: no segments

        # # #

        self.clk, self.rst = _clock()
        # The fast path executes a command: it is sampled, and committed now or at its time.
        self.executes = SimpleNamespace(**{name: Signal(name=f"executes_{name}") for name in ("taken", "commit", "timed")})
        estop, self.cleared = Signal(), Signal()
        self._timebase(fabric)
        self._watchdog(fabric, estop, ext_reset_active_low)
        self.comb += [pads.gate.eq(self.gate), pads.step_n.eq(~pads.step), pads.dir_n.eq(~pads.dir)]
        self._ident(fabric, channels, sys_clk_hz, rom_words)
        self._led(fabric, sys_clk_hz)
        self._flash(fabric)
        self.job = self._segments(fabric, jobs, channels) if jobs else None
        self._gpio(fabric, channels, estop, estop_mask, estop_level, safe_mask, invert_mask)
        arms = {name: self._committed(fabric, name) for name in ("enables", "arms", "probe_arms")}
        self._stepgens(fabric, channels.stepgen, arms)
        self._encoders(fabric, channels.encoder, arms)
        for n in range(channels.pwm):
            self._pwm(fabric, n)
        self._flags(fabric)
        self._mirrors(fabric, channels)
        if lines:
            latched, levels = multiplexer.join(self, channels, estop)
            self._sampled(fabric, "estop", latched)
            for n, name in enumerate(("outputs", "outputs_high")[:-(-lines.count // rm.WORD_PINS)]):
                fabric.live(rm.PADS, name, levels[rm.WORD_PINS * n:rm.WORD_PINS * (n + 1)])
        else:
            self._pads(fabric, channels)
        self._frames(fabric, select=arms["probe_arms"][0][16:21])

    def _frames(self, fabric, select):
        """What is done with a frame before it lies in a slot: rx_admission may discard it, the fast
        path may execute it. Both compare it with the same words."""
        admission, b, words, answer = rm.RX_ADMISSION, rm.FAST_PATH, self.words, self.answer
        mode, refused = fabric.storage(admission, "mode", 2), Signal(32)
        at, like_high, like_low, out, executed = Signal(5), Signal(), Signal(), Signal(), Signal()
        # As with the debounce: the low bits of the word's address are the place of the word.
        self.specials += Instance("rx_admission",
            i_clk=self.clk, i_header_we=fabric.write_page(admission.page, rm.HEADER_PLACES), i_header_at=fabric.we_word[:4],
            i_header=fabric.data, i_mode=mode, i_admit=fabric.pulse(admission, "admit"),
            **{f"i_{name}": getattr(words, name) for name in ("valid", "last", "bad", "room", "data")},
            o_refuse=self.refuse, o_refused=refused, o_at=at, o_like_high=like_high, o_like_low=like_low)
        fabric.live(admission, "mode", mode)
        fabric.live(admission, "refused", refused)

        gate = fabric.storage(b, "gate", 10)
        self.specials += Instance("fast_path",
            i_clk=self.clk, i_rst=self.rst, i_run_we=fabric.write_page(b.page, 16), i_run_at=fabric.we_word[:4], i_run=fabric.data[:19],
            i_ip_sum=fabric.storage(b, "ip_sum", 16), i_udp_sum=fabric.storage(b, "udp_sum", 16),
            i_gate_as=gate[:8], i_executes=gate[8], i_timed=gate[9], **{f"i_{name}": fabric.pulse(b, name) for name in ("pass", "revoke")},
            **{f"i_{name}": getattr(words, name) for name in ("valid", "last", "whole", "bad", "data")},
            i_at=at, i_like_high=like_high, i_like_low=like_low,
            i_gate_now=self.gate_word, i_waiting=self.timed_waits, i_select=select, i_free=answer.free,
            o_stages=fabric.stages, o_to=fabric.to, o_take=self.take, o_taken=self.executes.taken,
            o_commit=self.executes.commit, o_commit_timed=self.executes.timed,
            o_gathers_next=fabric.gathers_next, o_from_next=fabric.source_next, o_puts=answer.puts, o_put_at=answer.put_at, o_hold=self.hold,
            o_out=out, o_executed=executed)
        fabric.live(b, "status", Cat(executed, out, answer.sending))
        self.comb += [
            fabric.staged.eq(words.data),
            answer.send.eq(self.executes.taken),
            answer.length.eq(fabric.storage(b, "length", len(answer.length))),
            answer.put.eq(fabric.bus.dat_r),
        ]

    def _committed(self, fabric, name):
        """A word of single bits: (as staged, as committed)."""
        staged, now = fabric.storage(rm.COMMAND, name), Signal(32, reset_less=True, name=f"{name}_now")
        self.sync += If(self.commit, now.eq(staged))
        fabric.live(rm.COMMAND, name, staged)
        return staged, now

    def _sampled(self, fabric, name, value):
        """A status word caught by the sample strobe."""
        caught = Signal(len(value), reset_less=True, name=f"caught_{name}")
        self.sync += If(self.sample, caught.eq(value))
        fabric.live(rm.STATUS, name, caught)

    def _timebase(self, fabric):
        b = rm.TIMEBASE
        self.now = now = Signal(64)
        caught, pending = Signal(64, reset_less=True), Signal()
        self.commit, self.sample = Signal(), Signal()
        strobe = fabric.pulse(b, "strobe")
        at_lo = fabric.storage(b, "commit_at_lo")
        at_hi = fabric.storage(b, "commit_at_hi")
        self.specials += Instance("timebase",
            i_clk=self.clk, i_rst=self.rst, o_now=now,
            i_commit_now=strobe & fabric.data[0] | self.executes.commit,
            i_sample_now=strobe & fabric.data[1] | self.executes.taken,
            i_commit_timed=strobe & fabric.data[2] | self.executes.timed,
            i_commit_at=Cat(at_lo, at_hi),
            o_commit=self.commit, o_sample=self.sample, o_pending=pending)
        snapshot, beats = fabric.pulse(b, "snapshot"), Signal(32)
        self.sync += If(snapshot, caught.eq(now))
        self.specials += Instance("pace", i_clk=self.clk, i_changed=self.eth_beat, i_catch_it=snapshot, o_caught=beats)
        fabric.live(b, "eth_beats", beats)
        self.leash = Signal()
        self.specials += Instance("leash", i_clk=self.clk, i_rst=self.rst, i_set=fabric.pulse(b, "leash"), i_clocks=fabric.data[:24], o_irq=self.leash)

        self._guard(fabric)

        # Each slot stores the time when its frame was complete, so that a frame that had to queue
        # keeps its own time.
        slot_time = Array([Signal(64, reset_less=True) for _ in range(rm.ETHMAC_RX_SLOTS)])
        arrival = Signal(64, reset_less=True)
        self.sync += [
            If(self.frame_done, slot_time[self.frame_slot].eq(now)),
            If(self.frame_pending, arrival.eq(slot_time[self.pending_slot])),
        ]

        for name, value in (("now", caught), ("arrival", arrival), ("commit_at", Cat(at_lo, at_hi))):
            fabric.live(b, f"{name}_lo", value[:32])
            fabric.live(b, f"{name}_hi", value[32:])
        fabric.live(b, "status", pending)
        self.timed_waits = pending
        self._sampled(fabric, "sample_lo", now[:32])
        self._sampled(fabric, "sample_hi", now[32:])

    def _guard(self, fabric):
        """The guard between the CPU's data bus and the interconnect; `soc` connects it."""
        b, at = rm.TIMEBASE, Signal(30)
        self.guard = guard = SimpleNamespace(
            **{name: Signal(name=f"guard_{name}") for name in ("stb", "we", "ack", "we_out", "vacant", "answer", "irq")}, adr=Signal(30, name="guard_adr"))
        closed, refused = Signal(), Signal()
        places = guard_places()
        pack = [sum(word << 30 * n for n, word in enumerate(words)) for words in zip(*places)]
        self.specials += Instance("guard",
            p_KEY=Constant(rm.OPEN, 32), p_WAYS=len(places), **{f"p_{name}": Constant(words, 30 * len(places)) for name, words in zip(("PLACES", "ROOMS"), pack)},
            i_clk=self.clk, i_rst=self.rst, i_set=fabric.pulse(b, "guard"), i_word=fabric.data,
            **{f"i_{name}": getattr(guard, name) for name in ("stb", "we", "adr", "ack", "vacant")},
            **{f"o_{name}": getattr(guard, name) for name in ("we_out", "answer", "irq")},
            o_closed=closed, o_refused=refused, o_at=at)
        fabric.live(b, "guard_status", Cat(closed, Constant(0, 30), refused))
        fabric.live(b, "guard_at", Cat(Constant(0, 2), at))

    def _watchdog(self, fabric, estop, active_low):
        b = rm.WATCHDOG
        self.gate, self.stop, self.all_stopped = Signal(), Signal(), Signal()
        pin, bitten, latched, armed, estop_latched = (Signal() for _ in range(5))
        remaining, last, bites, last_close = Signal(32), Signal(32), Signal(32), Signal(4)
        timeout = fabric.storage(b, "timeout")
        grace = fabric.storage(b, "grace")
        control = fabric.pulse(b, "control")
        keys = {}
        for name, key in (("arm", rm.ARM), ("soft", rm.SOFT), ("stop", rm.STOP), ("clear", rm.CLEAR)):
            keys[name] = Signal()
            self.comb += keys[name].eq(control & (fabric.data == key))
        self.specials += [
            Instance("extreset", p_ACTIVE_LOW=int(active_low), i_clk=self.clk, i_pin=self.pads.ext_reset, o_active=pin),
            Instance("watchdog",
                i_clk=self.clk, i_rst=self.rst, i_ext_reset=pin, i_estop=estop,
                i_token_we=fabric.pulse(b, "token"), i_token=fabric.data, i_feed=self.executes.taken,
                i_arm=keys["arm"], i_soft_stop=keys["soft"], i_shut=keys["stop"], i_clear=keys["clear"],
                i_timeout=timeout, i_grace=grace, i_all_stopped=self.all_stopped,
                o_gate=self.gate, o_stop=self.stop, o_bitten=bitten, o_reset_latched=latched, o_estop_latched=estop_latched,
                o_armed=armed, o_cleared=self.cleared, o_last_close=last_close,
                o_remaining=remaining, o_last_token=last, o_bites=bites),
        ]
        self.gate_word = Cat(self.gate, self.stop, bitten, latched, pin, armed, estop_latched, estop)
        for name, value in (("timeout", timeout), ("grace", grace), ("remaining", remaining), ("last_token", last), ("bites", bites),
                            ("status", self.gate_word), ("last_close", last_close)):
            fabric.live(b, name, value)
        self._sampled(fabric, "left", remaining)

    def _ident(self, fabric, channels, sys_clk_hz, rom_words):
        major, minor, patch = VERSION
        for name, value in (
            ("magic", rm.MAGIC),
            ("abi", self.abi),
            ("gateware_version", major << 16 | minor << 8 | patch),
            ("sys_clk_hz", int(sys_clk_hz)),
            ("channels0", channels.stepgen | channels.encoder << 8 | channels.pwm << 16),
            ("channels1", channels.inputs | channels.outputs << 8),
            ("board_rom_words", rom_words),
            ("features", (1 if self.jobs else 0) | 2 | (4 if self.lines else 0)),
            *((("pins", self.lines.count), ("platform", self.lines.platform)) if self.lines else ()),
        ):
            fabric.live(rm.IDENT, name, value)

    def _led(self, fabric, sys_clk_hz):
        pattern = fabric.storage(rm.LED, "pattern", 3)
        fabric.live(rm.LED, "pattern", pattern)
        self.specials += Instance("led", p_BITS=int(sys_clk_hz).bit_length(), i_clk=self.clk, i_pattern=pattern, o_lit=self.pads.led)

    def _flash(self, fabric):
        b, busy, received = rm.FLASH, Signal(), Signal(32)
        select, length = fabric.storage(b, "control", 1), fabric.storage(b, "length", 6)
        meta, factory = Signal(reset_less=True), Signal(reset_less=True)
        meta.attr.add("keep"), factory.attr.add("keep")
        self.sync += [meta.eq(self.pads.factory), factory.eq(meta)]
        self.specials += Instance("spi",
            i_clk=self.clk, i_select=select, i_start=fabric.pulse(b, "data"), i_data=fabric.data, i_length=length[:5],
            o_busy=busy, o_received=received,
            o_cs_n=self.pads.spi_cs_n, o_sck=self.pads.spi_clk, o_mosi=self.pads.spi_mosi, i_miso=self.pads.spi_miso)
        for name, value in (("control", select), ("data", received), ("length", length), ("status", Cat(busy, factory))):
            fabric.live(b, name, value)

    def _gpio(self, fabric, channels, estop, estop_mask, estop_level, safe_mask, invert_mask):
        """The first word of inputs and outputs, with the e-stop inputs, and the word behind it,
        where a board has so many pins: a core for each."""
        pads, job, wide = self.pads, self.job, rm.WORD_PINS
        latched = Signal(wide)
        raw = list(self._gpio_word(
            fabric, rm.GPIO, 0, ("gpio_out", "gpio_in"), channels, safe_mask, invert_mask,
            p_ESTOP_MASK=Constant(estop_mask, wide), p_ESTOP_LEVEL=Constant(estop_level, wide), p_JOBS=int(self.jobs > 0),
            i_job_mask=job.mask if job else 0, i_job_value=Cat(job.aux, job.aux)[:min(wide, len(pads.outputs))] if job else 0,
            i_clear=self.cleared, o_estop=Signal() if self.lines else estop, o_estop_latched=latched))
        if channels.inputs and not self.lines:
            self._sampled(fabric, "estop", latched[:min(wide, channels.inputs)])
        fabric.live(rm.GPIO, "estop_mask", estop_mask)
        fabric.live(rm.GPIO, "estop_level", estop_level)
        if max(channels.inputs, channels.outputs) > wide:
            high = self._gpio_word(fabric, rm.GPIO_HIGH, wide, ("gpio_out_high", "gpio_in_high"), channels, safe_mask >> wide, invert_mask >> wide)
            raw += [0] * (wide - len(raw)) + list(high)
        self._probe(fabric, raw)

    def _gpio_word(self, fabric, bank, first, names, channels, safe_mask, invert_mask, **more):
        """Inputs and outputs from number `first` on, as many as a word has bits. Returns the
        synchronised inputs."""
        (command, status), pads = names, self.pads
        has_in, has_out = (max(0, min(rm.WORD_PINS, count - first)) for count in (channels.inputs, channels.outputs))
        n_in, n_out = max(1, has_in), max(1, has_out)
        level, raw, out = Signal(n_in), Signal(n_in), Signal(n_out)
        value = fabric.storage(rm.COMMAND, command, n_out)
        # Before the firmware runs, the outputs have the board file's levels.
        safe, invert = (fabric.storage(bank, name, n_out, reset=mask & (1 << n_out) - 1) for name, mask in (("safe", safe_mask), ("invert_out", invert_mask)))
        # The limits are written directly into the core's RAM: the low bits of the word's address
        # are the input's number.
        limit_we = fabric.write_page(rm.DEBOUNCE.page, first + n_in) & (fabric.we_word[5] == first // rm.WORD_PINS)
        self.specials += Instance("gpio",
            p_INPUTS=n_in, p_OUTPUTS=n_out, i_clk=self.clk, i_gate=self.gate, i_commit=self.commit,
            i_value=value, i_safe=safe, i_invert=invert, i_in_pins=pads.inputs[first:first + n_in] if has_in or not first else 0,
            i_debounce_we=limit_we, i_debounce_pin=fabric.we_word[:5], i_debounce_limit=fabric.data[:16],
            o_in=level, o_raw=raw, o_out_pins=out, **{"i_job_mask": 0, "i_job_value": 0, "i_clear": 0, **more})
        if has_out or not first:
            self.comb += pads.outputs[first:first + n_out].eq(out)
        if has_in:
            fabric.live(bank, "in_now", level)
            fabric.live(bank, "raw_now", raw)
            self._sampled(fabric, status, level)
        if has_out:
            fabric.live(rm.COMMAND, command, value)
            for name, value in (("safe", safe), ("invert_out", invert), ("out_now", out)):
                fabric.live(bank, name, value)
        return raw

    def _probe(self, fabric, raw):
        """One probe for all channels: an input, one clock after `raw_now`. A filter would only
        delay it."""
        select = fabric.storage(rm.GPIO, "probe", 10)
        self.probe = Signal()
        self.sync += self.probe.eq(select[8] & (Array(raw + [0] * (rm.MAX_IN - len(raw)))[select[:6]] ^ select[9]))
        fabric.live(rm.GPIO, "probe", Cat(select[:6], Constant(0, 2), select[8:]))

    def _latch(self, index, probe_arm, index_arm, pending, indexed, probed):
        """The latch of one channel; returns its capture pulse."""
        capture = Signal()
        self.specials += Instance("latch",
            i_clk=self.clk, i_arm_index=index_arm, i_arm_probe=probe_arm, i_index=index, i_probe=self.probe, i_pending=pending,
            o_capture=capture, o_index_latched=indexed, o_probe_latched=probed)
        return capture

    def _segments(self, fabric, axes, channels):
        """Plays segments into the first `axes` step generators; returns the signals that those and
        the outputs need."""
        assert 1 <= axes <= min(rm.JOB_AXES_MAX, channels.stepgen), f"jobs of {axes} axes on a board with {channels.stepgen} step generators"
        b, n_out = rm.SEGMENTS, max(1, min(rm.WORD_PINS, channels.outputs))
        job = SimpleNamespace(
            **{name: Signal(name=f"job_{name}") for name in ("advance", "stop", "busy", "stage", "commit_due", "waits", "stopped")},
            at=Signal(4), word=Signal(32), data=Signal(32), aux=Signal(16), mask=fabric.storage(b, "mask", n_out))
        level, state, reason, refused, stands, held = Signal(8), Signal(2), Signal(3), Signal(5), Signal(), Signal()
        begun, left, tag, pace_now = Signal(32), Signal(32), Signal(16), Signal(17)
        pace, slew, beam = fabric.storage(b, "pace", 17, reset=0x10000), fabric.storage(b, "slew"), fabric.storage(b, "beam", 16)
        control = fabric.pulse(b, "control")
        self.specials += Instance("segments",
            p_AXES=axes, p_DEPTH=rm.JOB_SEGMENTS, i_clk=self.clk, i_gate=self.gate, i_halt=self.stop,
            i_word_we=fabric.write_page(b.page, 16), i_word_at=fabric.we_word[:4], i_word=fabric.data, i_push=fabric.pulse(b, "push"),
            **{f"i_{name}": control & (fabric.data == n) for n, name in ((1, "start"), (2, "quit"), (3, "clear"))},
            i_pace_we=fabric.pulse(b, "pace"), i_pace=pace, i_slew=slew, i_beam=beam,
            i_waits=job.waits, i_stopped=job.stopped, o_advance=job.advance, o_stop=job.stop, o_busy=job.busy,
            o_stage=job.stage, o_stage_at=job.at, o_staged_word=job.word, o_commit_due=job.commit_due, o_aux=job.aux,
            o_level=level, o_state=state, o_reason=reason, o_refused=refused, o_stands=stands, o_held=held,
            o_begun=begun, o_left_now=left, o_tag=tag, o_pace_now=pace_now)
        zero = Constant(0, 2)
        for name, value in (
            ("pace", pace), ("slew", slew), ("beam", beam), ("mask", job.mask),
            ("status", Cat(level, state, zero, reason, zero[0], refused, Constant(0, 3), stands, held)),
            ("begun", begun), ("left", left), ("current", Cat(job.aux, tag)), ("pace_now", pace_now), ("shape", axes | rm.JOB_SEGMENTS << 8),
        ):
            fabric.live(b, name, value)
        # The segments core or the bus writes the staged commands: one choice for all step
        # generators.
        self.comb += job.data.eq(Mux(job.busy, job.word, fabric.data))
        return job

    def _job_storage(self, fabric, n):
        """The staged command of a job's step generator: from the segments while they play, else
        from the bus. A job leaves nothing behind."""
        job, staged = self.job, []
        lowest = job.data == 0x8000_0000
        for name, at, data in (("velocity", 2 * n, job.data | lowest), ("accel", 2 * n + 1, job.data)):
            signal = Signal(32, reset_less=True, name=f"command_stepgen{n}_{name}")
            written = fabric.write_hit(rm.COMMAND.page, rm.COMMAND.offset(f"stepgen{n}_{name}") // 4)
            self.sync += If(Mux(job.busy, job.stage & (job.at == at), written), signal.eq(data))
            if name == "velocity":
                self.sync += If(job.stop, signal.eq(0))
            staged.append(signal)
        return staged

    def _job_of(self, n, enable):
        """The inputs of step generator n that say what controls it, and whether its time passes."""
        if n >= self.jobs:
            return {"i_stop": self.stop, "i_advance": 1, "i_commit": self.commit, "i_enable": enable}
        job = self.job
        return {"p_TIMED": 1, "i_stop": self.stop | job.stop, "i_advance": job.advance,
                "i_commit": Mux(job.busy, job.commit_due, self.commit), "i_enable": enable | job.busy}

    def _stepgens(self, fabric, channels, arms):
        self.stepgen_flags = index_flags, probe_flags, limited = [[Signal() for _ in range(channels)] for _ in range(3)]
        if not channels:
            self.comb += self.all_stopped.eq(1)
            return
        (enables, _), (_, index_arms), (_, probe_arms) = (arms[name] for name in ("enables", "arms", "probe_arms"))
        visit, pending, deltas, captures, stopped, words, waiting = Signal(channels), Signal(channels), [], [], [], [], []
        for n in range(channels):
            b = rm.STEPGEN[n]
            # -2^31 has no positive counterpart; reading it as -(2^31-1) keeps |velocity|
            # representable in all later logic.
            lowest = fabric.data == 0x8000_0000
            if n < self.jobs:
                velocity, accel = self._job_storage(fabric, n)
            else:
                velocity = fabric.storage(rm.COMMAND, f"stepgen{n}_velocity", data=fabric.data | lowest)
                accel = fabric.storage(rm.COMMAND, f"stepgen{n}_accel")
            mode = fabric.storage(b, "mode", 5)
            delta, fraction, velocity_now = Signal(5), Signal(32), Signal(32)
            rest, waits, waited = Signal(), Signal(), Signal()
            self.specials += Instance("stepgen",
                i_clk=self.clk, i_gate=self.gate, o_stopped=rest, **self._job_of(n, enables[n]), i_velocity=velocity, i_accel=accel,
                i_steplen=fabric.storage(b, "steplen", 13), i_stepspace=fabric.storage(b, "stepspace", 13),
                i_dirsetup=fabric.storage(b, "dirsetup", 16), i_dirhold=fabric.storage(b, "dirhold", 16),
                i_stop_accel=fabric.storage(b, "stop_accel"), i_kind=mode[2:4], i_step_invert=mode[0], i_dir_invert=mode[1],
                i_visit=visit[n], o_delta=delta, o_fraction=fraction, o_velocity_now=velocity_now, o_waits=waits,
                o_step=self.pads.step[n], o_dir=self.pads.dir[n])
            self.sync += waited.eq(waits | (waited & ~self.sample))
            self.comb += limited[n].eq(waited)
            words.append(Cat(fraction, velocity_now))
            # The index pin is asynchronous; its polarity is applied after the two synchronising
            # flip-flops.
            meta, index = Signal(reset_less=True), Signal(reset_less=True)
            meta.attr.add("keep"), index.attr.add("keep")
            self.sync += [meta.eq(self.pads.step_index[n]), index.eq(meta ^ mode[4])]
            captures.append(self._latch(index, probe_arms[n], index_arms[n], pending[n], index_flags[n], probe_flags[n]))
            deltas.append(delta)
            stopped.append(rest)
            waiting.append(waits)
        if self.jobs:
            self.comb += [
                self.job.waits.eq(reduce(or_, waiting[:self.jobs])),
                self.job.stopped.eq(reduce(lambda a, b: a & b, stopped[:self.jobs])),
            ]
        self.comb += self.all_stopped.eq(reduce(lambda a, b: a & b, stopped))

        word = fabric.word
        at, latches, hits = Signal(4), Signal(), [Signal(), Signal(), Signal()]
        latch = rm.STATUS.offset("stepgen0_latch") // 4
        first = rm.STATUS.offset("stepgen0_position_lo") // 4  # then position_hi, velocity
        self.comb += [
            latches.eq((word >= latch) & (word < latch + channels)),
            at.eq(word[:4] ^ latch & 15),
            Case(word, {first + 3 * n + k: [at.eq(n), hit.eq(1)] for n in range(channels) for k, hit in enumerate(hits)}),
        ]
        assert latch % 16 == 0  # so that the exclusive or is a subtraction
        sampled, latched = Signal(32), Signal(32)
        self.specials += Instance("wide_counter",
            p_CHANNELS=channels, i_clk=self.clk, i_delta=Cat(*deltas), i_sample=self.sample, i_capture=Cat(*captures),
            i_clear=Constant(0, channels), i_addr=at, o_visit=visit, o_pending=pending, o_sampled=sampled, o_latched=latched)
        low, high, velocity = hits
        fraction, velocity_now = self._handed_on(words, at)
        status = fabric.page_hit(rm.STATUS.page)
        for hit, value in ((low, fraction), (high, sampled), (velocity, velocity_now), (latches, latched)):
            fabric.reads(status & hit, value)

    def _handed_on(self, words, at):
        """Fraction and velocity of the step generator `at` at the last sample. The strobe stores
        all of them. Then each channel passes them on to the one before, and the first to LUT RAM,
        one a clock: that takes wires between neighbours instead of 64 from every channel to the CPU
        (decision 11).

            clk       0   1   2   3   4
            sample    _/‾‾‾\\________________
            caught0   --X c0X c1X c2X c3X     written to channel 0, 1, 2 ..: all are there 18 clocks after the strobe
        """
        nth, busy = Signal(4), Signal()
        caught = [Signal(64, reset_less=True, name=f"caught_stepgen{n}") for n in range(len(words))]
        for here, behind, word in zip(caught, [*caught[1:], caught[-1]], words):
            self.sync += here.eq(Mux(self.sample, word, behind))
        self.sync += If(self.sample, nth.eq(0), busy.eq(1)).Else(nth.eq(nth + 1), If(nth == 15, busy.eq(0)))
        out = []
        for half in (caught[0][:32], caught[0][32:]):
            memory = Memory(32, 16, init=[0] * 16)
            write, read = memory.get_port(write_capable=True), memory.get_port(async_read=True)
            self.specials += memory, write, read
            self.comb += write.adr.eq(nth), write.dat_w.eq(half), write.we.eq(busy), read.adr.eq(at)
            out.append(read.dat_r)
        return out

    def _encoders(self, fabric, channels, arms):
        self.encoder_flags = index_flags, probe_flags, illegals = [[Signal() for _ in range(channels)] for _ in range(3)]
        if not channels:
            return
        (_, enables), (_, both) = arms["enables"], arms["arms"]
        visit, pending, turn, sampling = Signal(channels), Signal(channels), Signal(16), Signal()
        deltas, captures, clears, moves, illegals_now = [], [], [], [], []
        for n in range(channels):
            b = rm.ENCODER[n]
            mode, delta = fabric.storage(b, "mode", 8), Signal(5)
            index, moved, illegal, waited = (Signal() for _ in range(4))
            self.specials += Instance("encoder",
                i_clk=self.clk, i_a=self.pads.enc_a[n], i_b=self.pads.enc_b[n], i_index=self.pads.enc_i[n], i_mask=self.pads.enc_mask[n],
                i_mode=mode, i_filter=fabric.storage(b, "filter", 8), i_visit=visit[n],
                o_delta=delta, o_index_level=index, o_moved=moved, o_illegal=illegal)
            self.sync += waited.eq(illegal | (waited & ~self.sample))
            self.comb += illegals[n].eq(waited)
            arm = enables[16 + n]
            captures.append(self._latch(index, both[16 + n], arm, pending[n], index_flags[n], probe_flags[n]))
            # Only the index clears, not the probe: the same edge that the latch sees.
            index_was = Signal(reset=1, reset_less=True)
            self.sync += index_was.eq(index | ~arm)
            clears.append(mode[7] & index & ~index_was)
            deltas.append(delta), moves.append(moved), illegals_now.append(illegal)

        # count and edge words alternate from an address with a half of 12 mod 16; the latches
        # follow from 0 mod 16.
        word = fabric.word
        at, counts, latches = Signal(4), Signal(), Signal()
        count, latch = (rm.STATUS.offset(f"encoder0_{name}") // 4 for name in ("count", "latch"))
        sampled, latched, edge = Signal(32), Signal(32), Signal(32)
        self.comb += [
            counts.eq((word >= count) & (word < count + 2 * channels)),
            latches.eq((word >= latch) & (word < latch + channels)),
            If(latches, at.eq(word[:4] - latch)).Else(at.eq(word[1:5] - count // 2)),
        ]
        self.specials += Instance("wide_counter",
            p_CHANNELS=channels, i_clk=self.clk, i_delta=Cat(*deltas), i_sample=self.sample, i_capture=Cat(*captures),
            i_clear=Cat(*clears), i_addr=at, o_visit=visit, o_pending=pending, o_turn=turn, o_sampling=sampling,
            o_sampled=sampled, o_latched=latched)
        self.specials += Instance("edges",
            p_CHANNELS=channels, i_clk=self.clk, i_turn=turn, i_sampling=sampling, i_sample=self.sample,
            i_moved=Cat(*moves), i_illegal=Cat(*illegals_now), i_now=self.now[:24], i_addr=at, o_sampled=edge)
        status = fabric.page_hit(rm.STATUS.page)
        fabric.reads(status & counts & ~word[0], sampled)
        fabric.reads(status & counts & word[0], edge)
        fabric.reads(status & latches, latched)

    def _pwm(self, fabric, n):
        b = rm.PWM[n]
        # A width is stored as 0 if it is written without the enable bit, once for all channels. The
        # core would need a reset for each channel to clear it at the commit (decision 10); the
        # written value is read back from the mirror.
        data = fabric.data
        command = fabric.storage(rm.COMMAND, f"pwm{n}_width", data=Cat(data[:29] & Replicate(data[30], 29), data[29:]))
        mode = fabric.storage(b, "mode", 5)
        self.specials += Instance("pwm",
            i_clk=self.clk, i_gate=self.gate, i_commit=self.commit,
            i_enable=1, i_direction=command[31], i_width=command[:29], i_period=fabric.storage(b, "period", 21),
            i_invert=mode[0], i_kind=mode[1:3], i_dither=mode[3], i_swap=mode[4],
            o_out=self.pads.pwm[n], o_dir=self.pads.pwm_dir[n])

    def _pads(self, fabric, channels):
        """The pads' own levels. Nothing here leads to a driver, and nothing that drives waits for
        it."""
        b = rm.PADS
        for name, count, low, high in (("step", channels.stepgen, "step", "dir"), ("step_n", channels.stepgen, "step_n", "dir_n"),
                                       ("pwm", channels.pwm, "pwm", "pwm_dir"), ("outputs", channels.outputs, "outputs", None)):
            if not count:
                continue
            levels = [getattr(self.pads, f"{half}_seen") for half in (low, high) if half]
            seen = [Signal(count) for _ in levels]
            self.specials += Instance("pads", p_PINS=count * len(levels), i_clk=self.clk, i_levels=Cat(*levels), o_seen=Cat(*seen))
            if high:
                fabric.live(b, name, Cat(seen[0], Constant(0, 16 - count), seen[1]) if count < 16 else Cat(*seen))
                continue
            fabric.live(b, name, seen[0][:rm.WORD_PINS])
            if count > rm.WORD_PINS:
                fabric.live(b, f"{name}_high", seen[0][rm.WORD_PINS:])

    def _flags(self, fabric):
        def word(low, high):
            return Cat(*low, *[Constant(0, 1)] * (16 - len(low)), *high)

        step_index, step_probe, limited = self.stepgen_flags
        enc_index, enc_probe, illegal = self.encoder_flags
        for name, low, high in (("flags0", enc_index, limited), ("flags1", step_index, enc_probe), ("flags2", step_probe, illegal)):
            if low or high:
                self._sampled(fabric, name, word(low, high))

    def _mirrors(self, fabric, channels):
        fabric.mirror_settings(rm.STEPGEN, channels.stepgen, {"steplen": 13, "stepspace": 13, "dirsetup": 16, "dirhold": 16, "stop_accel": 32, "mode": 5})
        fabric.mirror_settings(rm.ENCODER, channels.encoder, {"mode": 8, "filter": 8})
        fabric.mirror_settings(rm.PWM, channels.pwm, {"period": 21, "mode": 5})
        fabric.mirror_words(rm.DEBOUNCE, 0, channels.inputs, 16)
        fabric.mirror_words(rm.COMMAND, rm.COMMAND.offset("stepgen0_velocity") // 4, 2 * channels.stepgen)
        fabric.mirror_words(rm.COMMAND, rm.COMMAND.offset("pwm0_width") // 4, channels.pwm)


def _clock():
    from migen import ClockSignal, ResetSignal
    return ClockSignal("sys"), ResetSignal("sys")
