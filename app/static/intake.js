// Files that are dropped, pasted or chosen, and what each of them is.

import { $, element } from "./dom.js";
import { areOneScene, isMask } from "./pictures.js";

const VIDEO = /\.(avi|flv|m4v|mkv|mov|mp4|mpe?g|ogv|ts|webm|wmv)$/i;
const NAMED_MASK = /mask/i, NAMED_EMPTY = /background|empty/i;

const isVideo = ({ type, name }) => type.startsWith("video/") || (!type && VIDEO.test(name));

// Browsers do not know the types of some formats that the service reads.
const isPicture = ({ type }) => type.startsWith("image/") || !type;

/** Say which files were left out. */
function leftOut(files, shown) {
  const names = files.filter((file) => !shown.includes(file)).map(({ name }) => name);
  return names.length
    ? `One photograph or video at a time: ${shown[0].name} is shown, ${names.join(", ")} left out.` : "";
}

/**
 * Decide which file is what.
 * @param ask Takes two pictures of one scene; returns the empty one, or null for none.
 * @returns `{video, note}`, `{frame, mask, background, note}`, or null where the question was dismissed;
 * `otherwise` is another reading of the same files, with a label.
 */
export async function sorted(files, ask) {
  files = [...files];
  const video = files.find(isVideo);
  if (video) return { video, note: leftOut(files, [video]) };
  const pictures = files.filter(isPicture);
  if (!pictures.length) {
    throw new Error(`“${files[0].name}” is neither a picture (PNG, JPEG, WebP, BMP, TIFF, GIF) `
      + "nor a video (MP4, MOV, MKV, AVI, WebM and others).");
  }

  let mask = pictures.find(({ name }) => NAMED_MASK.test(name));
  for (const picture of mask ? [] : pictures) {
    if (await isMask(picture)) {
      mask = picture;
      break;
    }
  }
  const others = pictures.filter((picture) => picture !== mask);
  if (!others.length) {
    return {
      mask,
      note: `${mask.name} is read as a mask: it says where the people are.`,
      otherwise: { label: "Read it as a photograph", upload: { frame: mask } },
    };
  }

  // A mask already says where people are: a background would add nothing.
  let background;
  if (!mask && others.length > 1) {
    background = others.find(({ name }) => NAMED_EMPTY.test(name));
    if (!background && await areOneScene(others.slice(0, 2))) {
      const answer = await ask(others.slice(0, 2));
      if (answer === undefined) return null;
      background = answer ?? undefined;
    }
  }
  const frame = others.find((picture) => picture !== background && !NAMED_EMPTY.test(picture.name))
    ?? others.find((picture) => picture !== background);
  const shown = [frame, mask, background].filter(Boolean);
  return { frame, mask, background, note: leftOut(files, shown) };
}

/** Ask which of two pictures shows the scene without people; undefined if the question is dismissed. */
export function whichIsEmpty(pictures) {
  const dialog = $("which-empty");
  const urls = pictures.map((picture) => URL.createObjectURL(picture));
  const buttons = pictures.map((picture, number) => element("button", { value: String(number) },
    element("img", { src: urls[number], alt: "" }), element("span", { textContent: picture.name })));
  $("scenes").replaceChildren(...buttons);
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      urls.forEach((url) => URL.revokeObjectURL(url));
      const { returnValue: chosen } = dialog;
      if (chosen === "") resolve(undefined);
      else resolve(pictures[chosen] ?? null);
    }, { once: true });
  });
}

/** Call `take` with the files that are dropped on the page, pasted into it or chosen. */
export function onFiles(take) {
  const drop = $("drop");
  $("file").addEventListener("change", () => {
    take([...$("file").files]);
    $("file").value = "";
  });
  drop.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    $("file").click();
  });
  for (const kind of ["dragenter", "dragover"]) {
    addEventListener(kind, (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) drop.classList.remove("over");
  });
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    take([...event.dataTransfer.files]);
  });
  addEventListener("paste", (event) => take([...event.clipboardData.files]));
}
