// node generate.mjs openapi.json api.ts: types from the contract; files are Blobs, as in its manual.
import { readFileSync, writeFileSync } from "node:fs";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const BLOB = ts.factory.createTypeReferenceNode("Blob");
const [source, target] = process.argv.slice(2);

const types = await openapiTS(JSON.parse(readFileSync(source, "utf8")), {
  transform: (schema) => (schema.format === "binary" ? BLOB : undefined),
});
writeFileSync(target, astToString(types));
