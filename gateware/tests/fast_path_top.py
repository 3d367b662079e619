#!/usr/bin/env python3
"""Writes the bench of the fast path: `python fast_path_top.py BOARD.toml DIR` makes
DIR/fast_path_board.v, a board as it is simulated, but with the CPU's bus as pins instead of a CPU;
and DIR/board.map, the address of every register."""

import logging
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from litex.soc.integration.soc import SoCRegion  # noqa: E402
from litex.soc.interconnect import wishbone  # noqa: E402

from ferrocnc import regmap as rm, sim, soc as ferro  # noqa: E402
from ferrocnc.board import read_board  # noqa: E402

BUS = (("bus_adr", 30), ("bus_dat_w", 32), ("bus_dat_r", 32), ("bus_stb", 1), ("bus_we", 1), ("bus_ack", 1))
# Looked at, besides the pins: a command executed, a commit, the word of the gate.
SEEN = (("see_taken", 1), ("see_commit", 1), ("see_gate", 8))
# RX_ER of the PHY.
ERROR = (("gmii_rx_er", 1),)


class Pins(sim.GMIIPins):
    """The simulated PHY's wires with RX_ER, which the simulator never raises."""

    def __init__(self, platform):
        super().__init__(platform)
        valid = platform.lookup_request("gmii_rx_dv")
        self.sync.eth_rx += self.wires.ctl_fall.eq(valid ^ platform.request("gmii_rx_er"))


class Board(sim.SimSoC):
    processor = None
    mem_map = {"ethmac": rm.ETHMAC[0], "csr": rm.CSR_BASE, "sram": rm.RAM[0]}

    def _add_memories(self, rom_init):
        for name, (origin, size) in {"rom": rm.ROM, "sram": rm.RAM}.items():  # nothing runs
            self.bus.add_region(name, SoCRegion(origin=origin, size=size, mode="r"))

    def _add_guard(self, guard):
        pass

    def _freeze(self, freeze):
        bus, pin = wishbone.Interface(data_width=32, address_width=32, addressing="word"), self.platform.request
        self.bus.add_master(name="bench", master=bus)
        stb, cores = pin("bus_stb"), self.cores
        self.comb += [
            bus.adr.eq(pin("bus_adr")), bus.dat_w.eq(pin("bus_dat_w")), pin("bus_dat_r").eq(bus.dat_r), bus.sel.eq(0b1111),
            bus.cyc.eq(stb), bus.stb.eq(stb), bus.we.eq(pin("bus_we")), pin("bus_ack").eq(bus.ack),
            pin("see_taken").eq(cores.executes.taken), pin("see_commit").eq(cores.commit), pin("see_gate").eq(cores.gate_word),
        ]


def main():
    logging.disable(logging.WARNING)
    sim.PORTS += BUS + SEEN + ERROR
    sim.GMIIPins = Pins
    out = Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    board = Board(read_board(sys.argv[1]))
    board.finalize()
    text = board.platform.get_verilog(board, name="fast_path_board")
    (out / "fast_path_board.v").write_text(sim._self_contained(text))
    names = [f"{bank.name}.{reg.name} {bank.base + 4 * i:08x}" for bank in ferro.all_banks(board) for i, reg in enumerate(bank.regs)]
    (out / "board.map").write_text("\n".join(names) + "\n")


main()
