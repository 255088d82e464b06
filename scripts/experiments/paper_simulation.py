"""Rendering the data of the paper's experiments; needs the extra ``build`` and motion capture.

python -m scripts simulate-paper [--mocap FOLDER] [--out FILE]

"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.silhouette import HEIGHT, WIDTH, pack
from index.skeleton import POINTS, camera_rotation
from index.store import ENTRY_DTYPE, SKELETON_DTYPE
from scripts.experiments.paper_data import DATA, KNOWN, STEP, STRETCHES, write_paper_data
from scripts.index.body import Avatar, pose_transforms, posed_points, retarget
from scripts.index.builder import PAPER_AVATARS
from scripts.index.garments import make_avatars
from scripts.index.motion import Segment, read_manifest
from scripts.index.poses import Poses, read_poses
from scripts.index.render import render, skin
from scripts.index.simulate import Simulation
from scripts.index.views import VIEW_DTYPE
from scripts.index.writer import compress
from scripts.results import SHARED

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


def simulate(motion: Path) -> tuple[Simulation, Simulation]:
    """Simulate the 2,925 known and the 608 unseen silhouettes from a folder of motion capture."""
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Render the data of the paper's experiments.")
    parser.add_argument("--mocap", type=Path, default=SHARED / "mocap")
    parser.add_argument("--out", type=Path, default=DATA)
    options = parser.parse_args(arguments)
    write_paper_data(*simulate(options.mocap), options.out)
