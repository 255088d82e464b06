// Skeletons in two dimensions, and the colours of people and of their sides.

const PEOPLE = [
  "#2f9bff", "#31c85f", "#ff7a45", "#e05fe0", "#e0c319", "#23c4c4",
  "#ff5c8a", "#9d7bff", "#b4dd3c", "#c98a5a", "#8fb8ff", "#ff9fd0",
];

const SIDES = { left: "#ff8a3c", right: "#3c9dff", middle: "#9fb3b8" };

export const personColour = (number) => PEOPLE[number % PEOPLE.length];

function side(name) {
  if (name.startsWith("left_")) return "left";
  return name.startsWith("right_") ? "right" : "middle";
}

/** The bones of a keypoint set, each with the colour of the side of the body it belongs to. */
export function bonesOf({ names, bones }) {
  return bones.map(({ parent, child }) => {
    const [one, other] = [side(names[parent]), side(names[child])];
    // From the trunk to a side, it is that side's; across the body, it is neither's.
    const sides = new Set([one, other].filter((name) => name !== "middle"));
    return { parent, child, colour: SIDES[sides.size === 1 ? [...sides][0] : "middle"] };
  });
}

/** Probability below which a keypoint, or a whole pose, is drawn as unsure. */
const SURE = 0.5;

/** A test of bones, by the names of their ends: unsure if the whole pose is, or if one end is hardly
 * visible. */
export function isUnsure({ confidence }, observed) {
  const hidden = new Set((observed ?? []).filter((point) => point?.score < SURE).map(({ name }) => name));
  return (...ends) => confidence < SURE || ends.some((name) => hidden.has(name));
}

/**
 * Draw a skeleton flat on a canvas.
 * @param place Takes a joint to canvas pixels.
 * @param plain A colour for all bones, in place of those of the sides.
 * @param unsure Takes the names of a bone's ends; where it is true, the bone is dashed.
 */
export function drawFlat(context, joints, keypoints, place, width, plain = null, unsure = () => false) {
  context.lineCap = "round";
  for (const pass of ["edge", "bone"]) {
    for (const { parent, child, colour } of bonesOf(keypoints)) {
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
