"""LiteEth's MAC in this SoC: aligned slots, cores that look at each frame before it lies in one,
and frames that cannot damage the next one.

Slots have an offset of two bytes, so that everything after the 14 bytes of an Ethernet header is
aligned.

    slot word   0         1         2         3          4           9           11
                |-- dst|  dst    |  src    |  src type|  IP ...  |  UDP ...  |  payload ...

Without the offset every word of the exchange would lie in two words of the slot and cost the CPU
three instructions on its way in and three on its way out. The length registers of the MAC include
the two bytes, which do not exist on the wire.

`Shift` works in both directions: received frames get two bytes in front, sent ones lose their first
two. The end needs care: if the shifted frame has bytes left over after its last word, one more word
follows.
"""

from migen import Cat, If, Mux, Replicate, Signal
from migen.genlib.fsm import NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.interconnect import stream, wishbone
from liteeth import mac as liteeth_mac
from liteeth.mac import crc as mac_crc, sram as mac_sram
from liteeth.common import eth_phy_description, reverse_bytes
from liteeth.mac.wishbone import LiteEthMACWishboneInterface


class Shift(LiteXModule):
    """Moves a frame two bytes up in a stream of 32-bit words. `swallow`: its first word, then only
    two pad bytes and the frame's first two, is held back, which moves a padded frame two bytes
    down."""

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
    """The way into a transmit slot: the CPU writes whole words and reads nothing. With byte lanes,
    or with a second port that reads, a slot of 2 KiB would take two block RAMs instead of one. A
    store of less than a word is lost. While the fast path `puts` a word, the CPU waits."""

    def __init__(self, memory):
        self.bus = bus = wishbone.Interface(data_width=32)
        self.puts, self.put_at, self.put = Signal(), Signal(7), Signal(32)
        port = memory.get_port(write_capable=True)

        # # #

        self.specials += memory, port
        self.comb += [
            port.adr.eq(Mux(self.puts, self.put_at, bus.adr[:len(port.adr)])),
            port.dat_w.eq(Mux(self.puts, self.put, bus.dat_w)),
            port.we.eq(self.puts | bus.cyc & bus.stb & bus.we & (bus.sel == 0b1111)),
        ]
        self.sync += bus.ack.eq(bus.cyc & bus.stb & ~bus.ack & ~self.puts)


class Checker(mac_crc.LiteEthMACCRC32Checker):
    """LiteEth's check of the FCS, with a fix: a frame that ended in its first word left the state
    machine in the middle, and the next frame was taken as its rest. Such a frame is nothing but an
    FCS, so it is wrong."""

    def __init__(self, description):
        super().__init__(description)
        self.fsm.act("IDLE", If(self.sink.valid & self.sink.ready & self.sink.last, self.error.eq(1), NextState("RESET")))


class Writer(mac_sram.LiteEthMACSRAMWriter):
    """LiteEth's way into the slots, with the same fix: a frame of one word that found no free slot
    took the next one with it. `room` is high while a frame passes that found a slot. With `take`, a
    clock after its last word, a frame is forgotten: it leaves its slot free, and one that found
    none is not counted, as all others are."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.room, self.take = Signal(), Signal()

        # # #

        free, errors = self.stat_fifo.sink.ready, self._errors.status
        lost = Signal()  # the frame has found no slot
        self.fsm.act("WRITE", If(self.sink.valid & ~free,
            NextValue(errors, errors),  # not yet
            NextValue(lost, 1),
            If(self.sink.last, NextState("DISCARD")),
        ))
        self.fsm.act("DISCARD", NextValue(lost, 0), If(lost & ~self.take, NextValue(errors, errors + 1)))
        (slot,) = (done.target for done in self.fsm.actions["TERMINATE"] if isinstance(done, NextValue) and len(done.target) == len(self._slot.status))
        self.fsm.act("TERMINATE", If(self.take, self.stat_fifo.sink.valid.eq(0), NextValue(slot, slot)))
        self.comb += self.room.eq(free & ~self.fsm.ongoing("DISCARD-ALL"))


class Reader(mac_sram.LiteEthMACSRAMReader):
    """LiteEth's way out of the slots. With `send`, which takes the place of the CPU's start, it
    sends `bytes` bytes of slot 0; only a clock after `free`, and the CPU must not start a frame in
    between. `sending`: slot 0 is queued or being sent, by either of them."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.send, self.bytes = Signal(), Signal(len(self._length.storage))
        self.free, self.sending = Signal(), Signal()

        # # #

        (fifo,) = (module for _, module in self._submodules if isinstance(module, stream.SyncFIFO))
        self.comb += [
            If(self.send, fifo.sink.valid.eq(1), fifo.sink.slot.eq(0), fifo.sink.length.eq(self.bytes)),
            self.free.eq(~self.sending & fifo.sink.ready),
        ]
        self.sync += If(fifo.sink.valid & fifo.sink.ready & (fifo.sink.slot == 0),
            self.sending.eq(1),
        ).Elif(fifo.source.ready & (fifo.source.slot == 0),
            self.sending.eq(0),
        )


class AlignedInterface(LiteEthMACWishboneInterface):
    """LiteEth's slots with a `Shift` in front of each direction; transmit slots are written in
    words and never read. A received frame with `refuse` at its last word is discarded like one with
    a `bad` FCS."""

    def __init__(self, dw, *args, **kwargs):
        LiteEthMACWishboneInterface.__init__(self, dw, *args, **kwargs)
        assert dw == 32
        into, out_of = self.sink, self.source
        self.shift_rx = Shift(swallow=False)
        self.shift_tx = Shift(swallow=True)
        self.sink, self.source = self.shift_rx.sink, self.shift_tx.source
        self.into = words = self.shift_rx.source
        self.refuse, self.bad = Signal(), Signal()
        self.comb += [
            words.connect(into, omit={"error"}),
            into.error.eq(words.error | Replicate(self.refuse, 4)),
            self.bad.eq((words.error & words.last_be) != 0),
            out_of.connect(self.shift_tx.sink),
        ]

    def _expose_wishbone_sram_interfaces(self, bus, dw, mems, nslots, read_only, write_only):
        if read_only:
            LiteEthMACWishboneInterface._expose_wishbone_sram_interfaces(self, bus, dw, mems, nslots, read_only, write_only)
            return
        assert nslots == 2
        self.stores = stores = [WordStore(memory) for memory in mems]
        self.submodules += stores
        which = (mems[0].depth - 1).bit_length()
        self.submodules += wishbone.Decoder(bus, [(lambda a, n=n: a[which] == n, store.bus) for n, store in enumerate(stores)], register=True)


def connect(interface, cores):
    """Connects the slots of this interface with the cores that look at each frame before it lies in
    one (`banks.Cores`: `rx_admission` and `fast_path`)."""
    stream, words, answer = interface.into, cores.words, cores.answer
    writer, reader, store = interface.sram.writer, interface.sram.reader, interface.stores[0]
    return [
        words.valid.eq(stream.valid), words.last.eq(stream.last), words.data.eq(reverse_bytes(stream.data)),
        words.whole.eq(stream.last_be[3]), words.bad.eq(interface.bad), words.room.eq(writer.room),
        interface.refuse.eq(cores.refuse), writer.take.eq(cores.take),
        answer.free.eq(reader.free), answer.sending.eq(reader.sending),
        reader.send.eq(answer.send), reader.bytes.eq(answer.length),
        store.puts.eq(answer.puts), store.put_at.eq(answer.put_at), store.put.eq(answer.put),
    ]


def align():
    """From now on LiteEth's MACs are built with aligned slots; LiteX has no parameter for that."""
    liteeth_mac.LiteEthMACWishboneInterface = AlignedInterface
    mac_crc.LiteEthMACCRC32Checker = Checker
    mac_sram.LiteEthMACSRAMWriter = Writer
    mac_sram.LiteEthMACSRAMReader = Reader
