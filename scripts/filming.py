"""Film motion clips with a fixed camera: the people of the experiments on tracks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.vision.optics import PinholeCamera
from app.vision.people import Silhouette, silhouette_from_mask
from index.skeleton import JOINT_NAMES, camera_rotation
from scripts.index.body import Avatar, pose_transforms, posed_points, retarget
from scripts.index.motion import METRES_PER_UNIT, Clip
from scripts.index.poses import Poses
from scripts.index.render import fill_triangles, skin

CLIP_FPS = 30
FPS = 10
"""Frame rate of the cameras, as in the street video."""

MIN_S, MAX_S = 1.5, 20.0
"""Shorter stretches are left out, longer ones cut."""

ELEVATIONS_DEG = (2.0, 40.0)
FIELD_DEG = 50.0
"""Diagonal field of view; cameras stand far enough away to see the whole path."""

NEAREST_M = 5.0
PERSON_PX = 160.0
"""Height of a body of 1.7 m in the middle of the path."""

_MARGIN_PX = 8


@dataclass(frozen=True)
class Filmed:
    """A stretch of motion as one fixed camera sees it.

    ``timestamps`` count from 0, silhouettes and ``points_2d`` are in pixels of the camera's frame;
    ``points_3d`` in metres in camera axes, relative to the pelvis; ``world``
    in metres, y up; ``speeds`` of the pelvis over the ground, metres a second.
    """

    clip: str
    action: str
    subject: str
    frames: NDArray[np.int64]
    timestamps: NDArray[np.float64]
    silhouettes: tuple[Silhouette, ...]
    points_3d: NDArray[np.float64]
    points_2d: NDArray[np.float64]
    world: NDArray[np.float64]
    speeds: NDArray[np.float64]
    elevation_deg: float
    camera: PinholeCamera

    def __len__(self) -> int:
        return len(self.frames)


def film(
    poses: Poses,
    subjects: dict[str, str],
    avatars: Sequence[Avatar],
    seed: int,
    *,
    views: int = 1,
    fps: int = FPS,
) -> list[Filmed]:
    """Film every stretch of recorded motion, with avatars in turn and ``views`` random cameras.

    ``subjects`` gives the subject of each clip; ``fps`` is a divisor of 30.
    """
    generator = np.random.default_rng(seed)
    filmed: list[Filmed] = []
    for rows in _pieces(poses, CLIP_FPS // fps):
        clip = poses.clips[poses.clip[rows[0]]]
        action = poses.actions[poses.action[rows[0]]]
        for _ in range(views):
            avatar = avatars[len(filmed) % len(avatars)]
            filmed.append(
                film_stretch(
                    clip, action, subjects[clip.name], poses.frame[rows], avatar, generator
                )
            )
    return filmed


def unbroken_stretches(poses: Poses) -> list[NDArray[np.int64]]:
    """Return the rows of unbroken motion of one action, stretch by stretch."""
    parted = (np.diff(poses.clip) != 0) | (np.diff(poses.action) != 0) | (np.diff(poses.frame) != 1)
    return np.split(np.arange(len(poses)), np.flatnonzero(parted) + 1)


def _pieces(poses: Poses, step: int) -> list[NDArray[np.int64]]:
    """Cut stretches to length and take every ``step``-th frame."""
    most = round(MAX_S * CLIP_FPS)
    pieces = [
        rows[first : first + most]
        for rows in unbroken_stretches(poses)
        for first in range(0, len(rows), most)
    ]
    return [piece[::step] for piece in pieces if len(piece) >= MIN_S * CLIP_FPS]


def film_stretch(
    clip: Clip,
    action: str,
    subject: str,
    frames: NDArray[np.int64],
    avatar: Avatar,
    generator: np.random.Generator,
) -> Filmed:
    """Film one stretch from one camera."""
    transforms = pose_transforms(avatar, retarget(clip, avatar), clip.rotations[frames])
    points = posed_points(avatar, transforms)
    path = on_ground(clip, frames, points)
    world = points + path[:, None]
    centre = (world.max(axis=(0, 1)) + world.min(axis=(0, 1))) / 2
    radius = float(np.linalg.norm(world - centre, axis=-1).max())
    distance = max(NEAREST_M, radius / np.sin(np.deg2rad(FIELD_DEG / 2)))
    elevation_deg = float(generator.uniform(*ELEVATIONS_DEG))
    rotation = camera_rotation(generator.uniform(0, 360), elevation_deg)
    focal = PERSON_PX / 1.7 * distance

    def projected(positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        seen = (positions - centre) @ rotation.T + np.array([0.0, 0.0, distance])
        return seen, focal * seen[..., :2] / seen[..., 2:]

    seen, points_2d = projected(world)
    # The body fits within the radius; clothes reach a little farther.
    half = focal * (radius + 0.5) / max(distance - radius - 0.5, 1.0) + _MARGIN_PX
    silhouettes = []
    for number, transform in enumerate(transforms):
        vertices = skin(
            avatar.vertices, avatar.influences, avatar.weights, transform.astype(np.float32)
        )
        _, plane = projected(vertices + path[number])
        silhouettes.append(_draw(plane + half, avatar))
    return Filmed(
        clip=clip.name,
        action=action,
        subject=subject,
        frames=frames,
        timestamps=(frames - frames[0]) / CLIP_FPS,
        silhouettes=tuple(silhouettes),
        points_3d=seen - seen[:, :1],
        points_2d=points_2d + half,
        world=world,
        speeds=clip.speeds[frames],
        elevation_deg=elevation_deg,
        camera=PinholeCamera(np.array([focal, focal]), np.array([half, half])),
    )


def on_ground(
    clip: Clip, frames: NDArray[np.int64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the path ``(F, 3)`` of the pelvis of a body ``(F, 24, 3)`` on the ground."""
    path = clip.positions[frames] * _leg_length(points[0]) / _clip_leg_length(clip)
    path[:, 1] += _ground_gap(points, path)
    return path


def _draw(plane: NDArray[np.float64], avatar: Avatar) -> Silhouette:
    """Draw a body whose vertices are projected to ``(V, 2)`` pixels."""
    corner = np.floor(plane.min(axis=0)).astype(int)
    width, height = np.ceil(plane.max(axis=0)).astype(int) - corner + 1
    image = np.zeros((height, width), np.uint8)
    fill_triangles((plane - corner).astype(np.float32), avatar.triangles, avatar.closed, image)
    silhouette = silhouette_from_mask(
        image > 0, left=int(corner[0]), top=int(corner[1]), segmenter="mask", truncated=False
    )
    if silhouette is None:
        raise ValueError("expected a body that covers a pixel")
    return silhouette


def _leg_length(points: NDArray[np.float64]) -> float:
    hip, knee, ankle = (
        points[JOINT_NAMES.index(f"left_{name}")] for name in ("hip", "knee", "ankle")
    )
    return float(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))


def _clip_leg_length(clip: Clip) -> float:
    lengths = [clip.offsets[clip.bones.index(name)] for name in ("LeftLeg", "LeftFoot")]
    return METRES_PER_UNIT * float(np.linalg.norm(lengths, axis=1).sum())


def _ground_gap(points: NDArray[np.float64], path: NDArray[np.float64]) -> float:
    """Return how far the lowest joints are below the ground, most of the time."""
    return -float(np.quantile((points[..., 1] + path[:, None, 1]).min(axis=1), 0.1))
