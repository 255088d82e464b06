"""The silhouettes of the Weizmann data set, and the paper's way of recognising actions in them.

The data set [1]_ is one file, ``classification_masks.mat``, which users fetch from its authors: the
silhouettes of nine people who do ten actions. The protocol is the paper's: one person is left out,
each of their frames takes the action of the nearest frame of the others, and the frames of a
sequence vote. Instead of single frames, stretches of consecutive frames may be compared.

References
----------
.. [1] L. Gorelick, M. Blank, E. Shechtman, M. Irani, R. Basri, "Actions as Space-Time Shapes",
   IEEE Transactions on Pattern Analysis and Machine Intelligence 29(12), 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Arrays, Descriptor
from descriptor.silhouette import HEIGHT, WIDTH, normalise
from scripts.experiments.protocol import nearest

ACTIONS = ("bend", "jack", "jump", "pjump", "run", "side", "skip", "walk", "wave1", "wave2")

PUBLISHED = 71.66
"""Percent of the sequences that Atrevi et al. (2016) recognise."""

STRUCT = "original_masks"
"""Masks as they were filmed; those of ``aligned_masks`` are the same, moved."""


IN_ORDER = 8
"""Consecutive frames that are compared at a time: a third of a second. The discriminant descriptor
recognises as many sequences with any number from 3 to 16."""

Mask = NDArray[np.generic]


@dataclass(frozen=True)
class Film:
    """Masks ``(H, W)`` of one person who does one action, in order; none without a person."""

    person: str
    action: str
    masks: tuple[Mask, ...]

    def normalised(self) -> Recording:
        """Its silhouettes."""
        silhouettes = [normalise(mask)[0] for mask in self.masks]
        return Recording(self.person, self.action, np.stack(silhouettes))


@dataclass(frozen=True)
class Recording:
    """Normalised silhouettes ``(F, 128, 48)`` of one person who does one action."""

    person: str
    action: str
    silhouettes: NDArray[np.uint8]


def read_films(file: Path) -> list[Film]:
    """Read ``classification_masks.mat``; a ValueError says what is not of the published layout."""
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
    """One field, such as ``lena_walk1``: masks ``(H, W, F)``."""
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


@dataclass(frozen=True)
class Pixels:
    """A silhouette as its own descriptor."""

    name: str = "pixels"
    dimension: int = HEIGHT * WIDTH

    def describe(self, silhouettes: NDArray[np.generic]) -> NDArray[np.float32]:
        """Pixels ``(B, 6144)`` of silhouettes ``(B, 128, 48)``."""
        return silhouettes.reshape(len(silhouettes), -1).astype(np.float32)

    def mirror(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Pixels of the mirrored silhouettes."""
        return vectors.reshape(-1, HEIGHT, WIDTH)[:, :, ::-1].reshape(vectors.shape)

    def parameters(self) -> dict[str, object]:
        """None but the name."""
        return {"name": self.name}

    def arrays(self) -> Arrays:
        """None."""
        return {}


@dataclass(frozen=True)
class Recognition:
    """What a vote over frames recognises of people who were left out.

    ``truth`` and ``answer`` are positions in ``actions``, of each recording; ``frames_right`` is
    the share of all frames, or of all stretches of frames; ``lead`` by which share of a recording's
    votes the answer leads the next action.
    """

    actions: tuple[str, ...]
    truth: NDArray[np.int64]
    answer: NDArray[np.int64]
    frames_right: float
    lead: NDArray[np.float64]

    @property
    def right(self) -> float:
        """Share of the recordings."""
        return float((self.truth == self.answer).mean())

    def confusion(self) -> NDArray[np.int64]:
        """Counts ``(A, A)``: truth in rows, answers in columns."""
        counts = np.zeros((len(self.actions), len(self.actions)), np.int64)
        np.add.at(counts, (self.truth, self.answer), 1)
        return counts


def stretches(vectors: NDArray[np.float32], frames: int) -> NDArray[np.float32]:
    """Vectors ``(F - frames + 1, frames * D)`` of stretches; the last of few is repeated."""
    padded = np.pad(vectors, ((0, max(0, frames - len(vectors))), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, frames, axis=0)
    return np.ascontiguousarray(windows.swapaxes(1, 2)).reshape(len(windows), -1)


def leave_one_person_out(
    recordings: Sequence[Recording], descriptor: Descriptor, *, mirrored: bool, frames: int = 1
) -> Recognition:
    """Recognise the recordings of each person by those of all others.

    ``mirrored``: known frames stand for their mirror images too. ``frames`` consecutive ones are
    compared at a time.
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
