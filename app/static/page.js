// The debug page: a photograph in, what the service made of it out.

import {
  drawCloseUp, drawStage, drawThumbnail, personColour, Solid, tint,
} from "./drawing.js";
import {
  curlCommand, describeEntry, describeIndex, entrySilhouette, estimatePose, extractSilhouettes,
} from "./service.js";

const $ = (id) => document.getElementById(id);
const solid = new Solid($("solid"));

// All that changes: what was sent, what came back, and what is chosen of it.
const state = { upload: null, bitmap: null, answer: null, silhouettes: null, person: 0, hypothesis: 0 };
let asking = null;
let webcam = null;

const options = () => ({
  count: Math.min(50, Math.max(1, Number($("count").value) || 7)),
  keypoints: $("keypoints").value,
  key: $("key").value,
  keyed: Boolean($("key").value),
});

function complain(error) {
  $("message").hidden = !error;
  $("message").textContent = error ? error.message : "";
  if (error?.status === 401) {
    $("key-form").hidden = false;
    $("key").focus();
  }
}

async function showIndex() {
  try {
    const index = await describeIndex($("key").value);
    $("index").textContent = `${index.name}: ${index.entries.toLocaleString("en")} silhouettes, `
      + `${index.actions.length} kinds of action`;
    $("attribution").textContent = index.attribution;
    return true;
  } catch (error) {
    $("index").textContent = error.message;
    if (error.status === 401) complain(error);
    return error.status !== 503;
  }
}

async function untilReady() {
  while (!await showIndex()) await new Promise((wake) => setTimeout(wake, 500));
}

/** Ask the service about a photograph, perhaps with a mask, and show what it says. */
async function ask(upload) {
  asking?.abort();
  asking = new AbortController();
  const { signal } = asking;
  const chosen = options();
  complain(null);
  $("result").classList.add("busy");
  $("busy").hidden = Boolean(webcam);
  try {
    const bitmap = await createImageBitmap(upload.frame).catch(() => null);
    const answer = await estimatePose(upload, { ...chosen, signal });
    const labels = answer.persons.length
      ? await extractSilhouettes(upload, { ...chosen, signal }).catch(() => null) : null;
    const silhouettes = labels && await tint(labels);
    if (signal.aborted) return;
    const person = upload.sameScene
      ? Math.min(state.person, Math.max(0, answer.persons.length - 1)) : largest(answer.persons);
    Object.assign(state, { upload, bitmap, answer, silhouettes, person, hypothesis: 0 });
    $("result").hidden = false;
    document.body.classList.add("has-result");
    $("curl").textContent = curlCommand(upload, chosen);
    if (!answer.persons.length) complain(new Error("Nobody was found in this photograph."));
    showPersons();
  } catch (error) {
    if (error.name !== "AbortError") complain(error);
  } finally {
    if (!signal.aborted) {
      $("result").classList.remove("busy");
      $("busy").hidden = true;
    }
  }
}

/** Who to look at first: whoever stands nearest to the camera. */
function largest(persons) {
  const heights = persons.map(({ box }) => box.height);
  return Math.max(0, heights.indexOf(Math.max(...heights)));
}

/** A group of radio buttons: arrow keys, focus and screen readers come with them. */
function choices(fieldset, name, items, content, chosen, choose) {
  const list = document.createElement("div");
  list.className = "list";
  items.forEach((item, number) => {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"),
      { type: "radio", name, value: number, checked: number === chosen });
    input.addEventListener("change", () => choose(number));
    label.append(input, content(item, number));
    list.append(label);
  });
  fieldset.querySelector(".list")?.remove();
  fieldset.append(list);
  fieldset.hidden = !items.length;
}

function showPersons() {
  choices($("persons"), "person", state.answer.persons, (person, number) => {
    const chip = document.createElement("span");
    chip.className = "chip";
    chip.style.borderBottomColor = personColour(number);
    chip.textContent = number + 1;
    return chip;
  }, state.person, (number) => {
    Object.assign(state, { person: number, hypothesis: 0 });
    showHypotheses();
  });
  showHypotheses();
}

const percent = (share) => `${Math.round(share * 100)} %`;

function showHypotheses() {
  const found = state.answer.persons[state.person];
  choices($("hypotheses"), "hypothesis", found?.hypotheses ?? [], card, state.hypothesis, (number) => {
    state.hypothesis = number;
    showPose();
  });
  showPose();
}

function card(hypothesis) {
  const box = document.createElement("div");
  box.className = "card";
  const line = (...parts) => {
    const p = document.createElement("p");
    p.append(...parts.map((part) => Object.assign(document.createElement("span"), { textContent: part })));
    return p;
  };
  const title = Object.assign(document.createElement("b"),
    { textContent: `${hypothesis.rank}. ${hypothesis.action}` });
  const sure = Object.assign(document.createElement("meter"),
    { min: 0, max: 1, value: hypothesis.confidence, title: "confidence" });
  const pictures = document.createElement("div");
  pictures.className = "pictures";
  const silhouette = Object.assign(document.createElement("canvas"), { width: 80, height: 140 });
  silhouette.setAttribute("role", "img");
  silhouette.setAttribute("aria-label", `Silhouette of entry ${hypothesis.entry}`);
  drawEntry(silhouette, hypothesis).catch(() => {});
  const skeleton = Object.assign(document.createElement("canvas"), { width: 140, height: 200 });
  drawThumbnail(skeleton, hypothesis.joints_3d, state.answer.keypoints);
  pictures.append(silhouette, skeleton);
  box.append(title, sure,
    line("confidence", percent(hypothesis.confidence)),
    line("outline error", `${hypothesis.reprojection_error_px.toFixed(1)} px`),
    pictures,
    line("entry", hypothesis.entry));
  return box;
}

/** The entry's silhouette as the hypothesis means it: mirrored, and turned as far as the person leans. */
async function drawEntry(canvas, { entry, source, camera }) {
  const key = $("key").value;
  const [blob, own] = await Promise.all([entrySilhouette(entry, key), describeEntry(entry, key)]);
  const picture = await createImageBitmap(blob);
  const side = source.mirrored ? -1 : 1;
  const context = canvas.getContext("2d");
  context.translate(canvas.width / 2, canvas.height / 2);
  context.rotate((camera.roll_deg - side * own.camera.roll_deg) * Math.PI / 180);
  context.scale(side, 1);
  context.drawImage(picture, -picture.width / 2, -picture.height / 2);
}

const FACING_FROM = { image: "from the photograph", motion: "from the walk", none: "a silhouette cannot tell" };

/** What is known of a person, as pairs of term and text. */
function facts(found, { source, camera }) {
  const front = found.facing.front_probability;
  const towards = front >= 0.5;
  const around = ((Math.round(camera.azimuth_deg) + 180) % 360) - 180;
  const side = around > 0 ? "the person’s left" : "the person’s right";
  return [
    ["Faces", `${towards ? "the camera" : "away"}, ${percent(towards ? front : 1 - front)} sure `
      + `(${FACING_FROM[found.facing.evidence]})`],
    ["Seen from", `${Math.abs(around)}° to ${side}, ${Math.round(camera.elevation_deg)}° above`],
    ["Motion", `clip ${source.clip}, frame ${source.frame}${source.mirrored ? ", mirrored" : ""}`],
    ["Body", source.subject],
    ["Found by", found.source + (found.detection_score === null ? "" : ` (${percent(found.detection_score)})`)],
    ["Cut out by", found.silhouette.segmenter + (found.silhouette.truncated ? ", cut off by the edge" : "")],
  ];
}

function showPose() {
  const found = state.answer.persons[state.person];
  const hypothesis = found?.hypotheses[state.hypothesis];
  $("pose").hidden = !hypothesis;
  if (hypothesis) {
    solid.show(hypothesis.joints_3d, state.answer.keypoints);
    $("facts").replaceChildren(...facts(found, hypothesis).flatMap(([term, text]) => [
      Object.assign(document.createElement("dt"), { textContent: term }),
      Object.assign(document.createElement("dd"), { textContent: text }),
    ]));
  }
  const { total, ...stages } = state.answer.timings_ms;
  $("timings").textContent = `${total.toFixed(0)} ms: ${Object.entries(stages)
    .map(([stage, ms]) => `${stage} ${ms.toFixed(1)}`).join(", ")}`;
  draw();
}

function draw() {
  if (!state.answer || !state.bitmap) return;
  const scene = {
    ...state,
    photo: state.bitmap,
    shown: {
      boxes: $("show-boxes").checked,
      silhouettes: $("show-silhouettes").checked,
      skeleton: $("show-skeleton").checked,
    },
  };
  drawStage($("stage"), scene);
  // Close up there is nobody else to be told from.
  drawCloseUp($("close-up"), { ...scene, shown: { ...scene.shown, boxes: false } });
}

/** Frames from the webcam, one after another, as fast as they are answered. */
async function toggleWebcam() {
  if (webcam) {
    webcam.getTracks().forEach((track) => track.stop());
    webcam = null;
    $("webcam").textContent = "Use the webcam";
    return;
  }
  try {
    webcam = await navigator.mediaDevices.getUserMedia({ video: { width: 640, height: 480 } });
  } catch (error) {
    complain(new Error(`The webcam cannot be used: ${error.message || error}`));
    return;
  }
  $("webcam").textContent = "Stop the webcam";
  const video = $("video");
  video.srcObject = webcam;
  await video.play();
  const shot = document.createElement("canvas");
  while (webcam) {
    Object.assign(shot, { width: video.videoWidth, height: video.videoHeight });
    shot.getContext("2d").drawImage(video, 0, 0);
    const blob = await new Promise((done) => shot.toBlob(done, "image/jpeg", 0.9));
    await ask({ frame: new File([blob], "webcam.jpg", { type: "image/jpeg" }), sameScene: true });
    await new Promise((wake) => setTimeout(wake, 150));
  }
}

async function copy(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    $("copied").textContent = `${what} copied`;
  } catch {
    // Browsers give pages without TLS no clipboard: select it, for Ctrl+C.
    getSelection().selectAllChildren($("curl"));
    $("copied").textContent = "press Ctrl+C";
  }
}

/** What was dropped, pasted or chosen: a photograph, and what other files are named for. */
function take(files) {
  const images = [...files].filter((file) => file.type.startsWith("image/") || !file.type);
  const named = (word) => images.find((file) => images.length > 1 && word.test(file.name));
  const mask = named(/mask/i);
  const background = mask ? undefined : named(/background/i);
  const frame = images.find((file) => file !== mask && file !== background);
  if (frame) ask({ frame, mask, background });
  else if (files.length) complain(new Error("That is no picture file."));
}

$("file").addEventListener("change", () => {
  take($("file").files);
  $("file").value = "";
});
$("drop").addEventListener("keydown", (event) => {
  if (event.key === "Enter" || event.key === " ") {
    event.preventDefault();
    $("file").click();
  }
});
for (const kind of ["dragenter", "dragover"]) {
  addEventListener(kind, (event) => {
    event.preventDefault();
    $("drop").classList.add("over");
  });
}
addEventListener("dragleave", (event) => {
  if (!event.relatedTarget) $("drop").classList.remove("over");
});
addEventListener("drop", (event) => {
  event.preventDefault();
  $("drop").classList.remove("over");
  take(event.dataTransfer.files);
});
addEventListener("paste", (event) => take(event.clipboardData.files));
for (const id of ["count", "keypoints"]) {
  $(id).addEventListener("change", () => { if (state.upload) ask(state.upload); });
}
$("key-form").addEventListener("submit", (event) => event.preventDefault());
$("key").addEventListener("change", () => {
  complain(null);
  untilReady();
  if (state.upload) ask(state.upload);
});
for (const id of ["show-boxes", "show-silhouettes", "show-skeleton"]) $(id).addEventListener("change", draw);
$("stage").addEventListener("click", (event) => {
  const scale = $("stage").width / $("stage").clientWidth;
  const [x, y] = [event.offsetX * scale, event.offsetY * scale];
  const hit = state.answer?.persons.findIndex(({ box }) =>
    x >= box.x && x <= box.x + box.width && y >= box.y && y <= box.y + box.height) ?? -1;
  if (hit >= 0) {
    Object.assign(state, { person: hit, hypothesis: 0 });
    showPersons();
  }
});
$("webcam").addEventListener("click", toggleWebcam);
$("straight").addEventListener("click", () => {
  $("spin").checked = false;
  solid.straighten();
});
$("copy-curl").addEventListener("click", () => copy($("curl").textContent, "Command"));
$("copy-json").addEventListener("click", () => copy(JSON.stringify(state.answer, null, 2), "Answer"));

// Turning shows the depth; who asked for less motion turns it by hand.
$("spin").checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
requestAnimationFrame(function step() {
  if ($("spin").checked && state.answer) solid.turn(0.012, 0);
  requestAnimationFrame(step);
});
untilReady();
