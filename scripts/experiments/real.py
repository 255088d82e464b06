"""The real experiment: street photographs and videos of ``../shared/real``.

The detector's weights are cross-validated by photograph. Settings of silhouettes and poses were
tuned on even-numbered photographs, so that the odd ones, always shown beside all, are their test.
The references of poses are MediaPipe's (street people) and a multi-view triangulation
(``pose2sim``): something to compare with, not ground truth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from app.estimation.estimator import Estimator
from app.settings import Settings
from app.vision.detection.detector import MIN_SCORE, Detector, NetworkDetector
from index.store import DEFAULT_PATH
from scripts.experiments.real_confidence import calibration_error, cross_validated, reliability
from scripts.experiments.real_data import (
    read_pennfudan,
    read_pose2sim,
    read_street_people,
    read_vtest,
)
from scripts.experiments.real_detection import all_candidates, measure_detection
from scripts.experiments.real_lying import measure_lying
from scripts.experiments.real_poses import (
    BOTH,
    LIMBS_RIGHT_BELOW_PX,
    WAYS,
    Trial,
    Way,
    figures,
    in_photographs,
    in_video,
    observed_pck,
    trials_of,
)
from scripts.experiments.real_silhouettes import end_to_end, in_true_boxes
from scripts.experiments.real_vtest import FOUND_FROM, MARKS, measure_vtest, read_marks
from scripts.results import machine

COMMAND = "python -m scripts.evaluate real"
CAMERAS = ("cam01", "cam03")
VTEST_FRAMES = 20
SCORES = (MIN_SCORE, 0.5)
"""Detection scores from which a box is reported (the service's default) or sure."""

Figures = dict[str, float]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="index artefact to ask")
    parser.add_argument("--step", type=int, default=4, help="every so many-th frame of pose2sim")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks."""
    cv2.setNumThreads(1)
    estimator = Estimator.load(Settings(index=options.index))
    detector = estimator.detector
    assert isinstance(detector, NetworkDetector)
    folder = options.shared / "real"
    photographs = read_pennfudan(folder / "pennfudan")
    people = read_street_people(folder / "pennfudan", photographs)
    candidates = all_candidates(photographs, detector)
    results: dict[str, Any] = {"command": COMMAND, "machine": machine()}
    results["detection"] = measure_detection(photographs, candidates)
    results["lying"] = measure_lying(photographs, estimator)
    results["silhouettes"] = {
        "true boxes": in_true_boxes(photographs, estimator),
        "own detections": end_to_end(photographs, estimator),
    }
    asked = in_photographs(people, estimator)
    street = {way: trials_of(asked, estimator, way) for way in WAYS}
    results["street"] = street_figures(street)
    results["observed"] = observed_pck(people, estimator)
    videos, results["pose2sim"] = pose2sim(folder, estimator, options.step)
    if MARKS.is_file():
        results["vtest"] = vtest(folder, detector)
    own = cross_validated(street[BOTH])
    grouped = {
        "street people": own,
        "street people, odd": [trial for trial in own if trial.odd],
        "pose2sim": videos,
    }
    results["confidence"] = {
        name: {"ece": calibration_error(trials), "bins": reliability(trials)}
        for name, trials in grouped.items()
    }
    options.out.mkdir(parents=True, exist_ok=True)
    plot_reliability(results["confidence"], options.out / "real-reliability.png")
    (options.out / "real.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.out / "real.md").write_text(report(results))


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


def report(results: dict[str, Any]) -> str:
    """Write the results as Markdown."""
    lines = [
        "# Real photographs and videos\n",
        f"`{COMMAND}` on {results['machine']}, one thread.\n",
        "What is fitted of the detector is cross-validated by photograph. *Odd*: the odd-numbered "
        "ones, on which no setting of silhouettes or poses was tuned. Times are of a machine that "
        "did other work as well.\n",
    ]
    lines += ["## Detection\n", *_detection(results["detection"]), *_lying(results["lying"])]
    lines += ["\n## Silhouettes\n", *_silhouettes(results["silhouettes"])]
    lines += ["\n## Street people\n", *_street(results)]
    lines += ["\n## A balancing person, two cameras\n", *_pose2sim(results["pose2sim"])]
    if "vtest" in results:
        lines += ["\n## Walkers in a street video\n", *_vtest(results["vtest"])]
    lines += ["\n## Confidence\n", *_confidence(results["confidence"])]
    return "\n".join(lines) + "\n"


def _detection(found: dict[str, Figures]) -> list[str]:
    people = int(next(iter(found.values()))["people"])
    return [
        f"Penn-Fudan, {people} labelled people in 74 photographs; a box is right from an overlap "
        "(IoU) of 0.5. People left unlabelled count as false: of the 24 surest false boxes all "
        "show somebody. Recall and precision: at a detection score of 0.5.\n",
        "| detector | AP | recall at a precision of 0.9 | recall | precision "
        "| recall at any score | ms a photograph |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {name} | {one['average_precision']:.3f} "
            f"| {_or_dash(one.get('recall_at_90'), '.3f')} | {one['recall']:.3f} "
            f"| {one['precision']:.3f} | {one['highest_recall']:.3f} "
            f"| {one['milliseconds']:.0f} |"
            for name, one in found.items()
        ),
    ]


def _lying(found: Figures) -> list[str]:
    return [
        f"\nPeople who lie: the {int(found['photographs'])} photographs turned by a quarter, the "
        f"odd ones to the left, the others to the right. Of the {int(found['people'])} people "
        f"{100 * found['found']:.0f} % are found (precision {100 * found['precision']:.0f} %, "
        f"unlabelled people counting as false), {100 * found['right_way_up']:.1f} % of them the "
        "right way up. In the photographs as they are, "
        f"{100 * found['upright_taken_for_lying']:.1f} % of those found are taken to lie.",
        "\nWhere the box of somebody who lies is given, the way up is right for "
        f"{100 * found['by_box']:.0f} %, and silhouettes overlap the true ones by "
        f"{found['overlap_mean']:.3f} (mean; median {found['overlap_median']:.3f}). Posture, by "
        f"the vote of seven hypotheses: `lying` for {100 * found['posture_lying']:.1f} % of them, "
        f"`standing` or `walking` for {100 * found['posture_upright']:.1f} % of the same people "
        "in the photographs as they are.",
    ]


def _silhouettes(found: dict[str, Figures]) -> list[str]:
    return [
        "Overlap (IoU) with the true masks; 0 where nobody is found.\n",
        "| silhouettes | people | mean | median | odd: mean | odd: median | ms a person |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {name} | {int(one['people'])} | {one['mean']:.3f} | {one['median']:.3f} "
            f"| {one['odd_mean']:.3f} | {one['odd_median']:.3f} "
            f"| {_or_dash(one.get('milliseconds'), '.1f')} |"
            for name, one in found.items()
        ),
    ]


def _street(results: dict[str, Any]) -> list[str]:
    rows = [
        f"| {name} | {part} | {int(one['people'])} | {one['pck']:.1f} % | {one['facing']:.1f} % "
        f"| {one['within_90']:.1f} % | {one['facing_any']:.1f} % "
        f"| {one['first_mm']:.0f} | {one['best_mm']:.0f} |"
        for name, parts in results["street"].items()
        for part, one in parts.items()
    ]
    observed = results["observed"]
    return [
        "The people of `landmarks.json`, in their true boxes. PCK: share of the 12 limb joints "
        "within a tenth of the body height, first hypothesis. Facing: front or back as in the "
        "reference (of somebody seen from the side, either may be); within 90 degrees: of the "
        "reference's azimuth. 3D: mean distance of the limb joints, hips on hips.\n",
        "| poses from | people of | people | PCK | facing | within 90 degrees "
        "| facing of any of 7 | first (mm) | best of 7 (mm) |",
        "|---|---|---|---|---|---|---|---|---|",
        *rows,
        f"\nThe landmarks themselves: PCK {observed['pck']:.1f} % "
        f"(odd {observed['odd_pck']:.1f} %), left and right as in the reference for "
        f"{observed['sides']:.1f} % of the people.",
    ]


def _pose2sim(found: dict[str, dict[str, Figures]]) -> list[str]:
    return [
        "Mean distance of the 12 limb joints, hips on hips, in true boxes.\n",
        "| camera | poses from | frames answered | first (mm) | best of 7 (mm) | PCK |",
        "|---|---|---|---|---|---|",
        *(
            f"| {camera} | {name} | {int(one['people'])} of {int(one['frames'])} "
            f"| {_or_dash(one.get('first_mm'), '.0f')} | {_or_dash(one.get('best_mm'), '.0f')} "
            f"| {_or_dash(one.get('pck'), '.0f')} |"
            for camera, rows in found.items()
            for name, one in rows.items()
        ),
    ]


def _vtest(found: dict[str, Figures]) -> list[str]:
    first = next(iter(found.values()))
    return [
        f"{int(first['walkers'])} walkers marked by hand in {int(first['frames'])} frames chosen "
        "evenly (`tests/data/vtest-people.json`); people hidden or cut off by more than half, or "
        f"under 50 px tall, count neither way. Found: a box overlaps by {FOUND_FROM:g} or more. "
        f"{first['milliseconds']:.0f} ms a frame of 768x576.\n",
        "| boxes from a score of | walkers found | false boxes a frame |",
        "|---|---|---|",
        *(
            f"| {score} | {100 * one['found']:.1f} % | {one['false_per_frame']:.2f} |"
            for score, one in found.items()
        ),
    ]


def _confidence(found: dict[str, Any]) -> list[str]:
    lines = [
        "All seven hypotheses; confidences of street people as the other half of the photographs "
        "gives them. Right: the limb joints lie within "
        f"{LIMBS_RIGHT_BELOW_PX:g} px of the reference on average, where as many simulated "
        "hypotheses lie as within 5 px over all 19 joints, as a confidence means it "
        "([measured](strict.md#limb-joints-alone)), "
        "in the normalised frame. The reference's joints are defined a little differently (knees "
        "and elbows 2 to 4 px lower), which counts as error.\n",
        "| people | confidence | hypotheses | stated | right |",
        "|---|---|---|---|---|",
    ]
    for name, one in found.items():
        lines += [
            f"| {name} | {row['from']:.1f} to {row['to']:.1f} | {row['hypotheses']} "
            f"| {100 * row['stated']:.0f} % | {100 * row['right']:.0f} % |"
            for row in one["bins"]
        ]
    errors = ", ".join(f"{name} {one['ece']:.3f}" for name, one in found.items())
    lines.append(f"\nExpected calibration error: {errors}.")
    lines.append("\n![reliability](real-reliability.png)")
    return lines


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def plot_reliability(found: dict[str, Any], file: Path) -> None:
    """Share of right hypotheses over the confidence stated."""
    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, one in found.items():
        stated = [row["stated"] for row in one["bins"]]
        axes.plot(stated, [row["right"] for row in one["bins"]], marker="o", label=name)
    axes.set(
        xlabel="confidence", ylabel="share that is right", xlim=(0, 1), ylim=(0, 1), aspect="equal"
    )
    axes.legend()
    figure.savefig(file, dpi=120)
    plt.close(figure)
