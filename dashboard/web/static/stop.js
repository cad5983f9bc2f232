// The stop, on every page: its button, and Escape wherever the focus is.

import { ask } from "./ask.js";
import { byId } from "./dom.js";

function stop() {
  ask("estop", { reason: "asked for on the web page" }, "Stop");
}

export function onKey(event) {
  if (event.key !== "Escape" || event.repeat) return;
  event.preventDefault();
  stop();
}

byId("estop").addEventListener("click", stop);
document.addEventListener("keydown", onKey, true);
