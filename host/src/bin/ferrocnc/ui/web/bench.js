// Bench: what `ferrocnc test` does. This page has the board while it is seen; the server moves
// nothing for another one.

import { html, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import { listen, tell } from "./answers.js";
import { number, Problem, Table, WhichBoard } from "./parts.js";

/** Between two repeats of a button that is held; without one for 200 ms the axis brakes. */
const REPEAT_MS = 50;

export function Bench({ board }) {
  return html`
    <p>One output, one axis at a time, slowly, before LinuxCNC is there. Nothing is driven before${" "}
      <b>Arm</b>; an axis moves while its button is held. This page takes the board, and gives it
      back when you leave it or hide its tab.</p>
    <${WhichBoard} page="bench" board=${board} />
    ${board && html`<${Held} key=${board} board=${board} />`}`;
}

function Held({ board }) {
  const [look, setLook] = useState();
  const [away, setAway] = useState();
  const [error, setError] = useState();
  const hold = useRef();
  const sent = useRef({ last: Promise.resolve(), waiting: 0 });
  useEffect(() => listen("bench", { board }, {
    line: (line) => {
      hold.current = line.hold;
      setLook(line);
      setAway(undefined);
    },
    away: (why) => {
      setLook(undefined);
      setAway(why);
    },
  }), [board]);
  // One request after the other: a release must not be overtaken by a repeat.
  const press = (keys, isRepeat) => {
    const queue = sent.current;
    if (isRepeat && queue.waiting) return;
    queue.waiting += 1;
    const done = (error) => {
      queue.waiting -= 1;
      setError(error?.message);
    };
    queue.last = queue.last
      .then(() => tell("bench/keys", { hold: hold.current, keys }))
      .then(() => done(), done);
  };
  useEffect(() => {
    const escape = (event) => event.key === "Escape" && press(["stop"]);
    addEventListener("keydown", escape);
    return () => removeEventListener("keydown", escape);
  }, []);
  if (!look) {
    return away ? html`<${Problem} error=${away} />` : html`<p role="status">Asking ${board} …</p>`;
  }
  const isArmed = look.state === "ARMED";
  return html`
    <div class=${`verdict ${isArmed ? "armed" : ""}`} role="status"><strong>${look.state}</strong>
      <span>${look.title}: ${look.said}</span></div>
    <${Problem} error=${error} />
    <p class="row">
      <button type="button" onClick=${() => press(["arm"])} disabled=${look.state !== "OFF"}>Arm</button>
      <button type="button" onClick=${() => press(["stop"])}>Stop (Esc)</button>
      <button type="button" onClick=${() => press(["off"])}>All off</button>
    </p>
    <div class="columns">
      <${Table} caption="Outputs" head=${["Name", "Pins", "", ""]} rows=${look.outputs.map((it, n) => [
        it.name, it.pins, it.on ? "on" : "off",
        html`<button type="button" onClick=${() => press([{ output: n }, "switch"])}
          aria-label=${`${it.name} on for 3 s`}>On for 3 s</button>`])} />
      <${Table} caption="Motors" head=${["Name", "Pins", "Steps", "Jog"]} rows=${look.motors.map((it, n) => [
        it.name, it.pins, number(it.gone),
        html`<${Jog} n=${n} motor=${it} press=${press} />`])} />
      <${Table} caption="Encoders" head=${["Name", "Pins", "Counts", ""]} rows=${look.encoders.map((it, n) => [
        it.name, it.pins, number(it.turned),
        html`<button type="button" onClick=${() => press([{ encoder: n }, "mark"])}
          aria-label=${`Count ${it.name} from here`}>From here</button>`])} />
      <${Table} caption="Inputs" head=${["Name", "Pins", "Level"]} rows=${look.inputs.map((it) => [
        it.name, it.pins, it.level === null ? "?" : it.level ? "high" : "low"])} />
    </div>
    <${Scale} look=${look} press=${press} />`;
}

/** The buttons of a motor. */
function Jog({ n, motor, press }) {
  const select = { motor: n };
  return html`<span class="row">
    <${HoldButton} label=${`Jog ${motor.name} minus`} shown="−" select=${select} way="minus" press=${press} />
    <${HoldButton} label=${`Jog ${motor.name} plus`} shown="+" select=${select} way="plus" press=${press} />
    <button type="button" onClick=${() => press([select, "distance"])}
      aria-label=${`${motor.name}: another distance than ${motor.distance} steps`}>${motor.distance} steps</button>
    <button type="button" onClick=${() => press([select, "slower"])}
      aria-label=${`${motor.name} slower than ${motor.speed} steps/s`}>slower</button>
    <button type="button" onClick=${() => press([select, "faster"])}
      aria-label=${`${motor.name} faster than ${motor.speed} steps/s`}>faster</button>
    <span>${motor.speed}/s</span>
    <button type="button" onClick=${() => press([select, "mark"])}
      aria-label=${`Count ${motor.name} from here`}>From here</button></span>`;
}

/** Moves while it is held, by a pointer or by the space bar. */
function HoldButton({ label, shown, select, way, press }) {
  const timer = useRef();
  const end = () => {
    if (!timer.current) return;
    clearInterval(timer.current);
    timer.current = undefined;
    press(["released"]);
  };
  const begin = () => {
    if (timer.current) return;
    press([select, way]);
    timer.current = setInterval(() => press([way], true), REPEAT_MS);
  };
  useEffect(() => end, []);
  const pointed = (event) => {
    if (event.button !== 0) return;
    event.target.setPointerCapture(event.pointerId);
    begin();
  };
  const isKey = (event) => event.key === " " || event.key === "Enter";
  const pressed = (event) => {
    if (!isKey(event)) return;
    event.preventDefault();
    if (!event.repeat) begin();
  };
  return html`<button type="button" class="jog" aria-label=${label} onPointerDown=${pointed}
    onPointerUp=${end} onPointerCancel=${end} onLostPointerCapture=${end} onBlur=${end}
    onKeyDown=${pressed} onKeyUp=${(event) => isKey(event) && end()}>${shown}</button>`;
}

/** "I measured 9.8 mm." */
function Scale({ look, press }) {
  const [motor, setMotor] = useState(0);
  const take = (event) => {
    event.preventDefault();
    const measured = new FormData(event.target).get("measured");
    press([{ motor: Number(motor) }, { measured }]);
  };
  if (!look.motors.length) return null;
  return html`<form class="row" onSubmit=${take}>
    <label class="field"><span>Motor</span><select value=${motor}
      onChange=${(event) => setMotor(event.target.value)}>
      ${look.motors.map((it, n) => html`<option value=${n}>${it.name}</option>`)}</select></label>
    <label class="field"><span>What it has gone since From here, measured</span>
      <input name="measured" inputmode="decimal" required /></label>
    <button>Make its scale</button>
    ${look.found && html`<output>${look.found}</output>`}
  </form>`;
}
