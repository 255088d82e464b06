"""Pictures of people: over their frame, as labels or silhouettes, and the animation of a replay."""

import io
from collections.abc import Sequence
from functools import partial, reduce
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.configuration import Zone
from app.estimation.results import Estimate, Person
from app.tracking.replay import COCO, Moment
from app.tracking.results import Event
from app.vision.geometry import Box
from app.vision.people import LANDMARK_NAMES
from index.skeleton import POINT_NAMES, KeypointSet

Colour = tuple[int, int, int]
"""Blue, green and red."""


def _bgr(colour: str) -> Colour:
    """A colour as the debug page writes it."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red


PEOPLE = tuple(map(_bgr, (
    "#2f9bff", "#31c85f", "#ff7a45", "#e05fe0", "#e0c319", "#23c4c4",
    "#ff5c8a", "#9d7bff", "#b4dd3c", "#c98a5a", "#8fb8ff", "#ff9fd0",
)))  # fmt: skip
"""Colours of people as on the debug page: bright enough for night, dark enough for snow."""

SIDE_COLOURS = {"left": _bgr("#ff8a3c"), "right": _bgr("#3c9dff"), "middle": _bgr("#9fb3b8")}
"""Colours of limbs as on the debug page: the person's own left is orange, right blue."""

OUTLINE = _bgr("#ffffff")

# The meaning of each line, its colour, and whether it is dashed.
LEGEND = (
    ("person's left", SIDE_COLOURS["left"], False),
    ("right", SIDE_COLOURS["right"], False),
    ("unsure", SIDE_COLOURS["middle"], True),
    ("silhouette", OUTLINE, False),
)
# Lines are dashed below this visibility of a landmark, or confidence of a hypothesis.
DASHED_BELOW = 0.5
# The drawn parts of a line, as shares of its length, by whether it is dashed.
_PARTS = {False: ((0.0, 1.0),), True: ((0.0, 0.2), (0.4, 0.6), (0.8, 1.0))}

_FONT, _FONT_PX = cv2.FONT_HERSHEY_SIMPLEX, 22  # The height of a capital letter at scale 1.


def draw_overlay(estimate: Estimate, keypoints: KeypointSet) -> NDArray[np.uint8]:
    """Draw the frame with numbered boxes, postures, silhouettes and the best skeletons, BGR.

    Rows below the frame explain the colours.
    """
    picture = estimate.frame.copy()
    longer = max(picture.shape[:2])
    line, letter = max(1, round(longer / 500)), max(11, longer // 50)
    for number, person in enumerate(estimate.persons, start=1):
        _draw_person(picture, person, PEOPLE[(number - 1) % len(PEOPLE)], keypoints, line)
    # Labels are drawn after all people, so that nobody covers another person's number.
    labels: list[_Label] = []
    for number, person in enumerate(estimate.persons, start=1):
        box = person.box
        posture = person.posture.label.replace("_", " ") if person.posture else ""
        text = f"{number} {posture}".strip()
        width = cv2.getTextSize(text, _FONT, letter / _FONT_PX, 1)[0][0]
        left = max(0, min(round(box.x), picture.shape[1] - width))
        label = _Label(left, left + width, max(letter + 2, round(box.y) - 2 - line))
        labels.append(_below_others(label, labels, letter + 4))
        corner = left, labels[-1].bottom
        write_text(picture, text, corner, letter, PEOPLE[(number - 1) % len(PEOPLE)])
    return np.vstack([picture, _legend(picture.shape[1], letter)])


class _Label(NamedTuple):
    """The place of a text: its first and last column, and its lowest row."""

    left: int
    right: int
    bottom: int


def _below_others(label: _Label, others: Sequence[_Label], height: int) -> _Label:
    """Move a label down until it covers no other one."""
    beside = [other for other in others if label.left < other.right and other.left < label.right]
    while any(abs(label.bottom - other.bottom) < height for other in beside):
        label = label._replace(bottom=label.bottom + height)
    return label


def _draw_person(
    picture: NDArray[np.uint8], person: Person, colour: Colour, keypoints: KeypointSet, line: int
) -> None:
    box, silhouette = person.box, person.silhouette
    # Lines of the width that suits the frame would hide small people.
    thin = min(line, max(1, round(box.height / 100)))
    corners = np.round([box.x, box.y, box.right, box.bottom]).astype(int)
    cv2.rectangle(picture, corners[:2].tolist(), corners[2:].tolist(), colour, thin)
    if silhouette is not None:
        outlines = silhouette.outlines(cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, OUTLINE, thin)
    if person.hypotheses:
        points = person.hypotheses[0].points_2d[list(keypoints.indices)]
        bone = min(line + 1, max(1, round(box.height / 60)))
        draw_skeleton(picture, points, keypoints, bone, _unsure(person, keypoints))


def _unsure(person: Person, keypoints: KeypointSet) -> list[bool]:
    """Return for each keypoint whether the photograph does not show it well."""
    landmarks = person.landmarks
    if person.hypotheses[0].confidence < DASHED_BELOW:
        return [True] * len(keypoints.names)
    if landmarks is None:
        return [False] * len(keypoints.names)
    seen = dict(zip(LANDMARK_NAMES, (landmarks.visibility >= DASHED_BELOW).tolist(), strict=True))
    names = [POINT_NAMES[row].replace("_toe", "_foot_index") for row in keypoints.indices]
    return [not seen.get(name, True) for name in names]


def _legend(width: int, letter: int) -> NDArray[np.uint8]:
    """Draw a strip that explains the colours; its letters shrink to fit."""
    text = "   ".join(name for name, *_ in LEGEND)
    samples = 2 * letter * len(LEGEND)
    wide = cv2.getTextSize(text, _FONT, letter / _FONT_PX, 1)[0][0] + samples + 2 * letter
    letter = max(1, min(letter, letter * width // wide))
    strip = np.full((3 * letter, width, 3), 32, np.uint8)
    left = letter
    for name, colour, dashed in LEGEND:
        middle = 3 * letter // 2
        for start, end in _PARTS[dashed]:
            ends = [(left + round(share * letter), middle) for share in (start, end)]
            cv2.line(strip, ends[0], ends[1], colour, 3)
        corner = left + 3 * letter // 2, 2 * letter
        left = letter + write_text(strip, name, corner, letter, (235, 235, 235))
    return strip


def write_text(
    picture: NDArray[np.uint8], text: str, corner: tuple[int, int], letter: int, colour: Colour
) -> int:
    """Write text with a dark outline into a BGR picture; return the column where it ends.

    ``corner`` is the column and row of its bottom left, ``letter`` the height of a capital, in
    pixels.
    """
    scale, line = letter / _FONT_PX, max(1, letter // 9)
    for width, paint in ((line + 2, (0, 0, 0)), (line, colour)):
        cv2.putText(picture, text, corner, _FONT, scale, paint, width, cv2.LINE_AA)
    return corner[0] + int(cv2.getTextSize(text, _FONT, scale, line)[0][0])


def draw_labels(estimate: Estimate) -> NDArray[np.uint8]:
    """Draw the label image ``(H, W)`` uint8: 0 background, k = the k-th person, counted from 1."""
    labels = np.zeros(estimate.frame.shape[:2], np.uint8)
    for label, person in enumerate(estimate.persons, start=1):
        if person.silhouette is not None:
            person.silhouette.paint(labels, label)
    return labels


def draw_silhouettes(estimate: Estimate) -> NDArray[np.uint8]:
    """Draw the silhouettes ``(H, W, 3)``, BGR, in the colours of their people, on black."""
    colours = np.zeros((256, 3), np.uint8)
    colours[1:] = np.resize(PEOPLE, (255, 3))
    return colours[draw_labels(estimate)]


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Encode grey or BGR pixels as PNG."""
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise ValueError(f"expected a picture to encode, got an array of shape {picture.shape}")
    return data.tobytes()


def draw_skeleton(
    picture: NDArray[np.uint8],
    points: NDArray[np.float64],
    keypoints: KeypointSet,
    line: int,
    unsure: Sequence[bool] = (),
) -> None:
    """Draw bones into a BGR picture, with a dark outline; points that are not finite are left out.

    Left and right have the colours of :data:`SIDE_COLOURS`; bones with an unsure end are dashed.
    The points ``(K, 2)`` are pixels, in the order of ``keypoints``; lines are ``line`` pixels wide.
    """
    # OpenCV takes fixed-point coordinates, here with four fractional bits.
    fixed = np.round(np.nan_to_num(points) * 16).astype(int)
    drawable = [bool(np.isfinite(point).all()) for point in points]
    for seam in (2, 0):
        for parent, child in keypoints.bones:
            if drawable[parent] and drawable[child]:
                colour = (0, 0, 0) if seam else SIDE_COLOURS[side_of(keypoints, parent, child)]
                dashed = bool(unsure) and (unsure[parent] or unsure[child])
                along = fixed[child] - fixed[parent]
                for part in _PARTS[dashed]:
                    ends = fixed[parent] + np.outer(part, along)
                    first, last = np.rint(ends).astype(int).tolist()
                    cv2.line(picture, first, last, colour, line + seam, cv2.LINE_AA, 4)


def side_of(keypoints: KeypointSet, *points: int) -> str:
    """Return ``left`` or ``right`` if a bone ends on that side, else ``middle``."""
    sides = {keypoints.names[point].split("_")[0] for point in points} & {"left", "right"}
    return sides.pop() if len(sides) == 1 else "middle"


# Six seconds take 45 kB at most: smooth lines would take twice as much, and lossy compression,
# which suits photographs, three times.
_LONGER_PX, _STRIP_PX = 320, 20
_BEYOND, _GROUND, _BODY, _ZONE = 16, 40, 66, 110  # Grey.
_SINCE: Colour = (80, 80, 255)
_FACE = ("eye", "ear")

Picture = NDArray[np.uint8]


class _View:
    """The part of the frame that a person crosses, with a margin, as a picture shows it."""

    def __init__(self, moments: Sequence[Moment], frame: tuple[int, ...]) -> None:
        around = reduce(Box.joined, (one.box for one in moments)).grown(0.25)
        part = around.clip(frame[1], frame[0]) or Box(-0.5, -0.5, frame[1], frame[0])
        self._scale = _LONGER_PX / max(part.width, part.height)
        self._corner = np.array([part.x, part.y])
        self.rows, self.columns = (int(side * self._scale) for side in (part.height, part.width))

    def at(self, points: NDArray[np.float64]) -> list[NDArray[np.int32]]:
        """Points ``(P, 2)`` of the frame in the picture, in a list, as OpenCV takes lines."""
        return [np.rint((points - self._corner) * self._scale).astype(np.int32)]


def encode_replay(event: Event, zones: Sequence[Zone]) -> bytes:
    """Draw the replay of an event as an animated WebP.

    What was seen half a second apart stays as a trace, the later the brighter. The first picture
    has all traces, for viewers that show no other.
    """
    assert event.replay is not None
    moments = list(event.replay.moments)
    view = _View(moments, event.replay.shape)
    ground = _empty(view, zones)
    traces = _traces(moments)
    draw = partial(_draw, view, event)
    pictures = []
    for moment in moments:
        pictures.append(draw(ground, moment))
        if moment in traces:
            grey = 70 + 90 * traces.index(moment) // len(traces)
            cv2.polylines(ground, view.at(moment.outline), True, (grey,) * 3)
    first = draw(ground, min(moments, key=lambda one: abs(one.timestamp - event.timestamp)))
    steps = np.diff([one.timestamp for one in moments]) * 1000
    times = [1500, *np.rint(steps).astype(int).tolist(), 1500]
    image, *others = (Image.fromarray(one[..., ::-1]) for one in (first, *pictures))
    file = io.BytesIO()
    kept = {"save_all": True, "append_images": others, "lossless": True, "method": 3}
    image.save(file, "WEBP", duration=times, loop=0, **kept)
    return file.getvalue()


def _traces(moments: Sequence[Moment]) -> list[Moment]:
    """The moments whose outlines stay."""
    kept: list[Moment] = []
    for one in moments:
        is_due = not kept or one.timestamp >= kept[-1].timestamp + 0.5
        if is_due and len(one.outline):
            kept.append(one)
    return kept


def _empty(view: _View, zones: Sequence[Zone]) -> Picture:
    """The zones of an empty frame, and a strip below it for words."""
    picture = np.full((view.rows + _STRIP_PX, view.columns, 3), _BEYOND, np.uint8)
    picture[: view.rows] = _GROUND
    for zone in zones:
        (corners,) = view.at(np.array(zone.polygon))
        cv2.polylines(picture[: view.rows], [corners], True, (_ZONE,) * 3)
        x, y = corners.min(axis=0).clip(0, [view.columns - 40, view.rows - _STRIP_PX]).tolist()
        _write(picture, zone.name, (x + 4, y + 14), (_ZONE,) * 3)
    return picture


def _draw(view: _View, event: Event, ground: Picture, moment: Moment) -> Picture:
    """The person's silhouette, box and skeleton, and how long before or after the event."""
    picture = ground.copy()
    if len(moment.outline):
        cv2.fillPoly(picture, view.at(moment.outline), (_BODY,) * 3)
        cv2.polylines(picture, view.at(moment.outline), True, OUTLINE)
    box = moment.box
    corners = [[box.x, box.y], [box.right, box.y], [box.right, box.bottom], [box.x, box.bottom]]
    cv2.polylines(picture, view.at(np.array(corners)), True, PEOPLE[0])
    for parent, child in COCO.bones:
        bone = moment.joints[[parent, child]]
        if np.isfinite(bone).all() and not COCO.names[child].endswith(_FACE):
            colour = SIDE_COLOURS[side_of(COCO, parent, child)]
            cv2.polylines(picture, view.at(bone), False, colour, 2)
    since_s = moment.timestamp - event.timestamp
    words = f"{event.event.replace('_', ' ')} {since_s:+.1f} s"
    picture[view.rows :] = _BEYOND
    _write(picture, words, (6, len(picture) - 6), OUTLINE if since_s < 0 else _SINCE)
    return picture


def _write(picture: Picture, text: str, corner: tuple[int, int], colour: Colour) -> None:
    cv2.putText(picture, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour)
