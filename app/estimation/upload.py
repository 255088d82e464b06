"""Uploads: images, masks and boxes are decoded, validated, and resized to square pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.images import (
    ImageError,
    ImageTooLargeError,
    ImageWarning,
    LabelImage,
    Photograph,
    blank_image,
    decode_image,
    decode_mask,
)
from app.vision.optics import PinholeCamera
from app.vision.people import Silhouette, silhouette_from_mask

Pixels = TypeVar("Pixels", bound=NDArray[Any])
AnyPerson = TypeVar("AnyPerson", bound=Person)


T = TypeVar("T")

_MAX_FRAMES_OF_PEOPLE = 4
"""A caller's boxes may together cover this many times the area of the largest frame. The boxes of a
crowd overlap less, and the work on people grows with their pixels."""

MIN_BOX_PX = 0.01
"""Shortest side of a caller's box: a unit of the last digit of a reply."""

_MIN_FIGURE_SHARE = 0.25
"""Area of the smallest part of a mask that may be a person, as a share of the largest part's."""

_MIN_FIGURE_PX = 48
"""Height of the smallest part of a mask that may be a person."""

_MIN_GAP_SHARE = 0.5
"""Parts of a mask are different people if the gap between them is wider than this share of the
narrower one."""


class UploadError(ValueError):
    """An upload that cannot be used; the message is one sentence.

    The field is ``frame``, ``mask``, ``background``, ``boxes`` or ``track_ids``; a ``misfit`` is
    valid in itself, but not for this frame.
    """

    def __init__(
        self, field: str, reason: Literal["undecodable", "too_large", "misfit"], message: str
    ) -> None:
        super().__init__(message)
        self.field = field
        self.reason = reason


@dataclass(frozen=True)
class Upload:
    """Encoded images and, if known, where the people are.

    Parameters
    ----------
    frame : bytes or (H, W, 3) uint8 array, optional
        Photograph, encoded or as BGR pixels; may be missing if there is a mask.
    mask : bytes, optional
        Encoded label image of the same size: 0 background, k = person k. It cannot be combined with
        boxes or a background.
    background : bytes, optional
        Encoded photograph of the empty scene, of the same size.
    boxes : sequence of Box, optional
        In pixels of the frame.
    track_ids : sequence of str, optional
        The caller's identity of the person in each box.
    fov_deg : float, optional
        Horizontal field of view of the camera; assumed if it is not given.
    pixel_aspect : float, optional
        Width over height of a pixel; 1 if it is not given.
    """

    frame: bytes | NDArray[np.uint8] | None = None
    mask: bytes | None = None
    background: bytes | None = None
    boxes: Sequence[Box] | None = None
    track_ids: Sequence[str] | None = None
    fov_deg: float | None = None
    pixel_aspect: float | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the given images and lists, which determine how long the work takes."""
        names = ("frame", "mask", "background", "boxes", "track_ids")
        return tuple(name for name in names if getattr(self, name) is not None)

    def __post_init__(self) -> None:
        if self.frame is None and self.mask is None:
            raise UploadError("frame", "misfit", "frame: expected an image file, got none")
        for name in ("background", "boxes"):
            if self.mask is not None and getattr(self, name) is not None:
                raise UploadError(name, "misfit", f"expected a mask or {name}, got both")
        if self.track_ids is not None:
            _check_track_ids(self.track_ids, self.boxes)


def _check_track_ids(track_ids: Sequence[str], boxes: Sequence[Box] | None) -> None:
    if boxes is None or len(track_ids) != len(boxes):
        count = "no boxes" if boxes is None else f"{len(boxes)} boxes"
        raise UploadError(
            "track_ids",
            "misfit",
            f"track_ids: expected one for each box, got {len(track_ids)} and {count}",
        )
    for track_id, times in Counter(track_ids).items():
        if times > 1:
            raise UploadError(
                "track_ids", "misfit", f"track_ids: expected each once, got {track_id!r} twice"
            )


@dataclass(frozen=True)
class DecodedUpload:
    """Images of one size and with square pixels, and boxes within them.

    Parameters
    ----------
    sent : (H, W, 3) uint8 array
        The frame as sent, BGR; black if the caller sent a mask alone.
    frame : (H, W, 3) uint8 array
        The frame with square pixels.
    has_frame : bool
        Whether the caller sent a frame, or a mask alone.
    background : (H, W, 3) uint8 array or None
        BGR.
    boxes : list of Box or None
        Clipped to the frame.
    pixels : SquarePixels
        Conversion from the frame as sent to the one with square pixels.
    warnings : tuple of str
        Of the frame; see :class:`app.vision.images.Photograph`.
    """

    sent: NDArray[np.uint8]
    frame: NDArray[np.uint8]
    has_frame: bool
    mask: LabelImage | None
    background: NDArray[np.uint8] | None
    boxes: list[Box] | None
    camera: PinholeCamera
    pixels: SquarePixels
    warnings: tuple[ImageWarning, ...] = ()


@dataclass(frozen=True)
class UploadDecoder:
    """Decodes uploads; raises :class:`UploadError` for those that cannot be used.

    Images may have ``max_pixels``; boxes or a mask may mark ``max_persons``.
    """

    max_pixels: int
    max_persons: int

    def decode(self, upload: Upload, job: Job, *, blank: bool = False) -> DecodedUpload:
        """Decode all images of an upload and check that they fit together.

        With ``blank``, the frame is black: nothing will look at it.
        """
        images = (
            ("frame", upload.frame, blank_image if blank else decode_image),
            ("mask", upload.mask, decode_mask),
            ("background", upload.background, decode_image),
        )
        sent = [image for image in images if isinstance(image[1], bytes)]
        decoded: list[Any] = job.map(lambda image: self._decode(*image), sent)
        by_name = dict(zip((name for name, _, _ in sent), decoded, strict=True))
        mask, background = by_name.get("mask"), by_name.get("background")
        if isinstance(upload.frame, np.ndarray):
            photograph = Photograph.of(upload.frame)
        elif "frame" in by_name:
            photograph = by_name["frame"]
        else:
            photograph = Photograph(np.zeros((*by_name["mask"].labels.shape, 3), np.uint8))
        frame = photograph.pixels
        if mask is not None:
            _check_size("mask", mask.labels, frame)
            self._check_count("mask", len(mask.present))
            _check_together(mask)
            self._check_area("mask", mask.boxes)
        if background is not None:
            background = background.pixels
            _check_size("background", background, frame)
        boxes = self._boxes(upload.boxes, frame)
        pixels = SquarePixels.of_frame(frame.shape, upload.pixel_aspect or 1.0)
        self._check_square(pixels)
        if mask is not None and pixels.changes:
            mask = LabelImage.of(pixels.resize(mask.labels, cv2.INTER_NEAREST))
        return DecodedUpload(
            sent=frame,
            frame=pixels.resize(frame),
            has_frame=upload.frame is not None,
            mask=mask,
            background=None if background is None else pixels.resize(background),
            boxes=None if boxes is None else pixels.boxes(boxes),
            camera=PinholeCamera.of_frame(pixels.square, upload.fov_deg),
            pixels=pixels,
            warnings=photograph.warnings,
        )

    def _decode(self, name: str, data: bytes, decode: Callable[..., T]) -> T:
        try:
            return decode(data, max_pixels=self.max_pixels)
        except ImageTooLargeError as error:
            raise UploadError(name, "too_large", f"{name}: {error}") from error
        except ImageError as error:
            raise UploadError(name, "undecodable", f"{name}: {error}") from error

    def _check_square(self, pixels: SquarePixels) -> None:
        height, width = pixels.square
        if pixels.changes and width * height > self.max_pixels:
            raise UploadError(
                "frame",
                "too_large",
                f"frame: expected at most {self.max_pixels} pixels once they are square, "
                f"got {width}x{height}",
            )

    def _boxes(self, boxes: Sequence[Box] | None, frame: NDArray[np.uint8]) -> list[Box] | None:
        if boxes is None:
            return None
        self._check_count("boxes", len(boxes))
        inside = [_clip(box, frame, position) for position, box in enumerate(boxes)]
        self._check_area("boxes", inside)
        return inside

    def _check_count(self, name: str, count: int) -> None:
        if count > self.max_persons:
            raise UploadError(
                name, "misfit", f"expected at most {self.max_persons} persons, got {count}"
            )

    def _check_area(self, name: str, boxes: Sequence[Box]) -> None:
        """Bound the work on people, which grows with the pixels of their boxes."""
        most, area = _MAX_FRAMES_OF_PEOPLE * self.max_pixels, sum(box.area for box in boxes)
        if area > most:
            raise UploadError(
                name,
                "misfit",
                f"{name}: expected people whose boxes together hold at most {most} pixels, "
                f"got {area:.0f}",
            )


def _check_size(name: str, image: NDArray[np.generic], frame: NDArray[np.uint8]) -> None:
    if image.shape[:2] != frame.shape[:2]:
        (height, width), (other_height, other_width) = frame.shape[:2], image.shape[:2]
        raise UploadError(
            name,
            "misfit",
            f"expected a {name} of {width}x{height} pixels like the frame, "
            f"got {other_width}x{other_height}",
        )


def _check_together(mask: LabelImage) -> None:
    """Refuse a mask whose only label marks several people who are apart from one another.

    Taken as one person, they would form a wide silhouette and appear to be lying.
    """
    if len(mask.present) != 1:
        return
    marked = np.asarray(mask.part != 0).view(np.uint8)
    stats = cv2.connectedComponentsWithStats(marked)[2][1:]
    areas = stats[:, cv2.CC_STAT_AREA]
    large = stats[areas >= _MIN_FIGURE_SHARE * areas.max()]
    apart = 1 + _gaps_between_people(large[np.argsort(large[:, cv2.CC_STAT_LEFT], kind="stable")])
    if apart > 1:
        raise UploadError(
            "mask",
            "misfit",
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
    wide = gap > _MIN_GAP_SHARE * np.minimum(width[:-1], width[1:])
    return int(np.count_nonzero(alike & wide))


def _clip(box: Box, frame: NDArray[np.uint8], position: int) -> Box:
    height, width = frame.shape[:2]
    inside = box.clip(width, height)
    if inside is not None and min(inside.width, inside.height) >= MIN_BOX_PX:
        return inside
    thin = "" if inside is None else f"at least {MIN_BOX_PX:g} pixels wide and high "
    raise UploadError(
        "boxes",
        "misfit",
        f"expected boxes {thin}inside the frame of {width}x{height} pixels, "
        f"got box {position}: {[box.x, box.y, box.width, box.height]}",
    )


@dataclass(frozen=True)
class SquarePixels:
    """Height and width of a frame as sent, and as it was resized so that its pixels are square."""

    sent: tuple[int, int]
    square: tuple[int, int]

    @classmethod
    def of_frame(cls, frame_shape: tuple[int, ...], pixel_aspect: float) -> SquarePixels:
        """Widen or heighten a frame with pixels of this aspect ratio, so that no detail is lost.

        Examples
        --------
        >>> SquarePixels.of_frame((1080, 960), 2.0).square
        (1080, 1920)
        """
        height, width = frame_shape[:2]
        square = (
            round(height * max(1.0, 1 / pixel_aspect)),
            round(width * max(1.0, pixel_aspect)),
        )
        return cls((height, width), square)

    @property
    def changes(self) -> bool:
        """Whether the frame has to be resized at all."""
        return self.sent != self.square

    @property
    def scale(self) -> NDArray[np.float64]:
        """Square pixels ``(2,)`` across and down for each pixel as sent."""
        return np.asarray(np.array(self.square[::-1]) / np.array(self.sent[::-1]))

    def resize(self, image: Pixels, interpolation: int = cv2.INTER_LINEAR) -> Pixels:
        """Resize an image ``(H, W, ...)`` to square pixels."""
        if not self.changes:
            return image
        resized = cv2.resize(image, self.square[::-1], interpolation=interpolation)
        return cast(Pixels, resized)

    def points(self, sent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the frame as sent, in square pixels."""
        return np.asarray((sent + 0.5) * self.scale - 0.5) if self.changes else sent

    def points_sent(self, square: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` in square pixels, in pixels of the frame as sent."""
        return np.asarray((square + 0.5) / self.scale - 0.5) if self.changes else square

    def boxes(self, sent: Sequence[Box]) -> list[Box]:
        """Boxes of the frame as sent, in square pixels."""
        return [_between(*self.points(_corners(box))) for box in sent] if self.changes else [*sent]

    def person_sent(self, person: AnyPerson) -> AnyPerson:
        """A person found in square pixels, in pixels of the frame as sent, for answers only.

        The window for the next frame stays in square pixels, since it is read in them.
        """
        if not self.changes:
            return person
        landmarks = person.landmarks and replace(
            person.landmarks, positions=self.points_sent(person.landmarks.positions)
        )
        silhouette = person.silhouette and self._silhouette_sent(person.silhouette)
        box = _between(*self.points_sent(_corners(person.box)))
        hypotheses = tuple(
            replace(one, points_2d=self.points_sent(one.points_2d)) for one in person.hypotheses
        )
        return replace(
            person, box=box, silhouette=silhouette, landmarks=landmarks, hypotheses=hypotheses
        )

    def _silhouette_sent(self, silhouette: Silhouette) -> Silhouette | None:
        mask = silhouette.mask(self.square).view(np.uint8)
        sent = cv2.resize(mask, self.sent[::-1], interpolation=cv2.INTER_NEAREST) > 0
        if not sent.any():
            # The silhouette is narrower than a pixel of the frame as sent.
            column, row = self.points_sent(silhouette.centroid).round().astype(int).tolist()
            sent[min(max(row, 0), self.sent[0] - 1), min(max(column, 0), self.sent[1] - 1)] = True
        return silhouette_from_mask(
            sent, segmenter=silhouette.segmenter, truncated=silhouette.truncated
        )


def _corners(box: Box) -> NDArray[np.float64]:
    return np.array([[box.x, box.y], [box.right, box.bottom]])


def _between(first: NDArray[np.float64], last: NDArray[np.float64]) -> Box:
    return Box.from_edges(*first.tolist(), *last.tolist())
