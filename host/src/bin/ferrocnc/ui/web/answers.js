// Asks the server, which answers as the command of the same name does with --json. All addresses
// are relative: the token is in the address of the page.

const GONE = "`ferrocnc ui` does not answer; start it again and open the address that it prints";

/** The JSON of a GET, or an error with the reason of the refusal. */
export async function ask(command, query = {}) {
  return (await sent(command, query)).json();
}

/** The JSON of a POST. */
export async function tell(command, body) {
  return (await sent(command, {}, post(body))).json();
}

/** The text of a POST. */
export async function text(command, body) {
  return (await sent(command, {}, post(body))).text();
}

/** A POST whose answer comes in lines of JSON, while it is worked on. */
export async function send(command, query, body, line) {
  const headers = { "Content-Type": "application/octet-stream" };
  const response = await sent(command, query, { method: "POST", headers, body });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    // Cut off is an end, too: the last line is missing.
    const { value, done } = await reader.read().catch(() => ({ done: true }));
    if (done) return;
    const lines = (text + value).split("\n");
    text = lines.pop();
    for (const it of lines) line(JSON.parse(it));
  }
}

function post(body) {
  const headers = { "Content-Type": "application/json" };
  return { method: "POST", headers, body: JSON.stringify(body) };
}

async function sent(command, query, options) {
  let response;
  try {
    response = await fetch(address(command, query), options);
  } catch {
    throw new Error(GONE);
  }
  if (!response.ok) {
    const said = await response.text();
    throw new Error(reason(said) || `the server answers ${response.status}`);
  }
  return response;
}

function reason(said) {
  try {
    return JSON.parse(said).error;
  } catch {
    return said;
  }
}

function address(command, query) {
  const given = Object.entries(query).filter(([, value]) => value !== "" && value != null);
  const search = new URLSearchParams(given).toString();
  return `api/${command}${search && "?"}${search}`;
}

/**
 * Listens to a command that goes on, while the page is seen: a hidden tab asks no board.
 * `begun` is told that the command begins (again), `line`, `note` and `away` get what the server
 * sends. Ends when the function returned is called.
 */
export function listen(command, query, { begun, line, note, away }) {
  let source;
  const open = () => {
    source = new EventSource(address(command, query));
    const on = (kind, take) =>
      source.addEventListener(kind, (event) => take?.(JSON.parse(event.data)));
    source.onopen = () => begun?.();
    on("line", line);
    on("note", (said) => note?.(said.note));
    on("away", (said) => away(said.error));
    source.onerror = () => {
      away(GONE);
      // Refused, not interrupted: the browser would not try again.
      if (source.readyState === EventSource.CLOSED) again = setTimeout(open, 1000);
    };
  };
  let again;
  const close = () => {
    clearTimeout(again);
    source?.close();
  };
  const seen = () => (document.hidden ? close() : open());
  document.addEventListener("visibilitychange", seen);
  if (!document.hidden) open();
  return () => {
    document.removeEventListener("visibilitychange", seen);
    close();
  };
}
