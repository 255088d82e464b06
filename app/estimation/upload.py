"""Uploads: images, masks and boxes are decoded, validated and rectified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from app.decoding.pictures import Allowance, Workers
from app.estimation.poses import NormalisedPerson
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.halved import Frame
from app.vision.images import (
    ImageError,
    ImageTooLargeError,
    ImageWarning,
    Photograph,
    blank_image,
    decode_image,
    halved,
    is_expensive,
)
from app.vision.masks import LabelImage, decode_mask, mask_of
from app.vision.optics import UNKNOWN_OPTICS, Optics, PinholeCamera, Rectification
from app.vision.people import silhouette_from_mask
from index.silhouette_matching import match_silhouette
from index.store import PoseIndex

MIN_BOX_PX = 0.01
"""Shortest side of a caller's box: a unit of the last digit of a reply."""


_MIN_FIGURE_PX = 48
"""Height of the smallest part of a mask that may be a person."""


UploadFault = Literal["undecodable", "too_large", "misfit"]
"""A ``misfit`` is valid in itself, but not for this frame."""


class UploadError(ValueError):
    """An unusable upload; the message is one sentence, ``field`` names the faulty part."""

    def __init__(self, field: str, message: str, reason: UploadFault = "misfit") -> None:
        super().__init__(message)
        self.field = field
        self.reason = reason


@dataclass(frozen=True)
class Upload:
    """Images of one size and, if known, where the people are.

    Each image is the bytes of a file or an array. The frame is a photograph, as an array ``(H, W,
    3)`` of uint8, BGR; it may be missing if there is a mask. A mask is a label image, as an array
    ``(H, W)`` of whole numbers or booleans: 0 is background, k is person k. It cannot be combined
    with boxes, which are in pixels of the frame, or with a background, a photograph of the empty
    scene. ``track_ids`` are the caller's identities of the people in the boxes. Without optics, a
    field of view is assumed, with square pixels and an upright camera. Raises UploadError if the
    parts do not go together.

    Examples
    --------
    >>> from pathlib import Path
    >>> from app import Box, Upload
    >>> walkers = Path("tests/data/walkers.jpg").read_bytes()
    >>> Upload(walkers, boxes=[Box(x=133, y=162, width=41, height=105)], track_ids=["17"]).given
    ('frame', 'boxes', 'track_ids')
    >>> Upload(mask=walkers, boxes=[])
    Traceback (most recent call last):
    app.UploadError: expected a mask or boxes, got both
    """

    frame: bytes | NDArray[np.uint8] | None = None
    mask: bytes | NDArray[np.integer] | NDArray[np.bool_] | None = None
    background: bytes | NDArray[np.uint8] | None = None
    boxes: Sequence[Box] | None = None
    track_ids: Sequence[str] | None = None
    optics: Optics = UNKNOWN_OPTICS

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the given images and lists; these determine how long the work takes."""
        names = ("frame", "mask", "background", "boxes", "track_ids")
        return tuple(name for name in names if getattr(self, name) is not None)

    def __post_init__(self) -> None:
        for name in ("frame", "background", "mask"):
            _check_kind(name, getattr(self, name))
        for name, kind in (("boxes", Box), ("track_ids", str)):
            _check_list(name, getattr(self, name), kind)
        if not isinstance(self.optics, Optics):
            got = type(self.optics).__name__
            raise UploadError("optics", f"optics: expected app.Optics, got a {got}")
        if self.frame is None and self.mask is None:
            raise UploadError("frame", "frame: expected an image file, got none")
        for name in ("background", "boxes"):
            if self.mask is not None and getattr(self, name) is not None:
                raise UploadError(name, f"expected a mask or {name}, got both")
        if self.track_ids is not None:
            _check_track_ids(self.track_ids, self.boxes)


def _check_kind(name: str, given: object) -> None:
    """Refuse what other libraries hold images in: taken for pixels, they would show nobody."""
    if given is None or isinstance(given, bytes):
        return
    if isinstance(given, np.ndarray) and given.size:
        is_grey, kind = given.ndim == 2, given.dtype.kind
        is_bgr = given.ndim == 3 and given.shape[2] == 3 and given.dtype == np.uint8
        if (is_grey and kind in "bui") if name == "mask" else is_bgr:
            return
    array = "(H, W, 3) and dtype uint8, BGR"
    if name == "mask":
        array = "(H, W) and dtype uint8, uint16 or bool"
    got = f"a {type(given).__name__}"
    if hasattr(given, "shape") and hasattr(given, "dtype"):
        got += f" of shape {tuple(given.shape)} and dtype {given.dtype}"
    raise UploadError(
        name,
        f"{name}: expected the bytes of an image file or a NumPy array of shape {array}, got {got}",
    )


def _check_list(name: str, given: Any, kind: type) -> None:
    if given is None:
        return
    if (
        not isinstance(given, Sequence)
        or isinstance(given, str)
        or not all(isinstance(one, kind) for one in given)
    ):
        expected = "app.Box" if kind is Box else "strings"
        raise UploadError(name, f"{name}: expected a list of {expected}, got something else")


def _check_track_ids(track_ids: Sequence[str], boxes: Sequence[Box] | None) -> None:
    if boxes is None or len(track_ids) != len(boxes):
        count = "no boxes" if boxes is None else f"{len(boxes)} boxes"
        raise UploadError(
            "track_ids",
            f"track_ids: expected one for each box, got {len(track_ids)} and {count}",
        )
    for track_id, times in Counter(track_ids).items():
        if times > 1:
            raise UploadError("track_ids", f"track_ids: expected each once, got {track_id!r} twice")


@dataclass(frozen=True)
class DecodedUpload:
    """Images of one size, with square pixels and upright, and boxes within them.

    Images are ``(H, W, 3)``, BGR. ``sent`` is the frame as sent; it is black, and ``has_frame``
    false, if the caller sent a mask alone. ``frame`` is the rectified frame, to which camera and
    boxes belong; ``rectification`` converts between the two.
    """

    sent: NDArray[np.uint8]
    frame: Frame
    has_frame: bool
    mask: LabelImage | None
    background: NDArray[np.uint8] | None
    boxes: list[Box] | None
    camera: PinholeCamera
    rectification: Rectification
    warnings: tuple[ImageWarning, ...] = ()

    @classmethod
    def halved(
        cls, upload: Upload, shape: tuple[int, ...], checkpoint: Callable[[], None]
    ) -> DecodedUpload | None:
        """A frame alone, of a known shape, at half its size; None if all has to be decoded.

        ``sent`` stays black.
        """
        rectification = Rectification.of_frame(shape, upload.optics)
        if not isinstance(upload.frame, bytes) or rectification.changes:
            return None
        if (found := halved(upload.frame, shape, checkpoint)) is None:
            return None
        return cls(
            sent=np.broadcast_to(np.zeros(1, np.uint8), shape),
            frame=found[0],
            has_frame=True,
            mask=None,
            background=None,
            boxes=None,
            camera=PinholeCamera.of_frame(shape, upload.optics.fov_deg),
            rectification=rectification,
            warnings=found[1],
        )


@dataclass(frozen=True)
class UploadDecoder:
    """Decodes uploads; raises :class:`UploadError` for those that cannot be used.

    Images may have ``max_pixels``; boxes or a mask may mark ``max_persons``. Images that may be
    expensive are decoded by ``workers``, if there are any.
    """

    max_pixels: int
    max_persons: int
    workers: Workers | None = None

    def decode(self, upload: Upload, job: Job, *, blank: bool = False) -> DecodedUpload:
        """Decode all images of an upload; if it is ``blank``, the frame's pixels are not needed."""
        images = (
            ("frame", upload.frame, blank_image if blank else decode_image),
            ("mask", upload.mask, decode_mask),
            ("background", upload.background, decode_image),
        )
        sent = [image for image in images if image[1] is not None]
        allowance = Allowance()
        decoded: list[Any] = job.map(lambda image: self._decode(job, allowance, *image), sent)
        by_name = dict(zip((name for name, _, _ in sent), decoded, strict=True))
        mask, background = by_name.get("mask"), by_name.get("background")
        photograph = by_name.get("frame")
        if photograph is None:
            photograph = Photograph(np.zeros((*by_name["mask"].labels.shape, 3), np.uint8))
        frame = photograph.pixels
        if mask is not None:
            self._check_mask(mask, frame)
        if background is not None:
            background = background.pixels
            _check_size("background", background, frame)
        rectification = Rectification.of_frame(frame.shape, upload.optics)
        self._check_rectified(rectification)
        boxes = None
        if upload.boxes is not None:
            boxes = rectification.boxes(self._clipped(upload.boxes, frame))
            self._check_area("boxes", boxes)
        if mask is not None:
            if rectification.changes:
                mask = LabelImage.of(rectification.rectify(mask.labels, cv2.INTER_NEAREST))
            self._check_area("mask", mask.boxes)
        camera = PinholeCamera.of_frame(rectification.square, upload.optics.fov_deg)
        return DecodedUpload(
            sent=frame,
            frame=rectification.rectify(frame),
            has_frame=upload.frame is not None,
            mask=mask,
            background=None if background is None else rectification.rectify(background),
            boxes=boxes,
            camera=camera.centred(rectification.upright),
            rectification=rectification,
            warnings=photograph.warnings,
        )

    def _check_mask(self, mask: LabelImage, frame: NDArray[np.uint8]) -> None:
        _check_size("mask", mask.labels, frame)
        self._check_count("mask", len(mask.present))
        _check_together(mask)

    def _decode(
        self,
        job: Job,
        allowance: Allowance,
        name: str,
        given: bytes | NDArray[Any],
        decode: Callable[..., Photograph | LabelImage],
    ) -> Photograph | LabelImage:
        max_pixels, checkpoint, is_mask = self.max_pixels, job.checkpoint, name == "mask"
        try:
            if not isinstance(given, bytes):
                return mask_of(given) if is_mask else Photograph.of(np.ascontiguousarray(given))
            if self.workers is None or not is_expensive(given):
                return decode(given, max_pixels=max_pixels, checkpoint=checkpoint)
            values, warnings = self.workers.decode(
                given,
                is_mask=is_mask,
                max_pixels=max_pixels,
                allowance=allowance,
                checkpoint=checkpoint,
            )
            if is_mask:
                return LabelImage.of(values)
            if decode is blank_image:
                return Photograph(np.zeros_like(values))
            return Photograph(values, warnings)
        except ImageTooLargeError as error:
            raise UploadError(name, f"{name}: {error}", "too_large") from error
        except ImageError as error:
            raise UploadError(name, f"{name}: {error}", "undecodable") from error

    def _check_rectified(self, rectification: Rectification) -> None:
        height, width = rectification.upright
        if rectification.changes and width * height > self.max_pixels:
            raise UploadError(
                "frame",
                f"frame: expected at most {self.max_pixels} pixels once they are square and "
                f"upright, got {width}x{height}",
                "too_large",
            )

    def _clipped(self, boxes: Sequence[Box], frame: NDArray[np.uint8]) -> list[Box]:
        self._check_count("boxes", len(boxes))
        return [_clip(box, frame, position) for position, box in enumerate(boxes)]

    def _check_count(self, name: str, count: int) -> None:
        if count > self.max_persons:
            raise UploadError(name, f"expected at most {self.max_persons} persons, got {count}")

    def _check_area(self, name: str, boxes: Sequence[Box]) -> None:
        """Bound the work on people, which grows with the pixels of their boxes."""
        # A caller's boxes may together cover this many times the area of the largest frame. The
        # boxes of a crowd overlap less, and the work on people grows with their pixels.
        most, area = 4 * self.max_pixels, sum(box.area for box in boxes)
        if area > most:
            raise UploadError(
                name,
                f"{name}: expected people whose boxes together hold at most {most} pixels, "
                f"got {area:.0f}",
            )


def _check_size(name: str, image: NDArray[np.generic], frame: NDArray[np.uint8]) -> None:
    if image.shape[:2] != frame.shape[:2]:
        (height, width), (other_height, other_width) = frame.shape[:2], image.shape[:2]
        raise UploadError(
            name,
            f"expected a {name} of {width}x{height} pixels like the frame, "
            f"got {other_width}x{other_height}",
        )


def _check_together(mask: LabelImage) -> None:
    """Refuse a mask with a single label for several people at a distance from one another.

    Taken as one person, they would form a wide silhouette and appear to be lying.
    """
    if len(mask.present) != 1:
        return
    marked = np.asarray(mask.part != 0).view(np.uint8)
    stats = cv2.connectedComponentsWithStats(marked)[2][1:]
    areas = stats[:, cv2.CC_STAT_AREA]
    # Area of the smallest part of a mask that may be a person, as a share of the largest part's.
    large = stats[areas >= 0.25 * areas.max()]
    apart = 1 + _gaps_between_people(large[np.argsort(large[:, cv2.CC_STAT_LEFT], kind="stable")])
    if apart > 1:
        raise UploadError(
            "mask",
            f"expected a label for each person (1, 2, ...; 0 is background), got {apart} figures "
            "apart with the same label",
        )


def _gaps_between_people(parts: NDArray[np.int32]) -> int:
    """Number of gaps between parts of a mask that separate people rather than parts of one.

    ``parts`` are rows of left, top, width, height and area, from left to right.
    """
    left, width, height = (parts[:, column] for column in (0, 2, 3))
    small = np.minimum(height[:-1], height[1:])
    alike = (small >= _MIN_FIGURE_PX) & (np.maximum(height[:-1], height[1:]) < 2 * small)
    gap = left[1:] - (left + width)[:-1]
    # Parts of a mask are different people if the gap between them is wider than this share of the
    # narrower one.
    wide = gap > 0.5 * np.minimum(width[:-1], width[1:])
    return int(np.count_nonzero(alike & wide))


def _clip(box: Box, frame: NDArray[np.uint8], position: int) -> Box:
    # Least longer side of a box in pixels: no person is smaller. Sides of a box that was sent in
    # fractions of the frame are at most 1.
    if max(box.width, box.height) < 2:
        raise UploadError(
            "boxes",
            "expected boxes [x, y, width, height] in pixels, not fractions of the frame, "
            f"got box {position}: {[box.x, box.y, box.width, box.height]}",
        )
    height, width = frame.shape[:2]
    inside = box.clip(width, height)
    if inside is not None and min(inside.width, inside.height) >= MIN_BOX_PX:
        return inside
    thin = "" if inside is None else f"at least {MIN_BOX_PX:g} pixels wide and high "
    raise UploadError(
        "boxes",
        f"expected boxes {thin}inside the frame of {width}x{height} pixels, "
        f"got box {position}: {[box.x, box.y, box.width, box.height]}",
    )


_LEAST_LABELS = 3  # Two that touch may well embrace.
_COMPARED = 4  # The largest labels of a group; each takes as long as a person's search.


def check_bodies(mask: LabelImage, index: PoseIndex) -> None:
    """Refuse labels of body parts, each of which would be answered as a person who lies.

    The index judges: parts resemble its silhouettes less than the body that they make up.

    Raises
    ------
    UploadError
        If labels that touch are likelier to be one body than a body each.
    """
    if len(mask.present) < _LEAST_LABELS:
        return
    marked = np.asarray(mask.part != 0).view(np.uint8)
    count, groups, stats, _ = cv2.connectedComponentsWithStats(marked)
    for group in range(1, count):
        left, top, width, height = stats[group, : cv2.CC_STAT_AREA].tolist()
        within = slice(top, top + height), slice(left, left + width)
        one = np.where(groups[within] == group, mask.part[within], 0)
        labels, areas = np.unique(one[one > 0], return_counts=True)
        if len(labels) < _LEAST_LABELS:
            continue
        largest = np.argsort(-areas, kind="stable")[:_COMPARED]
        each = [_likelihood(one == label, index) for label in labels[largest]]
        if _likelihood(one > 0, index) > np.average(each, weights=areas[largest]):
            raise UploadError(
                "mask",
                "mask: expected a label for each person (1, 2, ...; 0 is background), got "
                f"{len(labels)} labels that together look like one body, from {labels[0]} to "
                f"{labels[-1]}: parts of a body, or its soft edges, need one label",
            )


def _likelihood(mask: NDArray[np.bool_], index: PoseIndex) -> float:
    """Confidence of the nearest pose of a mask ``(H, W)``."""
    silhouette = silhouette_from_mask(mask, segmenter="mask")
    assert silhouette is not None
    person = NormalisedPerson.of(silhouette, None)
    found = match_silhouette(index, person.silhouette, 1, roll_deg=person.roll_deg)
    return found.hypotheses[0].confidence
