"""What each step of the matching adds: the descriptor, modes, and the network that re-ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from index import DEFAULT_PATH
from index.build.calibrate import (
    Queries,
    Trial,
    expected_calibration_error,
    run_trial,
)
from index.build.motion import Segment
from index.confidence import RIGHT_BELOW_PX
from index.parameters import DEFAULT_HYPOTHESES
from index.reranker import RankingModel, load_reranker
from index.rotations import (
    RotatedQuery,
    find_rotated_candidates,
    silhouette_rotations,
)
from index.skeleton import JOINTS, rotate_clockwise
from index.store import PoseIndex


def shipped_reranker(held: Sequence[Segment]) -> RankingModel | None:
    """The network beside the default index, which must not know the clips that are asked for.

    Raises
    ------
    ValueError
        If it was trained on one of them.
    """
    reranker = load_reranker(DEFAULT_PATH)
    if reranker is not None:
        known = {segment.clip for segment in held}.intersection(reranker.training["clips"])
        if known:
            raise ValueError(
                f"the network beside {DEFAULT_PATH} was trained on clips that the experiment "
                f"asks for: {', '.join(sorted(known))}"
            )
    return reranker


def steps(index: PoseIndex, groups: Mapping[str, tuple[Queries, Trial]]) -> list[list[str]]:
    """Rows of what each step adds; none without a network.

    Parameters
    ----------
    index : PoseIndex
    groups : mapping
        Queries by name, with what the index answered them.
    """
    if index.reranker is None:
        return []
    plain = replace(index, reranker=None)
    unfitted = replace(index.reranker, spread=(0.0, 0.0, 0.0))
    weighed = replace(index, reranker=unfitted)
    order = replace(index, reranker=replace(unfitted, support_weight=0.0))
    lines = []
    for name, (queries, answered) in groups.items():
        lines.append(_row(name, "the descriptor alone", *_nearest(index, queries)))
        lines.append(_trial_row(name, "modes", run_trial(plain, queries)))
        lines.append(_trial_row(name, "the network: order", run_trial(order, queries)))
        weights = run_trial(weighed, queries)
        lines.append(_trial_row(name, "the network: order, weights of candidates", weights))
        lines.append(_trial_row(name, "the network: order, weights, fit", answered))
        own = 100 * float(_right_by_itself(index.reranker, queries).mean())
        lines.append([name, "the network alone, no search", f"{own:.1f} %", *4 * [""]])
    return lines


def _nearest(index: PoseIndex, queries: Queries) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors ``(Q, N)`` in pixels and in metres of the nearest entries as they are."""
    error_px, error_m = (np.full((len(queries), DEFAULT_HYPOTHESES), np.inf) for _ in range(2))
    for row, (silhouette, roll_deg) in enumerate(
        zip(queries.silhouettes, queries.roll_deg.tolist(), strict=True)
    ):
        rotations = silhouette_rotations(silhouette, roll_deg)
        rotated = [RotatedQuery.of(silhouette, rotation) for rotation in rotations]
        found = find_rotated_candidates(index, rotated, DEFAULT_HYPOTHESES).take(
            slice(DEFAULT_HYPOTHESES)
        )
        apart_2d = found.points_normalised[:, :JOINTS] - queries.joints_2d[row]
        points_3d = rotate_clockwise(found.points_3d[:, :JOINTS], -roll_deg)
        apart_3d = points_3d - queries.joints_3d[row]
        error_px[row, : len(found)] = np.linalg.norm(apart_2d, axis=-1).mean(axis=-1)
        error_m[row, : len(found)] = np.linalg.norm(apart_3d, axis=-1).mean(axis=-1)
    return error_px, error_m


def _right_by_itself(reranker: RankingModel, queries: Queries) -> NDArray[np.bool_]:
    """Where the likeliest place of each joint makes a right skeleton ``(Q,)``."""
    places = np.stack(
        [reranker.network.distributions(s).likeliest()[:, :2] for s in queries.silhouettes]
    )
    errors = np.linalg.norm(places - queries.joints_2d, axis=-1).mean(axis=-1)
    return np.asarray(errors < RIGHT_BELOW_PX)


def _trial_row(name: str, step: str, trial: Trial) -> list[str]:
    ece = expected_calibration_error(trial.confidence, trial.right)
    return _row(name, step, trial.error_px, trial.error_m, f"{ece:.3f}")


def _row(
    name: str,
    step: str,
    error_px: NDArray[np.float64],
    error_m: NDArray[np.float64],
    ece: str = "",
) -> list[str]:
    right = error_px < RIGHT_BELOW_PX
    return [
        f"{name} ({len(right)})", step,
        f"{100 * right[:, 0].mean():.1f} %", f"{100 * right.any(axis=1).mean():.1f} %",
        f"{1000 * error_m[:, 0].mean():.0f}", f"{1000 * error_m.min(axis=1).mean():.0f}", ece,
    ]  # fmt: skip
