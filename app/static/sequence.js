// A video that the browser cannot play: the service reads it as a whole and answers line by line.

import { sentence } from "./dom.js";
import { analyseVideo, Problem } from "./service.js";

export class Sequence {
  #file;
  #options;
  #leaving = new AbortController();
  #begun = performance.now();
  #frames = 0;

  live = false;
  canPause = false;
  takesZones = false;
  held = false;

  constructor(file, { options }) {
    this.#file = file;
    this.#options = options;
  }

  /** Yield `{answer}` of each frame, `{end}` in words with `{unconfirmed}` events; throws if nothing could be answered. */
  async* answers() {
    const { signal } = this.#leaving;
    try {
      for await (const line of analyseVideo(this.#file, { ...this.#options(), signal })) {
        if (line.type === "end") {
          // All reasons are errors but the end of the video and the limit of frames.
          if (!["complete", "max_frames"].includes(line.reason)) throw ended(line);
          yield {
            end: sentence(line.detail),
            unconfirmed: line.events.filter(({ state }) => state === "unconfirmed"),
          };
          return;
        }
        this.#frames += 1;
        yield { answer: line, photo: null, jpeg: null };
      }
      throw new Problem({ status: 0, detail: "the service broke off its answer" });
    } catch (error) {
      if (!signal.aborted) throw error;
    }
  }

  get pace() {
    const seconds = (performance.now() - this.#begun) / 1000;
    return `${(this.#frames / seconds).toFixed(1)} frames a second`;
  }

  hold() {}

  jump() {}

  stop() {
    this.#leaving.abort();
  }
}

const ended = ({ detail, frames }) =>
  new Problem({ status: 422, detail: `${detail}, after ${frames} frames` });
