"""Actions in the Weizmann data set: by the paper's vote, in order, and as camera sessions.

The data set [1]_ is one file, ``classification_masks.mat``, which users fetch from its authors: the
silhouettes of nine people who perform ten actions. The protocol is the paper's: one person is left
out, each of their frames takes the action of the nearest frame of the others, and the frames of a
sequence vote. Instead of single frames, stretches of consecutive frames may be compared.

References
----------
.. [1] L. Gorelick, M. Blank, E. Shechtman, M. Irani, R. Basri, "Actions as Space-Time Shapes",
   IEEE Transactions on Pattern Analysis and Machine Intelligence 29(12), 2007.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from descriptor.descriptor import Descriptor, DiagonalDescriptor
from descriptor.silhouette import HEIGHT, WIDTH, normalise
from index import DEFAULT_PATH
from scripts.experiments.paper_data import nearest
from scripts.metrics import confusion

ACTIONS = ("bend", "jack", "jump", "pjump", "run", "side", "skip", "walk", "wave1", "wave2")
SAME_ACTION = {
    "walk": "walk",
    "run": "run",
    "jack": "jumping-jack",
    "jump": "jump",
    "pjump": "jump",
}
"""Actions that camera sessions recognise too, with their names there."""

PUBLISHED = 71.66
"""Percentage of the sequences that Atrevi et al. (2016) recognise."""

STRUCT = "original_masks"
"""Masks as they were filmed; those of ``aligned_masks`` are the same, moved."""

IN_ORDER = 8
"""Consecutive frames that are compared at a time: a third of a second. The discriminant descriptor
recognises as many sequences with any number from 3 to 16."""

CLOSE = 0.1
"""A vote led by a smaller share of the frames may change with the next drawing."""

FRAMES_PER_S = 25.0
FRAME = (144, 180)
"""Height and width of the data set's videos."""

Mask = NDArray[np.generic]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument(
        "--weizmann",
        type=Path,
        metavar="FILE",
        help="classification_masks.mat of the data set; by default that of --shared",
    )


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    file = options.weizmann
    films = read_films(file or options.shared / "real" / "weizmann" / "classification_masks.mat")
    return measure(films, load_estimator(Settings(index=DEFAULT_PATH)))


def measure(films: Sequence[Film], estimator: Estimator) -> dict[str, object]:
    """Return the figures of the paper's protocol and of camera sessions."""
    own = estimator.index.descriptor
    recognise = partial(leave_one_person_out, [film.normalised() for film in films])
    votes = {
        "paper": recognise(DiagonalDescriptor(), mirrored=False),
        "ours": recognise(own, mirrored=True),
        "pixels": recognise(Pixels(), mirrored=True),
        "ours_in_order": recognise(own, mirrored=True, frames=IN_ORDER),
    }
    sessions = [watch(film, estimator) for film in films]
    return {
        "sequences": len(films),
        "silhouettes": sum(len(film.masks) for film in films),
        "actions": list(ACTIONS),
        "in_order": IN_ORDER,
        "published_percent": PUBLISHED,
        "votes": {name: recognition.figures() for name, recognition in votes.items()},
        "sessions": session_figures(films, sessions),
        "session_counts": session_counts(films, sessions),
    }


@dataclass(frozen=True)
class Film:
    """Masks ``(H, W)`` of one person performing one action, in order; none without a person."""

    person: str
    action: str
    masks: tuple[Mask, ...]

    def normalised(self) -> Recording:
        """Normalise its silhouettes."""
        silhouettes = [normalise(mask)[0] for mask in self.masks]
        return Recording(self.person, self.action, np.stack(silhouettes))


@dataclass(frozen=True)
class Recording:
    """Normalised silhouettes ``(F, 128, 48)`` of one person performing one action."""

    person: str
    action: str
    silhouettes: NDArray[np.uint8]


def read_films(file: Path) -> list[Film]:
    """Read ``classification_masks.mat``; a ValueError says how it differs from that layout."""
    from scipy.io import loadmat

    expected = f"expected classification_masks.mat of the Weizmann data set, but {file}"
    if not file.is_file():
        raise FileNotFoundError(f"{expected} is no file")
    try:
        structs: dict[str, Any] = loadmat(file, variable_names=[STRUCT])
    except Exception as error:  # scipy raises many kinds on damaged files
        raise ValueError(f"{expected} is not a MATLAB 5 file: {error}") from error
    masks = structs.get(STRUCT)
    if masks is None or masks.dtype.names is None or masks.size != 1:
        raise ValueError(f"{expected} holds no struct {STRUCT}")
    films = [_film(name, masks[name].item(), expected) for name in masks.dtype.names]
    if len({film.person for film in films}) < 2:
        raise ValueError(f"{expected} holds fewer than two people")
    return films


def _film(field: str, masks: Mask, expected: str) -> Film:
    """Read one field, such as ``lena_walk1``: masks ``(H, W, F)``."""
    person, _, take = field.partition("_")
    # Two takes of an action are numbered; wave1 and wave2 are two actions.
    action = take if take in ACTIONS else take[:-1]
    if action not in ACTIONS:
        raise ValueError(f"{expected} has a field {field!r}, which names none of the ten actions")
    if masks.ndim != 3 or not np.isin(masks, (0, 1)).all() or not masks.any():
        raise ValueError(
            f"{expected} has a field {field!r} of shape {masks.shape} that is not masks of 0 and 1 "
            "by height, width and frame"
        )
    return Film(person, action, tuple(mask for mask in np.moveaxis(masks, 2, 0) if mask.any()))


class Pixels:
    """A silhouette as its own descriptor."""

    def describe(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        """Return the pixels ``(B, 6144)`` of silhouettes ``(B, 128, 48)``."""
        return silhouettes.reshape(len(silhouettes), -1).astype(np.float32)

    def mirror(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the pixels of the mirrored silhouettes."""
        return vectors.reshape(-1, HEIGHT, WIDTH)[:, :, ::-1].reshape(vectors.shape)


@dataclass(frozen=True)
class Recognition:
    """Actions recognised by a vote over frames, for people who were left out.

    ``truth`` and ``answer`` are positions in ``actions``, of each recording; ``frames_right`` is
    the share of all frames, or of all stretches of frames; ``lead`` is the share of a recording's
    votes by which the answer leads the next action.
    """

    actions: tuple[str, ...]
    truth: NDArray[np.int64]
    answer: NDArray[np.int64]
    frames_right: float
    lead: NDArray[np.float64]

    @property
    def right(self) -> float:
        """The share of the recordings."""
        return float((self.truth == self.answer).mean())

    def figures(self) -> dict[str, object]:
        """Return percentages, close votes and confusions: truth in rows, answers in columns."""
        return {
            "sequences_percent": 100 * self.right,
            "frames_percent": 100 * self.frames_right,
            "close_votes": int((self.lead < CLOSE).sum()),
            "confusion": confusion(len(self.actions), self.truth, self.answer).tolist(),
        }


def stretches(vectors: NDArray[np.float32], frames: int) -> NDArray[np.float32]:
    """Return vectors ``(F - frames + 1, frames * D)``; the last frame of too few is repeated."""
    padded = np.pad(vectors, ((0, max(0, frames - len(vectors))), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, frames, axis=0)
    return np.ascontiguousarray(windows.swapaxes(1, 2)).reshape(len(windows), -1)


def leave_one_person_out(
    recordings: Sequence[Recording],
    descriptor: Descriptor | Pixels,
    *,
    mirrored: bool,
    frames: int = 1,
) -> Recognition:
    """Recognise the recordings of each person by those of all others.

    If ``mirrored``, known frames stand for their mirror images too. ``frames`` consecutive ones
    are compared at a time.
    """
    actions = tuple(sorted({recording.action for recording in recordings}))
    described = [descriptor.describe(recording.silhouettes) for recording in recordings]
    vectors = [stretches(v, frames) for v in described]
    mirror_images = [stretches(descriptor.mirror(v), frames) for v in described]
    truth = np.array([actions.index(recording.action) for recording in recordings])
    lengths = [len(v) for v in vectors]
    answer, lead = np.zeros(len(recordings), np.int64), np.zeros(len(recordings))
    frames_right = 0
    for person in {recording.person for recording in recordings}:
        asked = np.array([recording.person == person for recording in recordings])
        rows = np.flatnonzero(~asked).tolist()
        known = [vectors[row] for row in rows] + [mirror_images[row] for row in rows if mirrored]
        labels = np.concatenate([np.full(lengths[row], truth[row]) for row in rows])
        labels = np.tile(labels, 2) if mirrored else labels
        compared = np.concatenate(known)
        for row in np.flatnonzero(asked).tolist():
            votes = labels[nearest(compared, vectors[row], 1)[:, 0]]
            counts = np.bincount(votes, minlength=len(actions))
            answer[row] = counts.argmax()
            second, first = np.sort(counts)[-2:]
            lead[row] = (first - second) / len(votes)
            frames_right += int(counts[truth[row]])
    return Recognition(actions, truth, answer, frames_right / sum(lengths), lead)


@dataclass(frozen=True)
class Session:
    """What a camera session reported of a film, None if nothing.

    ``answer`` is the action of the highest sum of probabilities, ``frames`` the action reported at
    each frame from the first one on, ``vote`` that of most frames' first hypotheses.
    """

    answer: str | None
    frames: tuple[str, ...]
    vote: str | None


def watch(film: Film, estimator: Estimator) -> Session:
    """Send the masks of a film to a camera session, one after the other."""
    session = CameraSession(estimator)
    sums: dict[str, float] = {}
    votes: Counter[str] = Counter()
    frames = []
    for number, mask in enumerate(in_frames(film)):
        upload = Upload(mask=cv2.imencode(".png", mask)[1].tobytes())
        result = session.process(upload, number / FRAMES_PER_S, 7, Job(), "silhouette")
        for person in result.persons[:1]:
            if person.action is not None:
                label = person.action.label
                frames.append(label)
                sums[label] = sums.get(label, 0.0) + person.action.probability
            votes.update(h.label.action for h in person.hypotheses[:1])
    return Session(
        max(sums, key=sums.__getitem__, default=None),
        tuple(frames),
        max(votes, key=votes.__getitem__, default=None),
    )


def in_frames(film: Film) -> Iterator[NDArray[np.uint8]]:
    """Yield masks of a film in frames of the size of its video, all at the same place."""
    height, width = FRAME
    for mask in film.masks:
        rows, columns = mask.shape
        frame = np.zeros(FRAME, np.uint8)
        top, left = (height - rows) // 2, (width - columns) // 2
        frame[top : top + rows, left : left + columns] = mask
        yield frame


def session_figures(films: Sequence[Film], sessions: Sequence[Session]) -> dict[str, Any]:
    """Return figures of each action that sessions recognise too, and of all of them."""
    watched = [
        (film.action, SAME_ACTION[film.action], session)
        for film, session in zip(films, sessions, strict=True)
        if film.action in SAME_ACTION
    ]

    def figures(name: str) -> dict[str, Any]:
        rows = [(label, one) for action, label, one in watched if name in (action, "all")]
        frames = [label == frame for label, one in rows for frame in one.frames]
        return {
            "as": SAME_ACTION.get(name),
            "sequences": len(rows),
            "percent": _percent([label == one.answer for label, one in rows]),
            "none_percent": _percent([one.answer is None for _, one in rows]),
            "frames_percent": _percent(frames),
            "vote_percent": _percent([label == one.vote for label, one in rows]),
        }

    return {name: figures(name) for name in (*SAME_ACTION, "all")}


def _percent(right: Sequence[bool]) -> float | None:
    return 100 * float(np.mean(right)) if right else None


def session_counts(films: Sequence[Film], sessions: Sequence[Session]) -> dict[str, dict[str, int]]:
    """Count what sessions recognised in each of the ten actions."""
    counts: dict[str, Counter[str]] = {}
    for film, session in zip(films, sessions, strict=True):
        counts.setdefault(film.action, Counter())[session.answer or "none"] += 1
    return {action: dict(sorted(counts[action].items())) for action in sorted(counts)}
