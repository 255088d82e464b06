// The view of a video or a webcam: the picture with its tracks, the people, events, the timeline and
// zones. One can look back while it plays and after its end.

import { $, renamed, save, sentence } from "./dom.js";
import { clock, showEvent } from "./events.js";
import { complain, named, tell, working } from "./notices.js";
import { PeopleTable } from "./people_table.js";
import { Recording } from "./recording.js";
import { Sequence } from "./sequence.js";
import { Session, UnplayableError } from "./session.js";
import { Solid } from "./solid.js";
import { drawTracks, fitted, personAt, pointAt } from "./stage.js";
import { Timeline } from "./timeline.js";
import { openWebcam } from "./webcam.js";
import { ZoneEditor } from "./zones.js";

const NO_PICTURE = "This browser cannot play the video, so the service reads it, and no picture is shown.";

export class VideoView {
  #page;
  #video = $("video");
  #solid = new Solid($("live-solid"));
  #timeline = new Timeline($("timeline"), $("timeline-legend"),
    (seconds) => this.#seek(seconds), (steps) => this.#step(steps));
  #table = new PeopleTable((id) => this.#choose(id));
  #zones = new ZoneEditor({
    apply: async (zones) => this.#session?.setZones(zones),
    drawing: (whether) => this.#holdForDrawing(whether),
    redraw: () => this.#draw(),
  });
  #recording = new Recording();
  // The session that plays, the source on show, and one that was refused for want of a key; a source's
  // file is null for the webcam.
  #session = null;
  #source = null;
  #refused = null;
  // The frame on show, the track chosen in it, and the earlier time on show, if any.
  #shown = null;
  #chosen = null;
  #looked = null;
  #notes = [];

  /** @param page Functions of the page: `options()`, `refused(error)` and `begins()`. */
  constructor(page) {
    this.#page = page;
    $("hold").addEventListener("click", () => this.#hold());
    $("stop").addEventListener("click", () => this.stop());
    $("download-video").addEventListener("click", () => this.#download());
    for (const input of $("film").querySelectorAll(".shown input")) {
      input.addEventListener("change", () => this.#draw());
    }
    addEventListener("resize", () => {
      this.#timeline.draw();
      this.#draw();
    });
    $("live").addEventListener("click", (event) => this.#click(event));
    $("live").addEventListener("keydown", (event) => {
      if (!this.#shown || !this.#zones.isDrawing) return;
      const { image } = this.#shown.answer;
      if (this.#zones.key(event, image, fitted($("live"), image).scale)) event.preventDefault();
    });
  }

  /** Track the people of a video file; the last view stays until its first frame is answered. */
  async play(file, note = "") {
    this.stop();
    this.#video.src = URL.createObjectURL(file);
    const session = new Session(this.#video, { live: false, options: this.#page.options });
    try {
      await this.#run(session, { file, note });
    } catch (error) {
      if (!(error instanceof UnplayableError)) throw error;
      this.stop();
      await this.#run(new Sequence(file, this.#page), { file, note: `${note} ${NO_PICTURE}`.trim() });
    }
  }

  async toggleWebcam() {
    if (this.#session?.live) {
      this.stop();
      return;
    }
    this.stop();
    const asked = this.#session = { live: true, stop() {} };
    try {
      const stream = await openWebcam();
      if (asked !== this.#session) {
        // The user has chosen something else meanwhile.
        stream.getTracks().forEach((track) => track.stop());
        return;
      }
      this.#video.srcObject = stream;
      const session = new Session(this.#video, { live: true, options: this.#page.options });
      await this.#run(session, { file: null, note: "The camera must not move." });
    } catch (error) {
      if (asked === this.#session) this.stop();
      complain(new Error(`The webcam cannot be used: ${error.message || error}`));
    }
  }

  /** Try again with another API key if the service required one; false if there is nothing to try. */
  again() {
    const refused = this.#refused;
    if (refused?.file) this.play(refused.file, refused.note);
    else if (refused) this.toggleWebcam();
    return Boolean(refused);
  }

  /** Stop playing and keep the view. */
  stop() {
    this.#session?.stop();
    this.#session = this.#refused = null;
    this.#video.srcObject?.getTracks().forEach((track) => track.stop());
    if (this.#video.src) URL.revokeObjectURL(this.#video.src);
    this.#video.srcObject = null;
    this.#video.removeAttribute("src");
    this.#video.load();
    working("");
    this.#showButtons();
  }

  hide() {
    this.stop();
    $("session").hidden = true;
  }

  async #run(session, source) {
    this.#session = session;
    this.#notes = [source.note];
    let begun = false;
    working("Opening the video …");
    complain(null);
    this.#tell();
    try {
      for await (const { answer, photo, jpeg, trouble, end, unconfirmed } of session.answers()) {
        if (session !== this.#session) return;
        if (trouble) this.#tell(`${sentence(trouble.message)} Trying again …`);
        if (end) this.#notes.push(end);
        for (const event of unconfirmed ?? []) showEvent(event, (seconds) => this.#seek(seconds));
        if (!answer) continue;
        if (!begun) await this.#begin(session, source);
        this.#receive(answer, photo, jpeg);
        begun = true;
      }
      if (session !== this.#session) return;
      this.#tell();
    } catch (error) {
      if (session !== this.#session) return;
      if (error instanceof UnplayableError && !begun && source.file) throw error;
      this.stop();
      if (error.status === 401) this.#refused = source;
      else if (source.file) named(error, source.file);
      tell(begun || $("result").hidden ? [] : ["Below is still the answer before this one."]);
      this.#page.refused(error, source.file ? () => this.play(source.file, source.note) : null);
      return;
    }
    this.stop();
    if (begun) $("pace").textContent = `The end, after ${this.#shown.answer.frame_index + 1} frames.`;
    else complain(new Error(`“${source.file?.name}” holds no frame.`));
  }

  /** Make room for a new source. */
  async #begin(session, source) {
    this.#page.begins();
    if (source.file !== this.#source?.file) this.#zones.clear();
    this.#source = source;
    $("session").hidden = false;
    working("");
    $("zones-panel").hidden = !session.takesZones;
    $("live").setAttribute("aria-label", `${source.file?.name ?? "Webcam"}, with the people found in it`);
    this.#reset();
    if (this.#zones.zones.length && session.takesZones) {
      await session.setZones(this.#zones.zones).catch((error) => this.#notes.push(sentence(error.message)));
    }
  }

  #reset() {
    this.#table.clear();
    this.#recording.clear();
    $("events").replaceChildren();
    this.#shown = this.#chosen = this.#looked = null;
    // Unknown for a webcam, for a browser's recordings, and for what it cannot play.
    const { duration } = this.#video;
    this.#timeline.clear(Number.isFinite(duration) ? duration : null, this.#session.live);
  }

  #tell(passing = "") {
    tell([...this.#notes, passing]);
  }

  #receive(answer, photo, jpeg) {
    const forgotten = answer.session === "new" && this.#shown;
    if (forgotten) {
      this.#reset();
      this.#note("The service had forgotten this camera: people are numbered anew.");
    }
    if (answer.reset) this.#note(`Tracking starts anew: ${answer.reset}.`);
    for (const warning of answer.image.warnings ?? []) this.#note(`About the picture: ${warning}.`);
    this.#tell();
    this.#recording.add(answer, jpeg);
    this.#timeline.add(answer);
    for (const event of answer.events) showEvent(event, (seconds) => this.#seek(seconds));
    if (this.#looked === null) this.#show(answer, photo);
    this.#showButtons();
  }

  /** Add a note once, not with each frame. */
  #note(text) {
    if (!this.#notes.includes(text)) this.#notes.push(text);
  }

  #show(answer, photo) {
    this.#shown = { answer, photo };
    const ids = answer.persons.map(({ track_id: id }) => id);
    if (!ids.includes(this.#chosen)) this.#chosen = ids.length ? Math.min(...ids) : null;
    this.#showPeople();
    $("pace").textContent = `${clock(answer.timestamp)}, frame ${answer.frame_index + 1}: `
      + `${answer.timings_ms.total.toFixed(0)} ms`
      + (this.#looked === null && this.#session ? `, ${this.#session.pace}` : "");
    this.#draw();
  }

  #showPeople() {
    this.#table.show(this.#shown.answer.persons, this.#chosen, this.#zones.zones.length > 0);
  }

  #choose(id) {
    this.#chosen = id;
    this.#showPeople();
    this.#draw();
  }

  #click(event) {
    if (!this.#shown) return;
    const { image, persons } = this.#shown.answer;
    const point = pointAt(event, $("live"), image);
    if (this.#zones.isDrawing) {
      this.#zones.click(point, image, fitted($("live"), image).scale);
      return;
    }
    const hit = persons[personAt(point, persons)];
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
    drawTracks($("live"), { photo, answer, shown, chosen: this.#chosen, zones: this.#zones.drawn });
    const person = answer.persons.find(({ track_id: id }) => id === this.#chosen);
    const pose = skeletons === "raw" ? person?.hypotheses[0] : person?.pose;
    this.#solid.show(pose?.joints_3d ?? [], answer.keypoints);
  }

  /** Show an answered frame, or let a video continue at a later time. */
  async #seek(seconds) {
    if (this.#recording.isEmpty) return;
    if (seconds > this.#recording.end && this.#session?.canPause) {
      this.#session.jump(seconds);
      this.#follow();
      return;
    }
    this.#looked = this.#recording.step(seconds, 0);
    if (this.#session?.canPause) this.#session.hold(true);
    this.#timeline.look(this.#looked);
    this.#showButtons();
    const looked = this.#looked;
    const { answer, photo } = await this.#recording.at(looked);
    if (looked === this.#looked) this.#show(answer, photo);
  }

  #step(steps) {
    if (this.#recording.isEmpty) return;
    this.#seek(this.#recording.step(this.#looked ?? this.#recording.end, steps));
  }

  /** Show the newest frame again, and let the video go on. */
  #follow() {
    this.#looked = null;
    this.#timeline.look(null);
    this.#session?.hold(false);
    this.#showButtons();
  }

  #hold() {
    if (!this.#session) this.play(this.#source.file, this.#source.note);
    else if (this.#looked !== null || this.#session.held) this.#follow();
    else this.#session.hold(true);
    this.#showButtons();
  }

  #holdForDrawing(whether) {
    if (this.#session?.canPause) this.#session.hold(whether || this.#looked !== null);
    this.#showButtons();
  }

  #download() {
    save(this.#recording.document(), renamed(this.#source.file?.name ?? "webcam", ".pose.json"));
  }

  #showButtons() {
    const session = this.#session;
    const paused = session?.held || this.#looked !== null;
    $("stop").hidden = !session;
    $("hold").hidden = session ? !session.canPause && !paused : !this.#source?.file;
    const goOn = session?.canPause ? "Go on" : "Back to the newest";
    $("hold").textContent = session ? (paused ? goOn : "Pause") : "Play again";
    $("download-video").disabled = this.#recording.isEmpty;
    $("webcam").textContent = session?.live ? "Stop the webcam" : "Use the webcam";
  }
}
