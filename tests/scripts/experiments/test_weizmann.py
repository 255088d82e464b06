"""The Weizmann protocol, on a small file of the published layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from app.photograph import Estimator
from descriptor.descriptor import DiagonalDescriptor
from index.store import PoseIndex
from scripts.experiments.weizmann import ACTIONS, Film, in_frame, read_films, vote_figures, watch

FRAMES = 6
HEIGHT, WIDTH = 72, 90


def body(action: str, width: int, step: int) -> NDArray[np.uint8]:
    """A mask ``(72, 90)``: a trunk, with arms that differ by action, moved by ``step``."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    left = 20 + step
    mask[10:60, left : left + width] = 1
    if action == "wave1":
        mask[2:25, left : left + 3] = 1
    elif action == "wave2":
        mask[2:25, left : left + 3] = mask[2:25, left + width - 3 : left + width] = 1
    elif action == "walk":
        mask[35:60, left + 3 : left + width - 3] = 0
        mask[50:60, left - 4 : left] = 1
    return mask


def masks(action: str, width: int) -> NDArray[np.uint8]:
    return np.stack([body(action, width, step) for step in range(FRAMES)], axis=2)


def fields() -> dict[str, NDArray[np.uint8]]:
    people = {"daria": 12, "lena": 13, "lyova": 14}
    written = {
        f"{person}_{action}": masks(action, width)
        for person, width in people.items()
        for action in ("walk", "wave1", "wave2")
    }
    written["lena_walk1"] = written.pop("lena_walk")
    written["lena_walk2"] = written["lena_walk1"][:, ::-1]
    return written


def write(path: Path, **structs: dict[str, NDArray[np.uint8]]) -> Path:
    savemat(path, structs)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write(
        tmp_path / "classification_masks.mat", original_masks=fields(), aligned_masks=fields()
    )


def test_people_and_actions_are_read_from_the_names_of_the_fields(file: Path) -> None:
    films = read_films(file)
    assert len(films) == 10
    assert {film.person for film in films} == {"daria", "lena", "lyova"}
    lena = sorted(film.action for film in films if film.person == "lena")
    assert lena == ["walk", "walk", "wave1", "wave2"]
    assert all(len(film.masks) == FRAMES for film in films)


@pytest.mark.parametrize("frames", [1, 3, 2 * FRAMES])
def test_people_left_out_are_recognised_by_the_others(file: Path, frames: int) -> None:
    films = read_films(file)
    figures = vote_figures(films, DiagonalDescriptor().describe, mirrored=True, frames=frames)
    assert figures["sequences_percent"] == figures["frames_percent"] == 100
    counts = np.array(figures["confusion"])
    assert counts.sum() == 10 and counts.trace() == 10


def test_nobody_is_recognised_by_their_own_frames(file: Path) -> None:
    films = [film for film in read_films(file) if film.action != "wave2" or film.person == "lena"]
    figures = vote_figures(films, DiagonalDescriptor().describe, mirrored=False)
    wave2 = ACTIONS.index("wave2")
    counts = np.array(figures["confusion"])
    assert counts[wave2].sum() == 1 and counts[wave2, wave2] == 0


def test_films_are_watched_as_by_a_camera(estimator: Estimator, tiny_index: PoseIndex) -> None:
    masks = tuple(tiny_index.silhouette(number) for number in range(0, 96, 4))
    assert in_frame(masks[0]).sum() == masks[0].sum()
    session = watch(Film("daria", "walk", tuple(np.repeat(masks, 2, axis=0))), estimator)
    assert session.vote in tiny_index.actions
    assert session.answer in (None, *session.frames)


@pytest.mark.parametrize(
    ("structs", "message"),
    [
        ({"aligned_masks": {"daria_walk": masks("walk", 12)}}, "holds no struct original_masks"),
        ({"original_masks": masks("walk", 12)}, "holds no struct original_masks"),
        ({"original_masks": {"daria_fly": masks("walk", 12)}}, "none of the ten actions"),
        ({"original_masks": {"daria_walk": 7 * masks("walk", 12)}}, "not masks of 0 and 1"),
        ({"original_masks": {"daria_walk": masks("walk", 12)[..., 0]}}, r"shape \(72, 90\)"),
        ({"original_masks": {"daria_walk": 0 * masks("walk", 12)}}, "not masks of 0 and 1"),
        ({"original_masks": {"daria_walk": masks("walk", 12)}}, "fewer than two people"),
    ],
)
def test_a_file_of_another_layout_is_refused(
    tmp_path: Path, structs: dict[str, object], message: str
) -> None:
    file = tmp_path / "other.mat"
    savemat(file, structs)
    with pytest.raises(ValueError, match=message) as refused:
        read_films(file)
    assert str(file) in str(refused.value)


def test_what_is_no_matlab_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is no file"):
        read_films(tmp_path / "none.mat")
    file = tmp_path / "text.mat"
    file.write_bytes(b"walk " * 100)
    with pytest.raises(ValueError, match="is not a MATLAB 5 file"):
        read_films(file)
