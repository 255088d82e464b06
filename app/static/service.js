// Calls to the service. Paths are relative, so the page also works behind a proxy's prefix.

export class Problem extends Error {
  constructor(problem, retryAfterS = 0) {
    super(problem.detail || problem.title || `the service answered with status ${problem.status}`);
    this.status = problem.status;
    this.retryAfterS = retryAfterS;
  }
}

async function answer(path, options = {}, key = "") {
  let response;
  try {
    const headers = { ...options.headers, ...key ? { "X-API-Key": key } : {} };
    response = await fetch(path, { ...options, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem({ status: 0, detail: "the service does not answer" });
  }
  if (response.ok) return response;
  let problem = { status: response.status, detail: response.statusText };
  try {
    problem = { ...problem, ...await response.json() };
  } catch { /* A proxy has answered instead of the service. */ }
  throw new Problem(problem, Number(response.headers.get("Retry-After")) || 0);
}

/** A file of the page's own. */
export async function download(address) {
  const blob = await (await answer(address)).blob();
  return new File([blob], address.split("/").at(-1), { type: blob.type });
}

function form(files) {
  const data = new FormData();
  for (const field of ["frame", "mask", "background"]) {
    const file = files[field];
    if (file) data.append(field, file, file.name || "photo.jpg");
  }
  return data;
}

export async function describeIndex(key) {
  return (await answer("index", {}, key)).json();
}

function query({ count, keypoints, evidence }) {
  const chosen = evidence === "photograph" ? "" : `&evidence=${evidence}`;
  return `n=${count}&keypoints=${keypoints}${chosen}`;
}

const posePath = (chosen) => `pose?${query(chosen)}`;

/** Request poses, with silhouettes as COCO's run lengths. */
export async function estimatePose(files, { key, signal, ...chosen }) {
  const path = `${posePath(chosen)}&silhouettes=rle`;
  return (await answer(path, { method: "POST", body: form(files), signal }, key)).json();
}

/** Send a frame of a camera; `session` is `new` if the camera starts afresh with it. */
export async function trackFrame(camera, jpeg, timestamp, { key, signal, ...chosen }) {
  const path = `cameras/${camera}/frames?timestamp=${timestamp}&${query({ ...chosen, count: 1 })}`;
  const response = await answer(path, { method: "POST", body: jpeg, signal }, key);
  return { ...await response.json(), session: response.headers.get("X-Session") };
}

/** Set all zones of a camera. */
export async function setZones(camera, zones, key) {
  const body = JSON.stringify({ zones });
  await answer(`cameras/${camera}`, { method: "PUT", body, headers: { "Content-Type": "application/json" } }, key);
}

/** The answers to the frames of a video as they come, and the line that ends them. */
export async function* analyseVideo(video, { key, signal, ...chosen }) {
  const body = new FormData();
  body.append("video", video, video.name);
  const path = `sequence?${query({ ...chosen, count: 1 })}`;
  const response = await answer(path, { method: "POST", body, signal }, key);
  for await (const line of linesOf(response.body)) yield JSON.parse(line);
}

async function* linesOf(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read().catch((error) => {
      if (error.name === "AbortError") throw error;
      throw new Problem({ status: 0, detail: "the service broke off its answer" });
    });
    if (done) break;
    const lines = (rest + value).split("\n");
    rest = lines.pop();
    yield* lines.filter(Boolean);
  }
  if (rest) yield rest;
}

/** End a camera session, even while the page is being left. */
export async function forgetCamera(camera, key) {
  await answer(`cameras/${camera}`, { method: "DELETE", keepalive: true }, key).catch(() => {});
}

export async function describeEntry(entry, key) {
  return (await answer(`index/entries/${entry}`, {}, key)).json();
}

export async function entrySilhouette(entry, key) {
  return (await answer(`index/entries/${entry}/silhouette.png`, {}, key)).blob();
}

const quoted = (text) => `'${text.replaceAll("'", "'\\''")}'`;

/** The same request as a command for a shell, after the download of a file that has an address; the
 * key stays out of it. */
export function curlCommand(files, { keyed, ...chosen }) {
  const url = new URL(posePath(chosen), document.baseURI);
  const parts = ["frame", "mask", "background"].filter((field) => files[field])
    .map((field) => `-F ${quoted(`${field}=@${files[field].name || "photo.jpg"}`)} `);
  const fetched = files.address
    ? `curl -O ${quoted(new URL(files.address, document.baseURI).href)}\n` : "";
  return `${fetched}curl ${keyed ? '-H "X-API-Key: $KEY" ' : ""}${parts.join("")}'${url}'`;
}
