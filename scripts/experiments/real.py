"""The real experiment: street photographs and videos of ``../shared/real``.

The detector's weights are cross-validated by photograph. Settings of silhouettes and poses were
tuned on even-numbered photographs, so that the odd ones, always shown beside all, are their test.
The references of poses are MediaPipe's (street people) and a multi-view triangulation
(``pose2sim``): something to compare with, not ground truth.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.estimation.estimator import Estimator
from app.serving.loading import load_estimator
from app.settings import Settings
from app.vision.detector import Detector, NetworkDetector
from app.vision.parameters import DEFAULTS
from index import DEFAULT_PATH
from index.build.calibrate import expected_calibration_error
from scripts.experiments.real_data import (
    read_pennfudan,
    read_pose2sim,
    read_street_people,
    read_vtest,
)
from scripts.experiments.real_detection import all_candidates, measure_detection
from scripts.experiments.real_detection_scores import FOUND_FROM
from scripts.experiments.real_lying import measure_lying
from scripts.experiments.real_poses import (
    BOTH,
    LIMBS_RIGHT_BELOW_PX,
    WAYS,
    Trial,
    Way,
    cross_validated,
    figures,
    in_photographs,
    in_video,
    observed_pck,
    trials_of,
)
from scripts.experiments.real_silhouettes import in_true_boxes
from scripts.experiments.real_vtest import measure_vtest, read_marks
from scripts.experiments.report import plot_reliability, reliability, table, write
from scripts.results import machine

COMMAND = "python -m scripts.evaluate real"
CAMERAS = ("cam01", "cam03")
VTEST_FRAMES = 20
SCORES = (DEFAULTS.detector.min_score, 0.5)
"""Detection scores from which a box is reported (the service's default) or sure."""

Figures = dict[str, float]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="index artefact to ask")
    parser.add_argument("--step", type=int, default=4, help="every so many-th frame of pose2sim")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks."""
    cv2.setNumThreads(1)
    estimator = load_estimator(Settings(index=options.index))
    detector = estimator.detector
    assert isinstance(detector, NetworkDetector)
    folder = options.shared / "real"
    photographs = read_pennfudan(folder / "pennfudan")
    people = read_street_people(folder / "pennfudan", photographs)
    candidates = all_candidates(photographs, detector)
    results: dict[str, Any] = {"machine": machine()}
    results["detection"] = measure_detection(photographs, candidates)
    results["lying"] = measure_lying(photographs, estimator)
    results["silhouettes"] = in_true_boxes(photographs, estimator)
    asked = in_photographs(people, estimator)
    street = {way: trials_of(asked, estimator, way) for way in WAYS}
    results["street"] = street_figures(street)
    results["observed"] = observed_pck(people, estimator)
    videos, results["pose2sim"] = pose2sim(folder, estimator, options.step)
    results["vtest"] = vtest(folder, detector)
    own = cross_validated(street[BOTH])
    results["confidence"] = {
        "street people": stated_and_met(own),
        "street people, odd": stated_and_met([trial for trial in own if trial.odd]),
        "pose2sim": stated_and_met(videos),
    }
    write(options.out, "real", COMMAND, report(results), results)
    curves = {name: one["bins"] for name, one in results["confidence"].items()}
    plot_reliability(curves, options.out / "real-reliability.png")


def stated_and_met(trials: Sequence[Trial]) -> dict[str, Any]:
    """Expected calibration error of all hypotheses, and their confidences in five bins."""
    confidence = np.concatenate([trial.confidence for trial in trials])
    right = np.concatenate([trial.right for trial in trials])
    return {
        "ece": expected_calibration_error(confidence, right),
        "bins": reliability(confidence, right, 5),
    }


def street_figures(street: Mapping[Way, list[Trial]]) -> dict[str, dict[str, Figures]]:
    """Figures of all street people and of those in odd photographs."""
    return {
        name: {"all": figures(trials), "odd": figures([t for t in trials if t.odd])}
        for name, trials in street.items()
    }


def pose2sim(
    folder: Path, estimator: Estimator, step: int
) -> tuple[list[Trial], dict[str, dict[str, Figures]]]:
    """Trials in the true boxes of both cameras, and the figures of each way to answer."""
    together: list[Trial] = []
    found: dict[str, dict[str, Figures]] = {}
    for camera in CAMERAS:
        frames = read_pose2sim(folder / "pose2sim", camera, step)
        asked = in_video(frames, estimator)
        trials = {way: trials_of(asked, estimator, way) for way in WAYS}
        together += trials[BOTH]
        found[camera] = {
            way: {**figures(some), "frames": len(frames)} for way, some in trials.items()
        }
    return together, found


def vtest(folder: Path, detector: Detector) -> dict[str, Figures]:
    """People found in the street video, at each of :data:`SCORES`."""
    frames = read_vtest(folder / "vtest", VTEST_FRAMES)
    return {f"{score:g}": measure_vtest(frames, read_marks(), detector, score) for score in SCORES}


def report(results: dict[str, Any]) -> list[str]:
    """The paragraphs of the page."""
    return [
        "Real photographs and videos",
        f"On {results['machine']}, one thread. What is fitted of the detector is cross-validated "
        "by photograph. *Odd*: the odd-numbered ones, on which no setting of silhouettes or poses "
        "was tuned. Times are of a machine that did other work as well.",
        "## Detection",
        *_detection(results["detection"]),
        *_lying(results["lying"]),
        "## Silhouettes",
        *_silhouettes(results["silhouettes"]),
        "## Street people",
        *_street(results["street"], results["observed"]),
        "## A balancing person, two cameras",
        "Mean distance of the 12 limb joints, hips on hips, in true boxes.",
        table(
            ["camera", "poses from", "frames answered", "first (mm)", "best of 7 (mm)", "PCK"],
            [[camera, name, f"{one['people']} of {one['frames']}",
              *(_or_dash(one, key, ".0f") for key in ("first_mm", "best_mm", "pck"))]
             for camera, rows in results["pose2sim"].items() for name, one in rows.items()],
        ),
        "## Walkers in a street video",
        *_vtest(results["vtest"]),
        "## Confidence",
        *_confidence(results["confidence"]),
    ]  # fmt: skip


def _or_dash(figures: Figures, key: str, form: str) -> str:
    return format(figures[key], form) if key in figures else "-"


def _detection(found: dict[str, Figures]) -> list[str]:
    people = next(iter(found.values()))["people"]
    keys = ("average_precision", "recall_at_90", "recall", "precision", "highest_recall")
    return [
        f"Penn-Fudan, {people:.0f} labelled people in 74 photographs; a box is right from an "
        "overlap (IoU) of 0.5. People left unlabelled count as false: of the 24 surest false "
        "boxes all show somebody. Recall and precision: at a detection score of 0.5.",
        table(
            ["detector", "AP", "recall at a precision of 0.9", "recall", "precision",
             "recall at any score", "ms a photograph"],
            [[name, *(_or_dash(one, key, ".3f") for key in keys), f"{one['milliseconds']:.0f}"]
             for name, one in found.items()],
        ),
    ]  # fmt: skip


def _lying(found: Figures) -> list[str]:
    return [
        f"People who lie: the {found['photographs']} photographs turned by a quarter, the "
        f"odd ones to the left, the others to the right. Of the {found['people']} people "
        f"{100 * found['found']:.0f} % are found (precision {100 * found['precision']:.0f} %, "
        f"unlabelled people counting as false), {100 * found['right_way_up']:.1f} % of them the "
        "right way up. In the photographs as they are, "
        f"{100 * found['upright_taken_for_lying']:.1f} % of those found are taken to lie.",
        "Where the box of somebody who lies is given, the way up is right for "
        f"{100 * found['by_box']:.0f} %, and silhouettes overlap the true ones by "
        f"{found['overlap_mean']:.3f} (mean; median {found['overlap_median']:.3f}). Posture, by "
        f"the vote of seven hypotheses: `lying` for {100 * found['posture_lying']:.1f} % of them, "
        f"`standing` or `walking` for {100 * found['posture_upright']:.1f} % of the same people "
        "in the photographs as they are.",
    ]


def _silhouettes(found: Figures) -> list[str]:
    overlaps = (f"{found[key]:.3f}" for key in ("mean", "median", "odd_mean", "odd_median"))
    return [
        "Overlap (IoU) with the true masks, in true boxes; 0 where nobody is found.",
        table(
            ["people", "mean", "median", "odd: mean", "odd: median", "ms a person"],
            [[str(found["people"]), *overlaps, f"{found['milliseconds']:.1f}"]],
        ),
    ]


def _street(street: dict[str, dict[str, Figures]], landmarks: Figures) -> list[str]:
    return [
        "The people of `landmarks.json`, in their true boxes. PCK: share of the 12 limb joints "
        "within a tenth of the body height, first hypothesis. Facing: front or back as in the "
        "reference (of somebody seen from the side, either may be); within 90 degrees: of the "
        "reference's azimuth. 3D: mean distance of the limb joints, hips on hips.",
        table(
            ["poses from", "people of", "people", "PCK", "facing", "within 90 degrees",
             "facing of any of 7", "first (mm)", "best of 7 (mm)"],
            [[name, part, str(one["people"]),
              *(f"{one[key]:.1f} %" for key in ("pck", "facing", "within_90", "facing_any")),
              f"{one['first_mm']:.0f}", f"{one['best_mm']:.0f}"]
             for name, parts in street.items() for part, one in parts.items()],
        ),
        f"The landmarks themselves: PCK {landmarks['pck']:.1f} % "
        f"(odd {landmarks['odd_pck']:.1f} %), left and right as in the reference for "
        f"{landmarks['sides']:.1f} % of the people.",
    ]  # fmt: skip


def _vtest(found: dict[str, Figures]) -> list[str]:
    first = next(iter(found.values()))
    return [
        f"{first['walkers']} walkers marked by hand in {first['frames']} frames chosen "
        "evenly (`tests/data/vtest-people.json`); people hidden or cut off by more than half, or "
        f"under 50 px tall, count neither way. Found: a box overlaps by {FOUND_FROM:g} or more. "
        f"{first['milliseconds']:.0f} ms a frame of 768x576.",
        table(
            ["boxes from a score of", "walkers found", "false boxes a frame"],
            [
                [score, f"{100 * one['found']:.1f} %", f"{one['false_per_frame']:.2f}"]
                for score, one in found.items()
            ],
        ),
    ]


def _confidence(found: dict[str, Any]) -> list[str]:
    errors = ", ".join(f"{name} {one['ece']:.3f}" for name, one in found.items())
    return [
        "All seven hypotheses; confidences of street people as the other half of the photographs "
        f"gives them. Right: the limb joints lie within {LIMBS_RIGHT_BELOW_PX:g} px of the "
        "reference on average, where as many simulated hypotheses lie as within 5 px over all 19 "
        "joints, as a confidence means it ([measured](simulation.md#limb-joints-alone)), in the "
        "normalised frame. The reference's joints are defined a little differently (knees and "
        "elbows 2 to 4 px lower), which counts as error.",
        table(
            ["people", "confidence", "hypotheses", "stated", "right"],
            [[name, f"{row['from']:.1f} to {row['to']:.1f}", str(row["hypotheses"]),
              f"{100 * row['stated']:.0f} %", f"{100 * row['right']:.0f} %"]
             for name, one in found.items() for row in one["bins"]],
        ),
        f"Expected calibration error: {errors}.",
        "![reliability](real-reliability.png)",
    ]  # fmt: skip
