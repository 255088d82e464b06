// node client.js URL FRAME MASK: what a TypeScript backend does, checked by tsc --strict.
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

const [url, frame, mask] = process.argv.slice(2) as [string, string, string];
const client = createClient<paths>({ baseUrl: url, bodySerializer: form });
const upload: Upload = { frame: file(frame), mask: file(mask) };

const { data, error } = await client.POST("/pose", { body: upload, params: { query: { n: 3 } } });
if (data === undefined) throw new Error(error.detail);
const joint = data.persons[0]?.hypotheses[0]?.joints_2d?.[0];

// Everything but the frame may be left out.
const broken = await client.POST("/pose", { body: { frame: new Blob(["?"]) } });
const problem: components["schemas"]["Problem"] | undefined = broken.error;
const picture = await client.POST("/pose/overlay", { body: upload, parseAs: "blob" });

console.log(
  JSON.stringify({
    entries: data.persons.map((person) => person.hypotheses.map((found) => found.entry)),
    x: joint?.x,
    field: problem?.field,
    picture: picture.data?.size,
  }),
);
