// The server's sections as they come, and whether they still do.

const SILENT_MS = 6000; // longer than the stream's own patience: then nobody is at the other end
const HIDDEN_MS = 5000;

/** Call take[section](data) for each section that comes, and lost(true | false) when that changes.
 *  A page that nobody sees lets go of the stream. */
export function listen(take, lost) {
  let port;
  const sections = [...Object.keys(take), "beat"];
  let seen = false, heard, was, hiding;
  const tell = (now) => {
    if (now !== was) lost((was = now));
    if (now) signIn();
  };
  const look = (now) => {
    seen = now;
    heard = performance.now();
    port.postMessage(now ? sections : []);
  };
  const hear = ({ data: [name, json] }) => {
    if (!seen) return;
    heard = performance.now();
    tell(!name);
    take[name]?.(JSON.parse(json));
  };
  const begin = () => {
    port = connect();
    port.onmessage = hear;
    look(true);
  };
  setInterval(() => {
    if (!seen || performance.now() - heard < SILENT_MS) return;
    tell(true);
    look(false);
    begin();
  }, 1000);
  document.addEventListener("visibilitychange", () => {
    clearTimeout(hiding);
    if (document.hidden) hiding = setTimeout(() => look(false), HIDDEN_MS);
    else if (!seen) look(true);
  });
  addEventListener("pagehide", () => look(false));
  begin();
}

/** The stream that all pages share; one of our own where a browser has no shared workers. */
function connect() {
  if (globalThis.SharedWorker) return new SharedWorker("/static/stream.js", { type: "module" }).port;
  const { port1, port2 } = new MessageChannel();
  import("./stream.js").then(({ serve }) => serve(port2));
  return port1;
}

/** Perhaps the server refuses us because it asks for its token now. */
async function signIn() {
  const response = await fetch("/api/state").catch(() => null);
  if (response?.status === 401) location.reload(); // and be led there
}
