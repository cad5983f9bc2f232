// Elements, and lists that keep their elements while their contents change.

export const byId = (id) => document.getElementById(id);

/** An element: el("p", {class: "faint"}, "text", child). Functions are listeners. */
export function el(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** A name that may be broken after its underscores. */
export function breakable(name) {
  return name.split("_").flatMap((part, index) => (index ? ["_", el("wbr"), part] : [part]));
}

/** Set a text only if it is another one, so that nothing is announced or drawn for nothing. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Let a parent hold one child a row, in order; what stays keeps its element, and so its focus.
 *  make(row) gives an element; update(element, row) fills it. */
export function keyed(parent, rows, key, make, update) {
  const wanted = new Set(rows.map((row) => String(key(row))));
  const had = new Map();
  for (const child of [...parent.children]) {
    const name = child.dataset.key;
    if (wanted.has(name) && !had.has(name)) had.set(name, child);
    else child.remove(); // first, so that what stays need not be moved; of two of one name the second
  }
  rows.forEach((row, index) => {
    const name = String(key(row));
    let child = had.get(name);
    if (child) had.delete(name);
    else {
      child = make(row);
      child.dataset.key = name;
    }
    update(child, row);
    if (parent.children[index] !== child) parent.insertBefore(child, parent.children[index] ?? null);
  });
}

/** A button with a label of its own that has to be pressed twice, for what is not undone by
 *  pressing another. */
export function twice(button, act) {
  const text = button.textContent;
  const name = button.getAttribute("aria-label");
  let timer = 0;
  const ask = (sure) => {
    clearTimeout(timer);
    button.classList.toggle("sure", sure);
    button.textContent = sure ? "Sure?" : text;
    button.setAttribute("aria-label", sure ? `Sure? ${name}` : name);
    say(byId("said"), sure ? `${name}? Press again to be sure.` : "");
  };
  button.addEventListener("click", () => {
    const sure = button.classList.contains("sure");
    ask(!sure);
    if (sure) act();
    else timer = setTimeout(() => ask(false), 4000);
  });
  return button;
}
