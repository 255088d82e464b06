// People over time: a row for each track, postures as coloured spans, events as marks.

import { inWords } from "./dom.js";
import { clock } from "./events.js";
import { personColour } from "./skeleton.js";

const POSTURES = {
  standing: "#8aa0a6", walking: "#3fae6b", running: "#a5c93a", arms_raised: "#e8c21c",
  bending: "#f0913a", sitting: "#5b8fe0", kneeling: "#9277d6", crouching: "#c56fc9",
  crawling: "#9a6b45", lying: "#dd4b4b", unclear: "#c9d2d2",
};

const MARKS = {
  entered: "+", left: "×", fell: "▼", lying: "■", arms_raised: "▲", zone_entered: "▸", zone_left: "◂",
};

/** Seconds without a sighting after which a posture is unknown. */
const GAP_S = 1;

/** Seconds on show of a webcam, which has no end, and the minimum for any video. */
const WINDOW_S = 120, MIN_S = 10;

const LOOKED = "#d2408a";

const ROW_PX = 20, AXIS_PX = 22, LEFT_PX = 44, RIGHT_PX = 10;

export class Timeline {
  #canvas;
  #legend;
  #tracks = new Map();
  #now = 0;
  #looked = null;
  #duration = null;
  #live = false;

  /**
   * @param seek Called with the time in seconds that the pointer chooses.
   * @param step Called with the number of frames that a key moves by, ±Infinity for Home and End.
   */
  constructor(canvas, legend, seek, step) {
    this.#canvas = canvas;
    this.#legend = legend;
    const seekTo = (event) => seek(this.#secondsAt(event.offsetX));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      seekTo(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) seekTo(event);
    });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -Infinity, End: Infinity };
      if (!(event.key in steps)) return;
      event.preventDefault();
      step(steps[event.key]);
    });
  }

  /** Start over; `duration` in seconds, null if unknown; a `live` source has no end. */
  clear(duration, live) {
    this.#tracks.clear();
    this.#now = 0;
    this.#looked = null;
    this.#duration = duration;
    this.#live = live;
    this.draw();
  }

  /** Mark the time on show, null for the newest. */
  look(seconds) {
    this.#looked = seconds;
    this.draw();
  }

  add({ timestamp, persons, events }) {
    this.#now = timestamp;
    for (const { track_id: id, posture } of persons) {
      const { spans } = this.#track(id);
      const last = spans.at(-1);
      const label = posture?.label ?? "unclear";
      const known = last && timestamp - last.to <= GAP_S;
      if (known) last.to = timestamp;
      if (!known || last.label !== label) spans.push({ label, from: timestamp, to: timestamp });
    }
    for (const event of events) if (event.track_id) this.#track(event.track_id).events.push(event);
    this.#forget();
    this.draw();
  }

  /** Tracks in the order of their numbers. */
  get rows() {
    return [...this.#tracks].sort(([a], [b]) => a - b).map(([id, track]) => ({ id, ...track }));
  }

  #track(id) {
    if (!this.#tracks.has(id)) this.#tracks.set(id, { spans: [], events: [] });
    return this.#tracks.get(id);
  }

  #forget() {
    if (!this.#live) return;
    const since = this.#now - WINDOW_S;
    for (const [id, track] of this.#tracks) {
      track.spans = track.spans.filter(({ to }) => to >= since);
      track.events = track.events.filter(({ timestamp }) => timestamp >= since);
      if (!track.spans.length && !track.events.length) this.#tracks.delete(id);
    }
  }

  /** The first and the last time on show, in seconds. */
  get #range() {
    const end = this.#duration ?? Math.max(MIN_S, this.#now);
    return { begin: this.#live ? Math.max(0, end - WINDOW_S) : 0, end };
  }

  #secondsAt(x) {
    const { begin, end } = this.#range;
    const share = (x - LEFT_PX) / (this.#canvas.clientWidth - LEFT_PX - RIGHT_PX);
    return begin + Math.max(0, Math.min(1, share)) * (end - begin);
  }

  draw() {
    const { rows } = this;
    const [width, height] = [this.#canvas.clientWidth, Math.max(1, rows.length) * ROW_PX + AXIS_PX];
    const sharp = devicePixelRatio || 1;
    Object.assign(this.#canvas, { width: width * sharp, height: height * sharp });
    const context = this.#canvas.getContext("2d");
    context.scale(sharp, sharp);
    const ink = getComputedStyle(this.#canvas).color;
    const { begin, end } = this.#range;
    const across = (seconds) =>
      LEFT_PX + (Math.max(begin, seconds) - begin) / (end - begin) * (width - LEFT_PX - RIGHT_PX);
    this.#drawAxis(context, { begin, end, across, width, bottom: height - AXIS_PX, ink });
    rows.forEach((track, row) => this.#drawRow(context, track, row * ROW_PX, across, ink));
    this.#drawNow(context, across, height - AXIS_PX, ink);
    this.#explain(rows);
  }

  #drawNow(context, across, bottom, ink) {
    context.fillStyle = ink;
    context.fillRect(across(this.#now), 0, 1, bottom);
    const looked = this.#looked ?? this.#now;
    this.#canvas.setAttribute("aria-valuemax", this.#range.end.toFixed(1));
    this.#canvas.setAttribute("aria-valuenow", looked.toFixed(1));
    this.#canvas.setAttribute("aria-valuetext", clock(looked));
    if (this.#looked === null) return;
    context.fillStyle = LOOKED;
    context.fillRect(across(looked) - 1.5, 0, 3, bottom + 4);
  }

  #drawRow(context, { id, spans, events }, top, across, ink) {
    context.textAlign = "right";
    context.textBaseline = "middle";
    context.font = "700 13px system-ui, sans-serif";
    context.fillStyle = personColour(id - 1);
    context.fillRect(LEFT_PX - 12, top + 4, 5, ROW_PX - 8);
    context.fillStyle = ink;
    context.fillText(id, LEFT_PX - 16, top + ROW_PX / 2);
    for (const { label, from, to } of spans) {
      context.fillStyle = POSTURES[label];
      context.fillRect(across(from), top + 3, Math.max(2, across(to) - across(from)), ROW_PX - 6);
    }
    context.textAlign = "center";
    context.lineWidth = 3;
    context.lineJoin = "round";
    for (const { event, state, timestamp } of events) {
      const place = [MARKS[event] ?? "?", across(timestamp), top + ROW_PX / 2];
      context.strokeStyle = state === "end" ? "#000" : "#fff";
      context.fillStyle = state === "end" ? "#fff" : "#000";
      context.strokeText(...place);
      context.fillText(...place);
    }
  }

  #drawAxis(context, { begin, end, across, width, bottom, ink }) {
    const room = (width - LEFT_PX - RIGHT_PX) / 60;
    const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800].find((s) => (end - begin) / s <= room) ?? 3600;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "bottom";
    context.fillStyle = context.strokeStyle = ink;
    context.lineWidth = 1;
    for (let at = Math.ceil(begin / step) * step; at <= end; at += step) {
      context.globalAlpha = 0.25;
      context.fillRect(across(at), 0, 1, bottom + 4);
      context.globalAlpha = 1;
      context.fillText(`${Math.floor(at / 60)}:${String(at % 60).padStart(2, "0")}`,
        Math.min(width - 16, across(at)), bottom + AXIS_PX);
    }
  }

  /** The legend of the colours and marks on show. */
  #explain(rows) {
    const labels = new Set(rows.flatMap(({ spans }) => spans.map(({ label }) => label)));
    const events = new Set(rows.flatMap((row) => row.events.map(({ event }) => event)));
    const ends = rows.some((row) => row.events.some(({ state, event }) => state === "end" && event !== "left"));
    const seen = [
      ...Object.keys(POSTURES).filter((label) => labels.has(label)),
      ...Object.keys(MARKS).filter((event) => events.has(event)), ends,
    ].join();
    if (this.#legend.dataset.seen === seen) return;
    this.#legend.dataset.seen = seen;
    const entry = (sign, text) => {
      const span = document.createElement("span");
      span.append(sign, ` ${text}`);
      return span;
    };
    const swatch = (colour) => {
      const sign = document.createElement("i");
      sign.style.background = colour;
      return sign;
    };
    this.#legend.replaceChildren(
      ...Object.keys(POSTURES).filter((label) => labels.has(label))
        .map((label) => entry(swatch(POSTURES[label]), inWords(label))),
      ...Object.keys(MARKS).filter((event) => events.has(event))
        .map((event) => entry(MARKS[event], inWords(event))),
      ...ends ? [entry("", "(white: it ended)")] : [],
    );
  }
}
