// Drawing on canvases: the photograph with what was found, and skeletons in two and three
// dimensions. Nothing here knows the service.

export const PEOPLE = ["#2f9bff", "#31c85f", "#ff7a45", "#e05fe0", "#e0c319", "#23c4c4"];

const SIDES = { left: "#ff8a3c", right: "#3c9dff", middle: "#9fb3b8" };

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

/** A skeleton flat on a canvas; `place` takes a joint to canvas pixels. */
export function drawFlat(context, joints, keypoints, place, width) {
  context.lineCap = "round";
  for (const pass of ["edge", "bone"]) {
    for (const { parent, child, colour } of bones(keypoints)) {
      if (!joints[parent] || !joints[child]) continue;
      context.strokeStyle = pass === "edge" ? "rgb(0 0 0 / 0.75)" : colour;
      context.lineWidth = pass === "edge" ? width * 1.8 : width;
      context.beginPath();
      context.moveTo(...place(joints[parent]));
      context.lineTo(...place(joints[child]));
      context.stroke();
    }
  }
}

/** A label image (0 background, k = person k) as one tinted canvas per frame. */
export async function tint(blob) {
  const bitmap = await createImageBitmap(blob);
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  const image = context.getImageData(0, 0, canvas.width, canvas.height);
  const colours = PEOPLE.map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
  for (let at = 0; at < image.data.length; at += 4) {
    const label = image.data[at];
    const colour = colours[(label - 1 + colours.length) % colours.length];
    image.data.set([...colour, label ? 115 : 0], at);
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

/** Photograph, silhouettes, boxes and skeletons in pixels of the photograph, as `shown` says. */
function drawLayers(context, { photo, answer, silhouettes, person, hypothesis, shown }, line) {
  const { width, height } = answer.image;
  context.drawImage(photo, 0, 0, width, height);
  if (shown.silhouettes && silhouettes) context.drawImage(silhouettes, 0, 0);
  answer.persons.forEach((found, number) => {
    const chosen = number === person;
    if (shown.boxes) {
      // The service counts from pixel centres, a canvas from pixel corners.
      const { x, y, width: w, height: h } = found.box;
      context.strokeStyle = personColour(number);
      context.lineWidth = chosen ? line * 1.8 : line;
      context.strokeRect(x + 0.5, y + 0.5, w, h);
      context.font = `600 ${line * 8}px system-ui, sans-serif`;
      context.lineWidth = line * 2;
      context.strokeStyle = "rgb(0 0 0 / 0.75)";
      context.fillStyle = personColour(number);
      const label = [String(number + 1), x + 0.5 + line * 2, Math.max(y - line * 2, line * 9)];
      context.strokeText(...label);
      context.fillText(...label);
    }
    const pose = found.hypotheses[chosen ? hypothesis : 0];
    if (shown.skeleton && pose) {
      drawFlat(context, pose.joints_2d, answer.keypoints, ({ x, y }) => [x + 0.5, y + 0.5],
        Math.max(line * 0.8, found.box.height / 70));
    }
  });
}

/** The whole photograph with what was found in it. */
export function drawStage(canvas, scene) {
  const { width, height } = scene.answer.image;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  drawLayers(canvas.getContext("2d"), scene, Math.max(1.5, Math.max(width, height) / 400));
}

/** The chosen person, filling the canvas: in a street they are small. */
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

/** A skeleton in a small card, upright and filling it. */
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

/** A skeleton in space that can be turned. */
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
