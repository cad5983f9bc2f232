// The robot's page: sections of the server's stream into the document.

import { ask, BY_COMMAND } from "./ask.js";
import { showBlinking, showChains, showReadings } from "./chains.js";
import * as controls from "./controls.js";
import { byId, el, keyed, say, twice } from "./dom.js";
import { listen } from "./feed.js";
import * as view from "./view.js";

const LEVELS = { info: "", warning: "amber", error: "bad" };
let events = [];
let supervised = true;
let serverLost = true;
let wasLost = false;
let modes = {};
let run = ""; // of the robot, where it is recorded

const take = {
  robot(robot) {
    controls.showRobot(robot);
    view.showViewer(robot.viewer);
  },
  robots({ here, robots }) {
    keyed(byId("others"), robots.filter((robot) => robot.name !== here), (robot) => robot.name, (robot) => el("a", {}),
      (link, robot) => {
        say(link, robot.name);
        if (robot.address) link.href = there(robot.address);
        else link.removeAttribute("href");
        link.title = robot.address ? `the page of ${robot.name}` : `${robot.name} has no page`;
      });
  },
  processes(table) {
    if (run && table.run_dir && table.run_dir !== run) location.reload(); // what stands here is another robot's
    run ||= table.run_dir;
    supervised = table.supervised;
    showProcesses(table);
    alarm();
  },
  chains(section) {
    showChains(section);
    controls.showSpares(section.chains);
  },
  readings(now) {
    modes = Object.fromEntries(Object.entries(now.chains).map(([name, chain]) => [name, chain.silent ? "silent" : chain.mode]));
    showReadings(now.chains);
    controls.showAngles(now.joints);
    controls.showStopped(Object.values(modes).some((mode) => ["stopping", "stopped"].includes(mode)));
    showBlinking(events, now.time_s ?? 0);
    say(byId("clock"), now.time_s == null ? "" : `${now.time_s.toFixed(1)} s · ${now.real_time_factor ?? "–"} × real time`);
    alarm();
  },
  executive: showDoing,
  schema: showVersions,
  events(section) {
    events = section.events;
    keyed(byId("events"), events, (event) => `${event.time_s}/${event.process}/${event.text}`, makeEvent, () => {});
  },
};

/** Another robot's page, by the name under which we reach this host. */
function there(address) {
  const url = new URL(address);
  if (url.hostname === "localhost") url.hostname = location.hostname;
  return url.href;
}

function makeEvent(event) {
  const level = LEVELS[event.level] ?? "";
  const words = level ? el("span", { class: `level ${level}` }, `${event.level}: `) : "";
  return el("li", {}, el("time", {}, `${event.time_s.toFixed(1)} s`), el("span", {}, words, `${event.process}: ${event.text}`));
}

function showDoing(state) {
  say(byId("stage"), state.stage);
  byId("stage").className = `pill ${state.stage === "stopped" ? "bad" : state.stage === "waiting" ? "amber" : ""}`;
  controls.showTask(state.task || (state.stage === "hold" ? "hold" : ""));
  const training = state.training?.epochs ? state.training : null;
  const [done, of] = training ? [training.epoch, training.epochs] : [state.step ?? 0, state.steps ?? 0];
  byId("progress").hidden = !of;
  byId("progress").value = of ? done / of : 0;
  const what = state.growth ? state.growth : state.task ? `task ${state.task}` : "";
  const how = training ? `epoch ${done} of ${of}` : of ? `${done} of ${of}` : "";
  const rest = state.settled && state.stage === "hold" ? "settled" : "";
  const version = state.schema_version ? `schema ${state.schema_version}` : "no schema";
  say(byId("detail"), [what, how, rest, state.text, version].filter(Boolean).join(" · "));
}

function showProcesses(table) {
  keyed(byId("processes").tBodies[0], table.rows, (row) => row.process,
    (row) => el("tr", {}, el("th", { scope: "row" }, row.process),
      ...["state", "restarts", "tick_hz", "cpu_percent", "memory_mb", "dropped", "pid", "last_exit"].map((name) =>
        el("td", { "data-name": name, class: ["state", "last_exit"].includes(name) ? "" : "n" }))),
    (line, row) => {
      const units = { tick_hz: " Hz", cpu_percent: " %", memory_mb: " MB" };
      for (const cell of line.querySelectorAll("[data-name]")) {
        const value = row[cell.dataset.name];
        say(cell, value == null || value === "" ? "–" : `${value}${units[cell.dataset.name] ?? ""}`);
      }
      line.dataset.process = row.process;
      line.children[1].className = { ready: "good", failed: "bad", backoff: "bad" }[row.state] ?? "amber";
    });
  say(byId("run-dir"), table.run_dir ? `recorded in ${table.run_dir}` : "");
}

function showVersions({ rows }) {
  keyed(byId("schema").tBodies[0], rows, (row) => row.version,
    (row) => {
      const back = el("button", { type: "button", class: "small asks" }, "Roll back");
      back.setAttribute("aria-label", `Roll back to version ${row.version}`);
      twice(back, () => ask("schema", { action: "rollback", version: row.version }, `Version ${row.version}`));
      return el("tr", {}, el("th", { scope: "row" }, String(row.version)), ...Array.from({ length: 5 }, () => el("td")), el("td", {}, back));
    },
    (line, row) => {
      line.classList.toggle("active", row.active);
      const off = row.mean_mm == null ? "–" : `${row.mean_mm.toFixed(2)}, ${row.worst_mm.toFixed(2)} mm`;
      const trained = row.train_s != null ? `${row.train_s.toFixed(1)} s` : "–";
      const state = row.reason && row.state === "refused" ? `refused: ${row.reason}` : row.state;
      const texts = [row.active ? `in use (${state})` : state, row.method, String(row.muscles.length), off, trained];
      texts.forEach((text, index) => say(line.children[index + 1], text));
      line.children[3].title = row.muscles.join(", ");
      line.querySelector("button").hidden = row.active || !row.usable;
    });
}

/** What a person must not overlook, the worst first. */
function alarm() {
  const named = (mode) => Object.keys(modes).filter((name) => modes[name] === mode).join(", ");
  const all = [
    serverLost && ["bad", `The page's server does not answer. What stands here is old; trying again. To stop the robot: ${BY_COMMAND}`],
    !serverLost && !supervised && ["bad", "The robot is not running any more, or its supervisor has fallen silent. What stands here is old."],
    named("stopping") && ["bad", `Stopping: the wires of chain ${named("stopping")} pay out.`],
    named("stopped") && ["bad", `Stopped and latched: all wires of chain ${named("stopped")} are slack.`, "Reset: hold here"],
    !serverLost && named("silent") && ["amber", `Chain ${named("silent")} is silent: its readings are old.`],
  ].filter(Boolean);
  byId("reset").classList.toggle("main", Object.values(modes).includes("stopped"));
  keyed(byId("alarm"), all, ([, text]) => text, makeAlarm, () => {});
}

/** A line of the alarm; with words for it, also a reset. */
function makeAlarm([kind, text, words]) {
  const line = el("p", { class: kind }, text);
  if (words) line.append(el("button", { type: "button", class: "asks", click: () => ask("reset", {}, "Reset") }, words));
  return line;
}

controls.setUp();
view.setUp();
listen(take, (lost) => {
  serverLost = lost;
  document.body.classList.toggle("lost", lost);
  byId("controls").disabled = lost;
  for (const button of document.querySelectorAll(".asks")) button.disabled = lost;
  if (lost) say(byId("stage"), "no connection");
  else if (wasLost) view.again();
  wasLost = lost;
  alarm();
});
