"""The real experiment: street photographs and videos of ``../shared/real``.

The detector's weights are cross-validated by photograph. Settings of silhouettes and poses were
tuned on even-numbered photographs, so that the odd ones, always shown beside all, are their test.
The references of poses are MediaPipe's (street people) and a multi-view triangulation
(``pose2sim``): something to compare with, not ground truth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from app.estimator import Estimator
from app.settings import DEFAULT_MODELS
from app.vision.detect import Detector
from app.vision.facing_evidence import FacingReader
from app.vision.grabcut import GrabCutSegmenter
from app.vision.joints import JointReader
from app.vision.networks import Networks
from app.vision.people import silhouette_from_mask
from app.vision.people_detector import make_detector
from app.vision.refine import Refiner
from app.vision.segment import NetworkSegmenter
from app.vision.tflite import TfliteError
from index.store import DEFAULT_PATH, PoseIndex
from scripts.experiments.real_confidence import (
    calibration_error,
    cross_validated,
    fit_confidence,
    reliability,
    without_definitions,
)
from scripts.experiments.real_data import (
    Photograph,
    StreetPerson,
    read_pennfudan,
    read_pose2sim,
    read_street_people,
    read_vtest,
)
from scripts.experiments.real_detection import measure_detection
from scripts.experiments.real_detection_fit import fit_detector, look_by
from scripts.experiments.real_lying import (
    fitted_lying,
    lying_figures,
    lying_trials,
    way_up_figures,
)
from scripts.experiments.real_peer import why_absent
from scripts.experiments.real_poses import (
    LIMBS_RIGHT_BELOW_PX,
    Trial,
    figures,
    peer_on_video,
    segmented,
    street_trials,
    video_trials,
)
from scripts.experiments.real_silhouettes import end_to_end, in_true_boxes, peer_in_true_boxes
from scripts.experiments.real_vtest import FOUND_FROM, MARKS, measure_vtest, read_marks
from scripts.facing.measure import street_figures as facing_figures
from scripts.results import machine

COMMAND = "python -m scripts.evaluate real"
CAMERAS = ("cam01", "cam03")
VTEST_FRAMES = 20
SCORES = (0.3, 0.5)
"""Detection scores from which a box is reported (the service's default) or sure."""

Figures = dict[str, float]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--models", type=Path, default=DEFAULT_MODELS, help="of fetch_models")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="index artefact to ask")
    parser.add_argument(
        "--mediapipe", type=Path, metavar="PYTHON", help="interpreter with mediapipe 0.10.21"
    )
    parser.add_argument("--step", type=int, default=4, help="every so many-th frame of pose2sim")
    parser.add_argument(
        "--fit-detector", action="store_true", help="print the detector's weights instead"
    )
    parser.add_argument(
        "--fit-confidence",
        action="store_true",
        help="print what app/weighing.py holds instead",
    )


@dataclass(frozen=True)
class Tools:
    """What is measured, loaded once."""

    detector: Detector
    segmenter: NetworkSegmenter
    index: PoseIndex
    facing_reader: FacingReader
    joint_reader: JointReader

    def estimator(self, *, facing: bool = True, joints: bool = True) -> Estimator:
        """Wrap them as the service does, with or without a look at facing and joints."""
        return Estimator(
            self.index,
            self.detector,
            self.segmenter,
            min_person_px=50,
            max_pixels=50_000_000,
            max_persons=50,
            facing_reader=self.facing_reader if facing else None,
            joint_reader=self.joint_reader if joints else None,
        )


def run(options: argparse.Namespace) -> None:
    """Run the experiment, or one of the fits, as the command line asks."""
    cv2.setNumThreads(1)
    try:
        networks = Networks.load(options.models)
    except TfliteError as error:
        raise FileNotFoundError(f"{error}; python -m scripts.fetch_models fetches it") from None
    segmenter, reader = NetworkSegmenter(networks, Refiner()), JointReader()
    detector = make_detector(networks, segmenter, reader)
    index = PoseIndex.load(options.index)
    tools = Tools(detector, segmenter, index, FacingReader(), reader)
    look = look_by(segmenter, reader)
    folder = options.shared / "real"
    photographs = read_pennfudan(folder / "pennfudan")
    if options.fit_detector:
        print(fit_detector(photographs, networks.person, look))
        lying = lying_trials(photographs, networks.person, segmenter, reader)
        print("_CLARITY, _OFFSET = {:.2f}, {:.2f} (lying)".format(*fitted_lying(lying)))
        return
    people = read_street_people(folder / "pennfudan", photographs)
    if options.fit_confidence:
        trials = street_trials(people, tools.estimator(), segmented(tools.segmenter))
        print("SLOPE, BIAS = {:.3f}, {:.3f}".format(*fit_confidence(trials)))
        return
    absent = why_absent(options.mediapipe)
    python = None if absent else options.mediapipe
    results: dict[str, Any] = {"command": COMMAND, "machine": machine()}
    results["mediapipe"] = absent or "0.10.21"
    results["detection"] = measure_detection(photographs, networks.person, look)
    results["lying"] = {
        **lying_figures(lying_trials(photographs, networks.person, segmenter, reader)),
        **way_up_figures(photographs, segmenter, reader),
    }
    results["silhouettes"] = silhouettes(photographs, tools, python)
    results["facing"] = facing_figures(people, tools.segmenter, tools.facing_reader.read)
    street = street_people(people, tools)
    results["street"] = street_figures(street)
    videos, results["pose2sim"] = pose2sim(folder, tools, options, python)
    if MARKS.is_file():
        results["vtest"] = vtest(folder, tools.detector)
    own = cross_validated(street["own silhouettes"])
    grouped = {
        "street people": own,
        "street people, odd": [trial for trial in own if trial.odd],
        "street people, definitions aside": without_definitions(own),
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


def silhouettes(
    photographs: Sequence[Photograph], tools: Tools, python: Path | None
) -> dict[str, Figures]:
    """Overlap with the true masks: in true boxes, end to end, and the peer's."""
    found = {
        "network, true boxes": in_true_boxes(photographs, tools.segmenter),
        "GrabCut, true boxes": in_true_boxes(photographs, GrabCutSegmenter()),
        "network, own detections": end_to_end(photographs, tools.detector, tools.segmenter),
    }
    if python is not None:
        found["MediaPipe, true boxes"] = peer_in_true_boxes(photographs, python)
    return found


def street_people(people: Sequence[StreetPerson], tools: Tools) -> dict[str, list[Trial]]:
    """Trials of the street people, with more and less of what the photograph shows."""

    def true_mask(person: StreetPerson) -> Any:
        mask = person.photograph.labels == person.label
        return silhouette_from_mask(mask, segmenter="mask", truncated=False)

    whole, unread, blind = (
        tools.estimator(),
        tools.estimator(joints=False),
        tools.estimator(facing=False, joints=False),
    )
    own = segmented(tools.segmenter)
    return {
        "own silhouettes": street_trials(people, whole, own),
        "own silhouettes, joints not read": street_trials(people, unread, own),
        "own silhouettes, photograph not asked": street_trials(people, blind, own),
        "true silhouettes, as a caller's mask": street_trials(people, unread, true_mask),
    }


def street_figures(street: dict[str, list[Trial]]) -> dict[str, dict[str, Figures]]:
    """Figures of all street people and of those in odd photographs."""
    return {
        name: {"all": figures(trials), "odd": figures([t for t in trials if t.odd])}
        for name, trials in street.items()
    }


def pose2sim(
    folder: Path, tools: Tools, options: argparse.Namespace, python: Path | None
) -> tuple[list[Trial], dict[str, dict[str, Figures]]]:
    """Trials in the true boxes of both cameras, and the figures of all that was tried."""
    estimator = tools.estimator()
    trials: list[Trial] = []
    found: dict[str, dict[str, Figures]] = {}
    for camera in CAMERAS:
        frames = read_pose2sim(folder / "pose2sim", camera, options.step)
        true = video_trials(frames, estimator, own_detection=False)
        own = video_trials(frames, estimator, own_detection=True)
        trials += true.trials
        found[camera] = {
            "true box": {**figures(true.trials), "frames": true.frames},
            "own detection": {**figures(own.trials), "frames": own.frames},
        }
        if python is not None:
            found[camera]["MediaPipe"] = {**peer_on_video(frames, python), "frames": true.frames}
    return trials, found


def vtest(folder: Path, detector: Detector) -> dict[str, Figures]:
    """People found in the street video, at each of :data:`SCORES`."""
    frames = read_vtest(folder / "vtest", VTEST_FRAMES)
    return {f"{score:g}": measure_vtest(frames, read_marks(), detector, score) for score in SCORES}


def report(results: dict[str, Any]) -> str:
    """Write the results as Markdown."""
    lines = [
        "# Real photographs and videos\n",
        f"`{COMMAND} [--mediapipe PYTHON]` on {results['machine']}, one thread.\n",
        "The detector's weights are cross-validated by photograph. *Odd*: the odd-numbered ones, "
        "on which no setting of silhouettes or poses was tuned. Times are of a machine that did "
        "other work as well.\n",
    ]
    if results["mediapipe"] != "0.10.21":
        lines.append(f"MediaPipe's columns are missing: {results['mediapipe']}.\n")
    lines += ["## Detection\n", *_detection(results["detection"]), *_lying(results["lying"])]
    lines += ["\n## Silhouettes\n", *_silhouettes(results["silhouettes"])]
    lines += ["\n## Street people\n", *_street(results)]
    lines += ["\n## A balancing person, two cameras\n", *_pose2sim(results["pose2sim"])]
    if "vtest" in results:
        lines += ["\n## Walkers in a street video\n", *_vtest(results["vtest"])]
    lines += ["\n## Confidence\n", *_confidence(results["confidence"])]
    return "\n".join(lines) + "\n"


def _detection(found: dict[str, Figures]) -> list[str]:
    people = int(found["cascade"]["people"])
    return [
        f"Penn-Fudan, {people} labelled people in 74 photographs; a box is right from an overlap "
        "(IoU) of 0.5. People left unlabelled count as false. Recall and precision: at a "
        "detection score of 0.5.\n",
        "| detector | AP | recall | precision | recall at any score | ms a photograph |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {one['average_precision']:.3f} | {one['recall']:.3f} "
            f"| {one['precision']:.3f} | {one['highest_recall']:.3f} "
            f"| {one['milliseconds']:.0f} |"
            for name, one in found.items()
        ),
        f"\nThe cascade's candidates reach {100 * found['cascade']['reachable']:.1f} % of the "
        "people. Without the networks' files, `gradients` serves. How far the search for gradients "
        "follows the network, and the least score reported (0.3), were chosen among a dozen "
        "settings by these figures and those of the street video below: expect a point or two "
        "less elsewhere.",
    ]


def _lying(found: Figures) -> list[str]:
    return [
        f"\nPeople who lie: the {int(found['photographs'])} photographs turned by a quarter, the "
        "odd ones to the left, the others to the right. Of the people in them "
        f"{100 * found['reachable']:.0f} % are wide parts of what the network saw, and "
        f"{100 * found['found']:.0f} % are found, {100 * found['wrong_way']:.0f} % of these the "
        f"wrong way up. {found['false_turned']:.2f} other parts of a turned photograph, and "
        f"{found['false_upright']:.2f} of one as it is, are taken for somebody who lies. Weights "
        "are cross-validated by photograph.",
        "\nWhere the box of somebody who lies is given, the way up is told of "
        f"{100 * found['by_box']:.0f} %, and silhouettes overlap the true ones by "
        f"{found['overlap_mean']:.3f} (mean; median {found['overlap_median']:.3f}); where the mask "
        f"is given, of {100 * found['by_mask']:.0f} %.",
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
    return [
        "The people of `landmarks.json`, in their true boxes. PCK: share of the 12 limb joints "
        "within a tenth of the body height, first hypothesis. Facing: front or back as in the "
        "reference (of somebody seen from the side, either may be); within 90 degrees: of the "
        "reference's azimuth. 3D: mean distance of the limb joints, hips on hips.\n",
        "| silhouettes | photographs | people | PCK | facing, first | within 90 degrees, first "
        "| facing, any of 7 | 3D first (mm) | 3D best of 7 (mm) |",
        "|---|---|---|---|---|---|---|---|---|",
        *rows,
        *(_facing(results["facing"]) if "facing" in results else []),
    ]


def _facing(found: dict[str, Figures]) -> list[str]:
    plain, pixelated = found["as they are"], found["faces pixelated"]
    return [
        f"\nThe photograph alone tells front from back of {100 * plain['right']:.0f} % "
        f"({100 * plain['right_clear']:.0f} % of those not seen from the side); median error of "
        f"the azimuth {plain['median_error_deg']:.0f} degrees. With the face pixelated to three "
        f"squares by three: {100 * pixelated['right']:.0f} % "
        f"({100 * pixelated['right_clear']:.0f} %), {pixelated['median_error_deg']:.0f} degrees."
    ]


def _pose2sim(found: dict[str, dict[str, Figures]]) -> list[str]:
    return [
        "Mean distance of the 12 limb joints, hips on hips, and after Procrustes alignment.\n",
        "| camera | silhouette from | frames answered | first (mm) | best of 7 (mm) "
        "| first, aligned | best of 7, aligned | PCK |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {camera} | {name} | {int(one['people'])} of {int(one['frames'])} "
            f"| {_or_dash(one.get('first_mm'), '.0f')} | {_or_dash(one.get('best_mm'), '.0f')} "
            f"| {_or_dash(one.get('first_procrustes_mm'), '.0f')} "
            f"| {_or_dash(one.get('best_procrustes_mm'), '.0f')} "
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
        "and elbows 2 to 4 px lower), which counts as error; *definitions aside* takes off the "
        "mean offset of each joint, measured on the other half of the photographs.\n",
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
