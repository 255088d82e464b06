// Calls to the service. Paths are relative, so the page also works behind a proxy's prefix.

export class Problem extends Error {
  constructor(problem, retryAfterS = 0) {
    super(problem.detail || problem.title);
    this.status = problem.status;
    this.retryAfterS = retryAfterS;
  }
}

async function answer(path, options = {}, key = "") {
  const headers = key ? { "X-API-Key": key } : {};
  let response;
  try {
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

function form({ frame, mask, background }) {
  const data = new FormData();
  data.append("frame", frame, frame.name || "photo.jpg");
  if (mask) data.append("mask", mask, mask.name);
  if (background) data.append("background", background, background.name);
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

export function curlCommand({ frame, mask, background }, { keyed, ...chosen }) {
  const url = new URL(posePath(chosen), document.baseURI);
  const part = (field, file) => `-F '${`${field}=@${file.name || "photo.jpg"}`.replaceAll("'", "'\\''")}' `;
  return `curl ${keyed ? "-H \"X-API-Key: $KEY\" " : ""}${part("frame", frame)}`
    + `${mask ? part("mask", mask) : ""}${background ? part("background", background) : ""}'${url}'`;
}

export function videoCommand({ name }) {
  const url = new URL("sequence", document.baseURI);
  return `curl -N -F 'video=@${name.replaceAll("'", "'\\''")}' '${url}'`;
}
