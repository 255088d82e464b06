"""Heads held level: marker sets let the heads of whole subjects hang or rise.

The median pitch of a subject's head over all upright frames lies anywhere from 6 degrees up to 41
down, although people look ahead most of the time: the head's markers were put on at an angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from index.build.motion import Clip

UPRIGHT_ABOVE = np.cos(np.deg2rad(25.0))
"""Vertical part of the trunk's axis from which a frame counts as upright."""

FEWEST_FRAMES = 100
"""Subjects with fewer upright frames are given the middle pitch of the others."""


def with_level_heads(clips: Sequence[Clip], subjects: Sequence[str]) -> tuple[Clip, ...]:
    """Turn the heads of each subject so that they look straight ahead in the median.

    Parameters
    ----------
    clips : sequence of Clip
    subjects : sequence of str
        Whose each clip is.
    """
    pitches: dict[str, list[NDArray[np.float64]]] = {subject: [] for subject in subjects}
    for clip, subject in zip(clips, subjects, strict=True):
        pitches[subject].append(_upright_pitches(clip))
    all_pitches = {subject: np.concatenate(parts) for subject, parts in pitches.items()}
    middle = {s: float(np.median(p)) for s, p in all_pitches.items() if len(p) >= FEWEST_FRAMES}
    usual = float(np.median(list(middle.values()))) if middle else 0.0
    return tuple(
        _pitched(clip, middle.get(subject, usual))
        for clip, subject in zip(clips, subjects, strict=True)
    )


def _upright_pitches(clip: Clip) -> NDArray[np.float64]:
    """How far the head looks up, in radians, in upright frames."""
    upright = clip.rotations[:, clip.bone("Spine1"), 1, 1] > UPRIGHT_ABOVE
    forward = clip.rotations[upright & ~clip.broken, clip.bone("Head"), :, 2]
    return np.asarray(np.arcsin(np.clip(forward[:, 1], -1, 1)))


def _pitched(clip: Clip, angle: float) -> Clip:
    """Turn a clip's head down by an angle in radians, about the head's own left axis."""
    cosine, sine = np.cos(angle), np.sin(angle)
    down = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    rotations = clip.rotations.copy()
    head = clip.bone("Head")
    rotations[:, head] = rotations[:, head] @ down
    return replace(clip, rotations=rotations)
