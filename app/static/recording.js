// The answers to a video so far and their frames, to look back and to save.

/** Frames that are kept; a longer recording loses its first ones. */
const MAX_FRAMES = 6000;

export class Recording {
  #entries = [];

  clear() {
    this.#entries = [];
  }

  get isEmpty() {
    return !this.#entries.length;
  }

  /** Timestamp of the newest answer, in seconds. */
  get end() {
    return this.#entries.at(-1)?.timestamp ?? 0;
  }

  /** Keep an answer, and the JPEG it belongs to if there is one. */
  add(answer, jpeg) {
    // Blobs rather than objects: browsers keep them outside the page's memory.
    this.#entries.push({ timestamp: answer.timestamp, answer: new Blob([JSON.stringify(answer)]), jpeg });
    if (this.#entries.length > MAX_FRAMES) this.#entries.shift();
  }

  /** The answer and the photograph at a time in seconds: the last ones up to it. */
  async at(seconds) {
    const after = this.#entries.findIndex(({ timestamp }) => timestamp > seconds + 1e-6);
    const entry = this.#entries[after < 0 ? this.#entries.length - 1 : Math.max(0, after - 1)];
    const [text, photo] = await Promise.all([
      entry.answer.text(), entry.jpeg && createImageBitmap(entry.jpeg),
    ]);
    return { answer: JSON.parse(text), photo };
  }

  /** Timestamp of the answer so many steps after the one at a time. */
  step(seconds, steps) {
    const times = this.#entries.map(({ timestamp }) => timestamp);
    const now = times.findLastIndex((timestamp) => timestamp <= seconds + 1e-6);
    return times[Math.max(0, Math.min(times.length - 1, now + steps))] ?? 0;
  }

  /** All answers as one JSON document. */
  document() {
    const parts = this.#entries.flatMap(({ answer }, number) => number ? [",\n", answer] : [answer]);
    return new Blob(['{"frames": [\n', ...parts, "\n]}\n"], { type: "application/json" });
  }
}
