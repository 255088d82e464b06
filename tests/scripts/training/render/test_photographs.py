"""Whole photographs of real motion and bodies: labels that hold, and the same ones by seed."""

from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from app.vision.judgement import FRAME_POSTURES
from scripts.training.render.materials import Materials
from scripts.training.render.people import MIRRORED, split_of
from scripts.training.render.posing import HELD_OUT_SUBJECTS
from scripts.training.render.scene import Photograph, Studio
from scripts.training.render.surroundings import PosedBody
from tests.conftest import SHARED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SHARED / "mocap").is_dir(), reason=f"needs {SHARED / 'mocap'}"),
]


@pytest.fixture(scope="module")
def studio() -> Studio:
    pytest.importorskip("anny")
    return Studio.open(SHARED / "mocap", SHARED / "garments", 2, 1, held_out=True)


@pytest.fixture(scope="module")
def photographs(studio: Studio) -> list[Photograph]:
    generator = np.random.default_rng(3)
    return [studio.take(generator) for _ in range(12)]


def test_landmarks_are_where_the_camera_projects_them(photographs: list[Photograph]) -> None:
    for photograph in photographs:
        seen = photograph.landmarks
        places = seen[:, :2] / seen[:, 2:] * photograph.focal + photograph.centre
        assert_allclose(places, photograph.places, atol=1e-6)
        height, width = photograph.image.shape[:2]
        inside = ((places > -1) & (places < [width, height])).all(axis=1)
        assert not (photograph.shown & ~inside).any()
        left, top, across, down = photograph.box
        assert left >= -0.51 and top >= -0.51
        assert left + across <= width and top + down <= height


@pytest.fixture(scope="module")
def bodies(studio: Studio) -> list[PosedBody]:
    """Forty tries at each posture, without those that came out as another."""
    generator = np.random.default_rng(2)
    made = [studio.body(name, Materials(), generator) for name in FRAME_POSTURES for _ in range(40)]
    return [body for body in made if body is not None]


def test_postures_that_are_asked_for_can_be_made(bodies: list[PosedBody]) -> None:
    assert {FRAME_POSTURES[body.posture] for body in bodies} == set(FRAME_POSTURES)


def test_the_same_seed_takes_the_same_photograph(studio: Studio) -> None:
    one, other = (studio.take(np.random.default_rng([5, 6])) for _ in range(2))
    for part in fields(Photograph):
        assert_array_equal(getattr(one, part.name), getattr(other, part.name))


def test_held_out_clips_and_garments_are_apart() -> None:
    names = ["female_casualsuit01", "female_elegantsuit01", "male_casualsuit01",
             "male_casualsuit02", "male_worksuit01"]  # fmt: skip
    held, others = split_of(names, True), split_of(names, False)
    assert sorted(held + others) == names and held and others
    assert len(HELD_OUT_SUBJECTS) == 4
    assert_array_equal(MIRRORED[MIRRORED], np.arange(33))
