// A board's settings: `ferrocnc set`. Only what is another value than before is sent, and only after
// a question that lists it.

import { html, useEffect, useState } from "./vendor/preact-htm.js";
import { tell } from "./answers.js";
import { Asking, Field, Outcome, useDoing } from "./parts.js";

const NAMES = {
  name: "Name",
  ip: "Address/bits of the netmask",
  gateway: "Gateway",
  mac: "MAC",
  port: "Port for LinuxCNC",
  syslog: "Syslog server",
  sntp: "Time server",
};

/** What an empty field means. */
const EMPTY = { gateway: "0.0.0.0", syslog: "0.0.0.0", sntp: "0.0.0.0", mac: "auto" };

/** As the fields have them. */
function texts({ name, ip, prefix, gateway, mac, port, syslog, sntp, dhcp }) {
  const server = (it) => (!it || it === "0.0.0.0" ? "" : it);
  return {
    name, ip: `${ip}/${prefix}`, gateway: server(gateway), mac, port: String(port),
    syslog: server(syslog), sntp: server(sntp), dhcp,
  };
}

/** `settings` are those of `ferrocnc describe`; `again` looks at the board once more. */
export function Settings({ board, settings, again }) {
  const before = texts(settings);
  const [wanted, setWanted] = useState(before);
  useEffect(() => setWanted(before), [JSON.stringify(settings)]);
  const [state, run] = useDoing();
  const changed = Object.keys(NAMES).filter((key) => wanted[key].trim() !== before[key]);
  const dhcp = wanted.dhcp !== before.dhcp;
  const save = (change) => run(async () => {
    const told = await tell("set", { board, ...change });
    again();
    return told.text;
  });
  const change = () => {
    const change = Object.fromEntries(changed.map((key) => [key, wanted[key].trim() || EMPTY[key] || ""]));
    // An address given turns DHCP off.
    if (dhcp && wanted.dhcp) change.dhcp = true;
    if (dhcp && !wanted.dhcp) change.ip = wanted.ip;
    return change;
  };
  const put = (key, value) => setWanted({ ...wanted, [key]: value });
  const shown = (value) => value || "none";
  return html`<details>
    <summary>Settings</summary>
    <p>They are kept in the board's flash. It restarts with them, disarmed; a board that is armed or
      driven refuses.</p>
    <div class="row">${Object.entries(NAMES).map(([key, label]) => html`
      <${Field} label=${label} value=${wanted[key]} onInput=${(event) => put(key, event.target.value)} />`)}
      <label class="check"><input type="checkbox" checked=${wanted.dhcp}
        onChange=${(event) => put("dhcp", event.target.checked)} /> Ask a DHCP server</label>
    </div>
    <p class="row">
      <${Asking} label="Save settings" title="Save these settings?" yes="Save them" disabled=${!changed.length && !dhcp}
        act=${() => save(change())} question=${() => html`<ul>
          ${changed.map((key) => html`<li>${NAMES[key]}: <code>${shown(before[key])}</code> becomes${" "}
            <code>${shown(wanted[key].trim())}</code></li>`)}
          ${dhcp && html`<li>DHCP: ${wanted.dhcp ? "on; the address is what it falls back to" : "off"}</li>`}
        </ul><p>The board at ${board} restarts with them.</p>`} />
      <${Asking} label="Built-in settings" title="Forget all settings?" yes="Forget them"
        act=${() => save({ factory: true })}
        question=${() => html`<p>The board at ${board} erases its settings and restarts with those built
          into its image: perhaps at another address. Its key is erased, too.</p>`} />
    </p>
    <${Outcome} state=${state} />
  </details>`;
}
