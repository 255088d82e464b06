"""Tracks against single frames: clips that the index never saw, filmed by a fixed camera.

The index without the held-out clips, with the network that ships, is asked for sequences of these
clips on unknown bodies, silhouettes alone. Every frame by itself is compared with the
smooth pose of the frames so far. Parameters were chosen, and the confidence fitted
(``--fit-tracks``), on other clips and bodies, with an index without them and without the network.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.results import Person, ProjectedHypothesis
from app.tracking.results import SmoothedPose
from app.tracking.smoothing import SMOOTHING, Smoothed
from app.vision.people import Silhouette
from index.confidence import RIGHT_BELOW_PX
from index.posture import azimuth_deg
from index.skeleton import exchange_sides, mean_joint_distance, wrap_degrees
from index.store import PoseIndex
from scripts.filming import FPS, Filmed, film
from scripts.helpers import Follower, match_silhouettes
from scripts.index.body import Phenotype
from scripts.index.builder import (
    CALIBRATION_AVATARS,
    HELD_OUT_AVATARS,
    IndexSpec,
    build,
    hold_out,
    split_by_clip,
)
from scripts.index.calibrate import expected_calibration_error
from scripts.index.garments import Wardrobe, make_avatars
from scripts.index.motion import Segment, read_manifest
from scripts.index.poses import read_poses
from scripts.training.held_out import strict_index

VIEWS, SEED = 4, 7
TUNING_VIEWS, TUNING_POSITION = 3, 1
"""Cameras of the tuning sequences, and which clips of each action they show."""

OVER_GROUND_M_S = 0.5
"""Mean speed from which a walk leads somewhere, unlike exercises on the spot."""

EXCHANGED = 0.8
"""Left and right count as exchanged where exchanging them takes the error below this share."""

VARIANTS: dict[str, dict[str, float]] = {
    "as_it_is": {},
    "seven_hypotheses_a_frame": {"max_states": 7},
    "without_heading_over_time": {"heading_weight": 0.0},
    "without_cost_of_moving": {"cost_per_m": 0.0},
    "without_line_through_last_frames": {"line_s": 0.0},
}
"""Parameters of the smoother that leave a part out, to see what it is worth."""

Sequences = Sequence[tuple[Filmed, Sequence[Person]]]


@dataclass(frozen=True)
class Estimated:
    """A filmed sequence and its estimates: every frame alone, or smooth."""

    filmed: Filmed
    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    confidences: NDArray[np.float64]

    def measures(self) -> dict[str, NDArray[np.floating]]:
        """Return the measures of each frame, or of each step between two."""
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


def run(options: argparse.Namespace) -> dict[str, object] | None:
    """Run the experiment."""
    if options.fit_tracks:
        fit(options.shared)
        return None
    _, held = hold_out(read_manifest(options.shared / "mocap"))
    index = strict_index(options.shared, options.strict_index)
    filmed = film_segments(options.shared, held, HELD_OUT_AVATARS, VIEWS)
    return measure([
        (one, match_silhouettes(index, one.silhouettes, one.camera, SMOOTHING.max_states))
        for one in tqdm(filmed, desc="matching", unit="sequence")
    ])  # fmt: skip


def measure(sequences: Sequences) -> dict[str, object]:
    """Compare single frames with tracks."""
    single = [
        estimated(filmed, [person.hypotheses[0] for person in persons])
        for filmed, persons in sequences
    ]
    tracks = [smooth(filmed, persons) for filmed, persons in sequences]
    return {
        "sequences": len(sequences),
        "cameras": VIEWS,
        "frames_per_s": FPS,
        "groups": {
            name: {
                "alone": summary([single[row] for row in rows]),
                "smooth": summary([tracks[row] for row in rows]),
            }
            for name, rows in groups([filmed for filmed, _ in sequences]).items()
        },
        "variants": {
            name: summary([smooth(filmed, persons, **left_out) for filmed, persons in sequences])
            for name, left_out in VARIANTS.items()
        },
    }


def groups(sequences: Sequence[Filmed]) -> dict[str, list[int]]:
    """Return the positions of all sequences, of walks and runs, and of each action."""
    moving = np.array([_mean_speed(filmed) > OVER_GROUND_M_S for filmed in sequences])
    actions = np.array([filmed.action for filmed in sequences])
    walks = np.isin(actions, ("walk", "run"))
    chosen = {
        "all": np.ones(len(sequences), bool),
        "walk_or_run_over_the_ground": walks & moving,
        "walk_or_run_on_the_spot": walks & ~moving,
        **{name.replace("-", "_"): actions == name for name in sorted(set(actions.tolist()))},
    }
    return {name: np.flatnonzero(rows).tolist() for name, rows in chosen.items() if rows.any()}


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


def estimated(filmed: Filmed, poses: Sequence[SmoothedPose | ProjectedHypothesis]) -> Estimated:
    """Put the poses of a sequence, one for each frame, beside the truth."""
    return Estimated(
        filmed,
        np.array([pose.points_3d for pose in poses]),
        np.array([pose.points_2d for pose in poses]),
        np.array([pose.confidence for pose in poses]),
    )


def smoothed(filmed: Filmed, persons: Sequence[Person], **parameters: Any) -> list[Smoothed]:
    """Smooth a sequence; each pose follows from the frames up to its own."""
    follower = Follower(replace(SMOOTHING, **parameters))
    updates = [
        follower.update(person, timestamp)
        for person, timestamp in zip(persons, filmed.timestamps.tolist(), strict=True)
    ]
    return [update[1] for update in updates if update is not None]


def smooth(filmed: Filmed, persons: Sequence[Person], **parameters: Any) -> Estimated:
    """Estimate a sequence by its smooth poses."""
    return estimated(filmed, [one.pose for one in smoothed(filmed, persons, **parameters)])


def summary(estimated: Sequence[Estimated]) -> dict[str, float]:
    """Return the figures of some sequences."""
    measures = [one.measures() for one in estimated]
    frames = {name: np.concatenate([one[name] for one in measures]) for name in measures[0]}
    confidences = np.concatenate([one.confidences for one in estimated])
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
    index: PoseIndex = build(
        IndexSpec("tuning", shared / "mocap", shared / "garments", segments=tuple(known)),
    )
    features, right = [], []
    for filmed in tqdm(film_segments(shared, asked, CALIBRATION_AVATARS, TUNING_VIEWS)):
        poses = smoothed(
            filmed,
            match_silhouettes(index, filmed.silhouettes, filmed.camera, SMOOTHING.max_states),
        )
        features += [one.confidence_features for one in poses]
        right.append(estimated(filmed, [one.pose for one in poses]).measures()["right"] > 0)
    fitted = LogisticRegression(C=1e3).fit(np.array(features), np.concatenate(right))
    print(f"offset {fitted.intercept_[0]:.2f}, weights {np.round(fitted.coef_[0], 2).tolist()}")


def _mean_speed(filmed: Filmed) -> float:
    path = filmed.world[:, 0][:, [0, 2]]
    seconds = max(float(filmed.timestamps[-1]), 1e-9)
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) / seconds


def _to_normalised(silhouette: Silhouette) -> float:
    """Return the pixels of the normalised frame for each pixel of the camera's."""
    height, width = silhouette.crop.shape
    return float(min(128 / max(height, width), 48 / min(height, width)))
