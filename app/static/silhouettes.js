// Silhouettes of an answer as a picture in colours.

import { personColour } from "./skeleton.js";

/** Decode run lengths from pycocotools' string. */
function runLengths(counts) {
  const lengths = [];
  let number = 0, shift = 0;
  for (const character of counts) {
    const bits = character.charCodeAt(0) - 48;
    number |= (bits & 31) << shift;
    shift += 5;
    if (bits & 32) continue;
    if (bits & 16) number |= -1 << shift;
    lengths.push(number + (lengths.length > 2 ? lengths.at(-2) : 0));
    number = shift = 0;
  }
  return lengths;
}

/** Draw the silhouettes of an answer in their persons' colours, on a canvas of the frame's size. */
export function tint({ image: { width, height }, persons }) {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  persons.forEach(({ silhouette }, number) => {
    const [red, green, blue] = [1, 3, 5].map((i) => parseInt(personColour(number).slice(i, i + 2), 16));
    // 30 %: the person beneath stays visible.
    const colour = (77 << 24) | (blue << 16) | (green << 8) | red;
    let start = 0;
    runLengths(silhouette?.rle?.counts ?? "").forEach((length, run) => {
      const end = start + length;
      // Alternately outside and inside, down the columns.
      for (let at = start; run % 2 && at < end; at += 1) {
        pixels[(at % height) * width + Math.floor(at / height)] = colour;
      }
      start = end;
    });
  });
  context.putImageData(image, 0, 0);
  return canvas;
}
