"""The SDRAM, where the services run: the controller with its pads, and the bridge from the bus
to it.

    CPU --- wishbone --- SdramBridge --- sdram.sv --- registers in the pads
"""

from math import ceil
from types import SimpleNamespace

from migen import ClockSignal, Instance, ResetSignal, Signal
from litex.build.io import SDROutput, SDRTristate
from litex.gen import LiteXModule
from litex.soc.integration.soc import SoCRegion
from litex.soc.interconnect.csr import CSRField, CSRStatus

from . import regmap as rm
from .board import BoardError
from .sdram_bridge import Port, SdramBridge

# The marking on the chips, and their geometry: bits of bank, row and column.
CHIPS = {
    "M12L64322A": SimpleNamespace(bank=2, row=11, column=8),
    "2x M12L16161A": SimpleNamespace(bank=1, row=11, column=8),
    "2x EM636165": SimpleNamespace(bank=1, row=11, column=8),
}
# ns, of the slowest grades of the three chips that are sold for 143 MHz: the cards do not say which
# they carry. EM636165-6 has t_RC 54 and t_RAS 36, so t_RP 18, where LiteDRAM has 15 for all three.
TIMES = {"T_RCD": 21, "T_RP": 21, "T_RAS": 42, "T_RFC": 80}
T_RC = 63
T_WR = 2             # clocks, in every data sheet
T_REFI = 15_500      # ns: 4096 refreshes in 64 ms, or 2048 in 32, less 0.8 per cent
PAUSE = 200_000      # ns between power-up and the first command


def geometry(board):
    """The chips on this board's card."""
    said = board.platform.sdram
    if not said or said["chip"] not in CHIPS:
        raise BoardError(board.platform.file, "sdram", f"its chip is none that is known ({', '.join(CHIPS)}); a board file with sdram = false does without")
    return CHIPS[said["chip"]]


def clocks(hz):
    """The parameters of `sdram.sv` that are times."""
    out = {name: ceil(ns * hz / 1e9) for name, ns in TIMES.items()}
    # The controller takes t_RC from t_RAS and t_RP, and t_RAS of a written row from t_RCD and t_WR.
    out["T_RAS"] = max(out["T_RAS"], ceil(T_RC * hz / 1e9) - out["T_RP"])
    out |= {"T_WR": T_WR, "T_REFI": T_REFI * hz // 10**9}
    out["START"] = ceil(PAUSE * hz / 1e9 / out["T_REFI"]) + 1
    assert out["T_RCD"] + T_WR >= out["T_RAS"] and max(out[name] for name in TIMES) <= 8 and out["START"] <= 22 and out["T_REFI"] <= 2048
    return out


class Sdram(LiteXModule):
    """The core `gateware/rtl/sdram.sv`, its register and its pads."""

    def __init__(self, board, pads):
        chips = geometry(board)
        self._status = CSRStatus(fields=[CSRField("ready", 1)], name="status")
        self.port = port = Port(chips.row + chips.bank + chips.column)

        # # #

        names = ("ras_n", "cas_n", "we_n", "ba", "a")
        lines = {name: Signal(len(getattr(pads, name))) for name in names}
        drives, out, came = Signal(), Signal(32), Signal(32)
        self.specials += Instance("sdram",
            p_BANK_BITS=chips.bank, p_ROW_BITS=chips.row, p_COL_BITS=chips.column, **{f"p_{name}": value for name, value in clocks(board.sys_clk_hz).items()},
            i_clk=ClockSignal("sys"), i_reset=ResetSignal("sys"),
            i_want=port.want, i_store=port.store, i_at=port.at, i_data=port.data,
            o_taken=port.taken, o_valid=port.valid, o_word=port.word, o_ready=self._status.fields.ready,
            **{f"o_{name}": line for name, line in lines.items()}, o_drives=drives, o_dq_out=out, i_dq_in=came)
        for name, line in lines.items():
            pad = getattr(pads, name)
            self.specials += [SDROutput(i=line[n], o=pad[n]) for n in range(len(pad))]
        self.specials += [SDRTristate(io=pads.dq[n], o=out[n], oe=drives, i=came[n]) for n in range(32)]


def add(soc, pads):
    """The controller with `pads` as the SoC's `main_ram`. The window is 8 MiB on every card: a
    smaller SDRAM appears in it twice."""
    soc.sdram = Sdram(soc.board, pads)
    soc.sdram_bridge = SdramBridge(soc.sdram.port)
    origin, size = rm.SDRAM_RAM
    soc.bus.add_slave("main_ram", soc.sdram_bridge.bus, SoCRegion(origin=origin, size=size, mode="rwx"))
