"""The PHY's wires: RGMII at 1000, 100 and 10 Mbit/s; the speed comes from the PHY (its in-band
status).

`PHY` is what LiteEth's MAC wants of a PHY, around the cores `rgmii_rx`, `rgmii_tx` and
`rgmii_link`; it has the registers that LiteEth's own RGMII PHY has. `Pins` are the ECP5's: a DDR
register and a delay at each wire. The simulated board has `PHY` and other pins (`sim.py`), so that
all but these few lines is simulated.

TXC is RXC sent back: at every speed the PHY gets data at the clock it gives. The PHYs are never
reset: the two on the board share a reset, and one of them makes the FPGA's clock.
"""

from migen import Cat, ClockDomain, ClockSignal, Instance, Signal
from migen.genlib.resetsync import AsyncResetSynchronizer
from litex.build.io import DDRInput, DDROutput
from litex.gen import LiteXModule
from litex.soc.interconnect import stream
from litex.soc.interconnect.csr import CSRField, CSRStatus, CSRStorage
from liteeth.common import eth_phy_description
from liteeth.phy.common import LiteEthPHYMDIO

# The PHY delays its clocks against the data; 2 ns more on the way in put the clock in the centre of
# the data's eye. LiteX uses the same value for these boards.
RX_DELAY = round(2e-9 / 25e-12)
TX_DELAY = 0


class PHY(LiteXModule):
    """`pins` has `rx_clk`, and in that clock `rise`, `fall`, `ctl_rise`, `ctl_fall` from the wires
    and `tx_rise`, `tx_fall`, `tx_ctl` to them. `mdio` makes the management port. `word` is the
    link's state if it does not come in-band."""

    dw, tx_clk_freq, rx_clk_freq = 8, 125e6, 125e6
    integrated_ifg_inserter = True  # the length of a gap depends on the speed: rgmii_tx keeps it

    def __init__(self, pins, mdio, word=None):
        self.crg = LiteXModule()
        self.crg._reset = CSRStorage()
        self.rx = LiteXModule()
        self.rx.inband_status = CSRStatus(fields=[CSRField("link_status", 1), CSRField("clock_speed", 2), CSRField("duplex_status", 1)])
        self.mdio = mdio()  # LiteX orders registers by their creation, and their order is the map
        self.cd_eth_rx = ClockDomain()
        self.cd_eth_tx = ClockDomain()
        self.sink = sink = stream.Endpoint(eth_phy_description(8))
        self.source = source = stream.Endpoint(eth_phy_description(8))
        self.link = link = Signal(4)  # what the register reads
        self.beat = Signal()          # in the core clock: once per 4 clocks of the receive clock

        # # #

        for domain in (self.cd_eth_rx, self.cd_eth_tx):
            self.comb += domain.clk.eq(pins.rx_clk)
            self.specials += AsyncResetSynchronizer(domain, self.crg._reset.storage)
        # LiteEth's FCS checker looks only where `last_be` is set, and LiteEth's own 8-bit PHYs do
        # not set it: so it never found a wrong FCS.
        self.comb += source.last_be.eq(source.last)
        status, slow, beat = Signal(4), Signal(), Signal()
        fields = self.rx.inband_status.fields
        self.comb += Cat(fields.link_status, fields.clock_speed, fields.duplex_status).eq(link)
        self.specials += [
            Instance("rgmii_rx",
                i_clk=ClockSignal("eth_rx"), i_rise=pins.rise, i_fall=pins.fall, i_ctl_rise=pins.ctl_rise, i_ctl_fall=pins.ctl_fall,
                o_valid=source.valid, o_data=source.data, o_last=source.last, o_status=status, o_slow=slow, o_beat=beat),
            Instance("rgmii_tx",
                i_clk=ClockSignal("eth_tx"), i_slow=slow, i_valid=sink.valid, i_last=sink.last, i_data=sink.data, o_ready=sink.ready,
                o_rise=pins.tx_rise, o_fall=pins.tx_fall, o_ctl=pins.tx_ctl),
            Instance("rgmii_link",
                i_clk=ClockSignal("sys"), i_word=status if word is None else word, i_beat=beat, o_status=link, o_changed=self.beat),
        ]


class Wires:
    """The pins `PHY` needs, as signals."""

    def __init__(self):
        self.rx_clk = Signal()
        self.rise, self.fall, self.tx_rise, self.tx_fall = (Signal(4) for _ in range(4))
        self.ctl_rise, self.ctl_fall, self.tx_ctl = (Signal() for _ in range(3))


class Pins(LiteXModule):
    """The ECP5's pins. A DDR register gives both edges' levels in the same clock."""

    def __init__(self, clock_pads, pads):
        self.wires = w = Wires()

        # # #

        clk = ClockSignal("eth_rx")
        self.comb += w.rx_clk.eq(clock_pads.rx)
        for pad, rise, fall in [(pads.rx_ctl, w.ctl_rise, w.ctl_fall), *((pads.rx_data[i], w.rise[i], w.fall[i]) for i in range(4))]:
            late = Signal()
            self.specials += [self._delay(pad, late, RX_DELAY), DDRInput(clk=clk, i=late, o1=rise, o2=fall)]
        for pad, rise, fall in [(clock_pads.tx, 1, 0), (pads.tx_ctl, w.tx_ctl, w.tx_ctl), *((pads.tx_data[i], w.tx_rise[i], w.tx_fall[i]) for i in range(4))]:
            early = Signal()
            self.specials += [DDROutput(clk=clk, i1=rise, i2=fall, o=early), self._delay(early, pad, TX_DELAY)]

    @staticmethod
    def _delay(signal, later, taps):
        return Instance("DELAYG", p_DEL_MODE="SCLK_ALIGNED", p_DEL_VALUE=taps, i_A=signal, o_Z=later)


def board_phy(clock_pads, pads):
    """The PHY of a real board."""
    pins = Pins(clock_pads, pads)
    phy = PHY(pins.wires, lambda: LiteEthPHYMDIO(pads))
    phy.pins = pins
    return phy
