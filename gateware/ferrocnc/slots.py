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
from litex.soc.interconnect import stream
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


class AlignedInterface(LiteEthMACWishboneInterface):
    """LiteEth's slots with a `Shift` in front of each direction."""

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


def align():
    """From now on LiteEth's MACs are built with aligned slots; LiteX offers no way to hand one in."""
    liteeth_mac.LiteEthMACWishboneInterface = AlignedInterface
