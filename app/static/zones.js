// Zones of a camera, drawn into its picture corner by corner.

import { $, copy, element, sentence } from "./dom.js";

/** A click this near to the first corner, in pixels of the screen, closes the zone. */
const CLOSE_PX = 10;

const MAX_CORNERS = 64;

/** Pixels of the screen by which a key moves the cursor; one with Shift. */
const KEY_PX = 10;

const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const within = (point, { width, height }) =>
  point.map((value, axis) => Math.round(10 * Math.max(0, Math.min([width, height][axis] - 1, value))) / 10);

export class ZoneEditor {
  #host;
  #zones = [];
  #draft = null;
  #size = null;

  /**
   * @param host Functions of the view: `apply(zones)` sends all zones to the camera and throws if
   * they are refused, `drawing(whether)` is called when drawing begins and ends, `redraw()` draws
   * the picture.
   */
  constructor(host) {
    this.#host = host;
    $("draw-zone").addEventListener("click", () => (this.#draft ? this.#cancel() : this.#begin()));
    $("close-zone").addEventListener("click", () => this.#close());
    $("cancel-zone").addEventListener("click", () => this.#cancel());
    $("zone-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#save();
    });
    $("zone-kind").addEventListener("change", () => {
      if (this.#draft) this.#draft.kind = $("zone-kind").value;
      this.#host.redraw();
    });
    $("copy-zones").addEventListener("click", async () => {
      $("zones-copied").textContent = await copy($("zones-command"));
    });
    addEventListener("keydown", (event) => {
      if (this.#draft && event.key === "Escape") this.#cancel();
    });
    this.#show();
  }

  get zones() {
    return this.#zones;
  }

  get isDrawing() {
    return Boolean(this.#draft?.open);
  }

  /** The zones to draw, including an unfinished one. */
  get drawn() {
    return this.#draft ? [...this.#zones, this.#draft] : this.#zones;
  }

  clear() {
    this.#zones = [];
    this.#draft = null;
    this.#show();
  }

  /** Add a corner, in pixels of a frame of this size; `scale` is pixels of the screen for one of it. */
  click([x, y], { width, height }, scale) {
    const { polygon } = this.#draft;
    this.#size = { width, height };
    const near = polygon.length > 2
      && Math.hypot(x - polygon[0][0], y - polygon[0][1]) * scale <= CLOSE_PX;
    if (near || polygon.length === MAX_CORNERS) {
      this.#close();
      return;
    }
    polygon.push(within([x, y], { width, height }));
    this.#show();
    this.#host.redraw();
  }

  /** Move the cursor, or set or take back a corner; returns whether the key does so. */
  key({ key, shiftKey }, size, scale) {
    const draft = this.#draft;
    draft.cursor ??= [size.width / 2, size.height / 2];
    const [x, y] = KEYS[key] ?? [];
    if (x !== undefined) {
      const step = (shiftKey ? 1 : KEY_PX) / scale;
      draft.cursor = within([draft.cursor[0] + x * step, draft.cursor[1] + y * step], size);
    } else if (key === "Enter" || key === " ") this.click(draft.cursor, size, scale);
    else if (key === "Backspace") draft.polygon.pop();
    else return false;
    this.#show();
    this.#host.redraw();
    return true;
  }

  #begin() {
    this.#draft = { name: "", kind: $("zone-kind").value, polygon: [], open: true };
    this.#host.drawing(true);
    this.#complain("");
    this.#show();
    $("live").focus();
  }

  #close() {
    if (this.#draft.polygon.length < 3) {
      this.#complain("A zone needs at least three corners.");
      return;
    }
    this.#complain("");
    this.#draft.open = false;
    this.#show();
    this.#host.redraw();
    $("zone-name").focus();
  }

  #cancel() {
    this.#draft = null;
    this.#complain("");
    this.#host.drawing(false);
    this.#show();
    this.#host.redraw();
  }

  async #save() {
    const { kind, polygon } = this.#draft;
    const name = $("zone-name").value.trim();
    if (!name) {
      this.#complain("The zone needs a name.");
      return;
    }
    if (!await this.#apply([...this.#zones, { name, kind, polygon }])) return;
    $("zone-name").value = "";
    this.#cancel();
  }

  /** Set these zones, unless the service refuses them; returns whether they are set. */
  async #apply(zones) {
    try {
      await this.#host.apply(zones);
    } catch (error) {
      this.#complain(sentence(error.message));
      return false;
    }
    this.#zones = zones;
    this.#complain("");
    this.#show();
    this.#host.redraw();
    return true;
  }

  #complain(text) {
    $("zone-message").hidden = !text;
    $("zone-message").textContent = text;
  }

  #show() {
    const draft = this.#draft;
    $("draw-zone").textContent = draft ? "Cancel" : "Draw a zone";
    $("zone-help").hidden = !draft?.open;
    $("close-zone").hidden = !draft?.open;
    $("close-zone").disabled = (draft?.polygon.length ?? 0) < 3;
    $("zone-form").hidden = !draft || draft.open;
    $("live").classList.toggle("drawing", Boolean(draft?.open));
    // Screen readers then pass on the arrow keys.
    $("live").setAttribute("role", draft?.open ? "application" : "img");
    if (draft?.open) $("live").tabIndex = 0;
    else $("live").removeAttribute("tabindex");
    const at = draft?.cursor?.map(Math.round).join(", ");
    $("zone-cursor").textContent = draft?.open && at ? `Corner ${draft.polygon.length + 1}: ${at}` : "";
    $("zones").replaceChildren(...this.#zones.map((zone) => this.#item(zone)));
    $("zones-use").hidden = !this.#zones.length;
    if (this.#zones.length) this.#showCommand();
  }

  #item(zone) {
    const remove = element("button", { type: "button", textContent: "Remove" });
    remove.setAttribute("aria-label", `Remove the zone ${zone.name}`);
    remove.addEventListener("click", () => this.#apply(this.#zones.filter((other) => other !== zone)));
    const kind = zone.kind === "rest" ? "for resting" : "watched";
    return element("li", {}, element("b", { textContent: zone.name }), ` (${kind}) `, remove);
  }

  #showCommand() {
    const { width, height } = this.#size;
    const url = new URL("cameras/CAMERA", document.baseURI);
    const body = JSON.stringify({ zones: this.#zones }).replaceAll("'", "'\\''");
    $("zones-size").textContent = `${width} × ${height}`;
    $("zones-command").textContent = `curl -X PUT -H 'Content-Type: application/json' -d '${body}' '${url}'`;
  }
}
