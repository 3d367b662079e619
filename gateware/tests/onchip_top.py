#!/usr/bin/env python3
"""Writes the bench of ROM and RAM: `python onchip_top.py DIR` makes DIR/onchip.v, both with their
buses as pins."""

import sys
from pathlib import Path

from migen import ClockDomain
from litex.gen import LiteXModule
from litex.soc.interconnect import wishbone

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import top  # noqa: E402
from ferrocnc import regmap as rm  # noqa: E402
from ferrocnc.onchip import Ram, Rom  # noqa: E402


def word(n):
    """As onchip.cpp has it."""
    return (n + 1) * 0x9E37_79B1 & 0xFFFF_FFFF


class Top(LiteXModule):
    def __init__(self):
        self.cd_sys = ClockDomain(reset_less=True)
        beyond = wishbone.Interface(data_width=32, address_width=32, addressing="word")
        self.rom = Rom("words", rm.ROM_PARTS, [word(n) for n in range(sum(rm.ROM_PARTS))], lambda adr: adr[14:] == 0, beyond)
        self.ram = Ram("ram", rm.RAM_PARTS)
        buses = {"fetch": self.rom.master, "beyond": beyond, "data": self.rom.bus, "ram": self.ram.bus}
        pins = {"fetch": ("cti",), "beyond": (), "data": (), "ram": ("we", "sel", "dat_w")}
        self.ports = {"clk": self.cd_sys.clk} | {
            f"{name}_{pin}": getattr(bus, pin) for name, bus in buses.items() for pin in ("adr", "cyc", "stb", "ack", "dat_r", *pins[name])}


top.write(Top(), "onchip", sys.argv[1])
