// Shrinks photographs before they are sent, and scales answers back to their pixels.

/** The service detects people at half of this: a longer side costs time and adds nothing. */
const LONGEST_PX = 2560;

/** The image to send and the image to draw. */
export async function prepare({ frame, mask, background }) {
  // Null where only a mask was given, and for formats that the browser does not read.
  const bitmap = frame ? await createImageBitmap(frame).catch(() => null) : null;
  const scale = bitmap ? LONGEST_PX / Math.max(bitmap.width, bitmap.height) : 1;
  // A mask and a background must have the frame's size.
  if (scale >= 1 || mask || background) return { bitmap, files: { frame, mask, background } };
  const { width, height } = bitmap;
  const canvas = new OffscreenCanvas(Math.round(width * scale), Math.round(height * scale));
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  bitmap.close();
  const blob = await canvas.convertToBlob({ type: "image/jpeg", quality: 0.92 });
  const small = new File([blob], frame.name || "photo.jpg", { type: blob.type });
  return { bitmap: canvas.transferToImageBitmap(), files: { frame: small }, original: { width, height } };
}

const round = (value) => Math.round(value * 100) / 100;

/** Scale the answer to a shrunk photograph back to the original pixels. */
export function inPixelsOf({ width, height }, answer) {
  const [across, down] = [width / answer.image.width, height / answer.image.height];
  // The origin is the centre of the first pixel, which moves.
  const point = (p) => p && {
    ...p, x: round((p.x + 0.5) * across - 0.5), y: round((p.y + 0.5) * down - 0.5),
  };
  const persons = answer.persons.map((person) => ({
    ...person,
    box: {
      ...point(person.box),
      width: round(person.box.width * across),
      height: round(person.box.height * down),
    },
    silhouette: person.silhouette && {
      ...person.silhouette, area_px: Math.round(person.silhouette.area_px * across * down),
    },
    observed_keypoints: person.observed_keypoints?.map(point) ?? null,
    hypotheses: person.hypotheses.map((h) => ({ ...h, joints_2d: h.joints_2d.map(point) })),
  }));
  return { ...answer, image: { width, height }, persons };
}
