// The debug page: shows the service's answer to a photograph or a video.

import {
  drawCloseUp, drawStage, drawThumbnail, fitted, personColour, Solid, tint,
} from "./drawing.js";
import { inPixelsOf, prepare } from "./photograph.js";
import {
  curlCommand, describeEntry, describeIndex, entrySilhouette, estimatePose,
} from "./service.js";
import { SessionView } from "./session_view.js";

const $ = (id) => document.getElementById(id);
const solid = new Solid($("solid"));

// Everything on show: the upload, the answer, and the current choice.
const state = { upload: null, bitmap: null, answer: null, silhouettes: null, person: 0, hypothesis: 0 };
// The upload of the last request, and the means to abort it.
let latest = null;
let asking = null;

const film = new SessionView({ options: () => options(), complain, tell, bringIntoView });

const options = () => ({
  count: Number($("count").value),
  keypoints: $("keypoints").value,
  evidence: $("evidence").value,
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

/** Show notes that are not errors. */
function tell(notes) {
  const texts = notes.filter(Boolean);
  $("note").hidden = !texts.length;
  $("note").textContent = texts.join(" ");
}

/** Clamp the number of hypotheses to its limits; returns a note if it has changed. */
function limitCount() {
  const { value, min, max, defaultValue } = $("count");
  const count = value ? Math.min(Number(max), Math.max(Number(min), Math.round(Number(value)))) : defaultValue;
  $("count").value = count;
  return value && Number(value) !== Number(count)
    ? `The number of hypotheses is ${min} to ${max}: ${count} instead of ${value}.` : "";
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

/** Send a photograph, perhaps with a mask, and show the answer. */
async function ask(upload) {
  asking?.abort();
  asking = new AbortController();
  const { signal } = asking;
  latest = upload;
  showFilm(false);
  const notes = [upload.note, limitCount()];
  const chosen = options();
  complain(null);
  tell(notes);
  working(true);
  try {
    upload.prepared ??= prepare(upload);
    const { bitmap, files, original } = await upload.prepared;
    const answered = await estimatePose(files, { ...chosen, signal });
    if (signal.aborted) return;
    const isNew = upload !== state.upload;
    show(upload, bitmap, answered, original);
    $("curl").textContent = curlCommand(upload, chosen);
    if (!answered.persons.length) {
      notes.push("Nobody was found in this photograph. A second file, named …mask…, can mark the people.");
    }
    tell(notes);
    working(false);
    if (isNew && answered.persons.length) bringIntoView($("result"));
  } catch (error) {
    if (signal.aborted) return;
    working(false);
    complain(error);
    setStale(true);
    if (state.answer) tell([...notes, "Below is still the answer before this one."]);
  }
}

/** Switch between a video's session and a photograph. */
function showFilm(whether) {
  $("count-label").hidden = whether;
  if (!whether) {
    film.hide();
    return;
  }
  asking?.abort();
  latest = null;
  complain(null);
  working(false);
  $("result").hidden = true;
  document.body.classList.add("has-result");
}

function working(whether) {
  $("result").classList.toggle("busy", whether);
  $("busy").hidden = !whether;
}

/** Show an answer in pixels of the photograph, even if a smaller copy was sent. */
function show(upload, bitmap, answered, original) {
  const silhouettes = tint(answered);
  // As the displayed command would return it, which requests no silhouettes.
  for (const { silhouette } of answered.persons) if (silhouette) silhouette.rle = null;
  const answer = original ? inPixelsOf(original, answered) : answered;
  Object.assign(state, { upload, bitmap, answer, silhouettes, person: largest(answer.persons), hypothesis: 0 });
  state.sent = original && answered.image;
  $("result").hidden = false;
  document.body.classList.add("has-result");
  setStale(false);
  showPersons();
}

/** Mark the shown answer as out of date: dimmed and inert. */
function setStale(stale) {
  $("result").classList.toggle("stale", stale);
  $("result").inert = stale;
}

/** Scroll to the result, which starts below the fold on a narrow screen. */
function bringIntoView(result) {
  if (!matchMedia("(max-width: 44rem)").matches) return;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  ($("note").hidden ? result : $("note")).scrollIntoView({ behavior: still ? "auto" : "smooth" });
}

/** The person to select first: the one nearest to the camera. */
function largest(persons) {
  const heights = persons.map(({ box }) => box.height);
  return Math.max(0, heights.indexOf(Math.max(...heights)));
}

/** A group of radio buttons, which bring arrow keys, focus and screen readers along. */
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
    { textContent: `${hypothesis.rank}. ${percent(hypothesis.confidence)} sure` });
  const sure = Object.assign(document.createElement("meter"),
    { min: 0, max: 1, value: hypothesis.confidence, title: "confidence: how probably the joints are right" });
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
    line("outline error", `${hypothesis.reprojection_error_px.toFixed(1)} px`),
    pictures,
    line("entry", hypothesis.entry));
  return box;
}

/** The entry's silhouette as the hypothesis uses it: mirrored, and rotated as the person leans. */
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

const FACING_FROM = { image: "from the photograph", none: "a silhouette cannot show it" };

const FOUND_BY = {
  detector: "the detector", mask: "your mask", boxes: "your boxes", background: "the difference to your background",
};

/** Measurements of a person, as pairs of term and text. */
function measured({ box, source, detection_score: score, silhouette, observed_keypoints: seen, facing, posture }) {
  const towards = facing.front_probability >= 0.5;
  const sure = towards ? facing.front_probability : 1 - facing.front_probability;
  return [
    ["Faces", `${towards ? "the camera" : "away"}, ${percent(sure)} sure (${FACING_FROM[facing.evidence]})`],
    ["Posture", posture.label.replace("_", " ")
      + (posture.label === "unclear" ? "" : `, ${percent(posture.probability)} sure`)],
    ["Size", `${Math.round(box.width)} × ${Math.round(box.height)} px, silhouette ${silhouette.area_px.toLocaleString("en")} px`
      + (silhouette.truncated ? ", cut off" : "")],
    ["Keypoints", seen ? `${seen.filter(Boolean).length} of ${seen.length} seen` : "not read"],
    ["Found by", FOUND_BY[source] + (score === null ? "" : ` (${percent(score)})`)],
    ["Cut out by", silhouette.segmenter],
  ];
}

const HEIGHTS = [[-3, "from below"], [10, "level"], [30, "from slightly above"], [55, "from above"]];

/** A camera's elevation in words. */
const height = (degrees) =>
  `${(HEIGHTS.find(([most]) => degrees < most) ?? [, "from high above"])[1]} (${Math.round(degrees)}°)`;

/** A hypothesis and its source, as pairs of term and text. */
function supposed({ confidence, reprojection_error_px: error, posture, entry, source, camera }) {
  const around = ((Math.round(camera.azimuth_deg) + 180) % 360) - 180;
  const side = around > 0 ? "the person’s left" : "the person’s right";
  return [
    ["Confidence", `${percent(confidence)} that its joints are right`],
    ["Posture", posture.replace("_", " ")],
    ["Outline", `${error.toFixed(1)} px from the entry’s on average, in 128 × 48`],
    ["Seen from", `${Math.abs(around)}° to ${side}, ${height(camera.elevation_deg)}`],
    ["Entry", `${entry}: body ${source.subject}, clip ${source.clip}, frame ${source.frame}`
      + (source.mirrored ? ", mirrored" : "")],
    ["Its clip", `${source.action}, which need not be what this person does`],
  ];
}

function showTerms(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([term, text]) => [
    Object.assign(document.createElement("dt"), { textContent: term }),
    Object.assign(document.createElement("dd"), { textContent: text }),
  ]));
}

function showPose() {
  const found = state.answer.persons[state.person];
  const hypothesis = found?.hypotheses[state.hypothesis];
  $("pose").hidden = $("terms").hidden = !hypothesis;
  if (hypothesis) {
    solid.show(hypothesis.joints_3d, state.answer.keypoints);
    showTerms($("facts"), measured(found));
    showTerms($("supposed"), supposed(hypothesis));
  }
  const { total, ...stages } = state.answer.timings_ms;
  $("timings").textContent = `${total.toFixed(0)} ms: ${Object.entries(stages)
    .map(([stage, ms]) => `${stage} ${ms.toFixed(1)}`).join(", ")}`
    + (state.sent ? `; sent at ${state.sent.width} × ${state.sent.height}` : "");
  draw();
}

function draw() {
  if (!state.answer) return;
  const scene = {
    ...state,
    photo: state.bitmap,
    shown: {
      boxes: $("show-boxes").checked,
      silhouettes: $("show-silhouettes").checked,
      skeleton: $("show-skeleton").checked,
      observed: $("show-observed").checked,
      numbers: true,
    },
  };
  drawStage($("stage"), scene);
  // In the close-up, there is no other person to distinguish.
  drawCloseUp($("close-up"), { ...scene, shown: { ...scene.shown, boxes: false, numbers: false } });
}

async function copy(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    $("copied").textContent = `${what} copied`;
  } catch {
    // Pages without TLS have no clipboard: select the text for Ctrl+C.
    getSelection().selectAllChildren($("curl"));
    $("copied").textContent = "press Ctrl+C";
  }
}

const isVideo = ({ type, name }) => type.startsWith("video/")
  || (!type && /\.(avi|flv|m4v|mkv|mov|mp4|mpe?g|ogv|ts|webm|wmv)$/i.test(name));

const leftOut = (files, shown) => {
  const names = [...files].filter((file) => !shown.includes(file)).map(({ name }) => name);
  return names.length
    ? `One photograph or video at a time: ${shown[0].name} is shown, ${names.join(", ")} left out.` : "";
};

/** Sort the dropped, pasted or chosen files: a video, or a photograph with a mask or background. */
function take(files) {
  if (!files.length) return;
  const video = [...files].find(isVideo);
  if (video) {
    showFilm(true);
    film.playFile(video, leftOut(files, [video]));
    return;
  }
  const images = [...files].filter((file) => file.type.startsWith("image/") || !file.type);
  const named = (word) => images.length > 1 ? images.find((file) => word.test(file.name)) : undefined;
  const mask = named(/mask/i);
  const plate = named(/background/i);
  const frame = images.find((file) => file !== mask && file !== plate);
  if (!frame) {
    complain(new Error(images.length
      ? "A photograph of people is missing beside the mask or background." : "That is neither a picture nor a video."));
    return;
  }
  // A mask marks the people, so a background adds nothing.
  const background = mask ? undefined : plate;
  ask({ frame, mask, background, note: leftOut(files, [frame, mask, background]) });
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
for (const id of ["count", "keypoints", "evidence"]) {
  $(id).addEventListener("change", () => {
    if (latest) ask(latest);
    else tell([limitCount()]);
  });
}
$("key-form").addEventListener("submit", (event) => event.preventDefault());
$("key").addEventListener("change", () => {
  complain(null);
  untilReady();
  if (latest) ask(latest);
  else film.again();
});
for (const id of ["show-boxes", "show-silhouettes", "show-skeleton", "show-observed"]) {
  $(id).addEventListener("change", draw);
}
addEventListener("resize", draw);
$("stage").addEventListener("click", (event) => {
  const { scale, left, top } = fitted($("stage"), state.answer.image);
  const [x, y] = [(event.offsetX - left) / scale, (event.offsetY - top) / scale];
  const hit = state.answer.persons.findIndex(({ box }) =>
    x >= box.x && x <= box.x + box.width && y >= box.y && y <= box.y + box.height);
  if (hit >= 0) {
    Object.assign(state, { person: hit, hypothesis: 0 });
    showPersons();
  }
});
$("webcam").addEventListener("click", () => {
  if (film.isLive) {
    film.stop();
  } else {
    showFilm(true);
    film.playWebcam();
  }
});
$("straight").addEventListener("click", () => {
  $("spin").checked = false;
  solid.straighten();
});
$("copy-curl").addEventListener("click", () => copy($("curl").textContent, "Command"));
$("copy-json").addEventListener("click", () => copy(JSON.stringify(state.answer, null, 2), "Answer"));

// Rotation shows depth; with reduced motion, the user rotates by hand.
$("spin").checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
requestAnimationFrame(function step() {
  if ($("spin").checked && state.answer) solid.turn(0.012, 0);
  requestAnimationFrame(step);
});
untilReady();
