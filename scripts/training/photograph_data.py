"""Training data from rendered photographs: one row for each window that the network read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import LANDMARKS
from app.vision.depth import HIPS
from app.vision.optics import ASSUMED_FOV_DEG, roll_rotation, to_line_of_sight
from app.vision.people import landmark_rows

LIMBS = landmark_rows("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Rows of the limb joints among the landmarks."""

RIGHT_WITHIN, RIGHT_SHARE = 0.2, 0.75
"""A landmark is right within this share of the trunk; a reading is with this share of limb joints.
"""

SEEN_FROM = 0.3
"""The network's presence from which a window teaches depth and posture."""

MIN_SHOWN = 6
"""Landmarks shown, of 33, below which nobody can say whether a window shows a person."""


@dataclass(frozen=True)
class Rows:
    """Arrays with one row for each of the same things."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Concatenate rows."""
        names = [one.name for one in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @classmethod
    def read(cls, folders: Sequence[Path]) -> Self:
        """All rows that were written into folders; ``FileNotFoundError`` if one holds none."""
        parts = []
        for folder in folders:
            files = sorted(folder.glob("*.npz"))
            if not files:
                raise FileNotFoundError(f"expected .npz files in {folder}, found none")
            for file in files:
                with np.load(file) as stored:
                    parts.append(cls(*(stored[part.name] for part in fields(cls))))
        return cls.joined(parts)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Self:
        """Some of the rows."""
        return type(self)(*(getattr(self, part.name)[rows] for part in fields(self)))

    def save(self, file: Path) -> None:
        """Write them as an ``.npz``, whole or not at all."""
        partial = file.with_suffix(".part")
        with partial.open("wb") as written:
            np.savez(written, **{part.name: getattr(self, part.name) for part in fields(self)})
        partial.rename(file)


@dataclass(frozen=True)
class WindowRows(Rows):
    """Windows that the landmark network read, with the truth about them, ``N`` of each.

    ``scene`` is the number of the photograph. Points, world, presence and last are as in
    :class:`app.vision.blazepose.NetworkPass`; ``sampled`` ``(N, 33, 144)`` is the middle map at the
    landmarks. Windows ``(N, 4)`` are x, y, side, and roll in degrees. Focal, centre and frame are
    as in :class:`scripts.training.render.scene.Photograph`. The posture is -1 where nobody is.
    Landmarks ``(N, 33, 3)`` are metres in camera axes, places ``(N, 33, 2)`` pixels, shown or not.
    The elevation is the camera's, as seen from the subject.
    """

    scene: NDArray[np.int64]
    points: NDArray[np.float32]
    world: NDArray[np.float32]
    presence: NDArray[np.float32]
    last: NDArray[np.float16]
    sampled: NDArray[np.float16]
    window: NDArray[np.float64]
    focal: NDArray[np.float64]
    centre: NDArray[np.float64]
    frame_px: NDArray[np.float64]
    posture: NDArray[np.int64]
    landmarks: NDArray[np.float32]
    places: NDArray[np.float32]
    shown: NDArray[np.bool_]
    elevation_deg: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.scene)


@dataclass(frozen=True)
class TrainingRows(WindowRows):
    """Rows and the focal lengths with which models read them ``(N, 2)``.

    Half of the cameras are known; the others are taken for the assumed one.
    """

    read_focal: NDArray[np.float64]

    @classmethod
    def of(cls, rows: WindowRows, seed: int) -> TrainingRows:
        """Choose by seed which cameras are known."""
        longest = rows.frame_px.max(axis=1)
        assumed = longest / 2 / np.tan(np.deg2rad(ASSUMED_FOV_DEG) / 2)
        known = np.random.default_rng(seed).random(len(rows)) < 0.5
        read_focal = np.where(known[:, None], rows.focal, assumed[:, None])
        return cls(**vars(rows), read_focal=read_focal)

    @property
    def person(self) -> NDArray[np.bool_]:
        """Whether each window shows a person."""
        return self.posture >= 0

    @property
    def teaches(self) -> NDArray[np.bool_]:
        """Whether each window teaches depth and posture."""
        return self.person & (self.presence > SEEN_FROM)

    @property
    def decided(self) -> NDArray[np.bool_]:
        """Whether each window shows nobody, or enough of a person to be sure."""
        return np.asarray(~self.person | (self.shown.sum(axis=1) >= MIN_SHOWN))

    @property
    def found_places(self) -> NDArray[np.float64]:
        """Where the network saw the landmarks: ``(N, 33, 2)`` pixels of the frame."""
        offsets = (self.points[:, :LANDMARKS, :2].astype(np.float64) - 128.0) / 256.0
        turn = roll_rotation(self.window[:, 3])[:, :2, :2]
        turned = np.einsum("nji,npj->npi", turn, offsets)
        return np.asarray(turned * self.window[:, None, 2:3] + self.window[:, None, :2])

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether each window shows a person of whom enough shown limb joints are right."""
        apart = np.linalg.norm(self.found_places - self.places, axis=2)[:, LIMBS]
        shoulders, hips = (self.places[:, rows].mean(axis=1) for rows in ([11, 12], [23, 24]))
        trunk = np.linalg.norm(shoulders - hips, axis=1)
        size = np.maximum(trunk, 0.2 * np.ptp(self.places, axis=1).max(axis=1))
        shown = self.shown[:, LIMBS]
        right = (apart < RIGHT_WITHIN * size[:, None]) & shown
        share = right.sum(axis=1) / np.maximum(shown.sum(axis=1), 1)
        return np.asarray(self.person & (share >= RIGHT_SHARE))

    @property
    def depths(self) -> NDArray[np.float64]:
        """True depths ``(N, 33)`` along the true line of sight, about the middle of the hips."""
        level = (self.window[:, :2] - self.centre) / self.focal
        rays = np.concatenate([level, np.ones((len(self), 1))], axis=1)
        depths = np.einsum("nj,npj->np", to_line_of_sight(rays)[:, 2], self.landmarks)
        return np.asarray(depths - depths[:, HIPS].mean(axis=1, keepdims=True), np.float64)
