// The server's stream of sections, and whether it still comes.

const SILENT_MS = 3500;
const HIDDEN_MS = 5000;

/** Call take[section](data) for each section that comes, and lost(true | false) when that changes.
 *  A browser tries again by itself, but not after every error: so we do. It opens six connections
 *  to one server at most, all its pages together: one that nobody sees lets go of its own. */
export function listen(take, lost) {
  let source, heard, was, hiding;
  const tell = (now) => {
    if (now !== was) lost((was = now));
  };
  const close = () => {
    source?.close();
    source = null;
  };
  const open = () => {
    close();
    heard = performance.now();
    const mine = (source = new EventSource("/api/stream"));
    for (const name of [...Object.keys(take), "beat"]) {
      mine.addEventListener(name, (event) => {
        heard = performance.now();
        tell(false);
        take[name]?.(JSON.parse(event.data));
      });
    }
    mine.addEventListener("error", () => {
      tell(true);
      if (mine.readyState === EventSource.CLOSED) setTimeout(signIn, 1000);
    });
  };
  const signIn = async () => {
    // The server refuses us: perhaps it asks for its token now.
    const response = await fetch("/api/state").catch(() => null);
    if (response?.status === 401) location.assign("/login");
    else if (source) open();
  };
  setInterval(() => {
    if (!source || performance.now() - heard < SILENT_MS) return;
    tell(true);
    open();
  }, 1000);
  document.addEventListener("visibilitychange", () => {
    clearTimeout(hiding);
    if (document.hidden) hiding = setTimeout(close, HIDDEN_MS);
    else if (!source) open();
  });
  open();
}
