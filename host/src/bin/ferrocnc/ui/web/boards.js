// Boards: `ferrocnc discover` and `ferrocnc describe`, and what changes one of them.

import { html, useRef, useState } from "./vendor/preact-htm.js";
import { ask } from "./answers.js";
import { Keys } from "./keys.js";
import { Facts, Field, number, Problem, Table, useAnswer, WhichBoard } from "./parts.js";
import { Settings } from "./settings.js";
import { Update } from "./update.js";

/** After a board was told to restart. */
const RESTART_MS = 500;

const CLASSES = ["stepgen", "encoder", "pwm", "input", "output"];

export function Boards({ board }) {
  return html`
    <${Discover} />
    <section aria-labelledby="one-board">
      <h2 id="one-board">One board</h2>
      <${WhichBoard} page="boards" board=${board} />
      ${board && html`<${Describe} key=${board} board=${board} />`}
    </section>`;
}

function Discover() {
  const [at, setAt] = useState("");
  const [query, setQuery] = useState({ at: "", turn: 0 });
  const { busy, value, error } = useAnswer(() => ask("discover", { at: query.at }), query.turn);
  const look = (event) => {
    event.preventDefault();
    setQuery({ at: at.trim(), turn: query.turn + 1 });
  };
  const rows = (value?.boards ?? []).map((found) => {
    const address = `${found.ip}:${found.port}`;
    return [
      found.name || "unnamed",
      html`<a href=${`#dashboard/${address}`}>${address}</a>`,
      found.platform,
      found.configuration,
      found.running,
      found.link_mbit ? `${found.link_mbit} Mbit/s` : "down",
      found.armed ? "armed" : found.owned ? "driven" : "idle",
      found.uid,
      html`<a href=${`#boards/${address}`}>describe<span class="unseen"> ${address}</span></a>`,
    ];
  });
  const head = ["Name", "Address", "Board", "Configuration", "Runs", "Link", "State", "Unique id", ""];
  return html`<section aria-labelledby="found">
    <h2 id="found">On this network</h2>
    <form class="row" onSubmit=${look}>
      <${Field} label="Ask at this address only" value=${at} placeholder="everywhere"
        onInput=${(event) => setAt(event.target.value)} />
      <button disabled=${busy}>Look again</button>
    </form>
    <p role="status">${busy ? "Asking …" : value && count(value.boards.length)}</p>
    <${Problem} error=${error} />
    <${Table} caption="Boards that answer" head=${head} rows=${rows} />
  </section>`;
}

function count(boards) {
  if (boards) return boards === 1 ? "1 board answers" : `${boards} boards answer`;
  return "No board answers. Check power and cable (the port beside the power connector first), and \
whether a firewall lets UDP broadcasts in.";
}

function Describe({ board }) {
  const [turn, setTurn] = useState(0);
  const { value: now, error } = useAnswer(() => ask("describe", { board }), `${board} ${turn}`);
  // What it said last stays while it restarts.
  const last = useRef();
  last.current = now ?? last.current;
  const value = last.current;
  const again = () => setTimeout(() => setTurn((turn) => turn + 1), RESTART_MS);
  const problem = error && html`<${Problem} error=${error} />
    <p><button type="button" onClick=${() => setTurn(turn + 1)}>Ask again</button></p>`;
  if (!value) return problem ||  html`<p role="status">Asking ${board} …</p>`;
  const { settings, link, flash } = value;
  const rows = (kind) => value[kind].map(({ name, pins }, n) => [n, name, pins]);
  return html`
    ${problem}
    ${settings && html`<${Settings} board=${board}
      settings=${settings} again=${again} />`}
    <${Keys} board=${board} again=${again} />
    <${Update} board=${board} again=${again}
      running=${`${value.running}, build ${value.build_id}; at power-up ${value.selected ?? "golden"}`} />
    <${Facts} facts=${[
      ["Board", value.board],
      ["Configuration", value.configuration],
      ["FPGA", value.fpga],
      ["Firmware", value.firmware_version],
      ["Gateware", value.gateware_version],
      ["Wire", value.wire_version],
      ["Clock", `${value.clock_hz / 1e6} MHz`],
      ["State", value.state],
      ["Stopped last by", value.fault_reason],
      ["Started by", value.last_reset_reason],
      ["Services", value.services],
      ["Unique id", value.uid],
      ["Flash", flash.bytes && `${flash.bytes >> 20} MiB, JEDEC id ${flash.jedec}`],
      ["Runs", `${value.running}, build ${value.build_id}`],
      ["Settings", settings && address(settings)],
      ["Settings from", value.settings_origin],
      ["MAC", settings?.mac],
      ["Link", link.mbit ? `${link.mbit} Mbit/s, ${number(link.errors)} frames thrown away` : "down"],
    ]} />
    <div class="columns">${CLASSES.map((kind) => html`
      <${Table} caption=${kind} head=${["No", "Name", "Pins"]} rows=${rows(kind)} />`)}</div>`;
}

function address({ name, dhcp, ip, prefix, port }) {
  return `${name || "unnamed"}, ${dhcp ? "DHCP, else " : ""}${ip}/${prefix}, port ${port}`;
}
