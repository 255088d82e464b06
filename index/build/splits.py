"""Which clips and bodies are learned from, and which are held out.

No held-out clip or body is among those that an index, its descriptor, confidence or network is
made from; experiments ask for these only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from index.build.body import Phenotype
from index.build.garments import Wardrobe
from index.build.motion import Segment
from index.build.simulate import Simulation
from index.store import PoseIndex

ALSO_HELD_OUT = ("m2m_Crouch_Fwd_Loop", "m2m_Tired_Hunched")
"""Clips near the ground that experiments hold out although their actions have fewer than three."""

NOT_HELD_OUT = (
    "No action has three clips, of which one could be held out: the confidence is fitted on the "
    "ends of the clips, which are easier than unseen ones."
)


class Split(NamedTuple):
    """Segments to learn from and segments to ask for.

    Parameters
    ----------
    kept, held : list of Segment
    by_clip : bool
        Whether no clip is in both; else the same clips were cut in two.
    """

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
    segments: Sequence[Segment], *, every: int = 5, position: int = 2
) -> tuple[list[Segment], list[Segment]]:
    """Segments to learn from and segments to ask for, no clip in both.

    Every ``every``-th clip of an action, from ``position`` on in the order of names, is held out.
    Actions of different manifests count as different; those with fewer than three clips are kept.
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
