// What is on a pin, moved to another one: by dragging it there, or chosen from a list. It is an edit
// of the text, which is checked as any other is; comments stay.

import { html, useState } from "./vendor/preact-htm.js";

/** Text in quotes, or a comment to the line's end. */
const PARTS = /"(?:[^"\\\n]|\\.)*"|#.*$/gm;

/** The text with the two pins exchanged, wherever it names them. */
export function exchanged(toml, one, other) {
  const names = { [`"${one}"`]: `"${other}"`, [`"${other}"`]: `"${one}"` };
  return toml.replace(PARTS, (part) => names[part] ?? part);
}

/** The pin that a text names for this one: a line that several headers share has one name. */
export function named(pin) {
  return pin.same_as ?? pin.pin;
}

/** Can something else be there? */
export function isMovable(pin) {
  return pin.use !== "ground";
}

/** The list, for keyboards and fingers. */
export function Move({ drawing, pin, move }) {
  const [to, setTo] = useState("");
  if (!pin || !isMovable(pin) || pin.use === "free") return null;
  const pins = drawing.headers.flatMap((header) => header.pins);
  const others = pins.filter((it) => isMovable(it) && !it.same_as && named(it) !== named(pin));
  const take = (event) => {
    event.preventDefault();
    move(named(pin), to || others[0].pin);
  };
  return html`<form class="row" onSubmit=${take}>
    <label class="field"><span>Move ${pin.label || named(pin)} to</span>
      <select value=${to} onChange=${(event) => setTo(event.target.value)}>${others.map((it) => html`
        <option value=${it.pin}>${it.pin}: ${it.label || "free"}</option>`)}</select></label>
    <button>Move</button>
  </form>`;
}
