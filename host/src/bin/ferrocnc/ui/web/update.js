// A new image for a board, or back to the one before: `ferrocnc update`. It goes on if this page is
// closed; the slot that is selected is never written.

import { html, useState } from "./vendor/preact-htm.js";
import { Asking } from "./parts.js";
import { Sending, useSending } from "./sending.js";

export function Update({ board, running, again }) {
  const [file, setFile] = useState();
  const remedy = "give the update again: it goes on where it stopped";
  const [sending, give] = useSending("update", { done: again, remedy });
  const isBusy = sending.state.busy;
  const update = (query, body) => give({ board, ...query }, body);
  const about = "A new image is compared, written to the slot that is not selected, verified and selected; it is loaded at the next power-up. A board that is armed or driven refuses.";
  return html`<details>
    <summary>Update</summary>
    <p>The board runs ${running}. ${about}</p>
    <div class="row">
      <label class="field"><span>Bitstream (.bit)</span><input type="file" accept=".bit"
        onChange=${(event) => setFile(event.target.files[0])} /></label>
      <${Asking} label="Write this file" title="Write this image?" yes="Write it" disabled=${!file || isBusy}
        act=${() => update({ file: file.name }, file)}
        question=${() => html`<p>${file.name} (${file.size >> 10} KiB) to the board at ${board}.</p>`} />
      <${Asking} label="Write the installed image" title="Write the installed image?" yes="Write it" disabled=${isBusy}
        act=${() => update({}, "")}
        question=${() => html`<p>The image of the package ferrocnc-images for this card and board file, to
          the board at ${board}.</p>`} />
      <${Asking} label="Back to the image before" title="Back to the image before?" yes="Select it"
        disabled=${isBusy} act=${() => update({ back: true }, "")}
        question=${() => html`<p>The board at ${board} sums up the image in its other slot, and loads it at
          its next power-up. Nothing is written.</p>`} />
    </div>
    <${Sending} sending=${sending} />
  </details>`;
}
