// Tables and pictures of one experiment, and what the robot does meanwhile.

import { byId, el, say } from "./dom.js";
import { listen } from "./feed.js";

async function get(address) {
  const response = await fetch(address);
  if (response.status === 401) location.reload(); // and be led to where the token is asked for
  const body = await response.json();
  if (!response.ok) throw new Error(body.text);
  return body;
}

function makeTable({ title, head, rows }) {
  return el("section", {}, el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": title },
    el("table", {}, el("caption", {}, title),
      el("thead", {}, el("tr", {}, ...head.map((cell, i) =>
        i || cell ? el("th", { scope: "col", class: i ? "n" : "" }, cell) : el("td", {})))),
      el("tbody", {}, ...rows.map(([first, ...rest]) =>
        el("tr", {}, el("th", { scope: "row" }, first), ...rest.map((cell) => el("td", { class: "n" }, cell))))))));
}

const counted = (list, index) => list.length && `${list.length} ${["table", "picture"][index]}${list.length === 1 ? "" : "s"}`;

async function show(name) {
  const found = await get(`/api/results/${encodeURIComponent(name)}`);
  const where = `/api/results/${encodeURIComponent(name)}`;
  byId("pictures").replaceChildren(...found.pictures.map((file) =>
    el("img", { src: `${where}/${encodeURIComponent(file)}`, alt: `${file.replace(/\.\w+$/, "")}: a plot of the tables below`, loading: "lazy" })));
  byId("tables").replaceChildren(...found.tables.map(makeTable));
  say(byId("note"), found.problem ?? [found.tables, found.pictures].map(counted).filter(Boolean).join(", "));
  document.title = `${found.title} - myograft`;
}

const tell = (error) => say(byId("note"), `The results cannot be read: ${error.message}`);
const which = byId("which");
which.addEventListener("change", () => {
  location.hash = which.value;
});
const follow = () => {
  const name = decodeURIComponent(location.hash.slice(1)) || which.value;
  if (!name) return;
  which.value = name;
  show(name).catch(tell);
};
window.addEventListener("hashchange", follow);
get("/api/results").then((list) => {
  which.replaceChildren(...list.map(({ name, title }) => el("option", { value: name }, title)));
  if (list.length) follow();
  else say(byId("note"), "There are no results yet: python -m experiments elbow --quick makes some.");
}).catch(tell);

function showStage(words, kind) {
  say(byId("stage"), `${document.body.dataset.robot}: ${words}`);
  byId("stage").className = `pill ${kind}`;
}
listen({ executive: ({ stage }) => showStage(stage, stage === "stopped" ? "bad" : "") },
  (lost) => lost && showStage("no connection", "bad"));
