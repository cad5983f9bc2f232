// Requests to the robot, and what was really answered.

import { byId, el } from "./dom.js";

export const BY_COMMAND = `myograft estop ${document.body.dataset.robot}`; // when this page cannot
const SHOWN_MS = { good: 7000, bad: 20000 };
const MOST = 4;
let others = new AbortController(); // of all requests but a stop

/** Put a request; its answer is shown. Gives {ok, text}. */
export async function ask(name, message, title) {
  const answer = await put(name, message);
  show(title, answer.text, answer.ok ? "good" : "bad");
  return answer;
}

/** A stop waits for no other request: a browser has few connections to one server. */
async function put(name, message) {
  const patience = AbortSignal.timeout(15000);
  if (name === "estop") {
    others.abort();
    others = new AbortController();
  }
  const given = others.signal;
  let response;
  try {
    response = await fetch(`/api/request/${name}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(message),
      signal: name === "estop" ? patience : AbortSignal.any([patience, given]),
    });
  } catch {
    if (given.aborted && name !== "estop") return { ok: false, text: "Given up for the stop: perhaps it was done, perhaps not." };
    const advice = name === "estop" ? ` Stop the robot by hand, or by: ${BY_COMMAND}` : "";
    return { ok: false, text: `NO ANSWER from the page's server: perhaps it was done, perhaps not.${advice}` };
  }
  try {
    return await response.json();
  } catch {
    return { ok: false, text: `the page's server answered ${response.status}, and nothing to read` };
  }
}

/** Show an answer for a while. */
export function show(title, text, kind) {
  const answers = byId("answers");
  const close = el("button", { type: "button", class: "small", "aria-label": "Dismiss", click: () => answer.remove() }, "×");
  const answer = el("div", { class: `answer ${kind}`, role: kind === "bad" ? "alert" : "status" },
    el("strong", {}, title), close, el("span", {}, text));
  if (kind === "good") for (const old of answers.querySelectorAll(".good")) old.remove(); // it must not cover much
  answers.append(answer);
  while (answers.children.length > MOST) answers.firstElementChild.remove();
  setTimeout(() => answer.remove(), SHOWN_MS[kind]);
}
