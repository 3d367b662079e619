"""The simulated board: the same SoC with its pins as plain ports, behind a PHY that speaks GMII
bytes.

`elaborate` writes Verilog for the module `sim`. Its ports are the same for every board. Nothing in
it depends on a firmware image: the ROM is one public array (`manifest.json` names it) which the
simulator fills from an ELF.
"""

import json
import re
from pathlib import Path
from types import SimpleNamespace

from migen import Cat, ClockDomain, ClockSignal, Instance, Module, Mux, Signal
from litex.gen import LiteXModule
from litex.gen.fhdl import verilog
from litex.build.generic_platform import GenericPlatform, Pins
from litex.build.io import SDRTristate
from litex.build.sim import common as sim_common
from litex.soc.interconnect.csr import CSRField, CSRStatus, CSRStorage

from . import banks, regmap as rm, rgmii, sdram, settled, soc as ferro
from .board import blob

CHIP = Path(__file__).resolve().parents[2] / "sim" / "verilator" / "sdram_chip.sv"
COPPER = CHIP.with_name("copper.sv")

PORTS = (
    ("sys_clk", 1), ("sys_rst", 1), ("eth_clk", 1),
    ("gmii_rx_data", 8), ("gmii_rx_dv", 1), ("gmii_tx_data", 8), ("gmii_tx_en", 1),
    ("step", rm.MAX_STEPGEN), ("dir", rm.MAX_STEPGEN), ("step_n", rm.MAX_STEPGEN), ("dir_n", rm.MAX_STEPGEN), ("step_index", rm.MAX_STEPGEN),
    ("enc_a", rm.MAX_ENCODER), ("enc_b", rm.MAX_ENCODER), ("enc_i", rm.MAX_ENCODER), ("enc_mask", rm.MAX_ENCODER),
    ("pwm_out", rm.MAX_PWM), ("pwm_dir", rm.MAX_PWM), ("gpio_in", rm.MAX_IN), ("gpio_out", rm.MAX_OUT),
    ("ext_reset", 1), ("led", 1), ("gate", 1), ("cpu_freeze", 1),
    ("spi_cs_n", 1), ("spi_clk", 1), ("spi_mosi", 1), ("spi_miso", 1), ("factory", 1), ("link_status", 4),
    ("pad_fault", 2), ("pad_at", 8), ("pad_to", 8),
    # An image's header lines, by number: levels from outside; of the pads that are driven; which
    # those are. All other pins of channels are 0 there, and have no effect.
    ("header_in", rm.MAX_IN), ("header_out", rm.MAX_OUT), ("header_drives", rm.MAX_OUT),
)
# Ports of pins that are driven, with the signal of `banks.Pads`: 16 bits each and 64, in the order
# in which `copper.sv` counts pads.
DRIVEN = (("step", "step"), ("dir", "dir"), ("step_n", "step_n"), ("dir_n", "dir_n"), ("pwm_out", "pwm"), ("pwm_dir", "pwm_dir"), ("gpio_out", "outputs"))
# Ports of pins that are not, by the same.
_FUNCTIONS = {"step_index": "step_index", "enc_a": "enc_a", "enc_b": "enc_b", "enc_i": "enc_i", "enc_mask": "enc_mask", "gpio_in": "inputs",
              "ext_reset": "ext_reset", "factory": "factory"}
_HEADER = ("header_in", "header_out", "header_drives")
_LINES_AT = 96  # the first line's pad in `copper.sv`


class _Platform(GenericPlatform):
    def __init__(self):
        GenericPlatform.__init__(self, "SIM", [(name, 0, Pins(width)) for name, width in PORTS], name="sim")

    def get_verilog(self, *args, special_overrides=None, **kwargs):
        overrides = {**sim_common.sim_special_overrides, SDRTristate: _PadRegisters}
        overrides.update(special_overrides or {})
        return GenericPlatform.get_verilog(self, *args, special_overrides=overrides, **kwargs)


class _CRG(LiteXModule):
    def __init__(self, platform):
        self.rst = Signal()
        self.cd_sys = ClockDomain()
        self.comb += [
            self.cd_sys.clk.eq(platform.request("sys_clk")),
            self.cd_sys.rst.eq(platform.request("sys_rst") | self.rst),
        ]


class MDIO(LiteXModule):
    """The registers of the management port, without a PHY."""

    def __init__(self):
        self._w = CSRStorage(fields=[CSRField("mdc", 1), CSRField("oe", 1), CSRField("w", 1)], name="w")
        self._r = CSRStatus(fields=[CSRField("r", 1)], name="r")


class GMIIPins(LiteXModule):
    """The PHY's wires without their DDR pins: the same register stages, a byte per clock whatever
    `link_status` says.

        eth_clk   _/‾\\_/‾\\_/‾\\_
        rx_dv     __/‾‾‾‾‾‾‾‾‾\\     preamble and FCS included, as on the wire
        rx_data   --X55X55Xd5X..
    """

    def __init__(self, platform):
        self.wires = w = rgmii.Wires()

        # # #

        self.comb += w.rx_clk.eq(platform.request("eth_clk"))
        data, valid = platform.request("gmii_rx_data"), platform.request("gmii_rx_dv")
        self.sync.eth_rx += [  # the IDDR's register
            w.rise.eq(Mux(valid, data[:4], 0b1101)), w.fall.eq(Mux(valid, data[4:], 0b1101)), w.ctl_rise.eq(valid), w.ctl_fall.eq(valid),
        ]
        self.sync.eth_tx += [  # the ODDR's
            platform.request("gmii_tx_en").eq(w.tx_ctl), platform.request("gmii_tx_data").eq(Cat(w.tx_rise, w.tx_fall)),
        ]


class _PadRegisters(Module):
    """A two-way pad's registers, with a wire for each way instead of the pad."""

    def __init__(self, io, o, oe, i):
        pad, n = io.value, io.start
        self.sync += [pad.out[n].eq(o), pad.drives[n].eq(oe), i.eq(pad.back[n])]

    @staticmethod
    def lower(dr):
        return _PadRegisters(dr.io, dr.o, dr.oe, dr.i)


def _sdram(soc, platform, board):
    """The wires of an SDRAM, and a model of the chip (`sdram_chip.sv`): the pads' registers are
    those of the card."""
    chips = sdram.geometry(board)
    dq = Signal(32)
    dq.out, dq.drives, dq.back = Signal(32), Signal(32), Signal(32)
    pads = SimpleNamespace(dq=dq, a=Signal(chips.row), ba=Signal(chips.bank), **{name: Signal(reset=1) for name in ("ras_n", "cas_n", "we_n")})
    platform.add_source(str(CHIP), "systemverilog")
    soc.specials += Instance("sdram_chip",
        p_BANK_BITS=chips.bank, p_ROW_BITS=chips.row, p_COL_BITS=chips.column,
        i_clk=ClockSignal(), i_ras_n=pads.ras_n, i_cas_n=pads.cas_n, i_we_n=pads.we_n, i_ba=pads.ba, i_a=pads.a,
        i_drives=dq.drives[0], i_d=dq.out, o_q=dq.back)
    return pads


def _phy(platform):
    pins = GMIIPins(platform)
    phy = rgmii.PHY(pins.wires, MDIO, word=platform.request("link_status"))
    phy.pins = pins
    return phy


class SimSoC(ferro.FerroSoC):
    def __init__(self, board):
        platform = _Platform()
        pads = _sdram(self, platform, board) if board.sdram else None
        ferro.FerroSoC.__init__(self, platform, board, _CRG(platform), lambda soc: _phy(platform), sdram_pads=pads)
        self._freeze(platform.request("cpu_freeze"))
        pads = self.cores.pads
        for port in ("led", "gate", "spi_cs_n", "spi_clk", "spi_mosi"):
            self.comb += platform.request(port).eq(getattr(pads, port))
        self.comb += pads.spi_miso.eq(platform.request("spi_miso"))
        ports = {name: platform.request(name) for name in (*_FUNCTIONS, *_HEADER)}
        if board.lines:
            self._header(platform, pads, ports, board)
        else:
            self._functions(platform, pads, ports, board)

    def _functions(self, platform, pads, ports, board):
        """The pins of a board file, each with its function."""
        absent = {name for kind, names in (("stepgen", ("step", "dir", "step_n", "dir_n")), ("pwm", ("pwm", "pwm_dir")), ("outputs", ("outputs",)))
                  if not getattr(board.channels, kind) for name in names}
        widths, first, driven = dict(PORTS), 0, Signal(160)
        levels = self._copper(platform, driven)
        for port, name in DRIVEN:
            signal, seen = getattr(pads, name), getattr(pads, f"{name}_seen")
            if name not in absent:
                self.comb += driven[first:first + len(signal)].eq(signal)
            self.comb += [platform.request(port).eq(levels[first:first + widths[port]]), seen.eq(levels[first:first + len(seen)])]
            first += widths[port]
        for port, name in _FUNCTIONS.items():
            # The external reset's port is active high on every board: the pin's own polarity is
            # undone in front of the core.
            low = port == "ext_reset" and board.ext_reset_active_low
            self.comb += getattr(pads, name).eq(~ports[port] if low else ports[port])
        self.comb += [ports["header_out"].eq(0), ports["header_drives"].eq(0)]

    def _header(self, platform, pads, ports, board):
        """The lines of an image, with the registers their pads have. A line is pad 96 and up of the
        copper, as the outputs of a board file are."""
        for port, _ in DRIVEN:
            self.comb += platform.request(port).eq(0)
        count, driven = len(board.lines), Signal(160)
        out, drives = Signal(count, reset=(1 << count) - 1, reset_less=True), Signal(count, reset_less=True)
        self.sync += [out.eq(pads.line_levels), drives.eq(pads.line_drives)]
        here = self._copper(platform, driven)[_LINES_AT:_LINES_AT + count]
        self.comb += [
            driven[_LINES_AT:_LINES_AT + count].eq(drives & out | ~drives & ports["header_in"]),
            ports["header_out"].eq(drives & here), ports["header_drives"].eq(drives),
            pads.line_seen.eq(here), pads.key.eq(ports["factory"] ^ int(board.key_active_low)),
        ]

    def _copper(self, platform, driven):
        """What the harness makes of the driven pads: the ports carry the pads' own levels, and so
        does what is read back."""
        levels = Signal(160)
        platform.add_source(str(COPPER), "systemverilog")
        self.specials += Instance("copper",
            i_driven=driven, i_fault=platform.request("pad_fault"), i_at=platform.request("pad_at"), i_to=platform.request("pad_to"), o_level=levels)
        return levels

    def _freeze(self, freeze):
        """A hung CPU: its clock stops between edges, and it makes no bus access. Change
        `cpu_freeze` while sys_clk is low."""
        params = self.cpu.cpu_params
        clock = Signal(name="cpu_clk")
        self.comb += clock.eq(self.crg.cd_sys.clk & ~freeze)
        params["i_clk"] = clock
        for bus, port in ((self.rom.master, "iBus"), (self.cpu.dbus, "dBus")):
            asks = Signal()
            params[f"o_{port}Wishbone_CYC"] = asks
            self.comb += bus.cyc.eq(asks & ~freeze)


def elaborate(board, out):
    """Writes sim.v, manifest.json, csr.csv and board.bin. Returns the manifest."""
    out = Path(out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    soc = SimSoC(board)
    soc.finalize()
    top = soc.platform.get_verilog(soc, name="sim")
    (out / "sim.v").write_text(_self_contained(top))
    (out / "csr.csv").write_text(ferro.csr_csv(soc))
    (out / "board.bin").write_bytes(soc.blob)
    manifest = {
        "top": "sim",
        "board": board.name,
        "verilog": [str(Path(source[0]).resolve()) for source in soc.platform.sources] + [str(out / "sim.v")],
        "rom_signals": [f"rom_{n}" for n in range(len(rm.ROM_PARTS))],
        "ram_signals": [f"sram_{n}" for n in range(len(rm.RAM_PARTS))],
        "rom_words": rm.ROM[1] // 4,
        "sys_clk_hz": board.sys_clk_hz,
        "eth_clk_hz": 125_000_000,
        "abi": f"0x{ferro.abi_number(soc):08x}",
        "csr_csv": str(out / "csr.csv"),
        "board_blob": str(out / "board.bin"),
        "ports": dict(PORTS),
    }
    (out / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    return manifest


def _self_contained(top):
    """One file without `$readmemh`: a shared library has no folder to read from. The simulator
    loads the ROM."""
    text = settled.verilog(top.main_source)
    rom = re.compile(r"^(\(\*[^\n]*\*\)\s*)?reg \[31:0\] rom_\d\[0:\d+\];", re.M)
    assert len(rom.findall(text)) == ("module sim (" in text) * len(rm.ROM_PARTS), "sim.v: the ROM's arrays are not where they used to be"
    text = rom.sub(lambda m: m.group(0)[:-1] + " /*verilator public_flat_rw*/;", text)

    def inline(match):
        file, memory = match.groups()
        if memory == "rom_0":
            return "rom_0[0] = 32'h0000006f; // waits for an image: jumps to itself"
        if memory.startswith("rom_"):
            return ""
        words = top.data_files[file].split()
        return "\n    ".join(f"{memory}[{i}] = 32'h{w};" for i, w in enumerate(words) if int(w, 16))

    text = re.sub(r'\$readmemh\("([^"]+)", (\w+)\);', inline, text)
    assert "$readmemh" not in text
    # No `timescale: the cores have none, and the simulator defines time.
    return re.sub(r"^(// (Date|LiteX sha1|Filename)|`timescale).*\n", "", text, flags=re.M)


def elaborate_cores(board, out):
    """Writes cores.v, the cores and their banks with the CSR bus as ports, and the map as
    cores.map: for `tests/cores.cpp` and `image.cpp`. The stream into the receive slots and the way
    into transmit slot 0 are ports, too. The SDRAM's controller is not included. Of an image, what
    is between cores and multiplexer are ports, too: all of them outputs."""
    out = Path(out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    cores = banks.Cores(board.channels, board.sys_clk_hz, len(blob(board)) // 4, estop_mask=board.estop_mask, estop_level=board.estop_level,
                        jobs=board.jobs, lines=ferro.header_lines(board), **dict(zip(("safe_mask", "invert_mask"), ferro.power_up_masks(board))))
    cores.cd_sys = ClockDomain()
    bus, pads = cores.bus, cores.pads
    ports = {
        "clk": cores.cd_sys.clk, "rst": cores.cd_sys.rst, "abi": cores.abi,
        "adr": cores.fabric.adr, "coming": cores.fabric.coming, "we": bus.we, "dat_w": bus.dat_w, "dat_r": bus.dat_r,
        "frame_done": cores.frame_done, "frame_slot": cores.frame_slot,
        "frame_pending": cores.frame_pending, "pending_slot": cores.pending_slot, "eth_beat": cores.eth_beat,
        **{name: getattr(pads, name) for name in vars(pads)},
        "hold": cores.hold, "refuse": cores.refuse, "take": cores.take, "taken": cores.executes.taken,
        **{f"words_{name}": signal for name, signal in vars(cores.words).items()},
        **{f"answer_{name}": signal for name, signal in vars(cores.answer).items()},
    }
    for name, signal in ports.items():
        signal.name_override = name
    top = verilog.convert(cores, set(ports.values()), name="cores")
    (out / "cores.v").write_text(_self_contained(top))
    names = [f"{bank.name}.{reg.name} 0x{bank.page * rm.CSR_PAGE // 4 + i:x} {reg.access} 0x{rm.mask(reg):x}"
             for bank in rm.BANKS if bank is not rm.SDRAM for i, reg in enumerate(bank.regs)]
    (out / "cores.map").write_text("\n".join(names) + "\n")
