"""MAC slots that begin two bytes in, so that everything behind the 14 bytes of an Ethernet header lies on a word.

    slot word   0         1         2         3          4           9           11
                |-- dst|  dst    |  src    |  src type|  IP ...  |  UDP ...  |  payload ...

Without it every word of the exchange straddles two words of the slot and costs the CPU three instructions on its way in
and three on its way out. The length registers of the MAC count the two bytes; on the wire there are none.

`Shift` is both directions: received frames get two bytes in front, sent ones lose their first two. Its one trick is the
end: where the shifted frame has bytes left over after its last word, one more word follows.
"""

from migen import Cat, If, Mux, Replicate, Signal
from litex.gen import LiteXModule
from litex.soc.interconnect import stream, wishbone
from liteeth import mac as liteeth_mac
from liteeth.common import eth_phy_description
from liteeth.mac.wishbone import LiteEthMACWishboneInterface


class Shift(LiteXModule):
    """Moves a frame two bytes up in a stream of 32-bit words. `swallow`: its first word, then only two pad bytes and the
    frame's first two, is held back, which moves a padded frame two bytes down."""

    def __init__(self, swallow):
        self.sink = sink = stream.Endpoint(eth_phy_description(32))
        self.source = source = stream.Endpoint(eth_phy_description(32))

        # # #

        held = Signal(16)      # upper half of the word before
        begun = Signal()       # a word of this frame has been taken
        rest = Signal()        # the frame's end is in `held`
        rest_be = Signal(4)
        rest_error = Signal()

        wrong = Signal()
        fits = Signal()        # the last word's bytes and `held` fill no more than one word
        self.comb += [
            wrong.eq((sink.error & sink.last_be) != 0),
            fits.eq(sink.last_be[0] | sink.last_be[1]),
            If(rest,
                source.valid.eq(1),
                source.last.eq(1),
                source.last_be.eq(rest_be),
                source.error.eq(Replicate(rest_error, 4)),
                source.data.eq(held),
            ).Else(
                source.valid.eq(sink.valid & (begun if swallow else 1)),
                source.last.eq(sink.last & fits),
                source.last_be.eq(Mux(sink.last & fits, Cat(0, 0, sink.last_be[:2]), 0)),
                source.error.eq(Replicate(sink.last & fits & wrong, 4)),
                source.data.eq(Cat(held, sink.data[:16])),
                sink.ready.eq(source.ready | (~begun if swallow else 0)),
            ),
        ]
        self.sync += [
            If(rest,
                If(source.ready, rest.eq(0), held.eq(0)),
            ).Elif(sink.valid & sink.ready,
                held.eq(Mux(sink.last & fits, 0, sink.data[16:])),
                begun.eq(~sink.last),
                If(sink.last & ~fits,
                    rest.eq(1),
                    rest_be.eq(Mux(sink.last_be[2], 0b0001, 0b0010)),
                    rest_error.eq(wrong),
                ),
            ),
        ]


class WordStore(LiteXModule):
    """The CPU's side of a transmit slot: whole words in, nothing out. With byte lanes, or with a second port that reads, a slot
    of 2 KiB takes two block RAMs; so it takes one. A store of less than a word is lost."""

    def __init__(self, memory):
        self.bus = bus = wishbone.Interface(data_width=32)
        port = memory.get_port(write_capable=True)

        # # #

        self.specials += memory, port
        self.comb += [
            port.adr.eq(bus.adr[:len(port.adr)]),
            port.dat_w.eq(bus.dat_w),
            port.we.eq(bus.cyc & bus.stb & bus.we & (bus.sel == 0b1111)),
        ]
        self.sync += bus.ack.eq(bus.cyc & bus.stb & ~bus.ack)


class AlignedInterface(LiteEthMACWishboneInterface):
    """LiteEth's slots with a `Shift` in front of each direction; transmit slots are written in words and never read."""

    def __init__(self, dw, *args, **kwargs):
        LiteEthMACWishboneInterface.__init__(self, dw, *args, **kwargs)
        assert dw == 32
        into, out_of = self.sink, self.source
        self.shift_rx = Shift(swallow=False)
        self.shift_tx = Shift(swallow=True)
        self.sink, self.source = self.shift_rx.sink, self.shift_tx.source
        self.comb += [
            self.shift_rx.source.connect(into),
            out_of.connect(self.shift_tx.sink),
        ]

    def _expose_wishbone_sram_interfaces(self, bus, dw, mems, nslots, read_only, write_only):
        if read_only:
            LiteEthMACWishboneInterface._expose_wishbone_sram_interfaces(self, bus, dw, mems, nslots, read_only, write_only)
            return
        assert nslots == 2
        stores = [WordStore(memory) for memory in mems]
        self.submodules += stores
        which = (mems[0].depth - 1).bit_length()
        self.submodules += wishbone.Decoder(bus, [(lambda a, n=n: a[which] == n, store.bus) for n, store in enumerate(stores)], register=True)


def align():
    """From now on LiteEth's MACs are built with aligned slots; LiteX offers no way to hand one in."""
    liteeth_mac.LiteEthMACWishboneInterface = AlignedInterface
