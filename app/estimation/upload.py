"""Uploads: images, masks and boxes are decoded, validated and rectified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person, ProjectedHypothesis
from app.scheduling.job import Job
from app.vision.geometry import Box, transform_points
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
from app.vision.optics import UNKNOWN_OPTICS, Optics, PinholeCamera
from app.vision.people import Silhouette, silhouette_from_mask
from app.vision.silhouettes import ends_at_border
from index.skeleton import rotate_clockwise, wrap_degrees

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


UploadFault = Literal["undecodable", "too_large", "misfit"]
"""A misfit is valid in itself, but not for this frame."""


class UploadError(ValueError):
    """An upload that cannot be used; its message is one sentence, its field the one at fault."""

    def __init__(self, field: str, message: str, reason: UploadFault = "misfit") -> None:
        super().__init__(message)
        self.field = field
        self.reason = reason


@dataclass(frozen=True)
class Upload:
    """Encoded images of one size and, if known, where the people are.

    The frame is a photograph, encoded or ``(H, W, 3)`` BGR pixels; it may be missing if there is a
    mask: a label image, 0 background, k = person k, which cannot be combined with boxes, in pixels
    of the frame, or a background, a photograph of the empty scene. ``track_ids`` are the caller's
    identities of the people in the boxes. Without optics, a field of view is assumed, with square
    pixels and an upright camera.
    """

    frame: bytes | NDArray[np.uint8] | None = None
    mask: bytes | None = None
    background: bytes | None = None
    boxes: Sequence[Box] | None = None
    track_ids: Sequence[str] | None = None
    optics: Optics = UNKNOWN_OPTICS

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the given images and lists, which determine how long the work takes."""
        names = ("frame", "mask", "background", "boxes", "track_ids")
        return tuple(name for name in names if getattr(self, name) is not None)

    def __post_init__(self) -> None:
        if self.frame is None and self.mask is None:
            raise UploadError("frame", "frame: expected an image file, got none")
        for name in ("background", "boxes"):
            if self.mask is not None and getattr(self, name) is not None:
                raise UploadError(name, f"expected a mask or {name}, got both")
        if self.track_ids is not None:
            _check_track_ids(self.track_ids, self.boxes)


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

    Images are ``(H, W, 3)``, BGR. ``sent`` is the frame as sent, black if the caller sent a mask
    alone, which ``has_frame`` tells; ``frame`` is the rectified one, to which the camera and the
    boxes, clipped to it, belong. ``rectification`` converts between the two; warnings about the
    frame are those of :class:`app.vision.images.Photograph`.
    """

    sent: NDArray[np.uint8]
    frame: NDArray[np.uint8]
    has_frame: bool
    mask: LabelImage | None
    background: NDArray[np.uint8] | None
    boxes: list[Box] | None
    camera: PinholeCamera
    rectification: Rectification
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

    def _decode(self, name: str, data: bytes, decode: Callable[..., T]) -> T:
        try:
            return decode(data, max_pixels=self.max_pixels)
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
        most, area = _MAX_FRAMES_OF_PEOPLE * self.max_pixels, sum(box.area for box in boxes)
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
        f"expected boxes {thin}inside the frame of {width}x{height} pixels, "
        f"got box {position}: {[box.x, box.y, box.width, box.height]}",
    )


@dataclass(frozen=True)
class Rectification:
    """How a frame was rectified: its pixels made square, then the camera's roll undone.

    Height and width of the frame as sent, with square pixels, and turned clockwise by ``roll_deg``,
    which is from 0 to below 360.
    """

    sent: tuple[int, int]
    square: tuple[int, int]
    upright: tuple[int, int]
    roll_deg: float

    @classmethod
    def of_frame(cls, frame_shape: tuple[int, ...], optics: Optics) -> Rectification:
        """Widen or heighten a frame, so that no detail is lost, and turn all of it upright.

        Examples
        --------
        >>> Rectification.of_frame((1080, 960), Optics(pixel_aspect=2.0, roll_deg=90)).upright
        (1920, 1080)
        """
        height, width = frame_shape[:2]
        aspect, roll_deg = optics.pixel_aspect or 1.0, (optics.roll_deg or 0.0) % 360
        square = round(height * max(1.0, 1 / aspect)), round(width * max(1.0, aspect))
        upright = square if roll_deg % 180 == 0 else square[::-1]
        if roll_deg % 90:
            turn = np.abs(_rotation(roll_deg))
            across, down = np.ceil(turn @ square[::-1]).astype(int).tolist()
            upright = down, across
        return cls((height, width), square, upright, roll_deg)

    @property
    def changes(self) -> bool:
        """Whether the frame is not rectified as it was sent."""
        return self.sent != self.square or self.roll_deg != 0

    def rectify(self, image: Pixels, interpolation: int = cv2.INTER_LINEAR) -> Pixels:
        """Rectify an image ``(H, W, ...)``; what lies beyond it is 0."""
        if not self.changes:
            return image
        if self.roll_deg % 90:
            size = self.upright[::-1]
            turned = cv2.warpAffine(image, self._matrix, size, flags=interpolation)
            return cast(Pixels, turned)
        resized = cv2.resize(image, self.square[::-1], interpolation=interpolation)
        return cast(Pixels, _turned(resized, self.roll_deg))

    def points(self, sent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the frame as sent, in the rectified one."""
        return transform_points(self._matrix, sent) if self.changes else sent

    def points_sent(self, rectified: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(..., 2)`` of the rectified frame, in the one that was sent."""
        return transform_points(self._matrix_sent, rectified) if self.changes else rectified

    def axes_sent(self, rectified: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors ``(..., 3)`` in axes of the upright camera, in those of the real one."""
        return rotate_clockwise(rectified, -self.roll_deg) if self.roll_deg else rectified

    def boxes(self, sent: Sequence[Box]) -> list[Box]:
        """Boxes of the frame as sent, in the rectified one."""
        return [_about(self.points(_corners(box))) for box in sent] if self.changes else [*sent]

    def box_sent(self, rectified: Box) -> Box:
        """A box of the rectified frame, in the one that was sent."""
        return _about(self.points_sent(_corners(rectified))) if self.changes else rectified

    def cuts_askew(self, box: Box) -> bool:
        """Whether a slanted border, within the rectified frame, may cut a person in a box."""
        return self.roll_deg % 90 != 0 and ends_at_border(self.box_sent(box), self.sent)

    def camera_sent(self, camera: PinholeCamera) -> PinholeCamera:
        """The camera of the rectified frame, before it was turned upright."""
        return camera.centred(self.square)

    def person_sent(self, person: AnyPerson) -> AnyPerson:
        """A person of the rectified frame, in pixels and axes of the one that was sent.

        For answers only: the window for the next frame is not changed, since it is read in the
        rectified frame. Where the frame is turned by an angle that is no multiple of 90 degrees,
        the box is the silhouette's.
        """
        if not self.changes:
            return person
        landmarks = person.landmarks and replace(
            person.landmarks,
            positions=self.points_sent(person.landmarks.positions),
            metres=self.axes_sent(person.landmarks.metres),
        )
        silhouette = person.silhouette and self._silhouette_sent(person.silhouette)
        box = self.box_sent(person.box)
        if silhouette and self.roll_deg % 90:
            box = silhouette.box
        hypotheses = tuple(self._hypothesis_sent(one) for one in person.hypotheses)
        return replace(
            person, box=box, silhouette=silhouette, landmarks=landmarks, hypotheses=hypotheses
        )

    @cached_property
    def _matrix(self) -> NDArray[np.float64]:
        """Affine transform ``(2, 3)`` from the frame as sent to the rectified one."""
        sent, square, upright = (np.array(s[::-1]) for s in (self.sent, self.square, self.upright))
        linear = _rotation(self.roll_deg) * (square / sent)
        return np.column_stack([linear, (upright - 1) / 2 - linear @ ((sent - 1) / 2)])

    @cached_property
    def _matrix_sent(self) -> NDArray[np.float64]:
        return np.asarray(cv2.invertAffineTransform(self._matrix), np.float64)

    def _hypothesis_sent(self, hypothesis: ProjectedHypothesis) -> ProjectedHypothesis:
        label = hypothesis.label
        if self.roll_deg:
            label = replace(label, roll_deg=float(wrap_degrees(label.roll_deg - self.roll_deg)))
        return replace(
            hypothesis,
            label=label,
            points_2d=self.points_sent(hypothesis.points_2d),
            points_3d=self.axes_sent(hypothesis.points_3d),
            pelvis=self.axes_sent(hypothesis.pelvis),
        )

    def _silhouette_sent(self, silhouette: Silhouette) -> Silhouette | None:
        mask = silhouette.mask(self.upright).view(np.uint8)
        if self.roll_deg % 90:
            flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            sent = cv2.warpAffine(mask, self._matrix, self.sent[::-1], flags=flags) > 0
        else:
            turned = _turned(mask, -self.roll_deg)
            sent = cv2.resize(turned, self.sent[::-1], interpolation=cv2.INTER_NEAREST) > 0
        if not sent.any():
            # The silhouette is narrower than a pixel of the frame as sent.
            column, row = self.points_sent(silhouette.centroid).round().astype(int).tolist()
            sent[min(max(row, 0), self.sent[0] - 1), min(max(column, 0), self.sent[1] - 1)] = True
        return silhouette_from_mask(
            sent, segmenter=silhouette.segmenter, truncated=silhouette.truncated
        )


def _rotation(roll_deg: float) -> NDArray[np.float64]:
    """Rotation ``(2, 2)`` of a picture, clockwise."""
    cosine, sine = np.cos(np.deg2rad(roll_deg)), np.sin(np.deg2rad(roll_deg))
    return np.array([[cosine, -sine], [sine, cosine]])


_QUARTERS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


def _turned(image: NDArray[Any], roll_deg: float) -> NDArray[Any]:
    """Turn an image ``(H, W, ...)`` clockwise by a multiple of 90 degrees."""
    quarters = roll_deg % 360
    return cv2.rotate(image, _QUARTERS[int(quarters)]) if quarters else image


def _corners(box: Box) -> NDArray[np.float64]:
    return np.array([[x, y] for x in (box.x, box.right) for y in (box.y, box.bottom)])


def _about(points: NDArray[np.float64]) -> Box:
    return Box.from_edges(*points.min(axis=0).tolist(), *points.max(axis=0).tolist())
