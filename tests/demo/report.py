#!/usr/bin/env python3
"""Compares the path that LinuxCNC commanded with the path counted from the STEP/DIR edges.

    report.py OUT --json REPORT.json

Reads what run.py left in OUT; writes OUT/path.png, OUT/path.svg and the report, prints a table, and
fails when the pins disagree with the firmware's counts, an axis does not stand on its step at rest,
or is further off in motion than the arithmetic of the position loop allows (`allowed`);
and when an exchange that the firmware could foresee takes the long way.
"""

import argparse
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from card import in_words, too_slow

AXES = "xyz"
EDGE = np.dtype([("clock", "<u8"), ("count", "<i4"), ("channel", "u1"), ("forward", "u1"), ("zero", "<u2")])
# The command of servo period k is for its end; what was sampled there is read two rows later.
ROWS_TO_ARRIVAL = 2
# Clocks from the last byte of a command to the first of its answer, if the gateware answers.
FAST = 20
# Those the firmware cannot foresee take the long way: the first of the session, the one behind the
# settings, and those that change flags, state or gate. How many may be, and their clocks.
LONG_WAYS = 6
LONG = 5000
# samples.csv has six places behind the point, in mm.
ROUNDING = 0.5e-6


def load(out):
    samples = np.genfromtxt(out / "samples.csv", delimiter=",", names=True)
    edges = np.fromfile(out / "edges.bin", EDGE, offset=16)
    simulator = json.loads((out / "sim.json").read_text())
    result = json.loads((out / "result.json").read_text())
    # Of a card that was given its board file.
    file = out / "card.json"
    card = json.loads(file.read_text()) if file.exists() else None
    return samples, edges, simulator, result, card


class Pins:
    """Counts at the pins at any clock."""

    def __init__(self, edges):
        self.axes = []
        for n in range(len(AXES)):
            own = edges[edges["channel"] == n]
            self.axes.append((own["clock"].astype(np.int64), own["count"].astype(np.int64)))

    def at(self, n, clocks):
        times, counts = self.axes[n]
        return np.concatenate(([0], counts))[np.searchsorted(times, clocks, side="right")]


def clock_offset(pins, clocks, counts):
    """The harness counts clocks from power-up, the board from the end of its reset. Finds the
    difference that makes the pins agree with every count the firmware reported, and says how many
    still disagree."""
    best = min(range(0, 300), key=lambda offset: sum(disagreements(pins, clocks + offset, counts)))
    return best, sum(disagreements(pins, clocks + best, counts))


def disagreements(pins, clocks, counts):
    return [int(np.count_nonzero(pins.at(n, clocks) != counts[n])) for n in range(len(AXES))]


def loop_lag(ratio):
    """How far behind its command the position loop falls (`host/src/blocks/stepgen.rs`), in A T^2:
    A is the command's acceleration, T the servo period, `ratio` is A over `maxaccel`.

    The loop asks for the command's own speed of the period, and the stepgen ramps there with
    `maxaccel`: D the change of speed, it loses D^2 / 2 maxaccel of way. The loop foresees that, and
    takes half of what is left of it back in each period. With x the error and d the speed that is
    missing at a period's beginning, both in units of A and T, and e = x + ratio d |d| / 2,

        x' = x / 2 - ratio d |d| / 4 + ratio D |D| / 2,    D = d + e / 2,    d' = u - e / 2,    u from -1 to 1.

    While A lasts, u = -1, that comes to rest at D = -1, d = -(1 - ratio / 2): the lag below. No
    other course of u lags more, if `maxaccel` is at least twice A: all of 11 periods of -1, 0 and 1
    have been tried. Below that a command that turns its acceleration over in every period can do
    worse, so nothing is claimed.
    """
    assert ratio <= 0.5, f"maxaccel is {1 / ratio:.2f} times the acceleration, and the bound is for twice and more"
    return ratio - ratio * (1 - ratio / 2) ** 2 / 2


def allowed(axis, command, intervals, clock_hz):
    """How many steps the pins may be off the command in motion, for each period.

    Half a step, for a pin knows whole steps and the stepgen rounds to the nearest; the lag of the
    loop; and for each clock that a command came early or late its way, twice: the loop takes half
    of it back in each period, and 1 + 1/2 + 1/4 ... = 2.
    """
    period = 1e-3
    accel = axis["accel_steps"] * period**2
    late = np.max(np.abs(intervals - period * clock_hz)) / (period * clock_hz)
    way = np.abs(np.diff(command, prepend=command[0]))
    return 0.5 + loop_lag(axis["accel_steps"] / axis["maxaccel_steps"]) * accel + 2 * late * way + 2 * ROUNDING * axis["scale"]


def analyse(samples, edges, simulator, result, card):
    pins = Pins(edges)
    scales = [axis["scale"] for axis in result["axes"]]
    clocks = (samples["ticks_msb"].astype(np.int64) << 32) + samples["ticks_lsb"].astype(np.int64)
    fresh = np.flatnonzero(np.diff(clocks, prepend=-1) > 0)
    counts = [samples[f"{axis}_counts"].astype(np.int64) for axis in AXES]
    offset, unequal = clock_offset(pins, clocks[fresh], [c[fresh] for c in counts])
    arrival = clocks + offset

    report = {"axes": [], "samples_compared": int(fresh.size), "samples_pins_differ_from_counts": unequal}
    deviations = []
    rows = np.arange(1, len(samples) - ROWS_TO_ARRIVAL)
    # Before the machine is on, LinuxCNC's commanded position follows the feedback; nothing to
    # compare.
    rows = rows[samples["machine_on"][rows] > 0]
    for n, axis in enumerate(AXES):
        command = samples[f"{axis}_cmd"] * scales[n]
        there = pins.at(n, arrival[rows + ROWS_TO_ARRIVAL])
        deviation = there - command[rows]
        limit = allowed(result["axes"][n], command, np.diff(arrival[rows]), simulator["sys_clk_hz"])[rows]
        deviations.append(deviation)
        at_pins = simulator["axes"][n]["pulses_at_pins"] if n < len(simulator["axes"]) else 0
        firmware = simulator["axes"][n]["firmware_counts"] if n < len(simulator["axes"]) else 0
        report["axes"].append(
            {
                "name": axis,
                "pulses_at_pins": at_pins,
                "firmware_counts": firmware,
                "pulses_total": simulator["axes"][n]["pulses_total"] if n < len(simulator["axes"]) else 0,
                "deviation_at_rest_steps": int(at_pins - round(command[-1])),
                "deviation_max_steps": float(np.max(np.abs(deviation))),
                "deviation_over_allowed_max": float(np.max(np.abs(deviation) / limit)),
                "allowed_max_steps": float(np.max(limit)),
                "speed_max_steps_per_s": float(np.max(np.abs(np.diff(command)))) * 1000,
            }
        )
    exchange = simulator["exchange"]
    report["exchange"] = {key: exchange[key] for key in ("turnaround_cycles", "frames_lost", "frames_refused")}
    report["exchange"]["count"] = exchange["answered"]
    report["exchange"]["long_way"] = [
        {"exchange": n, "cycles": cycles, "foreseen": n not in exchange["unforeseen"]}
        for n, cycles in enumerate(exchange["turnaround_list"], 1)
        if cycles > FAST
    ]
    report["exchange"]["long_ways"] = len(report["exchange"]["long_way"])
    report["exchange"]["unforeseen"] = len(exchange["unforeseen"])
    # The board's own word for the last of them.
    report["exchange"]["long_way_reason"] = simulator["board"]["long_way"] if simulator["board"] else None
    # The margin of the command that armed the board is that of a watchdog still asleep.
    armed = (samples["enabled"] > 0) & (np.roll(samples["enabled"], 2) > 0)
    margins = samples["margin_ns"][armed]
    report["watchdog"] = {"margin_min_ms": float(np.min(margins)) / 1e6 if margins.size else None}
    report["step_timing_violations"] = simulator["timing_violations"]
    report["sys_clk_hz"] = simulator["sys_clk_hz"]
    report["kcycles_per_second"] = simulator["kcycles_per_second"]
    begun = card["ended_clock"] if card else 0
    report["machine_seconds"] = (simulator["clocks"] - begun) / simulator["sys_clk_hz"]
    if card:
        armed = arrival[samples["enabled"] > 0][0]
        report["first_file"] = card | {"armed_s": float(armed - card["begun_clock"]) / simulator["sys_clk_hz"]}
    report["program"] = Path(result["program"]).name
    return report, pins, deviations, arrival, rows, scales


def draw(out, samples, pins, deviations, arrival, rows, scales, report):
    moments = np.unique(np.concatenate([times for times, _ in pins.axes[:2]]))
    x, y = (pins.at(n, moments) / scales[n] for n in (0, 1))
    on = samples["machine_on"] > 0
    figure = plt.figure(figsize=(17, 6.4), layout="constrained")
    grid = figure.add_gridspec(len(AXES), 3, width_ratios=(1, 1, 1.1))
    path, zoom = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[:, 1])
    figure.suptitle(
        f"FerroCNC: {report['program']} cut by LinuxCNC on the simulated board, "
        f"{sum(a['pulses_total'] for a in report['axes'])} pulses at the pins"
    )
    for panel, width in ((path, 5), (zoom, 2)):
        panel.plot(samples["x_cmd"][on], samples["y_cmd"][on], color="#adb5bd", linewidth=width, label="commanded by LinuxCNC")
        panel.plot(x, y, color="#d6336c", linewidth=1, label="counted from STEP/DIR edges")
        panel.set(xlabel="X, mm", ylabel="Y, mm", aspect="equal")
        panel.grid(color="#eeeeee")
    path.set_title("the whole path")
    # A hundredth of the path's width around its middle pulse: single steps become visible.
    reach = max(np.ptp(x), np.ptp(y)) / 200
    centre = len(moments) // 2
    path.plot(x[centre], y[centre], marker="s", markersize=9, markerfacecolor="none", color="#1c7ed6")
    zoom.set(xlim=(x[centre] - reach, x[centre] + reach), ylim=(y[centre] - reach, y[centre] + reach))
    zoom.set_title(f"the blue square, 100 times larger; one step is {1000 / scales[0]:g} µm")
    zoom.legend(loc="upper left", fontsize=9)
    seconds = (arrival[rows + ROWS_TO_ARRIVAL] - arrival[rows[0]]) / report["sys_clk_hz"]
    panel = None
    for n, (axis, deviation) in enumerate(zip(AXES, deviations)):
        panel = figure.add_subplot(grid[n, 2], sharex=panel)
        panel.axhspan(-1, 1, color="#ebfbee")
        panel.plot(seconds, deviation, ",", color="#1c7ed6")
        panel.set(ylabel=f"{axis.upper()}, steps", ylim=(-1.2, 1.2))
        panel.grid(color="#dddddd")
        if n == 0:
            panel.set_title("pins minus command, every servo period (green: one step)")
    panel.set_xlabel("machine time, s")
    figure.savefig(out / "path.png", dpi=110)
    figure.savefig(out / "path.svg")


def table(report):
    if "first_file" in report:
        print(in_words(report["first_file"]) + "\n")
    print("| axis | pulses at the pins | firmware's count | at rest, steps off | in motion, steps off (max) | of allowed |")
    print("|---|---|---|---|---|---|")
    for axis in report["axes"]:
        print(
            f"| {axis['name'].upper()} | {axis['pulses_at_pins']} | {axis['firmware_counts']} "
            f"| {axis['deviation_at_rest_steps']} | {axis['deviation_max_steps']:.2f} "
            f"| {100 * axis['deviation_over_allowed_max']:.0f} % |"
        )
    turnaround, exchange = report["exchange"]["turnaround_cycles"], report["exchange"]
    print(
        f"{exchange['count']} exchanges: turnaround {turnaround['min']} / {turnaround['median']} / {turnaround['max']} "
        f"clocks (min/median/max), {exchange['frames_lost']} frames lost, {exchange['frames_refused']} refused; "
        f"watchdog margin at least {report['watchdog']['margin_min_ms']:.2f} ms; "
        f"{report['machine_seconds']:.1f} s of machine time at {report['kcycles_per_second']:.0f} kclocks/s"
    )
    slow = exchange["long_way"]
    print(
        f"{exchange['count'] - len(slow)} of them were executed and answered by the gateware alone; of the {exchange['unforeseen']} "
        "that the firmware could not foresee, it answered "
        + (", ".join(f"number {way['exchange']} ({way['cycles']} clocks)" for way in slow) or "none")
    )


def verdict(report):
    """Everything that must hold, as sentences when it does not."""
    if "first_file" in report:
        yield from too_slow(report["first_file"])
    for axis in report["axes"]:
        name = axis["name"].upper()
        if axis["pulses_at_pins"] != axis["firmware_counts"]:
            yield f"{name}: {axis['pulses_at_pins']} pulses at the pins, but the firmware counts {axis['firmware_counts']}"
        if axis["deviation_at_rest_steps"] != 0:
            yield f"{name}: {axis['deviation_at_rest_steps']} steps off at rest"
        if axis["deviation_over_allowed_max"] > 1.0:
            yield f"{name}: {axis['deviation_max_steps']:.2f} steps off in motion, more than the {axis['allowed_max_steps']:.3f} of the loop's arithmetic"
    if report["samples_pins_differ_from_counts"]:
        yield f"{report['samples_pins_differ_from_counts']} reported counts differ from the pins at their clock"
    if report["step_timing_violations"]:
        yield f"{report['step_timing_violations']} violations of the step timing"
    slow = report["exchange"]["long_way"]
    if len(slow) > LONG_WAYS:
        yield f"{len(slow)} exchanges went through the firmware, more than the {LONG_WAYS} of a session that is taken, enabled and armed"
    for way in slow:
        name = f"exchange {way['exchange']} took {way['cycles']} clocks"
        if way["foreseen"]:
            yield f"{name}: it is not the first, has no settings before it, and changes neither flags nor state"
        if way["cycles"] > LONG:
            yield f"{name}, more than {LONG}"
    if not sum(axis["pulses_total"] for axis in report["axes"]):
        yield "nothing moved"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    options = parser.parse_args()
    samples, edges, simulator, result, card = load(options.out)
    report, pins, deviations, arrival, rows, scales = analyse(samples, edges, simulator, result, card)
    draw(options.out, samples, pins, deviations, arrival, rows, scales, report)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(report, indent=2) + "\n")
    table(report)
    wrong = list(verdict(report))
    for sentence in wrong:
        print(f"WRONG: {sentence}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
