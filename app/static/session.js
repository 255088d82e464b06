// A video or a webcam as a camera session: frames go to the service one after the other, as fast as
// it answers. `Sequence` in sequence.js has the same methods.

import { percent } from "./dom.js";
import { forgetCamera, setZones, trackFrame } from "./service.js";

/** Longest side that is sent: more pixels cost time and add nothing. */
const LONGEST_PX = 1280;

/** A file plays slowly enough to send at least this many frames of each of its seconds. */
const MIN_FPS = 8;
const MIN_RATE = 0.1;

/** Wait before another try where the service names none. */
const RETRY_S = 1;

/** Statuses worth a retry: no answer, too slow, overloaded. */
const TEMPORARY = [0, 408, 429, 502, 503, 504];

const newCameraId = () => "page-"
  + [...crypto.getRandomValues(new Uint8Array(6))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

/** The browser cannot play this video, or not all of it. */
export class UnplayableError extends Error {}

export class Session {
  #video;
  #options;
  #leaving = new AbortController();
  #wake = () => {};
  #started = performance.now();
  #newest = -1;
  #sent = -1;
  #held = false;
  #interval = 0;
  // Whether the service has been told of this camera.
  #known = false;

  /**
   * @param video The element that plays; its source is set.
   * @param live Whether it is a webcam, which cannot be slowed down.
   * @param options Returns the query and the API key.
   */
  constructor(video, { live, options }) {
    this.#video = video;
    this.#options = options;
    this.live = live;
    this.canPause = !live;
    this.takesZones = true;
    this.camera = newCameraId();
  }

  /** Play, and yield `{answer, photo, jpeg}` for each frame or `{trouble}` for a temporary error;
   * throws permanent errors, an UnplayableError among them. */
  async* answers() {
    const { signal } = this.#leaving;
    // Two canvases in turn: one is on show while the other is being sent.
    const shots = [new OffscreenCanvas(1, 1), new OffscreenCanvas(1, 1)];
    const wake = () => this.#wake();
    const look = () => this.#playOrPause();
    this.#video.addEventListener("ended", wake, { signal });
    this.#video.addEventListener("error", wake, { signal });
    document.addEventListener("visibilitychange", look, { signal });
    addEventListener("pagehide", () => this.stop(), { signal });
    await this.#begin();
    if (signal.aborted) return;
    // The first frame takes longest.
    if (!this.live) this.#video.playbackRate = MIN_RATE;
    this.#watch();
    while (await this.#nextFrame()) {
      const timestamp = this.#newest;
      const begun = performance.now();
      try {
        const photo = shots[0];
        const jpeg = await this.#capture(photo);
        this.#known = true;
        const answer = await trackFrame(this.camera, jpeg, timestamp.toFixed(4), { ...this.#options(), signal });
        this.#sent = timestamp;
        shots.reverse();
        this.#keepPace((performance.now() - begun) / 1000);
        yield { answer, photo, jpeg };
      } catch (error) {
        if (signal.aborted) break;
        if (!TEMPORARY.includes(error.status)) throw error;
        yield { trouble: error };
        await this.#pause(error.retryAfterS || RETRY_S);
      }
    }
  }

  get held() {
    return this.#held;
  }

  /** Pause at a frame, or go on. */
  hold(whether) {
    this.#held = whether;
    this.#playOrPause();
  }

  /** Continue at a later time of the video; earlier ones were answered before. */
  jump(seconds) {
    if (!this.live && seconds > this.#sent) this.#video.currentTime = seconds;
  }

  /** Answered frames per second, and the speed if the video is slowed down. */
  get pace() {
    const rate = this.#interval ? 1 / this.#interval : 0;
    const slowed = this.live || this.#video.playbackRate === 1 ? ""
      : `, slowed down to ${percent(this.#video.playbackRate)}`;
    return `${rate.toFixed(1)} frames a second${slowed}`;
  }

  /** Set the zones of this camera. */
  setZones(zones) {
    this.#known = true;
    return setZones(this.camera, zones, this.#options().key);
  }

  /** End the session here and at the service. */
  stop() {
    if (this.#leaving.signal.aborted) return;
    this.#leaving.abort();
    this.#video.pause();
    this.#wake();
    if (this.#known) forgetCamera(this.camera, this.#options().key);
  }

  async #begin() {
    try {
      await this.#video.play();
    } catch (error) {
      if (error.name === "AbortError") return;
      throw new UnplayableError(error.message);
    }
    // Some browsers play the sound of a video that they cannot show.
    if (!this.#video.videoWidth) throw new UnplayableError("no picture");
  }

  /** Watch the time of the frame on show, in seconds. */
  #watch() {
    const note = (_, frame) => {
      if (this.#leaving.signal.aborted) return;
      // Webcams start at any time, and some have no clock.
      this.#newest = this.live ? (performance.now() - this.#started) / 1000
        : frame?.mediaTime ?? this.#video.currentTime;
      this.#wake();
      next();
    };
    const next = () => this.#video.requestVideoFrameCallback?.(note) ?? setTimeout(note, 30);
    note();
  }

  /** Wait for a frame that has not been sent yet; false at the end. */
  async #nextFrame() {
    while (!this.#leaving.signal.aborted) {
      if (this.#video.error) throw new UnplayableError(this.#video.error.message);
      if (this.#newest > this.#sent && !this.#held) return true;
      if (this.#video.ended) return false;
      await new Promise((wake) => { this.#wake = wake; });
    }
    return false;
  }

  /** Draw the frame on show on a canvas, and return it as JPEG. */
  #capture(canvas) {
    const { videoWidth, videoHeight } = this.#video;
    const scale = Math.min(1, LONGEST_PX / Math.max(videoWidth, videoHeight));
    const [width, height] = [Math.round(videoWidth * scale), Math.round(videoHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext("2d").drawImage(this.#video, 0, 0, width, height);
    return canvas.convertToBlob({ type: "image/jpeg", quality: 0.85 });
  }

  #keepPace(seconds) {
    this.#interval = this.#interval ? 0.7 * this.#interval + 0.3 * seconds : seconds;
    if (!this.live) {
      const rate = Math.min(1, Math.max(MIN_RATE, 1 / (MIN_FPS * this.#interval)));
      this.#video.playbackRate = Math.round(rate * 20) / 20;
    }
  }

  #playOrPause() {
    if (this.#held || (document.hidden && !this.live)) this.#video.pause();
    else this.#video.play().catch(() => {});
    this.#wake();
  }

  async #pause(seconds) {
    if (!this.live) this.#video.pause();
    await new Promise((wake) => { setTimeout(wake, 1000 * seconds); });
    if (!this.#leaving.signal.aborted) this.#playOrPause();
  }
}
