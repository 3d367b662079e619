// Machine: `ferrocnc machine new`, `check`, and what `write` would write, beside each other. Nothing
// is written on this computer: the file is what was opened or made here, and leaves as a download.

import { html, useRef, useState } from "./vendor/preact-htm.js";
import { ask, tell } from "./answers.js";
import { Card, spoken } from "./card.js";
import { download, lineOf, show } from "./files.js";
import { Problem, useAnswer, useStill } from "./parts.js";

/** Survives a look at another page. */
let kept = { toml: "", saved: true };

addEventListener("beforeunload", (event) => kept.saved || event.preventDefault());

export function Machine() {
  const [file, setFile] = useState(kept);
  const [error, setError] = useState();
  const put = (change) => {
    kept = { ...kept, ...change };
    setFile(kept);
    setError(undefined);
  };
  const take = async (making) => {
    try {
      put({ saved: false, ...(await making()) });
    } catch (error) {
      setError(error.message);
    }
  };
  const drop = (event) => {
    event.preventDefault();
    const [dropped] = event.dataTransfer.files;
    if (dropped) take(() => opened(dropped));
  };
  return html`<div onDragOver=${(event) => event.preventDefault()} onDrop=${drop}>
    <p>A machine in one file, of which everything that LinuxCNC needs is made. Begin with the sample
      that is most like yours, or open your <code>machine.toml</code>.</p>
    <${Begin} take=${take} />
    <${Problem} error=${error} />
    ${file.toml && html`<${Editor} toml=${file.toml} put=${put} take=${take} />`}
  </div>`;
}

async function opened(file) {
  if (!file.name.toLowerCase().endsWith(".toml")) {
    throw new Error(`${file.name}: a machine's file ends in .toml`);
  }
  return { toml: await file.text(), saved: true };
}

function Begin({ take }) {
  const { value, error } = useAnswer(() => ask("machine/samples"), 0);
  const make = (event) => {
    event.preventDefault();
    const sample = new FormData(event.target).get("sample");
    take(() => tell("machine/new", { sample }));
  };
  return html`<${Problem} error=${error} />
    <form class="row" onSubmit=${make}>
      <label class="field"><span>Sample</span><select name="sample">
        ${(value ?? []).map((it) => html`<option value=${it.name}>${it.name}: ${it.about}</option>`)}
      </select></label>
      <button>Make it</button>
      <label class="field"><span>Open (or drop it here)</span><input type="file" accept=".toml"
        onChange=${(event) => event.target.files[0] && take(() => opened(event.target.files[0]))} />
      </label>
    </form>`;
}

function Editor({ toml, put, take }) {
  const [judged, setJudged] = useState();
  const [pin, setPin] = useState();
  const [error, setError] = useState();
  const area = useRef();
  useStill(() => tell("machine/check", { toml }), toml, (judged) => {
    // What was made last stays, pale, until the text is right again.
    setJudged((before) => ({ ...before, ...judged }));
    setError(undefined);
  }, setError);
  const save = () => {
    download("machine.toml", toml, "application/toml");
    put({ saved: true });
  };
  return html`<div class="editor">
    <section aria-label="What is made of it">
      <${Problem} error=${error} />
      ${judged && html`
        <${Verdict} judged=${judged} goto=${(line) => show(area.current, ...lineOf(toml, line))} />
        <${Questions} judged=${judged} answer=${(it, value) =>
          take(() => tell("machine/put", { toml, ...slot(it), value }))} />
        ${judged.files && html`<${Made} judged=${judged} pin=${pin} setPin=${setPin} />`}`}
    </section>
    <section aria-label="The machine's file">
      <p class="row"><button onClick=${save}>Download machine.toml</button>
        <span>then <code>ferrocnc machine write</code> beside it, and <code>linuxcnc</code></span></p>
      <label class="text"><span>machine.toml</span><textarea ref=${area} spellcheck="false" wrap="off"
        value=${toml} onInput=${(event) => put({ toml: event.target.value, saved: false })} /></label>
    </section>
  </div>`;
}

function slot({ table, number, key }) {
  return { table, number, key };
}

/** What `ferrocnc machine check` says. */
function Verdict({ judged, goto }) {
  const { ok, findings, notes } = judged;
  return html`<div class=${`verdict ${ok ? "good" : "faulted"}`} role=${ok ? "status" : "alert"}>
      <strong>${ok ? "ok" : "refused"}</strong>
      <span>${ok ? "LinuxCNC's files can be made." : "Nothing is made before this is right."}</span></div>
    <ul class="findings">
      ${findings.map((it) => html`<li class=${it.verdict}><span class="badge">${it.verdict}</span>
        <div><p>${it.key && html`<code>${it.key}</code> `}${it.value && html`<code>${it.value}</code> `}
          ${it.problem}${it.remedy && html`. ${it.remedy}`}</p></div>
        ${it.line && html`<button type="button" onClick=${() => goto(it.line)}>Line ${it.line}</button>`}</li>`)}
      ${notes.map((note) => html`<li class="note"><span class="badge">note</span><p>${note}</p></li>`)}
    </ul>`;
}

/**
 * The form: an answer is taken when it is left, or with Enter. What is being typed stays when the
 * page is drawn again; a field is a new one when its answer in the text is another.
 */
function Questions({ judged, answer }) {
  const groups = new Map();
  for (const it of judged.questions) groups.set(it.group, [...(groups.get(it.group) ?? []), it]);
  return html`<details open><summary>Questions</summary>
    ${[...groups].map(([group, asked]) => html`<fieldset><legend>${group}</legend>
      <div class="row">${asked.map((it) => html`
        <label class="field" key=${`${group} ${it.key} ${it.value}`}><span>${it.asks}</span>
          <input defaultValue=${it.value} onChange=${(event) => answer(it, event.target.value)} /></label>`)}
      </div></fieldset>`)}
  </details>`;
}

/** The card, and the files. */
function Made({ judged, pin, setPin }) {
  const { drawing, files, ok } = judged;
  return html`<h2>${drawing.title}</h2><p>${drawing.facts}</p>
    <p role="status" class="chosen">${pin ? spoken(pin) : "Point at a pin to see what is on it."}</p>
    <${Card} drawing=${drawing} old=${!ok} chosen=${pin} choose=${setPin} />
    <h2>Files</h2>
    ${files.filter(({ name }) => !name.endsWith(".svg")).map(({ name, text }) => html`
      <details class=${ok ? "" : "old"}><summary>${name}</summary>
        <pre class="scroll" tabindex="0">${text}</pre></details>`)}`;
}
