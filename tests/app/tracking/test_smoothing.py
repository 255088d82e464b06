"""Smooth poses: ambiguities resolved by motion, bones of constant length."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.results import Person
from app.tracking.motion import REFERENCE_HZ, Motion, MotionFilter
from app.tracking.results import SmoothedPose
from app.tracking.seen_body import SeenBody
from app.tracking.smoothing import COST_PER_M, EXTRAPOLATED_S, PoseSmoother
from app.vision.people import Landmarks
from index.posture import POSTURES, azimuth_deg
from index.skeleton import POINT_NAMES, POINTS, bone_lengths, mean_joint_distance, wrap_degrees
from tests.app.tracking.people import PX_PER_M, person_of, seen_from

ELEVATION_DEG = 20.0


class Follower:
    def __init__(self) -> None:
        self.motions, self.smoother = MotionFilter(), PoseSmoother()

    def update(self, person: Person, timestamp: float) -> tuple[Motion, SmoothedPose]:
        body = SeenBody.of(person)
        assert body is not None
        motion = self.motions.update(timestamp, person.whole_box, body)
        smoothed = self.smoother.update(person, timestamp, motion)
        assert smoothed is not None
        return motion, smoothed


def follow(people: list[Person]) -> list[tuple[Motion, SmoothedPose]]:
    follower = Follower()
    return [follower.update(person, 0.1 * frame) for frame, person in enumerate(people)]


def likeliest(smoothed: SmoothedPose) -> str:
    return POSTURES[int(smoothed.votes.argmax())]


def walkers(right_m_s: float, away_m_s: float, azimuths_deg: list[float]) -> list[Person]:
    """Frames of a person who walks, each with the same equally confident hypotheses."""
    poses = [seen_from(azimuth, ELEVATION_DEG) for azimuth in azimuths_deg]
    rise = np.sin(np.deg2rad(ELEVATION_DEG))
    return [
        person_of(
            poses,
            [0.5] * len(poses),
            (200 + PX_PER_M * right_m_s * t, 200 - PX_PER_M * away_m_s * rise * t),
            elevation_deg=ELEVATION_DEG,
        )
        for t in np.arange(0, 2, 0.1).tolist()
    ]


@pytest.mark.parametrize(
    ("right_m_s", "away_m_s", "facing_deg"),
    [(0.0, -1.2, 0.0), (0.0, 1.2, 180.0), (1.2, 0.0, -90.0), (-1.2, 0.0, 90.0), (0.9, 0.9, -135.0)],
)
def test_people_face_where_they_walk(right_m_s: float, away_m_s: float, facing_deg: float) -> None:
    candidates = [facing_deg, facing_deg + 180.0, 180.0 - facing_deg + 1e-3]
    motion, last = follow(walkers(right_m_s, away_m_s, candidates))[-1]
    turned = wrap_degrees(azimuth_deg(last.points_3d[None])[0] - facing_deg)
    assert abs(float(turned)) < 30
    assert motion.walks


def test_standing_is_no_evidence_of_facing() -> None:
    motion, _ = follow(walkers(0.0, 0.0, [0.0, 180.0]))[-1]
    assert not motion.walks
    assert motion.heading.front_probability == pytest.approx(0.5)


def test_a_single_flipped_frame_changes_nothing() -> None:
    front, back = seen_from(0.0), seen_from(180.0)
    people = [person_of([front, back], [0.7, 0.4]) for _ in range(10)]
    people[6] = person_of([back, front], [0.75, 0.4])
    assert all(motion.heading.front_probability > 0.6 for motion, _ in follow(people))


def test_a_steady_pose_stays_as_it_is() -> None:
    pose = seen_from(30.0)
    for _, update in follow([person_of([pose], [0.8]) for _ in range(8)]):
        np.testing.assert_allclose(update.points_3d, pose, atol=1e-9)
        assert update.entry == 0


def test_bones_keep_their_lengths() -> None:
    """Averages of turned bodies would shrink."""
    people = [
        person_of([seen_from(azimuth), seen_from(azimuth + 15)], [0.6, 0.5])
        for azimuth in np.linspace(0, 80, 20)
    ]
    for _, update in follow(people):
        np.testing.assert_allclose(
            bone_lengths(update.points_3d), bone_lengths(seen_from(0)), rtol=1e-6
        )


def test_noise_is_smoothed_away() -> None:
    rng = np.random.default_rng(0)
    pose = seen_from(40.0)
    noisy = [[pose + rng.normal(0, 0.05, pose.shape) for _ in range(6)] for _ in range(20)]
    updates = follow([person_of(poses, [0.5] * 6) for poses in noisy])
    smooth = np.array([update.points_3d for _, update in updates])
    raw = np.array([poses[0] for poses in noisy])
    assert np.abs(smooth - pose).mean() < 0.9 * np.abs(raw - pose).mean()
    assert np.abs(np.diff(smooth, axis=0)).mean() < 0.7 * np.abs(np.diff(raw, axis=0)).mean()


def test_without_hypotheses_there_is_no_pose() -> None:
    person, follower = person_of([seen_from(0.0)], [0.5]), Follower()
    motion, _ = follower.update(person, 0.0)
    hidden = replace(person, facing=None, posture=None, hypotheses=())
    assert SeenBody.of(hidden) is None
    assert follower.smoother.update(hidden, 0.1, motion) is None
    follower.update(person, 0.2)


def test_a_pose_is_extrapolated_along_with_the_person_for_a_second() -> None:
    follower = Follower()
    smoother = follower.smoother
    person = person_of([seen_from(0.0)], [0.5])
    assert smoother.extrapolate(person, 0.0) is None
    _, before = follower.update(person, 0.0)
    box = person.box
    moved = replace(person, box=replace(box, x=box.x + 8, y=box.y - 3))
    extrapolated = smoother.extrapolate(moved, EXTRAPOLATED_S)
    assert extrapolated is not None
    np.testing.assert_allclose(extrapolated.points_2d - before.points_2d, [[8, -3]] * POINTS)
    np.testing.assert_array_equal(extrapolated.points_3d, before.points_3d)
    assert extrapolated.confidence < before.confidence
    assert smoother.extrapolate(person, EXTRAPOLATED_S + 0.1) is None


@pytest.mark.parametrize(
    ("speed_m_s", "posture"), [(0.0, "standing"), (1.2, "walking"), (3.5, "running")]
)
def test_walking_and_running_follow_the_measured_speed(speed_m_s: float, posture: str) -> None:
    assert likeliest(follow(walkers(speed_m_s, 0.0, [-90.0]))[-1][1]) == posture


def test_a_sitting_person_does_not_walk_however_fast_the_chair() -> None:
    people = [
        person_of([seen_from(-90.0)], [0.5], (200 + 20 * frame, 200.0), postures=["sitting"])
        for frame in range(20)
    ]
    assert likeliest(follow(people)[-1][1]) == "sitting"


def arms_raised(degrees: float) -> NDArray[np.float64]:
    """The standing body with its arms raised sideways, from in front."""
    body, angle = seen_from(0.0), np.deg2rad(degrees)
    for side in ("left", "right"):
        shoulder = body[POINT_NAMES.index(f"{side}_shoulder")]
        sign = np.sign(shoulder[0])
        for joint in ("elbow", "wrist"):
            row = POINT_NAMES.index(f"{side}_{joint}")
            length = np.linalg.norm(body[row] - shoulder)
            body[row] = shoulder + length * np.array([sign * np.sin(angle), np.cos(angle), 0])
    return body


def share_after(seconds: float, fps: int) -> float:
    """Share of a pose that is always a little likelier than another one."""
    follower = Follower()
    person = person_of(
        [arms_raised(0.0), arms_raised(20.0)], [0.52, 0.48], postures=["standing", "bending"]
    )
    for frame in range(round(seconds * fps) + 1):
        _, smoothed = follower.update(person, frame / fps)
    return float(smoothed.votes[POSTURES.index("standing")])


def test_more_frames_a_second_are_no_more_evidence() -> None:
    assert share_after(1.0, 10) == pytest.approx(share_after(1.0, 40), abs=0.05)
    assert share_after(1.0, 10) < 0.9


@pytest.mark.parametrize(("gap_s", "follows"), [(0.1, False), (20.0, True)])
def test_the_sooner_a_pose_changes_the_more_evidence_it_needs(gap_s: float, follows: bool) -> None:
    low, high = arms_raised(0.0), arms_raised(150.0)
    follower = Follower()
    for frame in range(3):
        follower.update(person_of([low, high], [0.7, 0.3]), frame / 10)
    _, last = follower.update(person_of([high, low], [0.7, 0.3]), 0.2 + gap_s)
    assert (last.entry == 0) == follows


@pytest.mark.parametrize("elapsed_s", [0.025, 0.1, 0.4])
def test_odds_of_a_move_fall_with_its_distance_and_rise_with_its_time(elapsed_s: float) -> None:
    low, high = arms_raised(0.0), arms_raised(15.0)
    follower = Follower()
    follower.update(person_of([low], [0.5]), 0.0)
    _, last = follower.update(
        person_of([low, high], [0.5, 0.5], postures=["sitting", "kneeling"]), elapsed_s
    )
    stays, moves = (last.votes[POSTURES.index(name)] for name in ("sitting", "kneeling"))
    cost_per_m = COST_PER_M * 2 / (1 + elapsed_s * REFERENCE_HZ)
    metres = mean_joint_distance(low[None], high[None])[0]
    assert np.log(stays / moves) == pytest.approx(cost_per_m * metres, rel=1e-3)


@pytest.mark.parametrize(("by_landmarks", "frames"), [(False, 12), (True, 4)])
def test_a_pose_follows_from_the_last_frames_alone(by_landmarks: bool, frames: int) -> None:
    """Those of 0.35 s without landmarks, of 0.12 s with clear ones, at 32 frames a second."""
    landmarks = Landmarks(np.zeros((33, 2)), np.ones(33), np.zeros((33, 3)))

    def pose_after(azimuths: list[float]) -> NDArray[np.float64]:
        follower = Follower()
        for number, azimuth in enumerate(azimuths):
            person = person_of([seen_from(azimuth)], [0.9])
            box = replace(person.box, height=400.0)
            if by_landmarks:
                person = replace(person, box=box, landmarks=landmarks)
            _, last = follower.update(person, number / 32)
        return last.points_3d

    steady = [0.0] * 16
    for row in (0, 15 - frames, 16 - frames, 15):
        turned = [*steady[:row], 20.0, *steady[row + 1 :]]
        matters = np.abs(pose_after(turned) - pose_after(steady)).max() > 1e-9
        assert matters == (row >= len(steady) - frames)


def test_poses_far_from_the_likeliest_do_not_blend_with_it() -> None:
    low, high = arms_raised(0.0), arms_raised(170.0)
    _, last = follow([person_of([low, high], [0.6, 0.55])] * 5)[-1]
    mixed = np.linalg.norm(last.points_3d - low, axis=-1).mean()
    assert mixed < 0.45 * np.linalg.norm(high - low, axis=-1).mean() * 0.55


def test_a_steady_turn_is_followed_without_lag() -> None:
    turns = np.arange(0.0, 60.0, 3.0).tolist()
    _, last = follow([person_of([seen_from(azimuth)], [0.8]) for azimuth in turns])[-1]
    assert azimuth_deg(last.points_3d[None])[0] == pytest.approx(turns[-1], abs=1.0)


@pytest.mark.parametrize(("height_px", "keeps"), [(60.0, True), (400.0, False)])
def test_small_upright_people_keep_the_side_that_they_show(height_px: float, keeps: bool) -> None:
    """Landmarks of small people seen from the side flip; those of large ones do not."""
    azimuths = [60.0] * 10 + [110.0] * 2
    people = [person_of([seen_from(azimuth)], [0.9]) for azimuth in azimuths]
    landmarks = Landmarks(np.zeros((33, 2)), np.ones(33), np.zeros((33, 3)))
    _, last = follow([
        replace(person, box=replace(person.box, height=height_px), landmarks=landmarks)
        for person in people
    ])[-1]  # fmt: skip
    assert (azimuth_deg(last.points_3d[None])[0] < 90) == keeps
