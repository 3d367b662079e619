"""ROM and RAM on the chip, of block RAMs.

yosys builds a memory of as few block RAMs as possible, and chooses their shape by the number of
words. The 15 360 words of the ROM become 27 block RAMs of 1024 words, and behind each port 519
wires cross the chip to 700 LUTs of multiplexers. As 14 336 and 1024 words they are 27 block RAMs,
too, but with 257 wires and 225 LUTs; and one port instead of two halves that (decision 30).
"""

from migen import READ_FIRST, WRITE_FIRST, Cat, If, Memory, Mux, Signal
from litex.gen import LiteXModule
from litex.soc.interconnect import wishbone

from .sdram_bridge import BURST, LINE


def _bus():
    return wishbone.Interface(data_width=32, address_width=32, addressing="word")


class Parts(LiteXModule):
    """Words of 32 bits in memories of these sizes, one after the other, and one port for all: the
    word at `adr` is at `dat_r` a clock later. A writable memory takes the bytes `we` of `dat_w`,
    and reads what it takes."""

    def __init__(self, name, sizes, init=None, writable=False):
        self.adr, self.dat_r = Signal(max=sum(sizes)), Signal(32)
        self.we, self.dat_w = Signal(4), Signal(32)

        # # #

        firsts = [sum(sizes[:n]) for n in range(len(sizes))]
        read = None
        for n, (first, size) in enumerate(zip(firsts, sizes)):
            assert first % (1 << (size - 1).bit_length()) == 0, f"{name}: no part {n} can begin at word {first}"
            memory = Memory(32, size, init=init and init[first:first + size], name=f"{name}_{n}")
            part = memory.get_port(write_capable=writable, we_granularity=8 if writable else 0, mode=WRITE_FIRST if writable else READ_FIRST)
            self.specials += memory, part
            here, before = Signal(), Signal()  # not in an earlier part; not in a later one
            self.comb += [here.eq(self.adr >= first), before.eq(self.adr < (firsts + [1 << len(self.adr)])[n + 1]), part.adr.eq(self.adr)]
            if writable:
                self.comb += [part.dat_w.eq(self.dat_w), If(here & before, part.we.eq(self.we))]
            if n:
                was_here = Signal()
                self.sync += was_here.eq(here)
                read = Mux(was_here, part.dat_r, read)
            else:
                read = part.dat_r
        self.comb += self.dat_r.eq(read)


class Ram(LiteXModule):
    """RAM on the bus."""

    def __init__(self, name, sizes):
        self.bus = bus = _bus()
        self.words = words = Parts(name, sizes, writable=True)

        # # #

        self.comb += [
            words.adr.eq(bus.adr), words.dat_w.eq(bus.dat_w), bus.dat_r.eq(words.dat_r),
            If(bus.cyc & bus.stb & bus.we, words.we.eq(bus.sel)),
        ]
        self.sync += bus.ack.eq(bus.cyc & bus.stb & ~bus.ack)


class Rom(LiteXModule):
    """The ROM, and the CPU's way to its instructions. `bus` reads data in it. `master` is the CPU's
    instruction bus: it gets a word of the ROM on every clock, and all others from `beyond`, over
    the bus, where a line of the cache takes 22 clocks. Data wait for one line at most.

        clk         _/‾\\_/‾\\_/‾\\_ .. _/‾\\_/‾\\_/‾\\_
        master.stb  _/‾‾‾‾‾‾‾‾‾‾‾ .. ‾‾‾\\__________
        master.adr  --X 0     X 1 ..X 7 X----------
        master.ack  _____/‾‾‾‾‾‾‾ .. ‾‾‾\\__________
        bus.stb     _/‾‾‾‾‾‾‾‾‾‾‾ .. ‾‾‾‾‾‾‾\\______
        bus.ack     _____________ .. ___/‾‾‾\\______
    """

    def __init__(self, name, sizes, init, is_rom, beyond):
        self.bus, self.master = bus, master = _bus(), _bus()
        self.words = words = Parts(name, sizes, init)

        # # #

        near, busy, ready, data = Signal(), Signal(), Signal(), Signal()
        # A line of the cache begins at a multiple of its length: no carry leaves it.
        word = Signal((LINE - 1).bit_length())
        self.comb += [
            near.eq(master.cyc & master.stb & is_rom(master.adr)),
            word.eq(master.adr + ready),
            busy.eq(near & ~(ready & (master.cti != BURST))),  # at the last word the port is free
            words.adr.eq(Mux(busy, Cat(word, master.adr[len(word):]), bus.adr)),
            bus.dat_r.eq(words.dat_r),
            bus.ack.eq(data),
            master.connect(beyond, omit={"cyc", "dat_r", "ack"}),
            beyond.cyc.eq(master.cyc & ~is_rom(master.adr)),
            master.dat_r.eq(Mux(near, words.dat_r, beyond.dat_r)),
            master.ack.eq(Mux(near, ready, beyond.ack)),
        ]
        self.sync += [
            ready.eq(busy),
            data.eq(bus.cyc & bus.stb & ~busy & ~data),
        ]
