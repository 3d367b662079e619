"""The bridge from the bus to the SDRAM: it caches lines as they come, and answers a store before it
is done.

    cyc stb  _/‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾‾\\_     a line that is not here: its words are handed on as they come
    want     ____/‾‾‾‾‾‾‾‾‾‾‾\\___________
    word     ___________/01234567\\____
    ack      ____________/01234567\\___

    cyc stb  _/‾‾‾‾‾‾‾‾‾‾\\_                       one that is here, because it follows the last one: a word a clock
    ack      ___/01234567\\_

The cards tie the data masks to ground: a store of a byte would write its whole word. LiteX solves
that with an L2 cache, which is block RAM we do not have. This bridge merges the bytes into a word
it knows, or reads the word's line first.
"""

from migen import Cat, If, Memory, Mux, Signal
from migen.genlib.fsm import FSM, NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.interconnect import wishbone

LINE = 8  # words of a line of VexRiscv's caches
BURST = 0b010  # wishbone: the next word is the one behind this


class Port:
    """The client's side of `gateware/rtl/sdram.sv`."""

    def __init__(self, bits):
        self.want, self.store, self.at, self.data = Signal(), Signal(), Signal(bits), Signal(32)
        self.taken, self.valid, self.word = Signal(), Signal(), Signal(32)


class SdramBridge(LiteXModule):
    """A wishbone slave in front of the controller. It keeps two lines: the last one addressed, and
    the one after it or before it."""

    # LiteX gives every memory a port for registers. With a second port that writes, the lines would
    # be 512 flip-flops.
    autocsr_exclude = {"lines"}

    def __init__(self, port):
        self.bus = bus = wishbone.Interface(data_width=32, address_width=32, addressing="word")

        # # #

        bits = len(port.at)
        adr, data, sel, store = Signal(bits), Signal(32), Signal(4), Signal()
        tags, whole = [Signal(bits - 3) for _ in range(2)], [Signal() for _ in range(2)]
        self.specials.lines = lines = Memory(32, 2 * LINE)
        put, get = lines.get_port(write_capable=True), lines.get_port(async_read=True)
        self.specials += put, get

        # The line that is being read: which of the two, whether it is still requested, words
        # received.
        filling, filled, asking, came = Signal(), Signal(), Signal(), Signal(4)

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
                NextValue(filling, 1), NextValue(filled, n), NextValue(asking, 1), NextValue(came, 0),
                If(n, NextValue(tags[1], adr[3:]), NextValue(whole[1], 0)).Else(NextValue(tags[0], adr[3:]), NextValue(whole[0], 0)),
            ]

        # A store waits until the line has come: then its word is in the line, or the line is
        # another one, and the lines' write port is free.
        stores, done = Signal(), Signal()
        self.comb += [
            port.want.eq(asking | (stores & ~filling)),
            port.store.eq(~asking),
            port.at.eq(Cat(Mux(asking, 0, adr[:3]), Mux(asking, Mux(filled, tags[1], tags[0]), adr[3:]))),
            port.data.eq(data),
            done.eq(stores & ~filling & port.taken),
            If(stores,
                put.adr.eq(Cat(adr[:3], way)), put.dat_w.eq(data), put.we.eq(done & hit),
            ),
            If(port.valid, put.adr.eq(Cat(came[:3], filled)), put.dat_w.eq(port.word), put.we.eq(1)),
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
            If(done, NextState("IDLE")),
        )
        self.sync += [
            If(~bus.cyc, live.eq(0)),
            If(port.taken, asking.eq(0)),
            If(port.valid,
                came.eq(came + 1),
                If(came == LINE - 1, filling.eq(0), If(filled, whole[1].eq(1)).Else(whole[0].eq(1)))),
        ]
