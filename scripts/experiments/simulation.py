"""The simulation experiment: bodies, clips and views that the index never saw.

The index is built as the shipped one is, but without the held-out clips
(:func:`scripts.index.builder.hold_out`); descriptor and confidence are fitted to what remains. The
re-ranking network is the shipped one, which knows none of these clips either. Queries are frames
spread evenly over the held-out clips, on the bodies of ``HELD_OUT_AVATARS``, each from one random
view of the hemisphere: upright motion, clips near the ground, and both laid down.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import likeliest_posture
from index.confidence import RIGHT_BELOW_PX
from index.matching import DEFAULT_HYPOTHESES
from index.nearest import match_nearest
from index.network import AXES, RankingModel
from index.posture import LOW, POSTURES, SILHOUETTE_GROUPS, classify_postures
from index.skeleton import BODY_UP, JOINTS
from index.store import PoseIndex
from scripts.index.builder import HELD_OUT_AVATARS, QueryCounts, hold_out, simulate_queries
from scripts.index.calibrate import (
    Queries,
    Trial,
    calibration_floor,
    expected_calibration_error,
    run_trial,
)
from scripts.index.garments import make_avatars
from scripts.index.motion import read_manifest
from scripts.index.simulate import Simulation
from scripts.metrics import confusion, percent
from scripts.training.held_out import strict_index

ASKED = QueryCounts(upright=4000, near_ground=2000, laid_down=1200)
"""Numbers of queries; the share of right upright ones has a standard deviation of 0.8 points."""

QUERY_SEED = 99
DEGRADED_EVERY = 2
"""One in so many upright queries is asked again, degraded."""

ELEVATIONS_DEG = ((-5, 10), (10, 25), (25, 45), (45, 60))
NEAR_BELOW_PX = 8.0

Figures = dict[str, float]
Rows = NDArray[np.bool_]


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    motion = options.shared / "mocap"
    _, held = hold_out(read_manifest(motion))
    index = strict_index(options.shared, options.strict_index)
    avatars = make_avatars(HELD_OUT_AVATARS, options.shared / "garments")
    simulated = simulate_queries(motion, held, avatars, ASKED, QUERY_SEED)
    return {
        **measure(index, simulated),
        "index": {
            "entries": len(index),
            "poses": index.parameters["poses"],
            "bodies_per_pose": index.parameters["bodies_per_pose"],
            "views_per_body": index.parameters["views_per_body"],
            "avatars": len(index.subjects),
        },
        "held_out_clips": sorted({segment.clip for segment in held}),
    }


def measure(
    index: PoseIndex, simulated: Simulation, asked: QueryCounts = ASKED
) -> dict[str, object]:
    """Ask an index for simulated queries, the upright ones first."""
    queries = Queries.of(simulated)
    every = run_trial(index, queries)
    upright = every.take(np.arange(asked.upright))
    some = np.arange(0, asked.upright, DEGRADED_EVERY)
    degraded_queries = queries.take(some).degraded(QUERY_SEED)
    degraded = run_trial(index, degraded_queries)
    postures = true_postures(simulated)
    actions = simulated.skeleton_labels["action"][simulated.entries["skeleton"]]
    low = np.flatnonzero(posture_groups(postures)["low"])
    rankings = {
        "upright": rank(index, queries.take(some), every.take(some)),
        "degraded": rank(index, degraded_queries, degraded),
        "low_postures": rank(index, queries.take(low), every.take(low)),
    }
    return {
        "asked": {
            "upright": asked.upright,
            "near_ground": asked.near_ground,
            "laid_down": asked.laid_down,
        },
        "right_below_px": RIGHT_BELOW_PX,
        "summary": {"upright": summary(upright), "degraded": summary(degraded)},
        "ranking": rankings if index.reranker else {},
        "postures": posture_figures(postures, every),
        "posture_ways": {
            "votes_alone": way_figures(postures, every, every.votes, actions),
            "network_and_votes": way_figures(postures, every, every.postures, actions),
        },
        "posture_confusion": confusion(
            len(SILHOUETTE_GROUPS) + 1,
            SILHOUETTE_GROUPS.of[postures],
            told_kinds(every, every.postures)[0],
        ).tolist(),
        "elevations": by_elevation(simulated.take(np.arange(asked.upright)), upright),
        "limits": limits(upright),
    }


def summary(trial: Trial, rows: Rows | None = None) -> Figures:
    """Return the figures of a trial, or of some of its queries."""
    some = np.ones(len(trial.error_m), bool) if rows is None else rows
    return {
        **_errors(trial.error_px[some], trial.error_m[some]),
        "ece": expected_calibration_error(trial.confidence[some], trial.right[some]),
        "ece_floor": calibration_floor(trial.confidence[some]),
    }


def _errors(error_px: NDArray[np.float64], error_m: NDArray[np.float64]) -> Figures:
    """Return the figures of errors ``(Q, N)`` of ranked hypotheses."""
    right = error_px < RIGHT_BELOW_PX
    return {
        "queries": len(right),
        "right_1": percent(right[:, 0]),
        "right_7": percent(right.any(axis=1)),
        "first_mm": 1000 * float(error_m[:, 0].mean()),
        "best_mm": 1000 * float(error_m.min(axis=1).mean()),
    }


def rank(index: PoseIndex, queries: Queries, answered: Trial) -> dict[str, Figures]:
    """Return what each step of the matching adds; ``answered`` is the trial with all of them."""
    if index.reranker is None:
        return {}
    unfitted = replace(index.reranker, spread=(0.0, 0.0, 0.0))
    steps: Mapping[str, RankingModel | None] = {
        "modes": None,
        "network_order": replace(unfitted, support_weight=0.0),
        "network_order_and_weights": unfitted,
    }
    trials = {
        name: run_trial(replace(index, reranker=network), queries)
        for name, network in steps.items()
    }
    return {
        "paper_method": by_paper(index, queries),
        **{name: summary(trial) for name, trial in trials.items()},
        "network_order_weights_and_fit": summary(answered),
        "network_alone": {
            "queries": len(queries),
            "right_1": percent(network_alone_is_right(index.reranker, queries)),
        },
    }


def by_paper(index: PoseIndex, queries: Queries) -> Figures:
    """Return the figures of the paper's method: the nearest entries as they are."""
    error_px, error_m, confidence = (np.empty((len(queries), DEFAULT_HYPOTHESES)) for _ in range(3))
    for row, (silhouette, roll_deg) in enumerate(
        zip(queries.silhouettes, queries.roll_deg.tolist(), strict=True)
    ):
        found = match_nearest(index, silhouette, DEFAULT_HYPOTHESES, roll_deg=roll_deg).hypotheses
        points_2d = np.array([one.points_2d[:JOINTS] for one in found])
        points_3d = np.array([one.points_3d[:JOINTS] for one in found])
        apart_2d, apart_3d = points_2d - queries.joints_2d[row], points_3d - queries.joints_3d[row]
        error_px[row] = np.linalg.norm(apart_2d, axis=-1).mean(axis=-1)
        error_m[row] = np.linalg.norm(apart_3d, axis=-1).mean(axis=-1)
        confidence[row] = [one.confidence for one in found]
    return {
        **_errors(error_px, error_m),
        "ece": expected_calibration_error(confidence, error_px < RIGHT_BELOW_PX),
        "ece_floor": calibration_floor(confidence),
    }


def network_alone_is_right(reranker: RankingModel, queries: Queries) -> NDArray[np.bool_]:
    """Return which queries ``(Q,)`` the network's likeliest joint positions answer within 5 px."""
    places = np.empty(queries.joints_2d.shape)
    for row, silhouette in enumerate(queries.silhouettes):
        log_probabilities = reranker.network.read(silhouette).joints.by_axis()
        for column in range(2):
            places[row, :, column] = AXES[column].centres[log_probabilities[column].argmax(axis=1)]
    errors = np.linalg.norm(places - queries.joints_2d, axis=-1).mean(axis=-1)
    return np.asarray(errors < RIGHT_BELOW_PX)


def true_postures(queries: Simulation) -> NDArray[np.int64]:
    """Return the postures ``(Q,)`` of the skeletons themselves, as positions in ``POSTURES``."""
    rows = queries.entries["skeleton"]
    return classify_postures(
        queries.skeletons[rows], BODY_UP, queries.skeleton_labels["speed"][rows]
    )


def posture_groups(postures: NDArray[np.int64]) -> dict[str, Rows]:
    """Return the queries of each posture, and of all upright and all low ones."""
    low = np.isin(postures, [POSTURES.index(name) for name in LOW])
    groups = {"upright": ~low, "low": low}
    groups |= {name: postures == row for row, name in enumerate(POSTURES)}
    return {name: rows for name, rows in groups.items() if rows.any()}


def posture_figures(postures: NDArray[np.int64], trial: Trial) -> dict[str, Figures]:
    """Return the figures of each group of postures; kinds alone count as right."""
    right = told_kinds(trial, trial.postures)[0] == SILHOUETTE_GROUPS.of[postures]
    return {
        name: {**summary(trial, rows), "posture_right": percent(right[rows])}
        for name, rows in posture_groups(postures).items()
    }


def told_kinds(
    trial: Trial, shares: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the kinds ``(Q,)`` that the service would say, and the probability of each.

    Kinds are positions in ``SILHOUETTE_GROUPS``, or their number for ``unclear``.
    """
    said = [
        likeliest_posture(one, confidence=confidence)
        for one, confidence in zip(shares, trial.confidence.max(axis=1), strict=True)
    ]
    kinds = [
        len(SILHOUETTE_GROUPS)
        if one.label == "unclear"
        else SILHOUETTE_GROUPS.of[POSTURES.index(one.label)]
        for one in said
    ]
    return np.array(kinds), np.array([one.probability for one in said])


def way_figures(
    postures: NDArray[np.int64],
    trial: Trial,
    shares: NDArray[np.float64],
    actions: NDArray[np.integer],
) -> Figures:
    """Return how often the kinds of postures are right by shares ``(Q, 10)``; ``unclear`` is not.

    The calibration error is that of the labels' probabilities.
    """
    true = SILHOUETTE_GROUPS.of[postures]
    kinds, probability = told_kinds(trial, shares)
    right = kinds == true
    return {
        "right": percent(right),
        "mean_over_kinds": float(np.mean([percent(right[true == k]) for k in np.unique(true)])),
        "mean_over_actions": float(
            np.mean([percent(right[actions == action]) for action in np.unique(actions)])
        ),
        "wrong": percent(~right & (kinds < len(SILHOUETTE_GROUPS))),
        "unclear": percent(kinds == len(SILHOUETTE_GROUPS)),
        "ece": expected_calibration_error(probability, shares.argmax(axis=1) == postures),
    }


def by_elevation(queries: Simulation, trial: Trial) -> dict[str, Figures]:
    """Return the figures of each band of elevations."""
    elevation = queries.entries["elevation_deg"]
    return {
        f"{low}_to_{high}".replace("-", "minus_"): {
            "from_deg": low,
            "to_deg": high,
            **summary(trial, (elevation >= low) & (elevation < high)),
        }
        for low, high in ELEVATIONS_DEG
    }


def limits(trial: Trial) -> Figures:
    """Return how the first hypothesis goes wrong, judged by the others, in percent."""
    first, best = trial.error_px[:, 0], trial.error_px.min(axis=1)
    wrong = first >= RIGHT_BELOW_PX
    near = wrong & (first < NEAR_BELOW_PX)
    twin = wrong & ~near & (best < RIGHT_BELOW_PX)
    either_side = np.minimum(first, trial.twin_error_px[:, 0])
    return {
        "wrong": percent(wrong),
        "near": percent(near),
        "right_with_either_side": percent(either_side < RIGHT_BELOW_PX),
        "twin": percent(twin),
        "not_covered": percent(wrong & ~near & ~twin),
    }
