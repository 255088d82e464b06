"""Whether a body is cut: by the frame's border, or by another person in front of it.

A body that ends near the border may go on beyond it. The margin depends on how precisely the end is
known: to the pixel for a caller's mask, within a hundredth of the longer side for a silhouette,
within a twentieth for a box, and within three tenths of the body for landmarks.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.vision.blazepose import PoseReading
from app.vision.geometry import Box
from app.vision.people import COCO_NAMES, LANDMARK_NAMES, Landmarks, Silhouette, landmark_rows

# Chosen on even-numbered photographs, see docs/notes/history.md.
_SILHOUETTE_SHARE, _BOX_SHARE, _LANDMARKS_SHARE = 0.01, 0.05, 0.3


def gaps_to_border(box: Box, frame_shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Pixels between a box and the frame's left, upper, right and lower edge."""
    height, width = frame_shape[:2]
    return box.x + 0.5, box.y + 0.5, width - 0.5 - box.right, height - 0.5 - box.bottom


def ends_at_border(box: Box, frame_shape: tuple[int, ...]) -> bool:
    """Whether a person's box ends so near the frame's edge that it may cut them."""
    reach = _BOX_SHARE * max(box.width, box.height)
    return min(gaps_to_border(box, frame_shape)) <= reach


def may_have_left(box: Box, frame_shape: tuple[int, ...]) -> bool:
    """Whether a person last seen in a box may have left the frame.

    The lower edge cuts many who stand near the camera, and those who fall there stay.
    """
    left, top, right, _ = gaps_to_border(box, frame_shape)
    return min(left, top, right) <= _BOX_SHARE * max(box.width, box.height)


def extended_to_border(box: Box, frame_shape: tuple[int, ...]) -> Box:
    """A box within the frame, extended to the edges at which it may be cut."""
    height, width = frame_shape[:2]
    reach = _BOX_SHARE * max(box.width, box.height)
    edges = np.array([-0.5, -0.5, width - 0.5, height - 0.5])
    sides = np.array([box.x, box.y, box.right, box.bottom])
    near = np.array(gaps_to_border(box, frame_shape)) <= reach
    return Box.from_edges(*np.where(near, edges, sides).tolist())


def touches_border(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> bool:
    """Whether a silhouette runs along the frame's border."""
    crop = silhouette.crop
    is_exact = silhouette.segmenter == "mask"
    near = 0.0 if is_exact else max(1.0, _SILHOUETTE_SHARE * max(crop.shape))
    # The crop as seen from each edge; the first columns are nearest to it.
    views = (crop, crop.T, crop[:, ::-1], crop.T[:, ::-1])
    # A silhouette is cut if it touches an edge with more than this share of its extent along the
    # edge: a shoe that just reaches the last row is not cut.
    return any(
        gap <= near and view[:, : int(near - gap) + 1].any(axis=1).mean() > 0.1
        for gap, view in zip(gaps_to_border(silhouette.box, frame_shape), views, strict=True)
    )


_HEAD = [LANDMARK_NAMES.index("nose"), *landmark_rows("eye", "ear")]
_FEET = landmark_rows("ankle")
MIN_SEEN = 0.3
"""Visibility from which a landmark is seen."""


def end_beyond_border(box: Box, landmarks: Landmarks, frame_shape: tuple[int, ...]) -> bool:
    """Whether the frame cuts off a person's head or feet, so that its landmarks are not visible."""
    height, width = frame_shape[:2]
    end = np.array([width, height]) - 0.5
    inside = ((landmarks.positions > -0.5) & (landmarks.positions < end)).all(axis=1)
    seen = inside & (landmarks.visibility >= MIN_SEEN)
    is_whole = seen[_HEAD].any() and seen[_FEET].any()
    return ends_at_border(box, frame_shape) and not is_whole


MIN_VISIBLE_SCORE = 0.25
"""Score from which a keypoint of MoveNet is visible."""


# Landmarks that are no COCO keypoints, and the keypoint nearest along the body.
_NEAREST = {"mouth_left": "nose", "mouth_right": "nose"} | {
    f"{side}_{part}": f"{side}_{nearest}"
    for side in ("left", "right")
    for nearest, parts in (
        ("eye", ("eye_inner", "eye_outer")),
        ("wrist", ("pinky", "index", "thumb")),
        ("ankle", ("heel", "foot_index")),
    )
    for part in parts
}
_NEAREST_KEYPOINTS = [COCO_NAMES.index(_NEAREST.get(name, name)) for name in LANDMARK_NAMES]


def attenuate_visibility_at_border(reading: PoseReading, frame_shape: tuple[int, ...]) -> Landmarks:
    """Landmarks of a reading; near the frame's border no more visible than MoveNet's keypoints.

    If the border cuts off part of a body, the landmark network squeezes the whole body into the
    visible part and reports all of it as visible. MoveNet gives low scores to hidden keypoints.
    """
    landmarks = reading.landmarks
    if reading.keypoints is None:
        return landmarks
    reach = _LANDMARKS_SHARE * reading.body_px
    end = np.array([frame_shape[1], frame_shape[0]]) - 1
    near = ((landmarks.positions < reach) | (landmarks.positions > end - reach)).any(axis=1)
    scores = reading.keypoints.scores[_NEAREST_KEYPOINTS]
    factors = np.minimum(1.0, scores / MIN_VISIBLE_SCORE)
    visibility = np.where(near, factors * landmarks.visibility, landmarks.visibility)
    return replace(landmarks, visibility=visibility)


def with_truncation(
    silhouettes: Sequence[Silhouette | None],
    boxes: Sequence[Box],
    frame_shape: tuple[int, ...],
) -> list[Silhouette | None]:
    """The silhouettes of one frame with the flag ``truncated``; boxes stand in for missing ones."""
    people = [one or box for one, box in zip(silhouettes, boxes, strict=True)]
    result: list[Silhouette | None] = []
    for row, silhouette in enumerate(silhouettes):
        if silhouette is not None:
            others = people[:row] + people[row + 1 :]
            is_cut = touches_border(silhouette, frame_shape)
            is_cut = is_cut or hidden_by_others(silhouette, others)
            silhouette = replace(silhouette, truncated=is_cut)
        result.append(silhouette)
    return result


def hidden_by_others(silhouette: Silhouette, others: Sequence[Silhouette | Box]) -> bool:
    """Whether a nearer person, one whose feet are lower in the frame, covers part of this one."""
    box = silhouette.box
    for other in others:
        other_box = other.box if isinstance(other, Silhouette) else other
        if other_box.bottom <= box.bottom or box.intersection(other_box) == 0:
            continue
        if isinstance(other, Silhouette):
            covered = _pixels_inside(other, box)
        else:
            # Share of a box that a person without a silhouette fills.
            covered = 0.5 * box.intersection(other_box)
        # Share of a whole person's box that a nearer person may cover.
        if covered > 0.05 * box.area:
            return True
    return False


def _pixels_inside(silhouette: Silhouette, box: Box) -> float:
    left, top, right, bottom = box.pixels()
    rows = slice(max(0, top - silhouette.top), max(0, bottom - silhouette.top))
    columns = slice(max(0, left - silhouette.left), max(0, right - silhouette.left))
    return float(np.count_nonzero(silhouette.crop[rows, columns]))
