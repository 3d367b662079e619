"""The SDRAM of boards that execute jobs: LiteDRAM's controller and PHY, and the bridge from the bus
to it.

    CPU --- wishbone --- SdramBridge --- native port --- LiteDRAM --- GENSDRPHY --- pads
"""

from litex.soc.integration.soc import SoCRegion
from litedram import modules
from litedram.phy import GENSDRPHY

from . import regmap as rm
from .board import BoardError
from .sdram_bridge import SdramBridge

# The marking on the chips, and LiteDRAM's name for them. The EM636165 (512K x 16 x 2) has the
# M12L16161A's geometry; at 60 MHz its times are the same numbers of clocks.
CHIPS = {"M12L64322A": modules.M12L64322A, "2x M12L16161A": modules.M12L16161A, "2x EM636165": modules.M12L16161A}


def module(board):
    """LiteDRAM's description of the chips on this board's card."""
    said = board.platform.sdram
    if not said or said["chip"] not in CHIPS:
        raise BoardError(board.platform.file, "sdram", f"jobs live in SDRAM, and this platform has none that is known ({', '.join(CHIPS)})")
    chips = CHIPS[said["chip"]](board.sys_clk_hz, "1:1")
    # LiteDRAM rounds the time between two refreshes up: at 60 MHz 4096 of them took 64.03 ms, but
    # the data sheets require 64.
    chips.timing_settings.tREFI -= chips.timing_settings.tREFI // 32
    return chips


def add(soc, pads):
    """LiteDRAM with `pads` as the SoC's `main_ram`. The window is 8 MiB on every card: a smaller
    SDRAM appears in it twice."""
    chips = module(soc.board)
    soc.sdrphy = GENSDRPHY(pads, soc.board.sys_clk_hz)
    soc.add_sdram("sdram", phy=soc.sdrphy, module=chips, with_soc_interconnect=False)
    soc.sdram_bridge = SdramBridge(soc.sdram.crossbar.get_port())
    origin, size = rm.SDRAM_RAM
    soc.bus.add_slave("main_ram", soc.sdram_bridge.bus, SoCRegion(origin=origin, size=size, mode="rwx"))
