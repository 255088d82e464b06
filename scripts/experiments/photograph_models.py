"""The models of rendered people on real frames, by source: depth, posture, presence.

    python -m scripts evaluate-photographs --shared ../shared --cache /tmp/real-readings

Every real frame is a test: nothing is chosen on them. Lines are printed, the worst source first.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.vision.blazepose import PoseReading
from app.vision.body_reading import body_of
from app.vision.depth import Depths, network_depths
from app.vision.frame_posture import FRAME_POSTURES
from app.vision.photograph_models import PhotographModels, photograph_models
from app.vision.sight import PinholeCamera
from index.build.calibrate import expected_calibration_error
from scripts.datasets import HIPS, about_hips
from scripts.experiments.photograph_sources import (
    LOW,
    SITTING,
    SOURCES,
    UPRIGHT,
    ReadFrame,
    read_sources,
)
from scripts.training.train_photograph_models import LANDMARK_LIMBS

ROOT = Path(__file__).resolve().parent.parent.parent
SURE = 0.8

GROUPS = {
    UPRIGHT: ("standing",),
    SITTING: ("sitting",),
    LOW: ("lying", "all_fours"),
    "bending": ("bending",),
    "crouching": ("crouching",),
}
"""Which postures answer a truth: who is on the ground lies or crawls."""

TRUTHS = (UPRIGHT, SITTING, LOW)

Asked = tuple[ReadFrame, PoseReading, NDArray[np.float64]]


def aligned(joints: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joints moved, turned and scaled onto the truth (Procrustes)."""
    one, other = joints - joints.mean(axis=0), truth - truth.mean(axis=0)
    left, values, right = np.linalg.svd(one.T @ other)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left * sign @ right
    scale = float((values * sign).sum() / (one**2).sum())
    return np.asarray(scale * one @ turn + truth.mean(axis=0))


def distance_mm(joints: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Mean distance about the hips, and after Procrustes, in mm."""
    joints, truth = about_hips(joints), about_hips(truth)
    apart = np.linalg.norm(joints - truth, axis=1).mean()
    shape = np.linalg.norm(aligned(joints, truth) - truth, axis=1).mean()
    return float(1e3 * apart), float(1e3 * shape)


def measure_depth(frames: Sequence[ReadFrame], models: PhotographModels) -> list[str]:
    """Distances of limb joints: the network's own, on lines of sight, corrected."""
    lines = []
    for source in sorted({frame.source for frame in frames if frame.joints_3d is not None}):
        rows, errors, sigmas = [], [], []
        for frame in frames:
            if frame.source != source or frame.joints_3d is None or not frame.readings:
                continue
            reading = frame.readings[0]
            given = reading.network_pass
            assert given is not None
            camera = PinholeCamera.of_frame(frame.shape)
            body = models.body(reading, camera)
            own = Depths(network_depths(given.world[None])[0], np.ones(33))
            plain = body_of(
                given, reading.window, camera, own, reading.landmarks.positions,
                reading.landmarks.visibility,
            )  # fmt: skip
            truth = frame.joints_3d
            rows.append(
                [
                    *distance_mm(reading.landmarks.metres[LANDMARK_LIMBS], truth),
                    *distance_mm(plain.points[LANDMARK_LIMBS], truth),
                    *distance_mm(body.points[LANDMARK_LIMBS], truth),
                ]
            )
            along = (about_hips(body.points[LANDMARK_LIMBS]) - about_hips(truth)) @ body.sight[2]
            errors.append(np.abs(along))
            sigmas.append(body.sigmas[LANDMARK_LIMBS])
        mean, error, sigma = np.mean(rows, 0), np.array(errors), np.array(sigmas)
        quarter = np.digitize(sigma, np.quantile(sigma, [0.25, 0.5, 0.75]))
        by = " ".join(f"{1e3 * error[quarter == q].mean():.0f}" for q in range(4))
        lines.append(
            f"{source} ({len(rows)}): the network's metres {mean[0]:.0f} / {mean[1]:.0f} mm, on "
            f"lines of sight {mean[2]:.0f} / {mean[3]:.0f}, corrected {mean[4]:.0f} / "
            f"{mean[5]:.0f}; depth error over sigma {error.mean() / sigma.mean():.2f}, by quartile "
            f"of sigma {by}"
        )
    return lines


def ask_postures(frames: Sequence[ReadFrame], models: PhotographModels) -> list[Asked]:
    """Probabilities of the largest person of each frame."""
    asked = []
    for frame in frames:
        if frame.readings and frame.truth:
            reading = frame.readings[0]
            judged = models.judge(reading, PinholeCamera.of_frame(frame.shape))
            asked.append((frame, reading, judged.posture.probabilities))
    return asked


def _grouped(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities of :data:`GROUPS`."""
    return np.array(
        [
            sum(probabilities[FRAME_POSTURES.index(name)] for name in names)
            for names in GROUPS.values()
        ]
    )


def measure_posture(asked: Sequence[Asked]) -> list[tuple[float, str]]:
    """Confusion and calibration by source, each with its share right."""
    lines = []
    for source in sorted({frame.source for frame, _, _ in asked}):
        some = [(f.truth, _grouped(p)) for f, _, p in asked if f.source == source]
        some = [(truth, p) for truth, p in some if truth in TRUTHS]
        if not some:
            continue
        names = list(GROUPS)
        best = np.array([p.argmax() for _, p in some])
        sure = np.array([p.max() for _, p in some])
        right = np.array([names[b] == truth for b, (truth, _) in zip(best, some, strict=True)])
        parts = []
        for truth in TRUTHS:
            rows = np.array([t == truth for t, _ in some])
            if rows.any():
                answered = rows & (sure >= 0.5)
                wrong = (answered & ~right).sum() / rows.sum()
                shares = np.bincount(best[rows], minlength=len(names)) / rows.sum()
                parts.append(
                    f"{truth} {rows.sum()}: right {(answered & right).sum() / rows.sum():.2f}, "
                    f"wrong {wrong:.2f} ("
                    + " ".join(f"{n[:6]} {s:.2f}" for n, s in zip(names, shares, strict=True))
                    + ")"
                )
        lines.append(
            (
                float(right.mean()),
                f"{source}: right {right.mean():.3f}, "
                f"ECE {expected_calibration_error(sure, right):.3f}, "
                f"above {SURE} {(sure > SURE).mean():.2f}, of them right "
                f"{right[sure > SURE].mean():.3f}\n    " + "\n    ".join(parts),
            )
        )
    return lines


def measure_low(asked: Sequence[Asked]) -> list[str]:
    """People on the ground against all others, by source: recall and false."""
    lines = []
    for source in sorted({frame.source for frame, _, _ in asked}):
        low = np.array([f.truth == LOW for f, _, _ in asked if f.source == source])
        low_found = np.array([_grouped(p)[2] > 0.5 for f, _, p in asked if f.source == source])
        if low.any():
            false = f"{100 * low_found[~low].mean():.1f} %" if (~low).any() else "-"
            lines.append(f"{source}: recall {100 * low_found[low].mean():.1f} %, false {false}")
    return lines


def any_low(frames: Sequence[ReadFrame], models: PhotographModels) -> str:
    """The fall photographs: somebody who is probably a person is on the ground."""
    shares = {}
    for truth in (LOW, "not " + LOW):
        detected = []
        for frame in frames:
            if frame.source != "Ambianic" or frame.truth != truth:
                continue
            hit = False
            for reading in frame.readings:
                judged = models.judge(reading, PinholeCamera.of_frame(frame.shape))
                low = _grouped(judged.posture.probabilities)[2] > 0.5
                hit |= bool(low and judged.doubt.person > 0.5)
            detected.append(hit)
        shares[truth] = 100 * np.mean(detected)
    return f"fall photographs, anybody on the ground: {shares[LOW]:.1f} %, others " + (
        f"{shares['not ' + LOW]:.1f} %"
    )


def measure_doubt(frames: Sequence[ReadFrame], models: PhotographModels) -> list[str]:
    """Right landmarks of sports photographs; people and things of odd inputs."""
    given, right = [], []
    for frame in frames:
        if frame.joints_2d is None or frame.visible is None:
            continue
        middle = frame.joints_2d[HIPS].mean(axis=0)
        for reading in frame.readings:
            box = reading.landmarks.box()
            if not (box.x <= middle[0] <= box.right and box.y <= middle[1] <= box.bottom):
                continue
            doubt = models.judge(reading, PinholeCamera.of_frame(frame.shape)).doubt
            trunk = np.linalg.norm(frame.joints_2d[:2].mean(0) - middle)
            apart = np.linalg.norm(
                reading.landmarks.positions[LANDMARK_LIMBS] - frame.joints_2d, axis=1
            )
            size = max(float(trunk), 0.2 * float(np.ptp(frame.joints_2d, axis=0).max()))
            seen = frame.visible
            given.append(doubt)
            right.append(bool((apart[seen] < 0.2 * size).mean() >= 0.75))
    lines = []
    if given:
        sure, true = np.array([d.right for d in given]), np.array(right)
        lines.append(
            f"LSP ({len(given)} readings): a person above 0.5 in "
            f"{np.mean([d.person > 0.5 for d in given]):.3f}; landmarks right {true.mean():.2f}, "
            f"expected {sure.mean():.2f}, ECE {expected_calibration_error(sure, true):.3f}"
        )
    for frame in frames:
        if frame.source != "odd":
            continue
        said = []
        for reading, score in zip(frame.readings, frame.scores, strict=True):
            judged = models.judge(reading, PinholeCamera.of_frame(frame.shape))
            posture, doubt = judged.posture, judged.doubt
            said.append(
                f"{posture.likeliest} {posture.probabilities.max():.2f} (person "
                f"{doubt.person:.2f}, right {doubt.right:.2f}, presence {reading.presence:.2f}, "
                f"detected {score:.2f})"
            )
        lines.append(f"odd/{frame.name}: " + ("; ".join(said) or "nobody"))
    return lines


def measure_presence(frames: Sequence[ReadFrame], models: PhotographModels) -> list[str]:
    """Share of the largest people of each source that the model takes for people."""
    lines = []
    for source in sorted({frame.source for frame in frames} - {"odd"}):
        chances = []
        for frame in frames:
            if frame.source == source and frame.readings:
                reading = frame.readings[0]
                judged = models.judge(reading, PinholeCamera.of_frame(frame.shape))
                chances.append(judged.doubt.person)
        low = np.quantile(chances, 0.05)
        lines.append(f"{source}: above 0.5 {np.mean(np.array(chances) > 0.5):.3f}, 5 % {low:.2f}")
    return lines


def evaluate(real: Path, cache: Path | None, models: PhotographModels) -> None:
    """Print all measures."""
    frames = read_sources(real, list(SOURCES), cache)

    def show(title: str, lines: Sequence[str], print_: Callable[[str], None] = print) -> None:
        print_(f"\n{title}")
        for line in lines:
            print_(f"  {line}")

    show("Depth, limb joints about the hips / Procrustes", measure_depth(frames, models))
    asked = ask_postures(frames, models)
    show("Posture of the largest person, worst source first",
         [line for _, line in sorted(measure_posture(asked))])  # fmt: skip
    show("On the ground against the rest", [*measure_low(asked), any_low(frames, models)])
    show("Presence", measure_presence(frames, models))
    show("Doubt", measure_doubt(frames, models))


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--models", type=Path, help="others than those that ship")
    parser.add_argument("--cache", type=Path, help="keep what the networks read in this folder")
    options = parser.parse_args(arguments)
    evaluate(options.shared / "real", options.cache, photograph_models(options.models))


if __name__ == "__main__":
    main()
