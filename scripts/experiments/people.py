"""The people experiment: sport, falls, leaning bodies, cameras. Answers must be right, or unclear.

Asks the estimator and camera sessions in this process about ``../shared/real``. Detection scores
were fitted to frames of the street video; nothing was fitted to the others.
"""

import argparse
import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.camera import CameraSession
from app.estimation.results import Person
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from app.tracking.results import TrackedFrame, TrackedPerson
from app.vision.geometry import Box
from app.vision.people import LANDMARK_NAMES
from index.posture import ON_THE_GROUND
from index.skeleton import LIMB_ROWS, LIMBS, POINT_NAMES
from scripts.datasets import (
    POSE2SIM_CAMERAS,
    Athlete,
    Photograph,
    about_hips,
    read_frames,
    read_lsp,
    read_pennfudan,
    read_pose2sim_joints,
)
from scripts.helpers import encoded, estimate, track
from scripts.metrics import percent

MIN_CUT_PX, SAME_PERSON = 180, 0.3
"""Minimum height of people who are cut off, and minimum overlap (IoU) of a box with theirs."""

NEAR_OF_TRUNK, NEAR_OF_HEIGHT = 0.2, 0.1
"""A joint is right within this share of the trunk (sport) or of the height (cut off)."""

TRUNK_TILTS = {"upright": (0, 45), "horizontal": (45, 135), "inverted": (135, 181)}
CUTS = tuple(itertools.product(("head", "feet"), (0.2, 0.35, 0.5)))

FALL_VIDEOS = (("video_3", 80, 90), ("video_5", 120, 135))
"""Videos, the frame before which everybody stands, and the one from which a person has fallen."""

STREET_FRAMES = 300
MIN_TRACK = 10
"""Fewest poses of a track in which exchanges of left and right are counted."""

LOW = (*ON_THE_GROUND, "sitting", "kneeling", "crouching")
ONLOOKER_FROM_PX = 500.0
"""A person sits in the corner of UP-Fall's camera 2, right of this column."""


@dataclass(frozen=True)
class Activity:
    """An activity of UP-Fall: a fall, or what is right to say about it."""

    name: str
    is_fall: bool = False
    is_upright: bool = False
    postures: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()


ACTIVITIES = {
    **{number: Activity(f"fall_{number}", is_fall=True) for number in range(1, 6)},
    6: Activity("walks", False, True, ("walking", "standing"), ("walk",)),
    7: Activity("stands", False, True, ("standing",), ("stand",)),
    8: Activity("sits", False, False, ("sitting",), ("sit",)),
    9: Activity("picks_up", False, True),
    10: Activity(
        "jumps", False, True, ("standing", "crouching", "bending", "arms_raised"), ("jump",)
    ),
    11: Activity("lies", False, False, ON_THE_GROUND, ("lie",)),
}
UPFALL_FPS, UPFALL_STEP, UPFALL_FRAMES = 18, 3, 144
"""Frame rate, step between frames that are sent, and frames of an activity that is no fall."""

_LANDMARKS = [LANDMARK_NAMES.index(name) for name in LIMBS]
_TRUNK = [
    LIMBS.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "shoulder")
]

Figures = dict[str, float]


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    real = options.shared / "real"
    if not real.is_dir():
        raise FileNotFoundError(f"expected {real} to hold photographs and videos, it is not there")
    estimator = load_estimator(Settings())
    return {
        "sport": sport(estimator, read_lsp(real / "lsp")),
        "fallen": {
            "fall": fallen(estimator, sorted((real / "falls" / "fall").glob("*.jpg"))),
            "not_fall": fallen(estimator, sorted((real / "falls" / "not-fall").glob("*.jpg"))),
        },
        "cut_off": cut_off(estimator, read_pennfudan(real / "pennfudan")[1::2]),
        "leaning": {
            camera: leaning(estimator, real / "pose2sim", camera) for camera in POSE2SIM_CAMERAS
        },
        "fall_videos": fall_videos(estimator, real / "falls"),
        "upfall": upfall(estimator, sorted((real / "upfall").glob("*.mp4"))),
        "street": street(estimator, real / "vtest" / "vtest.avi"),
    }


def is_low(person: Person) -> bool:
    """Return whether the posture is reported as lying or crawling."""
    return person.posture is not None and person.posture.label in ON_THE_GROUND


def sport(estimator: Estimator, athletes: Iterable[Athlete]) -> dict[str, Figures]:
    """People in sport: found, and limb joints within a fifth of the trunk."""
    found: dict[str, list[tuple[float, float, float]]] = {kind: [] for kind in TRUNK_TILTS}
    for one in tqdm(athletes, desc="sport"):
        scores = [score_athlete(one, person) for person in estimate(estimator, one.encoded)]
        best = max(scores, key=lambda row: row[1] + row[2] + row[0] / 1e3, default=(0.0, 0.0, 0.0))
        tilt = abs(one.trunk_deg)
        kind = next(kind for kind, (low, high) in TRUNK_TILTS.items() if low <= tilt < high)
        found[kind].append(best)
    return {
        kind: {
            "people": len(rows),
            **{
                name: percent(column)
                for name, column in zip(
                    ("found", "keypoints_pck", "first_pck"), zip(*rows, strict=True), strict=True
                )
            },
        }
        for kind, rows in found.items()
        if rows
    }


def score_athlete(one: Athlete, person: Person) -> tuple[float, float, float]:
    """Return 1 for the annotated person, and the right shares of landmarks and of joints."""
    box, landmarks = person.box, person.landmarks
    x, y = one.limbs[_TRUNK].mean(axis=0)
    near = (box.x - 5 <= x <= box.right + 5) and (box.y - 5 <= y <= box.bottom + 5)
    if not near or landmarks is None or not person.hypotheses:
        return 0.0, 0.0, 0.0
    # Across, from each shoulder to the other side's hip.
    trunk = np.linalg.norm(one.limbs[[0, 1]] - one.limbs[[7, 6]], axis=1).max()
    read, first = (
        float((np.linalg.norm(p - one.limbs, axis=1)[one.visible] < NEAR_OF_TRUNK * trunk).mean())
        for p in (landmarks.positions[_LANDMARKS], person.hypotheses[0].points_2d[LIMB_ROWS])
    )
    return 1.0, read, first


def fallen(estimator: Estimator, files: Sequence[Path]) -> Figures:
    """Photographs with, or without, a fallen person."""
    people = [estimate(estimator, file.read_bytes()) for file in tqdm(files, desc="falls")]
    return {
        "photographs": len(files),
        "found": percent([bool(one) for one in people]),
        "on_the_ground": percent([any(map(is_low, one)) for one in people]),
    }


def cut_off(estimator: Estimator, photographs: Sequence[Photograph]) -> dict[str, Figures]:
    """Street people cut off by the upper or lower border of every second photograph.

    The truth is what is found in the whole photograph; the others were used in development.
    """
    rows: dict[str, list[tuple[float, float, float, float]]] = {}
    for photograph in tqdm(photographs, desc="cut off"):
        tallest = max(photograph.boxes, key=lambda box: box.height)
        whole = _person_at(tallest, estimate(estimator, encoded(photograph.frame)))
        if tallest.height < MIN_CUT_PX or whole is None or whole.landmarks is None:
            continue
        truth = whole.landmarks.positions[_LANDMARKS]
        for end, share in CUTS:
            name = f"{end}_{100 * share:.0f}"
            row = score_cut(estimator, photograph.frame, tallest, truth, end, share)
            rows.setdefault(name, []).append(row)
    return {name: summarise_cuts(np.array(table)) for name, table in rows.items()}


def score_cut(
    estimator: Estimator, frame: NDArray[np.uint8], tallest: Box, truth: NDArray[np.float64],
    end: str, share: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Cut a share of a person off; found, joints right that are seen and not, and flagged."""
    missing = round(share * tallest.height)
    top = round(tallest.y) + missing if end == "head" else 0
    bottom = frame.shape[0] if end == "head" else round(tallest.bottom) - missing
    box = Box(tallest.x, max(tallest.y - top, -0.5), tallest.width, tallest.height - missing)
    cut = np.ascontiguousarray(frame[top:bottom])
    person = _person_at(box, estimate(estimator, encoded(cut)))
    if person is None or not person.hypotheses or person.silhouette is None:
        return 0.0, np.nan, np.nan, 0.0
    apart = person.hypotheses[0].points_2d[LIMB_ROWS] + [0, top] - truth
    right = np.linalg.norm(apart, axis=1) < NEAR_OF_HEIGHT * tallest.height
    inside = (truth[:, 1] > top) & (truth[:, 1] < bottom)
    seen, unseen = (float(right[k].mean()) if k.any() else np.nan for k in (inside, ~inside))
    return 1.0, seen, unseen, float(person.silhouette.truncated)


def summarise_cuts(rows: NDArray[np.float64]) -> Figures:
    """Return the means of rows of :func:`score_cut`."""
    found, seen, unseen = 100 * np.nanmean(rows[:, :3], axis=0)
    return {
        "people": len(rows),
        "found": float(found),
        "seen_joints": float(seen),
        "unseen_joints": float(unseen),
        "flagged": percent(rows[rows[:, 0] == 1, 3]),
    }


def _person_at(box: Box, people: Sequence[Person]) -> Person | None:
    """Return the person in a box."""
    overlaps = [person.box.iou(box) for person in people]
    if max(overlaps, default=0.0) < SAME_PERSON:
        return None
    return people[int(np.argmax(overlaps))]


def leaning(estimator: Estimator, folder: Path, camera: str) -> Figures:
    """A balancing person before a calibrated camera: single frames, and a camera session."""
    video, _, limbs_3d, joints_2d = read_pose2sim_joints(folder, camera)
    session = CameraSession(estimator)
    single, tracked, low = [], [], []
    identities = set()
    frames = itertools.islice(read_frames(video), len(limbs_3d))
    for number, frame in tqdm(frames, desc=camera):
        truth = limbs_3d[number]
        if number % 4 == 0:
            (person,) = estimate(estimator, encoded(frame), generous_box(joints_2d[number]))
            errors = [error_mm(one.points_3d, truth) for one in person.hypotheses]
            single.append((errors[0], min(errors)))
            low.append(is_low(person))
        seen = [
            one for one in track(session, frame, number / 60).persons if one.pose and one.hypotheses
        ]
        if seen:
            one = max(seen, key=lambda other: other.box.height)
            assert one.pose is not None
            first = one.hypotheses[0]
            identities.add(one.track_id)
            tracked.append((error_mm(first.points_3d, truth), error_mm(one.pose.points_3d, truth)))
    first_mm, best_mm = np.mean(single, axis=0).tolist()
    session_first_mm, session_smooth_mm = np.mean(tracked, axis=0).tolist()
    return {
        "first_mm": first_mm,
        "best_mm": best_mm,
        "low": percent(low),
        "session_first_mm": session_first_mm,
        "session_smooth_mm": session_smooth_mm,
        "identities": len(identities),
    }


def generous_box(joints: NDArray[np.float64]) -> Box:
    """Return a box about joints ``(J, 2)`` as a caller might draw it."""
    low, high = joints.min(axis=0), joints.max(axis=0)
    height = float(high[1] - low[1])
    return Box(
        max(0.0, float(low[0]) - 0.06 * height),
        max(0.0, float(low[1]) - 0.08 * height),
        float(high[0] - low[0]) + 0.12 * height,
        1.14 * height,
    )


def error_mm(points_3d: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Return the mean distance of the limb joints about the hips, in millimetres."""
    apart = about_hips(points_3d[LIMB_ROWS]) - about_hips(truth)
    return float(1000 * np.linalg.norm(apart, axis=1).mean())


ALARMS = {"fell": ("fell",), "fell_or_lying": ("fell", "lying")}
"""Events that count as an alarm: with one of them, a fall is detected."""


def alarms_begin(frame: TrackedFrame) -> set[str]:
    """Return which of :data:`ALARMS` begin in a frame."""
    begun = {event.event for event in frame.events if event.state != "end"}
    return {name for name, events in ALARMS.items() if begun.intersection(events)}


def fall_videos(estimator: Estimator, folder: Path) -> dict[str, object]:
    """Care-home surveillance, every second frame, the last one held for four seconds."""
    detected: Counter[str] = Counter()
    seen, low = [], []
    for name, upright_until, fallen_from in FALL_VIDEOS:
        file = folder / f"{name}.mp4"
        fps = float(cv2.VideoCapture(str(file)).get(cv2.CAP_PROP_FPS)) or 25.0
        frames = [frame for _, frame in read_frames(file)]
        session = CameraSession(estimator)
        shown = [(i, frames[i], i / fps) for i in range(0, len(frames), 2)]
        end = (len(frames) - 1) / fps
        shown += [(len(frames), frames[-1], end + 0.2 * step) for step in range(1, 21)]
        alarms: set[str] = set()
        for number, frame, timestamp in shown:
            result = track(session, frame, timestamp)
            if number >= fallen_from:
                alarms |= alarms_begin(result)
            if number < upright_until:
                seen.append(bool(result.persons))
                low += [is_low(one) for one in result.persons]
        detected.update(alarms)
    return {
        "alarms": {
            name: {"falls": len(FALL_VIDEOS), "detected": detected[name]} for name in ALARMS
        },
        "seen_before_fall": percent(seen),
        "low_before_fall": percent(low),
    }


@dataclass
class Watched:
    """What a camera session reported of a video of UP-Fall.

    ``alarms`` are those of :data:`ALARMS` that begin; ``postures`` and ``actions`` are 1 where
    right, 0 where wrong and NaN where none is reported; ``low`` is whether a person lies or crawls
    in each frame.
    """

    activity: Activity
    alarms: set[str] = field(default_factory=set)
    low: list[bool] = field(default_factory=list)
    postures: list[float] = field(default_factory=list)
    actions: list[float] = field(default_factory=list)


def upfall(estimator: Estimator, files: Sequence[Path]) -> dict[str, object]:
    """UP-Fall: falls and daily activities at 6 frames a second."""
    watched = [watch(estimator, file) for file in tqdm(files, desc="UP-Fall")]
    falls = [one for one in watched if one.activity.is_fall]
    lying = [one for one in watched if one.activity.postures == ON_THE_GROUND]
    # Lying down is reported as an event, and rightly so: such activities have no false alarms.
    others = [
        one
        for one in watched
        if not one.activity.is_fall and one.activity.postures != ON_THE_GROUND
    ]
    upright = [one for one in watched if one.activity.is_upright]
    judged = [activity for activity in ACTIVITIES.values() if activity.postures]
    by_activity = {
        activity.name: [one for one in watched if one.activity is activity] for activity in judged
    }
    return {
        "alarms": {
            name: {
                "falls": len(falls),
                "detected": sum(name in one.alarms for one in falls),
                "activities": len(others),
                "false": sum(name in one.alarms for one in others),
            }
            for name in ALARMS
        },
        "low_of_upright": percent([low for one in upright for low in one.low]),
        "low_of_lying": percent([low for one in lying for low in one.low]),
        **{
            kind: {
                name: _right_or_none([right for one in some for right in getattr(one, kind)])
                for name, some in by_activity.items()
            }
            for kind in ("postures", "actions")
        },
    }


def watch(estimator: Estimator, file: Path) -> Watched:
    """Send a video of UP-Fall to a camera session."""
    activity = ACTIVITIES[int(file.name.split("_")[0].removeprefix("activity"))]
    watched, session = Watched(activity), CameraSession(estimator)
    for number, frame in read_frames(file):
        if not activity.is_fall and number >= UPFALL_FRAMES:
            break
        if number % UPFALL_STEP:
            continue
        result = track(session, frame, number / UPFALL_FPS)
        watched.alarms |= alarms_begin(result)
        watched.low.append(any(is_low(one) for one in result.persons))
        actor = _actor(result.persons)
        if actor is not None and activity.postures:
            posture, action = actor.posture, actor.action
            label = "unclear" if posture is None else posture.label
            watched.postures.append(np.nan if label == "unclear" else label in activity.postures)
            watched.actions.append(np.nan if action is None else action.label in activity.actions)
    return watched


def _actor(persons: Sequence[TrackedPerson]) -> TrackedPerson | None:
    """Return the largest person apart from the onlooker."""
    rest = [one for one in persons if one.box.x < ONLOOKER_FROM_PX]
    return max(rest, key=lambda one: one.box.area, default=None)


def _right_or_none(answers: Sequence[float]) -> Figures:
    """Return the percentages of answers that are right, and that are NaN."""
    if not answers:
        return {}
    none = np.isnan(answers)
    return {"right": 100 * float(np.nansum(answers)) / len(answers), "none": percent(none)}


def street(estimator: Estimator, video: Path, frames: int = STREET_FRAMES) -> Figures:
    """The street video as a camera: everybody walks or stands."""
    session = CameraSession(estimator)
    postures: list[str] = []
    actions: list[str] = []
    sides: dict[int, list[float]] = {}
    left, right = POINT_NAMES.index("left_shoulder"), POINT_NAMES.index("right_shoulder")
    for number, frame in tqdm(itertools.islice(read_frames(video), frames), desc="street"):
        for one in track(session, frame, number / 10).persons:
            if one.posture is not None:
                postures.append(one.posture.label)
            if one.pose is not None:
                x = one.pose.points_3d[:, 0]
                sides.setdefault(one.track_id, []).append(float(np.sign(x[left] - x[right])))
            if one.action is not None:
                actions.append(one.action.label)
    long = [track for track in sides.values() if len(track) >= MIN_TRACK]
    return {
        "frames": frames,
        "low": percent([label in LOW for label in postures]),
        "unclear": percent([label == "unclear" for label in postures]),
        "sides_exchanged": percent([a != b for one in long for a, b in itertools.pairwise(one)]),
        "walk": percent([label == "walk" for label in actions]),
    }
