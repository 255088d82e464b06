"""People as differences from a picture of the empty scene; the figures are printed.

The street's empty scene is the median of its frames. Pedestrians of Penn-Fudan, whose outlines are
known, are pasted into it under another exposure. The cameras of pose2sim always show their subject:
the scene behind it is painted in.
"""

import argparse
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.background import cut_out_changed, foreground, upright_regions
from app.vision.geometry import Box
from scripts.datasets import (
    POSE2SIM_CAMERAS,
    Photograph,
    VideoFrame,
    as_array,
    read_frames,
    read_marks,
    read_pennfudan,
    read_pose2sim,
    read_vtest,
    tight_box,
)
from scripts.metrics import detection_figures, mask_iou, percent

Figures = dict[str, Any]
_PASTED_PX = (100, 200)  # Heights of the people who are pasted.


def run(options: argparse.Namespace) -> None:
    """Print all figures."""
    real = options.shared / "real"
    film = read_frames(real / "vtest" / "vtest.avi")
    scene = np.median([one for number, one in film if number % 16 == 0], axis=0).astype(np.uint8)
    photographs = read_pennfudan(real / "pennfudan")
    print("street", street(scene, dict(read_vtest(real / "vtest", len(read_marks())))))
    print("pasted", pasted(scene, photographs))
    for camera in POSE2SIM_CAMERAS:
        print(camera, joints_inside(read_pose2sim(real / "pose2sim", camera, 8)))


def street(scene: NDArray[np.uint8], frames: dict[int, NDArray[np.uint8]]) -> Figures:
    """Walkers found without a detector, and how their silhouettes' boxes fit the marked ones."""
    found, truths, fits = [], [], []
    for marks in read_marks():
        frame = frames[marks.frame]
        changed = foreground(frame, scene)
        regions = upright_regions(changed, 50)
        seen = [one for one in regions if not _is_ignored(one.box, marks.ignored)]
        found.append((as_array([one.box for one in seen]), np.array([one.score for one in seen])))
        truths.append(as_array(marks.people))
        for box, one in zip(marks.people, cut_out_changed(changed, marks.people), strict=True):
            fits.append(one.box.iou(box) if one else 0.0)
    figures = detection_figures(found, truths)
    return {
        "average_precision": round(figures["average_precision"], 3),
        "found": round(figures["highest_recall"], 3),
        "boxes_iou": round(float(np.mean(fits)), 3),
    }


def _is_ignored(box: Box, ignored: list[Box]) -> bool:
    return any(box.intersection(one) > 0.5 * box.area for one in ignored)


def pasted(scene: NDArray[np.uint8], photographs: list[Photograph]) -> Figures:
    """Overlap of the silhouettes of pasted people with the outlines by which they were cut out."""
    rng, overlaps = np.random.default_rng(0), []
    for photograph in photographs:
        for label, box in zip(np.unique(photograph.labels)[1:], photograph.boxes, strict=True):
            left, top, right, bottom = box.pixels()
            factor = rng.uniform(*_PASTED_PX) / box.height
            colours, cover = (
                cv2.resize(one, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
                for one in (
                    photograph.frame[top:bottom, left:right].astype(np.float32),
                    (photograph.labels[top:bottom, left:right] == label).astype(np.float32),
                )
            )
            row, column = rng.integers(np.array(scene.shape[:2]) - cover.shape).tolist()
            place = np.s_[row : row + cover.shape[0], column : column + cover.shape[1]]
            frame, person = scene.astype(np.float32), np.zeros(scene.shape[:2], bool)
            frame[place] += cover[..., None] * (colours - frame[place])
            person[place] = cover >= 0.5
            light = rng.uniform(0.85, 1.15) * frame + rng.uniform(-8, 8)
            noisy = np.clip(light + rng.normal(0, 3, light.shape), 0, 255).astype(np.uint8)
            jpeg = cv2.imencode(".jpg", noisy)[1]
            shown = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
            (one,) = cut_out_changed(foreground(shown, scene), [tight_box(person)])
            mask = np.zeros_like(person) if one is None else one.mask(person.shape)
            overlaps.append(mask_iou(mask, person))
    mean, median = float(np.mean(overlaps)), float(np.median(overlaps))
    return {"people": len(overlaps), "iou": round(mean, 3), "median": round(median, 3)}


def joints_inside(frames: list[VideoFrame]) -> Figures:
    """Limb joints within the silhouette, in the joints' own box."""
    inside, filled = [], []
    for one in frames:
        left, top, right, bottom = one.box.pixels()
        hidden = np.zeros(one.frame.shape[:2], np.uint8)
        hidden[top:bottom, left:right] = 255
        scene = np.asarray(cv2.inpaint(one.frame, hidden, 3, cv2.INPAINT_TELEA), np.uint8)
        (person,) = cut_out_changed(foreground(one.frame, scene), [one.box])
        mask = np.zeros(hidden.shape, bool) if person is None else person.mask(hidden.shape)
        last = np.array(hidden.shape[::-1]) - 1
        places = one.reference.joints_2d.round().astype(int).clip(0, last)
        inside.append(mask[places[:, 1], places[:, 0]].mean())
        filled.append(mask.sum() / one.box.area)
    return {"joints_inside": round(percent(inside)), "box_filled": round(percent(filled))}
