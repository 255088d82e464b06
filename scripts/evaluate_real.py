"""Measure detection and silhouettes on real photographs; fit the detector's few weights.

    python scripts/evaluate_real.py detect     cross-validated average precision, by image
    python scripts/evaluate_real.py fit        the weights and calibration to put in detect.py
    python scripts/evaluate_real.py segment    silhouette overlap in true boxes and end to end
    python scripts/evaluate_real.py vtest      people per frame in the street video

Average precision counts every detection that overlaps no *labelled* person by half as wrong.
Penn-Fudan leaves some visible people unlabelled, so the figures are on the low side.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from app.vision import detect as detection  # noqa: E402
from app.vision.box_arrays import Boxes, iou_matrix  # noqa: E402
from app.vision.decode import decode_image, decode_mask  # noqa: E402
from app.vision.evidence import NAMES  # noqa: E402
from app.vision.grabcut import GrabCutSegmenter  # noqa: E402
from app.vision.network import PersonNetwork  # noqa: E402
from app.vision.people import Box  # noqa: E402
from app.vision.segment import NetworkSegmenter, Segmenter  # noqa: E402

MAX_PIXELS = 50_000_000
MIN_PERSON_PX = 50
FOLDS = 5

Scored = tuple[Boxes, NDArray[np.float64]]


@dataclass(frozen=True)
class Photograph:
    """A street photograph with its true label image."""

    name: str
    frame: NDArray[np.uint8]
    labels: NDArray[np.uint16]

    @property
    def boxes(self) -> list[Box]:
        """Tight boxes of the labelled people, by label."""
        return [tight_box(self.labels == k) for k in range(1, int(self.labels.max()) + 1)]


def tight_box(mask: NDArray[np.bool_]) -> Box:
    """Smallest box around the pixels of a mask."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return Box(x - 0.5, y - 0.5, width, height)


def read_pennfudan(folder: Path) -> list[Photograph]:
    """Read all photographs with masks in a folder."""
    photographs = []
    for path in sorted(folder.glob("*.jpg")):
        mask_path = path.with_name(f"{path.stem}_mask.png")
        frame = decode_image(path.read_bytes(), max_pixels=MAX_PIXELS)
        labels = decode_mask(mask_path.read_bytes(), max_pixels=MAX_PIXELS)
        photographs.append(Photograph(path.stem, frame, labels))
    if not photographs:
        raise SystemExit(f"expected photographs in {folder}, found none")
    return photographs


def as_array(boxes: Sequence[Box]) -> Boxes:
    """Boxes as an ``(N, 4)`` array."""
    return np.array([[b.x, b.y, b.width, b.height] for b in boxes], np.float64).reshape(-1, 4)


def matches(found: Sequence[Scored], truths: Sequence[Boxes]) -> NDArray[np.float64]:
    """Score and rightness of every detection, best first, ``(N, 2)``.

    A detection is right if it overlaps a labelled person that no better one took by half.
    """
    rows = []
    for (boxes, scores), truth in zip(found, truths, strict=True):
        free = np.ones(len(truth), bool)
        overlaps = iou_matrix(boxes, truth) if len(truth) else np.zeros((len(boxes), 0))
        for index in np.argsort(-scores):
            reachable = np.where(free, overlaps[index], 0)
            right = bool(reachable.size) and reachable.max() >= 0.5
            if right:
                free[reachable.argmax()] = False
            rows.append((scores[index], float(right)))
    table = np.array(rows, np.float64).reshape(-1, 2)
    return table[np.argsort(-table[:, 0], kind="stable")]


def average_precision(table: NDArray[np.float64], people: int) -> float:
    """Area under the precision-recall curve (all points, monotone envelope)."""
    hits = np.cumsum(table[:, 1])
    precision = hits / np.arange(1, len(table) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(np.concatenate([[0], hits / people])) * envelope).sum())


def describe_detection(name: str, found: Sequence[Scored], truths: Sequence[Boxes]) -> None:
    """Print average precision, and recall and precision at a score of 0.5."""
    people = sum(map(len, truths))
    table = matches(found, truths)
    sure = table[table[:, 0] >= 0.5]
    recall, precision = sure[:, 1].sum() / people, sure[:, 1].mean()
    print(
        f"{name}: AP {average_precision(table, people):.3f}, at score 0.5 recall {recall:.3f} "
        f"precision {precision:.3f}, highest recall {table[:, 1].sum() / people:.3f}"
    )


def fit_logistic(
    features: NDArray[np.float64], right: NDArray[np.bool_], ridge: float = 3.0
) -> tuple[NDArray[np.float64], float]:
    """Weights and offset of a ridge logistic regression, by Newton's method.

    The ridge acts on standardised features and not on the offset.
    """
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-9
    design = np.hstack([(features - mean) / spread, np.ones((len(features), 1))])
    penalty = np.diag([ridge] * features.shape[1] + [0.0])
    weights = np.zeros(design.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(design @ weights, -30, 30)))
        gradient = design.T @ (p - right) + penalty @ weights
        hessian = design.T @ (design * (p * (1 - p))[:, None]) + penalty
        weights -= np.linalg.solve(hessian, gradient)
    scaled = weights[:-1] / spread
    return scaled, float(weights[-1] - scaled @ mean)


@dataclass(frozen=True)
class Candidates:
    """Candidate boxes of one photograph, their features and their overlap with the truth."""

    boxes: Boxes
    features: NDArray[np.float64]
    overlap: NDArray[np.float64]


def all_candidates(photographs: Sequence[Photograph], network: PersonNetwork) -> list[Candidates]:
    """Candidates of every photograph."""
    result = []
    for photograph in photographs:
        boxes, features = detection.candidates(network, photograph.frame, MIN_PERSON_PX)
        overlap = iou_matrix(boxes, as_array(photograph.boxes)).max(axis=1, initial=0)
        result.append(Candidates(boxes, features, overlap))
    return result


def fitted(people: Sequence[Candidates]) -> tuple[NDArray[np.float64], float]:
    """Weights that tell candidates that are right by a margin from those that are wrong.

    What overlaps by a little over half counts as neither: it would teach to be content with
    a box that the merging can still improve.
    """
    features = np.vstack([one.features for one in people])
    overlap = np.concatenate([one.overlap for one in people])
    clear = (overlap > 0.65) | (overlap < 0.5)
    return fit_logistic(features[clear], overlap[clear] > 0.65)


def merged(one: Candidates, weights: NDArray[np.float64], offset: float) -> Scored:
    """Merge candidates into detections, with log odds for scores."""
    odds = one.features @ weights + offset
    boxes, kept = detection.merge(one.boxes, odds)
    return boxes, odds[kept]


def cross_validated(people: Sequence[Candidates], seed: int) -> list[Scored]:
    """Detect in every photograph by weights fitted without it."""
    fold = np.random.default_rng(seed).permutation(len(people)) % FOLDS
    found: list[Scored] = [(np.zeros((0, 4)), np.zeros(0))] * len(people)
    for held in range(FOLDS):
        model = fitted([one for one, f in zip(people, fold, strict=True) if f != held])
        for index in np.flatnonzero(fold == held).tolist():
            found[index] = merged(people[index], *model)
    return found


def calibration(found: Sequence[Scored], truths: Sequence[Boxes]) -> tuple[float, float]:
    """Slope and offset that turn log odds of merged detections into probabilities."""
    table = matches(found, truths)
    slope, offset = fit_logistic(table[:, :1], table[:, 1] > 0.5, ridge=0.01)
    return float(slope[0]), offset


def as_probabilities(found: Sequence[Scored], slope: float, offset: float) -> list[Scored]:
    """Apply a calibration to log odds."""
    return [(boxes, 1 / (1 + np.exp(-slope * odds - offset))) for boxes, odds in found]


def run_detect(photographs: Sequence[Photograph], network: PersonNetwork) -> None:
    """Print cross-validated and plain figures of both detectors."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    best = np.concatenate(
        [
            iou_matrix(one.boxes, truth).max(axis=0, initial=0)
            for one, truth in zip(people, truths, strict=True)
        ]
    )
    print(f"candidates reach {(best >= 0.5).mean():.3f} of the people")
    for seed in range(3):
        odds = cross_validated(people, seed)
        found = as_probabilities(odds, *calibration(odds, truths))
        describe_detection(f"cascade, cross-validated by image, split {seed}", found, truths)
    detectors: dict[str, detection.Detector] = {
        "cascade as shipped (fitted to these photographs)": detection.CascadeDetector(
            network, min_score=0.0
        ),
        "gradients alone": detection.HogDetector(min_score=0.0),
    }
    for name, detector in detectors.items():
        start = time.perf_counter()
        found = []
        for photograph in photographs:
            people_found = detector.detect(photograph.frame)
            scores = np.array([one.score for one in people_found])
            found.append((as_array([one.box for one in people_found]), scores))
        each = (time.perf_counter() - start) / len(photographs) * 1000
        describe_detection(name, found, truths)
        print(f"    {each:.0f} ms a photograph")


def run_fit(photographs: Sequence[Photograph], network: PersonNetwork) -> None:
    """Print what belongs into detect.py."""
    truths = [as_array(photograph.boxes) for photograph in photographs]
    people = all_candidates(photographs, network)
    weights, offset = fitted(people)
    slopes = [calibration(cross_validated(people, seed), truths) for seed in range(5)]
    slope, shift = np.mean(slopes, axis=0)
    print("_WEIGHTS = np.array([")
    for name, weight in zip(NAMES, weights, strict=True):
        print(f"    {weight:.3f},  # {name}")
    print(f"])\n_OFFSET = {offset:.3f}")
    print(f"_CALIBRATION_SLOPE, _CALIBRATION_OFFSET = {slope:.3f}, {shift:.3f}")
    alone = [detection.gradient_detections(one.frame, MIN_PERSON_PX) for one in photographs]
    slope, shift = calibration(alone, truths)
    print(f"_HOG_SLOPE, _HOG_OFFSET = {slope:.3f}, {shift:.3f}")


def overlap(mask: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks."""
    return float((mask & truth).sum() / max(1, int((mask | truth).sum())))


def run_segment(photographs: Sequence[Photograph], network: PersonNetwork) -> None:
    """Print silhouette overlaps in true boxes, for odd and even photographs, and end to end."""
    segmenters: list[Segmenter] = [NetworkSegmenter(network), GrabCutSegmenter()]
    for segmenter in segmenters:
        values, odd, spent = [], [], 0.0
        for index, photograph in enumerate(photographs):
            start = time.perf_counter()
            silhouettes = segmenter.segment(photograph.frame, photograph.boxes)
            spent += time.perf_counter() - start
            for label, one in enumerate(silhouettes, start=1):
                truth = photograph.labels == label
                values.append(0.0 if one is None else overlap(one.mask(truth.shape), truth))
                odd.append(index % 2 == 1)
        print(f"{segmenter.name} in true boxes: {spent / len(values) * 1000:.1f} ms a person")
        every, odd_mask = np.array(values), np.array(odd)
        for name, chosen in (
            ("all", np.ones(len(every), bool)), ("odd", odd_mask), ("even", ~odd_mask)
        ):  # fmt: skip
            part = every[chosen]
            print(f"    {name}: IoU mean {part.mean():.3f} median {np.median(part):.3f}")
    detector = detection.CascadeDetector(network)
    values = []
    for photograph in photographs:
        boxes = [one.box for one in detector.detect(photograph.frame)]
        silhouettes = segmenters[0].segment(photograph.frame, boxes)
        masks = [one.mask(photograph.labels.shape) for one in silhouettes if one is not None]
        for label in range(1, int(photograph.labels.max()) + 1):
            truth = photograph.labels == label
            values.append(max((overlap(mask, truth) for mask in masks), default=0.0))
    print(
        f"network end to end, best silhouette for each labelled person (0 if missed): "
        f"IoU mean {np.mean(values):.3f} median {np.median(values):.3f}"
    )


def run_vtest(video: Path, network: PersonNetwork, frames: int = 20) -> None:
    """Print people found and time spent in evenly chosen frames."""
    capture = cv2.VideoCapture(str(video))
    total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    detector = detection.CascadeDetector(network)
    counts, spent = [], 0.0
    for index in np.linspace(0, total - 1, frames).astype(int):
        capture.set(cv2.CAP_PROP_POS_FRAMES, float(index))
        ok, frame = capture.read()
        if not ok:
            continue
        start = time.perf_counter()
        counts.append(len(detector.detect(frame.astype(np.uint8, copy=False))))
        spent += time.perf_counter() - start
    print(f"people per frame: {counts}, least {min(counts)}, mean {np.mean(counts):.1f}")
    print(f"{spent / len(counts) * 1000:.0f} ms a frame of 768x576")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=("detect", "fit", "segment", "vtest"))
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument(
        "--model", type=Path, default=ROOT / "models" / "selfie_segmentation.tflite"
    )
    parser.add_argument("--threads", type=int, default=1, help="of OpenCV")
    options = parser.parse_args()
    cv2.setNumThreads(options.threads)
    network = PersonNetwork(options.model)
    if options.what == "vtest":
        run_vtest(options.shared / "real" / "vtest" / "vtest.avi", network)
        return
    photographs = read_pennfudan(options.shared / "real" / "pennfudan")
    {"detect": run_detect, "fit": run_fit, "segment": run_segment}[options.what](
        photographs, network
    )


if __name__ == "__main__":
    main()
