"""Pictures of what was found: the overlay and the label image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from app.estimates import Estimate, Scene
from index.skeleton import KeypointSet

COLOURS = ((66, 165, 255), (80, 220, 100), (255, 120, 80), (230, 110, 230), (90, 230, 240))
"""Of people, BGR; bright enough for night scenes, dark enough for snow."""

SIDES = {"left": (60, 138, 255), "right": (255, 157, 60), "middle": (184, 179, 159)}
"""Of limbs, BGR: the person's own left orange, right blue; as the debug page draws them."""


def draw_overlay(estimate: Estimate, keypoints: KeypointSet) -> NDArray[np.uint8]:
    """Draw the frame with boxes, outlines of silhouettes and the best skeletons.

    Parameters
    ----------
    estimate : Estimate
    keypoints : KeypointSet
        What to draw of the skeletons.

    Returns
    -------
    (H, W, 3) uint8 array
        BGR, a copy.
    """
    picture = estimate.frame.copy()
    line = max(1, round(max(picture.shape[:2]) / 500))
    for number, person in enumerate(estimate.persons):
        colour = COLOURS[number % len(COLOURS)]
        box = person.found.box
        corners = np.round([box.x, box.y, box.x + box.width, box.y + box.height]).astype(int)
        cv2.rectangle(picture, corners[:2].tolist(), corners[2:].tolist(), colour, line)
        silhouette = person.found.silhouette
        if silhouette is not None:
            outlines, _ = cv2.findContours(
                silhouette.crop.astype(np.uint8),
                cv2.RETR_EXTERNAL,
                cv2.CHAIN_APPROX_NONE,
                offset=(silhouette.left, silhouette.top),
            )
            cv2.drawContours(picture, outlines, -1, (255, 255, 255), line)
        if person.hypotheses:
            points = person.hypotheses[0].points_2d[list(keypoints.indices)]
            draw_skeleton(picture, points, keypoints, line + 1)
    return picture


def draw_labels(scene: Scene) -> NDArray[np.uint8]:
    """Draw the label image ``(H, W)`` uint8: 0 background, k = the k-th person, counted from 1."""
    labels = np.zeros(scene.frame.shape[:2], np.uint8)
    for label, found in enumerate(scene.people, start=1):
        if found.silhouette is not None:
            labels[found.silhouette.mask(labels.shape)] = label
    return labels


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Encode grey or BGR pixels as PNG."""
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise ValueError(f"expected a picture to encode, got an array of shape {picture.shape}")
    return data.tobytes()


def draw_skeleton(
    picture: NDArray[np.uint8],
    points: NDArray[np.float64],
    keypoints: KeypointSet,
    line: int,
) -> None:
    """Draw bones into a BGR picture, with a dark seam; points that are not finite are left out.

    Left and right have the colours of :data:`SIDES`.

    Parameters
    ----------
    picture : (H, W, 3) uint8 array
        Changed.
    points : (K, 2) float64 array
        Pixels, in the order of ``keypoints``.
    keypoints : KeypointSet
    line : int
        Pixels.
    """
    # Four binary digits behind the point: OpenCV draws between pixels.
    fixed = np.round(np.nan_to_num(points) * 16).astype(int)
    drawable = [bool(np.isfinite(point).all()) for point in points]
    for seam in (2, 0):
        for parent, child in keypoints.bones:
            if drawable[parent] and drawable[child]:
                ends = fixed[parent].tolist(), fixed[child].tolist()
                colour = (0, 0, 0) if seam else SIDES[_side(keypoints, parent, child)]
                cv2.line(picture, *ends, colour, line + seam, cv2.LINE_AA, 4)


def _side(keypoints: KeypointSet, *points: int) -> str:
    """``left`` or ``right`` where that is where a bone ends, else ``middle``."""
    sides = {keypoints.names[point].split("_")[0] for point in points} & {"left", "right"}
    return sides.pop() if len(sides) == 1 else "middle"
