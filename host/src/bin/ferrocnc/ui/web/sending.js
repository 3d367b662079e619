// Commands that take long: what they say while they work, and what came of it. They go on if the
// page is closed.

import { html, useState } from "./vendor/preact-htm.js";
import { send } from "./answers.js";
import { Outcome, useDoing } from "./parts.js";

/**
 * `give` sends a request of this command; what it says goes to `Sending`. `done` is told what was
 * done; `remedy` is for an answer without an end.
 */
export function useSending(command, { done, remedy }) {
  const [state, run] = useDoing();
  const [step, setStep] = useState();
  const [words, setWords] = useState([]);
  const give = (query, body) => run(async () => {
    setWords([]);
    let last;
    try {
      await send(command, query, body, (line) => {
        if (line.step) setStep(line);
        if (line.word) setWords((before) => [...before, line.word]);
        last = line;
      });
    } finally {
      setStep(undefined);
    }
    if (last?.error) throw new Error(last.error);
    if (!last?.done) throw new Error(`\`ferrocnc ui\` has ended; ${remedy}`);
    done(last.done);
    return last.text;
  });
  return [{ state, step, words }, give];
}

/** The step with its bar, the words, and the end. */
export function Sending({ sending: { state, step, words } }) {
  return html`${step && html`<p><label>${step.step} <progress max="1" value=${step.part}
      aria-label=${step.step} /></label></p>`}
    ${words.map((word) => html`<p role="status">${word}</p>`)}
    <${Outcome} state=${state} />`;
}
