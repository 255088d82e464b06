// Small helpers for the elements of the page.

export const $ = (id) => document.getElementById(id);

export const element = (tag, properties, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};

export const percent = (share) => `${Math.round(share * 100)}\u00a0%`;

export const inWords = (name) => name.replaceAll("_", " ");

/** Turn a message into a sentence. */
export const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1).replace(/\.$/, "")}.`;

/** Fill a group with radio buttons, which bring arrow keys, focus and screen readers along. */
export function choices(fieldset, name, items, content, chosen, choose) {
  const list = element("div", { className: "list" });
  items.forEach((item, number) => {
    const input = element("input", { type: "radio", name, value: number, checked: number === chosen });
    input.addEventListener("change", () => choose(number));
    list.append(element("label", {}, input, content(item, number)));
  });
  fieldset.querySelector(".list")?.remove();
  fieldset.append(list);
  fieldset.hidden = !items.length;
}

/** A person's number as a chip in that person's colour. */
export function chip(number, colour) {
  const made = element("span", { className: "chip", textContent: number });
  made.style.borderBottomColor = colour;
  return made;
}

/** Replace the terms of a description list; `pairs` of term and text. */
export function showTerms(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([term, text]) => [
    element("dt", { textContent: term }), element("dd", { textContent: text }),
  ]));
}

/** Copy an element's text, or select it where the browser gives no access to the clipboard. */
export async function copy(source) {
  try {
    await navigator.clipboard.writeText(source.textContent);
    return "copied";
  } catch {
    // Pages without TLS have no clipboard.
    getSelection().selectAllChildren(source);
    return "press Ctrl+C to copy it";
  }
}

/** Save a document under a name. */
export function save(blob, name) {
  const url = URL.createObjectURL(blob);
  element("a", { href: url, download: name }).click();
  // The browser reads it after this task.
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Save a value as JSON. */
export const saveJson = (value, name) =>
  save(new Blob([JSON.stringify(value, null, 2)], { type: "application/json" }), name);

/** The name of a file with another ending. */
export const renamed = (name, ending) => `${(name || "photo").replace(/\.[^.]*$/, "")}${ending}`;
