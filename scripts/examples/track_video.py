"""Annotate a video with the people who are tracked in it, in this process.

    python -m scripts track-video VIDEO OUT.mp4 [--stride 1] [--sheet FILE]

The video is MPEG-4 Part 2, which players show and most browsers do not. A service answers the same
results as JSON to ``POST /sequence``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api.overlay import PEOPLE, draw_skeleton, write_text
from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from app.tracking.results import Event, TrackedFrame, TrackedPerson
from index import DEFAULT_PATH
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import NATIVE
from scripts.datasets import read_frames
from scripts.helpers import check_outputs

SHEET_FRAMES, SHEET_COLUMNS, CELL_PX = 12, 3, 400
EVENT_SHOWN_S = 2.0
_USUAL_FPS = 25.0
_WHITE = (255, 255, 255)

Picture = NDArray[np.uint8]


class Annotator:
    """Draws tracked people; what happens to them stays on show for :data:`EVENT_SHOWN_S`."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def draw(self, frame: TrackedFrame) -> Picture:
        """Return a copy of the frame with boxes, smoothed skeletons and captions."""
        picture = frame.frame.copy()
        letter = max(14, max(picture.shape[:2]) // 40)
        for tracked in frame.persons:
            _draw_skeleton_and_box(picture, tracked)
        # Afterwards, so that no skeleton covers a caption.
        for tracked in frame.persons:
            _draw_captions(picture, tracked, letter)
        write_text(picture, f"{frame.timestamp:.1f} s", (letter, 2 * letter), letter, _WHITE)
        self._events = [
            event
            for event in (*self._events, *frame.events)
            if event.timestamp > frame.timestamp - EVENT_SHOWN_S
            and event.event not in ("entered", "left")
        ]
        for line, event in enumerate(reversed(self._events)):
            corner = (letter, picture.shape[0] - letter - line * 3 * letter // 2)
            text = f"{event.track_id} {event.event}" + " ended" * (event.state == "end")
            write_text(picture, text, corner, letter, _colour(event.track_id))
        return picture


def _draw_skeleton_and_box(picture: Picture, tracked: TrackedPerson) -> None:
    box = tracked.person.observed.box
    corners = np.round([box.x, box.y, box.right, box.bottom]).astype(int)
    colour = _colour(tracked.track_id)
    cv2.rectangle(picture, corners[:2].tolist(), corners[2:].tolist(), colour, 2)
    if tracked.pose is not None:
        bone = min(4, max(2, round(box.height / 50)))
        draw_skeleton(picture, tracked.pose.points_2d[list(NATIVE.indices)], NATIVE, bone)


def _draw_captions(picture: Picture, tracked: TrackedPerson, letter: int) -> None:
    """Write the track's number above the box, posture and action below it."""
    box, posture, action = tracked.person.observed.box, tracked.person.posture, tracked.action
    left, small = max(0, round(box.x)), letter * 2 // 3
    corner = (left, max(letter + 2, round(box.y) - 4))
    write_text(picture, str(tracked.track_id), corner, letter, _colour(tracked.track_id))
    lines = [posture.label.replace("_", " ")] if posture else []
    # An action that repeats the posture is left out.
    if action is not None and not (posture and posture.label.startswith(action.label)):
        lines.append(action.label)
    for line, text in enumerate(lines, start=1):
        bottom = min(picture.shape[0] - 3, round(box.bottom) + line * small * 4 // 3)
        write_text(picture, text, (min(left, picture.shape[1] - 5 * small), bottom), small, _WHITE)


def _colour(track_id: int) -> tuple[int, int, int]:
    return PEOPLE[(track_id - 1) % len(PEOPLE)]


def contact_sheet(cells: Sequence[Picture]) -> Picture:
    """Return pictures of one size in rows of :data:`SHEET_COLUMNS`, the rest black."""
    missing = -len(cells) % SHEET_COLUMNS
    padded = [*cells, *[np.zeros_like(cells[0])] * missing]
    rows = [
        np.hstack(padded[first : first + SHEET_COLUMNS])
        for first in range(0, len(padded), SHEET_COLUMNS)
    ]
    return np.vstack(rows)


def frames_of(video: Path, stride: int) -> Iterator[tuple[float, Picture]]:
    """Yield time in seconds and BGR pixels of every ``stride``-th frame."""
    fps, number = _fps(cv2.VideoCapture(str(video))), -1
    for number, pixels in read_frames(video):
        if number % stride == 0:
            yield number / fps, pixels
    if number < 0:
        raise SystemExit(f"track-video: expected a video that OpenCV reads, got {video}")


def annotated(
    video: Path, stride: int, max_frames: int | None, estimator: Estimator
) -> Iterator[Picture]:
    """Follow the people of a video and yield its frames with what is known of them."""
    session, annotator = CameraSession(estimator), Annotator()
    for timestamp, pixels in islice(frames_of(video, stride), max_frames):
        tracked = session.process(Upload(pixels), timestamp, DEFAULT_HYPOTHESES, Job())
        yield annotator.draw(tracked)


def write_video(pictures: Iterator[Picture], path: Path, fps: float, shown: int) -> list[Picture]:
    """Write a video, and return :data:`SHEET_FRAMES` of its first ``shown`` frames, made small."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for_sheet = set(np.linspace(0, shown - 1, SHEET_FRAMES).round().astype(int).tolist())
    cells: list[Picture] = []
    writer = None
    for number, picture in enumerate(pictures):
        height, width = picture.shape[:2]
        if writer is None:
            codec = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(str(path), codec, fps, (width, height))
            if not writer.isOpened():
                raise SystemExit(f"track-video: expected a place to write to, got {path}")
        writer.write(picture)
        if number in for_sheet:
            size = (CELL_PX, CELL_PX * height // width)
            shrunk = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            cells.append(np.asarray(shrunk, np.uint8))
    if writer is not None:
        writer.release()
    return cells


def _fps(capture: cv2.VideoCapture) -> float:
    fps = capture.get(cv2.CAP_PROP_FPS)
    return fps if 0 < fps < 1000 else _USUAL_FPS


def main(arguments: Sequence[str] | None = None) -> None:
    """Annotate as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path, help="annotated video, .mp4")
    parser.add_argument("--stride", type=int, default=1, help="work on every n-th frame")
    parser.add_argument("--max-frames", type=int, help="work on no more frames than this")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--sheet", type=Path, help="contact sheet of 12 frames, PNG")
    options = parser.parse_args(arguments)
    if options.stride < 1 or (options.max_frames is not None and options.max_frames < 1):
        parser.error("--stride and --max-frames: expected at least 1")
    check_outputs((options.out, options.sheet), (options.video,))
    capture = cv2.VideoCapture(str(options.video))
    frames = -(-max(1, int(capture.get(cv2.CAP_PROP_FRAME_COUNT))) // options.stride)
    estimator = load_estimator(Settings(index=options.index))
    pictures = annotated(options.video, options.stride, options.max_frames, estimator)
    shown = min(frames, options.max_frames or frames)
    cells = write_video(pictures, options.out, _fps(capture) / options.stride, shown)
    if options.sheet and cells:
        sheet = contact_sheet(cells)
        cv2.imwrite(str(options.sheet), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])
