// The view of a photograph: the people found in it, their hypotheses, and the chosen one.

import { $, chip, choices, copy, renamed, saveJson, showTerms } from "./dom.js";
import { measured, supposed } from "./facts.js";
import { Hypotheses } from "./hypotheses.js";
import { inPixelsOf } from "./photograph.js";
import { tint } from "./silhouettes.js";
import { personColour } from "./skeleton.js";
import { Solid } from "./solid.js";
import { drawCloseUp, drawStage, personAt, pointAt } from "./stage.js";

const LAYERS = ["show-boxes", "show-silhouettes", "show-skeleton", "show-observed"];

/** The person to select first: the one nearest to the camera. */
function largest(persons) {
  const heights = persons.map(({ box }) => box.height);
  return Math.max(0, heights.indexOf(Math.max(...heights)));
}

export class PhotographView {
  #solid = new Solid($("solid"));
  #hypotheses;
  #upload = null;
  #answer = null;
  #bitmap = null;
  #silhouettes = null;
  #sent = null;
  #person = 0;
  #hypothesis = 0;

  /** @param key Returns the API key. */
  constructor(key) {
    this.#hypotheses = new Hypotheses($("hypotheses"), (number) => {
      this.#hypothesis = number;
      this.#showPose();
    }, key);
    for (const id of LAYERS) $(id).addEventListener("change", () => this.#draw());
    addEventListener("resize", () => this.#draw());
    $("stage").addEventListener("click", (event) => this.#chooseAt(event));
    $("straight").addEventListener("click", () => {
      $("spin").checked = false;
      this.#solid.straighten();
      this.#hypotheses.draw(0);
    });
    $("copy-curl").addEventListener("click", async () => {
      $("copied").textContent = await copy($("curl"));
    });
    $("download").addEventListener("click", () => {
      const { frame, mask } = this.#upload;
      saveJson(this.#answer, renamed((frame ?? mask).name, ".pose.json"));
    });
    this.#turn();
  }

  /** The upload whose answer is shown. */
  get upload() {
    return this.#upload;
  }

  /** Show an answer in pixels of the photograph, even if a smaller copy was sent. */
  show(upload, { bitmap, original }, answered, command) {
    this.#silhouettes = tint(answered);
    // As the displayed command would return it, which requests no silhouettes.
    for (const { silhouette } of answered.persons) if (silhouette) silhouette.rle = null;
    this.#upload = upload;
    this.#bitmap = bitmap;
    this.#answer = original ? inPixelsOf(original, answered) : answered;
    this.#sent = original && answered.image;
    this.#person = largest(answered.persons);
    this.#hypothesis = 0;
    $("curl").textContent = command;
    $("result").hidden = false;
    this.setStale(false);
    this.#showPersons();
  }

  /** Mark the shown answer as out of date, dimmed and inert, or as current. */
  setStale(stale) {
    $("result").classList.toggle("stale", stale);
    $("result").inert = stale;
  }

  hide() {
    $("result").hidden = true;
  }

  #chooseAt(event) {
    const hit = personAt(pointAt(event, $("stage"), this.#answer.image), this.#answer.persons);
    if (hit < 0) return;
    this.#person = hit;
    this.#hypothesis = 0;
    this.#showPersons();
  }

  #showPersons() {
    choices($("persons"), "person", this.#answer.persons,
      (_, number) => chip(number + 1, personColour(number)), this.#person, (number) => {
        this.#person = number;
        this.#hypothesis = 0;
        this.#showHypotheses();
      });
    this.#showHypotheses();
  }

  #showHypotheses() {
    const found = this.#answer.persons[this.#person];
    this.#hypotheses.show(found?.hypotheses ?? [], this.#answer.keypoints, this.#hypothesis);
    this.#showPose();
  }

  #showPose() {
    const { persons, keypoints, timings_ms: { total, ...stages } } = this.#answer;
    const found = persons[this.#person];
    const hypothesis = found?.hypotheses[this.#hypothesis];
    $("pose").hidden = !hypothesis;
    if (hypothesis) {
      this.#solid.show(hypothesis.joints_3d, keypoints);
      showTerms($("facts"), measured(found));
      showTerms($("supposed"), supposed(hypothesis));
    }
    $("timings").textContent = `${total.toFixed(0)}\u00a0ms: ${Object.entries(stages)
      .map(([stage, ms]) => `${stage} ${ms.toFixed(0)}\u00a0ms`).join(", ")}`
      + (this.#sent ? `; sent at ${this.#sent.width} × ${this.#sent.height}` : "");
    this.#draw();
  }

  #draw() {
    if (!this.#answer) return;
    const [boxes, silhouettes, skeleton, observed] = LAYERS.map((id) => $(id).checked);
    const scene = {
      photo: this.#bitmap,
      answer: this.#answer,
      silhouettes: this.#silhouettes,
      person: this.#person,
      hypothesis: this.#hypothesis,
      shown: { boxes, silhouettes, skeleton, observed, numbers: true },
    };
    drawStage($("stage"), scene);
    // In the close-up, there is no other person to distinguish.
    drawCloseUp($("close-up"), { ...scene, shown: { ...scene.shown, boxes: false, numbers: false } });
  }

  /** Turn the skeletons, which shows depth; with reduced motion, the user turns them by hand. */
  #turn() {
    $("spin").checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    let seconds = 0, last = null, odd = false;
    const step = (now) => {
      if ($("spin").checked && !$("result").hidden && this.#answer) {
        seconds += last === null ? 0 : Math.min(0.1, (now - last) / 1000);
        this.#solid.turn(0.012, 0);
        // The many small ones are drawn half as often.
        odd = !odd;
        if (odd) this.#hypotheses.draw(seconds, false);
      }
      last = now;
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
    addEventListener("scroll", () => this.#hypotheses.draw(seconds, false), { passive: true });
  }
}
