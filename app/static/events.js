// Events of a video in words, and the list of them.

import { $, element, inWords, percent } from "./dom.js";
import { personColour } from "./skeleton.js";

const MAX_EVENTS = 100;

export const clock = (seconds) =>
  `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;

const WORDS = {
  entered: "entered", left: "left", fell: "fell",
  zone_entered: "went into", zone_left: "went out of",
};

const LASTING = {
  lying: { begin: "is lying", end: "is no longer lying" },
  arms_raised: { begin: "raises both arms", end: "lowers the arms" },
  obstructed: { begin: "does not see its usual view", end: "sees its usual view again" },
};

function eventWords({ event, state, zones = [] }) {
  const said = WORDS[event] ?? LASTING[event]?.[state === "end" ? "end" : "begin"] ?? `${inWords(event)}: ${state}`;
  const unconfirmed = state === "unconfirmed" ? " (unconfirmed)" : "";
  const where = zones.length ? `${event.startsWith("zone_") ? " " : ", in "}${zones.join(", ")}` : "";
  return `${said}${where}${unconfirmed}`;
}

/** Put an event on top of the list; `look` is called with its time when it is clicked. */
export function showEvent(event, look) {
  const who = element("b", { textContent: event.track_id ?? "The camera" });
  if (event.track_id) who.style.borderBottomColor = personColour(event.track_id - 1);
  const time = element("button", { type: "button", className: "time", textContent: clock(event.timestamp) });
  time.title = "Show this frame";
  time.addEventListener("click", () => look(event.timestamp));
  const item = element("li", {}, time, " ", who, ` ${eventWords(event)} (${percent(event.probability)})`);
  item.classList.toggle("alarm", event.event === "fell");
  $("events").prepend(item);
  while ($("events").children.length > MAX_EVENTS) $("events").lastChild.remove();
}
