// Skeletons in space: a small view of one, and a large one that can be turned.

import { bonesOf } from "./skeleton.js";

const FLOOR_STEP_M = 0.5;
const GHOST = "rgb(150 165 170 / 0.6)";

/** The middle of some joints, and the farthest of them from it, in metres. */
function extent(joints) {
  const known = joints.filter(Boolean);
  const [x, y, z] = ["x", "y", "z"].map((axis) => known.reduce((sum, p) => sum + p[axis], 0) / known.length);
  const reach = Math.max(...known.map((p) => Math.hypot(p.x - x, p.y - y, p.z - z)));
  return { middle: { x, y, z }, reach, floor: Math.max(...known.map((p) => p.y)) };
}

/** A function from points in camera axes (x right, y down, z forward) to pixels and depth. */
function projection({ width, height }, { middle, reach }, { yaw, pitch }) {
  const scale = Math.min(width * 0.5, height * 0.42) / reach, distance = 6 * reach;
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return ({ x, y, z }) => {
    const [dx, dy, dz] = [x - middle.x, y - middle.y, z - middle.z];
    const [tx, tz] = [cy * dx + sy * dz, cy * dz - sy * dx];
    const [ty, depth] = [cp * dy - sp * tz, cp * tz + sp * dy];
    const near = distance / (distance + depth);
    return { at: [width / 2 + tx * scale * near, height / 2 + ty * scale * near], depth };
  };
}

function line(context, from, to) {
  context.beginPath();
  context.moveTo(...from.at);
  context.lineTo(...to.at);
  context.stroke();
}

function drawFloor(context, { middle, reach, floor }, place) {
  context.strokeStyle = "rgb(128 150 150 / 0.35)";
  context.lineWidth = 1.5;
  const half = Math.ceil(reach / FLOOR_STEP_M) * FLOOR_STEP_M;
  const on = (x, z) => place({ x: middle.x + x, y: floor, z: middle.z + z });
  for (let at = -half; at <= half + 1e-6; at += FLOOR_STEP_M) {
    line(context, on(at, -half), on(at, half));
    line(context, on(-half, at), on(half, at));
  }
}

function drawBones(context, joints, keypoints, { place, width, taper, colour }) {
  const placed = joints.map((joint) => joint && place(joint));
  const farthestFirst = bonesOf(keypoints)
    .filter(({ parent, child }) => placed[parent] && placed[child])
    .map((bone) => ({ ...bone, depth: (placed[bone.parent].depth + placed[bone.child].depth) / 2 }))
    .sort((a, b) => b.depth - a.depth);
  context.lineCap = "round";
  for (const bone of farthestFirst) {
    const strokes = colour ? [[colour, 0]] : [["rgb(10 20 24 / 0.8)", 0.45 * width], [bone.colour, 0]];
    for (const [stroke, extra] of strokes) {
      context.strokeStyle = stroke;
      context.lineWidth = width * (1 - taper * bone.depth) + extra;
      line(context, placed[bone.parent], placed[bone.child]);
    }
  }
}

/**
 * Draw a skeleton in space.
 * @param view `yaw` and `pitch` in radians; yaw 0 is as the camera sees it, a quarter turn from the side.
 * @param ghost Joints of another skeleton, drawn pale behind this one in the same place and scale.
 */
export function drawSolid(canvas, joints, keypoints, view, ghost = null) {
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (!joints.some(Boolean)) return;
  const scene = extent(ghost ? [...joints, ...ghost] : joints);
  const place = projection(canvas, scene, view);
  const width = Math.max(3.5, canvas.width / 44), taper = 0.45 / scene.reach;
  drawFloor(context, scene, place);
  if (ghost) drawBones(context, ghost, keypoints, { place, width, taper, colour: GHOST });
  drawBones(context, joints, keypoints, { place, width, taper });
}

/** A skeleton that turns when it is dragged, or with the arrow keys. */
export class Solid {
  #canvas;
  #view = { yaw: 0, pitch: 0 };
  #joints = [];
  #keypoints = { names: [], bones: [] };

  constructor(canvas) {
    this.#canvas = canvas;
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
    this.#joints = joints;
    this.#keypoints = keypoints;
    this.#draw();
  }

  turn(yaw, pitch) {
    this.#view.yaw += yaw;
    this.#view.pitch = Math.max(-0.9, Math.min(0.9, this.#view.pitch + pitch));
    this.#draw();
  }

  straighten() {
    this.#view = { yaw: 0, pitch: 0 };
    this.#draw();
  }

  #draw() {
    drawSolid(this.#canvas, this.#joints, this.#keypoints, this.#view);
  }
}
