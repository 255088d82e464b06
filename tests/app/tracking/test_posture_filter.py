"""A track's posture, by the frames so far."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.posture_probability import vote_posture
from app.tracking.posture_filter import PostureFilter
from app.vision.geometry import Box
from app.vision.people import LANDMARK_NAMES, Landmarks
from index.posture import ON_THE_GROUND, POSTURES, Posture

UPRIGHT, LEVEL = Box(0, 0, 40, 160), Box(0, 0, 160, 40)


def votes(posture: Posture) -> NDArray[np.float64]:
    return vote_posture([posture], [1.0])


@pytest.mark.parametrize("fps", [5, 30])
def test_the_posture_settles_on_a_new_one_within_a_second(fps: int) -> None:
    postures = PostureFilter()
    labels = []
    for frame in range(3 * fps):
        seen = votes("standing" if frame < fps else "sitting")
        posture, shares = postures.update(frame / fps, seen, None, 1.0, UPRIGHT)
        labels.append(posture.label)
        assert shares is seen
    assert set(labels[:fps]) == {"standing"} and labels[fps] != "sitting"
    assert set(labels[2 * fps :]) == {"sitting"}


def test_after_a_long_gap_the_newest_frame_counts_for_most() -> None:
    postures = PostureFilter()
    postures.update(0.0, votes("standing"), None, 1.0, UPRIGHT)
    posture, _ = postures.update(60.0, votes("lying"), None, 1.0, LEVEL)
    assert posture.label == "lying"
    assert posture.share(["standing"]) == pytest.approx(np.exp(-1 / 0.4))


@pytest.mark.parametrize(("box", "lies"), [(UPRIGHT, False), (LEVEL, True)])
def test_where_the_network_sees_no_person_the_box_decides(box: Box, lies: bool) -> None:
    rng = np.random.default_rng(0)
    count = len(LANDMARK_NAMES)
    landmarks = Landmarks(rng.random((count, 2)), np.full(count, 0.9), rng.random((count, 3)))
    _, shares = PostureFilter().update(0.0, votes("standing"), landmarks, 0.0, box)
    share = sum(shares[POSTURES.index(posture)] for posture in ON_THE_GROUND)
    assert (share > 0.9) if lies else (share < 0.1)
