// The API key, for services whose operator has set one.

import { $ } from "./dom.js";

let accepted = "";

/** The key to send, empty if none was entered. */
export const apiKey = () => accepted;

/** Ask for a key, and say so if the one entered is wrong. */
export function askForKey() {
  $("key-form").hidden = false;
  $("key-wrong").hidden = !accepted;
  $("key").setAttribute("aria-invalid", String(Boolean(accepted)));
  accepted = "";
  $("key-form").scrollIntoView({ block: "nearest" });
  $("key").focus();
  $("key").select();
}

/** The service took the key: the form is needed no more. */
export function keyIsAccepted() {
  $("key-form").hidden = true;
}

/** Call `use` when a key was entered. */
export function onKey(use) {
  const enter = () => {
    const { value } = $("key");
    if (!value || value === accepted) return;
    accepted = value;
    use();
  };
  $("key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    enter();
  });
}
