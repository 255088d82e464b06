// The people in a frame of a video: a row for each track.

import { $, chip, element, inWords, percent } from "./dom.js";
import { personColour } from "./skeleton.js";

const guess = (found) => found ? `${inWords(found.label)} ${percent(found.probability)}` : "–";

function faces(facing) {
  if (!facing) return "–";
  const towards = facing.front_probability >= 0.5;
  const sure = towards ? facing.front_probability : 1 - facing.front_probability;
  return `${towards ? "the camera" : "away"} ${percent(sure)}`;
}

const COLUMNS = 4;

export class PeopleTable {
  #rows = new Map();
  #choose;

  /** @param choose Called with the track that is chosen. */
  constructor(choose) {
    this.#choose = choose;
  }

  clear() {
    this.#rows.clear();
    $("crowd").replaceChildren();
  }

  /** Show the people of a frame; `zoned` says whether the camera has zones. */
  show(persons, chosen, zoned) {
    for (const [id, row] of this.#rows) {
      if (persons.some((person) => person.track_id === id)) continue;
      row.remove();
      this.#rows.delete(id);
    }
    for (const { track_id: id, posture, action, facing, zones } of persons) {
      if (!this.#rows.has(id)) this.#add(id);
      const row = this.#rows.get(id);
      row.querySelector("input").checked = id === chosen;
      [guess(posture), guess(action), faces(facing), zones?.join(", ") || "–"].forEach((text, column) => {
        row.cells[column + 1].textContent = text;
      });
    }
    $("nobody").hidden = persons.length > 0;
    $("people").hidden = !persons.length;
    $("people").classList.toggle("zoned", zoned);
  }

  #add(id) {
    const input = element("input", { type: "radio", name: "track", value: id });
    input.addEventListener("change", () => this.#choose(id));
    const label = element("label", {}, input, chip(id, personColour(id - 1)));
    const head = element("th", { scope: "row", className: "choices" }, label);
    const cells = Array.from({ length: COLUMNS }, () => element("td"));
    cells.at(-1).className = "zone";
    const row = element("tr", {}, head, ...cells);
    this.#rows.set(id, row);
    // Ordered by number, which stays, rather than by place, which does not.
    const after = [...this.#rows].filter(([other]) => other > id).sort(([a], [b]) => a - b)[0];
    $("crowd").insertBefore(row, after?.[1] ?? null);
  }
}
