"""Actions in the Weizmann data set [1]_ by the paper's vote: its figure 13.

One person is left out, each of their frames takes the action of the nearest frame of the others,
and the frames of a sequence vote. The data set is one file, ``classification_masks.mat``, which
users fetch from its authors.

References
----------
.. [1] L. Gorelick, M. Blank, E. Shechtman, M. Irani, R. Basri, "Actions as Space-Time Shapes",
   IEEE Transactions on Pattern Analysis and Machine Intelligence 29(12), 2007.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import DiagonalDescriptor
from descriptor.silhouette import normalise
from index import DEFAULT_PATH
from index.artefact import load_index
from scripts.experiments.paper_data import nearest
from scripts.experiments.paper_descriptors import Describe, pixels
from scripts.metrics import confusion, percent

ACTIONS = ("bend", "jack", "jump", "pjump", "run", "side", "skip", "walk", "wave1", "wave2")
PUBLISHED = 71.66
"""Percentage of the sequences that Atrevi et al. (2016) recognise."""

FILE = Path("real", "weizmann", "classification_masks.mat")
STRUCT = "original_masks"
"""Masks as they were filmed; those of ``aligned_masks`` are the same, moved."""


@dataclass(frozen=True)
class Film:
    """Normalised silhouettes ``(F, 128, 48)`` of one person performing one action, in order."""

    person: str
    action: str
    silhouettes: NDArray[np.uint8]


def weizmann_figures(shared: Path) -> dict[str, Any]:
    """Return the figures of all descriptors; none, and the reason, where the data does not lie."""
    file = shared / FILE
    if not file.is_file():
        note = f"Not measured: there is no `{FILE}` in the folder of data (`SHARED`)."
        return {"figures": {"note": note}, "actions": [], "votes": {}}
    films = read_films(file)
    ours = load_index(DEFAULT_PATH).descriptor.describe
    silhouettes = sum(len(film.silhouettes) for film in films)
    note = (
        f"{len(films)} sequences, {silhouettes:,} silhouettes; published: {PUBLISHED:.2f} % of the "
        "sequences."
    )
    return {
        "figures": {"note": note},
        "actions": list(ACTIONS),
        "votes": {
            "paper": vote_figures(films, DiagonalDescriptor().describe),
            "pixels": vote_figures(films, pixels),
            "ours_nearest": vote_figures(films, ours),
        },
    }


def read_films(file: Path) -> list[Film]:
    """Read ``classification_masks.mat``; a ValueError says how it differs from that layout."""
    from scipy.io import loadmat

    expected = f"expected classification_masks.mat of the Weizmann data set, but {file}"
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


def _film(field: str, masks: NDArray[np.generic], expected: str) -> Film:
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
    frames = [normalise(mask)[0] for mask in np.moveaxis(masks, 2, 0) if mask.any()]
    return Film(person, action, np.stack(frames))


def vote_figures(films: Sequence[Film], describe: Describe) -> dict[str, Any]:
    """Recognise the films of each person by those of all others; percentages and confusions."""
    vectors = [describe(film.silhouettes) for film in films]
    truth = np.array([ACTIONS.index(film.action) for film in films])
    answers, frames_right = np.zeros(len(films), np.int64), 0
    for person in {film.person for film in films}:
        others = [row for row, film in enumerate(films) if film.person != person]
        labels = np.repeat(truth[others], [len(vectors[row]) for row in others])
        known = np.concatenate([vectors[row] for row in others])
        for row in {*range(len(films))}.difference(others):
            votes = labels[nearest(known, vectors[row], 1)[:, 0]]
            answers[row] = np.bincount(votes, minlength=len(ACTIONS)).argmax()
            frames_right += int((votes == truth[row]).sum())
    return {
        "sequences_percent": percent(truth == answers),
        "frames_percent": 100 * frames_right / sum(map(len, vectors)),
        "confusion": confusion(len(ACTIONS), truth, answers).tolist(),
    }
