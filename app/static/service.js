// Calls to the service. Paths are relative, so the page also works behind a proxy's prefix.

export class Problem extends Error {
  constructor(problem) {
    super(problem.detail || problem.title);
    this.status = problem.status;
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
  } catch { /* Something between here and the service has answered. */ }
  throw new Problem(problem);
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

export async function estimatePose(upload, { count, keypoints, key, signal }) {
  const path = `pose?n=${count}&keypoints=${keypoints}`;
  return (await answer(path, { method: "POST", body: form(upload), signal }, key)).json();
}

export async function extractSilhouettes(upload, { key, signal }) {
  return (await answer("silhouette", { method: "POST", body: form(upload), signal }, key)).blob();
}

export async function describeEntry(entry, key) {
  return (await answer(`index/entries/${entry}`, {}, key)).json();
}

export async function entrySilhouette(entry, key) {
  return (await answer(`index/entries/${entry}/silhouette.png`, {}, key)).blob();
}

export function curlCommand({ frame, mask, background }, { count, keypoints, keyed }) {
  const url = new URL(`pose?n=${count}&keypoints=${keypoints}`, document.baseURI);
  const part = (field, file) => `-F '${`${field}=@${file.name || "photo.jpg"}`.replaceAll("'", "'\\''")}' `;
  return `curl ${keyed ? "-H \"X-API-Key: $KEY\" " : ""}${part("frame", frame)}`
    + `${mask ? part("mask", mask) : ""}${background ? part("background", background) : ""}'${url}'`;
}
