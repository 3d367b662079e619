// Jobs: a drawing or G-code is drawn, sent to a board that executes jobs, and watched there. The
// commands are `ferrocnc job preview`, `send`, `start` and so on.

import { html, useEffect, useState } from "./vendor/preact-htm.js";
import { listen, tell } from "./answers.js";
import { Facts, Field, number, Problem, useStill, WhichBoard } from "./parts.js";

/** Survives a look at another page. */
let kept = { file: "", text: "", machine: undefined, width: "", height: "", margin: 0, tolerance: 0.02, feed: 1500 };

export function Jobs({ board }) {
  const [sheet, setSheet] = useState(kept);
  const [drawn, setDrawn] = useState();
  const [error, setError] = useState();
  const [report, setReport] = useState();
  useEffect(() => setReport(undefined), [board]);
  const put = (change) => {
    kept = { ...kept, ...change };
    setSheet(kept);
  };
  const open = async (files) => {
    for (const file of files) {
      const text = await file.text();
      put(file.name.endsWith(".toml") ? { machine: text } : { file: file.name, text });
    }
  };
  const drop = (event) => {
    event.preventDefault();
    open(event.dataTransfer.files);
  };
  const take = (value, error) => {
    setDrawn(value);
    setError(error);
  };
  useStill(sheet.file && (() => tell("job/drawn", wanted(sheet))), JSON.stringify(wanted(sheet)),
    take, (error) => take(undefined, error));
  const field = (label, name, more) => html`<${Field} label=${label} type="number" step="any"
    value=${sheet[name]} onInput=${(event) => put({ [name]: event.target.value })} ...${more} />`;
  return html`<div onDragOver=${(event) => event.preventDefault()} onDrop=${drop}>
    <p>A drawing (.svg) or G-code, and the machine's file (.toml): choose them, or drop them anywhere
      on this page.</p>
    <div class="row">
      <label class="field"><span>Drawing or G-code</span><input type="file" accept=".svg,.ngc,.gcode,.nc,.tap"
        onChange=${(event) => open(event.target.files)} /></label>
      <label class="field"><span>Machine</span><input type="file" accept=".toml"
        onChange=${(event) => open(event.target.files)} /></label>
      ${field("Page width, mm", "width", { placeholder: "its own" })}
      ${field("Page height, mm", "height", { placeholder: "its own" })}
      ${field("Margin, mm", "margin")}
      ${field("Tolerance, mm", "tolerance")}
      ${field("Feed, mm/min", "feed")}
    </div>
    <${Problem} error=${error} />
    ${drawn && html`<${Drawing} drawn=${drawn} report=${report} hasMachine=${Boolean(sheet.machine)} />`}
    <h2>On the board</h2>
    <${WhichBoard} page="jobs" board=${board} />
    ${board && html`<${OnBoard} key=${board} board=${board} drawn=${drawn} sheet=${wanted(sheet)}
      report=${report} setReport=${setReport} />`}
  </div>`;
}

/** As the server wants it. */
function wanted({ file, text, machine, width, height, margin, tolerance, feed }) {
  const page = width !== "" && height !== "" ? [Number(width), Number(height)] : undefined;
  return { file, text, machine, page, margin: Number(margin), tolerance: Number(tolerance), feed: Number(feed) };
}

/** Where the axes are, in mm, if that is known. */
function penOf(drawn, report) {
  const scale = drawn?.steps_per_mm;
  if (!scale || !report?.position_known) return undefined;
  return report.steps.map((steps, axis) => steps / scale[axis]);
}

function Drawing({ drawn, report, hasMachine }) {
  const { planned, out_of_bounds: wrong } = drawn;
  const size = drawn.highest_mm.map((high, axis) => number(high - drawn.lowest_mm[axis], 1));
  const picture = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(drawn.svg)}`;
  return html`
    <${Problem} error=${wrong.length > 0 && `Out of the machine's bounds: ${wrong.slice(0, 3).join("; ")}`} />
    <${Facts} facts=${[
      ["Job", drawn.name],
      ["Size, mm", `${size[0]} x ${size[1]}`],
      ["Drawn", `${number(drawn.drawn_mm)} mm`],
      ["Travelled", `${number(drawn.travelled_mm)} mm`],
      ["Takes", planned ? `${number(planned.seconds)} s` : !hasMachine && "unknown without the machine's file"],
    ]} />
    ${drawn.notes.map((note) => html`<p role="status">${note}</p>`)}
    <${Watched} drawn=${drawn} picture=${picture} pen=${penOf(drawn, report)}
      isDown=${Boolean(report?.outputs & 1)} label=${`The path of ${drawn.name}, ${size[0]} by ${size[1]} mm`} />`;
}

/** The drawing with the pen over it. */
function Watched({ drawn, picture, pen, isDown, label }) {
  const [left, top, wide, tall] = drawn.frame;
  return html`<svg class="drawing" viewBox=${`${left} ${top} ${wide} ${tall}`} role="img" aria-label=${label}>
    <image href=${picture} x=${left} y=${top} width=${wide} height=${tall} />
    ${pen && html`<g class=${`pen ${isDown ? "down" : "up"}`} transform=${`translate(${pen[0]} ${-pen[1]})`}>
      <circle r=${Math.max(wide, tall) / 100} /></g>`}
  </svg>`;
}

function OnBoard({ board, drawn, sheet, report, setReport }) {
  const [away, setAway] = useState();
  const [said, setSaid] = useState();
  const [error, setError] = useState();
  useEffect(() => listen("job/watch", { board }, {
    line: (line) => {
      setReport(line);
      setAway(undefined);
    },
    away: setAway,
  }), [board]);
  const ask = async (command, body, done) => {
    try {
      const answer = await tell(command, { board, ...body });
      setError(undefined);
      setSaid(done?.(answer));
    } catch (error) {
      setError(error.message);
    }
  };
  const order = (order, name) => ask("job/order", { order, name });
  const send = () => ask("job/send", { sheet }, (entry) =>
    `${entry.name} is on the board: ${number(entry.instructions)} instructions`);
  const button = (shown, onClick, isOff) => html`<button type="button" onClick=${onClick}
    disabled=${Boolean(isOff)}>${shown}</button>`;
  return html`
    <${Problem} error=${away} />
    <${Problem} error=${error} />
    <p class="row">
      ${button("Send", send, !drawn)}
      ${button("Home", () => order("home"))}
      ${button("Start", () => order("start", drawn.name), !drawn)}
      ${button("Pause", () => order("pause"))}
      ${button("Continue", () => order("continue"))}
      ${button("Stop", () => order("stop"))}
    </p>
    <p role="status">${said}</p>
    ${report && html`<div class=${away ? "old" : ""}>
      <progress max="100" value=${report.progress} aria-label="Progress of the job">${report.progress} %</progress>
      <${Facts} facts=${[
        ["State", report.state],
        ["Job", report.name],
        ["Line", report.line],
        ["Passed", `${number(report.elapsed_s, 1)} s`],
        ["To go", `${number(report.remaining_s, 1)} s`],
        ["Ended last", report.end],
        ["At steps", report.steps.map((it) => number(it)).join(", ")],
        ["Pen, mm", penOf(drawn, report)?.map((it) => number(it, 2)).join(", ")],
        ["Position", report.position_known ? "known" : "not known: home"],
        ["Machine", report.machine ? "told" : "not told: send with its file"],
      ]} /></div>`}
    <p>A job that is started here stops on its path if this page is closed or hidden for 3 s.</p>`;
}
