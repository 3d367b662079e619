"""The SoC: LiteX's bus, VexRiscv, LiteEth's MAC, the board's description in a ROM, and the cores.

One class builds both targets, so that simulation and synthesis use the same design. A target adds
its platform, its clocks and its PHY (`sim.py`, `ecp5.py`); everything behind the PHY is here.
"""

import hashlib
import random
from functools import partial, reduce
from operator import or_
from pathlib import Path

from migen import If, Memory, Signal
from migen.genlib.fsm import FSM, NextState, NextValue
from litex.gen import LiteXModule
from litex.soc.integration import soc as litex_soc
from litex.soc.integration.soc import SoCRegion
from litex.soc.integration.soc_core import SoCCore
from litex.soc.interconnect import csr_bus, wishbone
from litex.soc.interconnect.csr import CSRStatus
from liteeth import mac as liteeth_mac

from . import VERSION, banks, board as board_file, multiplexer, regmap as rm, sdram, slots
from .onchip import Ram, Rom

RTL = Path(__file__).resolve().parent.parent / "rtl"
# the layout of `wire`: its version, every field, address and code
LAYOUT = RTL.parents[1] / "wire" / "layout.txt"


class _BankArray(csr_bus.CSRBankArray):
    """LiteX's array of CSR banks, plus the fabric's own slave on the same bus."""

    def get_buses(self):
        return super().get_buses() + self.source.fabric_buses


class _Bridge(LiteXModule):
    """LiteX's bridge from the bus to the registers, with its address in flip-flops: the fast path's
    addresses join behind them. While `hold` its master waits.

    `banks` keeps the address of a read in flip-flops of its own, which take the master's address
    on every clock that the fast path leaves to them: with `hold` low they have had it for a clock.
    """

    def __init__(self, bus_wishbone, bus_csr, register):
        self.wishbone, self.csr = bus_wishbone, bus_csr
        self.hold, self.adr = Signal(), Signal(len(bus_csr.adr))

        # # #

        bus, csr, data, we = self.wishbone, self.csr, Signal(32), Signal()
        assert bus.addressing == "word" and bus.data_width == csr.data_width
        self.fsm = fsm = FSM(reset_state="IDLE")
        fsm.act("IDLE",
            NextValue(self.adr, bus.adr), NextValue(data, bus.dat_w), NextValue(we, bus.we & (bus.sel != 0)),
            If(bus.cyc & bus.stb, NextState("ACCESS")),
        )
        fsm.act("ACCESS",
            csr.adr.eq(self.adr), csr.dat_w.eq(data), csr.we.eq(we & ~self.hold), csr.re.eq(~we & ~self.hold),
            If(~self.hold, NextState("ACK")),
        )
        fsm.act("ACK", bus.ack.eq(1), bus.dat_r.eq(csr.dat_r), NextState("IDLE"))


litex_soc.csr_bus.CSRBankArray = _BankArray
litex_soc.wishbone.Wishbone2CSR = _Bridge
slots.align()

# LiteEth's clock crossings are 32 deep: two LUT RAMs and a multiplexer in the longest path of the
# 125 MHz clock (117 MHz). 16 is one RAM. The core clock's side moves 240 Mbyte/s, the wire 125:
# depth only has to cover the crossing itself. `add_ethernet` cannot pass it on.
liteeth_mac.LiteEthMAC = partial(liteeth_mac.LiteEthMAC, tx_cdc_depth=16, rx_cdc_depth=16)


class FerroSoC(SoCCore):
    """`phy` is called with the SoC after the CPU exists, and returns a PHY for LiteEth."""

    processor = "vexriscv"
    packed = False  # True: the board ROM holds random words, too, until `image` puts the blob there
    csr_map = {**rm.LITEX_PAGES, rm.SDRAM.name: rm.SDRAM.page}
    mem_map = {"ethmac": rm.ETHMAC[0]}

    def __init__(self, platform, board, crg, phy, rom_init=None, sdram_pads=None):
        self.board = board
        self.blob = board_file.blob(board)
        self.fabric_buses = []
        self.crg = crg
        SoCCore.__init__(
            self, platform, board.sys_clk_hz,
            ident="FerroCNC {}.{}.{} ".format(*VERSION) + board.name,
            cpu_type=self.processor, cpu_variant="standard",
            cpu_reset_address=rm.ROM[0],
            integrated_sram_size=0,
            with_uart=False,
            with_timer=False,  # the wall clock is the timer
            csr_address_width=rm.CSR_ADDRESS_WIDTH,
            bus_timeout=None,  # its counter sits in the acknowledge path and costs 16 MHz
        )
        self._add_memories(rom_init)
        self.ethphy = phy(self)
        # Slots in network order: the exchange is 32-bit big-endian words, and VexRiscv has no byte
        # swap. LiteX reads the slots' order from the CPU; nothing else uses it.
        self.cpu.endianness, order = "big", self.cpu.endianness
        self.add_ethernet(
            phy=self.ethphy, data_width=32, with_timing_constraints=False,
            nrxslots=rm.ETHMAC_RX_SLOTS, ntxslots=rm.ETHMAC_TX_SLOTS)
        self.cpu.endianness = order
        self._add_board_rom()
        if sdram_pads:
            sdram.add(self, sdram_pads)
        self._add_cores()

    def _jobs(self):
        """Axes of a job."""
        return getattr(self.board, "jobs", 0)

    def _add_memories(self, rom_init):
        """The RAM, and the ROM, which comes between the CPU and its instruction bus."""
        rom, ram = (SoCRegion(origin=origin, size=size, mode=mode) for (origin, size), mode in ((rm.ROM, "rx"), (rm.RAM, "rwx")))
        # Random words: a constant ROM is optimised away, and ecpbram finds the image's place by
        # this pattern.
        self.rom = Rom("rom", rm.ROM_PARTS, rom_init or random_words(rm.ROM[1] // 4), rom.decoder(self.bus), self.cpu.ibus)
        self.sram = Ram("sram", rm.RAM_PARTS)
        self.bus.add_slave("rom", self.rom.bus, rom)
        self.bus.add_slave("sram", self.sram.bus, ram)
        ours = self.rom.master
        self.cpu.cpu_params.update(
            o_iBusWishbone_ADR=ours.adr, o_iBusWishbone_DAT_MOSI=ours.dat_w, o_iBusWishbone_SEL=ours.sel, o_iBusWishbone_CYC=ours.cyc,
            o_iBusWishbone_STB=ours.stb, o_iBusWishbone_WE=ours.we, o_iBusWishbone_CTI=ours.cti, o_iBusWishbone_BTE=ours.bte,
            i_iBusWishbone_DAT_MISO=ours.dat_r, i_iBusWishbone_ACK=ours.ack, i_iBusWishbone_ERR=ours.err)

    def _add_board_rom(self):
        origin, size = rm.BOARD_ROM
        memory = Memory(32, size // 4, init=place_words()[1] if self.packed else board_words(self.blob), name="board_rom")
        # On an image it is a RAM: the configuration of the pins brings its own description.
        image = bool(getattr(self.board, "lines", ()))
        self.board_rom = wishbone.SRAM(memory, read_only=not image, bus=wishbone.Interface(data_width=32, address_width=32, addressing="word"))
        self.bus.add_slave("board_rom", self.board_rom.bus, SoCRegion(origin=origin, size=size, mode="rw" if image else "r", cached=False))

    def _add_cores(self):
        for source in sorted(RTL.glob("*.sv")):
            self.platform.add_source(str(source), "systemverilog")
        self.cores = cores = banks.Cores(
            self.board.channels, self.board.sys_clk_hz, len(self.blob) // 4, self.board.ext_reset_active_low,
            self.board.estop_mask, self.board.estop_level, *power_up_masks(self.board), jobs=self._jobs(), lines=header_lines(self.board))
        self.fabric_buses.append(cores.bus)
        fifo = self.ethmac.interface.sram.writer.stat_fifo
        self.comb += [
            cores.frame_done.eq(fifo.sink.valid),
            cores.frame_slot.eq(fifo.sink.payload.slot),
            cores.frame_pending.eq(fifo.source.valid),
            cores.pending_slot.eq(fifo.source.payload.slot),
            cores.eth_beat.eq(self.ethphy.beat),
        ]
        self.comb += slots.connect(self.ethmac.interface, cores)
        self._add_guard(cores.guard)

    def _add_guard(self, guard):
        """A store the guard keeps back leaves as a read, so its answer is the interconnect's, and
        no access takes a clock more. Guard and leash share an interrupt."""
        self.comb += self.cpu.interrupt[rm.LEASH_IRQ].eq(self.cores.leash | guard.irq)
        dbus, we, nothing = self.cpu.dbus, Signal(), wishbone.Interface(data_width=32, address_width=32, addressing="word")
        self.cpu.cpu_params["o_dBusWishbone_WE"] = we
        self.bus.add_slave("nothing", nothing, Elsewhere(self.bus))
        self.comb += [
            guard.we.eq(we), dbus.we.eq(guard.we_out),
            guard.stb.eq(dbus.stb), guard.adr.eq(dbus.adr), guard.ack.eq(dbus.ack),
            guard.vacant.eq(nothing.cyc & nothing.stb), nothing.ack.eq(guard.answer),
        ]

    def do_finalize(self):
        check_map(self)
        self.comb += [
            self.cores.abi.eq(abi_number(self)),
            self.csr_bridge.hold.eq(self.cores.hold),
            self.cores.fabric.adr.eq(self.csr_bridge.adr),
            self.cores.fabric.coming.eq(self.csr_bridge.wishbone.adr),
        ]
        SoCCore.do_finalize(self)


class Elsewhere(SoCRegion):
    """Every address that no other region has. Without an answer there the bus would wait for
    ever."""

    def __init__(self, bus):
        SoCRegion.__init__(self, origin=rm.NOTHING, size=4, mode="r", cached=False)
        self._bus = bus

    def decoder(self, bus):
        others = [region.decoder(bus) for name, region in bus.regions.items() if region is not self and name in bus.slaves]
        return lambda adr: ~reduce(or_, [other(adr) for other in others])


def power_up_masks(board):
    """`gpio.safe` and `gpio.invert_out` before the firmware runs."""
    return getattr(board, "safe_mask", 0), getattr(board, "invert_mask", 0)


def header_lines(board):
    """What the multiplexer of an image must know of its pins; `None` for a board file."""
    count = len(getattr(board, "lines", ()))
    return multiplexer.Lines(board.platform.name, count, board.key_active_low) if count else None


def random_words(count):
    """The same words on every machine and in every run."""
    rng = random.Random(0x4643_6E43)
    return [rng.getrandbits(32) for _ in range(count)]


def place_words():
    """The contents of ROM and board ROM in a routed design: no two columns of 512 bits are equal,
    so that ecpbram finds the place of each and replaces it with the image and the blob."""
    rom, board_rom = rm.ROM[1] // 4, rm.BOARD_ROM[1] // 4
    words = random_words(rom + board_rom)
    return words[:rom], words[rom:]


def board_words(data):
    """The blob as the board ROM's words, up to its end."""
    words = board_file.blob_words(data)
    return words + [0] * (rm.BOARD_ROM[1] // 4 - len(words))


# The map as built ---------------------------------------------------------------------------------

def litex_banks(soc):
    """LiteX's own pages as built, in `regmap` terms. LiteX documents few of its registers; these
    descriptions are ours."""
    out = []
    for name, page in rm.LITEX_PAGES.items():
        region = soc.csr.regions[name]
        regs = []
        if not isinstance(region.obj, Memory):
            for csr in region.obj:
                if csr.size > 32:
                    raise ValueError(f"{name}.{csr.name}: {csr.size} bits; LiteX splits such a register, and no half of it is atomic")
                access = "ro" if isinstance(csr, CSRStatus) and not hasattr(csr, "r") else "rw"
                prose = LITEX_PROSE.get((name, csr.name))
                if prose is None:
                    raise ValueError(f"{name}.{csr.name}: LiteX register without prose; add it to soc.LITEX_PROSE")
                fields = tuple(
                    rm.Field(f.name, f.offset, f.size, f"Part of {csr.name}.") for f in getattr(getattr(csr, "fields", None), "fields", ()))
                regs.append(rm.Reg(csr.name, access, prose, fields))
        out.append(rm.Bank(name, page, name, LITEX_DOC[name], tuple(regs)))
    return out


LITEX_DOC = {
    "ctrl": "LiteX's system controller.",
    "identifier_mem": "LiteX's identifier: one character per word, \"FerroCNC <version> <board>\", ended by 0.",
    "ethmac": "LiteEth's MAC: four receive and two transmit slots of 2 KiB at 0x80000000, in network order: a word reads as on the wire. A frame begins two bytes into its slot, and the length registers count them. Write the transmit slots in whole words: a byte or halfword store is lost, and reads return undefined values.",
    "ethphy": "LiteEth's PHY.",
}

LITEX_PROSE = {
    ("ctrl", "reset"): "Bit 0 resets the whole SoC, bit 1 the CPU alone; one bit each, written 1.",
    ("ctrl", "scratch"): "A word without an effect; powers up as 0x12345678, no unit.",
    ("ctrl", "bus_errors"): "Bus errors since reset, a count.",
    ("ethmac", "sram_writer_slot"): "Receive slot of the frame now presented, a number.",
    ("ethmac", "sram_writer_length"): "Length of the frame now presented, in bytes without FCS.",
    ("ethmac", "sram_writer_errors"): "Frames dropped because no receive slot was free, a count. A frame that `fast_path` executes needs none.",
    ("ethmac", "sram_writer_ev_status"): "Level: a frame is presented, one bit.",
    ("ethmac", "sram_writer_ev_pending"): "A frame is presented; write 1 to free its slot, one bit.",
    ("ethmac", "sram_writer_ev_enable"): "1 lets a received frame interrupt the CPU, one bit.",
    ("ethmac", "sram_reader_start"): "Writing it sends the frame in the chosen slot, one bit.",
    ("ethmac", "sram_reader_ready"): "1: another frame can be queued, one bit.",
    ("ethmac", "sram_reader_level"): "Frames queued for sending, a count.",
    ("ethmac", "sram_reader_slot"): "Transmit slot to send, a number.",
    ("ethmac", "sram_reader_length"): "Length of the frame to send, in bytes without FCS.",
    ("ethmac", "sram_reader_ev_status"): "Level: a frame has been sent, one bit.",
    ("ethmac", "sram_reader_ev_pending"): "A frame has been sent; write 1 to clear, one bit.",
    ("ethmac", "sram_reader_ev_enable"): "1 lets a sent frame interrupt the CPU, one bit.",
    ("ethmac", "preamble_crc"): "1: the MAC makes and checks preamble and FCS, one bit.",
    ("ethmac", "rx_datapath_preamble_errors"): "Frames dropped for a wrong preamble, a count.",
    ("ethmac", "rx_datapath_crc_errors"): "Frames dropped for a wrong FCS, a count.",
    ("ethphy", "crg_reset"): "1 resets the PHY. Never write it: this PHY makes the FPGA's clock. One bit.",
    ("ethphy", "rx_inband_status"): "The PHY's link status: bit 0 up, bits 2:1 speed (0, 1, 2: 10, 100, 1000 Mbit/s), bit 3 full duplex. Reads 0 while the PHY gives no clock.",
    ("ethphy", "mdio_w"): "Lines to the PHY's management port: bit 0 clock, bit 1 output enable, bit 2 data.",
    ("ethphy", "mdio_r"): "Data line from the PHY's management port, one bit.",
}


def check_map(soc):
    """Checks that the built SoC has every region where `regmap` puts it: otherwise the PAC would be
    wrong."""
    for name, (origin, size) in {"rom": rm.ROM, "sram": rm.RAM, "ethmac": rm.ETHMAC, "board_rom": rm.BOARD_ROM}.items():
        region = soc.bus.regions[name]
        assert (region.origin, region.size) == (origin, size), f"{name}: built at {region.origin:#x}, {region.size:#x} bytes"
    assert soc.bus.regions["csr"].origin == rm.CSR_BASE
    for name, page in rm.LITEX_PAGES.items():
        assert soc.csr.regions[name].origin == rm.CSR_BASE + page * rm.CSR_PAGE, f"{name}: not on page {page}"
    if "main_ram" in soc.bus.regions:
        region, built = soc.bus.regions["main_ram"], soc.csr.regions[rm.SDRAM.name]
        assert (region.origin, region.size) == rm.SDRAM_RAM, f"main_ram: built at {region.origin:#x}, {region.size:#x} bytes"
        assert built.origin == rm.SDRAM.base, f"{rm.SDRAM.name}: not on page {rm.SDRAM.page}"
        assert [csr.name for csr in built.obj] == [reg.name for reg in rm.SDRAM.regs], f"{rm.SDRAM.name}: its registers are {[csr.name for csr in built.obj]}"


def all_banks(soc):
    """Every bank of the map in address order: LiteX's as built, ours with all channels present, and
    the SDRAM's, which only some boards have, as checked by `check_map`."""
    return litex_banks(soc) + list(rm.BANKS)


def normalised_map(soc, layout=None):
    """Layout of the exchange and map as text, one fact per line: the ABI number is its hash.
    Descriptions are not part of it."""
    layout = LAYOUT.read_text(encoding="utf-8") if layout is None else layout
    lines = [line for line in layout.splitlines() if not line.startswith("#")]
    lines += [f"memory {n} {o:08x} {s:x}" for n, (o, s) in (("rom", rm.ROM), ("ram", rm.RAM), ("ethmac", rm.ETHMAC), ("board_rom", rm.BOARD_ROM), ("sdram", rm.SDRAM_RAM))]
    for bank in all_banks(soc):
        for i, reg in enumerate(bank.regs):
            lines.append(f"{bank.base + 4 * i:08x} {bank.name}.{reg.name} {reg.access}")
            for f in reg.fields:
                lines.append(f"  {f.lsb}:{f.width} {f.name} " + " ".join(f"{n}={v}" for n, v, _ in f.values))
    lines += ["window {:08x} {:x}".format(*rm.WINDOW)]
    lines += [f"key {n} {k:08x}" for n, k in (("arm", rm.ARM), ("soft", rm.SOFT), ("stop", rm.STOP), ("clear", rm.CLEAR), ("open", rm.OPEN))]
    return "\n".join(lines) + "\n"


def abi_number(soc, layout=None):
    return int.from_bytes(hashlib.sha256(normalised_map(soc, layout).encode()).digest()[:4], "big")


def csr_csv(soc):
    """The map as LiteX's RemoteClient reads it, with this board's channels only."""
    present = {"stepgen": soc.board.channels.stepgen, "encoder": soc.board.channels.encoder, "pwm": soc.board.channels.pwm}
    bases, registers = [], []
    for bank in all_banks(soc):
        if bank.kind in present and int(bank.name[len(bank.kind):]) >= present[bank.kind]:
            continue
        bases.append(f"csr_base,{bank.name},0x{bank.base:08x},,")
        for i, reg in enumerate(bank.regs):
            registers.append(f"csr_register,{bank.name}_{reg.name},0x{bank.base + 4 * i:08x},1,{'ro' if reg.access == 'ro' else 'rw'}")
    tail = [
        f"constant,config_clock_frequency,{soc.board.sys_clk_hz},,",
        "constant,config_csr_data_width,32,,",
        "constant,config_csr_alignment,32,,",
        "constant,config_bus_standard,wishbone,,",
        "constant,config_bus_data_width,32,,",
        "constant,config_bus_address_width,32,,",
        f"memory_region,rom,0x{rm.ROM[0]:08x},{rm.ROM[1]},cached",
        f"memory_region,sram,0x{rm.RAM[0]:08x},{rm.RAM[1]},cached",
        f"memory_region,ethmac,0x{rm.ETHMAC[0]:08x},{rm.ETHMAC[1]},io",
        f"memory_region,board_rom,0x{rm.BOARD_ROM[0]:08x},{rm.BOARD_ROM[1]},io",
        f"memory_region,csr,0x{rm.CSR_BASE:08x},{4 << rm.CSR_ADDRESS_WIDTH},io",
    ]
    return "# Generated by gateware/ferrocnc; do not edit.\n" + "\n".join(bases + registers + tail) + "\n"
