"""Estimates as models of the public contract."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.api import schemas
from app.api.coco import compressed, polygon, run_lengths
from app.estimation.facing import Facing
from app.estimation.posture_probability import EstimatedPosture
from app.estimation.results import Estimate, Person, ProjectedHypothesis
from app.vision.detector import DetectorName
from app.vision.geometry import COCO_NAMES, LANDMARK_NAMES, Landmarks, Silhouette
from index.skeleton import KEYPOINT_SETS, NATIVE, KeypointSet
from index.store import Entry, Label, PoseIndex

METRE_DIGITS, PIXEL_DIGITS = 4, 2
"""Joints are rounded to tenths of millimetres and hundredths of pixels."""

SIGNIFICANT_DIGITS = 4
"""Of distances in which a network's single precision has a part."""

DISTANCE_DIGITS = 4
"""Distances are rounded to far more than double precision loses on the way to them, so that the
same request has the same answer on every processor."""


LEAST_SCORE = 0.05
"""Keypoints below were not read."""


@dataclass(frozen=True)
class ReplyForm:
    """The form in which a caller wants an answer.

    Parameters
    ----------
    keypoints : KeypointSet
    silhouettes : str
        ``none``, or COCO's ``rle`` or ``polygon``.
    observed : str
        Keypoints of the photograph: ``coco17`` or ``blazepose33``.
    joints : str
        ``full``: as objects; ``compact``: as plain numbers; ``none``.
    """

    keypoints: KeypointSet
    silhouettes: schemas.SilhouetteForm = "none"
    joints: schemas.JointForm = "full"
    observed: schemas.ObservedSetName = "coco17"


def significant(value: float) -> float:
    """Round to :data:`SIGNIFICANT_DIGITS`."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def pose_reply(estimate: Estimate, index: PoseIndex, form: ReplyForm) -> schemas.PoseResponse:
    """Write the answer to a frame."""
    return schemas.PoseResponse(
        **frame_fields(estimate.frame, estimate.timings_ms, index, form),
        persons=[
            schemas.Person(**person_fields(person, estimate.frame.shape, form))
            for person in estimate.persons
        ],
    )


def frame_fields(
    frame: NDArray[np.uint8],
    timings_ms: Mapping[str, float],
    index: PoseIndex,
    form: ReplyForm,
) -> dict[str, Any]:
    """Write what answers say of a frame besides its people."""
    height, width = frame.shape[:2]
    return {
        "image": schemas.ImageSize(width=width, height=height),
        "index": schemas.IndexVersion(name=index.name, version=index.version),
        "keypoints": _keypoints(form.keypoints),
        "timings_ms": schemas.Timings(**{k: round(v, 3) for k, v in timings_ms.items()}),
    }


def index_reply(
    index: PoseIndex, version: str, revision: str, detector: DetectorName
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
        service=schemas.ServiceVersion(version=version, revision=revision, detector=detector),
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


def person_fields(person: Person, frame_shape: tuple[int, ...], form: ReplyForm) -> dict[str, Any]:
    """Write what a frame tells of a person."""
    observed, facing, silhouette = person.observed, person.facing, person.observed.silhouette
    return {
        "box": schemas.Box(
            x=round(observed.box.x, 2),
            y=round(observed.box.y, 2),
            width=round(observed.box.width, 2),
            height=round(observed.box.height, 2),
        ),
        "detection_score": _rounded(observed.detection_score, 4),
        "source": observed.source,
        "silhouette": _silhouette(silhouette, frame_shape, form) if silhouette else None,
        "observed_keypoints": (
            _observed(observed.landmarks, form.observed) if observed.landmarks else None
        ),
        "facing": _facing(facing) if facing else None,
        "posture": _posture(person.posture) if person.posture else None,
        "hypotheses": [
            _hypothesis(hypothesis, rank, form)
            for rank, hypothesis in enumerate(person.hypotheses, start=1)
        ],
    }


def _silhouette(
    silhouette: Silhouette, frame_shape: tuple[int, ...], form: ReplyForm
) -> schemas.SilhouetteSummary:
    return schemas.SilhouetteSummary(
        area_px=silhouette.area_px,
        segmenter=silhouette.segmenter,
        truncated=silhouette.truncated,
        rle=_run_lengths(silhouette, frame_shape) if form.silhouettes == "rle" else None,
        polygon=polygon(silhouette) if form.silhouettes == "polygon" else None,
    )


def _run_lengths(silhouette: Silhouette, frame_shape: tuple[int, ...]) -> schemas.RunLengths:
    counts = compressed(run_lengths(silhouette, frame_shape))
    return schemas.RunLengths(counts=counts, size=list(frame_shape[:2]))


def _observed(
    landmarks: Landmarks, keypoints: schemas.ObservedSetName
) -> list[schemas.ObservedKeypoint | None]:
    names = COCO_NAMES if keypoints == "coco17" else LANDMARK_NAMES
    rows = [LANDMARK_NAMES.index(name) for name in names]
    values = np.column_stack([landmarks.positions, landmarks.metres[:, 2], landmarks.visibility])[
        rows
    ]
    return [
        schemas.ObservedKeypoint(
            name=name, x=round(x, 2), y=round(y, 2), z=round(z, 4), score=round(score, 4)
        )
        if score >= LEAST_SCORE
        else None
        for name, (x, y, z, score) in zip(names, values.tolist(), strict=True)
    ]


def _facing(facing: Facing) -> schemas.Facing:
    return schemas.Facing(
        front_probability=round(facing.front_probability, 4), evidence=facing.evidence
    )


def _posture(posture: EstimatedPosture) -> schemas.Posture:
    return schemas.Posture(label=posture.label, probability=round(posture.probability, 4))


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def _hypothesis(hypothesis: ProjectedHypothesis, rank: int, form: ReplyForm) -> schemas.Hypothesis:
    # Not validated: for its hundreds of points that would take a third of the time of writing an
    # answer, and the values are our own. The tests validate whole answers.
    return schemas.Hypothesis.model_construct(
        rank=rank,
        entry=hypothesis.entry_id,
        distance=significant(hypothesis.distance),
        silhouette_distance=round(hypothesis.silhouette_distance, DISTANCE_DIGITS),
        reprojection_error_px=round(hypothesis.reprojection_error_px, 3),
        confidence=round(hypothesis.confidence, 4),
        adjusted_mm=round(1000 * hypothesis.adjusted_m, 1),
        posture=hypothesis.posture,
        **joint_fields(hypothesis.points_3d, hypothesis.points_2d, form),
        source=_source(hypothesis.label),
        camera=_camera(hypothesis.label),
    )


def joint_fields(
    points_3d: NDArray[np.float64], points_2d: NDArray[np.float64], form: ReplyForm
) -> dict[str, Any]:
    """Write joints in the form wanted; the fields of the other forms are null."""
    keypoints, full, compact = form.keypoints, form.joints == "full", form.joints == "compact"
    return {
        "joints_3d": _points_3d(points_3d, keypoints) if full else None,
        "joints_2d": _points_2d(points_2d, keypoints) if full else None,
        "joints_3d_flat": _flat(points_3d, keypoints, METRE_DIGITS) if compact else None,
        "joints_2d_flat": _flat(points_2d, keypoints, PIXEL_DIGITS) if compact else None,
    }


def _source(label: Label) -> schemas.MotionSource:
    return schemas.MotionSource(
        clip=label.clip,
        frame=label.frame,
        subject=label.subject,
        action=label.action,
        mirrored=label.mirrored,
    )


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
    """A point that the entry lacks is NaN there and null here."""
    return [
        {"x": x, "y": y, "z": z} if math.isfinite(x + y + z) else None
        for x, y, z in points.take(keypoints.indices, axis=0).round(METRE_DIGITS).tolist()
    ]


def _points_2d(points: NDArray[np.float64], keypoints: KeypointSet) -> list[schemas.Point2D | None]:
    """A point that the entry lacks is NaN there and null here."""
    return [
        {"x": x, "y": y} if math.isfinite(x + y) else None
        for x, y in points.take(keypoints.indices, axis=0).round(PIXEL_DIGITS).tolist()
    ]


def _flat(points: NDArray[np.float64], keypoints: KeypointSet, digits: int) -> list[float | None]:
    """All coordinates in one list; a point that the entry lacks is NaN there and nulls here."""
    rows: list[list[float]] = points.take(keypoints.indices, axis=0).round(digits).tolist()
    return [v for row in rows for v in (row if math.isfinite(sum(row)) else [None] * len(row))]
