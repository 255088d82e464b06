"""Tracks against single frames: clips that the index never saw, filmed by a fixed camera.

The index of the strict experiment is asked for sequences of its held-out clips on bodies that it
does not know, silhouettes alone. Every frame by itself is compared with the smooth pose of the
frames so far. What was chosen or fitted (``--fit``) was so on other clips, bodies and an index
without them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimates import ObservedPerson, Person
from app.estimation.facing import azimuth_deg
from app.estimation.hypotheses import fit_poses, normalise_person
from app.tracking.smoothing import STATES, PoseSmoother, Smoothed
from app.vision.people import Silhouette
from app.work.cores import available_cores
from index.build.avatars import CALIBRATION_AVATARS, HELD_OUT_AVATARS, Wardrobe, make_avatars
from index.build.body import Phenotype
from index.build.builder import Plan, build, split_by_clip
from index.build.calibrate import expected_calibration_error
from index.build.motion import Segment, read_manifest
from index.build.poses import read_poses
from index.confidence import RIGHT_BELOW_PX
from index.skeleton import exchange_sides, mean_joint_distance, wrap_degrees
from index.store import PoseIndex
from scripts.experiments.report import table, write
from scripts.experiments.sequences import FPS, Filmed, film
from scripts.experiments.strict import hold_out, strict_index

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
    "without the cost of low postures": {"low_cost": 0.0},
    "without the line through the last frames": {"line_s": 0.0},
}
"""What is left out of smoothing, to see what it is worth."""

HEADER = (
    "frames", "2D (px)", "right (%)", "3D (mm)", "front/back flipped (%)",
    "left/right flipped (%)", "change a frame (mm)", "beyond the true motion (mm)", "ECE",
)  # fmt: skip


@dataclass(frozen=True)
class Followed:
    """A filmed sequence and what was estimated: every frame alone, or smooth."""

    filmed: Filmed
    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    confidences: NDArray[np.float64]

    def errors_m(self) -> NDArray[np.float64]:
        """Mean joint errors ``(F,)`` in metres."""
        return mean_joint_distance(self.points_3d, self.filmed.points_3d)

    def errors_px(self) -> NDArray[np.float64]:
        """Mean joint errors ``(F,)`` in pixels of the normalised frame."""
        scales = np.array([_to_normalised(s) for s in self.filmed.silhouettes])
        return scales * mean_joint_distance(self.points_2d, self.filmed.points_2d)

    def front_back(self) -> NDArray[np.bool_]:
        """Frames ``(F,)`` in which the body faces the other half of the horizon."""
        turned = azimuth_deg(self.points_3d) - azimuth_deg(self.filmed.points_3d)
        return np.asarray(np.abs(wrap_degrees(turned)) > 90)

    def left_right(self) -> NDArray[np.bool_]:
        """Frames ``(F,)`` that face the right way with the limbs of left and right exchanged."""
        exchanged = mean_joint_distance(exchange_sides(self.points_3d), self.filmed.points_3d)
        return ~self.front_back() & (exchanged < EXCHANGED * self.errors_m())

    def changes_m(self) -> NDArray[np.float64]:
        """Mean ways ``(F - 1,)`` of the joints from frame to frame."""
        return mean_joint_distance(self.points_3d[1:], self.points_3d[:-1])

    def true_changes_m(self) -> NDArray[np.float64]:
        """As they truly are."""
        return mean_joint_distance(self.filmed.points_3d[1:], self.filmed.points_3d[:-1])


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--fit-tracks", action="store_true", help="fit the confidence instead")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks."""
    if options.fit_tracks:
        fit(options.shared)
        return
    index = strict_index(options.shared, options.strict_index)
    _, held = hold_out(read_manifest(options.shared / "mocap"))
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
    """Compare single frames with tracks, and write ``tracking.md``, ``.json`` and ``.png``."""
    single = [alone(*pair) for pair in zip(sequences, persons, strict=True)]
    tracks = [
        followed(filmed, smoothed(filmed, people))
        for filmed, people in zip(sequences, persons, strict=True)
    ]
    groups = {"all": [True] * len(sequences)}
    groups["walk or run over the ground"] = [
        filmed.action in ("walk", "run") and _mean_speed(filmed) > OVER_GROUND_M_S
        for filmed in sequences
    ]
    groups["walk or run on the spot"] = [
        filmed.action in ("walk", "run") and _mean_speed(filmed) <= OVER_GROUND_M_S
        for filmed in sequences
    ]
    for action in sorted({filmed.action for filmed in sequences}):
        groups[action] = [filmed.action == action for filmed in sequences]
    figures: dict[str, dict[str, dict[str, float]]] = {}
    rows = []
    for name, chosen in groups.items():
        if not any(chosen):
            continue
        figures[name] = {
            kind: summary([track for track, wanted in zip(those, chosen, strict=True) if wanted])
            for kind, those in (("alone", single), ("smooth", tracks))
        }
        rows += [
            [name if kind == "alone" else "", kind, *_cells(values)]
            for kind, values in figures[name].items()
        ]
    pairs = list(zip(sequences, persons, strict=True))
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
        "![Sequences, alone and smooth](tracking.png)",
        "Drawn at revision 508dd52; later ones do not draw it.",
    ], {**figures, "variants": variants})  # fmt: skip


def summary(tracks: Sequence[Followed]) -> dict[str, float]:
    """Figures of some sequences."""
    errors_px = np.concatenate([track.errors_px() for track in tracks])
    confidences = np.concatenate([track.confidences for track in tracks])
    changes = np.concatenate([track.changes_m() for track in tracks])
    true_changes = np.concatenate([track.true_changes_m() for track in tracks])
    right = errors_px < RIGHT_BELOW_PX
    return {
        "frames": len(errors_px),
        "px": float(errors_px.mean()),
        "right": 100 * float(right.mean()),
        "mm": 1000 * float(np.concatenate([t.errors_m() for t in tracks]).mean()),
        "front_back": 100 * float(np.concatenate([t.front_back() for t in tracks]).mean()),
        "left_right": 100 * float(np.concatenate([t.left_right() for t in tracks]).mean()),
        "change_mm": 1000 * float(changes.mean()),
        "jitter_mm": 1000 * float((changes - true_changes).mean()),
        "ece": expected_calibration_error(confidences[:, None], right[:, None]),
    }


def fit(shared: Path) -> None:
    """Fit the confidence of smooth poses on tuning sequences, and print it."""
    from sklearn.linear_model import LogisticRegression

    kept, _ = hold_out(read_manifest(shared / "mocap"))
    known, asked = split_by_clip(kept, position=TUNING_POSITION)
    index = build(
        shared / "mocap", shared / "garments", Plan(), name="tuning", segments=known, progress=True
    )
    sequences = film_segments(shared, asked, CALIBRATION_AVATARS, TUNING_VIEWS)
    features, right = [], []
    for filmed in tqdm(sequences, desc="matching", unit="sequence"):
        poses = smoothed(filmed, ask(index, filmed))
        features += [smooth.confidence_features for smooth in poses]
        right.append(followed(filmed, poses).errors_px() < RIGHT_BELOW_PX)
    fitted = LogisticRegression(C=1e3).fit(np.array(features), np.concatenate(right))
    print(f"offset {fitted.intercept_[0]:.2f}, weights {np.round(fitted.coef_[0], 2).tolist()}")


def _cells(values: dict[str, float]) -> list[str]:
    return [
        f"{values['frames']:,.0f}", f"{values['px']:.1f}", f"{values['right']:.1f}",
        f"{values['mm']:.0f}", f"{values['front_back']:.1f}", f"{values['left_right']:.1f}",
        f"{values['change_mm']:.0f}", f"{values['jitter_mm']:.0f}", f"{values['ece']:.3f}",
    ]  # fmt: skip


def _mean_speed(filmed: Filmed) -> float:
    path = filmed.world[:, 0][:, [0, 2]]
    seconds = max(float(filmed.timestamps[-1]), 1e-9)
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) / seconds


def _to_normalised(silhouette: Silhouette) -> float:
    """Pixels of the normalised frame for each pixel of the camera's."""
    height, width = silhouette.crop.shape
    return float(min(128 / max(height, width), 48 / min(height, width)))
