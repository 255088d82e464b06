"""Follow the people of a video: lines of JSON as ``/sequence`` answers, and an annotated video.

    python -m scripts.track_video VIDEO OUT_PREFIX [--stride 1] [--max-frames N] [--sheet FILE]

Writes OUT_PREFIX.ndjson and OUT_PREFIX.mp4 (MPEG-4 Part 2: players show it, most browsers do not).
Needs no service; ``tqdm`` is part of the extra ``build``.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.api.overlay import PEOPLE, draw_skeleton, write_text
from app.api.replies import ReplyForm
from app.api.tracking_replies import sequence_end_reply, sequence_frame_reply, sequence_line
from app.api.tracking_schemas import SequenceEndReason
from app.estimation.estimator import Estimator
from app.estimation.upload import Upload
from app.settings import Settings
from app.tracking.results import Event, TrackedFrame, TrackedPerson
from app.tracking.sequence import SequenceSummary
from app.tracking.session import CameraSession
from app.work.video_reader import VideoError, VideoReader, open_video
from index.skeleton import NATIVE
from index.store import DEFAULT_PATH

HYPOTHESES = 7
SHEET_FRAMES, SHEET_COLUMNS, CELL_PX = 12, 3, 400
EVENT_SHOWN_S = 2.0
_USUAL_FPS = 25.0
_WHITE = (255, 255, 255)
_DECODING_S = 24 * 3600.0

Picture = NDArray[np.uint8]


class Annotator:
    """Draws tracked people; what happens to them stays on show for :data:`EVENT_SHOWN_S`."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def draw(self, frame: TrackedFrame) -> Picture:
        """Return a copy of the frame with boxes, smoothed skeletons and captions.

        Returns
        -------
        (H, W, 3) uint8 array
            BGR.
        """
        picture = frame.frame.copy()
        letter = max(14, max(picture.shape[:2]) // 40)
        for tracked in frame.persons:
            _draw_skeleton_and_box(picture, tracked)
        # Afterwards, so that nobody covers another one's captions.
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
            text = f"{event.track_id} {_words(event.event)}" + " ended" * (event.state == "end")
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
    lines = [_words(posture.label)] if posture else []
    # Who walks need not be said to be walking as well.
    if action is not None and not (posture and posture.label.startswith(action.label)):
        lines.append(_words(action.label))
    for line, text in enumerate(lines, start=1):
        bottom = min(picture.shape[0] - 3, round(box.bottom) + line * small * 4 // 3)
        write_text(picture, text, (min(left, picture.shape[1] - 5 * small), bottom), small, _WHITE)


def _colour(track_id: int) -> tuple[int, int, int]:
    return PEOPLE[(track_id - 1) % len(PEOPLE)]


def _words(label: str) -> str:
    return label.replace("_", " ")


class Outputs:
    """The files that a tracked video becomes.

    Parameters
    ----------
    lines : binary file
    video : Path
    fps : float
        Of the annotated video.
    for_sheet : sequence of int
        Which of the frames worked on, counted from 0, the contact sheet shows.
    """

    def __init__(self, lines: IO[bytes], video: Path, fps: float, for_sheet: Sequence[int]) -> None:
        self._lines, self._path, self._fps = lines, video, fps
        self._for_sheet = frozenset(for_sheet)
        self._annotator = Annotator()
        self._writer: cv2.VideoWriter | None = None
        self.cells: list[Picture] = []

    def add(self, tracked: TrackedFrame, line: bytes) -> None:
        """Write a frame.

        Raises
        ------
        SystemExit
            If the video cannot be written.
        """
        self._lines.write(line)
        picture = self._annotator.draw(tracked)
        height, width = picture.shape[:2]
        if self._writer is None:
            codec = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._path), codec, self._fps, (width, height))
            if not self._writer.isOpened():
                raise SystemExit(f"track_video: expected a place to write to, got {self._path}")
        self._writer.write(picture)
        if tracked.frame_index in self._for_sheet:
            size = (CELL_PX, CELL_PX * height // width)
            shrunk = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            self.cells.append(np.asarray(shrunk, np.uint8))

    def close(self) -> None:
        """Finish the video."""
        if self._writer is not None:
            self._writer.release()


def contact_sheet(cells: Sequence[Picture]) -> Picture:
    """Return pictures of one size in rows of :data:`SHEET_COLUMNS`, the rest black."""
    missing = -len(cells) % SHEET_COLUMNS
    padded = [*cells, *[np.zeros_like(cells[0])] * missing]
    rows = [
        np.hstack(padded[first : first + SHEET_COLUMNS])
        for first in range(0, len(padded), SHEET_COLUMNS)
    ]
    return np.vstack(rows)


async def track(
    reader: VideoReader,
    estimator: Estimator,
    outputs: Outputs,
    lines: IO[bytes],
    max_frames: int | None,
    progress: tqdm[None],
) -> None:
    """Work on the frames of a video, and write them with a last line.

    Raises
    ------
    VideoError
        If the rest of the video, or all of it, cannot be read; the last line says so as well.
    """
    session, summary = CameraSession(estimator), SequenceSummary()

    def end(reason: SequenceEndReason, detail: str) -> None:
        lines.write(sequence_line(sequence_end_reply(summary, reason, detail)))

    try:
        while (frame := await reader.next()) is not None:
            if summary.frames == max_frames:
                end("max_frames", f"there are more than {max_frames} frames")
                return
            tracked = session.process(
                Upload(frame.pixels), frame.timestamp, HYPOTHESES, lambda: None
            )
            summary.add(tracked)
            reply = sequence_frame_reply(tracked, frame.number, estimator.index, ReplyForm(NATIVE))
            outputs.add(tracked, sequence_line(reply))
            progress.update()
    except VideoError as error:
        end("broken", str(error))
        raise
    end("complete", f"the video ended after {summary.frames} frames")


async def track_file(options: argparse.Namespace, settings: Settings) -> None:
    """Track the people of the video that the command line names."""
    frames, fps = _announced(options.video)
    frames = -(-frames // options.stride)
    if options.max_frames is not None:
        frames = min(frames, options.max_frames)
    for_sheet = np.linspace(0, frames - 1, SHEET_FRAMES).round().astype(int).tolist()
    lines_path, video_path = (Path(f"{options.out_prefix}{end}") for end in (".ndjson", ".mp4"))
    lines_path.parent.mkdir(parents=True, exist_ok=True)
    estimator = Estimator.load(settings)
    with ExitStack() as stack:
        file = stack.enter_context(options.video.open("rb"))
        lines = stack.enter_context(lines_path.open("wb"))
        outputs = Outputs(lines, video_path, fps / options.stride, for_sheet)
        stack.callback(outputs.close)
        progress = stack.enter_context(tqdm(total=frames, unit="frame"))
        async with open_video(file, options.stride, settings.max_pixels, _DECODING_S) as reader:
            await track(reader, estimator, outputs, lines, options.max_frames, progress)
    if options.sheet and outputs.cells:
        sheet = contact_sheet(outputs.cells)
        cv2.imwrite(str(options.sheet), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _announced(video: Path) -> tuple[int, float]:
    """Return how many frames a video says it has, and how many a second."""
    capture = cv2.VideoCapture(str(video))
    frames = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    fps = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return max(1, frames), fps if 0 < fps < 1000 else _USUAL_FPS


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Follow the people of a video.")
    parser.add_argument("video", type=Path)
    parser.add_argument("out_prefix", help="of the files written: .ndjson and .mp4")
    parser.add_argument("--stride", type=int, default=1, help="work on every n-th frame")
    parser.add_argument("--max-frames", type=int, help="work on no more frames than this")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--sheet", type=Path, help="contact sheet of 12 frames, PNG")
    options = parser.parse_args()
    if not options.video.is_file():
        parser.error(f"video: expected a file, got {options.video}")
    if options.stride < 1 or (options.max_frames is not None and options.max_frames < 1):
        parser.error("--stride and --max-frames: expected at least 1")
    try:
        asyncio.run(track_file(options, Settings(index=options.index)))
    except VideoError as error:
        print(f"track_video: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
