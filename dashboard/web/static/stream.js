// The server's stream, once for all pages of a browser: it opens six connections to one server at
// most, and those of streams do not end, so that with one a page a stop would have to wait for one.
//
// A page posts the names of the sections that it wants, [] when nobody sees it. It gets [name, JSON]
// for each that comes, all to begin with, and [] when the server is not heard.

const SILENT_MS = 3500;
const wanted = new Map(); // page's port -> its sections
const newest = new Map(); // section -> JSON
let source = null;
let named = new Set(); // sections that it listens to
let heard = 0;

/** Answer the page at the other end of a port. */
export function serve(port) {
  port.onmessage = ({ data: sections }) => {
    if (!sections.length) wanted.delete(port);
    else {
      wanted.set(port, sections);
      for (const section of newest) port.postMessage(section);
    }
    if (!wanted.size) close();
    else if (!source || sections.some((name) => !named.has(name))) open();
  };
}

function open() {
  close();
  heard = performance.now();
  source = new EventSource("/api/stream");
  named = new Set([...wanted.values()].flat());
  for (const name of named) {
    source.addEventListener(name, ({ data }) => {
      heard = performance.now();
      newest.set(name, data);
      tell([name, data]);
    });
  }
  source.addEventListener("error", () => tell([]));
}

function close() {
  source?.close();
  source = null;
  newest.clear();
}

function tell(message) {
  for (const port of wanted.keys()) port.postMessage(message);
}

// A browser tries again by itself, but not after every error: so we do.
setInterval(() => {
  if (!source || performance.now() - heard < SILENT_MS) return;
  tell([]);
  open();
}, 1000);

globalThis.onconnect = ({ ports: [port] }) => serve(port); // as a shared worker
