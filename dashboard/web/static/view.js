// Rerun's own viewer beside the controls. It does not find its stream again after viz or the
// page's server was restarted, so its frame is made anew then.

import { byId, el, say } from "./dom.js";
import { onKey } from "./stop.js";

const KEPT = "myograft.view";
const WIDE_PX = 960;
const HIDDEN_MS = 60000; // after which a page that nobody sees lets go of the viewer's connection
let viewer = null; // {there, number} as the server tells it
let wanted = null; // true | false: a person's word
let shown = ""; // what the frame is showing
let elsewhere = false; // another page of this browser has the view: each would keep a connection
const pages = new BroadcastChannel("myograft.view");
let away = false; // nobody has seen this page for a while

export function setUp() {
  wanted = { show: true, hide: false }[localStorage.getItem(KEPT)] ?? null;
  byId("view-toggle").addEventListener("click", () => {
    wanted = !isOpen();
    elsewhere = false;
    localStorage.setItem(KEPT, wanted ? "show" : "hide");
    draw();
  });
  pages.onmessage = () => {
    elsewhere = true;
    draw();
  };
  let hiding = 0;
  document.addEventListener("visibilitychange", () => {
    clearTimeout(hiding);
    const leave = (now) => {
      away = now;
      draw();
    };
    if (document.hidden) hiding = setTimeout(() => leave(true), HIDDEN_MS);
    else leave(false);
  });
  draw();
}

export function showViewer(now) {
  viewer = now;
  draw();
}

/** The server was away, and with it the viewer's stream. */
export function again() {
  shown = "";
  draw();
}

const isOpen = () => Boolean(viewer?.there) && !away && !elsewhere && (wanted ?? (window.innerWidth >= WIDE_PX && hasGraphics()));

function draw() {
  const open = isOpen();
  const button = byId("view-toggle");
  button.setAttribute("aria-pressed", String(open));
  say(button, open ? "Hide" : "Show");
  button.disabled = !viewer?.there;
  byId("view").classList.toggle("open", open);
  const what = open ? String(viewer.number) : "";
  if (what !== shown) {
    byId("view").querySelector("iframe")?.remove();
    if (open) {
      byId("view").append(frame());
      pages.postMessage("opened");
    }
    shown = what;
  }
  byId("view-note").hidden = open;
  byId("view-keys").hidden = !open;
  say(byId("view-note"), note());
}

function note() {
  if (viewer?.number && !viewer.there) return `The picture is drawn on ${viewer.host}, for that host alone: open it there by myograft view.`;
  if (!viewer?.there) return "The process viz has not said yet where its picture is.";
  if (elsewhere) return "Another window of this browser has the view. Show brings it here.";
  if (wanted === false) return "Hidden. Plots, lanes and the moving body are one press away.";
  return hasGraphics()
    ? "Show plots, lanes and the moving body: the viewer is loaded once, 43 MB."
    : "This browser draws without a graphics card: the view would lag behind. On a computer that has one: myograft view";
}

function frame() {
  const port = location.port || (location.protocol === "https:" ? "443" : "80");
  const stream = `rerun+${location.protocol}//${location.hostname}:${port}/proxy`;
  const theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  const query = new URLSearchParams({ url: stream, hide_welcome_screen: "", persist: "false", theme });
  // Not reached by Tab, which the viewer would keep to itself.
  const iframe = el("iframe", { src: `/viewer/?${query}`, title: "Live view by Rerun", allow: "fullscreen", tabindex: "-1" });
  iframe.addEventListener("load", () => iframe.contentWindow.addEventListener("keydown", onFrameKey, true));
  return iframe;
}

/** Escape stops the arm from inside the viewer, too; F6 is the way out of it. */
function onFrameKey(event) {
  onKey(event);
  if (event.key !== "F6") return;
  event.preventDefault();
  byId("controls-title").focus();
}

let graphics = null;
function hasGraphics() {
  if (graphics !== null) return graphics;
  const gl = document.createElement("canvas").getContext("webgl2");
  const about = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return (graphics = Boolean(gl) && !/swiftshader|llvmpipe|software/i.test(name));
}
