// Errors, which stay in view wherever one has scrolled, and notes.

import { $, sentence } from "./dom.js";

/** Statuses of errors that may pass: no answer, too slow, too much to do, a fault of the service. */
const mayPass = ({ status }) => status === 0 || status === 408 || status === 429 || status >= 500;

/** Show an error in a bar that stays in view, or none; `again` is offered where the error may pass. */
export function complain(error, again = null) {
  const repeat = error && mayPass(error) ? again : null;
  $("message").hidden = !error;
  $("message-text").textContent = error ? inPlainWords(error) : "";
  $("try-again").hidden = !repeat;
  $("try-again").onclick = repeat;
}

function inPlainWords({ message, status, retryAfterS }) {
  if (status === 0) return "The service does not answer. Check that it is running and that this machine can reach it.";
  const when = retryAfterS ? ` It asks to be tried again in ${retryAfterS} s.` : "";
  return sentence(message) + when;
}

/** Say what is being waited for, dimming an earlier answer; an empty text ends the wait. */
export function working(text) {
  $("busy").textContent = text;
  $("busy").hidden = !text;
  $("result").classList.toggle("busy", Boolean(text));
}

/** Begin an error's message with the name of the file that it is about. */
export function named(error, { name }, field = "video") {
  const prefix = `${field}: `;
  const message = error.message.startsWith(prefix) ? error.message.slice(prefix.length) : error.message;
  error.message = `“${name}”: ${message}`;
  return error;
}

/** The same for an upload of several files, where the message says which field it is about. */
export function about(error, upload) {
  const field = ["frame", "mask", "background"].find((name) => error.message.startsWith(`${name}: `));
  return upload[field]?.name ? named(error, upload[field], field) : error;
}

/** Show notes that are not errors, and perhaps offer an action, `{label, run}`. */
export function tell(notes, action = null) {
  const texts = notes.filter(Boolean);
  $("note").hidden = !texts.length;
  const text = texts.join(" ");
  // A screen reader would read the same text again.
  if ($("note-text").textContent !== text) $("note-text").textContent = text;
  $("note-action").hidden = !action;
  $("note-action").textContent = action?.label ?? "";
  $("note-action").onclick = action?.run ?? null;
}

/** Call `then` when an error is closed. */
export function onDismiss(then) {
  $("dismiss").addEventListener("click", () => {
    complain(null);
    then();
  });
}
