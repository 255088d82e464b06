// node client.js URL FRAME MASK VIDEO: what a TypeScript backend does, checked by tsc --strict.
import { readFileSync } from "node:fs";
import createClient from "openapi-fetch";
import type { components, paths } from "./api.js";

type Upload = components["schemas"]["FrameUpload"];

function form(fields: object = {}): FormData {
  const data = new FormData();
  for (const [name, value] of Object.entries(fields)) {
    if (value !== undefined) data.append(name, value as Blob | string);
  }
  return data;
}

function file(path: string): Blob {
  return new Blob([new Uint8Array(readFileSync(path))]);
}

const [url, frame, mask, video] = process.argv.slice(2) as [string, string, string, string];
const client = createClient<paths>({ baseUrl: url, bodySerializer: form });
const upload: Upload = { frame: file(frame), mask: file(mask) };
const statuses: Record<string, number[]> = {};
client.use({
  onResponse({ schemaPath, response }) {
    (statuses[schemaPath] ??= []).push(response.status);
  },
});

await client.GET("/healthz");
await client.GET("/readyz");
await client.GET("/index");
const entry = { params: { path: { entry: 3 } } };
await client.GET("/index/entries/{entry}", entry);
await client.GET("/index/entries/{entry}/silhouette.png", { ...entry, parseAs: "blob" });
const { data, error } = await client.POST("/pose", { body: upload, params: { query: { n: 3 } } });
if (data === undefined) throw new Error(error.detail);
const joint = data.persons[0]?.hypotheses[0]?.joints_2d?.[0];
const picture = await client.POST("/pose/overlay", { body: upload, parseAs: "blob" });
await client.POST("/silhouette", { body: upload, parseAs: "blob" });
await client.POST("/v1/vision/detection", { body: { image: file(frame) } });

const camera = { params: { path: { camera_id: "typed" } } };
const polygon = [[0, 0], [320, 0], [320, 240], [0, 240]];
await client.PUT("/cameras/{camera_id}", {
  ...camera,
  body: { zones: [{ name: "wall", kind: "watch", polygon }] },
  bodySerializer: JSON.stringify,
});
const tracked = await client.POST("/cameras/{camera_id}/frames", { ...camera, body: upload });
await client.GET("/cameras/{camera_id}", camera);
await client.GET("/cameras/{camera_id}/events", camera);
await client.GET("/cameras");
await client.DELETE("/cameras/{camera_id}", camera);
await client.POST("/sequence", { body: { video: file(video) }, parseAs: "text" });
const answered = structuredClone(statuses);

const times: (number | undefined)[] = [];
for (const at of [0.25, 0.75, 1.25, 1.75].map((seconds) => 1795880000 + seconds)) {
  const reply = await client.POST("/cameras/{camera_id}/frames", {
    params: { path: { camera_id: "timed" } },
    body: { frame: file(frame), timestamp: at },
  });
  times.push(reply.data?.timestamp);
}

// Everything but the frame may be left out.
const broken = await client.POST("/pose", { body: { frame: new Blob(["?"]) } });
const problem: components["schemas"]["Problem"] | undefined = broken.error;

console.log(
  JSON.stringify({
    statuses: answered,
    entries: data.persons.map((person) => person.hypotheses.map((found) => found.entry)),
    x: joint?.x,
    zones: tracked.data?.persons[0]?.zones,
    times,
    field: problem?.field,
    picture: picture.data?.size,
  }),
);
