// Configurator: a board file as text and as the card, beside each other. Nothing is written on this
// computer: the file is what was dropped, made here or read from a board, and leaves as a download
// or to a board. `ferrocnc config` judges, draws, imports, applies and reads.

import { html, useRef, useState } from "./vendor/preact-htm.js";
import { ask, tell, text } from "./answers.js";
import { Card, spoken } from "./card.js";
import { download, lineOf, show } from "./files.js";
import { exchanged, Move, named } from "./moves.js";
import { Asking, Field, Problem, Table, useAnswer, useStill } from "./parts.js";
import { Sending, useSending } from "./sending.js";

const COUNTS = ["stepgens", "encoders", "pwms", "inputs", "outputs"];
/** The card that the README names first. */
const USUAL = "5a-75b-8.0";
/** What a file's ending says about its origin. */
const ORIGINS = { ini: "lcnc", json: "litexcnc" };

/** Survives a look at another page. */
let kept = { name: "", toml: "", board: "", notes: [], saved: true };

addEventListener("beforeunload", (event) => kept.saved || event.preventDefault());

export function Configurator() {
  const [file, setFile] = useState(kept);
  const [error, setError] = useState();
  const [over, setOver] = useState(false);
  const put = (change) => {
    kept = { ...kept, ...change };
    setFile(kept);
  };
  const take = async (making) => {
    try {
      put({ notes: [], saved: false, ...(await making()) });
      setError(undefined);
    } catch (error) {
      setError(error.message);
    }
  };
  const drop = (event) => {
    event.preventDefault();
    setOver(false);
    const [dropped] = event.dataTransfer.files;
    if (dropped) take(() => opened(dropped));
  };
  const hover = (event) => {
    event.preventDefault();
    setOver(true);
  };
  return html`<div class=${over ? "over" : ""} onDragOver=${hover} onDragLeave=${() => setOver(false)}
    onDrop=${drop}>
    <details open=${!file.toml}>
      <summary>New, open, import, read</summary>
      <${New} take=${take} />
      <h2>Open or import</h2>
      <p>A board file (.toml), Lcnc's conf.ini, or LiteX-CNC's JSON: choose it, or drop it anywhere
        on this page.</p>
      <label class="field"><span>File</span><input type="file" accept=".toml,.ini,.json"
        onChange=${(event) => event.target.files[0] && take(() => opened(event.target.files[0]))} />
      </label>
      <${FromBoard} board=${file.board} put=${put} take=${take} />
    </details>
    <${Problem} error=${error} />
    ${file.notes.length > 0 && html`<section role="status" aria-label="Notes on the file">
      <ul>${file.notes.map((note) => html`<li>${note}</li>`)}</ul></section>`}
    ${file.toml && html`<${Editor} file=${file} put=${put} />`}
  </div>`;
}

/** Reads a file: a board file as it is, others by `ferrocnc config import`. */
async function opened(file) {
  const ending = file.name.split(".").pop().toLowerCase();
  const content = await file.text();
  if (ORIGINS[ending]) {
    return tell("config/import", { from: ORIGINS[ending], file: file.name, text: content });
  }
  if (ending !== "toml") {
    throw new Error(`${file.name}: a board file ends in .toml, Lcnc's in .ini, LiteX-CNC's in .json`);
  }
  return { name: file.name.slice(0, -".toml".length), toml: content, saved: true };
}

/** The file that a board has stored, as it was applied: `ferrocnc config read`. */
async function stored(board) {
  const { configuration, text, note } = await ask("config/read", { board });
  return { name: configuration, toml: text, notes: note ? [note] : [], saved: true };
}

function FromBoard({ board, put, take }) {
  const [isBusy, setBusy] = useState(false);
  const at = board.trim();
  const read = async (event) => {
    event.preventDefault();
    setBusy(true);
    await take(() => stored(at));
    setBusy(false);
  };
  return html`<h2>Read from a board</h2>
    <p>The file that its pins follow, with its comments. For a board whose pins are configured.</p>
    <form class="row" onSubmit=${read}>
      <${Address} board=${board} put=${put} />
      <button disabled=${isBusy}>Read from ${at || "a board"}</button>
    </form>`;
}

/** The same board wherever the page asks for one. */
function Address({ board, put }) {
  return html`<${Field} label="Board" value=${board} placeholder="192.168.2.50" required
    onInput=${(event) => put({ board: event.target.value })} />`;
}

function New({ take }) {
  const { value, error } = useAnswer(() => ask("platforms"), 0);
  const make = (event) => {
    event.preventDefault();
    const form = new FormData(event.target);
    const wanted = Object.fromEntries(COUNTS.map((name) => [name, Number(form.get(name))]));
    const modified = form.get("modified").split(",").map((it) => it.trim()).filter(Boolean);
    const [name, platform] = [form.get("name"), form.get("platform")];
    take(() => tell("config/new", { ...wanted, name, platform, modified }));
  };
  const begins = { stepgens: 3, encoders: 0, pwms: 1, inputs: 0, outputs: 4 };
  return html`<h2>New</h2>
    <${Problem} error=${error} />
    <form class="row" onSubmit=${make}>
      <${Field} label="Name" name="name" defaultValue="my-machine" required />
      <label class="field"><span>Card</span><select name="platform">
        ${(value ?? []).map((it) => html`<option value=${it.name} selected=${it.name === USUAL}>${it.title}</option>`)}
      </select></label>
      ${COUNTS.map((name) => html`<${Field} label=${name} name=${name} type="number" min="0" max="64"
        defaultValue=${begins[name]} required />`)}
      <${Field} label="Headers with bus switches" name="modified" placeholder="j5,j6"
        hint="encoders and inputs go there" />
      <button>Make it</button>
    </form>`;
}

/** What is checked. */
const whole = ({ name, toml }) => `${name}\n${toml}`;

function Editor({ file, put }) {
  const { name, toml } = file;
  const [verdict, setVerdict] = useState();
  const [drawing, setDrawing] = useState();
  const [pin, setPin] = useState();
  const [error, setError] = useState();
  const area = useRef();
  const check = async () => {
    const verdict = await tell("config/check", { name, toml });
    return [{ ...verdict, of: whole(file) }, verdict.ok && (await tell("config/pinout", { name, toml }))];
  };
  useStill(check, whole(file), ([verdict, drawing]) => {
    setVerdict(verdict);
    if (drawing) setDrawing(drawing);
    setError(undefined);
  }, setError);
  const choose = (pin) => {
    setPin(pin);
    const at = toml.indexOf(`"${named(pin)}"`);
    if (at >= 0) show(area.current, at, named(pin).length + 2);
  };
  const move = (from, to) => {
    put({ toml: exchanged(toml, from, to), saved: false });
    setPin(undefined);
  };
  const leave = async (ending, kind, making) => {
    try {
      download(`${name}.${ending}`, await making(), kind);
      if (ending === "toml") put({ saved: true });
    } catch (error) {
      setError(error.message);
    }
  };
  return html`<div class="editor">
    <section aria-label="The card">
      ${drawing && html`<h2>${drawing.title}</h2><p>${drawing.facts}</p>
        <${Card} drawing=${drawing} old=${verdict && !verdict.ok} chosen=${pin} choose=${choose} move=${move} />`}
      <${WithBoard} file=${file} put=${put} verdict=${verdict} />
    </section>
    <section aria-label="The board file">
      <div class="row">
        <${Field} label="Name" value=${name} onInput=${(event) => put({ name: event.target.value })} />
        <button onClick=${() => leave("toml", "application/toml", async () => toml)}>Download TOML</button>
        <button disabled=${!verdict?.ok}
          onClick=${() => leave("svg", "image/svg+xml", () => text("config/svg", { name, toml }))}>
          Download SVG</button>
        <button disabled=${!verdict?.ok} onClick=${() => print()}>Print</button>
      </div>
      <${Problem} error=${error} />
      <${Verdict} verdict=${verdict} goto=${(line) => show(area.current, ...lineOf(toml, line))} />
      <p role="status" class="chosen">${pin ? spoken(pin) : "Point at a pin to find its line, drag it to move what is on it."}</p>
      ${drawing && html`<${Move} key=${pin?.pin} drawing=${drawing} pin=${pin} move=${move} />`}
      <label class="text"><span>TOML</span><textarea ref=${area} spellcheck="false" wrap="off"
        value=${toml} onInput=${(event) => put({ toml: event.target.value, saved: false })} /></label>
    </section>
  </div>`;
}

/** What a board has other than the file, or that file on it: `ferrocnc config diff` and `apply`. */
function WithBoard({ file, put, verdict }) {
  const { name, toml, board } = file;
  const at = board.trim();
  // The verdict may still be that of the text before.
  const isGood = Boolean(verdict?.ok) && verdict.of === whole(file);
  const [found, setFound] = useState();
  const [error, setError] = useState();
  const compare = async (event) => {
    event.preventDefault();
    try {
      setFound(await tell("config/diff", { name, toml, board: at }));
      setError(undefined);
    } catch (error) {
      setFound(undefined);
      setError(error.message);
    }
  };
  const done = ({ moved }) => {
    setFound(undefined);
    if (moved) put({ board: moved });
  };
  const remedy = "apply the file again: the board has this one or the one before";
  const [sending, give] = useSending("config/apply", { done, remedy });
  const shown = (it) => it ?? "-";
  return html`<section class="with-board" aria-labelledby="with-board">
    <h2 id="with-board">With a board</h2>
    <form class="row" onSubmit=${compare}>
      <${Address} board=${board} put=${put} />
      <button disabled=${!isGood}>Compare</button>
      <${Asking} label=${`Apply to ${at || "a board"}`} title="Apply this file?" yes="Apply it"
        disabled=${!isGood || !at || sending.state.busy} act=${() => give({ board: at, name }, toml)}
        question=${() => html`<p>${verdict.name} for ${verdict.platform} to the board at ${at}, in
          the place of the file that is there. The board restarts with these pins. One that is armed
          or driven refuses.</p>`} />
    </form>
    <${Sending} sending=${sending} />
    <${Problem} error=${error} />
    ${found && html`<p role="status">${found.differences.length ? `${found.differences.length} differences`
      : `${found.board} has what this file says.`}</p>
      <${Table} caption="What differs" head=${["", "Board", "File"]}
        rows=${found.differences.map((it) => [it.what, shown(it.board), shown(it.file)])} />`}
  </section>`;
}

/** What `ferrocnc config check` says. */
function Verdict({ verdict, goto }) {
  if (!verdict) return null;
  if (verdict.ok) {
    const missing = verdict.missing_pins.length
      ? ` For simulation only: ${verdict.missing_pins[0]} and others have no pins.` : "";
    return html`<p class="verdict good" role="status"><strong>ok</strong>
      <span>It can be built.${missing}</span></p>`;
  }
  return html`<div class="verdict faulted" role="alert"><strong>refused</strong>
    <span>${verdict.key && html`<code>${verdict.key}</code> `}${verdict.value && html`<code>${verdict.value}</code> `}
      ${verdict.problem}${verdict.remedy && html`. ${verdict.remedy}`}</span>
    ${verdict.line && html`<button type="button" onClick=${() => goto(verdict.line)}>
      Line ${verdict.line}</button>`}</div>`;
}
