"""What landmarks show of a body is what was projected into them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.results import Person
from app.tracking.results import SmoothedPose
from app.tracking.seen_body import SeenBody
from app.vision.people import LANDMARK_NAMES, Landmarks, Silhouette
from index.posture import POSTURES, camera_up, classify_postures
from index.posture import azimuth_deg as seen_azimuth_deg
from index.skeleton import POINT_NAMES, camera_rotation
from tests.app.tracking.people import person_of, standing_body

PX_PER_M, CENTRE = 90.0, np.array([300.0, 200.0])


def with_landmarks(points_3d: NDArray[np.float64]) -> Person:
    """A person whose landmarks are the points of a skeleton ``(24, 3)`` in camera axes."""
    metres = np.zeros((len(LANDMARK_NAMES), 3))
    for row, name in enumerate(LANDMARK_NAMES):
        name = name.replace("foot_index", "toe").replace("heel", "ankle")
        if name in POINT_NAMES:
            metres[row] = points_3d[POINT_NAMES.index(name)]
    landmarks = Landmarks(CENTRE + PX_PER_M * metres[:, :2], np.ones(len(metres)), metres)
    person = person_of([points_3d], [0.8], (300.0, 200.0))
    crop = np.ones((int(person.box.height), int(person.box.width)), bool)
    silhouette = Silhouette(crop, 270, 115, "network", truncated=False)
    return replace(person, landmarks=landmarks, silhouette=silhouette)


def seen(points_3d: NDArray[np.float64]) -> SeenBody:
    body = SeenBody.of(with_landmarks(points_3d))
    assert body is not None
    return body


@pytest.mark.parametrize("elevation_deg", [0.0, 15.0, 30.0, 45.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 70.0, -120.0, 180.0])
def test_landmarks_show_elevation_scale_and_heading(
    azimuth_deg: float, elevation_deg: float
) -> None:
    points = standing_body() @ camera_rotation(azimuth_deg, elevation_deg).T
    body = seen(points)
    assert body.elevation_deg == pytest.approx(elevation_deg, abs=9)
    assert body.px_per_m == pytest.approx(PX_PER_M)
    assert body.azimuths_deg == pytest.approx(seen_azimuth_deg(points[None]))


def test_landmarks_make_a_skeleton_of_the_index() -> None:
    points = standing_body() @ camera_rotation(30.0, 10.0).T
    skeleton = seen(points).skeleton
    assert skeleton is not None
    np.testing.assert_allclose(skeleton, points, atol=0.1)
    posture = classify_postures(skeleton[None], camera_up(10.0))[0]
    assert POSTURES[posture] == "standing"


def test_a_smooth_pose_gives_a_silhouette_its_skeleton() -> None:
    points = standing_body() @ camera_rotation(30.0, 10.0).T
    body = SeenBody.of(person_of([points], [0.8]))
    assert body is not None and body.skeleton is None
    pose = SmoothedPose(points, CENTRE + PX_PER_M * points[:, :2], 0.8, 0, np.zeros(10))
    seen_in_pose = body.in_pose(pose)
    assert seen_in_pose.skeleton is points
    assert seen_in_pose.px_per_m == pytest.approx(PX_PER_M)
    assert seen_in_pose.hips_px == pytest.approx(CENTRE)


def test_nothing_is_seen_without_landmarks_and_hypotheses() -> None:
    person = with_landmarks(standing_body())
    assert SeenBody.of(replace(person, landmarks=None, hypotheses=())) is None
