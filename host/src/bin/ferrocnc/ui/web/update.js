// A new image for a board, or back to the one before: `ferrocnc update`. It goes on if this page is
// closed; the slot that is selected is never written.

import { html, useState } from "./vendor/preact-htm.js";
import { send } from "./answers.js";
import { Asking, Outcome, useDoing } from "./parts.js";

export function Update({ board, running, again }) {
  const [state, run] = useDoing();
  const [file, setFile] = useState();
  const [step, setStep] = useState();
  const [words, setWords] = useState([]);
  const update = (query, body) => run(async () => {
    setWords([]);
    let last;
    await send("update", { board, ...query }, body, (line) => {
      if (line.step) setStep(line);
      if (line.word) setWords((before) => [...before, line.word]);
      last = line;
    });
    setStep(undefined);
    if (last?.error) throw new Error(last.error);
    if (!last?.done) throw new Error("`ferrocnc ui` has ended; give the update again: it goes on where it stopped");
    again();
    return last.text;
  });
  const about = "A new image is compared, written to the slot that is not selected, verified and selected; it is loaded at the next power-up. A board that is armed or driven refuses.";
  return html`<details>
    <summary>Update</summary>
    <p>The board runs ${running}. ${about}</p>
    <div class="row">
      <label class="field"><span>Bitstream (.bit)</span><input type="file" accept=".bit"
        onChange=${(event) => setFile(event.target.files[0])} /></label>
      <${Asking} label="Write this file" title="Write this image?" yes="Write it" disabled=${!file || state.busy}
        act=${() => update({ file: file.name }, file)}
        question=${() => html`<p>${file.name} (${file.size >> 10} KiB) to the board at ${board}.</p>`} />
      <${Asking} label="Write the installed image" title="Write the installed image?" yes="Write it" disabled=${state.busy}
        act=${() => update({}, "")}
        question=${() => html`<p>The image of the package ferrocnc-images for this card and board file, to
          the board at ${board}.</p>`} />
      <${Asking} label="Back to the image before" title="Back to the image before?" yes="Select it"
        disabled=${state.busy} act=${() => update({ back: true }, "")}
        question=${() => html`<p>The board at ${board} sums up the image in its other slot, and loads it at
          its next power-up. Nothing is written.</p>`} />
    </div>
    ${step && html`<p><label>${step.step} <progress max="1" value=${step.part}
      aria-label=${step.step} /></label></p>`}
    ${words.map((word) => html`<p role="status">${word}</p>`)}
    <${Outcome} state=${state} />
  </details>`;
}
