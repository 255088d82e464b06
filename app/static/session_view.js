// The view of a camera session: the video with its tracks, the people, events, and the timeline.

import { drawTracks, fitted, personColour, Solid } from "./drawing.js";
import { videoCommand } from "./service.js";
import { Session } from "./session.js";
import { clock, eventWords, inWords, Timeline } from "./timeline.js";

const $ = (id) => document.getElementById(id);

const MOST_EVENTS = 100;

const percent = (share) => `${Math.round(share * 100)}\u00a0%`;

const guess = (found) => found ? `${inWords(found.label)} ${percent(found.probability)}` : "–";

function faces(facing) {
  if (!facing) return "–";
  const towards = facing.front_probability >= 0.5;
  const sure = towards ? facing.front_probability : 1 - facing.front_probability;
  return `${towards ? "the camera" : "away"} ${percent(sure)}`;
}

const element = (tag, properties) => Object.assign(document.createElement(tag), properties);

export class SessionView {
  #page;
  #video = $("video");
  #solid = new Solid($("live-solid"));
  #timeline = new Timeline($("timeline"), $("timeline-legend"));
  #rows = new Map();
  #session = null;
  #file = null;
  #shown = null;
  #chosen = null;
  #restarted = "";
  #refused = false;
  #asked = null;
  #told = null;

  /** @param page Functions of the page: `options()`, `complain(error)`, `tell(notes)` and
   * `bringIntoView(element)`. */
  constructor(page) {
    this.#page = page;
    $("hold").addEventListener("click", () => this.#hold());
    $("stop").addEventListener("click", () => this.stop());
    for (const input of $("film").querySelectorAll("input")) {
      input.addEventListener("change", () => this.#draw());
    }
    addEventListener("resize", () => {
      this.#timeline.draw();
      this.#draw();
    });
    $("live").addEventListener("click", (event) => this.#chooseAt(event));
  }

  get isLive() {
    return Boolean(this.#session?.live);
  }

  /** Play a video file as a camera session. */
  async playFile(file, note = "") {
    this.stop();
    this.#file = file;
    this.#video.src = URL.createObjectURL(file);
    await this.#play(false, note, `Film: ${file.name}`);
  }

  async playWebcam() {
    this.stop();
    this.#file = null;
    // Browsers offer no webcams to pages without TLS.
    if (!navigator.mediaDevices) {
      this.#page.complain(new Error("Browsers allow the webcam only on pages over HTTPS or on localhost."));
      return;
    }
    const asked = this.#asked = {};
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia(
        { video: { width: 640, height: 480, facingMode: "environment" } });
    } catch (error) {
      if (asked === this.#asked) this.#page.complain(this.#unplayable(error));
      return;
    }
    if (asked !== this.#asked) {
      // The user has chosen something else meanwhile.
      stream.getTracks().forEach((track) => track.stop());
      return;
    }
    this.#video.srcObject = stream;
    await this.#play(true, "The camera must not move.", "Webcam");
  }

  /** Try again with another API key if the service required one. */
  async again() {
    if (!this.#refused) return;
    if (this.#file) await this.playFile(this.#file);
    else await this.playWebcam();
  }

  /** Stop playing and keep the view. */
  stop() {
    this.#session?.stop();
    this.#session = this.#asked = null;
    this.#refused = false;
    this.#video.srcObject?.getTracks().forEach((track) => track.stop());
    if (this.#video.src) URL.revokeObjectURL(this.#video.src);
    this.#video.srcObject = null;
    this.#video.removeAttribute("src");
    this.#video.load();
    this.#showButtons();
  }

  hide() {
    this.stop();
    $("session").hidden = true;
  }

  async #play(live, note, title) {
    const session = new Session(this.#video, { live, options: this.#page.options });
    this.#session = session;
    this.#restarted = "";
    $("session").hidden = false;
    this.#begin();
    $("live").setAttribute("aria-label", `${title}, with the people found in it`);
    $("pace").textContent = "Looking for people …";
    this.#page.complain(null);
    this.#told = null;
    this.#tell(note);
    this.#showButtons();
    try {
      for await (const { answer, photo, trouble } of session.answers()) {
        if (session !== this.#session) return;
        if (trouble) this.#tell(`${sentence(trouble.message)} Trying again …`);
        else this.#show(answer, photo, note);
      }
      if (session !== this.#session) return;
      $("pace").textContent = `The end, after ${this.#shown?.answer.frame_index + 1 || 0} frames.`;
    } catch (error) {
      if (session !== this.#session) return;
      $("pace").textContent = "";
      this.#page.complain(error.status === undefined ? this.#unplayable(error) : error);
      this.stop();
      this.#refused = error.status === 401;
      if (!this.#shown) {
        // There is nothing to show or to play again, except with another key.
        $("session").hidden = true;
        if (!this.#refused) this.#file = null;
        this.#showButtons();
      }
      return;
    }
    this.stop();
  }

  /** Show a note once: a screen reader would repeat it with each frame. */
  #tell(text) {
    if (text !== this.#told) this.#page.tell([text]);
    this.#told = text;
  }

  #unplayable(error) {
    return new Error(this.#file
      ? `This browser cannot play ${this.#file.name}. The service reads more formats: ${videoCommand(this.#file)}`
      : `The webcam cannot be used: ${error.message || error}`);
  }

  #begin() {
    this.#rows.clear();
    $("crowd").replaceChildren();
    $("events").replaceChildren();
    this.#shown = this.#chosen = null;
    // Unknown before it plays, for a webcam, and for a browser's recordings.
    const { duration } = this.#video;
    this.#timeline.clear(Number.isFinite(duration) ? duration : null);
  }

  #show(answer, photo, note) {
    const session = this.#session;
    const afresh = answer.session === "new" && this.#shown;
    if (afresh) this.#restarted = "The service had forgotten this camera: people are numbered anew.";
    if (answer.reset) this.#restarted = `Tracking starts anew: ${answer.reset}.`;
    if (answer.session === "new") this.#begin();
    this.#tell(`${note} ${this.#restarted}`.trim());
    const first = !this.#shown;
    this.#shown = { answer, photo };
    const ids = answer.persons.map(({ track_id: id }) => id);
    if (!ids.includes(this.#chosen)) this.#chosen = ids.length ? Math.min(...ids) : null;
    this.#timeline.add(answer);
    this.#showPeople(answer.persons);
    for (const event of answer.events) this.#tellEvent(event);
    const rate = session.live || this.#video.playbackRate === 1 ? ""
      : `, slowed down to ${percent(this.#video.playbackRate)}`;
    $("pace").textContent = `${clock(answer.timestamp)}, frame ${answer.frame_index + 1}: `
      + `${answer.timings_ms.total.toFixed(0)} ms, ${session.framesPerSecond.toFixed(1)} frames a second${rate}`;
    this.#draw();
    if (first && !afresh) this.#page.bringIntoView($("session"));
  }

  #showPeople(persons) {
    for (const [id, row] of this.#rows) {
      if (persons.some((person) => person.track_id === id)) continue;
      row.remove();
      this.#rows.delete(id);
    }
    for (const { track_id: id, posture, action, facing } of persons) {
      if (!this.#rows.has(id)) this.#addRow(id);
      const row = this.#rows.get(id);
      row.querySelector("input").checked = id === this.#chosen;
      [guess(posture), guess(action), faces(facing)].forEach((text, column) => {
        row.cells[column + 1].textContent = text;
      });
    }
    $("nobody").hidden = persons.length > 0;
    $("people").hidden = !persons.length;
  }

  #addRow(id) {
    const row = document.createElement("tr");
    const label = document.createElement("label");
    const input = element("input", { type: "radio", name: "track", value: id });
    input.addEventListener("change", () => this.#choose(id));
    const chip = element("span", { className: "chip", textContent: id });
    chip.style.borderBottomColor = personColour(id - 1);
    label.append(input, chip);
    const head = element("th", { scope: "row", className: "choices" });
    head.append(label);
    row.append(head, ...["posture", "action", "faces"].map(() => document.createElement("td")));
    this.#rows.set(id, row);
    // Ordered by number, which stays the same, rather than by place.
    const after = [...this.#rows].filter(([other]) => other > id).sort(([a], [b]) => a - b)[0];
    $("crowd").insertBefore(row, after?.[1] ?? null);
  }

  #tellEvent(event) {
    const item = element("li", { textContent: `${clock(event.timestamp)}  ` });
    const who = element("b", { textContent: event.track_id });
    who.style.borderBottomColor = personColour(event.track_id - 1);
    item.append(who, ` ${eventWords(event)} (${percent(event.probability)})`);
    item.classList.toggle("alarm", event.event === "fell");
    $("events").prepend(item);
    while ($("events").children.length > MOST_EVENTS) $("events").lastChild.remove();
  }

  #choose(id) {
    this.#chosen = id;
    this.#showPeople(this.#shown.answer.persons);
    this.#draw();
  }

  #chooseAt({ offsetX, offsetY }) {
    if (!this.#shown) return;
    const { answer } = this.#shown;
    const { scale, left, top } = fitted($("live"), answer.image);
    const [x, y] = [(offsetX - left) / scale, (offsetY - top) / scale];
    const hit = answer.persons.find(({ box }) =>
      x >= box.x && x <= box.x + box.width && y >= box.y && y <= box.y + box.height);
    if (hit) this.#choose(hit.track_id);
  }

  #draw() {
    if (!this.#shown) return;
    const { answer, photo } = this.#shown;
    const skeletons = $("film").querySelector("[name=skeletons]:checked").value;
    const shown = {
      boxes: $("live-boxes").checked,
      smoothed: ["smoothed", "both"].includes(skeletons),
      raw: ["raw", "both"].includes(skeletons),
    };
    $("alone").hidden = skeletons !== "both";
    drawTracks($("live"), { photo, answer, shown, chosen: this.#chosen });
    const person = answer.persons.find(({ track_id: id }) => id === this.#chosen);
    const pose = skeletons === "raw" ? person?.hypotheses[0] : person?.pose;
    this.#solid.show(pose?.joints_3d ?? [], answer.keypoints);
  }

  #hold() {
    if (this.#session) this.#session.hold(!this.#session.held);
    else if (this.#file) this.playFile(this.#file);
    this.#showButtons();
  }

  #showButtons() {
    const session = this.#session;
    $("stop").hidden = !session;
    $("hold").hidden = session ? session.live : !this.#file;
    $("hold").textContent = session ? (session.held ? "Go on" : "Pause") : "Play again";
    $("webcam").textContent = this.isLive ? "Stop the webcam" : "Use the webcam";
  }
}

/** Turn a message into a sentence. */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1).replace(/\.$/, "")}.`;
