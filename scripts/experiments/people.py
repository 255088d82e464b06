"""The people experiment: sport, falls, leaning bodies, cameras. What must be right, or unclear.

Asks the estimator and camera sessions in this process about ``../shared/real``. Of these data the
fall photographs, the sports photographs (detection and confidence alone), and the street video
(detection, ground) were learned from; UP-Fall, the fall videos and Pose2Sim were not.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.estimation.estimator import Estimator
from app.estimation.results import Person
from app.estimation.upload import Upload
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from app.tracking.results import TrackedFrame, TrackedPerson
from app.tracking.session import CameraSession
from app.vision.geometry import Box
from app.vision.people import LANDMARK_NAMES
from index.posture import ON_THE_GROUND
from index.skeleton import LIMBS, POINT_NAMES
from scripts.experiments.asking import HYPOTHESES, estimate
from scripts.experiments.real_data import read_frames, read_pennfudan
from scripts.results import machine, revision

COMMAND = "python -m scripts.evaluate people"
CUT_FROM_PX, SAME_PERSON = 180, 0.3
"""Height of people who are cut off, and overlap (IoU) from which a box is theirs."""

FALL_VIDEOS = (("video_3", 80, 90), ("video_5", 120, 135))
"""Videos, the frames before which everybody stands, and from which on somebody has fallen."""

ACTIVITIES: dict[int, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    6: ("walks", ("walking", "standing"), ("walk",)),
    7: ("stands", ("standing",), ("stand",)),
    8: ("sits", ("sitting",), ("sit",)),
    10: ("jumps", ("standing", "crouching", "bending", "arms_raised"), ("jump",)),
    11: ("lies", ON_THE_GROUND, ("lie",)),
}
"""Of UP-Fall's activities what people do, in which postures, and with which actions."""

ONLOOKER_FROM_PX = 500.0

_ROWS = [POINT_NAMES.index(name) for name in LIMBS]
_LANDMARKS = [LANDMARK_NAMES.index(name) for name in LIMBS]
_HIPS = [LIMBS.index("left_hip"), LIMBS.index("right_hip")]
# Names of the limbs in the files of Pose2Sim.
_TRIANGULATED = {
    f"{side}_{part}": f"{side[0].upper()}{part.capitalize()}"
    for side in ("left", "right")
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
}

Row = tuple[str, str, str]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add no options."""


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks."""
    real = options.shared / "real"
    if not real.is_dir():
        raise FileNotFoundError(f"expected {real} to hold photographs and videos, it is not there")
    estimator = load_estimator(Settings())
    rows = [
        *sport(estimator, real / "lsp"),
        *fallen(estimator, real / "falls"),
        *cut_off(estimator, real / "pennfudan"),
        *leaning(estimator, real / "pose2sim"),
        *fall_videos(estimator, real / "falls"),
        *upfall(estimator, real / "upfall"),
        *street(estimator, real / "vtest"),
    ]
    table = "".join(f"| {data} | {what} | {figure} |\n" for data, what, figure in rows)
    page = (
        "# People who fall, sit, lie, lean or do sport\n\n"
        f"`{COMMAND}` at revision {revision()}, {machine()}.\n\n"
        "| data | | |\n|---|---|---|\n" + table
    )
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "people.md").write_text(page)
    print(table)


def _encoded(frame: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())


def grounded(person: Person) -> bool:
    """Whether somebody is said to lie or crawl."""
    return person.posture is not None and person.posture.label in ON_THE_GROUND


def sport(estimator: Estimator, folder: Path) -> list[Row]:
    """People in sport: found, and limb joints within a fifth of the trunk."""
    document = json.loads((folder / "joints.json").read_text())
    names = document["joint_names"]
    order = [names.index(name) for name in LIMBS]
    found: dict[str, list[tuple[float, float, float]]] = {}
    for one in tqdm(document["people"], desc="sport"):
        joints, seen = np.array(one["joints_2d"]), np.array(one["visible"])[order]
        trunk = max(
            float(np.linalg.norm(joints[names.index(f"{side}_shoulder")] - joints[hip]))
            for side, hip in (
                ("left", names.index("right_hip")),
                ("right", names.index("left_hip")),
            )
        )
        limbs = joints[order]
        middle = limbs[
            [LIMBS.index(f"{s}_{p}") for s in ("left", "right") for p in ("hip", "shoulder")]
        ]
        best = (0.0, 0.0, 0.0)
        for person in estimate(estimator, (folder / one["image"]).read_bytes()):
            box = person.observed.box
            centre = middle.mean(axis=0)
            near = (box.x - 5 <= centre[0] <= box.right + 5) and (
                box.y - 5 <= centre[1] <= box.bottom + 5
            )
            landmarks = person.observed.landmarks
            if not near or landmarks is None or not person.hypotheses:
                continue
            read, first = (
                float((np.linalg.norm(places - limbs, axis=1)[seen] < 0.2 * trunk).mean())
                for places in (
                    landmarks.positions[_LANDMARKS],
                    person.hypotheses[0].points_2d[_ROWS],
                )
            )
            best = max(best, (1.0, read, first), key=lambda row: row[1] + row[2] + row[0] / 1e3)
        tilt = abs(one["trunk_deg"])
        kind = "upright" if tilt < 45 else "horizontal" if tilt < 135 else "inverted"
        found.setdefault(kind, []).append(best)
    kinds = [kind for kind in ("upright", "horizontal", "inverted") if kind in found]
    shares = 100 * np.array([np.mean(found[kind], axis=0) for kind in kinds])
    count = ", ".join(f"{len(found[kind])} {kind}" for kind in kinds)
    return [
        (f"LSP Extended ({count})", what, " / ".join(f"{share:.1f}" for share in column) + " %")
        for what, column in zip(
            ("found", "keypoints, PCK 0.2", "first hypothesis, PCK 0.2"), shares.T, strict=True
        )
    ]


def fallen(estimator: Estimator, folder: Path) -> list[Row]:
    """Photographs of people who fell, and who did not."""
    rows = []
    for kind, what in (("fall", "people who fell"), ("not-fall", "people who did not")):
        files = sorted((folder / kind).glob("*.jpg"))
        people = [estimate(estimator, file.read_bytes()) for file in tqdm(files, desc=kind)]
        found = 100 * np.mean([bool(one) for one in people])
        low = 100 * np.mean([any(map(grounded, one)) for one in people])
        rows.append((f"{len(files)} photographs of {what}", "somebody found", f"{found:.1f} %"))
        rows.append(
            (f"{len(files)} photographs of {what}", "somebody on the ground", f"{low:.1f} %")
        )
    return rows


def cut_off(estimator: Estimator, folder: Path) -> list[Row]:
    """Street people of every second photograph, cut off by its upper or lower border.

    Truth is what the whole photograph shows of them; the others were looked at in development.
    """
    rows: list[tuple[str, bool, float, float, bool]] = []
    for photograph in tqdm(read_pennfudan(folder)[1::2], desc="cut off"):
        tallest = max(photograph.boxes, key=lambda box: box.height)
        whole = _at(tallest, estimate(estimator, _encoded(photograph.frame)))
        if tallest.height < CUT_FROM_PX or whole is None or whole.observed.landmarks is None:
            continue
        truth = whole.observed.landmarks.positions[_LANDMARKS]
        for end, share in itertools.product(("head", "feet"), (0.2, 0.35, 0.5)):
            missing = round(share * tallest.height)
            top = round(tallest.y) + missing if end == "head" else 0
            bottom = photograph.frame.shape[0] if end == "head" else round(tallest.bottom) - missing
            frame = np.ascontiguousarray(photograph.frame[top:bottom])
            box = Box(
                tallest.x, max(tallest.y - top, -0.5), tallest.width, tallest.height - missing
            )
            name = f"{end}, {100 * share:.0f} %"
            person = _at(box, estimate(estimator, _encoded(frame)))
            if person is None or not person.hypotheses or person.observed.silhouette is None:
                rows.append((name, False, np.nan, np.nan, False))
                continue
            apart = person.hypotheses[0].points_2d[_ROWS] + [0, top] - truth
            right = np.linalg.norm(apart, axis=1) < 0.1 * tallest.height
            inside = (truth[:, 1] > top) & (truth[:, 1] < bottom)
            seen, unseen = (
                float(right[k].mean()) if k.any() else np.nan for k in (inside, ~inside)
            )
            rows.append((name, True, seen, unseen, person.observed.silhouette.truncated))
    told = []
    for name in dict.fromkeys(row[0] for row in rows):
        figures = np.array([row[1:] for row in rows if row[0] == name], np.float64)
        found, seen, unseen = 100 * np.nanmean(figures[:, :3], axis=0)
        flagged = 100 * figures[figures[:, 0] == 1, 3].mean()
        what = (
            f"{name} of the height missing: found / joints within a tenth: seen, unseen / flagged"
        )
        told.append(
            (
                f"{len(figures)} street people cut off by the border",
                what,
                f"{found:.0f} / {seen:.0f}, {unseen:.0f} / {flagged:.0f} %",
            )
        )
    return told


def _at(box: Box, people: tuple[Person, ...]) -> Person | None:
    """Who is in a box."""
    overlaps = [person.observed.box.iou(box) for person in people]
    if max(overlaps, default=0.0) < SAME_PERSON:
        return None
    return people[int(np.argmax(overlaps))]


def leaning(estimator: Estimator, folder: Path) -> list[Row]:
    """A balancing person before two calibrated cameras: single frames, and a camera session."""
    rows: list[Row] = []
    for camera in ("cam01", "cam03"):
        document = json.loads((folder / f"{camera}.json").read_text())
        order = [document["joint_names"].index(_TRIANGULATED[name]) for name in LIMBS]
        truths, places = np.array(document["joints_3d"]), np.array(document["joints_2d"])
        session = CameraSession(estimator)
        single, followed, told, identities = [], [], [], set()
        frames = read_frames(folder / document["video"])
        for number, frame in tqdm(list(frames)[: len(truths)], desc=camera):
            truth = truths[number][order]
            if number % 4 == 0:
                box = _padded(places[number])
                (person,) = estimate(estimator, _encoded(frame), box)
                errors = [_error_mm(one.points_3d, truth) for one in person.hypotheses]
                single.append((errors[0], min(errors)))
                told.append(grounded(person))
            tracked = session.process(Upload(_encoded(frame)), number / 60, HYPOTHESES, Job())
            seen = [one for one in tracked.persons if one.pose and one.person.hypotheses]
            if seen:
                one = max(seen, key=lambda other: other.person.observed.box.height)
                assert one.pose is not None
                identities.add(one.track_id)
                followed.append(
                    (
                        _error_mm(one.person.hypotheses[0].points_3d, truth),
                        _error_mm(one.pose.points_3d, truth),
                    )
                )
        first, best = np.mean(single, axis=0)
        frame_mm, smooth_mm = np.mean(followed, axis=0)
        data = f"Pose2Sim {camera}"
        rows += [
            (data, "true box: first / best of 7", f"{first:.0f} / {best:.0f} mm"),
            (data, "said to lie or crawl", f"{100 * np.mean(told):.1f} %"),
            (
                data,
                "camera session: first / smooth, identities",
                f"{frame_mm:.0f} / {smooth_mm:.0f} mm, {len(identities)}",
            ),
        ]
    return rows


def _padded(joints: NDArray[np.float64]) -> Box:
    low, high = joints.min(axis=0), joints.max(axis=0)
    height = float(high[1] - low[1])
    return Box(
        max(0.0, float(low[0]) - 0.06 * height),
        max(0.0, float(low[1]) - 0.08 * height),
        float(high[0] - low[0]) + 0.12 * height,
        1.14 * height,
    )


def _error_mm(points_3d: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Mean distance of the limb joints about the hips, millimetres."""
    limbs = points_3d[_ROWS]
    own, true = (limb - limb[_HIPS].mean(axis=0) for limb in (limbs, truth))
    return float(1000 * np.linalg.norm(own - true, axis=1).mean())


def begins(frame: TrackedFrame) -> bool:
    """Whether somebody falls or lies from this frame on."""
    return any(event.event in ("fell", "lying") and event.state != "end" for event in frame.events)


def fall_videos(estimator: Estimator, folder: Path) -> list[Row]:
    """Care-home surveillance, every second frame, the last one held for four seconds."""
    told, seen, low = 0, [], []
    for name, upright_until, fallen_from in FALL_VIDEOS:
        video = cv2.VideoCapture(str(folder / f"{name}.mp4"))
        fps = float(video.get(cv2.CAP_PROP_FPS)) or 25.0
        frames = [frame for _, frame in read_frames(folder / f"{name}.mp4")]
        session = CameraSession(estimator)
        shown = [(i, frames[i], i / fps) for i in range(0, len(frames), 2)]
        end = (len(frames) - 1) / fps
        shown += [(len(frames), frames[-1], end + 0.2 * step) for step in range(1, 21)]
        hit = False
        for number, frame, time in shown:
            result = session.process(Upload(_encoded(frame)), time, HYPOTHESES, Job())
            hit |= number >= fallen_from and begins(result)
            if number < upright_until:
                seen.append(bool(result.persons))
                low += [grounded(one.person) for one in result.persons]
        told += hit
    return [
        ("two care-home videos", "falls told", f"{told} of {len(FALL_VIDEOS)}"),
        (
            "two care-home videos",
            "before the fall: somebody seen / said to lie or crawl",
            f"{100 * np.mean(seen):.1f} / {100 * np.mean(low):.1f} %",
        ),
    ]


def upfall(estimator: Estimator, folder: Path) -> list[Row]:
    """UP-Fall: falls and daily activities at 6 frames a second."""
    falls, activities, upright, lying = [], [], [], []
    postures: dict[str, list[float]] = {name: [] for name, *_ in ACTIVITIES.values()}
    actions: dict[str, list[float]] = {name: [] for name, *_ in ACTIVITIES.values()}
    for file in tqdm(sorted(folder.glob("*.mp4")), desc="UP-Fall"):
        activity = int(file.name.split("_")[0].removeprefix("activity"))
        session, hit, low = CameraSession(estimator), False, []
        for number, frame in read_frames(file):
            if activity > 5 and number >= 144:
                break
            if number % 3:
                continue
            result = session.process(Upload(_encoded(frame)), number / 18, HYPOTHESES, Job())
            hit |= begins(result)
            low.append(any(grounded(one.person) for one in result.persons))
            if activity in ACTIVITIES and (actor := _actor(result.persons)):
                name, shown, done = ACTIVITIES[activity]
                posture = actor.person.posture
                label = "unclear" if posture is None else posture.label
                postures[name].append(np.nan if label == "unclear" else label in shown)
                action = actor.action
                actions[name].append(np.nan if action is None else action.label in done)
        if activity <= 5:
            falls.append(hit)
        elif activity < 11:
            activities.append(hit)
        if activity in (6, 7, 9, 10):
            upright += low
        if activity == 11:
            lying += low
    return [
        ("UP-Fall, held out", "falls told", f"{sum(falls)} of {len(falls)}"),
        (
            "UP-Fall, held out",
            "activities with a false alarm",
            f"{sum(activities)} of {len(activities)}",
        ),
        (
            "UP-Fall, held out",
            "frames in which somebody lies or crawls: of upright activities / of lying",
            f"{100 * np.mean(upright):.1f} / {100 * np.mean(lying):.1f} %",
        ),
        *(
            ("UP-Fall, held out", f"{what} of who {name}: right / none told", _right_or_none(told))
            for what, by_activity in (("posture", postures), ("action", actions))
            for name, told in by_activity.items()
        ),
    ]


def _actor(persons: Sequence[TrackedPerson]) -> TrackedPerson | None:
    """Who does what the video is of: the largest, apart from who sits in a corner of camera 2."""
    rest = [one for one in persons if one.person.observed.box.x < ONLOOKER_FROM_PX]
    return max(rest, key=lambda one: one.person.observed.box.area, default=None)


def _right_or_none(told: Sequence[float]) -> str:
    """Percent of answers that are right, and that are NaN."""
    none = np.isnan(told)
    return f"{100 * np.nansum(told) / len(told):.0f} / {100 * none.mean():.0f} %"


def street(estimator: Estimator, folder: Path, frames: int = 300) -> list[Row]:
    """The street video as a camera: everybody walks or stands."""
    session = CameraSession(estimator)
    postures: list[str] = []
    sides: dict[int, list[float]] = {}
    actions: list[str] = []
    left, right = POINT_NAMES.index("left_shoulder"), POINT_NAMES.index("right_shoulder")
    for number, frame in tqdm(list(read_frames(folder / "vtest.avi"))[:frames]):
        result = session.process(Upload(_encoded(frame)), number / 10, HYPOTHESES, Job())
        for one in result.persons:
            if one.person.posture is not None:
                postures.append(one.person.posture.label)
            if one.pose is not None:
                points = one.pose.points_3d
                side = float(np.sign(points[left, 0] - points[right, 0]))
                sides.setdefault(one.track_id, []).append(side)
            if one.action is not None:
                actions.append(one.action.label)
    long = [track for track in sides.values() if len(track) >= 10]
    flips = [a != b for track in long for a, b in itertools.pairwise(track)]
    low = [label in (*ON_THE_GROUND, "sitting", "kneeling", "crouching") for label in postures]
    return [
        (
            f"PETS 2009, {frames} frames",
            "said to be low / unclear",
            f"{100 * np.mean(low):.1f} / {100 * np.mean([p == 'unclear' for p in postures]):.1f} %",
        ),
        (
            f"PETS 2009, {frames} frames",
            "left and right exchanged from pose to pose / action `walk`",
            f"{100 * np.mean(flips):.1f} / {100 * np.mean([a == 'walk' for a in actions]):.0f} %",
        ),
    ]
