// The card as it lies on the bench: its headers from above, with what is on every pin. The data
// are those of `ferrocnc config pinout --json`.

import { html, useRef, useState } from "./vendor/preact-htm.js";
import { isMovable, named } from "./moves.js";

/** Pins beside each other, and how far an arrow key goes. */
const STEPS = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -2, ArrowDown: 2 };

/** What is dragged, for other pins only. */
const KIND = "application/x-ferrocnc-pin";

/**
 * `chosen` is the pin that was pointed at, `choose` gets another one. `move`, if given, gets two pins:
 * the first was dragged onto the second.
 */
export function Card({ drawing, old, chosen, choose, move }) {
  return html`<div class=${`card ${old ? "old" : ""}`}>
    <p class="legend">${drawing.uses.map((use) => html`
      <span><i class=${`dot ${use.use}`} aria-hidden="true">${use.letter}</i> ${use.title}</span>`)}
      <span>dashed: the same line on every header</span></p>
    <div class="headers">${drawing.headers.map((header) => html`
      <${Header} header=${header} chosen=${chosen} choose=${choose} move=${move} />`)}</div>
    <p>KEY (button): <b>${drawing.key.label || "free"}</b></p>
  </div>`;
}

/** Sixteen pins; one of them is reached by Tab, the others from it by arrow keys. */
function Header({ header, chosen, choose, move }) {
  const [at, setAt] = useState(0);
  const pins = useRef();
  const moved = (event) => {
    const to = at + (STEPS[event.key] ?? 0);
    if (to === at || to < 0 || to >= header.pins.length) return;
    event.preventDefault();
    setAt(to);
    pins.current.children[to].focus();
  };
  const title = `${header.name.toUpperCase()}, ${header.modified || "as sold: 5 V outputs"}`;
  return html`<section class="header" aria-label=${title}>
    <h3>${header.name.toUpperCase()} <small>${header.modified || "as sold"}</small></h3>
    <div class="pins" role="group" aria-label=${`pins of ${header.name}`} ref=${pins} onKeyDown=${moved}>
      ${header.pins.map((pin, n) => html`<button type="button" tabindex=${n === at ? 0 : -1}
        class=${`pin ${pin.shared ? "shared" : ""} ${n % 2 ? "right" : "left"}`}
        ...${dragged(pin, move)} aria-pressed=${chosen?.pin === pin.pin} aria-label=${spoken(pin)} title=${spoken(pin)}
        onFocus=${() => setAt(n)} onClick=${() => choose(pin)}>
        <span class=${pin.same_as ? "echo" : ""}>${shown(pin)}</span>
        <i class=${`dot ${pin.use} ${pin.same_as ? "pale" : ""} ${n ? "" : "first"}`}
          data-letter=${pin.letter} aria-hidden="true" />
      </button>`)}
    </div>
  </section>`;
}

/** A pin with something on it can be dragged, and dropped on every pin that is no ground. */
function dragged(pin, move) {
  if (!move || !isMovable(pin)) return {};
  const isOurs = (event) => event.dataTransfer.types.includes(KIND);
  return {
    draggable: pin.use !== "free",
    onDragStart: (event) => event.dataTransfer.setData(KIND, named(pin)),
    onDragOver: (event) => {
      if (!isOurs(event)) return;
      event.preventDefault();
      event.stopPropagation();
    },
    onDrop: (event) => {
      if (!isOurs(event)) return;
      event.preventDefault();
      event.stopPropagation();
      const from = event.dataTransfer.getData(KIND);
      if (from !== named(pin)) move(from, named(pin));
    },
  };
}

function shown(pin) {
  if (pin.use === "ground") return "GND";
  return pin.label || pin.panel;
}

/** As a screen reader says it, and as the line below the card has it. */
export function spoken(pin) {
  const place = `${pin.pin}, pin ${pin.number}`;
  const same = pin.same_as ? `, the same line as ${pin.same_as}` : "";
  const copy = pin.copy ? " (a 5 V copy of what is read there)" : "";
  // What the pin shows is part of its name.
  const label = pin.label || (pin.use === "ground" ? "GND" : (pin.panel ? `nothing on ${pin.panel}` : "nothing"));
  return `${place}: ${label}, ${pin.title}${same}${copy}`;
}
