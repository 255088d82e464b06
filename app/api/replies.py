"""Estimates, tracked frames, sessions and videos as models of the public contract."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api import schemas, tracking_schemas
from app.cameras import CameraSettings, CameraSummary, SessionSummary
from app.estimation.results import Estimate, Person, ProjectedHypothesis
from app.estimation.upload import MIN_BOX_PX
from app.film import TrackSummary, VideoEnd, VideoSummary
from app.settings import Method
from app.tracking.results import (
    EVENT_NAMES,
    Event,
    RecognisedAction,
    SmoothedPose,
    TrackedFrame,
    TrackedPerson,
)
from app.tracking.zones import Zone, crosses_itself, is_outside
from app.vision.optics import Optics, PinholeCamera
from app.vision.people import COCO_NAMES, LANDMARK_NAMES, Landmarks, Silhouette
from index.skeleton import KEYPOINT_SETS, NATIVE, KeypointSet
from index.store import Entry, Label, PoseIndex

SIZE_SD = 0.1
"""Standard deviation of the logarithm of a body's size, and so of its distance."""


def run_lengths(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Count the pixels of a frame down its columns, in turn outside and inside a silhouette.

    The first count is of pixels outside; it is 0 if the first pixel lies inside.
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
    """Return the outlines of a silhouette's parts, each ``[x1, y1, x2, y2, ...]`` in frame pixels.

    They run through the centres of the outermost pixels and have at least three points, as COCO
    requires; holes are omitted.
    """
    outlines = silhouette.outlines(cv2.CHAIN_APPROX_SIMPLE)
    # np.resize repeats the points of an outline that has only one or two.
    return [
        np.resize(outline, (max(3, len(outline)), 2)).ravel().astype(float).tolist()
        for outline in outlines
    ]


METRE_DIGITS, PIXEL_DIGITS, SECOND_DIGITS = 4, 2, 4
"""Decimals of joints and of times."""

SIGNIFICANT_DIGITS = 4
"""Digits of distances that depend on a network, which has single precision."""

DISTANCE_DIGITS = 4
"""Decimals of silhouette distances, few enough that every processor gives the same answer."""

MIN_FOV_DEG = 0.01
"""Least field of view that is written: that of a frame of one column could be rounded to 0."""

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
    """Round to :data:`SIGNIFICANT_DIGITS`."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def pose_reply(
    estimate: Estimate,
    index: PoseIndex,
    form: ReplyForm,
    checkpoint: Callable[[], None] = lambda: None,
) -> schemas.PoseResponse:
    """Write the answer to a frame.

    ``checkpoint`` is called before each person; it raises an error if the answer is no longer
    wanted.
    """

    def write(person: Person) -> schemas.Person:
        checkpoint()
        return schemas.Person(**person_fields(person, estimate.frame.shape, estimate.camera, form))

    return schemas.PoseResponse(
        **frame_fields(estimate, index, form),
        persons=[write(person) for person in estimate.persons],
    )


def frame_fields(seen: Estimate, index: PoseIndex, form: ReplyForm) -> dict[str, Any]:
    """Write the fields of a frame besides its people."""
    height, width = seen.frame.shape[:2]
    return {
        "image": schemas.Image(
            width=width,
            height=height,
            fov_deg=max(MIN_FOV_DEG, round(seen.camera.fov_deg, 2)),
            fov_given=seen.camera.given,
            warnings=list(seen.warnings),
        ),
        "index": schemas.IndexVersion(name=index.name, version=index.version),
        "keypoints": _keypoints(form.keypoints),
        "timings_ms": schemas.Timings(**{k: round(v, 3) for k, v in seen.timings_ms.items()}),
    }


def index_reply(
    index: PoseIndex, version: str, revision: str, method: Method
) -> schemas.IndexResponse:
    """Describe an index."""
    parameters = dict(index.parameters)
    return schemas.IndexResponse(
        name=index.name,
        version=index.version,
        entries=len(index),
        descriptor=schemas.DescriptorSummary(
            name=index.descriptor.name, dimension=index.descriptor.dimension
        ),
        joints=list(NATIVE.names),
        bones=_bones(NATIVE),
        actions=list(index.actions),
        subjects=list(index.subjects),
        attribution=str(parameters.pop("attribution", "")),
        parameters=parameters,
        service=schemas.ServiceVersion(
            version=version,
            revision=revision,
            detector="hog" if method == "paper" else "network",
        ),
    )


def entry_reply(entry: Entry, keypoints: schemas.KeypointSetName) -> schemas.EntryResponse:
    """Describe an entry of an index."""
    chosen = KEYPOINT_SETS[keypoints]
    return schemas.EntryResponse(
        entry=entry.entry_id,
        source=_source(entry),
        camera=_camera(entry),
        keypoints=_keypoints(chosen),
        joints_3d=_points_3d(entry.points_3d, chosen),
        joints_2d=_points_2d(entry.points_normalised, chosen),
    )


def person_fields(
    person: Person, frame_shape: tuple[int, ...], camera: PinholeCamera, form: ReplyForm
) -> dict[str, Any]:
    """Write the fields of a person in a single frame."""
    facing, posture = person.facing, person.posture
    box, score = person.box, person.detection_score
    silhouette, landmarks = person.silhouette, person.landmarks
    return {
        "box": schemas.Box(
            x=round(box.x, 2),
            y=round(box.y, 2),
            width=max(MIN_BOX_PX, round(box.width, 2)),
            height=max(MIN_BOX_PX, round(box.height, 2)),
        ),
        "detection_score": None if score is None else round(score, 4),
        "source": person.source,
        "window_empty": person.window_empty,
        "silhouette": silhouette and _silhouette(silhouette, frame_shape, form),
        "observed_keypoints": landmarks and _observed(landmarks, form.observed),
        "facing": None
        if facing is None
        else schemas.Facing(
            front_probability=round(facing.front_probability, 4), evidence=facing.evidence
        ),
        "posture": None
        if posture is None
        else schemas.Posture(label=posture.label, probability=round(posture.probability, 4)),
        "position": None if person.hips is None or not camera.given else _position(person.hips),
        "hypotheses": [
            _hypothesis(projected, rank, form)
            for rank, projected in enumerate(person.hypotheses, start=1)
        ],
    }


def _position(pelvis: NDArray[np.float64]) -> schemas.Position:
    x, y, z = (round(value, 2) for value in pelvis.tolist())
    distance = float(np.linalg.norm(pelvis))
    return schemas.Position(x=x, y=y, z=z, sd=round(SIZE_SD * distance, 2))


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
        schemas.ObservedKeypoint(
            name=name,
            x=round(x, 2),
            y=round(y, 2),
            z=round(z, 4),
            sd=round(sd, 3),
            score=round(score, 4),
        )
        if score >= MIN_SCORE
        else None
        for name, (x, y, z, sd, score) in zip(names, values.tolist(), strict=True)
    ]


def _hypothesis(hypothesis: ProjectedHypothesis, rank: int, form: ReplyForm) -> schemas.Hypothesis:
    # The model is not validated: its hundreds of points would add a third to the time that writing
    # an answer takes, and the values are our own. The tests validate whole answers.
    return schemas.Hypothesis.model_construct(
        rank=rank,
        entry=hypothesis.entry_id,
        distance=significant(hypothesis.distance),
        silhouette_distance=round(hypothesis.silhouette_distance, DISTANCE_DIGITS),
        reprojection_error_px=round(hypothesis.reprojection_error_px, 3),
        alternative="depth" if hypothesis.in_depth else None,
        confidence=round(hypothesis.confidence, 4),
        weight=None if hypothesis.weight is None else round(hypothesis.weight, 4),
        adjusted_mm=round(1000 * hypothesis.adjusted_m, 1),
        posture=hypothesis.posture,
        **joint_fields(hypothesis.points_3d, hypothesis.points_2d, form),
        source=schemas.HypothesisSource(**dict(_source(hypothesis.label)), twin=hypothesis.twin),
        camera=_camera(hypothesis.label),
    )


def joint_fields(
    points_3d: NDArray[np.float64], points_2d: NDArray[np.float64], form: ReplyForm
) -> dict[str, Any]:
    """Write joints in the chosen form; the fields of the other forms are null."""
    keypoints, full, compact = form.keypoints, form.joints == "full", form.joints == "compact"
    return {
        "joints_3d": _points_3d(points_3d, keypoints) if full else None,
        "joints_2d": _points_2d(points_2d, keypoints) if full else None,
        "joints_3d_flat": _flat(points_3d, keypoints, METRE_DIGITS) if compact else None,
        "joints_2d_flat": _flat(points_2d, keypoints, PIXEL_DIGITS) if compact else None,
    }


def _source(label: Label) -> schemas.MotionSource:
    return schemas.MotionSource.model_validate(label, from_attributes=True)


def _camera(label: Label) -> schemas.Camera:
    return schemas.Camera(
        azimuth_deg=round(label.azimuth_deg, 2) % 360.0,
        elevation_deg=round(label.elevation_deg, 2),
        roll_deg=round(label.roll_deg, 2),
    )


@cache
def _keypoints(keypoints: KeypointSet) -> schemas.Keypoints:
    return schemas.Keypoints.model_validate(
        {"set": keypoints.name, "names": list(keypoints.names), "bones": _bones(keypoints)}
    )


def _bones(keypoints: KeypointSet) -> list[schemas.Bone]:
    return [schemas.Bone(parent=parent, child=child) for parent, child in keypoints.bones]


def _points_3d(points: NDArray[np.float64], keypoints: KeypointSet) -> list[schemas.Point3D | None]:
    """Write points; one that the entry lacks is NaN in the array and null here."""
    return [
        {"x": x, "y": y, "z": z} if math.isfinite(x + y + z) else None
        for x, y, z in points.take(keypoints.indices, axis=0).round(METRE_DIGITS).tolist()
    ]


def _points_2d(points: NDArray[np.float64], keypoints: KeypointSet) -> list[schemas.Point2D | None]:
    """Write points; one that the entry lacks is NaN in the array and null here."""
    return [
        {"x": x, "y": y} if math.isfinite(x + y) else None
        for x, y in points.take(keypoints.indices, axis=0).round(PIXEL_DIGITS).tolist()
    ]


def _flat(points: NDArray[np.float64], keypoints: KeypointSet, digits: int) -> list[float | None]:
    """Write all coordinates in one list; a point that the entry lacks becomes nulls."""
    rows: list[list[float]] = points.take(keypoints.indices, axis=0).round(digits).tolist()
    return [v for row in rows for v in (row if math.isfinite(sum(row)) else [None] * len(row))]


def track_reply(
    frame: TrackedFrame, camera_id: str, index: PoseIndex, form: ReplyForm
) -> tracking_schemas.TrackResponse:
    """Write the answer to a frame of a camera."""
    return tracking_schemas.TrackResponse(
        camera_id=camera_id, **_tracked_fields(frame, index, form)
    )


def sequence_frame_reply(
    frame: TrackedFrame, video_frame: int, index: PoseIndex, form: ReplyForm
) -> tracking_schemas.SequenceFrame:
    """Write the line of a frame of a video."""
    return tracking_schemas.SequenceFrame(
        type="frame", video_frame=video_frame, **_tracked_fields(frame, index, form)
    )


def sequence_end_reply(summary: VideoSummary, end: VideoEnd) -> tracking_schemas.SequenceEnd:
    """Write the last line of the answer to a video."""
    return tracking_schemas.SequenceEnd(
        type="end",
        reason=end.reason,
        detail=end.detail,
        frames=summary.frames,
        damaged=summary.damaged,
        tracks=[_track_summary(track) for _, track in sorted(summary.tracks.items())],
        events=[_event(event) for event in summary.events],
    )


def sequence_line(reply: tracking_schemas.SequenceLine) -> bytes:
    """Write a line of the answer to a video."""
    return reply.model_dump_json().encode() + b"\n"


def camera_reply(camera: CameraSummary) -> tracking_schemas.CameraState:
    """Describe a camera."""
    zones, optics = camera.settings.zones, camera.settings.optics
    return tracking_schemas.CameraState(
        camera_id=camera.camera_id,
        zones=[
            tracking_schemas.Zone(name=zone.name, kind=zone.kind, polygon=zone.polygon.tolist())
            for zone in zones
        ],
        zones_crossing=[zone.name for zone in zones if crosses_itself(zone.polygon)],
        fov_deg=optics.fov_deg,
        pixel_aspect=optics.pixel_aspect,
        roll_deg=optics.roll_deg,
        events=[name for name in EVENT_NAMES if name in camera.settings.events],
        **(_session_fields(camera.session, zones) if camera.session else _NO_SESSION),
    )


_NO_SESSION: dict[str, Any] = {
    **dict.fromkeys(("zones_outside", "track_ids"), ()),
    **dict.fromkeys(("frames", "memory_bytes"), 0),
    **dict.fromkeys(("timestamp", "image", "age_s", "idle_s")),
}


def _session_fields(session: SessionSummary, zones: Sequence[Zone]) -> dict[str, Any]:
    shape = session.height, session.width
    return {
        "zones_outside": [zone.name for zone in zones if is_outside(zone.polygon, shape)],
        "frames": session.frames,
        "timestamp": round(session.timestamp, SECOND_DIGITS),
        "image": schemas.ImageSize(width=session.width, height=session.height),
        "track_ids": list(session.track_ids),
        "age_s": round(session.age_s, SECOND_DIGITS),
        "idle_s": round(session.idle_s, SECOND_DIGITS),
        "memory_bytes": session.memory_bytes,
    }


def events_reply(camera_id: str, events: Iterable[Event]) -> tracking_schemas.CameraEvents:
    """List the latest events of a camera."""
    return tracking_schemas.CameraEvents(camera_id=camera_id, events=list(map(_event, events)))


def settings_from(configuration: tracking_schemas.CameraConfiguration) -> CameraSettings:
    """Convert a camera's configuration."""
    zones = [
        Zone(zone.name, zone.kind, np.array(zone.polygon, float)) for zone in configuration.zones
    ]
    optics = Optics(configuration.fov_deg, configuration.pixel_aspect, configuration.roll_deg)
    raised = EVENT_NAMES if configuration.events is None else configuration.events
    return CameraSettings(tuple(zones), optics, frozenset(raised))


def _tracked_fields(frame: TrackedFrame, index: PoseIndex, form: ReplyForm) -> dict[str, Any]:
    return {
        **frame_fields(frame, index, form),
        "frame_index": frame.frame_index,
        "timestamp": round(frame.timestamp, SECOND_DIGITS),
        "reset": frame.reset,
        "persons": [
            _tracked_person(tracked, frame.frame.shape, frame.camera, form)
            for tracked in frame.persons
        ],
        "events": [_event(event) for event in frame.events],
    }


def _tracked_person(
    tracked: TrackedPerson,
    frame_shape: tuple[int, ...],
    camera: PinholeCamera,
    form: ReplyForm,
) -> tracking_schemas.TrackedPerson:
    return tracking_schemas.TrackedPerson(
        **person_fields(tracked, frame_shape, camera, form),
        track_id=tracked.track_id,
        age_frames=tracked.age_frames,
        pose=_smoothed_pose(tracked.pose, form) if tracked.pose else None,
        action=_action(tracked.action) if tracked.action else None,
        zones=list(tracked.zones),
        caller_track_id=tracked.caller_track_id,
        still_s=None if tracked.still_s is None else round(tracked.still_s, SECOND_DIGITS),
        on_floor=None if tracked.on_floor is None else round(tracked.on_floor, 4),
    )


def _smoothed_pose(pose: SmoothedPose, form: ReplyForm) -> tracking_schemas.SmoothedPose:
    # The model is not validated; see _hypothesis.
    return tracking_schemas.SmoothedPose.model_construct(
        entry=pose.entry,
        confidence=round(pose.confidence, 4),
        **joint_fields(pose.points_3d, pose.points_2d, form),
    )


def _action(action: RecognisedAction) -> tracking_schemas.Action:
    return tracking_schemas.Action(label=action.label, probability=round(action.probability, 4))


def _event(event: Event) -> tracking_schemas.Event:
    return tracking_schemas.Event(
        event=event.event,
        track_id=event.track_id,
        state=event.state,
        timestamp=round(event.timestamp, SECOND_DIGITS),
        probability=round(event.probability, 4),
        zones=list(event.zones),
        caller_track_id=event.caller_track_id,
        dwell_s=None if event.dwell_s is None else round(event.dwell_s, SECOND_DIGITS),
        lost=event.lost,
        on_floor=None if event.on_floor is None else round(event.on_floor, 4),
    )


def _track_summary(track: TrackSummary) -> tracking_schemas.TrackSummary:
    action = track.action()
    return tracking_schemas.TrackSummary(
        track_id=track.track_id,
        first_timestamp=round(track.first_timestamp, SECOND_DIGITS),
        last_timestamp=round(track.last_timestamp, SECOND_DIGITS),
        frames=track.frames,
        action=_action(action) if action else None,
        postures=[
            tracking_schemas.PostureTime(label=label, seconds=round(seconds, SECOND_DIGITS))
            for label, seconds in track.postures()
        ],
    )
