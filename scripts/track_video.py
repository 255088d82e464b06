"""Annotate a video with the people who are tracked in it, in this process.

    python -m scripts track-video VIDEO OUT.mp4 [--stride 1]

The video is H.264, which players and browsers show. A service answers the same results as JSON to
``POST /sequence``.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from app.api.pictures import PEOPLE, draw_skeleton, write_text
from app.camera import CameraSession
from app.decoding import Frame
from app.decoding.video_program import UnreadableError, Video
from app.estimation.upload import Upload
from app.photograph import Estimator, load_estimator
from app.scheduling.job import Job
from app.settings import Settings
from app.tracking.results import Event, TrackedFrame, TrackedPerson
from app.vision.optics import Optics
from index import DEFAULT_PATH
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import NATIVE
from scripts.helpers import check_outputs

EVENT_SHOWN_S = 2.0
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
            who, colour = ("camera", _WHITE)
            if event.track_id is not None:
                who, colour = str(event.track_id), _colour(event.track_id)
            text = f"{who} {event.event}" + " ended" * (event.state == "end")
            write_text(picture, text, corner, letter, colour)
        return picture


def _draw_skeleton_and_box(picture: Picture, tracked: TrackedPerson) -> None:
    box = tracked.box
    corners = np.round([box.x, box.y, box.right, box.bottom]).astype(int)
    colour = _colour(tracked.track_id)
    cv2.rectangle(picture, corners[:2].tolist(), corners[2:].tolist(), colour, 2)
    if tracked.pose is not None:
        bone = min(4, max(2, round(box.height / 50)))
        draw_skeleton(picture, tracked.pose.points_2d[list(NATIVE.indices)], NATIVE, bone)


def _draw_captions(picture: Picture, tracked: TrackedPerson, letter: int) -> None:
    """Write the track's number above the box, posture and action below it."""
    box, posture, action = tracked.box, tracked.posture, tracked.action
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


def frames_of(video: Path, stride: int) -> Iterator[Frame]:
    """Yield every ``stride``-th frame, up to where the video cannot be read."""
    frame = None
    try:
        for frame in Video(str(video)).frames(stride):
            yield frame
    except UnreadableError as error:
        if frame is None:
            raise SystemExit(f"track-video: expected a video, got {error}: {video}") from error
        print(f"track-video: expected the whole video, got {error}: {video}", file=sys.stderr)


def annotated(frames: Iterable[Frame], estimator: Estimator) -> Iterator[tuple[float, Picture]]:
    """Follow the people of a video and yield times and frames with what is known of them."""
    session, annotator = CameraSession(estimator), Annotator()
    for frame in frames:
        upload = Upload(frame.pixels, optics=Optics(pixel_aspect=frame.pixel_aspect))
        tracked = session.process(upload, frame.timestamp, DEFAULT_HYPOTHESES, Job())
        yield frame.timestamp, annotator.draw(tracked)


def write_video(pictures: Iterable[tuple[float, Picture]], path: Path) -> int:
    """Write pictures with their times as a video, and return how many there are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    written = 0
    # The index comes first, so that a browser need not load the whole video before it plays.
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as out:
        stream = out.add_stream("h264", options={"crf": "20"})
        stream.pix_fmt, stream.codec_context.time_base = "yuv420p", Fraction(1, 1000)
        for timestamp, picture in pictures:
            # Colours have half the resolution, so sizes are even.
            height, width = (length // 2 * 2 for length in picture.shape[:2])
            if not written:
                stream.height, stream.width = height, width
            frame = av.VideoFrame.from_ndarray(picture[:height, :width], "bgr24")
            frame.time_base, frame.pts = Fraction(1, 1000), round(1000 * timestamp)
            out.mux(stream.encode(frame))
            written += 1
        out.mux(stream.encode())
    return written


def main(arguments: Sequence[str] | None = None) -> None:
    """Annotate as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path, help="annotated video, .mp4")
    parser.add_argument("--stride", type=int, default=1, help="work on every n-th frame")
    parser.add_argument("--max-frames", type=int, help="work on no more frames than this")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    options = parser.parse_args(arguments)
    if options.stride < 1 or (options.max_frames is not None and options.max_frames < 1):
        parser.error("--stride and --max-frames: expected at least 1")
    check_outputs((options.out,), (options.video,))
    estimator = load_estimator(Settings(index=options.index))
    frames = islice(frames_of(options.video, options.stride), options.max_frames)
    written = write_video(annotated(frames, estimator), options.out)
    print(f"track-video: {written} frames in {options.out}")
