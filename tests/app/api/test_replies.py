"""Answers as JSON."""

from dataclasses import replace

import numpy as np
import pytest

from app.api.replies import ReplyForm, joint_fields, pose_reply
from app.estimation.results import Estimate
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.vision.optics import PinholeCamera
from index.skeleton import NATIVE
from tests.conftest import Photo


@pytest.fixture(scope="module")
def estimate(estimator: Estimator, photo: Photo) -> Estimate:
    return estimator.estimate(Upload(photo.frame_png, mask=photo.mask_png), 2, Job())


def test_a_frame_of_one_column_has_a_field_of_view(
    estimate: Estimate, estimator: Estimator
) -> None:
    narrow = replace(estimate, camera=PinholeCamera.of_frame((10**6, 1)))
    reply = pose_reply(narrow, estimator.index, ReplyForm(NATIVE))
    assert reply.image.fov_deg == 0.01


def test_a_joint_that_an_entry_lacks_is_null_in_every_form() -> None:
    pose = np.arange(72.0).reshape(24, 3)
    pose[1, 2] = np.nan
    assert joint_fields(pose, pose[:, :2], ReplyForm(NATIVE))["joints_3d"][1] is None
    flat = joint_fields(pose, pose[:, :2], ReplyForm(NATIVE, joints="compact"))["joints_3d_flat"]
    assert flat[:9] == [0, 1, 2, None, None, None, 6, 7, 8]
