"""Poses x bodies x views to silhouettes with their skeletons."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import Descriptor
from descriptor.silhouette import HEIGHT, WIDTH, is_wide, pack, principal_axis_deg, unpack
from index.build.body import Avatar, pose_transforms, posed_points, retarget
from index.build.camera import ELEVATIONS_DEG, GROUND_ELEVATIONS_DEG, sample_views
from index.build.poses import Poses
from index.build.render import render, skin
from index.posture import POSTURES, classify
from index.skeleton import BODY_UP, JOINT_NAMES, POINTS, camera_rotation, wrap_degrees
from index.store import ENTRY_DTYPE, SKELETON_DTYPE

BLOCK = 4096
"""Silhouettes unpacked and described at a time."""

FORESHORTENED_OF = 2
"""Cameras sampled for each that looks at a pose laid down: who lies across the picture looks as
somebody who stands."""

_NEAR_GROUND = [POSTURES.index(posture) for posture in ("crawling", "lying")]


@dataclass(frozen=True)
class Simulation:
    """Simulated silhouettes and where each comes from; fields as in :class:`index.store.PoseIndex`.

    Parameters
    ----------
    bits : (E, 768) uint8 array
        Bit-packed normalised silhouettes.
    entries : (E,) array of ENTRY_DTYPE
    skeletons : (S, 24, 3) float16 array
    skeleton_labels : (S,) array of SKELETON_DTYPE
    clips, subjects, actions : tuple of str
    """

    bits: NDArray[np.uint8]
    entries: NDArray[np.void]
    skeletons: NDArray[np.float16]
    skeleton_labels: NDArray[np.void]
    clips: tuple[str, ...]
    subjects: tuple[str, ...]
    actions: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.entries)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Simulation:
        """Some entries; all skeletons stay."""
        return replace(self, bits=self.bits[rows], entries=self.entries[rows])

    def silhouettes(self, rows: slice | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Unpack some silhouettes ``(B, 128, 48)`` of 0 and 1."""
        return unpack(self.bits[rows])

    def describe(self, descriptor: Descriptor) -> NDArray[np.float32]:
        """All silhouettes as vectors ``(E, D)``, block by block."""
        blocks = [
            descriptor.describe(self.silhouettes(slice(start, start + BLOCK)))
            for start in range(0, len(self), BLOCK)
        ]
        return np.concatenate(blocks)


def simulate(
    poses: Poses,
    avatars: Sequence[Avatar],
    *,
    bodies: int,
    views: int,
    seed: int,
    only_new: bool = False,
    progress: bool = False,
) -> Simulation:
    """Render every pose on some bodies from some views.

    Parameters
    ----------
    poses : Poses
    avatars : sequence of Avatar
        Dealt out in turn, so that each gets its share of the poses.
    bodies : int
        Bodies per pose.
    views : int
        Views per pose and body.
    seed : int
        The same seed, poses and avatars give the same bytes, on any number of cores.
    only_new : bool
        Whether poses laid down are left out where standing ones look the same: seen across.
    progress : bool
        Whether to draw a progress bar.

    Returns
    -------
    Simulation
        Entries pose by pose, body by body, view by view.
    """
    bodies = min(bodies, len(avatars))
    count = len(poses) * bodies
    generator = np.random.default_rng(seed)
    cast = np.concatenate(
        [generator.permutation(len(avatars)) for _ in range(-(-count // len(avatars)))]
    )[:count]
    seeds = np.random.SeedSequence(seed).spawn(count)
    retargeting = {
        (clip, body): retarget(poses.clips[clip], avatars[body])
        for clip in np.unique(poses.clip)
        for body in range(len(avatars))
    }
    bits = np.empty((count * views, HEIGHT * WIDTH // 8), np.uint8)
    entries = np.zeros(count * views, ENTRY_DTYPE)
    skeletons = np.empty((count, POINTS, 3), np.float16)
    labels = np.zeros(count, SKELETON_DTYPE)
    speeds = poses.speeds()

    def one(skeleton: int) -> None:
        row, body = skeleton // bodies, int(cast[skeleton])
        avatar, clip = avatars[body], int(poses.clip[row])
        rotations = poses.rotations(np.array([row]))
        transforms = pose_transforms(avatar, retargeting[clip, body], rotations)
        points = posed_points(avatar, transforms)
        near_ground = classify(points, BODY_UP)[0] in _NEAR_GROUND
        skeletons[skeleton] = points[0]
        labels[skeleton] = (clip, poses.frame[row], body, poses.action[row], speeds[row])
        vertices = skin(
            avatar.vertices, avatar.influences, avatar.weights, transforms[0].astype(np.float32)
        )
        laid_down = not np.isnan(poses.lying_deg[row])
        cameras = sample_views(
            (FORESHORTENED_OF if laid_down and only_new else 1) * views,
            np.random.default_rng(seeds[skeleton]),
            GROUND_ELEVATIONS_DEG if near_ground else ELEVATIONS_DEG,
        )
        if laid_down and only_new:
            cameras = most_foreshortened(cameras, points[0], views)
        silhouettes = np.empty((views, HEIGHT, WIDTH), np.uint8)
        first = skeleton * views
        for view, camera in enumerate(cameras):
            entries[first + view] = (
                skeleton, *_draw(avatar, vertices, points[0], camera, silhouettes[view])
            )  # fmt: skip
        bits[first : first + views] = pack(silhouettes)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        done = pool.map(one, range(count))
        for _ in tqdm(done, total=count, unit="body", desc="simulating", disable=not progress):
            pass
    return Simulation(
        bits, entries, skeletons, labels,
        tuple(clip.name for clip in poses.clips), tuple(a.name for a in avatars), poses.actions,
    )  # fmt: skip


def most_foreshortened(
    cameras: NDArray[np.void], points: NDArray[np.float64], count: int
) -> NDArray[np.void]:
    """The ``count`` cameras that look most along the trunk of a body ``(24, 3)``."""
    trunk = points[JOINT_NAMES.index("neck")] - points[JOINT_NAMES.index("pelvis")]
    rotations = camera_rotation(cameras["azimuth_deg"], cameras["elevation_deg"])
    along = np.abs(rotations[:, 2] @ trunk)
    return cameras[np.sort(np.argsort(-along, kind="stable")[:count])]


def _draw(
    avatar: Avatar,
    vertices: NDArray[np.float32],
    points: NDArray[np.float64],
    camera: np.void,
    silhouette: NDArray[np.uint8],
) -> tuple[float, ...]:
    """Draw one view; return its camera, rolled where the body is wide, and the placement."""
    azimuth_deg, elevation_deg, roll_deg, distance = camera.tolist()

    def placed() -> tuple[float, ...]:
        rotation = camera_rotation(azimuth_deg, elevation_deg, roll_deg).astype(np.float32)
        return tuple(
            render(vertices, avatar.triangles, avatar.closed, rotation, distance, silhouette)
        )

    placement = placed()
    if is_wide(silhouette):
        axis_deg = principal_axis_deg(silhouette)
        body = points[[JOINT_NAMES.index("head"), JOINT_NAMES.index("pelvis")]]
        rolls = [roll_deg - axis_deg, roll_deg - axis_deg + 180.0]
        upright = camera_rotation(azimuth_deg, elevation_deg, np.array(rolls))
        head_down, pelvis_down = (body @ upright.swapaxes(1, 2))[..., 1].T
        roll_deg = float(wrap_degrees(rolls[int((head_down - pelvis_down).argmin())]))
        placement = placed()
    return azimuth_deg, elevation_deg, roll_deg, distance, *placement
