#!/usr/bin/env python3
"""Writes the bench of the SDRAM bridge: `python sdram_bridge_top.py DIR` makes DIR/sdram_bridge.v,
the bridge with its bus and LiteDRAM's port as pins."""

import sys
from pathlib import Path

from migen import ClockDomain
from litedram.common import LiteDRAMNativePort
from litex.gen import LiteXModule
from litex.gen.fhdl import verilog

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from ferrocnc.sdram_bridge import SdramBridge  # noqa: E402

BITS = 10  # of a word's address: few, so that all accesses hit the same words


class Top(LiteXModule):
    def __init__(self):
        self.cd_sys = ClockDomain(reset_less=True)
        port = LiteDRAMNativePort("both", BITS, 32)
        self.bridge = SdramBridge(port)
        bus = self.bridge.bus
        self.ports = {
            "clk": self.cd_sys.clk,
            "adr": bus.adr, "dat_w": bus.dat_w, "dat_r": bus.dat_r, "sel": bus.sel, "cyc": bus.cyc, "stb": bus.stb, "we": bus.we,
            "cti": bus.cti, "ack": bus.ack,
            "cmd_valid": port.cmd.valid, "cmd_ready": port.cmd.ready, "cmd_we": port.cmd.we, "cmd_addr": port.cmd.addr,
            "wdata_valid": port.wdata.valid, "wdata_ready": port.wdata.ready, "wdata": port.wdata.data, "wdata_we": port.wdata.we,
            "rdata_valid": port.rdata.valid, "rdata": port.rdata.data,
        }


def main():
    top = Top()
    for name, signal in top.ports.items():
        signal.name_override = name
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    (out / "sdram_bridge.v").write_text(str(verilog.convert(top, set(top.ports.values()), name="sdram_bridge")))


main()
