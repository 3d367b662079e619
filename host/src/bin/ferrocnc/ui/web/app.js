// The pages and the way between them: the part of the address behind # is page/board.

import { html, render, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import { Bench } from "./bench.js";
import { Boards } from "./boards.js";
import { Configurator } from "./configurator.js";
import { Dashboard } from "./dashboard.js";
import { Doctor } from "./doctor.js";
import { Jobs } from "./jobs.js";
import { Machine } from "./machine.js";

const PAGES = {
  boards: ["Boards", Boards],
  dashboard: ["Dashboard", Dashboard],
  configurator: ["Configurator", Configurator],
  machine: ["Machine", Machine],
  jobs: ["Jobs", Jobs],
  bench: ["Bench", Bench],
  doctor: ["Doctor", Doctor],
};

/** Pages of files. */
const WITHOUT_BOARD = ["configurator", "machine"];

function where() {
  const [page, ...board] = location.hash.slice(1).split("/");
  return { page: Object.hasOwn(PAGES, page) ? page : "boards", board: board.join("/") };
}

function App() {
  const [at, setAt] = useState(where());
  const main = useRef();
  useEffect(() => {
    const moved = () => {
      setAt(where());
      main.current.focus();
    };
    addEventListener("hashchange", moved);
    return () => removeEventListener("hashchange", moved);
  }, []);
  const [title, Page] = PAGES[at.page];
  useEffect(() => {
    document.title = `${title} ${at.board} - FerroCNC`;
  }, [title, at.board]);
  const skip = (event) => {
    event.preventDefault();
    main.current.focus();
  };
  return html`
    <a class="skip" href="#content" onClick=${skip}>To the content</a>
    <header>
      <strong>FerroCNC</strong>
      <nav aria-label="Pages">${Object.entries(PAGES).map(([name, [shown]]) => html`
        <a href=${link(name, at.board)} aria-current=${name === at.page ? "page" : undefined}>
          ${shown}</a>`)}</nav>
    </header>
    <main ref=${main} tabindex="-1" id="content">
      <h1>${title}</h1>
      <${Page} key=${at.page} board=${at.board} />
    </main>`;
}

/** The board stays the same from page to page, where a page has one. */
function link(page, board) {
  return board && !WITHOUT_BOARD.includes(page) ? `#${page}/${board}` : `#${page}`;
}

render(html`<${App} />`, document.body);
