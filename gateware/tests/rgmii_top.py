#!/usr/bin/env python3
"""Writes the bench of the board's PHY: `python rgmii_top.py DIR` makes DIR/rgmii.v, LiteEth's MAC
behind our PHY, ECP5 pins in front.

The MAC's streams are ports in the core clock. What it would not have given to a slot (an error with
the last byte) is marked by `rx_error`, as LiteEth's slots see it.
"""

import logging
import sys
from pathlib import Path

from migen import ClockDomain, Record, Signal
from litex.build.lattice.common import lattice_ecp5_special_overrides
from litex.gen import LiteXModule
from liteeth.mac.core import LiteEthMACCore

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import top  # noqa: E402
from ferrocnc import rgmii, sim  # noqa: E402


class Top(LiteXModule):
    def __init__(self):
        self.cd_sys = ClockDomain(reset_less=True)
        clocks = Record([("rx", 1), ("tx", 1)])
        pads = Record([("rx_ctl", 1), ("rx_data", 4), ("tx_ctl", 1), ("tx_data", 4)])
        self.pins = rgmii.Pins(clocks, pads)
        self.phy = phy = rgmii.PHY(self.pins.wires, sim.MDIO)
        self.mac = mac = LiteEthMACCore(phy=phy, dw=32, tx_cdc_depth=16, rx_cdc_depth=16)
        error = Signal()
        self.comb += [mac.source.ready.eq(1), error.eq((mac.source.error & mac.source.last_be) != 0)]
        self.ports = {
            "clk": self.cd_sys.clk, "rx_clk": clocks.rx, "tx_clk": clocks.tx,
            "rx_ctl": pads.rx_ctl, "rx_data": pads.rx_data, "tx_ctl": pads.tx_ctl, "tx_data": pads.tx_data,
            "to_valid": mac.sink.valid, "to_ready": mac.sink.ready, "to_last": mac.sink.last, "to_last_be": mac.sink.last_be, "to_word": mac.sink.data,
            "from_valid": mac.source.valid, "from_last": mac.source.last, "from_last_be": mac.source.last_be, "from_word": mac.source.data,
            "from_error": error, "status": phy.link, "beat": phy.beat,
            "preamble_errors": mac.rx_datapath.preamble_errors.status, "crc_errors": mac.rx_datapath.crc_errors.status,
        }


logging.disable(logging.WARNING)
top.write(Top(), "rgmii", sys.argv[1], special_overrides=lattice_ecp5_special_overrides)
