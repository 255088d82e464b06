"""The models of rendered people on real frames, by source: depth, posture, trust.

Every real frame is a test: nothing is chosen on them. Each is read as the service reads it, and the
largest person counts. ``--models FILE`` asks other models than those that ship.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.finder import Models
from app.photograph import load_models
from app.settings import Settings
from app.vision.blazepose import PoseReading
from app.vision.depth import Body3D, Depths, body_of, network_depths
from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES, Trust, load_photograph_models
from app.vision.optics import PinholeCamera, window_axes
from app.vision.people import Detection
from app.vision.truncation import attenuate_visibility_at_border
from scripts.datasets import (
    HIPS,
    LOW,
    SITTING,
    UPRIGHT,
    about_hips,
    frames_at,
    home_films,
    read_lsp,
    read_pose2sim,
)
from scripts.index.calibrate import expected_calibration_error
from scripts.metrics import percent
from scripts.training.photograph_data import LIMBS, RIGHT_SHARE, RIGHT_WITHIN

SURE, CLEAR = 0.8, 0.5
"""Probabilities from which a posture is counted as sure, and as clear."""

LONGEST_PX = 1280
GROUPS = {
    UPRIGHT: ("standing",),
    SITTING: ("sitting",),
    LOW: ("lying", "all_fours"),
    "bending": ("bending",),
    "crouching": ("crouching",),
}
"""Which postures answer a truth: people on the ground lie or crawl."""

Figures = dict[str, Any]
Answer = tuple[str, str, NDArray[np.float64]]
"""Source and true posture of a person, and the probabilities of :data:`GROUPS`."""


@dataclass(frozen=True)
class Shown:
    """A frame ``(H, W, 3)``, BGR, of a source, and what is known of the person in it.

    The truth is one of :data:`GROUPS`. The limb joints are ``(12, 3)`` in camera axes, ``(12, 2)``
    in pixels, and visible or not, ``(12,)``.
    """

    source: str
    frame: NDArray[np.uint8]
    truth: str | None = None
    box: Box | None = None
    joints_3d: NDArray[np.float64] | None = None
    joints_2d: NDArray[np.float64] | None = None
    visible: NDArray[np.bool_] | None = None


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--models", type=Path, help="others than those that ship")


def run(options: argparse.Namespace) -> Figures:
    """Run the experiment."""
    settings, real = Settings(), options.shared / "real"
    if not real.is_dir():
        raise FileNotFoundError(f"expected real frames in {real}, found none")
    networks = load_models(settings.concurrency)
    models = load_photograph_models(options.models)
    depths: dict[str, list[list[float]]] = defaultdict(list)
    answers: list[Answer] = []
    trusted: list[tuple[Trust, bool]] = []
    for source in (pose2sim, homes, upfall, falls, lsp):
        for shown in tqdm(source(real), desc=source.__name__, unit="frame"):
            camera = PinholeCamera.of_frame(shown.frame.shape)
            readings = read(networks, shown)
            judged = [models.judge(reading, camera) for reading in readings]
            if readings and shown.joints_3d is not None:
                row = depth_errors(readings[0], judged[0].body, camera, shown.joints_3d)
                depths[shown.source].append(row)
            if readings and shown.truth is not None:
                groups = grouped(judged[0].posture.probabilities)
                answers.append((shown.source, shown.truth, groups))
            for reading, judgement in zip(readings, judged, strict=True):
                right = landmarks_are_right(reading, shown)
                if right is not None:
                    trusted.append((judgement.trust, right))
    return {
        "depth": {source: depth_figures(np.array(rows)) for source, rows in depths.items()},
        "postures": posture_figures(answers),
        "confusions": confusions(answers),
        "trust": trust_figures(trusted),
    }


def pose2sim(real: Path) -> Iterator[Shown]:
    """Every eighth frame of three cameras, with its true box."""
    for camera in ("cam01", "cam02", "cam03"):
        for found in read_pose2sim(real / "pose2sim", camera, 8):
            joints_3d, joints_2d = found.reference.joints_3d, found.reference.joints_2d
            yield Shown(f"pose2sim {camera}", found.frame, UPRIGHT, found.box, joints_3d, joints_2d)


def homes(real: Path) -> Iterator[Shown]:
    """Frames of homes whose posture is known, two a second."""
    for film in home_films(real):
        for at, frame in film.frames(2.0):
            truth = film.truth(at)
            if truth is not None:
                yield Shown(film.source, shrunk(frame), truth)


def upfall(real: Path) -> Iterator[Shown]:
    """A frame a second of activities, and the last second of falls."""
    truths = {6: UPRIGHT, 7: UPRIGHT, 8: SITTING, 10: UPRIGHT, 11: LOW}
    for path in sorted((real / "upfall").glob("*.mp4")):
        activity = int(path.name.split("_")[0].removeprefix("activity"))
        if activity <= 5:
            frames = list(frames_at(path, 6.0))[-6::2]
        elif activity in truths:
            # Before, people sit or lie down.
            begin = 4 if activity in (8, 11) else -1
            frames = [one for one in frames_at(path, 1.0) if one[0] > begin]
        else:
            continue
        for _, frame in frames:
            yield Shown(f"UP-Fall {path.stem[-4:]}", shrunk(frame), truths.get(activity, LOW))


def falls(real: Path) -> Iterator[Shown]:
    """Photographs of people who fell."""
    for path in sorted((real / "falls" / "fall").glob("*.jpg")):
        image = cv2.imread(str(path))
        if image is not None:
            yield Shown("Ambianic", shrunk(np.asarray(image, np.uint8)), LOW)


def lsp(real: Path) -> Iterator[Shown]:
    """Sports photographs with limb joints: whether landmarks are right."""
    for one in read_lsp(real / "lsp"):
        yield Shown("LSP", one.frame, joints_2d=one.limbs, visible=one.visible)


def shrunk(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a frame of at most :data:`LONGEST_PX`."""
    scale = LONGEST_PX / max(frame.shape)
    if scale >= 1:
        return frame
    smaller = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(smaller, np.uint8)


def read(networks: Models, shown: Shown) -> list[PoseReading]:
    """Read the people of a frame, the largest first, as the service does."""
    found = [Detection(shown.box, 1.0)] if shown.box else networks.detector.detect(shown.frame)[0]
    readings = [
        networks.reader.read(shown.frame, PinholeCamera.of_frame(shown.frame.shape), one)
        for one in sorted(found, key=lambda one: -one.box.area)
    ]
    return [
        replace(one, landmarks=attenuate_visibility_at_border(one, shown.frame.shape))
        for one in readings
    ]


def grouped(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the probabilities of :data:`GROUPS`."""
    rows = [[FRAME_POSTURES.index(name) for name in names] for names in GROUPS.values()]
    return np.array([probabilities[some].sum() for some in rows])


def depth_errors(
    reading: PoseReading, body: Body3D, camera: PinholeCamera, truth: NDArray[np.float64]
) -> list[float]:
    """Return errors in metres: own, on lines of sight, corrected, along the sight; and sigma."""
    own_depths = Depths(network_depths(reading.network_pass.world[None])[0], np.ones(33))
    plain = body_of(reading, camera, own_depths)
    found = (reading.landmarks.metres, plain.points, body.points)
    apart = [about_hips(points[LIMBS]) - about_hips(truth) for points in found]
    sight = window_axes(camera, reading.window)[2]
    return [
        *(float(np.linalg.norm(one, axis=1).mean()) for one in apart),
        float(np.abs(apart[2] @ sight).mean()),
        float(body.sigmas[LIMBS].mean()),
    ]


def depth_figures(rows: NDArray[np.float64]) -> Figures:
    """Return the means of rows of :func:`depth_errors`."""
    own, on_sight, corrected, along, sigma = rows.mean(axis=0).tolist()
    return {
        "frames": len(rows),
        "own_mm": 1000 * own,
        "on_sight_mm": 1000 * on_sight,
        "corrected_mm": 1000 * corrected,
        "error_over_sigma": along / sigma,
    }


def posture_figures(answers: Sequence[Answer]) -> Figures:
    """Return the share right and the calibration by source, the worst first."""
    names, figures = list(GROUPS), {}
    for source in {one[0] for one in answers}:
        some = [one[1:] for one in answers if one[0] == source]
        sure = np.array([given.max() for _, given in some])
        right = np.array([names[given.argmax()] == truth for truth, given in some])
        figures[source] = {
            "frames": len(some),
            "right": percent(right),
            "ece": expected_calibration_error(sure, right),
            "sure": percent(sure > SURE),
            "sure_right": percent(right[sure > SURE]),
        }
    return dict(sorted(figures.items(), key=lambda item: item[1]["right"]))


def confusions(answers: Sequence[Answer]) -> Figures:
    """Return the share of each answer by source and truth."""
    figures: Figures = defaultdict(dict)
    for source, truth in sorted({one[:2] for one in answers}):
        some = np.array([one[2] for one in answers if one[:2] == (source, truth)])
        clear = some.max(axis=1) >= CLEAR
        figures[source][truth.replace(" ", "_")] = {
            "frames": len(some),
            **{
                name.replace(" ", "_"): percent(clear & (some.argmax(axis=1) == number))
                for number, name in enumerate(GROUPS)
            },
            "unclear": percent(~clear),
        }
    return figures


def landmarks_are_right(reading: PoseReading, shown: Shown) -> bool | None:
    """Return whether three of four visible limb joints are right; None for another person."""
    if shown.visible is None or shown.joints_2d is None:
        return None
    x, y = middle = shown.joints_2d[HIPS].mean(axis=0)
    box = reading.landmarks.box()
    if not (box.x <= x <= box.right and box.y <= y <= box.bottom):
        return None
    trunk = float(np.linalg.norm(shown.joints_2d[:2].mean(axis=0) - middle))
    size = max(trunk, 0.2 * float(np.ptp(shown.joints_2d, axis=0).max()))
    apart = np.linalg.norm(reading.landmarks.positions[LIMBS] - shown.joints_2d, axis=1)
    return bool((apart[shown.visible] < RIGHT_WITHIN * size).mean() >= RIGHT_SHARE)


def trust_figures(trusted: Sequence[tuple[Trust, bool]]) -> Figures:
    """Return whether landmarks are as often right as they are said to be."""
    stated = np.array([trust.right for trust, _ in trusted])
    right = np.array([right for _, right in trusted])
    return {
        "readings": len(right),
        "people": percent([trust.person > CLEAR for trust, _ in trusted]),
        "right": percent(right),
        "stated": percent(stated),
        "ece": expected_calibration_error(stated, right),
    }
