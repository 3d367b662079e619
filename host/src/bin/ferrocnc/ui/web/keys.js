// A board's pre-shared key: `ferrocnc key`. The key itself never comes to this page but from a file
// that is chosen here.

import { html, useState } from "./vendor/preact-htm.js";
import { ask, tell } from "./answers.js";
import { Asking, Outcome, useDoing } from "./parts.js";

export function Keys({ board, again }) {
  const [state, run] = useDoing();
  const [file, setFile] = useState();
  const order = (body) => run(async () => {
    const told = await tell("key", { board, ...body });
    again();
    return told.text;
  });
  const set = async () => order({ order: "set", file: file.name, text: await file.text() });
  return html`<details>
    <summary>Key</summary>
    <p>A board with a key is driven, set and updated only by computers that have it. The old key is
      needed to change it; this computer keeps it in a file of this user.</p>
    <p class="row">
      <button type="button" onClick=${() => run(async () => (await ask("key", { board })).text)}>
        Compare keys</button>
      <${Asking} label="New key" title="Make a new key?" yes="Make it" act=${() => order({ order: "new" })}
        question=${() => html`<p>A random key is kept in this user's file for the board and set in the
          board at ${board}, which restarts. Copy that file to every computer that is to drive it.</p>`} />
      <label class="field"><span>Key of another computer</span><input type="file" accept=".key"
        onChange=${(event) => setFile(event.target.files[0])} /></label>
      <${Asking} label="Set this key" title="Set this key?" yes="Set it" disabled=${!file} act=${set}
        question=${() => html`<p>The key in ${file.name} is kept in this user's file for the board and
          set in the board at ${board}, which restarts.</p>`} />
      <${Asking} label="Remove the key" title="Remove the key?" yes="Remove it" act=${() => order({ order: "clear" })}
        question=${() => html`<p>Every computer on the network may command the board at ${board}
          again. It restarts, and this computer's file of the key is removed.</p>`} />
    </p>
    <${Outcome} state=${state} />
  </details>`;
}
