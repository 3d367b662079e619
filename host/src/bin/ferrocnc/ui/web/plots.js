// Plots of the last minute, and how often something took how long. uPlot draws them on a canvas; what
// a screen reader says of one are its newest values.

import { html, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import uPlot from "./vendor/uplot.js";
import { number } from "./parts.js";

export const MINUTE = 60;
const HEIGHT = 180;
/** Okabe and Ito's, which colour-blind readers can tell apart and which both schemes show. */
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
/** Bars of the histogram in a doubling. */
const BARS = 2;

/** A setting of the system that may change meanwhile. */
function useDark() {
  const [query] = useState(() => matchMedia("(prefers-color-scheme: dark)"));
  const [dark, setDark] = useState(query.matches);
  useEffect(() => {
    const changed = () => setDark(query.matches);
    query.addEventListener("change", changed);
    return () => query.removeEventListener("change", changed);
  }, []);
  return dark;
}

function colour(n) {
  return COLOURS[n % COLOURS.length];
}

/** Dashes, where the colours come again. */
function dash(n) {
  return n < COLOURS.length ? undefined : [6, 3];
}

function Canvas({ data, series, x, label }) {
  const [place, plot] = [useRef(), useRef()];
  const dark = useDark();
  useEffect(() => {
    const style = getComputedStyle(document.documentElement);
    const [stroke, edge] = ["--ink", "--edge"].map((name) => style.getPropertyValue(name));
    const axis = { stroke, grid: { stroke: edge, width: 1 }, ticks: { stroke: edge, width: 1 } };
    const drawn = new uPlot({
      width: place.current.clientWidth || 300, height: HEIGHT, legend: { show: false },
      cursor: { show: false }, scales: { x: { time: false, range: x.range } },
      axes: [{ ...axis, values: x.values }, { ...axis, size: 70 }], series: [{}, ...series],
    }, data, place.current);
    plot.current = drawn;
    const sized = new ResizeObserver(() =>
      drawn.setSize({ width: place.current.clientWidth, height: HEIGHT }));
    sized.observe(place.current);
    return () => {
      sized.disconnect();
      drawn.destroy();
    };
  }, [dark, series.length]);
  useEffect(() => plot.current.setData(data), [data]);
  return html`<div class="plot" role="img" aria-label=${label} ref=${place} />`;
}

/** One line for each name; `past` has `at`, in seconds, and what `of` takes from it. */
export function Lines({ title, names, past, of }) {
  const last = past.at(-1)?.at ?? 0;
  const lines = names.map((_, n) => past.map((it) => of(it, n) ?? null));
  const series = names.map((_, n) => ({ stroke: colour(n), width: 2, dash: dash(n), points: { show: false } }));
  const newest = lines.map((line) => number(line.findLast((it) => it !== null), 1));
  const x = {
    range: [-MINUTE, 0],
    values: (_, splits) => splits.map((it) => `${it} s`),
  };
  return html`<figure><figcaption>${title}
      <span class="legend">${names.length > 1 && names.map((name, n) => html`<span>
        <i class="line" data-n=${n % COLOURS.length} aria-hidden="true" /> ${name}</span>`)}</span></figcaption>
    <${Canvas} data=${[past.map((it) => it.at - last), ...lines]} series=${series} x=${x}
      label=${`${title}: ${names.map((name, n) => `${name} ${newest[n]}`).join(", ")}`} /></figure>`;
}

/** How many of the times, in microseconds, are how long; each bar is half of a doubling. */
export function Histogram({ title, times }) {
  const known = times.filter((it) => it > 0);
  const bar = (time) => Math.floor(Math.log2(time) * BARS);
  const all = known.map(bar);
  const [low, high] = known.length ? [Math.min(...all) - 1, Math.max(...all) + 1] : [0, 1];
  const bars = Array.from({ length: high - low + 1 }, (_, n) => low + n);
  const counts = bars.map((it) => all.filter((other) => other === it).length);
  const series = [{ stroke: colour(0), fill: colour(0), paths: uPlot.paths.bars({ size: [0.9], align: 1 }),
    points: { show: false } }];
  const x = {
    range: (_, from, to) => [from, to + 1],
    values: (_, splits) => splits.map((it) => (Number.isInteger(it) ? number(2 ** (it / BARS)) : "")),
  };
  const sorted = [...known].sort((a, b) => a - b);
  const at = (part) => number(sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))]);
  const said = known.length ? `${known.length} looks: half within ${at(0.5)} µs, longest ${at(1)} µs` : "none yet";
  return html`<figure><figcaption>${title} <span class="spoken">${said}</span></figcaption>
    <${Canvas} data=${[bars, counts]} series=${series} x=${x} label=${`${title}: ${said}`} /></figure>`;
}
