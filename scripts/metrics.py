"""Metrics of detections and of confidences.

Average precision counts every detection that overlaps no *labelled* person by half as wrong.
Penn-Fudan leaves some visible people unlabelled, so the figures are on the low side.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.vision.geometry import Boxes, iou_matrix

Scored = tuple[Boxes, NDArray[np.float64]]
"""Detections of one photograph, and a score or features of each."""

FOUND_FROM = 0.5
"""Minimum overlap (IoU) at which a labelled person counts as found."""


def percent(values: ArrayLike) -> float:
    """Return the mean in percent."""
    return 100 * float(np.mean(np.asarray(values, np.float64)))


def detection_figures(found: Sequence[Scored], truths: Sequence[Boxes]) -> dict[str, float]:
    """Return average precision, recall at a precision of 0.9, and both at a score of 0.5."""
    people = sum(map(len, truths))
    table = matches(found, truths)
    hits = np.cumsum(table[:, 1])
    precise = hits / np.arange(1, len(table) + 1) >= 0.9
    sure = table[table[:, 0] >= 0.5]
    return {
        "people": people,
        "average_precision": average_precision(table, people),
        "recall_at_90": float(hits[precise].max(initial=0) / people),
        "recall": float(sure[:, 1].sum() / people),
        "precision": float(sure[:, 1].mean()) if len(sure) else 0.0,
        "highest_recall": float(table[:, 1].sum() / people),
    }


def matches(found: Sequence[Scored], truths: Sequence[Boxes]) -> NDArray[np.float64]:
    """Return score of every detection and whether it is right, best first, ``(N, 2)``.

    A detection is right if it overlaps, by half, a labelled person that no better one took.
    """
    rows = [
        np.stack([one[1], true_positives(one, truth)], axis=1)
        for one, truth in zip(found, truths, strict=True)
    ]
    table = np.concatenate([np.zeros((0, 2)), *rows])
    return table[np.argsort(-table[:, 0], kind="stable")]


def true_positives(found: Scored, truth: Boxes) -> NDArray[np.bool_]:
    """Return which detections of a photograph are right ``(N,)``; see :func:`matches`."""
    boxes, scores = found
    right, free = np.zeros(len(boxes), bool), np.ones(len(truth), bool)
    overlaps = iou_matrix(boxes, truth) if len(truth) else np.zeros((len(boxes), 0))
    for index in np.argsort(-scores):
        reachable = np.where(free, overlaps[index], 0)
        if reachable.size and reachable.max() >= FOUND_FROM:
            right[index] = True
            free[reachable.argmax()] = False
    return right


def average_precision(table: NDArray[np.float64], people: int) -> float:
    """Return the area under the precision-recall curve (all points, monotone envelope)."""
    hits = np.cumsum(table[:, 1])
    precision = hits / np.arange(1, len(table) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(np.concatenate([[0], hits / people])) * envelope).sum())


def mask_iou(mask: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Return the intersection over union of two masks."""
    return float((mask & truth).sum() / max(1, int((mask | truth).sum())))


def confusion(
    size: int, truth: NDArray[np.integer], answer: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Count ``(size, size)`` answers: truth in rows, answers in columns."""
    counts = np.zeros((size, size), np.int64)
    np.add.at(counts, (truth, answer), 1)
    return counts


def reliability(
    confidence: NDArray[np.floating], right: NDArray[np.bool_], bins: int
) -> list[dict[str, float]]:
    """Return confidences stated and met in bins of equal width, without empty ones."""
    bin_of = np.minimum((confidence * bins).astype(int), bins - 1)
    return [
        {
            "from": b / bins,
            "to": (b + 1) / bins,
            "hypotheses": int((bin_of == b).sum()),
            "stated": float(confidence[bin_of == b].mean()),
            "right": float(right[bin_of == b].mean()),
        }
        for b in np.unique(bin_of).tolist()
    ]
