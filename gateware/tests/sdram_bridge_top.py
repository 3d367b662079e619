#!/usr/bin/env python3
"""Writes the bench of the SDRAM bridge: `python sdram_bridge_top.py DIR` makes DIR/sdram_bridge.v,
the bridge with its bus as pins, and the SDRAM's controller behind it with its own."""

import sys
from pathlib import Path

from migen import ClockDomain, Instance, Signal
from litex.gen import LiteXModule

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import top  # noqa: E402
from ferrocnc.sdram_bridge import Port, SdramBridge  # noqa: E402

BANK, ROW, COLUMN = 1, 11, 8  # bits: the smaller of the cards' SDRAMs


class Top(LiteXModule):
    def __init__(self):
        self.cd_sys = ClockDomain(reset_less=True)
        port = Port(BANK + ROW + COLUMN)
        self.bridge = SdramBridge(port)
        bus = self.bridge.bus
        pins = {name: Signal(width) for name, width in (
            ("ready", 1), ("ras_n", 1), ("cas_n", 1), ("we_n", 1), ("ba", BANK), ("a", ROW), ("drives", 1), ("dq_out", 32), ("dq_in", 32))}
        self.specials += Instance("sdram",
            p_BANK_BITS=BANK, p_ROW_BITS=ROW, p_COL_BITS=COLUMN,
            i_clk=self.cd_sys.clk, i_reset=0, i_want=port.want, i_store=port.store, i_at=port.at, i_data=port.data,
            o_taken=port.taken, o_valid=port.valid, o_word=port.word,
            **{("i_" if name == "dq_in" else "o_") + name: pin for name, pin in pins.items()})
        self.ports = {
            "clk": self.cd_sys.clk,
            "adr": bus.adr, "dat_w": bus.dat_w, "dat_r": bus.dat_r, "sel": bus.sel, "cyc": bus.cyc, "stb": bus.stb, "we": bus.we,
            "cti": bus.cti, "ack": bus.ack, **pins,
        }


top.write(Top(), "sdram_bridge", sys.argv[1])
