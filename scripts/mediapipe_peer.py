"""Ask MediaPipe Pose about the photographs of ``evaluate people``, in an environment of its own.

    python3.11 -m venv /tmp/mediapipe && /tmp/mediapipe/bin/pip install mediapipe==0.10.21
    /tmp/mediapipe/bin/python scripts/mediapipe_peer.py --shared ../shared

It finds one person in a photograph. A person counts as on the ground if the trunk is tilted by more
than 50 degrees. This file imports nothing of the project.
"""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

NAMES = [
    f"{side}_{part}"
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
]
ROWS = (11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)
SHOULDERS, HIPS = (0, 1), (6, 7)
TILTED_DEG = 50.0


class Peer:
    """MediaPipe Pose as its documentation uses it for single images."""

    def __init__(self) -> None:
        pose = importlib.import_module("mediapipe").solutions.pose
        self._pose: Any = pose.Pose(static_image_mode=True, model_complexity=1)

    def joints(self, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Limb joints ``(12, 2)`` in pixels and ``(12, 3)`` in metres; None if none is found."""
        result = self._pose.process(np.ascontiguousarray(frame[..., ::-1]))
        if result.pose_landmarks is None:
            return None
        flat, world = result.pose_landmarks.landmark, result.pose_world_landmarks.landmark
        height, width = frame.shape[:2]
        places = np.array([[flat[i].x * width - 0.5, flat[i].y * height - 0.5] for i in ROWS])
        return places, np.array([[world[i].x, world[i].y, world[i].z] for i in ROWS])


def read(file: Path) -> np.ndarray:
    """Pixels of a photograph, BGR."""
    picture = cv2.imread(str(file))
    if picture is None:
        raise SystemExit(f"mediapipe_peer: expected a picture, cannot read {file}")
    return picture


def on_the_ground(places: np.ndarray) -> bool:
    """Whether the trunk is tilted far in the picture."""
    right, down = places[list(SHOULDERS)].mean(axis=0) - places[list(HIPS)].mean(axis=0)
    return bool(np.degrees(np.arctan2(abs(right), -down)) > TILTED_DEG)


def sport(peer: Peer, folder: Path) -> None:
    """Print the share of people found, and of limb joints within a fifth of the trunk."""
    document = json.loads((folder / "joints.json").read_text())
    order = [document["joint_names"].index(name) for name in NAMES]
    rows = []
    for one in document["people"]:
        joints = np.array(one["joints_2d"])[order]
        seen = np.array(one["visible"], bool)[order]
        answer = peer.joints(read(folder / one["image"]))
        trunk = max(np.linalg.norm(joints[0] - joints[7]), np.linalg.norm(joints[1] - joints[6]))
        right = 0.0
        if answer is not None:
            right = (np.linalg.norm(answer[0] - joints, axis=1)[seen] < 0.2 * trunk).mean()
        rows.append((abs(one["trunk_deg"]), answer is not None, right))
    table = np.array(rows, float)
    for kind, low, high in (("upright", 0, 45), ("horizontal", 45, 135), ("inverted", 135, 181)):
        some = table[(table[:, 0] >= low) & (table[:, 0] < high)]
        found, right = 100 * some[:, 1:].mean(axis=0)
        print(f"sport, {kind}: found {found:.1f} %, joints {right:.1f} %")


def falls(peer: Peer, folder: Path) -> None:
    """Print how often a person is on the ground, with a fall and without."""
    for kind in ("fall", "not-fall"):
        answers = [peer.joints(read(file)) for file in sorted((folder / kind).glob("*.jpg"))]
        found = 100 * np.mean([answer is not None for answer in answers])
        low = 100 * np.mean([answer is not None and on_the_ground(answer[0]) for answer in answers])
        print(f"{kind}: found {found:.1f} %, on the ground {low:.1f} %")


def leaning(peer: Peer, folder: Path) -> None:
    """Print the 3D error about the hips of the person before the calibrated cameras."""
    for camera in ("cam01", "cam03"):
        document = json.loads((folder / f"{camera}.json").read_text())
        names = [f"{n[0].upper()}{n.split('_')[1].capitalize()}" for n in NAMES]
        order = [document["joint_names"].index(name) for name in names]
        video, errors = cv2.VideoCapture(str(folder / document["video"])), []
        for number, truth in enumerate(np.array(document["joints_3d"])[:, order]):
            read, frame = video.read()
            answer = peer.joints(frame) if read and number % 4 == 0 else None
            if answer is not None:
                own, known = (
                    points - points[list(HIPS)].mean(axis=0) for points in (answer[1], truth)
                )
                errors.append(1000 * np.linalg.norm(own - known, axis=1).mean())
        print(f"{camera}: 3D {np.mean(errors):.0f} mm in {len(errors)} frames")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=Path("../shared"))
    real = parser.parse_args().shared / "real"
    peer = Peer()
    sport(peer, real / "lsp")
    falls(peer, real / "falls")
    leaning(peer, real / "pose2sim")


if __name__ == "__main__":
    main()
