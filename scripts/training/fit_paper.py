"""Fit the confidence and the detection score of the paper's method, and print their constants.

The confidence is fitted to simulated silhouettes of the clips and bodies that calibrations ask for,
every second one degraded, and measured on those of other bodies; the index asked is the shipped one
without the frames of these clips. The detection score is fitted to the marked frames of the street
video (Apache-2.0). Takes about ten minutes.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from app.vision.detectors.hog import HogDetector
from index import DEFAULT_PATH
from index.artefact import load_index
from index.confidence import RIGHT_BELOW_PX
from index.matching import DEFAULT_HYPOTHESES, PoseHypothesis
from index.nearest import match_nearest, reprojection_confidence
from index.search import ExactNeighbours
from index.skeleton import JOINTS
from index.store import PoseIndex
from scripts.datasets import as_array, read_marks, read_vtest
from scripts.index.builder import (
    CALIBRATION_AVATARS,
    HELD_OUT_AVATARS,
    Plan,
    QueryCounts,
    entries_of,
    hold_out,
    simulate_queries,
    split,
)
from scripts.index.calibrate import Queries, calibration_floor, expected_calibration_error
from scripts.index.garments import make_avatars
from scripts.index.motion import Segment, read_manifest
from scripts.metrics import percent, true_positives
from scripts.results import SHARED

MEASURED = QueryCounts(1000, 500, 300)
"""Silhouettes on which the confidence is measured."""


def without_clips(index: PoseIndex, segments: Sequence[Segment]) -> PoseIndex:
    """Return an index without the entries of some segments, searched exactly."""
    rows = np.setdiff1d(np.arange(len(index)), entries_of(index, segments))
    return replace(
        index,
        vectors=ExactNeighbours(index.vectors[rows], in_bytes=False),
        entries=index.entries[rows],
        silhouette_store=index.silhouette_store.select(rows),
    )


def answers(
    index: PoseIndex, queries: Queries, n: int = DEFAULT_HYPOTHESES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reprojection errors ``(Q, N, 2)`` of the nearest entries, and their joint errors ``(Q, N)``.

    Both are in pixels of the normalised frame.
    """
    errors_px, joints_px = np.empty((len(queries), n, 2)), np.empty((len(queries), n))
    for row in tqdm(range(len(queries)), desc="matching", unit="query", disable=None):
        roll_deg = float(queries.roll_deg[row])
        found = match_nearest(index, queries.silhouettes[row], n, roll_deg=roll_deg).hypotheses[:n]
        errors_px[row] = [one.features for one in found]
        joints_px[row] = [_joint_error_px(one, queries.joints_2d[row]) for one in found]
    return errors_px, joints_px


def _joint_error_px(one: PoseHypothesis, truth: NDArray[np.floating]) -> float:
    apart = one.points_2d[:JOINTS] - truth
    return float(np.linalg.norm(apart, axis=-1).mean())


def fit_confidence(
    errors_px: NDArray[np.float64], right: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Fit the log odds that an entry is right: weights, none positive, and the offset."""
    features = np.log1p(errors_px.reshape(-1, errors_px.shape[-1]))
    signs = np.where(right.ravel(), 1.0, -1.0)

    def loss(constants: NDArray[np.float64]) -> float:
        odds = features @ constants[:-1] + constants[-1]
        return float(np.logaddexp(0, -signs * odds).mean())

    count = features.shape[1]
    bounds = [(None, 0.0)] * count + [(None, None)]
    fitted = minimize(loss, np.zeros(count + 1), bounds=bounds).x
    return fitted[:-1], float(fitted[-1])


def fit_detection(shared: Path) -> tuple[float, float, int]:
    """Fit slope and offset of the log odds that a window of HOG shows a person."""
    detector = HogDetector()
    marks = read_marks()
    frames = dict(read_vtest(shared / "real" / "vtest", len(marks)))
    margins, right = [], []
    for one in tqdm(marks, desc="street video"):
        boxes, found = detector.kept_windows(frames[one.frame])
        hits = true_positives((boxes, found), as_array(one.people))
        unsure = true_positives((boxes, found), as_array(one.ignored))
        margins.append(found[hits | ~unsure])
        right.append(hits[hits | ~unsure])
    model = LogisticRegression(C=1e3).fit(np.concatenate(margins)[:, None], np.concatenate(right))
    return float(model.coef_[0, 0]), float(model.intercept_[0]), sum(map(len, margins))


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit both, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    shared = parser.parse_args(arguments).shared
    slope, offset, count = fit_detection(shared)
    print(f"app/vision/detectors/hog.py: {slope:.2f}, {offset:.2f}, fitted to {count} windows")
    motion = shared / "mocap"
    segments = read_manifest(motion)
    whole = load_index(DEFAULT_PATH, reranked=False)
    plan = Plan()
    for held, bodies, counts, seed in (
        (split(segments).held, CALIBRATION_AVATARS, plan.calibration, plan.seed + 1),
        (hold_out(segments)[1], HELD_OUT_AVATARS, MEASURED, plan.seed + 2),
    ):
        avatars = make_avatars(bodies, shared / "garments")
        asked = simulate_queries(motion, held, avatars, counts, seed)
        queries = Queries.of(asked).half_degraded(seed)
        errors_px, joints_px = answers(without_clips(whole, held), queries)
        right = joints_px < RIGHT_BELOW_PX
        if bodies is CALIBRATION_AVATARS:
            weights, bias = fit_confidence(errors_px, right)
            print(f"index/nearest.py: {weights.round(3)}, {bias:.3f}, fitted to {right.size}")
        shipped = reprojection_confidence(errors_px)
        refitted = 1 / (1 + np.exp(-(np.log1p(errors_px) @ weights + bias)))
        print(
            f"{len(queries)} silhouettes: right at rank 1 {percent(right[:, 0]):.1f} %, within "
            f"{DEFAULT_HYPOTHESES} {percent(right.any(axis=1)):.1f} %; calibration error as "
            f"shipped {expected_calibration_error(shipped, right):.3f}, refitted "
            f"{expected_calibration_error(refitted, right):.3f} (by chance "
            f"{calibration_floor(refitted):.3f})"
        )
