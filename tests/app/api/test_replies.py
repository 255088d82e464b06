"""Answers as JSON."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.api.replies import (
    ReplyForm,
    joint_fields,
    pose_reply,
    track_reply,
)
from app.api.tracking_schemas import TrackResponse
from app.estimation.results import Estimate, Facing
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.results import Event, RecognisedAction, SmoothedPose, TrackedFrame, TrackedPerson
from app.vision.optics import PinholeCamera
from index.skeleton import NATIVE
from tests.conftest import Photo

EVENT = Event("fell", 3, "instant", 12.34567, 0.93, ("kitchen",), "17")


@pytest.fixture(scope="module")
def estimate(estimator: Estimator, photo: Photo) -> Estimate:
    return estimator.estimate(Upload(photo.frame_png, mask=photo.mask_png), 2, Job())


@pytest.fixture(scope="module")
def frame(estimate: Estimate) -> TrackedFrame:
    """A frame with a person who has walked for a while."""
    (person,) = estimate.persons
    best = person.hypotheses[0]
    pose = SmoothedPose(best.points_3d, best.points_2d, 0.91234567, best.entry_id)
    tracked = TrackedPerson(
        **vars(person) | {"facing": Facing(0.75, "motion")},
        track_id=3,
        age_frames=41,
        pose=pose,
        action=RecognisedAction("walk", 0.875),
    )
    return TrackedFrame(
        frame=estimate.frame,
        camera=estimate.camera,
        warnings=("dark",),
        frame_index=40,
        timestamp=12.34567,
        session="warm",
        reset="the frames had another size",
        persons=(tracked,),
        events=(EVENT,),
        timings_ms=estimate.timings_ms,
    )


def test_a_frame_of_one_column_has_a_field_of_view(
    estimate: Estimate, estimator: Estimator
) -> None:
    narrow = replace(estimate, camera=PinholeCamera.of_frame((10**6, 1)))
    reply = pose_reply(narrow, estimator.index, ReplyForm(NATIVE))
    assert reply.image.fov_deg == 0.01


def test_a_tracked_reply_adds_results_over_time(frame: TrackedFrame, estimator: Estimator) -> None:
    reply = track_reply(frame, "yard", estimator.index, ReplyForm(NATIVE))
    answer = TrackResponse.model_validate_json(reply.model_dump_json())
    assert (answer.camera_id, answer.frame_index, answer.timestamp) == ("yard", 40, 12.3457)
    assert answer.reset == "the frames had another size"
    (person,) = answer.persons
    assert (person.track_id, person.age_frames) == (3, 41)
    assert person.action is not None
    assert (person.action.label, person.action.probability) == ("walk", 0.875)
    assert person.facing is not None
    assert person.facing.evidence == "motion"
    assert person.pose is not None
    assert person.pose.confidence == 0.9123
    assert person.pose.entry == person.hypotheses[0].entry
    (event,) = answer.events
    assert (event.event, event.track_id, event.state) == ("fell", 3, "instant")
    assert (event.timestamp, event.probability) == (12.3457, 0.93)
    assert (event.zones, event.caller_track_id) == (["kitchen"], "17")


def test_a_person_without_a_smoothed_pose_has_null(
    frame: TrackedFrame, estimator: Estimator
) -> None:
    unknown = replace(frame.persons[0], pose=None, action=None)
    reply = track_reply(
        replace(frame, persons=(unknown,)), "yard", estimator.index, ReplyForm(NATIVE)
    )
    (person,) = TrackResponse.model_validate_json(reply.model_dump_json()).persons
    assert (person.pose, person.action) == (None, None)


def test_a_joint_that_an_entry_lacks_is_null_in_every_form() -> None:
    pose = np.arange(72.0).reshape(24, 3)
    pose[1, 2] = np.nan
    assert joint_fields(pose, pose[:, :2], ReplyForm(NATIVE))["joints_3d"][1] is None
    flat = joint_fields(pose, pose[:, :2], ReplyForm(NATIVE, joints="compact"))["joints_3d_flat"]
    assert flat[:9] == [0, 1, 2, None, None, None, 6, 7, 8]
