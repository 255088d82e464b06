// Drawing on top of a photograph or a frame: silhouettes, boxes, skeletons, keypoints and labels.

import { drawFlat, isUnsure, personColour } from "./skeleton.js";

const OBSERVED = "#ffffff";

/** In place of a photograph that the browser cannot show, or that was not sent. */
const NO_PHOTOGRAPH = "#5d6a6d";

/** Colour of a single frame's skeletons beside smoothed ones. */
const SINGLE_FRAME = "#ffffff";

/** Draw the keypoints observed in the photograph. */
function drawObserved(context, keypoints, radius) {
  context.fillStyle = OBSERVED;
  context.strokeStyle = "rgb(0 0 0 / 0.75)";
  context.lineWidth = radius / 2;
  for (const point of keypoints ?? []) {
    if (!point) continue;
    context.beginPath();
    context.arc(point.x + 0.5, point.y + 0.5, radius, 0, 2 * Math.PI);
    context.stroke();
    context.fill();
  }
}

function drawBackground(context, photo, { width, height }) {
  context.fillStyle = NO_PHOTOGRAPH;
  context.fillRect(0, 0, width, height);
  if (photo) context.drawImage(photo, 0, 0, width, height);
}

/** Draw what `shown` lists, in pixels of the photograph; `line` is the width of a line on the screen. */
function drawLayers(context, { photo, answer, silhouettes, person, hypothesis, shown }, line) {
  const { width, height } = answer.image;
  drawBackground(context, photo, answer.image);
  if (shown.silhouettes && silhouettes) context.drawImage(silhouettes, 0, 0, width, height);
  answer.persons.forEach((found, number) => {
    const chosen = number === person;
    const bone = boneWidth(found.box, line);
    if (shown.boxes) drawBox(context, found.box, personColour(number), chosen ? line * 2 : line);
    const pose = found.hypotheses[chosen ? hypothesis : 0];
    if (shown.skeleton && pose) {
      const unsure = isUnsure(pose, found.observed_keypoints);
      drawFlat(context, pose.joints_2d, answer.keypoints, fromCorners, bone, null, unsure);
    }
    if (shown.observed) drawObserved(context, found.observed_keypoints, 0.8 * bone);
  });
  if (!shown.numbers) return;
  drawLabels(context, answer.image, line, answer.persons.map(({ box }, number) =>
    ({ text: String(number + 1), at: [box.x, box.y], colour: personColour(number) })));
}

/**
 * The place nearest to a label's own that is inside the picture and free of others.
 * @param label Its edges, `{x, y, width, height}`.
 * @param others The labels placed before.
 */
export function freePlace({ x, y, width, height }, others, picture) {
  const meets = (left, top) => others.some((other) => left < other.x + other.width && other.x < left + width
    && top < other.y + other.height && other.y < top + height);
  const inside = (at, size, room) => Math.max(0, Math.min(room - size, at));
  const start = { x: inside(x, width, picture.width), y: inside(y, height, picture.height), width, height };
  for (let ring = 0; ring * height < picture.height; ring += 1) {
    for (const [across, down] of [[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]) {
      const left = inside(start.x + across * ring * width, width, picture.width);
      const top = inside(start.y + down * ring * height, height, picture.height);
      if (!meets(left, top)) return { ...start, x: left, y: top };
    }
  }
  return start;
}

/** Draw labels `{text, at, colour}` above their points, none on top of another. */
function drawLabels(context, picture, line, labels) {
  context.font = `700 ${line * 9}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  const drawn = [];
  for (const { text, at: [x, y], colour } of labels) {
    const [width, height] = [context.measureText(text).width + 5 * line, 10 * line];
    const place = freePlace({ x, y: y - height, width, height }, drawn, picture);
    drawn.push(place);
    context.fillStyle = colour;
    context.fillRect(place.x, place.y, width, height);
    context.fillStyle = "#10181b";
    context.fillText(text, place.x + 2.5 * line, place.y + 0.55 * height);
  }
}

function drawBox(context, { x, y, width, height }, colour, line) {
  context.strokeStyle = colour;
  context.lineWidth = line;
  // The service counts from pixel centres, a canvas from pixel corners.
  context.strokeRect(x + 0.5, y + 0.5, width, height);
}

const fromCorners = ({ x, y }) => [x + 0.5, y + 0.5];

/** Width of bones: visible, but not hiding a small person. */
const boneWidth = (box, line) => Math.max(Math.min(2 * line, box.height / 30), box.height / 70);

/** Placement of an image that fits into a canvas: screen pixels per image pixel, and its edges. */
export function fitted(canvas, { width, height }) {
  const scale = Math.min(canvas.clientWidth / width, canvas.clientHeight / height) || 1;
  return {
    scale,
    left: (canvas.clientWidth - width * scale) / 2,
    top: (canvas.clientHeight - height * scale) / 2,
  };
}

/** Position of a pointer event on an image's canvas, `[x, y]` in pixels of the image. */
export function pointAt({ offsetX, offsetY }, canvas, image) {
  const { scale, left, top } = fitted(canvas, image);
  return [(offsetX - left) / scale, (offsetY - top) / scale];
}

/** The first person whose box holds a point. */
export const personAt = ([x, y], persons) => persons.findIndex(({ box }) =>
  x >= box.x && x <= box.x + box.width && y >= box.y && y <= box.y + box.height);

/** Draw the whole photograph with the people found in it. */
export function drawStage(canvas, scene) {
  const { width, height } = scene.answer.image;
  // More pixels than were sent add nothing, and some phones lack the memory.
  const scale = scene.photo ? Math.min(1, scene.photo.width / width) : 1;
  const size = { width: Math.round(width * scale), height: Math.round(height * scale) };
  if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  drawLayers(context, scene, 1.6 / fitted(canvas, scene.answer.image).scale);
}

/** Draw a camera's frame with its zones, and the boxes and skeletons of its tracks that `shown` lists. */
export function drawTracks(canvas, { photo, answer, shown, chosen, zones = [] }) {
  const { width, height } = answer.image;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  drawBackground(context, photo, answer.image);
  const line = 1.6 / fitted(canvas, answer.image).scale;
  for (const zone of zones) drawZone(context, zone, line);
  for (const { box, track_id: id, pose, hypotheses, source, observed_keypoints: observed } of answer.persons) {
    // A hidden person is only predicted there.
    context.globalAlpha = source === "track" ? 0.4 : 1;
    const bone = boneWidth(box, line);
    if (shown.boxes) drawBox(context, box, personColour(id - 1), id === chosen ? 2 * line : line);
    const draw = (joints, plain, unsure) => {
      drawFlat(context, joints, answer.keypoints, fromCorners, bone, plain, unsure);
    };
    if (shown.raw && hypotheses.length) draw(hypotheses[0].joints_2d, shown.smoothed ? SINGLE_FRAME : undefined);
    if (shown.smoothed && pose) draw(pose.joints_2d, undefined, isUnsure(pose, observed));
  }
  context.globalAlpha = 1;
  drawLabels(context, answer.image, line, [
    ...answer.persons.map(({ box, track_id: id }) =>
      ({ text: String(id), at: [box.x, box.y], colour: personColour(id - 1) })),
    ...zones.filter(({ name }) => name).map(({ name, kind, polygon }) =>
      ({ text: name, at: polygon[0], colour: ZONES[kind] })),
  ]);
}

const ZONES = { rest: "#7cc4ff", watch: "#ffd34d" };

/** Draw a zone; an unfinished one is open, with its corners and the cursor of the keyboard marked. */
function drawZone(context, { kind, polygon, open = false, cursor }, line) {
  if (open && cursor) {
    const [x, y] = cursor;
    context.strokeStyle = ZONES[kind];
    context.lineWidth = 1.5 * line;
    context.strokeRect(x - 5 * line, y - 5 * line, 10 * line, 10 * line);
  }
  if (!polygon.length) return;
  context.beginPath();
  for (const [x, y] of polygon) context.lineTo(x + 0.5, y + 0.5);
  if (!open) context.closePath();
  const colour = ZONES[kind];
  context.fillStyle = `${colour}33`;
  if (polygon.length > 2) context.fill();
  context.strokeStyle = "rgb(0 0 0 / 0.6)";
  context.lineWidth = 2.2 * line;
  context.stroke();
  context.strokeStyle = colour;
  context.lineWidth = 1.2 * line;
  context.stroke();
  context.fillStyle = colour;
  for (const [x, y] of open ? polygon : []) {
    context.beginPath();
    context.arc(x + 0.5, y + 0.5, 3 * line, 0, 2 * Math.PI);
    context.fill();
  }
}

/** Draw the chosen person, filling the canvas: people in a street are small. */
export function drawCloseUp(canvas, scene) {
  const context = canvas.getContext("2d");
  context.resetTransform();
  context.clearRect(0, 0, canvas.width, canvas.height);
  const found = scene.answer.persons[scene.person];
  if (!found) return;
  const { x, y, width, height } = found.box;
  const scale = Math.min(canvas.width / (1.3 * width), canvas.height / (1.25 * height));
  const [left, top] = [x + width / 2 - canvas.width / scale / 2, y + height / 2 - canvas.height / scale / 2];
  context.setTransform(scale, 0, 0, scale, -left * scale, -top * scale);
  drawLayers(context, scene, 2.5 / scale);
}
