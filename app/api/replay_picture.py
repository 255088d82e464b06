"""An animated picture of a replay: a person's outlines on an empty ground."""

import io
from collections.abc import Sequence
from functools import partial, reduce

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from app.api.overlay import OUTLINE, PEOPLE, SIDE_COLOURS, Colour, side_of
from app.tracking.replay import COCO, Moment
from app.tracking.results import Event
from app.tracking.zones import Zone
from app.vision.geometry import Box

# Six seconds take 45 kB at most: smooth lines would take twice as much, and lossy compression,
# which suits photographs, three times.
_LONGER_PX, _STRIP_PX = 320, 20
_FIRST_MS = _LAST_MS = 1500
_MARGIN, _TRACED_EVERY_S = 0.25, 0.5
_BEYOND, _GROUND, _BODY, _ZONE = 16, 40, 66, 110  # Grey.
_SINCE: Colour = (80, 80, 255)
_FACE = ("eye", "ear")

Picture = NDArray[np.uint8]


class _View:
    """The part of the frame that a person crosses, with a margin, as a picture shows it."""

    def __init__(self, moments: Sequence[Moment], frame: tuple[int, ...]) -> None:
        around = reduce(Box.joined, (one.box for one in moments)).grown(_MARGIN)
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
    times = [_FIRST_MS, *np.rint(steps).astype(int).tolist(), _LAST_MS]
    image, *others = (Image.fromarray(one[..., ::-1]) for one in (first, *pictures))
    file = io.BytesIO()
    kept = {"save_all": True, "append_images": others, "lossless": True, "method": 3}
    image.save(file, "WEBP", duration=times, loop=0, **kept)
    return file.getvalue()


def _traces(moments: Sequence[Moment]) -> list[Moment]:
    """The moments whose outlines stay."""
    kept: list[Moment] = []
    for one in moments:
        is_due = not kept or one.timestamp >= kept[-1].timestamp + _TRACED_EVERY_S
        if is_due and len(one.outline):
            kept.append(one)
    return kept


def _empty(view: _View, zones: Sequence[Zone]) -> Picture:
    """The zones of an empty frame, and a strip below it for words."""
    picture = np.full((view.rows + _STRIP_PX, view.columns, 3), _BEYOND, np.uint8)
    picture[: view.rows] = _GROUND
    for zone in zones:
        (corners,) = view.at(zone.polygon)
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
