// The server's stream of sections, and whether it still comes.

const SILENT_MS = 3500;

/** Call take[section](data) for each section that comes, and lost(true | false) when that changes.
 *  A browser tries again by itself, but not after every error: so we do. */
export function listen(take, lost) {
  let source, heard, was;
  const tell = (now) => {
    if (now !== was) lost((was = now));
  };
  const open = () => {
    source?.close();
    heard = performance.now();
    source = new EventSource("/api/stream");
    for (const name of [...Object.keys(take), "beat"]) {
      source.addEventListener(name, (event) => {
        heard = performance.now();
        tell(false);
        take[name]?.(JSON.parse(event.data));
      });
    }
    source.addEventListener("error", () => {
      tell(true);
      if (source.readyState === EventSource.CLOSED) setTimeout(signIn, 1000);
    });
  };
  const signIn = async () => {
    // The server refuses us: perhaps it asks for its token now.
    const response = await fetch("/api/state").catch(() => null);
    if (response?.status === 401) location.assign("/login");
    else open();
  };
  setInterval(() => {
    if (performance.now() - heard < SILENT_MS) return;
    tell(true);
    open();
  }, 1000);
  open();
}
