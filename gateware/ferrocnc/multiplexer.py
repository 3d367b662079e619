"""The pins of an image: what is between its cores and its header lines, and the numbers of both,
which are those of `wire::pins`.

    cores --> sources --> pinmux_out --> line_levels, line_drives --> pads
          <-- sinks   <-- pinmux_in  <-- line_seen, key           <--

Inputs and outputs have the numbers of their lines. The button is a line behind the others, for
inputs only.
"""

import zlib

from migen import Cat, Constant, Instance, Signal

from . import regmap as rm

HEARTBEAT = 12  # its bit of the wall clock: an edge in 4096 clocks
ESTOPS = 4


class Lines:
    """What must be known of the pins."""

    def __init__(self, platform, count, key_active_low):
        assert count % 4 == 0 and count <= min(rm.MAX_IN, rm.MAX_OUT), f"{count} lines"
        self.platform, self.count, self.key_active_low = zlib.crc32(platform.encode()), count, key_active_low


def sources(channels, pads, enabled, heartbeat):
    """What every line can carry, by number; `None` for nothing."""
    pairs = [(pads.step[n], pads.dir[n]) for n in range(channels.stepgen)] + [(pads.pwm[n], pads.pwm_dir[n]) for n in range(channels.pwm)]
    return _fours([signal for pair in [*pairs, (enabled, heartbeat)] for signal in pair])


def sinks(channels, pads, reset, factory, estops):
    """What can listen to a line, by number; `None` for nothing."""
    encoders = [(pads.enc_a[n], pads.enc_b[n], pads.enc_i[n], pads.enc_mask[n]) for n in range(channels.encoder)]
    indexes = [pads.step_index[n] for n in range(channels.stepgen)]
    return _fours([signal for encoder in encoders for signal in encoder] + indexes) + [reset, factory, None, None, *estops]


def _fours(signals):
    return signals + [None] * (-len(signals) % 4)


def join(cores, channels, estop):
    """Puts the multiplexer between the cores and the pins. `estop` is to stop the machine. Returns
    the latches of the e-stops, and the levels at the lines."""
    pads, lines, fabric = cores.pads, cores.lines, cores.fabric
    count = lines.count
    enabled, heartbeat = Signal(reset_less=True), Signal(reset_less=True)
    cores.sync += [enabled.eq(cores.gate), heartbeat.eq(cores.gate & cores.now[HEARTBEAT])]
    factory, stops, latched, ready, live = Signal(), Signal(ESTOPS), Signal(ESTOPS), Signal(), Signal()

    levels = Signal(count + 4)
    listening = sinks(channels, pads, pads.ext_reset, factory, stops)
    heard = Signal(len(listening))
    cores.comb += [sink.eq(heard[n]) for n, sink in enumerate(listening) if sink is not None]
    cores.specials += Instance("pinmux_in",
        p_PINS=count + 4, p_SINKS=len(listening), i_clk=cores.clk, i_gate=cores.gate,
        **_page(fabric, rm.PINMUX_IN, 32, ready), i_pins=Cat(pads.line_seen, pads.key, Constant(0, 3)),
        o_ready=ready, o_levels=levels, o_sinks=heard)
    cores.comb += [
        pads.inputs.eq(levels[:count]),
        # Whatever is routed: a wrong configuration must not lock its owner out.
        pads.factory.eq(factory | (levels[count] ^ int(lines.key_active_low))),
    ]
    cores.specials += Instance("estops", i_clk=cores.clk, i_lines=stops, i_clear=cores.cleared, o_estop=estop, o_latched=latched)

    carried = [Constant(0, 1) if source is None else source for source in sources(channels, pads, enabled, heartbeat)]
    cores.specials += Instance("pinmux_out",
        p_PINS=count, p_SOURCES=len(carried), i_clk=cores.clk, i_gate=cores.gate, i_inputs_ready=ready,
        **_page(fabric, rm.PINMUX_OUT, 44, live), i_sources=Cat(*carried), i_own=pads.outputs,
        o_live=live, o_levels=pads.line_levels, o_drives=pads.line_drives)
    return latched, levels[:count]


def _page(fabric, bank, words, more):
    """The page of one half: `words` words to write, then its status, with `more` in bit 2."""
    idle, refused = Signal(), Signal()
    assert bank.offset("status") == 4 * words
    fabric.live(bank, "status", Cat(idle, refused, more))
    return {"i_we": fabric.write_page(bank.page, words), "i_at": fabric.we_word[:(words - 1).bit_length()], "i_word": fabric.data,
            "o_idle": idle, "o_refused": refused}
