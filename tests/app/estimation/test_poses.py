"""People normalised for matching, and skeletons placed before the camera."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from app.estimation.poses import NormalisedPerson, place_skeletons
from app.vision.optics import PinholeCamera, to_line_of_sight
from app.vision.people import LANDMARK_NAMES, Landmarks, Silhouette, silhouette_from_mask
from descriptor.silhouette import is_wide, normalise, principal_axis_deg
from index.skeleton import (
    LIMBS,
    OTHER_SIDE,
    POINT_NAMES,
    mirror_3d,
    rotate_clockwise,
    rows,
    side_rows,
)
from tests.support.figures import stick_figure
from tests.support.projection import project

SHAPE = (300, 300)
CENTRE = np.array([149.5, 149.5])
WIDE_DEG = pytest.mark.parametrize("angle", [-120.0, -90.0, -65.0, 70.0, 90.0, 115.0])
ANY_DEG = pytest.mark.parametrize("angle", [-135.0, -90.0, -30.0, 0.0, 20.0, 90.0, 120.0, 180.0])


def about_centre(angle: float) -> NDArray[np.float64]:
    """Affine transform ``(2, 3)`` of the frame that rotates it clockwise about its middle."""
    return cv2.getRotationMatrix2D(CENTRE.tolist(), -angle, 1.0)


def moved(points: NDArray[np.float64], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    return points @ transform[:, :2].T + transform[:, 2]


def silhouette_of(mask: NDArray[np.generic], angle: float = 0.0) -> Silhouette:
    """The silhouette of a mask of the frame that is rotated clockwise."""
    rotated = cv2.warpAffine(mask.astype(np.float32), about_centre(angle), SHAPE[::-1])
    silhouette = silhouette_from_mask(rotated >= 0.5, segmenter="mask", truncated=False)
    assert silhouette is not None
    return silhouette


def standing() -> NDArray[np.bool_]:
    """A person with one arm out, so that every rotation looks different."""
    mask = np.zeros(SHAPE, bool)
    mask[90:210, 135:165] = True
    mask[110:122, 165:190] = True
    return mask


def landmark(point: str) -> int:
    """Row of the landmark of a point of the index."""
    return LANDMARK_NAMES.index(point.replace("_toe", "_foot_index"))


def seen(scores: float | NDArray[np.float64] = 0.5, angle: float = 0.0) -> Landmarks:
    rng = np.random.default_rng(0)
    places = rng.uniform((135, 90), (190, 210), (33, 2))
    metres = rotate_clockwise(rng.normal(0, 0.3, (33, 3)), angle)
    visibility = np.broadcast_to(scores, 33).astype(np.float64)
    return Landmarks(moved(places, about_centre(angle)), visibility, metres)


def person(angle: float = 0.0, landmarks: Landmarks | None = None) -> NormalisedPerson:
    """`standing`, rotated clockwise in the frame."""
    return NormalisedPerson.of(silhouette_of(standing(), angle), landmarks)


def landmarks_in_frame(one: NormalisedPerson) -> NDArray[np.float64]:
    landmarks = one.normalised_landmarks()
    assert landmarks is not None
    return one.points_in_frame(landmarks.positions)


@pytest.mark.parametrize("angle", [-35.0, -10.0, 0.0, 30.0, 180.0])
def test_narrow_silhouette_is_not_rotated(angle: float) -> None:
    silhouette = silhouette_of(standing(), angle)
    one = NormalisedPerson.of(silhouette, None)
    assert one.roll_deg == 0
    assert_array_equal(one.silhouette, normalise(silhouette.crop)[0])
    assert one.to_frame[0, 0] == one.to_frame[1, 1]
    assert one.to_frame[0, 1] == one.to_frame[1, 0] == 0


@WIDE_DEG
def test_wide_silhouette_is_rotated_upright(angle: float) -> None:
    one = person(angle)
    assert abs(one.roll_deg) > 40
    assert not is_wide(one.silhouette)
    assert principal_axis_deg(one.silhouette) == pytest.approx(0, abs=3)
    # Head or feet up, as large as a standing person.
    assert one.silhouette.any(axis=1).sum() > 100


@ANY_DEG
def test_landmarks_map_back_to_the_frame(angle: float) -> None:
    observed = seen(angle=angle)
    one = person(angle, observed)
    landmarks = one.normalised_landmarks()
    assert landmarks is not None
    shown = [landmark(POINT_NAMES[row]) for row in landmarks.rows]
    assert_allclose(landmarks_in_frame(one), observed.positions[shown], atol=1e-9)
    assert_array_equal(landmarks.scores, observed.visibility[shown])
    # In depth they are turned with the silhouette.
    limbs = observed.metres[rows(*LIMBS, among=LANDMARK_NAMES)]
    assert_allclose(rotate_clockwise(landmarks.limbs_3d, -one.roll_deg), limbs, atol=1e-9)


@ANY_DEG
def test_silhouette_maps_back_to_the_frame(angle: float) -> None:
    silhouette = silhouette_of(standing(), angle)
    one = NormalisedPerson.of(silhouette, None)
    pixels = np.argwhere(one.silhouette)[:, ::-1].astype(float)
    x, y = np.rint(one.points_in_frame(pixels)).astype(int).T
    mask = silhouette.mask(SHAPE)
    assert mask[y.clip(0, 299), x.clip(0, 299)].mean() > 0.97
    # All of it.
    area = one.silhouette.sum() * np.linalg.det(one.to_frame[:, :2])
    assert area == pytest.approx(mask.sum(), rel=0.03)


def test_visible_limbs_nose_and_toes_are_used() -> None:
    compared = {*LIMBS, "nose", "left_toe", "right_toe"}
    landmarks = person(landmarks=seen()).normalised_landmarks()
    assert landmarks is not None
    assert {POINT_NAMES[row] for row in landmarks.rows} == compared
    scores = np.full(33, 0.9)
    scores[landmark("left_wrist")] = 0.01
    fewer = person(landmarks=seen(scores)).normalised_landmarks()
    assert fewer is not None
    assert {POINT_NAMES[row] for row in fewer.rows} == compared - {"left_wrist"}
    place = {POINT_NAMES[row]: p for row, p in zip(fewer.rows, fewer.positions, strict=True)}
    for row, position in zip(landmarks.rows, landmarks.positions, strict=True):
        if POINT_NAMES[row] in place:
            assert_allclose(place[POINT_NAMES[row]], position)


@pytest.mark.parametrize("visible", [0, 3])
def test_too_few_landmarks_are_not_used(visible: int) -> None:
    scores = np.zeros(33)
    scores[[landmark(name) for name in LIMBS[:visible]]] = 0.9
    assert person(landmarks=seen(scores)).normalised_landmarks() is None
    # An index has no points to compare with the rest of the face.
    scores[1:7] = 0.9
    assert person(landmarks=seen(scores)).normalised_landmarks() is None
    assert person().normalised_landmarks() is None


def test_person_without_visible_ankles_or_head_is_not_whole() -> None:
    assert person().whole and person(landmarks=seen(0.9)).whole
    for hidden in (("left_ankle", "right_ankle"), ("nose", "left_ear", "right_ear")):
        scores = np.full(33, 0.9)
        scores[[landmark(name) for name in hidden]] = 0.05
        assert not person(landmarks=seen(scores)).whole
    # From the side one leg hides the other.
    scores = np.full(33, 0.9)
    scores[landmark("left_ankle")] = 0.05
    assert person(landmarks=seen(scores)).whole


CAMERA = PinholeCamera.of_frame((720, 1280), 70.0)
HIPS = side_rows("hip")


def skeleton(seed: int = 0) -> NDArray[np.float64]:
    """A pose ``(24, 3)`` in axes of a line of sight: y down, away from the camera."""
    return stick_figure(np.random.default_rng(seed)) * [1.0, -1.0, -1.0]


def projected(
    pose: NDArray[np.float64], pelvis: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The pose ``(24, 3)`` in camera axes about the hips' line of sight, and its pixels."""
    line = to_line_of_sight(pelvis)
    placed = pose @ line + pelvis
    return placed, project(CAMERA, placed)


def about_line_of_sight(
    placed: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A placed skeleton about its hips in the axes of their line of sight, and these axes."""
    hips = placed[HIPS].mean(axis=0)
    line = to_line_of_sight(hips)
    return (placed - hips) @ line.T, line


def landmarks_of(placed: NDArray[np.float64], visibility: float = 0.9) -> Landmarks:
    """Exact landmarks of a placed skeleton; those that it lacks lie at the nose."""
    rows = [
        POINT_NAMES.index(name.replace("foot_index", "toe"))
        if name.replace("foot_index", "toe") in POINT_NAMES
        else POINT_NAMES.index("nose")
        for name in LANDMARK_NAMES
    ]
    hips = placed[HIPS].mean(axis=0)
    pixels = project(CAMERA, placed[rows])
    landmark_hips = side_rows("hip", among=LANDMARK_NAMES)
    line = to_line_of_sight(CAMERA.rays(pixels[landmark_hips].mean(axis=0)))
    metres = (placed[rows] - hips) @ line.T
    count = len(LANDMARK_NAMES)
    return Landmarks(pixels, np.full(count, visibility), metres, 1e-6 * np.eye(count))


@given(x=st.floats(-2, 2), y=st.floats(-0.5, 0.5), z=st.floats(3, 8))
def test_exact_skeletons_stay_where_they_are(x: float, y: float, z: float) -> None:
    placed, pixels = projected(skeleton(), np.array([x, y, z]))
    own, _ = about_line_of_sight(placed)
    result = place_skeletons(own[None], pixels[None], landmarks_of(placed), CAMERA)
    assert_allclose(result.points_2d[0], pixels, atol=1e-6)
    assert_allclose(result.points_3d[0] + result.pelvis[0], placed, atol=0.03)


def test_first_hypothesis_follows_the_landmarks_in_depth_and_another_one_does_not() -> None:
    placed, pixels = projected(skeleton(1), np.array([0.5, 0.0, 4.0]))
    own, _ = about_line_of_sight(placed)
    twin = own * [1.0, 1.0, -1.0]
    result = place_skeletons(
        np.array([twin, twin]), np.array([pixels, pixels + 0.1]), landmarks_of(placed), CAMERA
    )
    limbs = side_rows("wrist") + side_rows("ankle")
    errors = np.linalg.norm(
        result.points_3d[:, limbs] + result.pelvis[:, None] - placed[limbs], axis=-1
    ).mean(axis=1)
    assert errors[0] < 0.5 * errors[1]


def test_joints_are_seen_where_the_landmarks_are_as_far_as_these_are_visible() -> None:
    placed, pixels = projected(skeleton(1), np.array([0.5, 0.0, 4.0]))
    own, _ = about_line_of_sight(placed)
    limbs = rows(*LIMBS)
    for visibility in (0.3, 0.9):
        result = place_skeletons(
            own[None], pixels[None] + [6.0, -4.0], landmarks_of(placed, visibility), CAMERA
        )
        off = result.points_2d[0, limbs] - pixels[limbs]
        assert_allclose(off, np.tile((1 - visibility) * np.array([6.0, -4.0]), (len(limbs), 1)))


def test_a_hypothesis_that_faces_the_other_way_meets_the_landmarks_of_its_other_side() -> None:
    placed, pixels = projected(skeleton(1), np.array([0.5, 0.0, 4.0]))
    own, _ = about_line_of_sight(placed)
    exchanged = pixels[OTHER_SIDE] + 0.1
    result = place_skeletons(
        np.array([own, own[OTHER_SIDE] * [1.0, 1.0, -1.0]]),
        np.array([pixels, exchanged]),
        landmarks_of(placed),
        CAMERA,
    )
    limbs = rows(*LIMBS)
    assert_allclose(result.points_2d[1, limbs], exchanged[limbs], atol=0.2)


def test_alternatives_to_the_first_in_depth_keep_their_distance_from_it() -> None:
    placed, pixels = projected(skeleton(1), np.array([0.5, 0.0, 4.0]))
    own, line = about_line_of_sight(placed)
    wrist = side_rows("wrist")[0]
    nearer = own.copy()
    nearer[wrist, 2] -= 0.2
    result = place_skeletons(
        np.array([own, nearer]), np.array([pixels, pixels]), landmarks_of(placed), CAMERA
    )
    away = ((result.points_3d[1] - result.points_3d[0]) @ line.T)[:, 2]
    assert away[wrist] == pytest.approx(-0.2, abs=0.03)
    assert_allclose(np.delete(away, wrist), 0, atol=0.01)
    assert_allclose(result.points_2d[1], result.points_2d[0])


def test_joints_project_to_their_pixels() -> None:
    placed, pixels = projected(skeleton(2), np.array([-1.0, 0.3, 5.0]))
    poses = np.array([skeleton(3), mirror_3d(skeleton(4))])
    result = place_skeletons(poses, np.array([pixels, pixels]), landmarks_of(placed), CAMERA)
    again = project(CAMERA, result.points_3d + result.pelvis[:, None])
    assert_allclose(again, result.points_2d, atol=1e-6)


def test_without_landmarks_a_known_field_of_view_turns_the_skeleton() -> None:
    pose = skeleton(5) - skeleton(5)[POINT_NAMES.index("pelvis")]
    _, pixels = projected(pose, np.array([2.0, 0.0, 4.0]))
    assumed = PinholeCamera(CAMERA.focal, CAMERA.centre)
    kept = place_skeletons(pose[None], pixels[None], None, assumed)
    turned = place_skeletons(pose[None], pixels[None], None, CAMERA)
    assert_allclose(kept.points_3d[0], pose)
    rotation = to_line_of_sight(CAMERA.rays(pixels[POINT_NAMES.index("pelvis")]))
    assert_allclose(turned.points_3d[0], pose @ rotation, atol=1e-9)
    assert turned.pelvis[0, 2] == pytest.approx(4.0, abs=0.1)
