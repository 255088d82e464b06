"""Estimates, tracked frames, sessions and videos as models of the public contract."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api import schemas, tracking_schemas
from app.api.schemas import METRE_DIGITS, PIXEL_DIGITS
from app.cameras import CameraSummary
from app.configuration import EVENT_NAMES, Zone
from app.estimation.results import Estimate, Person
from app.settings import Method
from app.tracking.results import Event, SmoothedPose, TrackedFrame, TrackedPerson
from app.tracking.zones import crosses_itself, is_outside
from app.vision.people import COCO_NAMES, LANDMARK_NAMES, Landmarks, Silhouette
from index.matching import PoseHypothesis
from index.skeleton import KEYPOINT_SETS, NATIVE, KeypointSet
from index.store import Entry, PoseIndex


def run_lengths(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Count the pixels of a frame down its columns, in turn outside and inside a silhouette.

    The first count, of pixels outside, is 0 if the first pixel lies inside.
    """
    height, width = frame_shape[:2]
    # Working in one dimension is several times as fast; no run crosses the margin of a column.
    columns = np.pad(silhouette.crop.T, ((0, 0), (1, 1)))
    pixels = columns.ravel()
    changes = np.flatnonzero(pixels[1:] != pixels[:-1])
    column, row = np.divmod(changes, columns.shape[1])
    edges = (silhouette.left + column) * height + silhouette.top + row
    # A run may continue at the top of the next column.
    changes, times = np.unique(edges, return_counts=True)
    ends = np.unique(np.append(changes[times == 1], width * height))
    return np.diff(ends, prepend=0)


def compressed(counts: NDArray[np.int64]) -> str:
    """Write run lengths as pycocotools does.

    From the fourth on, a count is replaced by its difference from the last but one. Each number is
    written in groups of five bits, the lowest first; a sixth bit says whether more follow.
    """
    left = counts.copy()
    left[3:] -= counts[1:-2]
    groups = []
    more = np.ones(len(left), bool)
    while more.any():
        written, bits = more, left & 31
        left >>= 5
        more = written & (left != np.where(bits & 16, -1, 0))
        groups.append(np.where(written, 48 + bits + 32 * more, 0).astype(np.uint8))
    letters = np.array(groups, np.uint8).T.ravel()
    return letters[letters > 0].tobytes().decode()


def polygon(silhouette: Silhouette) -> list[list[float]]:
    """Outlines of a silhouette's parts, each ``[x1, y1, x2, y2, ...]`` in frame pixels.

    They run through the centres of the outermost pixels and have at least three points, as COCO
    requires; holes are omitted.
    """
    outlines = silhouette.outlines(cv2.CHAIN_APPROX_SIMPLE)
    # np.resize repeats the points of an outline that has only one or two.
    return [
        np.resize(outline, (max(3, len(outline)), 2)).ravel().astype(float).tolist()
        for outline in outlines
    ]


SIGNIFICANT_DIGITS = 4
"""Digits of distances that depend on a network, which has single precision."""

MIN_SCORE = 0.05
"""A keypoint with a lower score is null."""


@dataclass(frozen=True)
class ReplyForm:
    """The form of an answer, chosen by the query parameters of the same names."""

    keypoints: KeypointSet
    silhouettes: schemas.SilhouetteForm = "none"
    joints: schemas.JointForm = "full"
    observed: schemas.ObservedSetName = "coco17"


def significant(value: float) -> float:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def pose_reply(
    estimate: Estimate,
    index: PoseIndex,
    form: ReplyForm,
    checkpoint: Callable[[], None] = lambda: None,
) -> schemas.PoseResponse:
    """Write the answer to a frame.

    ``checkpoint`` is called before each person; it raises an error if the answer is not wanted.
    """

    def write(person: Person) -> schemas.Person:
        checkpoint()
        return schemas.Person(**_person_fields(person, estimate, form))

    persons = [write(person) for person in estimate.persons]
    return schemas.PoseResponse(**_frame_fields(estimate, index, form), persons=persons)


def tracked_fields(frame: TrackedFrame, index: PoseIndex, form: ReplyForm) -> dict[str, Any]:
    return {
        **_frame_fields(frame, index, form),
        "frame_index": frame.frame_index,
        "timestamp": frame.timestamp,
        "reset": frame.reset,
        "persons": [_tracked_person(tracked, frame, form) for tracked in frame.persons],
        "events": frame.events,
    }


def _frame_fields(seen: Estimate, index: PoseIndex, form: ReplyForm) -> dict[str, Any]:
    height, width = seen.frame.shape[:2]
    return {
        "image": schemas.Image(
            width=width,
            height=height,
            fov_deg=seen.camera.fov_deg,
            fov_given=seen.camera.given,
            warnings=list(seen.warnings),
        ),
        "index": index,
        "keypoints": _keypoints(form.keypoints),
        "timings_ms": seen.timings_ms,
    }


def index_reply(
    index: PoseIndex, version: str, revision: str, method: Method
) -> schemas.IndexResponse:
    parameters = dict(index.parameters)
    return schemas.IndexResponse.model_validate(
        {
            "name": index.name,
            "version": index.version,
            "entries": len(index),
            "descriptor": index.descriptor,
            "joints": list(NATIVE.names),
            "bones": _bones(NATIVE),
            "actions": list(index.actions),
            "subjects": list(index.subjects),
            "attribution": str(parameters.pop("attribution", "")),
            "parameters": parameters,
            "service": schemas.ServiceVersion(
                version=version,
                revision=revision,
                detector="hog" if method == "paper" else "network",
            ),
        }
    )


def entry_reply(entry: Entry, keypoints: schemas.KeypointSetName) -> schemas.EntryResponse:
    chosen = KEYPOINT_SETS[keypoints]
    return schemas.EntryResponse.model_validate(
        {
            "entry": entry.entry_id,
            "source": entry,
            "camera": entry,
            "keypoints": _keypoints(chosen),
            "joints_3d": _points(entry.points_3d, chosen, METRE_DIGITS),
            "joints_2d": _points(entry.points_normalised, chosen, PIXEL_DIGITS),
        }
    )


def _person_fields(person: Person, seen: Estimate, form: ReplyForm) -> dict[str, Any]:
    silhouette, landmarks = person.silhouette, person.landmarks
    return {
        "box": person.box,
        "detection_score": person.detection_score,
        "source": person.source,
        "window_empty": person.window_empty,
        "silhouette": silhouette and _silhouette(silhouette, seen.frame.shape, form),
        "observed_keypoints": landmarks and _observed(landmarks, form.observed),
        "facing": person.facing,
        "posture": person.posture,
        "position": _position(person.hips) if seen.camera.given else None,
        "hypotheses": [
            _hypothesis(projected, rank, form)
            for rank, projected in enumerate(person.hypotheses, start=1)
        ],
    }


def _position(hips: NDArray[np.float64] | None) -> schemas.Position | None:
    if hips is None:
        return None
    x, y, z = hips.tolist()
    # Standard deviation of the logarithm of a body's size, and so of its distance.
    return schemas.Position(x=x, y=y, z=z, sd=0.1 * float(np.linalg.norm(hips)))


def _silhouette(
    silhouette: Silhouette, frame_shape: tuple[int, ...], form: ReplyForm
) -> schemas.SilhouetteSummary:
    rle = None
    if form.silhouettes == "rle":
        counts = compressed(run_lengths(silhouette, frame_shape))
        rle = schemas.RunLengths(counts=counts, size=list(frame_shape[:2]))
    return schemas.SilhouetteSummary(
        area_px=silhouette.area_px,
        segmenter=silhouette.segmenter,
        truncated=silhouette.truncated,
        rle=rle,
        polygon=polygon(silhouette) if form.silhouettes == "polygon" else None,
    )


def _observed(
    landmarks: Landmarks, keypoints: schemas.ObservedSetName
) -> list[schemas.ObservedKeypoint | None]:
    names = COCO_NAMES if keypoints == "coco17" else LANDMARK_NAMES
    rows = [LANDMARK_NAMES.index(name) for name in names]
    depths = landmarks.metres[:, 2:], landmarks.depth_sd[:, None]
    values = np.hstack([landmarks.positions, *depths, landmarks.visibility[:, None]])[rows]
    return [
        schemas.ObservedKeypoint(name=name, x=x, y=y, z=z, sd=sd, score=score)
        if score >= MIN_SCORE
        else None
        for name, (x, y, z, sd, score) in zip(names, values.tolist(), strict=True)
    ]


def _hypothesis(hypothesis: PoseHypothesis, rank: int, form: ReplyForm) -> schemas.Hypothesis:
    # The model is not validated: its hundreds of points would add a third to the time that writing
    # an answer takes, and the values are our own. The tests validate whole answers.
    return schemas.Hypothesis.model_construct(
        rank=rank,
        entry=hypothesis.entry_id,
        distance=significant(hypothesis.distance),
        silhouette_distance=round(hypothesis.silhouette_distance, 4),
        reprojection_error_px=round(hypothesis.reprojection_error_px, 3),
        alternative="depth" if hypothesis.in_depth else None,
        confidence=round(hypothesis.confidence, 4),
        weight=None if hypothesis.weight is None else round(hypothesis.weight, 4),
        adjusted_mm=round(1000 * hypothesis.adjusted_m, 1),
        posture=hypothesis.posture,
        **joint_fields(hypothesis.points_3d, hypothesis.points_2d, form),
        source=schemas.HypothesisSource(
            **dict(schemas.MotionSource.model_validate(hypothesis.label)), twin=hypothesis.twin
        ),
        camera=schemas.Camera.model_validate(hypothesis.label),
    )


def joint_fields(
    points_3d: NDArray[np.float64], points_2d: NDArray[np.float64], form: ReplyForm
) -> dict[str, Any]:
    """Write joints in the chosen form; the fields of the other forms are null."""
    keypoints, full, compact = form.keypoints, form.joints == "full", form.joints == "compact"
    return {
        "joints_3d": _points(points_3d, keypoints, METRE_DIGITS) if full else None,
        "joints_2d": _points(points_2d, keypoints, PIXEL_DIGITS) if full else None,
        "joints_3d_flat": _flat(points_3d, keypoints, METRE_DIGITS) if compact else None,
        "joints_2d_flat": _flat(points_2d, keypoints, PIXEL_DIGITS) if compact else None,
    }


@cache
def _keypoints(keypoints: KeypointSet) -> schemas.Keypoints:
    return schemas.Keypoints.model_validate(
        {"set": keypoints.name, "names": list(keypoints.names), "bones": _bones(keypoints)}
    )


def _bones(keypoints: KeypointSet) -> list[schemas.Bone]:
    return [schemas.Bone(parent=parent, child=child) for parent, child in keypoints.bones]


def _points(points: NDArray[np.float64], keypoints: KeypointSet, digits: int) -> list[Any]:
    """Write points ``(K, 2)`` or ``(K, 3)``; one that the entry lacks is NaN, and null here."""
    return [
        dict(zip("xyz", row, strict=False)) if math.isfinite(sum(row)) else None
        for row in points.take(keypoints.indices, axis=0).round(digits).tolist()
    ]


def _flat(points: NDArray[np.float64], keypoints: KeypointSet, digits: int) -> list[float | None]:
    """Write all coordinates in one list; a point that the entry lacks becomes nulls."""
    rows: list[list[float]] = points.take(keypoints.indices, axis=0).round(digits).tolist()
    return [v for row in rows for v in (row if math.isfinite(sum(row)) else [None] * len(row))]


def camera_reply(camera: CameraSummary) -> tracking_schemas.CameraState:
    settings, session = camera.settings, camera.session
    polygons = {zone.name: np.array(zone.polygon) for zone in settings.zones}
    return tracking_schemas.CameraState.model_validate(
        {
            "camera_id": camera.camera_id,
            **dict(settings),
            "zones_outside": [
                name
                for name, polygon in polygons.items()
                if session and is_outside(polygon, (session.image.height, session.image.width))
            ],
            "zones_crossing": [name for name, one in polygons.items() if crosses_itself(one)],
            "events": [name for name in EVENT_NAMES if settings.raises(name)],
            **(vars(session) if session else _NO_SESSION),
        }
    )


_NO_SESSION: dict[str, Any] = {
    **dict.fromkeys(("timestamp", "image", "age_s", "idle_s")),
    **{"frames": 0, "track_ids": (), "memory_bytes": 0},
}


def replay_reply(camera_id: str, event: Event, zones: Sequence[Zone]) -> dict[str, Any]:
    """Describe the replay of an event."""
    replay = event.replay
    assert replay is not None
    (height, width), moments = replay.shape[:2], list(replay.moments)
    return {
        "camera_id": camera_id,
        "event": event,
        "image": {"width": width, "height": height},
        "zones": zones,
        "complete": replay.is_complete,
        "frames": [
            {
                "timestamp": one.timestamp,
                "box": one.box,
                "joints": [
                    None if math.isnan(x) else {"x": x, "y": y} for x, y in one.joints.tolist()
                ],
                "outline": one.outline.ravel().tolist() or None,
            }
            for one in moments
        ],
    }


def _tracked_person(
    tracked: TrackedPerson, seen: Estimate, form: ReplyForm
) -> tracking_schemas.TrackedPerson:
    return tracking_schemas.TrackedPerson.model_validate(
        {
            **_person_fields(tracked, seen, form),
            "track_id": tracked.track_id,
            "age_frames": tracked.age_frames,
            "pose": _smoothed_pose(tracked.pose, form) if tracked.pose else None,
            "action": tracked.action,
            "zones": tracked.zones,
            "caller_track_id": tracked.caller_track_id,
            "still_s": tracked.still_s,
            "on_floor": tracked.on_floor,
        }
    )


def _smoothed_pose(pose: SmoothedPose, form: ReplyForm) -> tracking_schemas.SmoothedPose:
    # The model is not validated; see _hypothesis.
    return tracking_schemas.SmoothedPose.model_construct(
        entry=pose.entry,
        confidence=round(pose.confidence, 4),
        **joint_fields(pose.points_3d, pose.points_2d, form),
    )
