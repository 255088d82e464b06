"""The models of rendered people on real frames, by source: depth, posture, doubt.

Every real frame is a test: nothing is chosen on them. ``--cache FOLDER`` keeps what the networks
read, and ``--models FILE`` asks others than those that ship.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.vision.depth import Depths, body_of, network_depths
from app.vision.judgement import FRAME_POSTURES, Judgement, PhotographModels, load_photograph_models
from app.vision.optics import PinholeCamera
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
from scripts.metrics import percent
from scripts.training.train_photograph_models import LANDMARK_LIMBS

SURE = 0.8

GROUPS = {
    UPRIGHT: ("standing",),
    SITTING: ("sitting",),
    LOW: ("lying", "all_fours"),
    "bending": ("bending",),
    "crouching": ("crouching",),
}
"""Which postures answer a truth: people on the ground lie or crawl."""

TRUTHS = (UPRIGHT, SITTING, LOW)

Figures = dict[str, Any]
Asked = tuple[ReadFrame, NDArray[np.float64]]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Options of this experiment alone."""
    parser.add_argument("--models", type=Path, help="others than those that ship")
    parser.add_argument("--cache", type=Path, help="keeps what the networks read in this folder")


def run(options: argparse.Namespace) -> Figures:
    """Measure everything."""
    models = load_photograph_models(options.models)
    frames = read_sources(options.shared / "real", list(SOURCES), options.cache)
    asked = [
        (frame, grouped(judge(models, frame).posture.probabilities))
        for frame in frames
        if frame.readings and frame.truth
    ]
    return {
        "depth": measure_depth(frames, models),
        "postures": measure_postures(asked),
        "confusions": measure_confusions(asked),
        "ground": measure_ground(asked),
        "doubt": measure_doubt(frames, models),
        "odd": ask_odd(frames, models),
    }


def judge(models: PhotographModels, frame: ReadFrame, number: int = 0) -> Judgement:
    """What the models make of one of the people in a frame, the largest first."""
    return models.judge(frame.readings[number], PinholeCamera.of_frame(frame.shape))


def grouped(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probabilities of :data:`GROUPS`."""
    return np.array(
        [
            sum(probabilities[FRAME_POSTURES.index(name)] for name in names)
            for names in GROUPS.values()
        ]
    )


def distance_mm(joints: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Mean distance about the hips, mm."""
    return float(1e3 * np.linalg.norm(about_hips(joints) - about_hips(truth), axis=1).mean())


def measure_depth(frames: Sequence[ReadFrame], models: PhotographModels) -> Figures:
    """Distances of limb joints: the network's own, on lines of sight, corrected."""
    figures = {}
    known = [frame for frame in frames if frame.joints_3d is not None and frame.readings]
    for source in sorted({frame.source for frame in known}):
        rows, errors, sigmas = [], [], []
        for frame in known:
            if frame.source != source:
                continue
            truth, reading = frame.joints_3d, frame.readings[0]
            assert truth is not None
            camera, body = PinholeCamera.of_frame(frame.shape), judge(models, frame).body
            own_depths = Depths(network_depths(reading.raw.world[None])[0], np.ones(33))
            plain = body_of(reading, camera, own_depths)
            points = (reading.landmarks.metres, plain.points, body.points)
            rows.append([distance_mm(one[LANDMARK_LIMBS], truth) for one in points])
            along = (about_hips(body.points[LANDMARK_LIMBS]) - about_hips(truth)) @ body.sight[2]
            errors.append(np.abs(along))
            sigmas.append(body.sigmas[LANDMARK_LIMBS])
        own, on_sight, corrected = np.mean(rows, axis=0).tolist()
        figures[source] = {
            "frames": len(rows),
            "own_mm": own,
            "on_sight_mm": on_sight,
            "corrected_mm": corrected,
            "error_over_sigma": float(np.mean(errors) / np.mean(sigmas)),
        }
    return figures


def measure_postures(asked: Sequence[Asked]) -> Figures:
    """Share right and calibration by source, the worst first."""
    names, figures = list(GROUPS), {}
    for source in sorted({frame.source for frame, _ in asked}):
        some = [(f.truth, p) for f, p in asked if f.source == source and f.truth in TRUTHS]
        if not some:
            continue
        sure = np.array([p.max() for _, p in some])
        right = np.array([names[p.argmax()] == truth for truth, p in some])
        figures[source] = {
            "frames": len(some),
            "right": percent(right),
            "ece": expected_calibration_error(sure, right),
            "sure": percent(sure > SURE),
            "sure_right": percent(right[sure > SURE]),
        }
    return dict(sorted(figures.items(), key=lambda item: item[1]["right"]))


def measure_confusions(asked: Sequence[Asked]) -> Figures:
    """For each source and truth: the share of each answer, that below one half being unclear."""
    figures: Figures = {}
    for source in sorted({frame.source for frame, _ in asked}):
        for truth in TRUTHS:
            some = np.array([p for f, p in asked if (f.source, f.truth) == (source, truth)])
            if not len(some):
                continue
            clear = some.max(axis=1) >= 0.5
            answers = {
                name.replace(" ", "_"): percent(clear & (some.argmax(axis=1) == number))
                for number, name in enumerate(GROUPS)
            }
            figures.setdefault(source, {})[truth.replace(" ", "_")] = {
                "frames": len(some), **answers, "unclear": percent(~clear),
            }  # fmt: skip
    return figures


def measure_ground(asked: Sequence[Asked]) -> Figures:
    """People on the ground against all others, by source."""
    figures: Figures = {}
    for source in sorted({frame.source for frame, _ in asked}):
        some = [(f.truth == LOW, p[2] > 0.5) for f, p in asked if f.source == source]
        truth, found = np.array(some).T
        if truth.any():
            others = percent(found[~truth]) if (~truth).any() else None
            figures[source] = {"recall": percent(found[truth]), "false": others}
    return dict(sorted(figures.items(), key=lambda item: item[1]["recall"]))


def measure_doubt(frames: Sequence[ReadFrame], models: PhotographModels) -> Figures:
    """Whether the landmarks of sports photographs are as often right as they are said to be."""
    given, right = [], []
    for frame in frames:
        if frame.joints_2d is None or frame.visible is None:
            continue
        middle = frame.joints_2d[HIPS].mean(axis=0)
        for number, reading in enumerate(frame.readings):
            box = reading.landmarks.box()
            if not (box.x <= middle[0] <= box.right and box.y <= middle[1] <= box.bottom):
                continue
            trunk = np.linalg.norm(frame.joints_2d[:2].mean(0) - middle)
            places = reading.landmarks.positions[LANDMARK_LIMBS]
            apart = np.linalg.norm(places - frame.joints_2d, axis=1)
            size = max(float(trunk), 0.2 * float(np.ptp(frame.joints_2d, axis=0).max()))
            given.append(judge(models, frame, number).trust)
            right.append(bool((apart[frame.visible] < 0.2 * size).mean() >= 0.75))
    stated = np.array([trust.right for trust in given])
    return {
        "readings": len(right),
        "people": percent([trust.person > 0.5 for trust in given]),
        "right": percent(right),
        "stated": percent(stated),
        "ece": expected_calibration_error(stated, np.array(right)),
    }


def ask_odd(frames: Sequence[ReadFrame], models: PhotographModels) -> Figures:
    """Animals, bags, desks, riders: what is answered of each detection."""
    figures = {}
    for frame in frames:
        if frame.source != "odd":
            continue
        answers = []
        for number in range(len(frame.readings)):
            posture = judge(models, frame, number).posture
            answers.append(f"{posture.likeliest} {posture.probabilities.max():.2f}")
        figures[frame.name] = {"answers": ", ".join(answers) or "nobody"}
    return figures
