"""How well silhouettes are redrawn: overlap with the street masks, limbs of the balancing person.

    python -m scripts.refinement.measure [--odd] [--network FILE]

Settings may be looked at on even-numbered photographs; the odd ones, and the balancing person,
are for the final figure.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.networks import Networks
from app.vision.people import Box
from app.vision.refine import WEIGHTS_PATH, Refiner
from app.vision.segment import NetworkSegmenter, Segmenter
from scripts.experiments.real_data import Photograph, read_pennfudan, read_pose2sim
from scripts.experiments.real_options import read_options
from scripts.experiments.real_silhouettes import in_true_boxes, overlap

CAMERAS = ("cam01", "cam03")
LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
SLACK = 0.03
"""How far beyond the silhouette a joint may lie, in heights of the person's box."""


def covered(
    silhouette: NDArray[np.bool_], joints: NDArray[np.float64], slack_px: float
) -> NDArray[np.bool_]:
    """Whether joints ``(J, 2)`` in pixels lie in a silhouette or near it; not beyond the frame."""
    distance = cv2.distanceTransform((~silhouette).astype(np.uint8), cv2.DIST_L2, 5)
    height, width = silhouette.shape
    found = np.zeros(len(joints), bool)
    for number, (x, y) in enumerate(joints):
        if np.isfinite((x, y)).all() and -0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5:
            found[number] = distance[round(float(y)), round(float(x))] <= slack_px
    return found


def limbs_covered(folder: Path, segmenter: Segmenter, step: int) -> dict[str, float]:
    """Share of frames in which each limb joint, nose and head of ``pose2sim`` are covered."""
    shares: dict[str, list[bool]] = {}
    for camera in CAMERAS:
        document = json.loads((folder / f"{camera}.json").read_text())
        names: Sequence[str] = document["joint_names"]
        joints = np.array(document["joints_2d"], np.float64)
        wanted = [n for n in names if n in ("Head", "Nose") or n.endswith(LIMBS)]
        for frame in read_pose2sim(folder, camera, step):
            places = joints[int(frame.name.split("/")[1])][[names.index(n) for n in wanted]]
            mask = _mask(segmenter, frame.frame, frame.box)
            for name, share in zip(
                wanted, covered(mask, places, SLACK * frame.box.height), strict=True
            ):
                shares.setdefault(name.lstrip("LR") or name, []).append(bool(share))
    figures = {name.lower(): float(np.mean(found)) for name, found in shares.items()}
    figures["all"] = float(np.mean([one for found in shares.values() for one in found]))
    return figures


def cut_by_the_frame(
    photographs: Sequence[Photograph], segmenter: Segmenter
) -> dict[str, list[float]]:
    """Overlap where the frame ends, or begins, in the middle of each person."""
    found: dict[str, list[float]] = {"legs cut off": [], "head cut off": []}
    for photograph in photographs:
        for label, box in enumerate(photograph.boxes, start=1):
            middle = round(box.y + box.height / 2)
            truth = photograph.labels == label
            for name, rows in zip(found, (slice(middle), slice(middle, None)), strict=True):
                frame = np.ascontiguousarray(photograph.frame[rows])
                above = rows.start or 0
                moved = Box(box.x, box.y - above, box.width, box.height)
                part = moved.clip(frame.shape[1], len(frame))
                assert part is not None
                found[name].append(overlap(_mask(segmenter, frame, part), truth[rows]))
    return found


def _mask(segmenter: Segmenter, frame: NDArray[np.uint8], box: Box) -> NDArray[np.bool_]:
    one = segmenter.segment(frame, [box])[0]
    return np.zeros(frame.shape[:2], bool) if one is None else one.mask(frame.shape)


def main() -> None:
    """Command line."""
    options = read_options(__doc__, WEIGHTS_PATH)
    cv2.setNumThreads(1)
    folder = options.shared / "real"
    segmenter = NetworkSegmenter(Networks.load(options.models), Refiner(options.network))
    photographs = [one for one in read_pennfudan(folder / "pennfudan") if one.odd == options.odd]
    street = in_true_boxes(photographs, segmenter)
    found = {"street": {key: street[key] for key in ("people", "mean", "median", "milliseconds")}}
    for name, overlaps in cut_by_the_frame(photographs, segmenter).items():
        found[name] = {"mean": float(np.mean(overlaps)), "median": float(np.median(overlaps))}
    if options.odd:
        found["limbs covered"] = limbs_covered(folder / "pose2sim", segmenter, options.step)
    for name, one in found.items():
        print(f"{name}:", ", ".join(f"{key} {value:.4g}" for key, value in one.items()))


if __name__ == "__main__":
    main()
