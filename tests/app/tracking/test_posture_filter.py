"""A track's posture, by the frames so far."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.posture import PostureFilter, vote_posture
from app.vision.geometry import Box
from app.vision.judgement import FRAME_POSTURES, FramePosture
from index.posture import ON_THE_GROUND, POSTURES, PostureName

UPRIGHT, LEVEL = Box(0, 0, 40, 160), Box(0, 0, 160, 40)


def votes(posture: PostureName) -> NDArray[np.float64]:
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
    frame_posture = FramePosture(np.full(len(FRAME_POSTURES), 1 / len(FRAME_POSTURES)))
    _, shares = PostureFilter().update(0.0, votes("standing"), frame_posture, 0.0, box)
    share = sum(shares[POSTURES.index(posture)] for posture in ON_THE_GROUND)
    assert (share > 0.9) if lies else (share < 0.1)


def test_unreliable_frames_hardly_change_the_posture() -> None:
    postures = PostureFilter()
    postures.update(0.0, votes("lying"), None, 1.0, LEVEL)
    for frame in range(1, 11):
        posture, _ = postures.update(frame / 10, votes("standing"), None, 1.0, UPRIGHT, 0.1)
    assert posture.label == "lying"
