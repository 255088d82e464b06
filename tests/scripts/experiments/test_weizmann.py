"""The Weizmann protocol, on a small file of the published layout."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from descriptor.descriptor import DiagonalDescriptor
from scripts.experiments.weizmann import ACTIONS, read_films, vote_figures

FRAMES = 6


def masks(action: str, width: int) -> NDArray[np.uint8]:
    """Masks ``(72, 90, 6)``: a trunk that moves, with arms and legs that differ by action."""
    frames = np.zeros((72, 90, FRAMES), np.uint8)
    for step in range(FRAMES):
        mask, left = frames[..., step], 20 + step
        mask[10:60, left : left + width] = 1
        if action.startswith("wave"):
            mask[2:25, left : left + 3] = 1
        if action == "wave2":
            mask[2:25, left + width - 3 : left + width] = 1
        if action == "walk":
            mask[35:60, left + 3 : left + width - 3] = 0
            mask[50:60, left - 4 : left] = 1
    return frames


@pytest.fixture
def file(tmp_path: Path) -> Path:
    people = {"daria": 12, "lena": 13, "lyova": 14}
    fields = {
        f"{person}_{action}": masks(action, width)
        for person, width in people.items()
        for action in ("walk", "wave1", "wave2")
    }
    fields["lena_walk1"] = fields.pop("lena_walk")
    fields["lena_walk2"] = fields["lena_walk1"][:, ::-1]
    savemat(tmp_path / "masks.mat", {"original_masks": fields, "aligned_masks": fields})
    return tmp_path / "masks.mat"


def test_people_left_out_are_recognised_by_the_others(file: Path) -> None:
    films = read_films(file)
    lena = sorted(film.action for film in films if film.person == "lena")
    assert len(films) == 10 and lena == ["walk", "walk", "wave1", "wave2"]
    figures = vote_figures(films, DiagonalDescriptor().describe)
    counts = np.array(figures["confusion"])
    assert figures["sequences_percent"] == figures["frames_percent"] == 100
    assert counts.sum() == 10 and counts.trace() == 10


def test_nobody_is_recognised_by_their_own_frames(file: Path) -> None:
    films = [film for film in read_films(file) if film.action != "wave2" or film.person == "lena"]
    counts = np.array(vote_figures(films, DiagonalDescriptor().describe)["confusion"])
    wave2 = ACTIONS.index("wave2")
    assert counts[wave2].sum() == 1 and counts[wave2, wave2] == 0
