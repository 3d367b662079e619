// Texts of files on a page: their lines, and a way out.

/** Selects a part of the text, and scrolls to it. */
export function show(area, at, length) {
  area.focus();
  area.setSelectionRange(at, at + length);
  const before = area.value.slice(0, at).split("\n").length;
  const height = area.scrollHeight / area.value.split("\n").length;
  area.scrollTop = Math.max(0, (before - 5) * height);
}

/** Where a line begins, and its length. */
export function lineOf(toml, number) {
  const lines = toml.split("\n");
  const at = lines.slice(0, number - 1).reduce((sum, line) => sum + line.length + 1, 0);
  return [at, (lines[number - 1] ?? "").length];
}

/** Lets the browser save it. */
export function download(name, content, kind) {
  const url = URL.createObjectURL(new Blob([content], { type: kind }));
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
