"""The SDRAM of boards that execute jobs: LiteDRAM's controller and PHY, and the bus' door to it.

    CPU --- wishbone --- Door --- native port --- LiteDRAM --- GENSDRPHY --- pads

The cards tie the data masks to ground: a store of a byte would write its whole word. LiteX hides that behind an L2 cache, which is
block RAM we do not have; the door reads the line, puts the bytes into it, and writes the word. It keeps one line, because both
of VexRiscv's caches fetch 8 words in a row.
"""

from migen import Cat, If, Memory, Mux, Signal
from migen.genlib.fsm import FSM, NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.integration.soc import SoCRegion
from litex.soc.interconnect import wishbone
from litedram import modules
from litedram.phy import GENSDRPHY

from . import regmap as rm
from .board import BoardError

# What is printed on the chips, and what LiteDRAM knows them as. The EM636165 (512K x 16 x 2) has the M12L16161A's geometry; at
# 60 MHz its times are the same numbers of clocks.
CHIPS = {"M12L64322A": modules.M12L64322A, "2x M12L16161A": modules.M12L16161A, "2x EM636165": modules.M12L16161A}

LINE = 8  # words of a line of VexRiscv's caches


def module(board):
    """LiteDRAM's idea of the chips on this board's card."""
    said = board.platform.sdram
    if not said or said["chip"] not in CHIPS:
        raise BoardError(board.platform.file, "sdram", f"jobs live in SDRAM, and this platform has none that is known ({', '.join(CHIPS)})")
    chips = CHIPS[said["chip"]](board.sys_clk_hz, "1:1")
    # LiteDRAM rounds the time between two refreshes up: at 60 MHz 4096 of them took 64.03 ms, where the data sheets say 64.
    chips.timing_settings.tREFI -= chips.timing_settings.tREFI // 32
    return chips


class Door(LiteXModule):
    """A wishbone slave on a native port: stores of less than a word, and a line at a time.

        cyc stb  _/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\\_      a load that is not in the line: 8 commands in a row, 8 words come back
        cmd      ___/01234567\\___________
        rdata    __________/01234567\\____
        ack      _____________________/‾\\_      one that is in the line: ack two clocks after stb
    """

    def __init__(self, port):
        self.bus = bus = wishbone.Interface(data_width=32, address_width=32, addressing="word")

        # # #

        self.specials.line = line = Memory(32, LINE)
        put, get = line.get_port(write_capable=True), line.get_port(async_read=True)
        self.specials += put, get
        bits = len(port.cmd.addr)
        adr, data, sel, store = Signal(bits), Signal(32), Signal(4), Signal()
        tag, there, asked, came = Signal(bits - 3), Signal(), Signal(4), Signal(3)
        live, hit = Signal(), Signal()
        merged = Cat(*(Mux(sel[n], data[8 * n:8 * n + 8], get.dat_r[8 * n:8 * n + 8]) for n in range(4)))
        self.comb += [
            hit.eq(there & (tag == adr[3:])),
            get.adr.eq(adr[:3]),
            port.rdata.ready.eq(1),
            port.wdata.data.eq(data),
            port.wdata.we.eq(0xF),
            bus.dat_r.eq(data),
        ]
        # Whoever turns away in between (a reset of the CPU) gets no answer to a question it has not asked.
        self.sync += If(~bus.cyc, live.eq(0))
        self.fsm = fsm = FSM(reset_state="IDLE")
        fsm.act("IDLE",
            NextValue(adr, bus.adr), NextValue(sel, bus.sel), NextValue(store, bus.we),
            If(bus.we, NextValue(data, bus.dat_w)),
            NextValue(asked, 0), NextValue(came, 0),
            If(bus.cyc & bus.stb, NextValue(live, 1), NextState("LOOK")),
        )
        fsm.act("LOOK",
            If(store & (hit | (sel == 0xF)),
                NextValue(data, merged),
                NextState("STORE"),
            ).Elif(hit,
                NextValue(data, get.dat_r),
                NextState("ANSWER"),
            ).Else(
                NextValue(there, 0),
                NextState("FILL"),
            ))
        fsm.act("FILL",
            port.cmd.valid.eq(~asked[3]),
            port.cmd.addr.eq(Cat(asked[:3], adr[3:])),
            port.cmd.last.eq(asked == LINE - 1),
            If(port.cmd.valid & port.cmd.ready, NextValue(asked, asked + 1)),
            put.adr.eq(came),
            put.dat_w.eq(port.rdata.data),
            put.we.eq(port.rdata.valid),
            If(port.rdata.valid,
                NextValue(came, came + 1),
                If(came == LINE - 1, NextValue(there, 1), NextValue(tag, adr[3:]), NextState("LOOK"))),
        )
        fsm.act("STORE",
            port.cmd.valid.eq(1),
            port.cmd.we.eq(1),
            port.cmd.addr.eq(adr),
            put.adr.eq(adr[:3]),
            put.dat_w.eq(data),
            put.we.eq(hit),
            If(port.cmd.ready, NextState("DATA")),
        )
        fsm.act("DATA",
            port.wdata.valid.eq(1),
            If(port.wdata.ready, NextState("ANSWER")),
        )
        fsm.act("ANSWER",
            bus.ack.eq(live & bus.cyc),
            NextState("IDLE"),
        )


def add(soc, pads):
    """LiteDRAM behind `pads` as the SoC's `main_ram`. The window is 8 MiB on every card: a smaller SDRAM is seen in it twice."""
    chips = module(soc.board)
    soc.sdrphy = GENSDRPHY(pads, soc.board.sys_clk_hz)
    soc.add_sdram("sdram", phy=soc.sdrphy, module=chips, with_soc_interconnect=False)
    soc.sdram_door = Door(soc.sdram.crossbar.get_port())
    origin, size = rm.SDRAM_RAM
    soc.bus.add_slave("main_ram", soc.sdram_door.bus, SoCRegion(origin=origin, size=size, mode="rwx"))
