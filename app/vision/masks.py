"""Encoded label images, which say where people are."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from app.vision.geometry import Box
from app.vision.images import FORMATS, JPEG, ImageError, checked_header, decode
from app.vision.parameters import DEFAULTS, ImageParameters

Labels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class LabelImage:
    """Where people are: 0 is background, k is person k.

    Parameters
    ----------
    labels : (H, W) array of uint8 or uint16
    present : list of int
        The labels it holds, ascending, without 0.
    left, top : int
        First column and row of the part.
    part : (h, w) array
        The smallest part that holds all labels, since most of a mask is background.
    """

    labels: Labels
    present: list[int]
    left: int
    top: int
    part: Labels

    @classmethod
    def of(cls, labels: Labels) -> LabelImage:
        """Find the labels of an array ``(H, W)``."""
        if labels.ndim != 2:
            raise ValueError(f"expected labels of shape (H, W), got {labels.shape}")
        # `boundingRect` takes 8 bits only.
        marked = labels if labels.dtype == np.uint8 else np.asarray(labels != 0).view(np.uint8)
        left, top, width, height = cv2.boundingRect(marked)
        part = labels[top : top + height, left : left + width].copy()
        return cls(labels, _labels_in(part), left, top, part)

    @cached_property
    def boxes(self) -> list[Box]:
        """The tight box of each label."""
        found = []
        for label in self.present:
            left, top, width, height = cv2.boundingRect(cv2.inRange(self.part, label, label))
            found.append(Box(self.left + left - 0.5, self.top + top - 0.5, width, height))
        return found

    def merged(self) -> LabelImage:
        """The same image with all labels merged into one person, label 1."""
        labels, part = ((image != 0).view(np.uint8) for image in (self.labels, self.part))
        return LabelImage(labels, [1] if self.present else [], self.left, self.top, part)


def _labels_in(part: Labels) -> list[int]:
    """The labels in a contiguous part ``(h, w)``, ascending, without 0."""
    # calcHist is several times as fast as np.unique or np.bincount.
    if part.size == 0:
        return []
    bins = int(part.max()) + 1
    counts = cv2.calcHist([part], [0], None, [bins], [0, bins])
    return (np.flatnonzero(counts[1:]) + 1).tolist()


def _checked(image: LabelImage, parameters: ImageParameters) -> LabelImage:
    """Check that the labels of an image may mark people; a single label becomes label 1."""
    count, part = len(image.present), image.part
    if count > parameters.max_labels:
        raise ImageError(
            f"expected a mask of at most {parameters.max_labels} labels, got {count}: "
            "a mask with soft edges must be thresholded first"
        )
    changes = sum(
        np.count_nonzero(first != second)
        for first, second in ((part[:, 1:], part[:, :-1]), (part[1:], part[:-1]))
    )
    many = max(parameters.few_label_changes, parameters.max_label_change_share * part.size)
    most = min(parameters.max_label_changes, round(many))
    if changes > most:
        raise ImageError(
            "expected a mask whose labels mark people, got scattered ones: "
            f"{changes} neighbouring pixels differ, more than {most}"
        )
    return image.merged() if count == 1 and image.present != [1] else image


def decode_mask(
    data: bytes, *, max_pixels: int, parameters: ImageParameters = DEFAULTS.images
) -> LabelImage:
    """Decode a label image: 0 is background, k is person k.

    Grey images and PNG images with a palette keep their stored values, whatever their bit depth: of
    a palette, the indices are used, not the colours. An image with only two values, 0 and one
    other, marks one person (label 1). So does a lossy image (JPEG, WebP), since compression
    destroys labels; there, values of 128 and above mark the person. Three channels are accepted if
    they are equal. The EXIF orientation is applied. The alpha channel is used only if all other
    channels are black; alpha values of 128 and above mark one person.

    Raises
    ------
    ImageTooLargeError, ImageError
        As for :func:`app.vision.images.decode_image`, or if the image is coloured, a lossy image is
        not essentially black and white, or there are more than 100 labels or labels too scattered
        to mark people.
    """
    header = checked_header(data, max_pixels)
    if header.format == "PNG" and header.mode == "P":
        return _checked(LabelImage.of(_stored(data)), parameters)
    pixels = decode(data, header, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if is_lossy(header, data):
        values = _one_channel(pixels, parameters.lossy_channel_difference)
        return _checked(LabelImage.of(_thresholded(values, parameters)), parameters)
    labels = _one_channel(pixels, 0)
    if header.format == "PNG" and header.mode == "L":
        # OpenCV stretches 2 and 4 bits to 0..255; the 25th byte of a PNG is its bit depth.
        labels = labels // {2: 85, 4: 17}.get(data[24], 1)
    if header.mode in ("RGBA", "LA") and not labels.any():
        alpha = _stored(data)[..., -1]
        if alpha.min() < parameters.lossy_threshold:
            labels = np.asarray(alpha >= parameters.lossy_threshold).view(np.uint8)
    return _checked(LabelImage.of(labels), parameters)


def is_lossy(image: Image.Image, data: bytes) -> bool:
    """Whether the compression of an image may alter pixel values."""
    match image.format:
        case "WEBP":
            return b"VP8L" not in data
        case "TIFF":
            return image.info.get("compression") in ("jpeg", "tiff_jpeg")
    return image.format in JPEG


def _thresholded(values: Labels, parameters: ImageParameters) -> NDArray[np.uint8]:
    """The person ``(H, W)`` in a lossy mask; raise an error if its values look like labels."""
    marked = np.asarray(values >= parameters.lossy_threshold).view(np.uint8)
    certain = parameters.lossy_certainty
    between = np.count_nonzero((values > certain) & (values < 255 - certain))
    allowed = parameters.max_lossy_between * int(np.count_nonzero(marked))
    # Labels that are small numbers leave nothing above the threshold.
    if between > allowed or (values.any() and not marked.any()):
        raise ImageError(
            "expected a mask of black and white, since lossy compression (JPEG, WebP) keeps no "
            "labels, got one of other values; send labels as PNG"
        )
    return marked


def _stored(data: bytes) -> NDArray[np.uint8]:
    """Stored values of an image: the indices ``(H, W)`` of a palette, or all channels."""
    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as image:
            return np.asarray(ImageOps.exif_transpose(image))
    except Exception as error:  # Damaged data make Pillow raise almost anything.
        raise ImageError("the image is broken") from error


def _one_channel(pixels: NDArray[Any], max_difference: int) -> Labels:
    """Values ``(H, W)`` of an image of one channel, or of three that differ by no more."""
    if pixels.ndim == 2:
        return pixels
    first, *others = (pixels[..., channel] for channel in range(pixels.shape[2]))
    if any(cv2.absdiff(first, other).max() > max_difference for other in others):
        raise ImageError("expected a mask of one channel or of equal ones, got a coloured one")
    return np.ascontiguousarray(first)
