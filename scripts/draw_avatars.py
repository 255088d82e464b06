"""Draw the avatars of the index, dressed and in motion, from several cameras.

    python -m scripts.draw_avatars [--shared ../shared] [--out docs/avatars.png]

Each avatar in a pose of a clip of its own: shaded from three cameras, and as the silhouette of
the third.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from index.build.avatars import INDEX_AVATARS, make_avatars
from index.build.body import Avatar, pose_transforms, posed_points, retarget
from index.build.motion import read_manifest
from index.build.poses import Poses, read_poses
from index.build.render import render, skin
from index.skeleton import NATIVE, camera_rotation, project
from scripts.results import ROOT

VIEWS_DEG = ((15.0, 5.0), (75.0, 20.0), (160.0, 45.0))
"""Azimuth and elevation of the cameras."""
DISTANCE_M = 6.0
CELL_WIDTH, CELL_HEIGHT = 150, 220
PIXELS_PER_METRE = 100
COLUMNS = 9
SKIN = np.array([140.0, 170.0, 215.0])
CLOTH = np.array([165.0, 120.0, 90.0])


def shaded(
    avatar: Avatar, vertices: NDArray[np.float32], points: NDArray[np.float64], view: int
) -> NDArray[np.uint8]:
    """Draw a posed avatar with its skeleton, the nearest triangles last, ``(H, W, 3)``."""
    rotation = camera_rotation(*VIEWS_DEG[view])
    seen = vertices @ rotation.T
    middle = np.array([CELL_WIDTH, CELL_HEIGHT]) / 2
    plane = project(seen, DISTANCE_M) * PIXELS_PER_METRE + middle
    corners = seen[avatar.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    # Lit from the camera and from above, whichever way round a triangle is wound.
    light = 0.35 + 0.5 * np.abs(normals[:, 2]) + 0.15 * np.abs(normals[:, 1])
    base = np.where((np.arange(len(corners)) < avatar.closed)[:, None], SKIN, CLOTH)
    colours = np.clip(base * light[:, None], 0, 255)
    cell = np.full((CELL_HEIGHT, CELL_WIDTH, 3), 255, np.uint8)
    polygons = np.rint(plane[avatar.triangles] * 16).astype(np.int32)
    for triangle in np.argsort(-corners[:, :, 2].mean(axis=1)):
        cv2.fillConvexPoly(cell, polygons[triangle], colours[triangle].tolist(), shift=4)
    joints = project(points @ rotation.T, DISTANCE_M) * PIXELS_PER_METRE + middle
    for parent, child in NATIVE.bones:
        ends = np.rint(joints[[parent, child]]).astype(int).tolist()
        cv2.line(cell, ends[0], ends[1], (40, 40, 40), 1, cv2.LINE_AA)
    return cell


def silhouette(avatar: Avatar, vertices: NDArray[np.float32], view: int) -> NDArray[np.uint8]:
    """Draw what the index stores of a view: black on white, ``(H, W, 3)``."""
    normalised = np.empty((128, 48), np.uint8)
    rotation = camera_rotation(*VIEWS_DEG[view]).astype(np.float32)
    render(vertices, avatar.triangles, avatar.closed, rotation, DISTANCE_M, normalised)
    cell = np.full((CELL_HEIGHT, CELL_WIDTH, 3), 255, np.uint8)
    top, left = (CELL_HEIGHT - 128) // 2, (CELL_WIDTH - 48) // 2
    cell[top : top + 128, left : left + 48] = 255 * (1 - normalised[:, :, None])
    return cell


def column(avatar: Avatar, poses: Poses, row: int) -> NDArray[np.uint8]:
    """Draw one avatar: its name, the shaded views and a silhouette, above one another."""
    retargeting = retarget(poses.clips[poses.clip[row]], avatar)
    transforms = pose_transforms(avatar, retargeting, poses.rotations(np.array([row])))
    vertices = skin(
        avatar.vertices, avatar.influences, avatar.weights, transforms[0].astype(np.float32)
    )
    points = posed_points(avatar, transforms)[0]
    title = np.full((34, CELL_WIDTH, 3), 255, np.uint8)
    action = poses.actions[poses.action[row]]
    for line, text in enumerate((avatar.name, action)):
        place = (6, 14 + 14 * line)
        cv2.putText(title, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    views = [shaded(avatar, vertices, points, view) for view in range(len(VIEWS_DEG))]
    return np.vstack([title, *views, silhouette(avatar, vertices, len(VIEWS_DEG) - 1)])


def sheet(shared: Path) -> NDArray[np.uint8]:
    """All avatars, :data:`COLUMNS` in a row."""
    segments = read_manifest(shared / "mocap")
    avatars = make_avatars(INDEX_AVATARS, shared / "garments")
    chosen = [segments[i] for i in np.linspace(0, len(segments) - 1, len(avatars)).astype(int)]
    columns = []
    for avatar, segment in zip(avatars, chosen, strict=True):
        poses, _ = read_poses(shared / "mocap", [segment])
        columns.append(column(avatar, poses, len(poses) // 2))
    rows = [columns[start : start + COLUMNS] for start in range(0, len(columns), COLUMNS)]
    return np.vstack([np.hstack(row) for row in rows])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "avatars.png")
    options = parser.parse_args()
    cv2.imwrite(str(options.out), sheet(options.shared))


if __name__ == "__main__":
    main()
