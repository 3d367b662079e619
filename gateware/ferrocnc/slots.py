"""LiteEth's MAC in this SoC: aligned slots, a filter for guests, and frames that cannot damage the
next one.

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

from migen import Cat, ClockSignal, If, Instance, Mux, Replicate, ResetSignal, Signal
from migen.genlib.fsm import NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.interconnect import stream, wishbone
from liteeth import mac as liteeth_mac
from liteeth.mac import crc as mac_crc, sram as mac_sram
from liteeth.common import eth_phy_description, reverse_bytes
from liteeth.mac.wishbone import LiteEthMACWishboneInterface

from . import regmap as rm


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
    """The CPU's side of a transmit slot: it writes whole words and reads nothing. With byte lanes,
    or with a second port that reads, a slot of 2 KiB would take two block RAMs instead of one. A
    store of less than a word is lost."""

    def __init__(self, memory):
        self.bus = bus = wishbone.Interface(data_width=32)
        port = memory.get_port(write_capable=True)
        self.puts, self.put_at, self.put = Signal(), Signal(7), Signal(32)  # the fast path's words

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
    took the next one with it. `room` is high while a frame passes that found a slot."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        free = self.stat_fifo.sink.ready
        self.fsm.act("WRITE", If(self.sink.valid & ~free & self.sink.last, NextState("DISCARD")))
        self.take = Signal()
        (slot,) = (done.target for done in self.fsm.actions["TERMINATE"] if isinstance(done, NextValue) and done.target is not None and len(done.target) == 2)
        self.fsm.act("TERMINATE", If(self.take, self.stat_fifo.sink.valid.eq(0), NextValue(slot, slot)))
        self.room = Signal()
        self.comb += self.room.eq(free & ~self.fsm.ongoing("DISCARD-ALL"))


class Reader(mac_sram.LiteEthMACSRAMReader):
    """LiteEth's way out of the slots; `send` sends `length` bytes of slot 0 for the fast path."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.send, self.length, self.sending, self.free = Signal(), Signal(len(self._length.storage)), Signal(), Signal()
        (fifo,) = (module for _, module in self._submodules if hasattr(module, "sink") and hasattr(module.sink, "length"))
        self.comb += [
            If(self.send, fifo.sink.valid.eq(1), fifo.sink.slot.eq(0), fifo.sink.length.eq(self.length)),
            self.free.eq(~self.sending & fifo.sink.ready),
        ]
        self.sync += If(self.send, self.sending.eq(1)).Elif(self.fsm.ongoing("TERMINATE") & (fifo.source.slot == 0), self.sending.eq(0))


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
        stores = [WordStore(memory) for memory in mems]
        self.submodules += stores
        self.answer = stores[0]
        which = (mems[0].depth - 1).bit_length()
        self.submodules += wishbone.Decoder(bus, [(lambda a, n=n: a[which] == n, store.bus) for n, store in enumerate(stores)], register=True)


class RxAdmission(LiteXModule):
    """The cores `gateware/rtl/rx_admission.sv` and `fast_path.sv` and their registers, between the
    aligned stream and the slots."""

    def __init__(self, interface, fabric, cores):
        at, like_high, like_low, data = Signal(5), Signal(), Signal(), Signal(32)
        self.comb += data.eq(reverse_bytes(interface.into.data))
        bank, words, mode, refused = rm.RX_ADMISSION, interface.into, fabric.storage(rm.RX_ADMISSION, "mode", 2), Signal(32)
        # As with the debounce: the low bits of the word's address are the header's word.
        self.specials += Instance("rx_admission",
            i_clk=ClockSignal("sys"), i_header_we=fabric.write_page(bank.page, bank.offset("mode") // 4), i_header_at=fabric.we_word[:4],
            i_header=fabric.data, i_mode=mode, i_admit=fabric.pulse(bank, "admit"),
            i_valid=words.valid, i_last=words.last, i_bad=interface.bad, i_room=interface.sram.writer.room,
            i_data=data, o_refuse=interface.refuse, o_refused=refused,
            o_at=at, o_like_high=like_high, o_like_low=like_low)
        fabric.live(bank, "mode", mode)
        fabric.live(bank, "refused", refused)

        bank, writer, reader, answer = rm.FAST_PATH, interface.sram.writer, interface.sram.reader, interface.answer
        gate, length = fabric.storage(bank, "gate", 10), fabric.storage(bank, "length", 11)
        out, executed = Signal(), Signal()
        self.hold, self.gathers, self.source = Signal(), Signal(), Signal(10)
        self.specials += Instance("fast_path",
            i_clk=ClockSignal("sys"), i_rst=ResetSignal("sys"), i_run_we=fabric.write_page(bank.page, 16), i_run_at=fabric.we_word[:4], i_run=fabric.data[:19],
            i_ip_sum=fabric.storage(bank, "ip_sum", 16), i_udp_sum=fabric.storage(bank, "udp_sum", 16),
            i_gate_as=gate[:8], i_executes=gate[8], i_timed=gate[9], **{"i_pass": fabric.pulse(bank, "pass")}, i_revoke=fabric.pulse(bank, "revoke"),
            i_valid=words.valid, i_last=words.last, i_whole=words.last_be[3], i_bad=interface.bad, i_data=data,
            i_at=at, i_like_high=like_high, i_like_low=like_low,
            i_gate_now=cores.gate_word, i_waiting=cores.timed_waits, i_select=cores.probe_arms[16:21], i_free=reader.free,
            o_stages=fabric.stages, o_to=fabric.stage_to, o_take=writer.take, o_taken=cores.taken,
            o_commit=cores.fast_commit, o_commit_timed=cores.fast_timed, o_gathers=self.gathers, **{"o_from": self.source},
            o_puts=answer.puts, o_put_at=answer.put_at, o_hold=self.hold, o_out=out, o_executed=executed)
        fabric.live(bank, "status", Cat(executed, out, reader.sending))
        self.comb += [
            fabric.stage_data.eq(data), answer.put.eq(fabric.bus.dat_r),
            reader.send.eq(cores.taken), reader.length.eq(length),
        ]


def align():
    """From now on LiteEth's MACs are built with aligned slots; LiteX has no parameter for that."""
    liteeth_mac.LiteEthMACWishboneInterface = AlignedInterface
    mac_crc.LiteEthMACCRC32Checker = Checker
    mac_sram.LiteEthMACSRAMWriter = Writer
    mac_sram.LiteEthMACSRAMReader = Reader
