"""The floor learnt from people who stand, and how high over it somebody lies."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import Generator
from numpy.typing import NDArray

from app.camera import CameraSession
from app.estimation.results import Person
from app.photograph import Estimator
from app.tracking.floor import Floor, Height, Rest
from app.tracking.results import Event
from app.tracking.track import Track
from app.vision.geometry import Box, PersonWindow
from app.vision.judgement import FRAME_POSTURES, FramePosture, Trust
from app.vision.optics import PinholeCamera, to_line_of_sight
from app.vision.people import LANDMARK_NAMES, Landmarks, Silhouette, landmark_rows
from scripts.datasets import frames_at
from scripts.helpers import track
from tests.conftest import SHARED

SHAPE = (480, 640)
_HIPS = landmark_rows("hip")
_UP_M = {
    "nose": 1.57, "eye": 1.6, "ear": 1.58, "mouth": 1.53, "shoulder": 1.38, "elbow": 1.1,
    "wrist": 0.86, "pinky": 0.8, "index": 0.78, "thumb": 0.82, "hip": 0.92, "knee": 0.5,
    "ankle": 0.08, "heel": 0.04, "foot": 0.03,
}  # fmt: skip
_ASIDE_M = {"shoulder": 0.17, "elbow": 0.22, "wrist": 0.24, "pinky": 0.24, "index": 0.24,
            "thumb": 0.22, "hip": 0.1, "knee": 0.1, "ankle": 0.1, "heel": 0.1,
            "foot": 0.1}  # fmt: skip


def body() -> NDArray[np.float64]:
    """Landmarks ``(33, 3)`` of a person who stands: aside, up, ahead; metres over the ground."""
    points = np.zeros((len(LANDMARK_NAMES), 3))
    for row, name in enumerate(LANDMARK_NAMES):
        part = next(part for part in _UP_M if part in name)
        side = 1 if "left" in name else -1 if "right" in name else 0
        points[row] = side * _ASIDE_M.get(part, 0.05), _UP_M[part], 0.12 * (part == "foot")
    return points


class Scene:
    """A camera that hangs at a height, tilted down by an angle."""

    def __init__(
        self, height_m: float, tilt_deg: float, fov_deg: float = 60.0, px: float = 1.0,
        given: bool = False,
    ) -> None:  # fmt: skip
        self.height_m, self.tilt = height_m, np.deg2rad(tilt_deg)
        self.shape = round(SHAPE[0] * px), round(SHAPE[1] * px)
        self.true = PinholeCamera.of_frame(self.shape, fov_deg)
        # Where the middle of the picture shows the ground, metres away.
        self.middle_m = min(height_m / np.tan(self.tilt), 5.0)
        self.floor = Floor()
        self.floor.watch(PinholeCamera.of_frame(self.shape, fov_deg if given else None))

    def person(self, points: NDArray[np.float64], posture: str = "standing") -> Person:
        """A person of landmarks ``(33, 3)``: aside, up and away from the camera's foot, metres."""
        sine, cosine = np.sin(self.tilt), np.cos(self.tilt)
        x, below, away = points[:, 0], self.height_m - points[:, 1], points[:, 2]
        seen = np.stack([x, below * cosine - away * sine, below * sine + away * cosine], axis=1)
        places = seen[:, :2] / seen[:, 2:] * self.true.focal + self.true.centre
        hips = seen[_HIPS].mean(axis=0)
        metres = (seen - hips) @ to_line_of_sight(hips).T
        shares = np.full(len(FRAME_POSTURES), 0.01)
        shares[FRAME_POSTURES.index(posture)] = 0.95
        return Person(
            Box(0, 0, 10, 10), "detector", 0.9,
            landmarks=Landmarks(places, np.ones(len(places)), metres),
            frame_posture=FramePosture(shares), trust=Trust(0.99, 0.9),
        )  # fmt: skip

    def stands(self, aside: float, away: float, size: float = 1.0, turned: float = 0.0) -> Person:
        """A person who stands at a place."""
        cosine, sine = np.cos(turned), np.sin(turned)
        turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        return self.person(size * body() @ turn + [aside, 0, away])

    def lies(self, aside: float, away: float, over: float, turned: float) -> Person:
        """A person who lies on the back at a height, the head towards an angle."""
        flat = body()[:, [0, 2, 1]] * [1, 1, 1] + [0, 0.12, -0.9]
        cosine, sine = np.cos(turned), np.sin(turned)
        turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        return self.person(flat @ turn + [aside, over, away], "lying")

    def walk(self, who: int, generator: Generator, count: int = 12, size: float = 1.0) -> None:
        """Let somebody walk about in the middle of the picture."""
        for _ in range(count):
            aside, away = generator.uniform(-0.8, 0.8), self.middle_m * generator.uniform(0.8, 1.3)
            one = self.stands(aside, away, size, generator.uniform(0, 6.3))
            self.floor.see(who, one, self.shape)


CAMERAS = [(1.5, 12.0), (2.4, 25.0), (2.7, 40.0), (4.0, 35.0), (3.0, 60.0)]
"""Heights in metres and tilts in degrees."""


def watched(scene: Scene, people: int = 1) -> Scene:
    """The scene after people have walked in it."""
    generator = np.random.default_rng(0)
    for who in range(1, 1 + people):
        scene.walk(who, generator)
    return scene


def height(scene: Scene, over: float, *, who: int = 1, turned: float = 1.2) -> Height:
    """How high somebody lies who does so ``over`` the floor in the middle of the picture."""
    lying = scene.lies(0.3, scene.middle_m, over, turned).landmarks
    assert lying is not None
    found = scene.floor.height(who, lying)
    assert found is not None
    return found


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("fov_deg", [60.0, 80.0])
@pytest.mark.parametrize(("height_m", "tilt_deg"), CAMERAS)
def test_people_who_walk_show_how_the_camera_hangs(
    height_m: float, tilt_deg: float, fov_deg: float, given: bool
) -> None:
    known = watched(Scene(height_m, tilt_deg, fov_deg, given=given), 3).floor.calibration
    assert known is not None
    assert np.rad2deg(known.mean[0]) == pytest.approx(tilt_deg, abs=3 if given else 6)
    assert np.exp(known.mean[2]) + 0.08 == pytest.approx(height_m, rel=0.1 if given else 0.2)


@pytest.mark.parametrize("fov_deg", [60.0, 80.0])
@pytest.mark.parametrize(("height_m", "tilt_deg"), CAMERAS)
def test_it_is_known_how_high_somebody_lies(
    height_m: float, tilt_deg: float, fov_deg: float
) -> None:
    scene = watched(Scene(height_m, tilt_deg, fov_deg))
    for turned in (0.3, 1.2, 2.1, 3.9):
        floor, bed = (height(scene, over, turned=turned) for over in (0.0, 0.5))
        assert bed.mean - floor.mean == pytest.approx(0.5, abs=0.05)
        assert abs(floor.mean - 0.04) < max(0.05, floor.sd)


def test_a_few_wrong_readings_change_little() -> None:
    scene, generator = watched(Scene(2.4, 25), 3), np.random.default_rng(1)
    before = height(scene, 0.5)
    for who in range(10, 14):
        seen = scene.stands(0, scene.middle_m)
        assert seen.landmarks is not None
        stretched = (seen.landmarks.positions - [320, 240]) * generator.uniform(0.4, 0.7) + [
            320,
            240,
        ]
        wrong = replace(seen.landmarks, positions=stretched)
        scene.floor.see(who, replace(seen, landmarks=wrong), scene.shape)
    assert height(scene, 0.5).mean == pytest.approx(before.mean, abs=0.1)


def test_the_size_of_the_picture_changes_nothing() -> None:
    small, large = (height(watched(Scene(2.4, 25, px=px)), 0.5) for px in (0.5, 2.0))
    assert small == pytest.approx(large, abs=0.01)


def test_somebody_short_who_stood_is_known_to_be_short() -> None:
    scene, generator = watched(Scene(2.4, 25), 4), np.random.default_rng(1)
    scene.walk(9, generator, size=0.8)
    assert scene.floor.calibration is not None
    sizes = dict(zip(scene.floor.calibration.people, scene.floor.calibration.mean[4:], strict=True))
    assert sizes[9] < min(sizes[who] for who in (1, 2, 3, 4)) - 0.1
    # Of others, nobody knows.
    assert height(scene, 0.0, who=77).sd > 1.3 * height(scene, 0.0).sd


def test_nothing_is_known_before_people_stood_whole() -> None:
    scene = Scene(2.4, 25)
    lying = scene.lies(0.3, scene.middle_m, 0.0, 1.2)
    assert lying.landmarks is not None
    stands = scene.stands(0, scene.middle_m)
    for seen in (
        scene.stands(0, 1.5),  # The feet are below the frame.
        replace(stands, trust=Trust(0.9, 0.1)),
        replace(stands, frame_posture=lying.frame_posture),
        replace(stands, landmarks=None),
        *[stands] * 2,
    ):
        scene.floor.see(1, seen, scene.shape)
        assert scene.floor.height(1, lying.landmarks) is None
    scene.floor.see(1, stands, scene.shape)
    assert scene.floor.height(1, lying.landmarks) is not None


def test_who_stands_still_does_not_outweigh_those_who_walk() -> None:
    scene = watched(Scene(2.4, 25))
    before = height(scene, 0.5)
    for _ in range(100):
        scene.floor.see(1, scene.stands(0.5, scene.middle_m), scene.shape)
    assert height(scene, 0.5) == pytest.approx(before, abs=0.03)


def test_a_moved_camera_is_learnt_anew() -> None:
    scene, moved = watched(Scene(1.5, 10)), Scene(3.0, 40)
    generator = np.random.default_rng(1)
    moved.floor = scene.floor
    moved.walk(2, generator, count=20)
    assert height(moved, 0.5, who=2).mean == pytest.approx(0.54, abs=0.1)


def test_another_field_of_view_is_another_camera() -> None:
    scene = watched(Scene(2.4, 25))
    scene.floor.watch(PinholeCamera.of_frame(scene.shape, 70))
    assert scene.floor.calibration is None


def rested(scene: Scene, over: float, frames: int = 6) -> Rest:
    rest = Rest()
    for number in range(frames):
        lying = scene.lies(0.3, scene.middle_m, over, 1.2 + 0.05 * number)
        rest.update(number / 5, lying, 1, scene.floor)
    return rest


@pytest.mark.parametrize(("height_m", "tilt_deg"), CAMERAS[:3])
def test_the_floor_and_a_bed_are_told_apart(height_m: float, tilt_deg: float) -> None:
    scene = watched(Scene(height_m, tilt_deg, given=True), 3)
    on_floor, in_bed = rested(scene, 0.0).on_floor, rested(scene, 0.6).on_floor
    assert on_floor is not None and in_bed is not None
    assert on_floor > 0.8 and in_bed < 0.2
    assert rested(scene, 0.0).odds > 3 and rested(scene, 0.6).odds < 1 / 3


@pytest.mark.parametrize("fov_deg", [60.0, 80.0, 100.0])
@pytest.mark.parametrize(("height_m", "tilt_deg"), [(4.0, 35.0), (3.0, 60.0), (3.5, 75.0)])
def test_steep_high_and_wide_cameras_say_nothing_rather_than_something_wrong(
    height_m: float, tilt_deg: float, fov_deg: float
) -> None:
    scene = watched(Scene(height_m, tilt_deg, fov_deg), 3)
    on_floor, in_bed = rested(scene, 0.0).on_floor, rested(scene, 0.6).on_floor
    assert on_floor is None or on_floor > 0.8
    assert in_bed is None or in_bed < 0.2


def misread(person: Person, size: float, distance: float, slope: float) -> Person:
    """A person of a size whose body is read in the usual size, too near or far, and aslant."""
    assert person.landmarks is not None
    sine, cosine = np.sin(slope), np.cos(slope)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    metres = person.landmarks.metres @ turn.T * np.exp(distance) / size
    return replace(person, landmarks=replace(person.landmarks, metres=metres))


def test_what_is_told_is_mostly_right_though_bodies_are_misread() -> None:
    told = []
    for seed in range(40):
        generator = np.random.default_rng(seed)
        height_m, over = generator.uniform(1.5, 3.5), generator.choice([0.0, 0.6])
        scene = Scene(height_m, np.rad2deg(np.arctan2(height_m - 0.8, generator.uniform(2, 6))))
        for who in (1, 2):
            size, slope = np.exp(generator.normal(0, 0.06)), generator.normal(0, 0.1)
            for _ in range(5):
                away = scene.middle_m * generator.uniform(0.8, 1.3)
                one = scene.stands(generator.uniform(-0.8, 0.8), away, size)
                seen = misread(one, size, generator.normal(0, 0.05), slope)
                scene.floor.see(who, seen, scene.shape)
        lying = scene.lies(0.2, scene.middle_m, over, generator.uniform(0, 6.3))
        lying = misread(lying, 1.0, generator.normal(0, 0.07), generator.normal(0, 0.1))
        rest = Rest()
        for number in range(3):
            rest.update(number / 5, lying, 2, scene.floor)
        if rest.on_floor is not None:
            told.append((rest.on_floor > 0.5) == (over == 0))
    assert len(told) > 20
    assert np.mean(told) >= 0.85


def test_who_falls_out_of_bed_is_on_the_floor_soon() -> None:
    scene = watched(Scene(2.4, 25), 3)
    rest = rested(scene, 0.6, frames=50)
    for number in range(10):
        rest.update(10 + number / 5, scene.lies(-0.5, scene.middle_m, 0.0, 1), 1, scene.floor)
    assert rest.on_floor is not None and rest.on_floor > 0.8


def test_of_those_who_do_not_lie_nothing_is_said() -> None:
    scene, rest = watched(Scene(2.4, 25)), Rest()
    for number in range(10):
        rest.update(number / 5, scene.stands(0, scene.middle_m), 1, scene.floor)
    assert rest.on_floor is None and rest.odds == 1
    rest = rested(scene, 0.0)
    rest.update(60.0, scene.stands(0, scene.middle_m), 1, scene.floor)
    assert rest.on_floor is None


def fallen(scene: Scene, floor: Floor | None) -> tuple[list[float | None], list[Event]]:
    """What a track says of the floor, and its events: a person stands, then lies."""
    frame = np.zeros((*SHAPE, 3), np.uint8)
    silhouette = Silhouette(np.ones((40, 90), bool), 200, 200, "network", truncated=False)
    people = [scene.stands(0.1 * step - 0.5, scene.middle_m) for step in range(10)]
    people += [scene.lies(0.3, scene.middle_m, 0.0, 1.2)] * 10
    track, said, events = Track(people[0], 0.0), list[float | None](), list[Event]()
    track.confirm(1, 0.0, ())
    for number, person in enumerate(people):
        window = PersonWindow.about_box(person.box)
        seen = replace(person, silhouette=silhouette, next_window=window)
        track.see(seen, number / 5)
        tracked, new = track.update(seen, number / 5, frame=frame, floor=floor)
        said.append(tracked.on_floor)
        events += new
    return said, events


def test_a_track_learns_the_floor_and_says_who_lies_on_it() -> None:
    scene = Scene(1.5, 12, given=True)
    said, events = fallen(scene, scene.floor)
    assert set(said[:10]) == {None} and (said[-1] or 0) > 0.8
    (lying,) = [one for one in events if one.event == "lying"]
    assert (lying.on_floor or 0) > 0.8


def test_a_fall_is_likelier_where_the_person_lies_on_the_floor() -> None:
    scene = Scene(1.5, 12, given=True)
    known, unknown = (
        next(one.probability for one in fallen(scene, floor)[1] if one.event == "fell")
        for floor in (scene.floor, None)
    )
    assert known / (1 - known) == pytest.approx(4 * unknown / (1 - unknown))


def test_a_session_says_that_who_fell_lies_on_the_floor(estimator: Estimator) -> None:
    path = SHARED / "real" / "urfd" / "fall-11.mp4"
    if not path.exists():
        pytest.skip(f"no film {path}; set SHARED to the folder above real")
    session = CameraSession(estimator)
    frames = [track(session, frame, at, 0) for at, frame in frames_at(path, 5)]
    (begun,) = [
        event
        for frame in frames
        for event in frame.events
        if (event.event, event.state) == ("lying", "begin")
    ]
    said = [one.on_floor for frame in frames for one in frame.persons if one.on_floor is not None]
    assert min([begun.on_floor or 0, *said]) >= 0.8
    assert frames[0].persons[0].on_floor is None
