// Recognises masks and pictures of the same scene by their pixels.

/** Formats that keep every pixel's value, as a mask needs. */
const LOSSLESS = /^image\/(png|bmp|webp|gif|tiff)$/;

/** A mask numbers no more people than the service takes, beside its background. */
const MAX_LABELS = 51;

/** Two shots of one scene: the size at which they are compared, the difference in brightness up to
 * which a pixel counts as equal, and the share of equal pixels. */
const SMALL = { width: 64, height: 48 }, EQUAL = 14, EQUAL_SHARE = 0.7;

function pixelsOf(bitmap, { width, height }) {
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0, width, height);
  return context.getImageData(0, 0, width, height).data;
}

/** Whether a picture holds labels rather than a scene: few grey values, and more than one. */
export function holdsLabels(pixels) {
  const values = new Set();
  for (let at = 0; at < pixels.length; at += 4) {
    const [red, green, blue] = [pixels[at], pixels[at + 1], pixels[at + 2]];
    if (red !== green || green !== blue) return false;
    values.add(red);
    if (values.size > MAX_LABELS) return false;
  }
  // A few greys spread from dark to light are a drawing: labels count up from zero, or are two.
  return values.size === 2 || (values.size > 2 && values.has(0) && Math.max(...values) < MAX_LABELS);
}

/** Whether two pictures of the same size, as small copies, show one scene at different times. */
function showsSameScene(one, other) {
  const grey = (pixels, at) => (pixels[at] + pixels[at + 1] + pixels[at + 2]) / 3;
  let equal = 0;
  for (let at = 0; at < one.length; at += 4) {
    if (Math.abs(grey(one, at) - grey(other, at)) <= EQUAL) equal += 1;
  }
  const share = 4 * equal / one.length;
  return share >= EQUAL_SHARE && share < 1;
}

const decoded = (file) => createImageBitmap(file).catch(() => null);

/** Whether a file is a mask by what it shows. */
export async function isMask(file) {
  if (!LOSSLESS.test(file.type)) return false;
  const bitmap = await decoded(file);
  return Boolean(bitmap) && holdsLabels(pixelsOf(bitmap, bitmap));
}

/** Whether two files are pictures of one scene, and of one size. */
export async function areOneScene(files) {
  const [one, other] = await Promise.all(files.map(decoded));
  if (!one || !other || one.width !== other.width || one.height !== other.height) return false;
  return showsSameScene(pixelsOf(one, SMALL), pixelsOf(other, SMALL));
}
