// Drawing on canvases: the photograph with the people found in it, and skeletons in two and three
// dimensions; independent of the service.

export const PEOPLE = [
  "#2f9bff", "#31c85f", "#ff7a45", "#e05fe0", "#e0c319", "#23c4c4",
  "#ff5c8a", "#9d7bff", "#b4dd3c", "#c98a5a", "#8fb8ff", "#ff9fd0",
];

const SIDES = { left: "#ff8a3c", right: "#3c9dff", middle: "#9fb3b8" };

const OBSERVED = "#ffffff";

/** Colour of a single frame's skeletons beside smoothed ones. */
const RAW = "#ffffff";

export const personColour = (number) => PEOPLE[number % PEOPLE.length];

function side(name) {
  if (name.startsWith("left_")) return "left";
  return name.startsWith("right_") ? "right" : "middle";
}

function bones(keypoints) {
  return keypoints.bones.map(({ parent, child }) => {
    const sides = [side(keypoints.names[parent]), side(keypoints.names[child])];
    return { parent, child, colour: SIDES[sides[0] === sides[1] ? sides[0] : sides.includes("left")
      && sides.includes("right") ? "middle" : sides.find((s) => s !== "middle")] };
  });
}

/** Probability below which a keypoint, or a whole pose, is drawn as unsure. */
const SURE = 0.5;

/** Whether a bone is unsure: the whole pose is, or one end is hardly visible. */
function isUnsure({ confidence }, observed) {
  const hidden = new Set((observed ?? []).filter((point) => point?.score < SURE).map(({ name }) => name));
  return (...ends) => confidence < SURE || ends.some((name) => hidden.has(name));
}

/** Draw a skeleton; `place` maps a joint to canvas pixels; `plain` is one colour for all bones;
 * `unsure` returns, for the names of a bone's ends, whether it is dashed. */
export function drawFlat(context, joints, keypoints, place, width, plain = null, unsure = () => false) {
  context.lineCap = "round";
  for (const pass of ["edge", "bone"]) {
    for (const { parent, child, colour } of bones(keypoints)) {
      if (!joints[parent] || !joints[child]) continue;
      context.strokeStyle = pass === "edge" ? "rgb(0 0 0 / 0.75)" : plain ?? colour;
      context.lineWidth = pass === "edge" ? width * 1.8 : width;
      const dashed = unsure(keypoints.names[parent], keypoints.names[child]);
      context.setLineDash(dashed ? [0.5 * width, 3 * width] : []);
      context.beginPath();
      context.moveTo(...place(joints[parent]));
      context.lineTo(...place(joints[child]));
      context.stroke();
    }
  }
  context.setLineDash([]);
}

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
    const colour = (115 << 24) | (blue << 16) | (green << 8) | red;
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

/** Photograph, silhouettes, boxes, skeletons and keypoints in pixels of the photograph, as
 * `shown` says; `line` is as wide as a line on the screen. */
function drawLayers(context, { photo, answer, silhouettes, person, hypothesis, shown }, line) {
  const { width, height } = answer.image;
  context.fillStyle = "#7d8a8c";
  context.fillRect(0, 0, width, height);
  if (photo) context.drawImage(photo, 0, 0, width, height);
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
  const labels = [];
  answer.persons.forEach(({ box }, number) => {
    drawLabel(context, box, String(number + 1), personColour(number), line, labels);
  });
}

/** Write a label above a person's box, or inside it at the edge of the frame or over another label.
 * @param labels The labels drawn before; this one is added. */
function drawLabel(context, { x, y }, text, colour, line, labels) {
  context.font = `700 ${line * 9}px system-ui, sans-serif`;
  context.lineJoin = "round";
  context.lineWidth = line * 2.5;
  context.strokeStyle = "rgb(0 0 0 / 0.8)";
  context.fillStyle = colour;
  const width = context.measureText(text).width;
  const covered = (bottom) => labels.some((other) => Math.abs(bottom - other.bottom) < line * 10
    && x < other.x + other.width && other.x < x + width);
  let bottom = Math.max(y - line * 2, line * 8);
  while (covered(bottom)) bottom += line * 10;
  labels.push({ x, width, bottom });
  const label = [text, x + 0.5, bottom];
  context.strokeText(...label);
  context.fillText(...label);
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

/** Placement of an image that fits into a canvas: screen pixels per image pixel, and the image's
 * edges. */
export function fitted(canvas, { width, height }) {
  const scale = Math.min(canvas.clientWidth / width, canvas.clientHeight / height) || 1;
  return {
    scale,
    left: (canvas.clientWidth - width * scale) / 2,
    top: (canvas.clientHeight - height * scale) / 2,
  };
}

/** Draw the whole photograph with the people found in it. */
export function drawStage(canvas, scene) {
  const { width, height } = scene.answer.image;
  // More pixels than were sent show nothing, and some phones lack the memory.
  const scale = scene.photo ? Math.min(1, scene.photo.width / width) : 1;
  const size = { width: Math.round(width * scale), height: Math.round(height * scale) };
  if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  drawLayers(context, scene, 1.6 / fitted(canvas, scene.answer.image).scale);
}

/** Draw a camera's frame with its tracks: boxes, and skeletons smoothed, of the frame, or both. */
export function drawTracks(canvas, { photo, answer, shown, chosen }) {
  const { width, height } = answer.image;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.drawImage(photo, 0, 0, width, height);
  const line = 1.6 / fitted(canvas, answer.image).scale;
  for (const { box, track_id: id, pose, hypotheses, source, observed_keypoints: observed } of answer.persons) {
    // A hidden person is only predicted there.
    context.globalAlpha = source === "track" ? 0.4 : 1;
    const bone = boneWidth(box, line);
    if (shown.boxes) drawBox(context, box, personColour(id - 1), id === chosen ? 2 * line : line);
    const draw = (joints, plain, unsure) => {
      drawFlat(context, joints, answer.keypoints, fromCorners, bone, plain, unsure);
    };
    if (shown.raw && hypotheses.length) draw(hypotheses[0].joints_2d, shown.smoothed ? RAW : undefined);
    if (shown.smoothed && pose) draw(pose.joints_2d, undefined, isUnsure(pose, observed));
  }
  context.globalAlpha = 1;
  const labels = [];
  for (const { box, track_id: id } of answer.persons) {
    drawLabel(context, box, String(id), personColour(id - 1), line, labels);
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

/** Draw a skeleton upright, filling a small card. */
export function drawThumbnail(canvas, joints, keypoints) {
  const known = joints.filter(Boolean);
  const xs = known.map((p) => p.x), ys = known.map((p) => p.y);
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  const [wide, tall] = [Math.max(...xs) - left || 1, Math.max(...ys) - top || 1];
  const scale = Math.min((canvas.width - 16) / wide, (canvas.height - 16) / tall);
  const place = ({ x, y }) => [canvas.width / 2 + (x - left - wide / 2) * scale,
    canvas.height / 2 + (y - top - tall / 2) * scale];
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  drawFlat(context, joints, keypoints, place, 4);
}

/** A skeleton in 3D that the user can rotate. */
export class Solid {
  constructor(canvas) {
    this.canvas = canvas;
    this.yaw = 0;
    this.pitch = 0;
    this.joints = [];
    this.keypoints = { names: [], bones: [] };
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      last = event;
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      this.turn((event.clientX - last.clientX) / 120, (event.clientY - last.clientY) / 200);
      last = event;
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => { last = null; });
    }
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
      if (!step[event.key]) return;
      event.preventDefault();
      this.turn(...step[event.key]);
    });
  }

  show(joints, keypoints) {
    Object.assign(this, { joints, keypoints });
    this.draw();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-0.9, Math.min(0.9, this.pitch + pitch));
    this.draw();
  }

  straighten() {
    this.yaw = this.pitch = 0;
    this.draw();
  }

  draw() {
    const { canvas, joints } = this;
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    const known = joints.filter(Boolean);
    if (!known.length) return;
    const middle = ["x", "y", "z"].map((axis) => known.reduce((sum, p) => sum + p[axis], 0) / known.length);
    const reach = Math.max(...known.map((p) => Math.hypot(p.x - middle[0], p.y - middle[1], p.z - middle[2])));
    const scale = Math.min(canvas.width * 0.5, canvas.height * 0.42) / reach, distance = 6 * reach;
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    // Camera axes: x right, y down, z forward; the skeleton turns about its own middle.
    const place = ({ x, y, z }) => {
      const [dx, dy, dz] = [x - middle[0], y - middle[1], z - middle[2]];
      const [tx, tz] = [cy * dx + sy * dz, cy * dz - sy * dx];
      const [ty, depth] = [cp * dy - sp * tz, cp * tz + sp * dy];
      const near = distance / (distance + depth);
      return { at: [canvas.width / 2 + tx * scale * near, canvas.height / 2 + ty * scale * near], depth };
    };
    const floor = Math.max(...known.map((p) => p.y));
    context.strokeStyle = "rgb(128 150 150 / 0.35)";
    context.lineWidth = 1.5;
    const half = Math.ceil(reach / 0.5) * 0.5;
    for (let at = -half; at <= half + 1e-6; at += 0.5) {
      for (const ends of [[[at, -half], [at, half]], [[-half, at], [half, at]]]) {
        context.beginPath();
        ends.forEach(([x, z], end) => {
          const { at: pixel } = place({ x: middle[0] + x, y: floor, z: middle[2] + z });
          if (end) context.lineTo(...pixel); else context.moveTo(...pixel);
        });
        context.stroke();
      }
    }
    const placed = joints.map((joint) => joint && place(joint));
    const far = bones(this.keypoints)
      .filter(({ parent, child }) => placed[parent] && placed[child])
      .map((bone) => ({ ...bone, depth: (placed[bone.parent].depth + placed[bone.child].depth) / 2 }))
      .sort((a, b) => b.depth - a.depth);
    context.lineCap = "round";
    for (const { parent, child, colour, depth } of far) {
      for (const [stroke, extra] of [["rgb(10 20 24 / 0.8)", 5], [colour, 0]]) {
        context.strokeStyle = stroke;
        context.lineWidth = 11 - 5 * depth / reach + extra;
        context.beginPath();
        context.moveTo(...placed[parent].at);
        context.lineTo(...placed[child].at);
        context.stroke();
      }
    }
  }
}
