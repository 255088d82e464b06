"""The data of the paper's experiments, and what counts as recognised.

Four unclothed avatars (two women, two men) perform four actions before eight fixed cameras.
One stretch of each action is sampled at regular steps. Nearly every sixth of these frames is unseen
and the others are known, for all avatars and cameras alike: 19 frames x 4 avatars x 8 cameras make
608 unseen silhouettes, 92 x 4 x 8, evenly thinned, 2,925 known ones. ``paper.npz`` holds them;
:mod:`scripts.experiments.paper_simulation` renders them.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, pack
from index.confidence import RIGHT_BELOW_PX
from scripts.index.simulate import Simulation
from scripts.index.writer import compress

DATA = Path(__file__).with_name("paper.npz")
PARTS = ("known", "unseen")

KNOWN = 2925
"""The paper's number of training silhouettes."""

STRETCHES = {
    "walk": ("07_01", 20, 28, 5),
    "basketball": ("basketball_train_1", 20, 28, 5),
    "jump": ("jump_train_2", 20, 28, 5),
    "climb": ("01_02", 200, 27, 4),
}
"""Clip and first frame of each action, its number of frames, and of those that are unseen."""

STEP = 2
"""Frames from one sample to the next, for 15 samples a second."""


def read_paper_data(file: Path = DATA) -> tuple[Simulation, Simulation]:
    """Read the 2,925 known and the 608 unseen silhouettes with their skeletons."""
    with np.load(file) as arrays:
        names = [tuple(arrays[name].tolist()) for name in ("clips", "subjects", "actions")]
        known, unseen = (
            Simulation(
                compress(pack_by_rows(arrays[f"{part}_silhouettes"])),
                arrays[f"{part}_entries"],
                arrays[f"{part}_skeletons"],
                arrays[f"{part}_labels"],
                *names,
            )
            for part in PARTS
        )
    return known, unseen


def write_paper_data(known: Simulation, unseen: Simulation, file: Path = DATA) -> None:
    """Write both parts; the same silhouettes give the same bytes."""
    arrays: dict[str, Any] = {
        name: np.array(getattr(known, name)) for name in ("clips", "subjects", "actions")
    }
    for part, simulation in zip(PARTS, (known, unseen), strict=True):
        bits = pack(simulation.silhouettes(slice(None)))
        # By columns of bytes, which differ less along a body: a quarter smaller.
        arrays[f"{part}_silhouettes"] = bits.reshape(-1, HEIGHT, WIDTH // 8).swapaxes(1, 2).copy()
        arrays[f"{part}_entries"] = simulation.entries
        arrays[f"{part}_skeletons"] = simulation.skeletons
        arrays[f"{part}_labels"] = simulation.skeleton_labels
    np.savez_compressed(file, **arrays)


def pack_by_rows(columns: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Packed silhouettes ``(B, 768)`` from their columns of bytes ``(B, 6, 128)``."""
    return np.ascontiguousarray(columns.swapaxes(1, 2)).reshape(len(columns), -1)


def of_subject(simulation: Simulation, name: str, *, others: bool = False) -> Simulation:
    """Return the entries of one avatar, or of all others."""
    subjects = simulation.skeleton_labels["subject"][simulation.entries["skeleton"]]
    own = subjects == simulation.subjects.index(name)
    return simulation.take(np.flatnonzero(own != others))


def of_action(simulation: Simulation, name: str) -> Simulation:
    """Return the entries of one action."""
    actions = simulation.skeleton_labels["action"][simulation.entries["skeleton"]]
    return simulation.take(np.flatnonzero(actions == simulation.actions.index(name)))


def errors_px(answers: NDArray[np.floating], truth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return mean joint reprojection errors ``(Q, N)`` of answers ``(Q, N, 19, 2)`` in 128x48."""
    return np.linalg.norm(answers - truth[:, None], axis=-1).mean(axis=-1)


def nearest(
    known: NDArray[np.float32], asked: NDArray[np.float32], count: int
) -> NDArray[np.int64]:
    """Return rows ``(Q, count)`` of the nearest known vectors by exact Euclidean distance."""
    import faiss

    flat = faiss.IndexFlatL2(known.shape[1])
    flat.add(np.ascontiguousarray(known, np.float32))
    return np.asarray(flat.search(np.ascontiguousarray(asked, np.float32), count)[1])


def recognised(errors: NDArray[np.floating], n: int) -> float:
    """Return the percentage of queries with one of the ``n`` nearest under 5 px."""
    return 100 * float((errors[:, :n] < RIGHT_BELOW_PX).any(axis=1).mean())


def stretched(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Stretch the bounding boxes of silhouettes to 128x48, whatever their aspect ratio."""
    boxes = [cv2.boundingRect(silhouette) for silhouette in silhouettes]
    crops = [
        one[y : y + height, x : x + width].astype(np.float32)
        for one, (x, y, width, height) in zip(silhouettes, boxes, strict=True)
    ]
    return np.stack([(cv2.resize(crop, (WIDTH, HEIGHT)) >= 0.5).astype(np.uint8) for crop in crops])
