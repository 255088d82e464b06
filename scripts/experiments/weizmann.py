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
from collections.abc import Callable, Sequence
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
from descriptor.descriptor import DiagonalDescriptor
from descriptor.silhouette import normalise
from index import DEFAULT_PATH
from scripts.experiments.paper_data import nearest
from scripts.metrics import confusion, percent

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

FRAMES_PER_S = 25.0
FRAME = (144, 180)
"""Height and width of the data set's videos."""

Mask = NDArray[np.generic]
Describe = Callable[[NDArray[np.uint8]], NDArray[np.float32]]
"""Normalised silhouettes ``(F, 128, 48)`` to vectors ``(F, D)``."""


@dataclass(frozen=True)
class Film:
    """Masks ``(H, W)`` of one person performing one action, in order; none without a person."""

    person: str
    action: str
    masks: tuple[Mask, ...]


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
    estimator = load_estimator(Settings(index=DEFAULT_PATH))
    own = estimator.index.descriptor.describe
    votes = partial(vote_figures, films)
    return {
        "sequences": len(films),
        "silhouettes": sum(len(film.masks) for film in films),
        "actions": list(ACTIONS),
        "in_order": IN_ORDER,
        "published_percent": PUBLISHED,
        "votes": {
            "paper": votes(DiagonalDescriptor().describe, mirrored=False),
            "ours": votes(own, mirrored=True),
            "pixels": votes(pixels, mirrored=True),
            "ours_in_order": votes(own, mirrored=True, frames=IN_ORDER),
        },
        "sessions": session_figures([(film, watch(film, estimator)) for film in films]),
    }


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


def pixels(silhouettes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Describe silhouettes by their pixels."""
    return silhouettes.reshape(len(silhouettes), -1).astype(np.float32)


def stretches(vectors: NDArray[np.float32], frames: int) -> NDArray[np.float32]:
    """Return vectors ``(F - frames + 1, frames * D)``; the last frame of too few is repeated."""
    padded = np.pad(vectors, ((0, max(0, frames - len(vectors))), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, frames, axis=0)
    return np.ascontiguousarray(windows.swapaxes(1, 2)).reshape(len(windows), -1)


def vote_figures(
    films: Sequence[Film], describe: Describe, *, mirrored: bool, frames: int = 1
) -> dict[str, object]:
    """Recognise the films of each person by those of all others; percentages and confusions.

    If ``mirrored``, known frames stand for their mirror images too. ``frames`` consecutive ones
    are compared at a time.
    """
    silhouettes = [np.stack([normalise(mask)[0] for mask in film.masks]) for film in films]
    vectors = [stretches(describe(one), frames) for one in silhouettes]
    mirror_images = [stretches(describe(one[:, :, ::-1]), frames) for one in silhouettes]
    truth = np.array([ACTIONS.index(film.action) for film in films])
    answer, frames_right = np.zeros(len(films), np.int64), 0
    for person in {film.person for film in films}:
        others = [row for row, film in enumerate(films) if film.person != person]
        known = [vectors[row] for row in others]
        labels = np.repeat(truth[others], [len(one) for one in known])
        if mirrored:
            known += [mirror_images[row] for row in others]
            labels = np.tile(labels, 2)
        compared = np.concatenate(known)
        for row in [row for row, film in enumerate(films) if film.person == person]:
            votes = labels[nearest(compared, vectors[row], 1)[:, 0]]
            answer[row] = np.bincount(votes, minlength=len(ACTIONS)).argmax()
            frames_right += int((votes == truth[row]).sum())
    return {
        "sequences_percent": percent(truth == answer),
        "frames_percent": 100 * frames_right / sum(map(len, vectors)),
        "confusion": confusion(len(ACTIONS), truth, answer).tolist(),
    }


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
    for number, mask in enumerate(film.masks):
        upload = Upload(mask=cv2.imencode(".png", in_frame(mask))[1].tobytes())
        result = session.process(upload, number / FRAMES_PER_S, 7, Job(), "silhouette")
        for person in result.persons[:1]:
            if person.action is not None:
                frames.append(person.action.label)
                sums[frames[-1]] = sums.get(frames[-1], 0.0) + person.action.probability
            votes.update(h.label.action for h in person.hypotheses[:1])
    answer = max(sums, key=sums.__getitem__, default=None)
    vote = max(votes, key=votes.__getitem__, default=None)
    return Session(answer, tuple(frames), vote)


def in_frame(mask: Mask) -> NDArray[np.uint8]:
    """Put a mask into the middle of a frame of the size of its video."""
    (height, width), (rows, columns) = FRAME, mask.shape
    frame = np.zeros(FRAME, np.uint8)
    top, left = (height - rows) // 2, (width - columns) // 2
    frame[top : top + rows, left : left + columns] = mask
    return frame


def session_figures(watched: Sequence[tuple[Film, Session]]) -> dict[str, Any]:
    """Return percentages of each action that sessions recognise too, and of all of them."""
    figures: dict[str, Any] = {}
    for name in (*SAME_ACTION, "all"):
        rows = [
            (SAME_ACTION[film.action], session)
            for film, session in watched
            if film.action in SAME_ACTION and name in (film.action, "all")
        ]
        frames = [label == frame for label, one in rows for frame in one.frames]
        figures[name] = {
            "as": SAME_ACTION.get(name),
            "sequences": len(rows),
            "percent": percent([label == one.answer for label, one in rows]),
            "none_percent": percent([one.answer is None for _, one in rows]),
            "frames_percent": percent(frames) if frames else None,
            "vote_percent": percent([label == one.vote for label, one in rows]),
        }
    return figures
