// Doctor: `ferrocnc doctor`.

import { html, useState } from "./vendor/preact-htm.js";
import { ask } from "./answers.js";
import { Facts, Problem, useAnswer, WhichBoard } from "./parts.js";

const VERDICTS = { bad: "bad", note: "to know", skipped: "skipped", good: "good" };

export function Doctor({ board }) {
  const [turn, setTurn] = useState(0);
  const { busy, value, error } = useAnswer(() => ask("doctor", { board }), `${board} ${turn}`);
  return html`
    <p>What of this computer makes exchanges late or loses them. It only reads.</p>
    <${WhichBoard} page="doctor" board=${board} optional />
    <p><button onClick=${() => setTurn(turn + 1)} disabled=${busy}>Look again</button></p>
    <p role="status">${busy ? "Looking …" : value && counts(value.findings)}</p>
    <${Problem} error=${error} />
    ${value && html`<${Report} report=${value} />`}`;
}

function counts(findings) {
  const of = (verdict) => findings.filter((it) => it.verdict === verdict).length;
  return Object.entries(VERDICTS).map(([verdict, word]) => `${of(verdict)} ${word}`).join(", ");
}

function Report({ report }) {
  return html`
    <ul class="findings" aria-label="Findings">
      ${report.findings.map((it) => html`<li class=${it.verdict}>
        <span class="badge">${VERDICTS[it.verdict]}</span>
        <div><b>${it.check}</b>: ${it.fact}
          ${it.reason && html`<p>Why: ${it.reason}</p>`}
          ${it.remedy && html`<p>Do: <code>${it.remedy}</code></p>`}
          ${it.lasting && html`<p>So that it lasts: <code>${it.lasting}</code></p>`}
        </div></li>`)}
    </ul>
    <h2>This computer</h2>
    <${Facts} facts=${Object.entries(report.computer ?? {})} />`;
}
