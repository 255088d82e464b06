"""Indexes of stick figures that move, and of some that lie as well."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from descriptor.silhouette import is_wide, principal_axis_deg
from index.confidence import RERANKING_FEATURES, Calibration, signs
from index.reranking import RankingModel
from index.skeleton import camera_rotation, rows, wrap_degrees
from index.store import PoseIndex
from scripts.index.writer import save_index
from tests.conftest import draw_view, index_of_figures, posed_figure
from tests.index.helpers import random_network

VIEWS = 12


def movement(figures: int, extent: float = 1.0) -> NDArray[np.float64]:
    """Figures ``(figures, 24, 3)`` that move from one random pose to the next in four steps."""
    generator = np.random.default_rng(6)
    keys = extent * generator.uniform(
        (-1.0, 0.0, -0.7, 0.0, 0.1), (1.2, 1.4, 0.8, 1.0, 2.0), (figures // 4 + 2, 2, 5)
    )
    times = np.arange(figures) / 4
    before, share = times.astype(int), (times % 1)[:, None, None]
    sides = (1 - share) * keys[before] + share * keys[before + 1]
    return np.array([posed_figure(*both) for both in sides])


def drawn(
    skeleton: NDArray[np.float64], generator: np.random.Generator, views: int = VIEWS
) -> list[tuple[NDArray[np.uint8], dict[str, float]]]:
    """Views all around a figure, rolled to stand where it is wider than high."""
    found = []
    for azimuth_deg in 360 * (np.arange(views) + generator.uniform(size=2).sum()) / views:
        camera = (float(azimuth_deg) % 360, float(generator.uniform(-5, 40)))
        roll_deg = float(generator.normal(0, 2))
        silhouette, placed = draw_view(skeleton, *camera, roll_deg)
        if is_wide(silhouette):
            upright = roll_deg - principal_axis_deg(silhouette)
            head, pelvis = (skeleton @ camera_rotation(*camera, upright).T)[rows("head", "pelvis")]
            upright += 0 if head[1] < pelvis[1] else 180
            silhouette, placed = draw_view(skeleton, *camera, float(wrap_degrees(upright)))
        found.append((silhouette, placed))
    return found


@pytest.fixture(scope="session")
def toy_index() -> PoseIndex:
    """576 silhouettes of moving figures."""
    generator, skeletons = np.random.default_rng(7), movement(48)
    views = [view for skeleton in skeletons for view in drawn(skeleton, generator)]
    return index_of_figures("toy", skeletons, views, np.arange(48) // 24)


@pytest.fixture(scope="session")
def ground_index() -> PoseIndex:
    """Silhouettes of figures, most of them lying on the back, the belly or a side."""
    generator, standing = np.random.default_rng(8), movement(12, extent=0.35)
    lying = []
    for figure in np.repeat(standing, 3, axis=0):
        # The head to the back, then about the spine.
        about, turned = np.deg2rad(generator.uniform(0, 360)), figure[:, [0, 2, 1]] * [1, 1, -1]
        cosine, sine = np.cos(about), np.sin(about)
        lying.append(turned @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]))
    skeletons = np.concatenate([standing, lying])
    views = [view for skeleton in skeletons for view in drawn(skeleton, generator)]
    actions = np.repeat([0, 2], [len(standing), len(lying)])
    return index_of_figures("ground", skeletons, views, actions, ("walk", "jump", "lie"))


@pytest.fixture(scope="session")
def reranker() -> RankingModel:
    """A network that has learned nothing."""
    weights = tuple((0.1 * signs(RERANKING_FEATURES)).tolist())
    calibration = Calibration(weights, -0.2, RERANKING_FEATURES)
    return RankingModel(random_network(1), calibration, {"passes": 0})


@pytest.fixture(scope="session")
def reranked(toy_index: PoseIndex, reranker: RankingModel) -> PoseIndex:
    """The index of moving figures with such a network."""
    return replace(toy_index, reranker=reranker)


@pytest.fixture(scope="session")
def saved_once(toy_index: PoseIndex, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the index of moving figures, to read."""
    folder = tmp_path_factory.mktemp("index") / "artefact"
    save_index(toy_index, folder)
    return folder


@pytest.fixture
def saved(saved_once: Path, tmp_path: Path) -> Path:
    """A copy of this folder, to spoil."""
    return shutil.copytree(saved_once, tmp_path / "artefact")
