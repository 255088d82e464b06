"""Run MediaPipe Pose on images, in an environment of its own.

    python3.11 -m venv /path/to/mediapipe-env  # It has wheels for CPython 3.9 to 3.12.
    /path/to/mediapipe-env/bin/pip install mediapipe==0.10.21

    /path/to/mediapipe-env/bin/python scripts/mediapipe_peer.py images.npz answers.npz
    /path/to/mediapipe-env/bin/python scripts/mediapipe_peer.py --again image.npy

``images.npz`` holds BGR images by name. ``answers.npz`` holds for every name: ``NAME/found``,
``NAME/milliseconds`` and, where somebody was found, ``NAME/mask`` (h, w) bool, ``NAME/points_2d``
(12, 2) in pixels and ``NAME/points_3d`` (12, 3) in metres about the hips (x right, y down,
z away).

``image.npy`` holds one BGR image. After ``ready``, for every line of standard input it is processed
again and answered with ``1`` if a person was found and ``0`` if not, which lets a benchmark time it
in turns with other work. This file imports nothing of the project.
"""

from __future__ import annotations

import importlib
import sys
import time
from typing import Any

import numpy as np

# Shoulders, elbows, wrists, hips, knees, ankles; left before right.
ROWS = (11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)


def make_pose() -> Any:
    """Set up MediaPipe Pose and run it once, since the first image takes longer."""
    pose = importlib.import_module("mediapipe").solutions.pose.Pose(
        static_image_mode=True, model_complexity=1, enable_segmentation=True
    )
    pose.process(np.zeros((256, 256, 3), np.uint8))
    return pose


def answer_all(source: str, target: str) -> None:
    """Answer about every image of a file."""
    pose = make_pose()
    answers: dict[str, Any] = {}
    with np.load(source, allow_pickle=False) as images:
        for name in images.files:
            image = np.ascontiguousarray(images[name][..., ::-1])
            height, width = image.shape[:2]
            started = time.perf_counter()
            result = pose.process(image)
            answers[f"{name}/milliseconds"] = 1000 * (time.perf_counter() - started)
            found = result.pose_landmarks is not None and result.segmentation_mask is not None
            answers[f"{name}/found"] = found
            if not found:
                continue
            flat, world = result.pose_landmarks.landmark, result.pose_world_landmarks.landmark
            answers[f"{name}/mask"] = result.segmentation_mask > 0.5
            answers[f"{name}/points_2d"] = np.array(
                [[flat[i].x * width - 0.5, flat[i].y * height - 0.5] for i in ROWS]
            )
            answers[f"{name}/points_3d"] = np.array(
                [[world[i].x, world[i].y, world[i].z] for i in ROWS]
            )
    np.savez_compressed(target, **answers)


def answer_again(source: str) -> None:
    """Process one image once for each line of standard input."""
    pose = make_pose()
    image = np.ascontiguousarray(np.load(source, allow_pickle=False)[..., ::-1])
    print("ready", flush=True)
    for _ in sys.stdin:
        print(int(pose.process(image).pose_landmarks is not None), flush=True)


def main() -> None:
    """Command line."""
    first, second = sys.argv[1:]
    if first == "--again":
        answer_again(second)
    else:
        answer_all(first, second)


if __name__ == "__main__":
    main()
