"""The real board: the same SoC on an ECP5, with pins and clock from the platform file, and the PHY
on RGMII."""

from functools import reduce
from operator import xor

from migen import ClockDomain, ClockSignal, Instance, Module, Signal
from litex.gen import LiteXModule
from litex.build.generic_platform import IOStandard, Misc, Pins, Subsignal
from litex.build.io import DDROutput, SDRInput, SDROutput, SDRTristate
from litex.build.lattice import LatticeECP5Platform
from litex.soc.cores.clock import ECP5PLL

from . import rgmii, soc as ferro
from .board import BoardError, pins_missing

# ABC9's default script without &mfs, with which yosys 0.70 does not finish, and with a fifth of the
# depth traded for area:
ABC9 = 'scratchpad -set abc9.script "+&scorr;&sweep;&dc2;&dch,-f,-r;&ps;&if,-R,20,-W,300,-v"'
ABC9_AREA = ABC9.replace("&if,", "&if,-a,")
# Without these the 125 MHz Ethernet clock closes in one run of three; with them in every run.
PLACER = " --placer-heap-timingweight 30 --placer-heap-critexp 4 "

_LVCMOS = IOStandard("LVCMOS33")
# STEP and DIR drive long cables through slow buffers: no need for edges that ring.
_OUT = (_LVCMOS, Misc("SLEWRATE=SLOW"), Misc("DRIVE=8"), Misc("PULLMODE=NONE"))
# A cut wire must read the same every time.
_IN = (_LVCMOS, Misc("PULLMODE=UP"), Misc("HYSTERESIS=ON"))

# kind of channel, its pin, the signal of `banks.Pads`, whether it is an output
_PADS = (
    ("stepgen", "step", "step", True), ("stepgen", "dir", "dir", True), ("stepgen", "step_n", "step_n", True),
    ("stepgen", "dir_n", "dir_n", True), ("stepgen", "index", "step_index", False),
    ("encoder", "a", "enc_a", False), ("encoder", "b", "enc_b", False), ("encoder", "index", "enc_i", False), ("encoder", "mask", "enc_mask", False),
    ("pwm", "pin", "pwm", True), ("pwm", "dir", "pwm_dir", True),
    ("gpio_in", "pin", "inputs", False), ("gpio_out", "pin", "outputs", True),
)
# A line of an image may be either.
_LINE = (_LVCMOS, Misc("SLEWRATE=SLOW"), Misc("DRIVE=8"), Misc("PULLMODE=UP"), Misc("HYSTERESIS=ON"))
# A board that is measured without pins must keep its logic. Its inputs come from a shift register
# behind this pad, and its outputs leave as their parity through that one: one flip-flop for an
# input, a third of a LUT for an output.
_FERRY = (("ferry_in", 0, Pins("X"), *_IN), ("ferry_out", 0, Pins("X"), *_OUT))


# Phase of the SDRAM's clock after the core's, in degrees. Commands and data are registered in their
# pads in both directions. A third of a period of 16.7 ns is 5.6 ns before the chip's edge (it needs
# 2), and leaves 11.1 ns from there to our edge, less the 6 ns of the chip and about 3 of two pads.
# LiteX's boards use 180, with data registers in the fabric.
SDRAM_PHASE = 120


# Balls of a package whose pads have no bits for their registers in prjtrellis' database: nextpnr
# places them, and ecppack ends. M9 is the pad of the tile R50C18:SPICB0.
_BARE = {"CABGA256": {"M9"}}


class _PadRegisters(Module):
    """A bidirectional pad with its three registers in the pad: LiteX would leave the one for the
    direction in the fabric."""

    def __init__(self, io, o, oe, i, clk):
        data, off, came = Signal(), Signal(reset=1), Signal()
        self.specials += [
            SDROutput(o, data, clk), SDROutput(~oe, off, clk), SDRInput(came, i, clk),
            Instance("TRELLIS_IO", p_DIR="BIDIR", i_B=io, i_I=data, i_T=off, o_O=came),
        ]

    @staticmethod
    def lower(dr):
        return _PadRegisters(dr.io, dr.o, dr.oe, dr.i, dr.clk)


def _factory(board):
    """(pin, active low) of the factory pin."""
    return getattr(board, "factory_pin", None), getattr(board, "factory_active_low", False)


class _Platform(LatticeECP5Platform):
    default_clk_name = "clk"

    def __init__(self, board, all_pins):
        p = board.platform
        self.default_clk_period = 1e9 / p.clock_hz
        eth = p.ethernet
        io = [
            ("clk", 0, Pins(p.clock_ball), _LVCMOS),
            ("led", 0, Pins(p.led_ball), _LVCMOS),
            ("eth_clocks", 0, Subsignal("tx", Pins(eth["tx_clk"])), Subsignal("rx", Pins(eth["rx_clk"])), _LVCMOS),
            ("eth", 0, *(Subsignal(k, Pins(eth[k])) for k in ("mdio", "mdc", "rx_ctl", "rx_data", "tx_ctl", "tx_data")), _LVCMOS),
        ]
        if p.phy_reset:
            io.append(("phy_reset", 0, Pins(p.phy_reset), _LVCMOS, Misc("PULLMODE=UP")))
        for name, pin in (("ext_reset", board.ext_reset_pin), ("factory", _factory(board)[0])):
            if pin and not any(pad[0] == "ext_reset" and pin == board.ext_reset_pin for pad in io):
                io.append((name, 0, Pins(p.pins[pin]), *_IN))
        if flash := getattr(p, "flash", None):
            io += [(f"flash_{k}", 0, Pins(flash[k]), _LVCMOS, Misc("SLEWRATE=SLOW")) for k in ("cs", "mosi")]
            io.append(("flash_miso", 0, Pins(flash["miso"]), _LVCMOS, Misc("PULLMODE=UP")))
        if board.sdram:
            chips = p.sdram
            io.append(("sdram_clk", 0, Pins(chips["clk"]), _LVCMOS))
            io.append(("sdram", 0, *(Subsignal(name, Pins(chips[key])) for name, key in (
                ("we_n", "we"), ("ras_n", "ras"), ("cas_n", "cas"), ("ba", "ba"), ("a", "a"), ("dq", "dq"))), _LVCMOS))
        for kind, pin, _, output in _PADS:
            for n, channel in enumerate(getattr(board, kind)):
                if channel[pin]:
                    io.append((f"{kind}_{pin}", n, Pins(p.pins[channel[pin]]), *(_OUT if output else _IN)))
        io += [("line", n, Pins(ball), *_LINE) for n, (_, ball) in enumerate(board.lines)]
        if board.lines:
            io.append(("key", 0, Pins(board.key_ball), *_IN))
        if not all_pins:
            io += _FERRY
        LatticeECP5Platform.__init__(self, p.device, io, toolchain="trellis")

    def get_verilog(self, *args, special_overrides=None, **kwargs):
        return LatticeECP5Platform.get_verilog(self, *args, special_overrides={SDRTristate: _PadRegisters, **(special_overrides or {})}, **kwargs)

    def do_finalize(self, fragment):
        LatticeECP5Platform.do_finalize(self, fragment)
        self.add_period_constraint(self.lookup_request("clk", loose=True), self.default_clk_period)
        self.add_period_constraint(self.lookup_request("eth_clocks:rx", 0, loose=True), 1e9 / rgmii.PHY.rx_clk_freq)


class _CRG(LiteXModule):
    def __init__(self, platform, hz_in, hz, sdram):
        self.rst = Signal()
        self.cd_sys = ClockDomain()
        self.pll = pll = ECP5PLL()
        self.comb += pll.reset.eq(self.rst)
        pll.register_clkin(platform.request("clk"), hz_in)
        pll.create_clkout(self.cd_sys, hz)
        if sdram:
            self.cd_sdram = ClockDomain(reset_less=True)
            pll.create_clkout(self.cd_sdram, hz, phase=SDRAM_PHASE, with_reset=False)
            self.specials += DDROutput(1, 0, platform.request("sdram_clk"), ClockSignal("sdram"))


class BoardSoC(ferro.FerroSoC):
    packed = True

    def __init__(self, board, all_pins=True):
        missing = pins_missing(board)
        if all_pins and missing:
            raise BoardError(board.file, missing[0], f"has no pin ({len(missing)} are missing); a configuration without pins can only be simulated")
        platform = _Platform(board, all_pins)
        crg = _CRG(platform, board.platform.clock_hz, board.sys_clk_hz, board.sdram)

        def phy(_):
            return rgmii.board_phy(platform.request("eth_clocks", 0), platform.request("eth", 0))

        ferro.FerroSoC.__init__(self, platform, board, crg, phy, sdram_pads=platform.request("sdram") if board.sdram else None)
        self._pins(platform, board, all_pins)

    def _pins(self, platform, board, all_pins):
        pads = self.cores.pads
        link, outputs = None if all_pins else platform.request("ferry_in"), []
        for kind, pin, name, output in _PADS:
            signal = getattr(pads, name)
            for n in range(len(getattr(board, kind))):
                pad = platform.request(f"{kind}_{pin}", n, loose=True)
                if output:
                    seen = getattr(pads, f"{name}_seen")[n]
                if pad is not None and output:
                    self._driven(pad, signal[n], seen)
                elif pad is not None:
                    self.comb += signal[n].eq(pad)
                elif output and link is not None and not pin.endswith("_n"):
                    self.comb += seen.eq(signal[n])  # as the pad would
                    outputs.append(signal[n])
                elif link is not None and not output:
                    self.sync += signal[n].eq(link)
                    link = signal[n]
        if outputs:
            self.sync += platform.request("ferry_out").eq(reduce(xor, outputs))
        if board.platform.phy_reset:
            # Both PHYs share this line, and one of them generates the FPGA's clock: pulled up, and
            # never driven.
            self.specials += Instance("BB", i_I=1, i_T=1, io_B=platform.request("phy_reset"), o_O=Signal())
        self.comb += platform.request("led").eq(pads.led ^ int(board.platform.led_active_low))
        if board.lines:
            self._lines(platform, board, pads)
            self._flash(platform, board, pads)
            return
        # Without a pin there is no external reset; the core inverts the idle level if the file says
        # active low.
        reset = platform.request("ext_reset") if board.ext_reset_pin else int(board.ext_reset_active_low)
        self.comb += pads.ext_reset.eq(reset)
        pin, active_low = _factory(board)
        if pin:
            # The external reset's own pin, or a shared one.
            self.comb += pads.factory.eq((reset if pin == board.ext_reset_pin else platform.request("factory")) ^ int(active_low))
        self._flash(platform, board, pads)

    def _lines(self, platform, board, pads):
        """The header lines of an image. Level and direction are registered in the pad, or near it,
        and power up so that it does not drive; all lines have the same delay in clocks."""
        clk = ClockSignal()
        for n, (level, drives, seen) in enumerate(zip(pads.line_levels, pads.line_drives, pads.line_seen)):
            out, off = Signal(reset=1, reset_less=True), Signal(reset=1, reset_less=True)
            if board.lines[n][1] in _BARE.get(board.platform.package, ()):
                self.sync += [out.eq(level), off.eq(~drives)]
            else:
                self.specials += [SDROutput(level, out, clk), SDROutput(~drives, off, clk)]
            self.specials += Instance("TRELLIS_IO", p_DIR="BIDIR", io_B=platform.request("line", n), i_I=out, i_T=off, o_O=seen)
        self.comb += pads.key.eq(platform.request("key"))

    def _driven(self, pad, level, seen):
        """A pad that is always driven, and its input buffer. It has no wire for its direction:
        nextpnr ties that to the driver's side, as it does at a pad that is only an output. So a bit
        that is read back cannot let go of a pin."""
        self.specials += Instance("TRELLIS_IO", p_DIR="BIDIR", io_B=pad, i_I=level, o_O=seen)

    def _flash(self, platform, board, pads):
        if not getattr(board.platform, "flash", None):
            self.comb += pads.spi_miso.eq(1)
            return
        self.comb += [
            platform.request("flash_cs").eq(pads.spi_cs_n),
            platform.request("flash_mosi").eq(pads.spi_mosi),
            pads.spi_miso.eq(platform.request("flash_miso")),
        ]
        # The flash's clock is the FPGA's configuration pin: a primitive instead of a ball.
        self.specials += Instance("USRMCLK", i_USRMCLKI=pads.spi_clk, i_USRMCLKTS=0)
