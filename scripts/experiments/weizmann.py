"""The silhouettes of the Weizmann data set, and the paper's way of recognising actions in them.

The data set [1]_ is one file, ``classification_masks.mat``, which users fetch from its authors: the
silhouettes of nine people who do ten actions. The protocol is the paper's: one person is left out,
each of their frames takes the action of the nearest frame of the others, and the frames of a
sequence vote.

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

from descriptor.descriptor import Descriptor
from descriptor.silhouette import normalise
from scripts.experiments.protocol import nearest

ACTIONS = ("bend", "jack", "jump", "pjump", "run", "side", "skip", "walk", "wave1", "wave2")

PUBLISHED = 71.66
"""Percent of the sequences that Atrevi et al. (2016) recognise."""

STRUCT = "original_masks"
"""Masks as they were filmed; those of ``aligned_masks`` are the same, moved."""


@dataclass(frozen=True)
class Recording:
    """Silhouettes of one person who does one action.

    Parameters
    ----------
    person, action : str
    silhouettes : (F, 128, 48) uint8 array
        Normalised; 1 on the person.
    """

    person: str
    action: str
    silhouettes: NDArray[np.uint8]


def read_recordings(file: Path) -> list[Recording]:
    """Read ``classification_masks.mat``.

    Frames without a person are left out.

    Raises
    ------
    ValueError
        If the file is not of the published layout; the message says what is missing.
    """
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
    recordings = [_recording(name, masks[name].item(), expected) for name in masks.dtype.names]
    if len({recording.person for recording in recordings}) < 2:
        raise ValueError(f"{expected} holds fewer than two people")
    return recordings


def _recording(field: str, masks: NDArray[np.generic], expected: str) -> Recording:
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
    filled = [mask for mask in np.moveaxis(masks, 2, 0) if mask.any()]
    return Recording(person, action, np.stack([normalise(mask)[0] for mask in filled]))


@dataclass(frozen=True)
class Recognition:
    """What a vote over frames recognises of people who were left out.

    Parameters
    ----------
    actions : tuple of str
    truth, answer : (S,) int64 arrays
        Positions in ``actions``, of each recording.
    frames_right : float
        Share of all frames.
    """

    actions: tuple[str, ...]
    truth: NDArray[np.int64]
    answer: NDArray[np.int64]
    frames_right: float

    @property
    def right(self) -> float:
        """Share of the recordings."""
        return float((self.truth == self.answer).mean())

    def confusion(self) -> NDArray[np.int64]:
        """Counts ``(A, A)``: truth in rows, answers in columns."""
        counts = np.zeros((len(self.actions), len(self.actions)), np.int64)
        np.add.at(counts, (self.truth, self.answer), 1)
        return counts


def leave_one_person_out(
    recordings: Sequence[Recording], descriptor: Descriptor, *, mirrored: bool
) -> Recognition:
    """Recognise the recordings of each person by those of all others.

    Parameters
    ----------
    recordings : sequence of Recording
    descriptor : Descriptor
    mirrored : bool
        Whether known frames stand for their mirror images too.
    """
    actions = tuple(sorted({recording.action for recording in recordings}))
    vectors = [descriptor.describe(recording.silhouettes) for recording in recordings]
    truth = np.array([actions.index(recording.action) for recording in recordings])
    lengths = [len(v) for v in vectors]
    answer = np.zeros(len(recordings), np.int64)
    frames_right = 0
    for person in {recording.person for recording in recordings}:
        asked = np.array([recording.person == person for recording in recordings])
        known = np.concatenate([vectors[row] for row in np.flatnonzero(~asked)])
        labels = np.concatenate([np.full(lengths[r], truth[r]) for r in np.flatnonzero(~asked)])
        if mirrored:
            known, labels = np.concatenate([known, descriptor.mirror(known)]), np.tile(labels, 2)
        for row in np.flatnonzero(asked):
            votes = labels[nearest(known, vectors[row], 1)[:, 0]]
            answer[row] = np.bincount(votes).argmax()
            frames_right += int((votes == truth[row]).sum())
    return Recognition(actions, truth, answer, frames_right / sum(lengths))
