// What a person asks of the robot.

import { ask, show } from "./ask.js";
import { byId, el, keyed, say } from "./dom.js";

const METHODS = {
  i: "(i) new motions alone",
  ii: "(ii) with replay of the old",
  iii: "(iii) with fading replay",
  iv: "(iv) by wires",
};
let stopped = false;
let running = "";
let joints = [];
let muscles = [];
let simulated = true;
const touched = new Set();

export function setUp() {
  byId("reset").addEventListener("click", () => ask("reset", {}, "Reset"));
  byId("reach").addEventListener("submit", reach);
  byId("as-it-is").addEventListener("click", () => touched.clear());
  byId("plug").addEventListener("submit", (event) => {
    event.preventDefault();
    const muscle = byId("spare").value;
    if (muscle) ask("plug", { muscle }, `Plug ${muscle}`);
  });
  byId("relearn").addEventListener("submit", (event) => {
    event.preventDefault();
    const n_new = Number(byId("n-new").value);
    ask("relearn", { method: byId("method").value, n_new }, "Relearn");
  });
}

export function showRobot(robot) {
  joints = robot.joints;
  muscles = robot.muscles;
  simulated = robot.simulated;
  document.body.classList.toggle("real", !simulated);
  const tasks = [...robot.tasks.map((task) => [task.name, `${task.name} (${task.targets})`]), ["park", "park"], ["hold", "hold"]];
  keyed(byId("tasks"), tasks, ([name]) => name,
    ([name]) => el("button", { type: "button", click: () => ask("task", { name }, `Task ${name}`) }),
    (button, [, words]) => say(button, words));
  showStopped(stopped);
  showTask(running);
  keyed(byId("joints"), joints, (joint) => joint.name, makeJoint, () => {});
  keyed(byId("method"), robot.methods, (name) => name,
    (name) => el("option", { value: name, selected: name === robot.growth.method }, METHODS[name] ?? name), () => {});
  if (!byId("n-new").value) byId("n-new").value = robot.growth.n_new;
}

/** After a stop nothing is moved before it is cleared; the robot would refuse, and why is said. */
export function showStopped(now) {
  stopped = now;
  byId("stopped-note").hidden = !now;
  for (const button of document.querySelectorAll("#tasks button, #reach button, #relearn button")) {
    button.disabled = now;
    if (now) button.setAttribute("aria-describedby", "stopped-note");
    else button.removeAttribute("aria-describedby");
  }
}

/** Which of the tasks runs now; "" if none does. */
export function showTask(name) {
  running = name;
  for (const button of byId("tasks").children) {
    const current = button.dataset.key === name;
    button.classList.toggle("main", current);
    button.setAttribute("aria-pressed", String(current));
  }
}

/** What can be plugged in: spares, and muscles that were taken off. On a real robot hands do it. */
export function showSpares(chains) {
  const heard = new Set(chains.filter((chain) => chain.modules.length).map((chain) => chain.chain));
  const plugged = new Set(chains.flatMap((chain) =>
    chain.modules.filter((module) => module.state !== "lost").map((module) => module.name)));
  const free = simulated ? muscles.filter((muscle) => heard.has(muscle.chain) && !plugged.has(muscle.name)) : [];
  keyed(byId("spare"), free, (muscle) => muscle.name,
    (muscle) => el("option", { value: muscle.name }, `${muscle.name} on ${muscle.chain}`), () => {});
  byId("plug").querySelector(".row").hidden = free.length === 0;
  const none = simulated ? "Every muscle is plugged in." : "Plug and unplug modules by hand: the robot notices.";
  say(byId("plug-note"), free.length ? "" : none);
}

function makeJoint(joint) {
  const attributes = { min: joint.low_deg, max: joint.high_deg, value: joint.rest_deg };
  const slider = el("input", { type: "range", step: "0.5", id: `joint-${joint.name}`, ...attributes });
  const number = el("input", { type: "number", step: "any", "aria-label": `${joint.name}, degrees`, required: true, ...attributes });
  const touch = (from, to) => () => {
    touched.add(joint.name);
    to.value = from.value;
  };
  slider.addEventListener("input", touch(slider, number));
  number.addEventListener("input", touch(number, slider));
  const ends = el("div", { class: "ends", "aria-hidden": "true" },
    el("span", {}, `${joint.low_deg.toFixed(0)}°`), el("span", {}, `${joint.high_deg.toFixed(0)}°`));
  const names = el("div", { class: "names" }, el("label", { for: slider.id }, joint.name), el("span", { class: "now" }));
  return el("div", { class: "joint" }, names, el("div", {}, slider, ends), number);
}

export function showAngles(angles) {
  for (const joint of joints) {
    const row = byId("joints").querySelector(`[data-key="${CSS.escape(joint.name)}"]`);
    const now = angles[joint.name];
    if (!row || !now) continue;
    const parts = [];
    if (now.measured_deg != null) parts.push(`measured ${now.measured_deg.toFixed(1)}°`);
    if (now.estimated_deg != null) {
      const give = now.confidence_deg != null ? ` ± ${now.confidence_deg.toFixed(1)}°` : "";
      parts.push(`by its muscles ${now.estimated_deg.toFixed(1)}°${give}`);
    }
    if (now.reference_deg != null) parts.push(`wanted ${now.reference_deg.toFixed(1)}°`);
    say(row.querySelector(".now"), parts.join(" · "));
    const where = now.reference_deg ?? now.measured_deg;
    if (!touched.has(joint.name) && where != null && !row.contains(document.activeElement)) {
      for (const input of row.querySelectorAll("input")) input.value = where.toFixed(1);
    }
  }
}

async function reach(event) {
  event.preventDefault();
  const angle_rad = {};
  for (const joint of joints) {
    if (!touched.has(joint.name)) continue;
    const row = byId("joints").querySelector(`[data-key="${CSS.escape(joint.name)}"]`);
    angle_rad[joint.name] = (Number(row.querySelector("[type=number]").value) * Math.PI) / 180;
  }
  if (!touched.size) {
    show("Reach", "Nothing was asked for: move a slider, or type an angle.", "bad");
    return;
  }
  const answer = await ask("reach", { angle_rad }, "Reach");
  if (answer.ok) touched.clear();
}
