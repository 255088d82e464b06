// The hypotheses of a person side by side, so that their differences show: each from the camera,
// where they look alike, and from the side, where they do not.

import { choices, element, inWords, percent } from "./dom.js";
import { difference, sideSeen } from "./facts.js";
import { describeEntry, entrySilhouette } from "./service.js";
import { drawSolid } from "./solid.js";

const QUARTER_TURN = Math.PI / 2;

/** How far the views sway to and fro, in radians, and how long it takes, in seconds. */
const SWAY = 0.5, SWAY_S = 5;

const SIZE = { width: 150, height: 200 };

const centimetres = (metres) => `${Math.round(100 * metres)} cm`;

/** How far a hypothesis is from the best one, in words. */
function apart(hypothesis, best, { names }) {
  if (hypothesis === best) return "–";
  const found = difference(hypothesis.joints_3d, best.joints_3d, names);
  if (!found) return "unknown";
  const { name, metres, farther } = found.most;
  const where = Math.abs(farther) < metres / 2 ? "" : farther < 0 ? " nearer" : " farther";
  return `${centimetres(found.mean)} (${inWords(name)} ${centimetres(metres)}${where})`;
}

export class Hypotheses {
  #fieldset;
  #choose;
  #key;
  #views = [];

  /**
   * @param fieldset Holds the cards.
   * @param choose Called with the number of the hypothesis that is chosen.
   * @param key Returns the API key.
   */
  constructor(fieldset, choose, key) {
    this.#fieldset = fieldset;
    this.#choose = choose;
    this.#key = key;
  }

  show(hypotheses, keypoints, chosen) {
    this.#views = [];
    choices(this.#fieldset, "hypothesis", hypotheses,
      (hypothesis) => this.#card(hypothesis, hypotheses[0], keypoints), chosen, this.#choose);
    this.draw(0);
  }

  /** Draw the views as they are so many seconds into their sway; `all`, or those on the screen. */
  draw(seconds, all = true) {
    const yaw = SWAY * Math.sin(2 * Math.PI * seconds / SWAY_S);
    for (const { canvas, hypothesis, best, keypoints, turn } of this.#views) {
      if (!all && !isOnScreen(canvas)) continue;
      const ghost = hypothesis === best ? null : best.joints_3d;
      drawSolid(canvas, hypothesis.joints_3d, keypoints, { yaw: yaw + turn, pitch: 0 }, ghost);
    }
  }

  #card(hypothesis, best, keypoints) {
    const { rank, confidence, weight, camera } = hypothesis;
    const pictures = element("div", { className: "pictures" },
      this.#entry(hypothesis),
      this.#view(hypothesis, best, keypoints, 0, "camera view"),
      this.#view(hypothesis, best, keypoints, QUARTER_TURN, "side view"));
    const line = (term, text) => element("p", {},
      element("span", { textContent: term }), element("span", { textContent: text }));
    return element("div", { className: "card" },
      element("b", { textContent: `${rank}. ${percent(confidence)} sure` }),
      element("meter", { min: 0, max: 1, value: confidence, title: "how likely the joints are right" }),
      pictures,
      line("camera sees", `the ${sideSeen(camera.azimuth_deg)}`),
      line("differs by", apart(hypothesis, best, keypoints)),
      line("nearest to the truth", weight === null ? "unknown" : percent(weight)));
  }

  #view(hypothesis, best, keypoints, turn, caption) {
    const canvas = element("canvas", { ...SIZE });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Skeleton ${hypothesis.rank}, ${caption}`);
    this.#views.push({ canvas, hypothesis, best, keypoints, turn });
    return element("figure", {}, canvas, element("figcaption", { textContent: caption }));
  }

  #entry(hypothesis) {
    const canvas = element("canvas", { width: 80, height: 140, className: "silhouette" });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Silhouette of entry ${hypothesis.entry}`);
    drawEntry(canvas, hypothesis, this.#key()).catch(() => {});
    return element("figure", {}, canvas, element("figcaption", { textContent: "silhouette" }));
  }
}

function isOnScreen(canvas) {
  const { top, bottom } = canvas.getBoundingClientRect();
  return bottom >= 0 && top <= innerHeight;
}

/** The entry's silhouette as the hypothesis uses it: mirrored, and rotated as the person leans. */
async function drawEntry(canvas, { entry, source, camera }, key) {
  const [blob, own] = await Promise.all([entrySilhouette(entry, key), describeEntry(entry, key)]);
  const picture = await createImageBitmap(blob);
  const side = source.mirrored ? -1 : 1;
  const context = canvas.getContext("2d");
  context.translate(canvas.width / 2, canvas.height / 2);
  context.rotate((camera.roll_deg - side * own.camera.roll_deg) * Math.PI / 180);
  context.scale(side, 1);
  context.drawImage(picture, -picture.width / 2, -picture.height / 2);
}
