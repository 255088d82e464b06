"""Pictures of the strict experiment: calibration, and hard queries with their answers."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from app.api.overlay import draw_skeleton
from index.build.calibrate import HYPOTHESES, Queries, Trial
from index.confidence import RIGHT_BELOW_PX
from index.matching import match
from index.rotations import rotate_silhouette
from index.skeleton import JOINTS, NATIVE
from index.store import PoseIndex

HARD = 10
ZOOM = 2
GAP = 34


def plot_reliability(trial: Trial, file: Path) -> None:
    """Share of right hypotheses over confidence, in ten bins, above how many there are."""
    confidence, right = trial.confidence.ravel(), trial.right.ravel()
    bins = np.minimum((confidence * 10).astype(int), 9)
    filled = [b for b in range(10) if (bins == b).any()]
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(5, 6), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    top.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    top.plot(
        [confidence[bins == b].mean() for b in filled],
        [right[bins == b].mean() for b in filled],
        marker="o",
    )
    top.set(ylabel="share that is right", ylim=(0, 1), aspect="equal")
    bottom.hist(confidence, bins=10, range=(0, 1), color="0.6")
    bottom.set(xlabel="confidence", ylabel="hypotheses", xlim=(0, 1))
    figure.savefig(file, dpi=120)
    plt.close(figure)


def draw_hard_queries(index: PoseIndex, queries: Queries, trial: Trial, file: Path) -> None:
    """Draw queries whose first answer is wrong, evenly chosen, each beside its answers.

    Left of each row the query with its true skeleton; then the hypotheses over the silhouettes
    of their entries, with confidence and error, framed in green where right. The person's left
    is orange, the right blue.
    """
    wrong = np.flatnonzero(~trial.right[:, 0])
    chosen = wrong[np.linspace(0, len(wrong) - 1, HARD).astype(int)]
    rows = [np.hstack(_answers(index, queries, query, HYPOTHESES)) for query in chosen.tolist()]
    cv2.imwrite(str(file), np.vstack(rows))


def _answers(index: PoseIndex, queries: Queries, query: int, count: int) -> list[NDArray[np.uint8]]:
    """Pictures of a query and of its first answers."""
    silhouette, truth = queries.silhouettes[query], queries.joints_2d[query]
    roll_deg = float(queries.roll_deg[query])
    cells = [_cell(silhouette, truth, "query", None)]
    for hypothesis in match(index, silhouette, count, roll_deg=roll_deg).hypotheses[:count]:
        joints = hypothesis.points_normalised[:JOINTS]
        error = float(np.linalg.norm(joints - truth, axis=-1).mean())
        entry = index.silhouette(hypothesis.entry)
        entry = entry[:, ::-1] if hypothesis.mirrored else entry
        entry, _ = rotate_silhouette(entry, hypothesis.rotation_deg + roll_deg)
        text = f"{hypothesis.confidence:.2f}  {error:.1f} px"
        cells.append(_cell(entry, joints, text, error < RIGHT_BELOW_PX, hypothesis.posture))
    return cells


def _cell(
    silhouette: NDArray[np.uint8],
    joints: NDArray[np.floating],
    text: str,
    right: bool | None,
    title: str = "",
) -> NDArray[np.uint8]:
    height, width = (ZOOM * side for side in silhouette.shape)
    grey = np.where(silhouette, 190, 255).astype(np.uint8)
    picture = np.full((height + 2 * GAP, width + 2 * GAP, 3), 255, np.uint8)
    enlarged = cv2.resize(grey, (width, height), interpolation=cv2.INTER_NEAREST)
    picture[GAP : GAP + height, GAP : GAP + width] = enlarged[:, :, None]
    pixels = (np.asarray(joints, np.float64) + 0.5) * ZOOM + GAP - 0.5
    body = np.full((len(NATIVE.names), 2), np.nan)
    body[:JOINTS] = pixels
    draw_skeleton(picture, body, NATIVE, 2)
    if right is not None:
        frame = (60, 160, 60) if right else (200, 200, 200)
        cv2.rectangle(picture, (4, 4), (picture.shape[1] - 5, picture.shape[0] - 5), frame, 2)
    for line, row in ((title, 22), (text, picture.shape[0] - 14)):
        cv2.putText(
            picture, line, (12, row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA
        )
    return picture
