"""The pictures that the requests send: those in ``tests/data``, and drawn ones."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Point = tuple[int, int]

DATA = Path(__file__).resolve().parent.parent / "data"
STREET = (DATA / "walkers.jpg").read_bytes()
STREET_MASK = (DATA / "walkers-mask.png").read_bytes()
YARD = (DATA / "yard.jpg").read_bytes()
EMPTY_YARD = (DATA / "yard-empty.jpg").read_bytes()

WALKER = 2
"""The label of the tallest person of :data:`STREET_MASK`."""


def png(picture: Picture) -> bytes:
    """Encode as PNG."""
    return cv2.imencode(".png", picture)[1].tobytes()


def decode(content: bytes) -> Picture:
    """Decode a picture as it is stored."""
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None, "expected a picture"
    return pixels.astype(np.uint8, copy=False)


def figure(*limbs: tuple[Point, ...], head: Point, thickness: int = 22) -> Picture:
    """Draw a silhouette ``(320, 240)`` of 0 and 1: lines through points, and a head."""
    canvas = np.zeros((320, 240), np.uint8)
    for limb in limbs:
        cv2.polylines(canvas, [np.array(limb, np.int32)], False, 1, thickness)
    cv2.circle(canvas, head, thickness, 1, -1)
    return canvas


def standing() -> Picture:
    """A person who stands, arms hanging a little aside."""
    torso = ((112, 80), (128, 80), (130, 160), (110, 160), (112, 80), (120, 160))
    arms = ((80, 170), (88, 120), (105, 80), (135, 80), (152, 120), (160, 170))
    return figure(torso, arms, ((112, 160), (104, 290)), ((128, 160), (136, 290)), head=(120, 48))


def arms_raised() -> Picture:
    """A person who holds both arms up."""
    torso = ((112, 100), (128, 100), (130, 175), (110, 175), (112, 100), (120, 175))
    arms = ((70, 24), (82, 66), (105, 100), (135, 100), (158, 66), (170, 24))
    return figure(torso, arms, ((112, 175), (100, 300)), ((128, 175), (140, 300)), head=(120, 68))


def lying() -> Picture:
    """The standing person, on the side."""
    return np.ascontiguousarray(np.rot90(standing()))


def _turned(lines: Sequence[Sequence[Point]], about: Point, degrees: float) -> list[Any]:
    """Lines of a figure, turned about a point; whole pixels, hence the same on every processor."""
    turn = np.deg2rad(degrees)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return [np.rint((np.array(line) - about) @ matrix.T + about).astype(int) for line in lines]


def falling(degrees: float) -> Picture:
    """The standing person, tilted to the right about the feet by ``degrees``: ``(360, 400)``."""
    torso = ((112, 110), (128, 110), (130, 190), (110, 190), (112, 110), (120, 190))
    arms = ((80, 200), (88, 150), (105, 110), (135, 110), (152, 150), (160, 200))
    legs = ((112, 190), (104, 320)), ((128, 190), (136, 320))
    *limbs, head = _turned((torso, arms, *legs, ((120, 78),)), (120, 320), degrees)
    canvas = np.zeros((360, 400), np.uint8)
    for limb in limbs:
        cv2.polylines(canvas, [limb], False, 1, 22)
    cv2.circle(canvas, (int(head[0][0]), int(head[0][1])), 22, 1, -1)
    return canvas


def falls() -> Iterator[Picture]:
    """Two people at ten frames a second for 4 s: both stand for 1.5 s, fall in 0.7 s, and lie.

    Labels ``(360, 800)``: 1 falls in the left half, 2 a little later in the right half.
    """
    for step in range(40):
        first, second = (np.clip((step - begin) / 7, 0, 1) * 86 for begin in (15, 18))
        yield np.hstack([falling(first), 2 * falling(second)])


def crossing() -> Iterator[Picture]:
    """Two people who walk past each other at ten frames a second for 2.5 s: ``(340, 640)``.

    The nearer person walks to the left and covers the other one half-way.
    """
    near = standing()
    far = cv2.resize(near, (192, 256), interpolation=cv2.INTER_NEAREST)
    for step in range(25):
        canvas = np.zeros((340, 640), np.uint8)
        canvas[40:296, 20 + 16 * step : 212 + 16 * step][far == 1] = 1
        canvas[10:330, 400 - 16 * step : 640 - 16 * step][near == 1] = 2
        if np.count_nonzero(canvas == 1) < np.count_nonzero(far) / 2:
            canvas[canvas == 1] = 0  # A sliver of a person is no mask that a caller would send.
        yield canvas


def greeting() -> Iterator[Picture]:
    """A person at ten frames a second who stands, raises both arms from 1.5 to 3 s, and stands."""
    for step in range(45):
        yield arms_raised() if 15 <= step < 30 else standing()


def crowd() -> Picture:
    """Three people, labelled 1 to 3: standing, cut off by the right border, and small."""
    canvas = np.zeros((340, 480), np.uint8)
    canvas[10:330, :240][standing() == 1] = 2
    canvas[10:330, 330:][arms_raised()[:, :150] == 1] = 1
    small = cv2.resize(standing(), (60, 80), interpolation=cv2.INTER_NEAREST)
    canvas[120:200, 240:300][small == 1] = 3
    return canvas


def frame_of(mask: Picture) -> Picture:
    """Draw a frame: dark where ``mask`` is set, a coarse chequered wall elsewhere."""
    rows, columns = np.indices(mask.shape) // 24
    wall = 170 + 40 * ((rows + columns) % 2)
    return np.where(mask > 0, 60, wall).astype(np.uint8)


def walk(steps: int) -> list[tuple[Picture, Picture]]:
    """Frames ``(330, 400, 3)`` and masks ``(330, 400)``: a walker crosses the empty yard.

    The walker is cut from the street, and moves to the right by six pixels a frame.
    """
    street, yard = decode(STREET), decode(EMPTY_YARD)
    mask = decode(STREET_MASK)
    rows, columns = np.nonzero(mask == WALKER)
    frames = []
    for step in range(steps):
        places = rows + 20, columns + 6 * step
        frame, walker = yard.copy(), np.zeros_like(yard[..., 0])
        frame[places], walker[places] = street[rows, columns], 1
        frames.append((frame, walker))
    return frames


def film(steps: int) -> bytes:
    """Ten frames a second of :func:`walk`, as Motion JPEG."""
    frames = [frame for frame, _ in walk(steps)]
    size = (frames[0].shape[1], frames[0].shape[0])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.avi"
        codec = cv2.VideoWriter.fourcc(*"MJPG")
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, 10.0, size)
        for frame in frames:
            writer.write(frame)
        writer.release()
        return path.read_bytes()
