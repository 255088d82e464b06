"""Tracks against single frames: clips that the index never saw, filmed by a fixed camera.

The index of the strict experiment, with the network that ships, is asked for sequences of its
held-out clips on bodies that it does not know, silhouettes alone. Every frame by itself is compared
with the smooth pose of the frames so far. What was chosen or fitted (``--fit``) was so on other
clips, bodies and an index without them, and without the network.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import fit_poses, normalise_person
from app.estimation.facing import azimuth_deg
from app.estimation.results import ObservedPerson, Person
from app.scheduling.process import available_cores
from app.tracking.smoothing import STATES, PoseSmoother, Smoothed
from app.vision.geometry import Silhouette
from index.build.body import Phenotype
from index.build.builder import IndexSpec, build
from index.build.calibrate import expected_calibration_error
from index.build.garments import Wardrobe, make_avatars
from index.build.motion import Segment, read_manifest
from index.build.poses import read_poses
from index.build.splits import (
    CALIBRATION_AVATARS,
    HELD_OUT_AVATARS,
    hold_out,
    split_by_clip,
)
from index.confidence import RIGHT_BELOW_PX
from index.skeleton import exchange_sides, mean_joint_distance, wrap_degrees
from index.store import PoseIndex
from scripts.experiments.report import table, write
from scripts.experiments.sequences import FPS, Filmed, film
from scripts.experiments.strict import strict_index
from scripts.experiments.strict_ranking import shipped_reranker

COMMAND = "python -m scripts.evaluate tracking"
VIEWS, SEED = 4, 7
TUNING_VIEWS, TUNING_POSITION = 3, 1
"""Cameras of the tuning sequences, and which clips of each action they are of."""

OVER_GROUND_M_S = 0.5
"""Mean speed from which somebody goes somewhere: exercises on the spot are no walks."""

EXCHANGED = 0.8
"""Left and right count as exchanged where exchanging them takes the error below this share."""

VARIANTS: dict[str, dict[str, float]] = {
    "as it is": {},
    "seven hypotheses a frame for twelve": {"states": 7},
    "without the way people are turned over time": {"turn_weight": 0.0},
    "without the cost of moving": {"cost_per_m": 0.0},
    "without the line through the last frames": {"line_s": 0.0},
}
"""What is left out of smoothing, to see what it is worth."""

COLUMNS = {
    "frames": ("frames", ",.0f"),
    "px": ("2D (px)", ".1f"),
    "right": ("right (%)", ".1f"),
    "mm": ("3D (mm)", ".0f"),
    "front_back": ("front/back flipped (%)", ".1f"),
    "left_right": ("left/right flipped (%)", ".1f"),
    "change_mm": ("change a frame (mm)", ".0f"),
    "jitter_mm": ("beyond the true motion (mm)", ".0f"),
    "ece": ("ECE", ".3f"),
}
"""Title and form of each figure."""

HEADER = tuple(title for title, _ in COLUMNS.values())


@dataclass(frozen=True)
class Followed:
    """A filmed sequence and what was estimated: every frame alone, or smooth."""

    filmed: Filmed
    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    confidences: NDArray[np.float64]

    def measures(self) -> dict[str, NDArray[np.floating]]:
        """What :data:`COLUMNS` shows the means of, frame by frame."""
        truth = self.filmed
        scales = np.array([_to_normalised(silhouette) for silhouette in truth.silhouettes])
        error_px = scales * mean_joint_distance(self.points_2d, truth.points_2d)
        error_m = mean_joint_distance(self.points_3d, truth.points_3d)
        exchanged_m = mean_joint_distance(exchange_sides(self.points_3d), truth.points_3d)
        turned = np.abs(wrap_degrees(azimuth_deg(self.points_3d) - azimuth_deg(truth.points_3d)))
        change_m, true_change_m = (
            mean_joint_distance(points[1:], points[:-1])
            for points in (self.points_3d, truth.points_3d)
        )
        return {
            "px": error_px,
            "right": 100.0 * (error_px < RIGHT_BELOW_PX),
            "mm": 1000 * error_m,
            "front_back": 100.0 * (turned > 90),
            "left_right": 100.0 * ((turned <= 90) & (exchanged_m < EXCHANGED * error_m)),
            "change_mm": 1000 * change_m,
            "jitter_mm": 1000 * (change_m - true_change_m),
        }


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--fit-tracks", action="store_true", help="fit the confidence instead")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks."""
    if options.fit_tracks:
        fit(options.shared)
        return
    _, held = hold_out(read_manifest(options.shared / "mocap"))
    index = replace(
        strict_index(options.shared, options.strict_index), reranker=shipped_reranker(held)
    )
    sequences = film_segments(options.shared, held, HELD_OUT_AVATARS, VIEWS)
    persons = [ask(index, filmed) for filmed in tqdm(sequences, desc="matching", unit="sequence")]
    report(sequences, persons, options.out)


def film_segments(
    shared: Path,
    segments: Sequence[Segment],
    bodies: Iterable[tuple[Phenotype, Wardrobe]],
    views: int,
) -> list[Filmed]:
    """Film segments of motion on some bodies."""
    poses, _ = read_poses(shared / "mocap", segments)
    avatars = make_avatars(bodies, shared / "garments")
    subjects = {segment.clip: segment.subject for segment in segments}
    return film(poses, subjects, avatars, SEED, views=views)


def ask(index: PoseIndex, filmed: Filmed) -> list[Person]:
    """Estimate every frame by itself, from its silhouette alone."""

    def estimate(silhouette: Silhouette) -> Person:
        observed = ObservedPerson(silhouette.box, "mask", None, silhouette)
        return fit_poses(index, observed, normalise_person(observed), STATES)

    with ThreadPoolExecutor(available_cores()) as pool:
        return list(pool.map(estimate, filmed.silhouettes))


def alone(filmed: Filmed, persons: Sequence[Person]) -> Followed:
    """The first hypothesis of every frame."""
    first = [person.hypotheses[0] for person in persons]
    return Followed(
        filmed,
        np.array([placed.hypothesis.points_3d for placed in first]),
        np.array([placed.points_2d for placed in first]),
        np.array([placed.confidence for placed in first]),
    )


def smoothed(filmed: Filmed, persons: Sequence[Person], **parameters: Any) -> list[Smoothed]:
    """The smooth poses of a sequence, each from the frames up to its own."""
    smoother = PoseSmoother(**parameters)
    updates = [
        smoother.update(person, timestamp)
        for person, timestamp in zip(persons, filmed.timestamps.tolist(), strict=True)
    ]
    return [update for update in updates if update is not None]


def followed(filmed: Filmed, updates: Sequence[Smoothed]) -> Followed:
    """Smooth poses beside the truth."""
    poses = [update.pose for update in updates]
    return Followed(
        filmed,
        np.array([pose.points_3d for pose in poses]),
        np.array([pose.points_2d for pose in poses]),
        np.array([pose.confidence for pose in poses]),
    )


def report(sequences: Sequence[Filmed], persons: Sequence[Sequence[Person]], out: Path) -> None:
    """Compare single frames with tracks, and write ``tracking.md`` and ``.json``."""
    pairs = list(zip(sequences, persons, strict=True))
    single = [alone(*pair) for pair in pairs]
    tracks = [followed(filmed, smoothed(filmed, people)) for filmed, people in pairs]
    going = np.array([_mean_speed(filmed) > OVER_GROUND_M_S for filmed in sequences])
    actions = np.array([filmed.action for filmed in sequences])
    walks = np.isin(actions, ("walk", "run"))
    groups = {
        "all": np.ones(len(sequences), bool),
        "walk or run over the ground": walks & going,
        "walk or run on the spot": walks & ~going,
        **{action: actions == action for action in sorted(set(actions.tolist()))},
    }
    figures: dict[str, dict[str, dict[str, float]]] = {}
    rows = []
    for name, chosen in groups.items():
        if not chosen.any():
            continue
        figures[name] = {
            kind: summary([those[number] for number in np.flatnonzero(chosen)])
            for kind, those in (("alone", single), ("smooth", tracks))
        }
        rows += [
            [name if kind == "alone" else "", kind, *_cells(values)]
            for kind, values in figures[name].items()
        ]
    variants = {
        name: summary([followed(filmed, smoothed(filmed, people, **left_out))
                       for filmed, people in pairs])
        for name, left_out in VARIANTS.items()
    }  # fmt: skip
    write(out, "tracking", COMMAND, [
        "Tracks against single frames",
        f"{len(sequences)} sequences of held-out clips, each stretch of motion of one action "
        f"filmed by {VIEWS} fixed cameras (elevation 2 to 40 degrees, at least 5 m away) at "
        f"{FPS} frames a second, on bodies and in clothes that the index does not know; "
        "silhouettes alone. *alone*: the first hypothesis of every frame; *smooth*: `pose` of a "
        "track, from the frames so far. Errors are means over 19 joints, 3D in axes of a camera "
        "that looks at the person, about the pelvis. *Right*: 2D error under 5 px of the "
        "normalised frame. *Front/back flipped*: facing off by more than 90 degrees; "
        "*left/right*: facing right, but exchanging the sides takes a fifth off the error. "
        "*Beyond the true motion*: how much more the joints move between frames than they truly "
        "do. ECE: expected calibration error of the confidence.",
        table(["sequences", "", *HEADER], rows),
        "## What each part is worth\n\nAll sequences, smooth.",
        table(["", *HEADER], [[name, *_cells(values)] for name, values in variants.items()]),
        "## What limits it\n\nWhere nobody goes anywhere, nothing but the silhouette tells front "
        "from back: a track settles on the side that most frames prefer, which is the wrong one "
        "for some (running on the spot, arms in circles). Poses that the index lacks (breakdance, "
        "lying on the side) stay wrong however smooth they are.",
    ], {**figures, "variants": variants})  # fmt: skip


def summary(tracks: Sequence[Followed]) -> dict[str, float]:
    """Figures of some sequences."""
    measures = [track.measures() for track in tracks]
    frames = {name: np.concatenate([one[name] for one in measures]) for name in measures[0]}
    confidences = np.concatenate([track.confidences for track in tracks])
    return {
        "frames": len(confidences),
        **{name: float(values.mean()) for name, values in frames.items()},
        "ece": expected_calibration_error(confidences, frames["right"] > 0),
    }


def fit(shared: Path) -> None:
    """Fit the confidence of smooth poses on tuning sequences, and print it."""
    from sklearn.linear_model import LogisticRegression

    kept, _ = hold_out(read_manifest(shared / "mocap"))
    known, asked = split_by_clip(kept, position=TUNING_POSITION)
    index = build(
        IndexSpec("tuning", shared / "mocap", shared / "garments", segments=tuple(known)),
        progress=True,
    )
    sequences = film_segments(shared, asked, CALIBRATION_AVATARS, TUNING_VIEWS)
    features, right = [], []
    for filmed in tqdm(sequences, desc="matching", unit="sequence"):
        poses = smoothed(filmed, ask(index, filmed))
        features += [smooth.confidence_features for smooth in poses]
        right.append(followed(filmed, poses).measures()["right"] > 0)
    fitted = LogisticRegression(C=1e3).fit(np.array(features), np.concatenate(right))
    print(f"offset {fitted.intercept_[0]:.2f}, weights {np.round(fitted.coef_[0], 2).tolist()}")


def _cells(values: dict[str, float]) -> list[str]:
    return [format(values[name], form) for name, (_, form) in COLUMNS.items()]


def _mean_speed(filmed: Filmed) -> float:
    path = filmed.world[:, 0][:, [0, 2]]
    seconds = max(float(filmed.timestamps[-1]), 1e-9)
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) / seconds


def _to_normalised(silhouette: Silhouette) -> float:
    """Pixels of the normalised frame for each pixel of the camera's."""
    height, width = silhouette.crop.shape
    return float(min(128 / max(height, width), 48 / min(height, width)))
