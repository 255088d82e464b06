// A person and a hypothesis in words.

import { inWords, percent } from "./dom.js";

const FACING_FROM = { image: "photograph", motion: "motion", none: "a silhouette cannot show it" };

const FOUND_BY = {
  detector: "the detector", mask: "your mask", boxes: "your boxes",
  background: "the difference from your background",
};

/** Measurements of a person, as pairs of term and text. */
export function measured({
  box, source, detection_score: score, silhouette, observed_keypoints: seen, facing, posture,
}) {
  const towards = facing.front_probability >= 0.5;
  const sure = towards ? facing.front_probability : 1 - facing.front_probability;
  return [
    ["Faces", `${towards ? "the camera" : "away"}, ${percent(sure)} sure (${FACING_FROM[facing.evidence]})`],
    ["Posture", inWords(posture.label)
      + (posture.label === "unclear" ? "" : `, ${percent(posture.probability)} sure`)],
    ["Size", `${Math.round(box.width)} × ${Math.round(box.height)} px, silhouette ${silhouette.area_px.toLocaleString("en")} px`
      + (silhouette.truncated ? ", cut off" : "")],
    ["Keypoints", seen ? `${seen.filter(Boolean).length} of ${seen.length} seen` : "not read"],
    ["Found by", FOUND_BY[source] + (score === null ? "" : ` (${percent(score)})`)
      + `, cut out by ${silhouette.segmenter}`],
  ];
}

const HEIGHTS = [[-3, "below"], [10, "level"], [30, "slightly above"], [55, "above"]];

/** A camera's elevation in words. */
const height = (degrees) =>
  `${(HEIGHTS.find(([max]) => degrees < max) ?? [, "high above"])[1]} (${Math.round(degrees)}°)`;

/** An azimuth between -180 and 180: 0 from the front, positive from the person's left. */
const around = (degrees) => ((Math.round(degrees) + 540) % 360) - 180;

const SIDES = ["front", "front left", "left", "back left", "back", "back right", "right", "front right"];

/** The side of the person that the camera sees. */
export const sideSeen = (azimuth) => SIDES[((Math.round(azimuth / 45) % 8) + 8) % 8];

/** A hypothesis and its source, as pairs of term and text. */
export function supposed({ confidence, reprojection_error_px: error, posture, entry, source, camera }) {
  const azimuth = around(camera.azimuth_deg);
  const side = azimuth > 0 ? "left" : "right";
  return [
    ["Confidence", `${percent(confidence)} that its joints are right`],
    ["Posture", inWords(posture)],
    ["Outline", `${error.toFixed(1)} px from the entry’s, in 128 × 48 px`],
    ["Seen from", `${Math.abs(azimuth)}° to their ${side}, ${height(camera.elevation_deg)}`],
    ["Entry", `${entry}: clip ${source.clip} (${source.action}), frame ${source.frame}`
      + `${source.mirrored ? ", mirrored" : ""}${source.twin ? ", from behind" : ""}, on ${source.subject}`],
  ];
}

/** How far two skeletons lie apart: the mean over their joints, and the joint that differs most. */
export function difference(joints, others, names) {
  const apart = joints.flatMap((joint, number) => joint && others[number] ? [{
    name: names[number],
    metres: Math.hypot(...["x", "y", "z"].map((axis) => joint[axis] - others[number][axis])),
    farther: joint.z - others[number].z,
  }] : []);
  if (!apart.length) return null;
  return {
    mean: apart.reduce((sum, { metres }) => sum + metres, 0) / apart.length,
    most: apart.reduce((a, b) => (b.metres > a.metres ? b : a)),
  };
}
