// The debug page: shows the service's answer to a photograph or a video.

import { $, sentence } from "./dom.js";
import { onFiles, sorted, whichIsEmpty } from "./intake.js";
import { apiKey, askForKey, keyIsAccepted, onKey } from "./key.js";
import { about, complain, onDismiss, tell, working } from "./notices.js";
import { prepare } from "./photograph.js";
import { PhotographView } from "./photograph_view.js";
import { curlCommand, describeIndex, download, estimatePose } from "./service.js";
import { VideoView } from "./video_view.js";

const photograph = new PhotographView(apiKey);
const video = new VideoView({ options, refused: report, begins: showVideo });

// The upload of the last request, and the means to abort it.
let latest = null;
let asking = null;

function options() {
  return {
    count: Number($("count").value),
    keypoints: $("keypoints").value,
    evidence: $("evidence").value,
    key: apiKey(),
    keyed: Boolean(apiKey()),
  };
}

/** Show an error, or ask for the key if that is what is missing. */
function report(error, again = null) {
  if (error.status === 401) {
    complain(null);
    askForKey();
  } else {
    complain(error, again);
  }
}

/** Clamp the number of hypotheses to its limits; returns a note if it has changed. */
function limitCount() {
  const { value, min, max, defaultValue } = $("count");
  const count = value ? Math.min(Number(max), Math.max(Number(min), Math.round(Number(value)))) : defaultValue;
  $("count").value = count;
  return value && Number(value) !== Number(count)
    ? `The number of hypotheses is ${min} to ${max}: ${count} instead of ${value}.` : "";
}

/** Wait until the service answers; false if it wants another key. */
async function isReady() {
  for (;;) {
    try {
      const index = await describeIndex(apiKey());
      $("index").textContent = `${index.name}: ${index.entries.toLocaleString("en")} silhouettes, `
        + `${index.actions.length} kinds of action.`;
      $("attribution").textContent = index.attribution;
      keyIsAccepted();
      working("");
      return true;
    } catch (error) {
      working(error.status === 401 ? "" : sentence(error.message));
      if (error.status === 401) askForKey();
      if (error.status !== 503 && error.status !== 0) return false;
    }
    await new Promise((wake) => setTimeout(wake, 1000));
  }
}

/** Begin with the example, or with what was refused for want of a key. */
async function begin() {
  if (!await isReady() || video.again()) return;
  if (latest) ask(latest);
  else tryExample();
}

/** Send a photograph, perhaps with a mask, and show the answer. */
async function ask(upload) {
  asking?.abort();
  asking = new AbortController();
  const { signal } = asking;
  latest = upload;
  video.stop();
  const notes = [upload.note, limitCount()];
  const chosen = options();
  const { otherwise } = upload;
  const action = otherwise && { label: otherwise.label, run: () => ask(otherwise.upload) };
  complain(null);
  tell(notes, action);
  working("Looking for people …");
  try {
    if (upload.address) upload.frame = await download(upload.address);
    upload.prepared ??= prepare(upload);
    const prepared = await upload.prepared;
    const answered = await estimatePose(prepared.files, { ...chosen, signal });
    if (signal.aborted) return;
    video.hide();
    $("count-label").hidden = false;
    photograph.show(upload, prepared, answered, curlCommand(upload, chosen));
    notes.push(...(answered.image.warnings ?? []).map((warning) => `About the picture: ${warning}.`));
    if (!answered.persons.length) {
      notes.push("Nobody was found in this photograph. A second file, a mask, can mark the people.");
    }
    tell(notes, action);
    working("");
  } catch (error) {
    if (signal.aborted) return;
    working("");
    report(about(error, upload), () => ask(upload));
    photograph.setStale(true);
    if (photograph.upload && !$("result").hidden) {
      tell([...notes, "Below is still the answer before this one."], action);
    }
  }
}

/** Make room for a video once its first frame is answered; until then the last result stays. */
function showVideo() {
  asking?.abort();
  latest = null;
  photograph.hide();
  $("count-label").hidden = true;
}

/** Take files that were dropped, pasted or chosen. */
async function take(files) {
  if (!files.length) return;
  complain(null);
  try {
    const upload = await sorted(files, whichIsEmpty);
    if (upload?.video) {
      asking?.abort();
      video.play(upload.video, upload.note);
    } else if (upload) {
      ask(upload);
    }
  } catch (error) {
    complain(error);
  }
}

function tryExample() {
  ask({ address: "static/example.jpg", note: "An example from a public data set, PETS 2009." });
}

onFiles(take);
onDismiss(() => {
  photograph.setStale(false);
  tell([]);
});
onKey(() => {
  complain(null);
  begin();
});
$("example").addEventListener("click", tryExample);
$("webcam").addEventListener("click", () => video.toggleWebcam());
for (const id of ["count", "keypoints", "evidence"]) {
  $(id).addEventListener("change", () => {
    if (latest) ask(latest);
    else tell([limitCount()]);
  });
}
begin();
