"""The bridge from the bus to the SDRAM: it caches lines as they come, and queues stores.

    cyc stb  _/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\\_     a line that is not here: 8 commands in a row, its words are handed on
    cmd      ____/01234567\\______________        as they come
    rdata    ______________/01234567\\____
    ack      _______________/01234567\\___

    cyc stb  _/‾‾‾‾‾‾‾‾‾‾\\_                       one that is here, because it follows the last one: a word a clock
    ack      ___/01234567\\_

The cards tie the data masks to ground: a store of a byte would write its whole word. LiteX solves
that with an L2 cache, which is block RAM we do not have. This bridge merges the bytes into a word
it knows, or reads the word's line first.
"""

from migen import Cat, If, Memory, Mux, Signal
from migen.genlib.fsm import FSM, NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.interconnect import stream, wishbone

LINE = 8  # words of a line of VexRiscv's caches
STORES = 4  # words that may be on their way to the SDRAM
BURST = 0b010  # wishbone: the next word is the one behind this


class SdramBridge(LiteXModule):
    """A wishbone slave on a native port of LiteDRAM. It keeps two lines: the last one addressed,
    and the one after it or before it."""

    def __init__(self, port):
        self.bus = bus = wishbone.Interface(data_width=32, address_width=32, addressing="word")

        # # #

        bits = len(port.cmd.addr)
        adr, data, sel, store = Signal(bits), Signal(32), Signal(4), Signal()
        tags, whole = [Signal(bits - 3) for _ in range(2)], [Signal() for _ in range(2)]
        self.specials.lines = lines = Memory(32, 2 * LINE)
        put, get = lines.get_port(write_capable=True), lines.get_port(async_read=True)
        self.specials += put, get

        # The line that is being read: which of the two, words requested, words received.
        filling, filled, asked, came = Signal(), Signal(), Signal(4), Signal(4)
        asking = Signal()
        self.comb += asking.eq(filling & ~asked[3])

        # Is the addressed line here, or coming? Is its word here?
        here = [(tag == adr[3:]) & (known | (filling & (filled == n))) for n, (tag, known) in enumerate(zip(tags, whole))]
        hit, way, last, word = Signal(), Signal(), Signal(), Signal()
        self.comb += [
            hit.eq(here[0] | here[1]),
            way.eq(here[1]),
            word.eq(Mux(way, whole[1], whole[0]) | (came > adr[:3])),
            get.adr.eq(Cat(adr[:3], way)),
            bus.dat_r.eq(get.dat_r),
        ]
        merged = Cat(*(Mux(sel[n], data[8 * n:8 * n + 8], get.dat_r[8 * n:8 * n + 8]) for n in range(4)))

        def fill(n):
            return [
                NextValue(filling, 1), NextValue(filled, n), NextValue(asked, 0), NextValue(came, 0),
                If(n, NextValue(tags[1], adr[3:]), NextValue(whole[1], 0)).Else(NextValue(tags[0], adr[3:]), NextValue(whole[0], 0)),
            ]

        # Stores: the command at once, the word when the SDRAM needs it.
        self.queue = queue = stream.SyncFIFO([("data", 32)], STORES, buffered=False)
        stores, goes = Signal(), Signal()
        self.comb += [
            queue.source.connect(port.wdata, keep={"valid", "ready", "data"}),
            port.wdata.we.eq(0xF),
            queue.sink.data.eq(data),
            queue.sink.valid.eq(goes & port.cmd.ready),
            # Not into a line that is still coming, and not while a word of another line comes: the
            # lines have one write port.
            goes.eq(stores & queue.sink.ready & ~asking & (~hit | (Mux(way, whole[1], whole[0]) & ~port.rdata.valid))),
            port.cmd.valid.eq(asking | goes),
            port.cmd.we.eq(~asking),
            port.cmd.addr.eq(Mux(asking, Cat(asked[:3], Mux(filled, tags[1], tags[0])), adr)),
            port.cmd.last.eq(~asking | (asked == LINE - 1)),
            port.rdata.ready.eq(1),
            If(stores,
                put.adr.eq(Cat(adr[:3], way)), put.dat_w.eq(data), put.we.eq(goes & port.cmd.ready & hit),
            ),
            If(port.rdata.valid, put.adr.eq(Cat(came[:3], filled)), put.dat_w.eq(port.rdata.data), put.we.eq(1)),
        ]

        # A master that ends its cycle in between (a reset of the CPU) gets no answer to a question
        # it has not asked.
        live, told, gives, takes = Signal(), Signal(), Signal(), Signal()
        self.comb += bus.ack.eq(bus.cyc & bus.stb & live & (gives & word | takes & ~told))
        self.fsm = fsm = FSM(reset_state="IDLE")
        fsm.act("IDLE",
            NextValue(adr, bus.adr), NextValue(sel, bus.sel), NextValue(store, bus.we), NextValue(data, bus.dat_w), NextValue(told, 0),
            If(bus.cyc & bus.stb,
                NextValue(live, 1),
                If(bus.we & (bus.sel == 0xF), NextState("STORE")).Else(NextState("LOOK"))),
        )
        fsm.act("LOOK",
            takes.eq(store),
            NextValue(told, store),
            If(~live & ~store, NextState("IDLE"),
            ).Elif(hit,
                If(store, If(word, NextValue(data, merged), NextState("STORE"))).Else(NextState("GIVE")),
            ).Elif(~filling, *fill(~last)),
        )
        fsm.act("GIVE",
            gives.eq(1),
            NextValue(last, way),
            If(~live | ~bus.cyc, NextState("IDLE"),
            ).Elif(bus.ack,
                NextValue(adr, adr + 1),
                If(adr[:3] == LINE - 1, NextState("AHEAD")).Elif(bus.cti != BURST, NextState("IDLE"))),
        )
        # The line after this one is requested next more often than not; the line itself is in a
        # cache now.
        fsm.act("AHEAD",
            If(~hit & ~filling, *fill(last)),
            NextState("IDLE"),
        )
        fsm.act("STORE",
            stores.eq(1),
            takes.eq(1),
            NextValue(told, 1),
            If(goes & port.cmd.ready, NextState("IDLE")),
        )
        self.sync += [
            If(~bus.cyc, live.eq(0)),
            If(asking & port.cmd.ready, asked.eq(asked + 1)),
            If(port.rdata.valid,
                came.eq(came + 1),
                If(came == LINE - 1, filling.eq(0), If(filled, whole[1].eq(1)).Else(whole[0].eq(1)))),
        ]
