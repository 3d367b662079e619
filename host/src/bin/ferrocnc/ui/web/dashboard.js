// Dashboard: `ferrocnc watch` and `ferrocnc log`, as a guest: it takes no session.

import { html, useEffect, useState } from "./vendor/preact-htm.js";
import { listen } from "./answers.js";
import { Facts, number, Problem, Table, WhichBoard } from "./parts.js";
import { Histogram, Lines, MINUTE } from "./plots.js";

/** Lines of the log that are kept on the page. */
const LINES = 500;

export function Dashboard({ board }) {
  return html`<${WhichBoard} page="dashboard" board=${board} />
    ${board && html`<${State} key=${board} board=${board} /><${Log} key=${`log ${board}`} board=${board} />`}`;
}

function State({ board }) {
  const [look, setLook] = useState();
  const [away, setAway] = useState();
  const [past, setPast] = useState([]);
  useEffect(() => {
    const keep = (look) => setPast((before) => {
      const at = performance.now() / 1000;
      return [...before.filter((it) => it.at > at - MINUTE), { at, ...look }];
    });
    const line = (line) => {
      setLook(line);
      setAway(undefined);
      keep(line);
    };
    const gone = (why) => {
      setAway(why);
      // A gap in the lines.
      keep({});
    };
    return listen("watch", { board }, { line, away: gone });
  }, [board]);
  return html`<${Problem} error=${away} />
    ${look ? html`<${Look} look=${look} old=${Boolean(away)} /><${Plots} look=${look} past=${past} />`
      : !away && html`<p role="status">Asking ${board} …</p>`}`;
}

function Look({ look, old }) {
  return html`<div class=${old ? "old" : ""}>
    ${old && html`<p>What it said last:</p>`}
    <${Verdict} look=${look} />
    <${Facts} facts=${[
      ["Outputs", look.enabled ? "live" : "at their safe levels"],
      ["Positions", look.position_trusted ? "trusted" : "not trusted: home again"],
      ["Watchdog", look.bitten ? "has bitten" : "has not bitten"],
      ["E-stop", look.estop ? "pressed" : "released"],
      ["External reset", look.external_reset ? "active" : "not active"],
      ["Session", look.owner ? `of ${look.owner}` : "free"],
      ["Link", look.link_mbit ? `${look.link_mbit} Mbit/s` : "down"],
      ["Frames thrown away", number(look.link_errors)],
      ["Frames in, out", `${number(look.frames_rx)}, ${number(look.frames_tx)}`],
      ["Exchanges", number(look.exchanges)],
      ["Of these the fast way", number(look.ways.fast)],
      ["Refused", refused(look.refused)],
    ]} />
    <div class="columns">
      <${Table} caption="Step generators" head=${["Name", "Position, steps", "Steps/s", ""]}
        rows=${look.stepgen.map((it) => [it.name, number(it.position, 3), number(it.velocity, 1),
          it.rate_limited ? "limited" : ""])} />
      <${Table} caption="Encoders" head=${["Name", "Count", "Errors"]}
        rows=${look.encoder.map((it) => [it.name, number(it.count), number(it.errors)])} />
      <${Table} caption="Inputs" head=${["Name", "Level"]}
        rows=${look.input.map((it) => [it.name, it.level ? "high" : "low"])} />
    </div>
  </div>`;
}

/** The last minute, while this page was seen. */
function Plots({ look, past }) {
  const names = look.stepgen.map((it) => it.name);
  return html`<section aria-labelledby="minute">
    <h2 id="minute">The last minute</h2>
    <div class="plots">
      <${Lines} title="Positions, steps" names=${names} past=${past} of=${(it, n) => it.stepgen?.[n]?.position} />
      <${Lines} title="Velocities, steps/s" names=${names} past=${past} of=${(it, n) => it.stepgen?.[n]?.velocity} />
      <${Lines} title="Answer time, µs" names=${["answer"]} past=${past} of=${(it) => it.answer_us} />
      <${Histogram} title="Looks by answer time, µs" times=${past.map((it) => it.answer_us)} />
    </div>
    <p>The answer time is that of this page's own look, as a guest. How long LinuxCNC's exchanges take,
      the pins <code>exchange.time-ns-*</code> say.</p>
  </section>`;
}

/** What state it is in; what stopped it, and what to do about it. */
function Verdict({ look }) {
  const faulted = look.state === "faulted";
  const stopped = look.fault_remedy && html`<span>
    ${faulted ? "Stopped by" : "Stopped last by"}: <b>${look.fault_reason}</b>.
    ${" "}${faulted && look.fault_remedy}</span>`;
  return html`<div class=${`verdict ${look.state}`} role=${faulted ? "alert" : "status"}>
    <strong>${look.state}</strong>${stopped}</div>`;
}

function refused(reasons) {
  return Object.entries(reasons).map(([reason, count]) => `${reason} ${number(count)}`).join(", ");
}

function Log({ board }) {
  const [lines, setLines] = useState([]);
  const [note, setNote] = useState();
  useEffect(() => {
    // The board tells its whole log again, then.
    let anew = true;
    const begun = () => {
      anew = true;
    };
    const line = (line) => {
      const first = anew;
      anew = false;
      setNote(undefined);
      setLines((before) => [...(first ? [] : before), line].slice(-LINES));
    };
    const away = (why) => {
      begun();
      setNote(why);
    };
    return listen("log", { board }, { begun, line, note: setNote, away });
  }, [board]);
  return html`<section aria-labelledby="log">
    <h2 id="log">Log of the firmware</h2>
    ${note && html`<p role="status">${note}</p>`}
    <ol class="log" role="log" tabindex="0" aria-labelledby="log">${lines.map((line) => html`
      <li class=${line.level ?? ""}>${line.timestamp} <b>${line.level}</b> ${line.text}</li>`)}</ol>
  </section>`;
}
