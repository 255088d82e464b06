"""The data of the paper's experiments, and what counts as recognised.

Four unclothed avatars (two women, two men) perform four actions before eight fixed cameras.
One stretch of each action is sampled at regular steps. Nearly every sixth of these frames is unseen
and the others are known, for all avatars and cameras alike: 19 frames x 4 avatars x 8 cameras make
608 unseen silhouettes, 92 x 4 x 8, evenly thinned, 2,925 known ones.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.silhouette import HEIGHT, WIDTH, pack
from index.build.body import Avatar, pose_transforms, posed_points, retarget
from index.build.builder import PAPER_AVATARS
from index.build.descriptor_learning import view_joints
from index.build.garments import make_avatars
from index.build.motion import Segment, read_manifest
from index.build.poses import Poses, read_poses
from index.build.render import render, skin
from index.build.simulate import Simulation
from index.build.views import VIEW_DTYPE
from index.build.writer import compress
from index.confidence import RIGHT_BELOW_PX
from index.skeleton import POINTS, camera_rotation
from index.store import ENTRY_DTYPE, SKELETON_DTYPE

KNOWN = 2925
"""The paper's number of training silhouettes."""

STRETCHES = {
    "walk": ("07_01", 20, 28, 5),
    "basketball": ("basketball_train_1", 20, 28, 5),
    "jump": ("jump_train_2", 20, 28, 5),
    "climb": ("01_02", 200, 27, 4),
}
"""Clip and first frame of each action, its number of frames, and of those that are unseen."""

STEP = 2
"""Frames from one sample to the next, for 15 samples a second."""

CAMERA_DISTANCE_M = 5.0


def rig() -> NDArray[np.void]:
    """Place eight cameras about the person, 45 degrees apart, at 10 and 30 degrees in turn."""
    cameras = np.zeros(8, VIEW_DTYPE)
    cameras["azimuth_deg"] = np.arange(8) * 45.0
    cameras["elevation_deg"] = np.tile([10.0, 30.0], 4)
    cameras["distance"] = CAMERA_DISTANCE_M
    return cameras


def film(poses: Poses, avatars: Sequence[Avatar], cameras: NDArray[np.void]) -> Simulation:
    """Film every pose on every avatar before every camera, in that order."""
    bodies, views = len(avatars), len(cameras)
    to_camera = camera_rotation(
        cameras["azimuth_deg"], cameras["elevation_deg"], cameras["roll_deg"]
    ).astype(np.float32)
    retargeting = {
        (clip, body): retarget(poses.clips[clip], avatar)
        for clip in np.unique(poses.clip)
        for body, avatar in enumerate(avatars)
    }
    count = len(poses) * bodies
    silhouettes = np.empty((count * views, HEIGHT, WIDTH), np.uint8)
    entries = np.zeros(count * views, ENTRY_DTYPE)
    skeletons = np.empty((count, POINTS, 3), np.float16)
    labels = np.zeros(count, SKELETON_DTYPE)
    for skeleton in tqdm(range(count), desc="filming", unit="body"):
        row, body = divmod(skeleton, bodies)
        avatar, clip = avatars[body], int(poses.clip[row])
        rotations = poses.rotations(np.array([row]))
        transforms = pose_transforms(avatar, retargeting[clip, body], rotations)
        skeletons[skeleton] = posed_points(avatar, transforms)[0]
        labels[skeleton] = (clip, poses.frame[row], body, poses.action[row], 0.0)
        vertices = skin(
            avatar.vertices, avatar.influences, avatar.weights, transforms[0].astype(np.float32)
        )
        for view, camera in enumerate(cameras):
            entry = skeleton * views + view
            placed = render(
                vertices, avatar.triangles, avatar.closed, to_camera[view],
                float(camera["distance"]), silhouettes[entry],
            )  # fmt: skip
            entries[entry] = (skeleton, *camera.tolist(), *placed)
    return Simulation(
        compress(pack(silhouettes)), entries, skeletons, labels,
        tuple(clip.name for clip in poses.clips), tuple(a.name for a in avatars), poses.actions,
    )  # fmt: skip


def paper_data(motion: Path) -> tuple[Simulation, Simulation]:
    """Simulate the 2,925 known and the 608 unseen silhouettes."""
    avatars = make_avatars(PAPER_AVATARS, None)
    subjects = {segment.action: segment.subject for segment in read_manifest(motion)}
    parts = [
        Segment(clip, subjects[action], action, first, first + STEP * frames)
        for action, (clip, first, frames, _) in STRETCHES.items()
    ]
    poses, _ = read_poses(motion, parts)
    known_rows, unseen_rows = [], []
    for part in parts:
        number = [clip.name for clip in poses.clips].index(part.clip)
        wanted = np.isin(poses.frame, np.arange(part.start, part.end, STEP))
        rows = np.flatnonzero((poses.clip == number) & wanted)
        spread = np.linspace(0, len(rows) - 1, STRETCHES[part.action][3] + 2)
        unseen = spread[1:-1].round().astype(int)
        unseen_rows.append(rows[unseen])
        known_rows.append(np.delete(rows, unseen))
    known, asked = (
        film(poses.take(np.concatenate(rows)), avatars, rig()) for rows in (known_rows, unseen_rows)
    )
    return known.take(np.linspace(0, len(known) - 1, KNOWN).round().astype(int)), asked


def joint_errors(
    known: Simulation, unseen: Simulation, numbers: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Return mean joint reprojection errors ``(Q, N)`` in px of answers ``(Q, N)`` in 128x48."""
    answers, truth = view_joints(known)[1], view_joints(unseen)[1]
    errors = [
        np.linalg.norm(answers[row] - joints, axis=-1).mean(axis=-1)
        for row, joints in zip(numbers, truth, strict=True)
    ]
    return np.stack(errors)


def nearest(
    known: NDArray[np.float32], asked: NDArray[np.float32], count: int
) -> NDArray[np.int64]:
    """Return rows ``(Q, count)`` of the nearest known vectors by exact Euclidean distance."""
    import faiss

    flat = faiss.IndexFlatL2(known.shape[1])
    flat.add(np.ascontiguousarray(known, np.float32))
    return np.asarray(flat.search(np.ascontiguousarray(asked, np.float32), count)[1])


def recognised(errors: NDArray[np.floating], n: int) -> float:
    """Return the percentage of queries with one of the ``n`` nearest under 5 px."""
    return 100 * float((errors[:, :n] < RIGHT_BELOW_PX).any(axis=1).mean())
