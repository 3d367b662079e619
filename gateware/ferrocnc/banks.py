"""CSR banks around the cores: every register of `regmap.py` meets the signal it belongs to here, and nowhere else.

The cores (`gateware/rtl`) know no bus; this file knows no motion. One slave on LiteX's CSR bus carries pages 8 and up:

    bus  --> write pipeline --> staging and settings registers, shadow RAMs --> cores
         <-- live words | status window | shadow RAMs                      <-- cores

* Writes land one clock after the bus cycle, so that address decoding stays out of the cores' timing. The CPU cannot tell:
  its next access is two clocks later.
* The status window is a copy of every live word, caught by the sample strobe, behind one read multiplexer.
* Channel settings and staged commands are read back, as written, from LUT RAMs; reading back the flip-flops themselves would
  cost more multiplexers than the cores have logic, and every block RAM is the CPU's.
* Registers of absent channels are never created: they read 0 and ignore writes.
"""

from functools import reduce
from operator import or_

from migen import Array, Cat, Constant, If, Instance, Memory, READ_FIRST, Replicate, Signal
from litex.gen import LiteXModule
from litex.soc.interconnect import csr_bus

from . import VERSION, regmap as rm

_PAGE_WORDS = rm.CSR_PAGE // 4
_WORD_BITS = _PAGE_WORDS.bit_length() - 1


class FabricBus(LiteXModule):
    """Decodes pages 8 and up. `storage`, `pulse` and `live` create registers; `shadow` makes a range of them readable.

    A read has one clock. Words are read in groups of eight; a group that is not addressed holds its register in reset, so
    that putting the groups together is an OR, and half of the multiplexer is behind the register.
    """

    GROUP = 8

    def __init__(self):
        self.bus = csr_bus.Interface(data_width=32, address_width=rm.CSR_ADDRESS_WIDTH)
        # The word address as the bus master gives it, whether or not it means us: `bus.adr` is the same one behind the
        # bridge's state, and half a clock later. Reading has no side effect, so a read that was not meant harms nobody.
        self.adr = Signal(rm.CSR_ADDRESS_WIDTH)
        self.word = self.adr[:_WORD_BITS]
        self.page = self.adr[_WORD_BITS:]
        self.we = Signal()
        self.data = Signal(32, reset_less=True)
        self._we_word = Signal(_WORD_BITS, reset_less=True)
        self._we_page = Signal(rm.CSR_ADDRESS_WIDTH - _WORD_BITS, reset_less=True)
        self._decoded = {}
        self._live = {}
        self._shadowed = []

        # # #

        self.sync += [
            self.we.eq(self.bus.we),
            self.data.eq(self.bus.dat_w),
            self._we_word.eq(self.word),
            self._we_page.eq(self.page),
        ]

    def _is(self, kind, value, number):
        """`value == number`, decoded once for everybody who asks."""
        if (kind, number) not in self._decoded:
            hit = self._decoded[kind, number] = Signal(name=f"{kind}_{number}")
            self.comb += hit.eq(value == number)
        return self._decoded[kind, number]

    def _written(self, page, word):
        return self._is("we_page", Cat(self._we_page, self.we), page | 1 << len(self._we_page)) & self._is("we_word", self._we_word, word)

    def pulse(self, bank, name):
        """High for one clock when the register is written; `self.data` is what was written."""
        strobe = Signal()
        self.comb += strobe.eq(self._written(bank.page, bank.offset(name) // 4))
        return strobe

    def storage(self, bank, name, width=32, reset=0, data=None):
        """What was last written. Keeps its value through a reset of the CPU: firmware writes what it wants at boot."""
        signal = Signal(width, reset=reset, reset_less=True, name=f"{bank.name}_{name}")
        self.sync += If(self._written(bank.page, bank.offset(name) // 4), signal.eq(self.data if data is None else data))
        return signal

    def live(self, bank, name, value):
        """Makes `value` readable as this register."""
        self._live[bank.page, bank.offset(name) // 4] = value

    def shadow(self, name, page, pages, first, words):
        """What was written to these words of these pages can be read back."""
        if not pages or not words:
            return
        bits = (words - 1).bit_length()
        memory = Memory(32, max(2, pages << bits), init=[0] * max(2, pages << bits), name=name)
        read, write = memory.get_port(async_read=True), memory.get_port(write_capable=True, mode=READ_FIRST)
        self.specials += memory, read, write
        hits = []
        for port, at_page, at_word in ((read, self.page, self.word), (write, self._we_page, self._we_word)):
            hit, from_page, from_word = Signal(), Signal(len(at_page)), Signal(_WORD_BITS)
            self.comb += [
                from_page.eq(at_page - page),
                from_word.eq(at_word - first),
                port.adr.eq(Cat(from_word[:bits], from_page)),
                hit.eq((from_page < pages) & (from_word < words)),
            ]
            hits.append(hit)
        self.comb += [write.dat_w.eq(self.data), write.we.eq(self.we & hits[1])]
        self._shadowed.append(Replicate(hits[0], 32) & read.dat_r)

    def do_finalize(self):
        parts = []
        words = sorted(self._live.items(), key=lambda item: item[0])
        for start in range(0, len(words), self.GROUP):
            group = [(self._is("page", self.page, page) & self._is("word", self.word, word), value)
                     for (page, word), value in words[start:start + self.GROUP]]
            part = Signal(32, reset_less=True)
            self.sync += part.eq(reduce(or_, [Replicate(hit, 32) & value for hit, value in group]))
            parts.append(part)

        if self._shadowed:
            part = Signal(32, reset_less=True)
            self.sync += part.eq(reduce(or_, self._shadowed))
            parts.append(part)
        self.comb += self.bus.dat_r.eq(reduce(or_, parts))


class Pads:
    """The signals of a board's pins, one bit per channel, after the platform's polarity has been dealt with."""

    def __init__(self, channels):
        self.step = Signal(max(1, channels.stepgen))
        self.dir = Signal(max(1, channels.stepgen))
        self.enc_a = Signal(max(1, channels.encoder))
        self.enc_b = Signal(max(1, channels.encoder))
        self.enc_i = Signal(max(1, channels.encoder))
        self.pwm = Signal(max(1, channels.pwm))
        self.pwm_dir = Signal(max(1, channels.pwm))
        self.inputs = Signal(max(1, channels.inputs))
        self.outputs = Signal(max(1, channels.outputs))
        self.ext_reset = Signal()
        self.led = Signal()
        self.gate = Signal()


class Cores(LiteXModule):
    """All cores of one board and their banks. `arrival` is the wall clock of the frame the MAC presents."""

    def __init__(self, channels, sys_clk_hz, rom_words, ext_reset_active_low=False):
        self.pads = pads = Pads(channels)
        self.abi = Signal(32)            # constant; the SoC knows it once its map is final
        self.frame_done = Signal()       # MAC: a frame is complete in `frame_slot`
        self.frame_slot = Signal(1)
        self.frame_pending = Signal()    # MAC: presents the frame in `pending_slot`
        self.pending_slot = Signal(1)
        self.fabric = fabric = FabricBus()
        self.bus = fabric.bus

        # # #

        clk, rst = _clock()
        now = self._timebase(fabric, clk, rst)
        gate, stop = self._watchdog(fabric, clk, rst, ext_reset_active_low)
        self.comb += pads.gate.eq(gate)
        self._ident(fabric, channels, sys_clk_hz, rom_words)
        self._led(fabric, clk, sys_clk_hz)

        commit, sample = self.commit, self.sample
        window = {0: now[:32], 1: now[32:]}
        enables = fabric.storage(rm.COMMAND, "enables")
        flags_index = [Signal() for _ in range(channels.encoder)] + [Constant(0, 1)] * (16 - channels.encoder)
        flags_limited = [Signal() for _ in range(channels.stepgen)] + [Constant(0, 1)] * (16 - channels.stepgen)
        window[2] = self._gpio(fabric, clk, gate, commit, channels)
        window[3] = Cat(*flags_index, *flags_limited)

        stopped = [
            self._stepgen(fabric, clk, n, gate, stop, commit, sample, enables[n], flags_limited[n], window)
            for n in range(channels.stepgen)
        ]
        self.comb += self.all_stopped.eq(reduce(lambda a, b: a & b, stopped, 1))
        for n in range(channels.encoder):
            self._encoder(fabric, clk, n, commit, enables[16 + n], flags_index[n], now, window)
        for n in range(channels.pwm):
            self._pwm(fabric, clk, n, gate, commit)

        for word, live in window.items():
            caught = Signal(32, reset_less=True)
            self.sync += If(sample, caught.eq(live))
            fabric.live(rm.STATUS, rm.STATUS.regs[word].name, caught)

        fabric.shadow("command_shadow", rm.COMMAND.page, 1, 0, 4 + 2 * channels.stepgen)
        fabric.shadow("width_shadow", rm.COMMAND.page, 1, rm.COMMAND.offset("pwm0_width") // 4, channels.pwm)
        fabric.shadow("stepgen_shadow", rm.STEPGEN[0].page, channels.stepgen, 0, len(rm.STEPGEN_REGS))
        fabric.shadow("encoder_shadow", rm.ENCODER[0].page, channels.encoder, 0, 2)
        fabric.shadow("pwm_shadow", rm.PWM[0].page, channels.pwm, 0, len(rm.PWM_REGS))

    def _timebase(self, fabric, clk, rst):
        b = rm.TIMEBASE
        now, caught, pending = Signal(64), Signal(64, reset_less=True), Signal()
        self.commit, self.sample = Signal(), Signal()
        strobe = fabric.pulse(b, "strobe")
        at_lo = fabric.storage(b, "commit_at_lo")
        at_hi = fabric.storage(b, "commit_at_hi")
        self.specials += Instance("timebase",
            i_clk=clk, i_rst=rst, o_now=now,
            i_commit_now=strobe & fabric.data[0],
            i_sample_now=strobe & fabric.data[1],
            i_commit_timed=strobe & fabric.data[2],
            i_commit_at=Cat(at_lo, at_hi),
            o_commit=self.commit, o_sample=self.sample, o_pending=pending)
        self.sync += If(fabric.pulse(b, "snapshot"), caught.eq(now))

        # Each slot remembers when its frame was complete, so that a frame which had to queue keeps its own time.
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
        return now

    def _watchdog(self, fabric, clk, rst, active_low):
        b = rm.WATCHDOG
        gate, stop, pin, bitten, latched, armed = (Signal() for _ in range(6))
        remaining, last, bites = Signal(32), Signal(32), Signal(32)
        timeout = fabric.storage(b, "timeout")
        grace = fabric.storage(b, "grace")
        control = fabric.pulse(b, "control")
        keys = {}
        for name, key in (("arm", rm.ARM), ("soft", rm.SOFT), ("stop", rm.STOP), ("clear", rm.CLEAR)):
            keys[name] = Signal()
            self.comb += keys[name].eq(control & (fabric.data == key))
        self.all_stopped = Signal()
        self.specials += [
            Instance("extreset", p_ACTIVE_LOW=int(active_low), i_clk=clk, i_pin=self.pads.ext_reset, o_active=pin),
            Instance("watchdog",
                i_clk=clk, i_rst=rst, i_ext_reset=pin,
                i_token_we=fabric.pulse(b, "token"), i_token=fabric.data,
                i_arm=keys["arm"], i_soft_stop=keys["soft"], i_shut=keys["stop"], i_clear=keys["clear"],
                i_timeout=timeout, i_grace=grace, i_all_stopped=self.all_stopped,
                o_gate=gate, o_stop=stop, o_bitten=bitten, o_reset_latched=latched, o_armed=armed,
                o_remaining=remaining, o_last_token=last, o_bites=bites),
        ]
        for name, value in (("timeout", timeout), ("grace", grace), ("remaining", remaining), ("last_token", last), ("bites", bites),
                            ("status", Cat(gate, stop, bitten, latched, pin, armed))):
            fabric.live(b, name, value)
        return gate, stop

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
        ):
            fabric.live(rm.IDENT, name, value)

    def _led(self, fabric, clk, sys_clk_hz):
        pattern = fabric.storage(rm.LED, "pattern", 3)
        fabric.live(rm.LED, "pattern", pattern)
        self.specials += Instance("led", p_BITS=int(sys_clk_hz).bit_length(), i_clk=clk, i_pattern=pattern, o_lit=self.pads.led)

    def _gpio(self, fabric, clk, gate, commit, channels):
        n_in, n_out = len(self.pads.inputs), len(self.pads.outputs)
        level, out = Signal(n_in), Signal(n_out)
        value = fabric.storage(rm.COMMAND, "gpio_out", n_out)
        safe = fabric.storage(rm.GPIO, "safe", n_out)
        invert = fabric.storage(rm.GPIO, "invert_out", n_out)
        self.specials += Instance("gpio",
            p_INPUTS=n_in, p_OUTPUTS=n_out, i_clk=clk, i_gate=gate, i_commit=commit,
            i_value=value, i_safe=safe, i_invert=invert, i_in_pins=self.pads.inputs, o_in=level, o_out_pins=out)
        self.comb += self.pads.outputs.eq(out)
        inputs = level if channels.inputs else 0
        fabric.live(rm.GPIO, "in_now", inputs)
        if channels.outputs:
            for name, value in (("safe", safe), ("invert_out", invert), ("out_now", out)):
                fabric.live(rm.GPIO, name, value)
        return inputs

    def _stepgen(self, fabric, clk, n, gate, stop, commit, sample, enable, limited, window):
        b = rm.STEPGEN[n]
        stopped, waits = Signal(), Signal()
        position, velocity_now = Signal(64), Signal(32)
        # -2^31 has no positive twin; taking it as -(2^31-1) keeps |velocity| representable for everyone downstream.
        lowest = fabric.data == 0x8000_0000
        velocity = fabric.storage(rm.COMMAND, f"stepgen{n}_velocity", data=fabric.data | lowest)
        accel = fabric.storage(rm.COMMAND, f"stepgen{n}_accel")
        mode = fabric.storage(b, "mode", 2)
        self.specials += Instance("stepgen",
            i_clk=clk, i_gate=gate, i_stop=stop, o_stopped=stopped,
            i_commit=commit, i_enable=enable, i_velocity=velocity, i_accel=accel,
            i_steplen=fabric.storage(b, "steplen", 16), i_stepspace=fabric.storage(b, "stepspace", 16),
            i_dirsetup=fabric.storage(b, "dirsetup", 24), i_dirhold=fabric.storage(b, "dirhold", 24),
            i_stop_accel=fabric.storage(b, "stop_accel"), i_step_invert=mode[0], i_dir_invert=mode[1],
            o_position=position, o_velocity_now=velocity_now, o_waits=waits,
            o_step=self.pads.step[n], o_dir=self.pads.dir[n])
        waited = Signal()
        self.sync += waited.eq(waits | (waited & ~sample))
        self.comb += limited.eq(waited)
        window[8 + 3 * n] = position[:32]
        window[9 + 3 * n] = position[32:]
        window[10 + 3 * n] = velocity_now
        return stopped

    def _encoder(self, fabric, clk, n, commit, arm_staged, latched, now, window):
        b = rm.ENCODER[n]
        arm = Signal()
        count, latch, edge_time, errors = Signal(32), Signal(32), Signal(32), Signal(16)
        self.sync += If(commit, arm.eq(arm_staged))
        self.specials += Instance("encoder",
            p_FILTER=8, i_clk=clk, i_a=self.pads.enc_a[n], i_b=self.pads.enc_b[n], i_index=self.pads.enc_i[n],
            i_arm=arm, i_filter=fabric.storage(b, "filter", 8), i_now=now[:32],
            o_count=count, o_latch=latch, o_latched=latched, o_edge_time=edge_time, o_errors=errors)
        window[56 + 2 * n] = count
        window[57 + 2 * n] = Cat(edge_time[:24], errors[:8])
        window[88 + n] = latch

    def _pwm(self, fabric, clk, n, gate, commit):
        b = rm.PWM[n]
        command = fabric.storage(rm.COMMAND, f"pwm{n}_width")
        mode = fabric.storage(b, "mode", 1)
        self.specials += Instance("pwm",
            p_WIDTH=24, i_clk=clk, i_gate=gate, i_commit=commit,
            i_enable=command[30], i_direction=command[31], i_width=command[8:29],
            i_period=fabric.storage(b, "period", 24), i_invert=mode[0],
            o_out=self.pads.pwm[n], o_dir=self.pads.pwm_dir[n])


def _clock():
    from migen import ClockSignal, ResetSignal
    return ClockSignal("sys"), ResetSignal("sys")
