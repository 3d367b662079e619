// Doctor: `ferrocnc doctor`, and `--fix` and `--undo` one by one. Nothing is written before the
// question that shows it is answered.

import { html, useState } from "./vendor/preact-htm.js";
import { ask, tell } from "./answers.js";
import { Asking, Facts, Outcome, Problem, useAnswer, useDoing, WhichBoard } from "./parts.js";

const VERDICTS = { bad: "bad", note: "to know", skipped: "skipped", good: "good" };

export function Doctor({ board }) {
  const [turn, setTurn] = useState(0);
  const { busy, value, error } = useAnswer(() => ask("doctor", { board }), `${board} ${turn}`);
  const [state, run] = useDoing();
  const repairs = useAnswer(() => ask("doctor/repairs"), turn);
  const repair = (shown, undo) => run(async () => {
    await tell("doctor/repairs", { undo, shown });
    setTurn(turn + 1);
    return undo ? `${shown.check}: taken back` : `${shown.check}: repaired`;
  });
  const button = (shown, undo) => html`<${Repair} shown=${shown} undo=${undo}
    refused=${repairs.value.refused} act=${() => repair(shown, undo)} />`;
  const fix = (check) => {
    const shown = repairs.value?.fixes.find((it) => it.check === check);
    return shown && button(shown, false);
  };
  return html`
    <p>What of this computer makes exchanges late or loses them. It only reads, until you repair
      something here.</p>
    <${WhichBoard} page="doctor" board=${board} optional />
    <p><button onClick=${() => setTurn(turn + 1)} disabled=${busy}>Look again</button></p>
    <p role="status">${busy ? "Looking …" : value && counts(value.findings)}</p>
    <${Problem} error=${error} />
    <${Problem} error=${repairs.error} />
    <${Outcome} state=${state} />
    ${repairs.value?.undo.length > 0 && html`<section aria-labelledby="repaired">
      <h2 id="repaired">Repaired here</h2>
      <ul class="findings">${repairs.value.undo.map((shown) => html`<li>
        <p><code>/${shown.check}</code></p>${button(shown, true)}</li>`)}</ul></section>`}
    ${value && html`<${Report} report=${value} fix=${fix} />`}`;
}

function counts(findings) {
  const of = (verdict) => findings.filter((it) => it.verdict === verdict).length;
  return Object.entries(VERDICTS).map(([verdict, word]) => `${of(verdict)} ${word}`).join(", ");
}

/** The button of a repair. Only root may; the others are told the command. */
function Repair({ shown, undo, refused, act }) {
  const label = undo ? `Take back ${shown.check}` : `Repair ${shown.check}`;
  return html`<${Asking} label=${undo ? "Take back" : "Repair"} title=${label} aria-label=${label}
    yes=${undo ? "Take it back" : "Write it"} act=${act} question=${() => html`
      <ul class="writes">${shown.writes.map(({ path, now, text }) => html`<li>
        ${text === null ? html`remove <code>${path}</code>`
          : text.includes("\n") ? html`write <code>${path}</code><pre tabindex="0">${text}</pre>`
            : html`<code>${path}</code>: <code>${now}</code> becomes <code>${text}</code>`}
      </li>`)}</ul>
      ${refused && html`<p class="problem">${refused}</p>`}`} />`;
}

function Report({ report, fix }) {
  return html`
    <ul class="findings" aria-label="Findings">
      ${report.findings.map((it) => html`<li class=${it.verdict}>
        <span class="badge">${VERDICTS[it.verdict]}</span>
        <div><b>${it.check}</b>: ${it.fact}
          ${it.reason && html`<p>Why: ${it.reason}</p>`}
          ${it.remedy && html`<p>Do: <code>${it.remedy}</code></p>`}
          ${it.lasting && html`<p>So that it lasts: <code>${it.lasting}</code></p>`}
          ${fix(it.check)}
        </div></li>`)}
    </ul>
    <h2>This computer</h2>
    <${Facts} facts=${Object.entries(report.computer ?? {})} />`;
}
