// Parts that several pages have.

import { html, useEffect, useRef, useState } from "./vendor/preact-htm.js";

/** After the last key, before a text is checked. */
const STILL_MS = 200;

/** The error of what was asked last. */
export function Problem({ error }) {
  return error && html`<p class="problem" role="alert">${error}</p>`;
}

/** A labelled input. */
export function Field({ label, hint, ...rest }) {
  return html`<label class="field"><span>${label}</span>
    <input ...${rest} />${hint && html`<small>${hint}</small>`}</label>`;
}

/** Name and value, one below the other. */
export function Facts({ facts }) {
  const rows = facts.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return html`<dl class="facts">
    ${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}
  </dl>`;
}

/** A table with a caption. */
export function Table({ caption, head, rows }) {
  if (!rows.length) return null;
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${caption}><table>
    <caption>${caption}</caption>
    <thead><tr>${head.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${rows.map((cells) => html`<tr>${cells.map((cell, n) =>
      n ? html`<td>${cell}</td>` : html`<th scope="row">${cell}</th>`)}</tr>`)}</tbody>
  </table></div>`;
}

/** The form that asks which board is meant; it leads to the page for it. */
export function WhichBoard({ page, board, optional }) {
  const [address, setAddress] = useState(board);
  useEffect(() => setAddress(board), [board]);
  const go = (event) => {
    event.preventDefault();
    location.hash = address.trim() ? `${page}/${address.trim()}` : page;
  };
  return html`<form class="row" onSubmit=${go}>
    <${Field} label="Board" value=${address} placeholder="192.168.2.50" required=${!optional}
      onInput=${(event) => setAddress(event.target.value)} />
    <button>Show</button>
  </form>`;
}

/** Asks once, and again whenever `key` changes; says what came of it. */
export function useAnswer(asking, key) {
  const [state, setState] = useState({ busy: true });
  useEffect(() => {
    let wanted = true;
    setState((before) => ({ ...before, busy: true, error: undefined }));
    asking().then(
      (value) => wanted && setState({ value }),
      (error) => wanted && setState({ error: error.message }),
    );
    return () => {
      wanted = false;
    };
  }, [key]);
  return state;
}

/**
 * Asks whenever `key` has changed and then stood still for a moment; nothing without `asking`. An
 * answer that comes when there is a newer question is dropped.
 */
export function useStill(asking, key, take, fail) {
  useEffect(() => {
    if (!asking) return undefined;
    let wanted = true;
    const ask = () => asking().then(
      (value) => wanted && take(value),
      (error) => wanted && fail(error.message),
    );
    const still = setTimeout(ask, STILL_MS);
    return () => {
      wanted = false;
      clearTimeout(still);
    };
  }, [key]);
}

/** A number with thin groups of three. */
export function number(value, digits = 0) {
  if (value === null || value === undefined) return "-";
  return value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

/**
 * A button that first shows what will be done: `question` makes it, when it is pressed. Only the
 * second button, `yes`, does it.
 */
export function Asking({ label, title, yes, question, act, ...rest }) {
  const [open, setOpen] = useState(false);
  return html`<button type="button" onClick=${() => setOpen(true)} ...${rest}>${label}</button>
    ${open && html`<${Question} title=${title ?? label} yes=${yes ?? label} act=${act}
      close=${() => setOpen(false)}>${question()}</${Question}>`}`;
}

/** Escape and the first button leave everything as it is. */
function Question({ title, yes, act, close, children }) {
  const dialog = useRef();
  useEffect(() => dialog.current.showModal(), []);
  const done = () => {
    dialog.current.close();
    act();
  };
  return html`<dialog ref=${dialog} aria-label=${title} onClose=${close}>
    <h2>${title}</h2>
    ${children}
    <p class="row">
      <button type="button" onClick=${() => dialog.current.close()}>Cancel</button>
      <button type="button" class="does" onClick=${done}>${yes}</button>
    </p>
  </dialog>`;
}

/** Does one thing at a time; says that it does, what came of it, or why not. */
export function useDoing() {
  const [state, setState] = useState({});
  const run = async (doing) => {
    setState({ busy: true });
    try {
      setState({ said: await doing() });
    } catch (error) {
      setState({ error: error.message });
    }
  };
  return [state, run];
}

/** What came of it. */
export function Outcome({ state }) {
  return html`<p role="status" class="said">${state.busy ? "Working …" : state.said}</p>
    <${Problem} error=${state.error} />`;
}
