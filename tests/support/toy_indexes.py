"""Indexes of stick figures; ``python -m tests.support.toy_indexes`` writes them to tests/data."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import DiagonalDescriptor
from descriptor.silhouette import pack
from index.confidence import FEATURES, Calibration, signs
from index.search import ExactNeighbours
from index.store import ENTRY_DTYPE, SKELETON_DTYPE, PoseIndex
from scripts.index.writer import compress, save_index
from tests.support.figures import draw_view, drawn, movement, stick_figure

FOLDER = Path(__file__).parents[1] / "data" / "indexes"
CALIBRATION = Calibration(tuple((0.3 * signs(FEATURES)).tolist()), 1.0)
"""Higher where a hypothesis is near, fits well and has many votes."""


def index_of_figures(
    name: str,
    skeletons: NDArray[np.float64],
    views: Sequence[tuple[NDArray[np.uint8], dict[str, float]]],
    action: NDArray[np.integer],
    actions: tuple[str, ...] = ("walk", "jump"),
) -> PoseIndex:
    """An index of figures ``(S, 24, 3)``, each with equally many views of :func:`draw_view`."""
    entries = np.zeros(len(views), ENTRY_DTYPE)
    entries["skeleton"] = np.arange(len(views)) // (len(views) // len(skeletons))
    for entry, (_, camera) in zip(entries, views, strict=True):
        for field, value in camera.items():
            entry[field] = value
    labels = np.zeros(len(skeletons), SKELETON_DTYPE)
    labels["frame"], labels["action"] = np.arange(len(skeletons)), action
    descriptor = DiagonalDescriptor()
    stack = np.array([silhouette for silhouette, _ in views])
    return PoseIndex(
        name=name,
        descriptor=descriptor,
        vectors=ExactNeighbours(descriptor.describe(stack)),
        entries=entries,
        skeletons=skeletons.astype(np.float16),
        skeleton_labels=labels,
        clips=("sticks_01",),
        subjects=("stick",),
        actions=actions,
        silhouette_store=compress(pack(stack)),
        parameters={
            "seed": 1,
            "attribution": "Drawn for tests.",
            "confidence": CALIBRATION.parameters(),
        },
    )


def build_tiny_index(poses: int = 24, views: int = 4, seed: int = 1) -> PoseIndex:
    """An index of random stick figures: ``poses * views`` entries."""
    rng = np.random.default_rng(seed)
    skeletons = np.array([stick_figure(rng) for _ in range(poses)])
    # No view exactly from the side: rounding would decide which way it faces.
    drawn = [
        draw_view(skeleton, 20.0 + 360.0 / views * view, 10.0)
        for skeleton in skeletons
        for view in range(views)
    ]
    return index_of_figures("sticks", skeletons, drawn, np.arange(poses) % 2)


def build_toy_index() -> PoseIndex:
    """576 silhouettes of moving figures."""
    generator, skeletons = np.random.default_rng(7), movement(48)
    views = [view for skeleton in skeletons for view in drawn(skeleton, generator)]
    return index_of_figures("toy", skeletons, views, np.arange(48) // 24)


def build_ground_index() -> PoseIndex:
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


INDEXES = {"sticks": build_tiny_index, "toy": build_toy_index, "ground": build_ground_index}

if __name__ == "__main__":
    for name, build in INDEXES.items():
        save_index(build(), FOLDER / name)
