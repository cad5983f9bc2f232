// Chains as they are strung: a master, then its modules in order, each with its gauges.

import { ask } from "./ask.js";
import { breakable, byId, el, keyed, say, twice } from "./dom.js";

const shares = { warm: 1, hot: 1 }; // of a limit: as the server tells it
const HELD = new Map(); // module -> until when its LED blinks

export function showChains({ chains, temperature_limit_degc, warm, hot }) {
  Object.assign(shares, { warm, hot });
  keyed(byId("chains"), chains, (chain) => chain.chain, makeChain, (element, chain) => {
    keyed(element.querySelector("ol"), [null, ...chain.modules],
      (module) => (module ? `${module.serial}/${module.name}` : "master"),
      (module) => (module ? makeModule(chain.chain, module, temperature_limit_degc) : makeMaster(chain)),
      (item, module) => module && fillModule(item, module));
  });
}

function makeChain(chain) {
  return el("div", { class: "chain" },
    el("h3", {}, `chain ${chain.chain} `, el("span", { class: "pill" }, "no readings yet")),
    el("ol", { "aria-label": `modules of chain ${chain.chain}, in order` }));
}

function makeMaster(chain) {
  return el("li", { class: "master" }, el("span", {}, `driver-${chain.chain}`, el("br"), el("span", { class: "faint" }, chain.link)));
}

function makeModule(chain, module, limit_degc) {
  const name = module.name || "(new)";
  const card = el("div", { class: "module" },
    el("div", { class: "head" }, el("h4", {}, ...breakable(name)), el("span", { class: "state" })),
    el("p", { class: "facts numbers", title: "errors: answers that were missing or garbled" }), el("p", { class: "facts serial" }, `serial ${module.serial}`), el("p", { class: "facts bad problem", hidden: true }));
  if (module.kind === "muscle") {
    card.append(gauge("tension", `tension of ${name}`), gauge("temperature", `temperature of ${name}`));
    card.dataset.limitDegc = limit_degc;
  }
  const led = el("span", { class: "led", "aria-hidden": "true" });
  const identify = el("button", { type: "button", class: "small asks", "aria-label": `Identify ${name}: blink its LED`, disabled: !module.name,
    click: () => ask("identify", { chain, module: module.name }, `Identify ${name}`) }, led, " Identify");
  const row = el("div", { class: "row" }, identify);
  if (module.kind === "muscle") {
    const unplug = el("button", { type: "button", class: "small asks unplug" }, "Unplug");
    unplug.setAttribute("aria-label", `Unplug ${name}`);
    row.append(twice(unplug, () => ask("unplug", { muscle: module.name }, `Unplug ${name}`)));
  }
  card.append(row);
  return el("li", { "data-muscle": name }, card);
}

function fillModule(item, module) {
  item.dataset.state = module.state;
  const state = item.querySelector(".state");
  state.className = `state ${module.standing ? "outside" : module.state}`;
  say(state, module.standing || module.state);
  const errors = module.link_errors ? `${module.link_errors} error${module.link_errors === 1 ? "" : "s"}` : "";
  say(item.querySelector(".numbers"), [module.kind, `id ${module.module_id}`, errors].filter(Boolean).join(" · "));
  const problem = item.querySelector(".problem");
  problem.hidden = !module.fault;
  say(problem, module.fault);
  item.dataset.limitN = module.tension_limit_n;
}

function gauge(quantity, label) {
  return el("div", { class: `gauge ${quantity}` },
    el("span", {}, quantity), el("span", { class: "value" }, "–"),
    el("div", { role: "meter", "aria-label": label, "aria-valuemin": "0", "aria-valuemax": "1", "aria-valuenow": "0" }, el("i")));
}

function setGauge(item, quantity, value, limit, unit) {
  const place = item.querySelector(`.gauge.${quantity}`);
  if (!place) return;
  const now = Math.min(limit, Math.max(0, value ?? 0));
  const share = now / limit;
  const meter = place.querySelector("[role=meter]");
  meter.setAttribute("aria-valuemax", limit);
  meter.setAttribute("aria-valuenow", now);
  meter.setAttribute("aria-valuetext", value == null ? "no reading" : `${value} of ${limit} ${unit}`);
  const bar = meter.firstElementChild;
  bar.style.setProperty("--level", share);
  bar.className = share > shares.hot ? "bad" : share > shares.warm ? "amber" : "";
  say(place.querySelector(".value"), value == null ? "–" : `${value.toFixed(1)} of ${limit.toFixed(0)} ${unit}`);
}

export function showReadings(chains) {
  for (const [name, chain] of Object.entries(chains)) {
    const element = byId("chains").querySelector(`[data-key="${CSS.escape(name)}"]`);
    if (!element) continue;
    const pill = element.querySelector(".pill");
    const words = chain.silent ? "silent" : chain.mode;
    say(pill, words);
    pill.className = `pill ${["silent", "stopping", "stopped"].includes(words) ? "bad" : ""}`;
    for (const item of element.querySelectorAll("[data-muscle]")) {
      const [tension_n, temperature_degc] = chain.muscles[item.dataset.muscle] ?? [];
      setGauge(item, "tension", tension_n, Number(item.dataset.limitN), "N");
      setGauge(item, "temperature", temperature_degc, Number(item.firstElementChild.dataset.limitDegc), "°C");
    }
  }
}

/** All who watch see which LED blinks: its driver tells it by an event. */
export function showBlinking(events, time_s) {
  for (const event of events) {
    if (event.kind === "identify" && time_s - event.time_s < 5) HELD.set(event.muscle, event.time_s + 5);
  }
  for (const item of byId("chains").querySelectorAll("[data-muscle]")) {
    item.querySelector(".led").classList.toggle("on", (HELD.get(item.dataset.muscle) ?? 0) > time_s);
  }
}
