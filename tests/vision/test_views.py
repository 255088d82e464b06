"""Windows about people, and their halves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.people import Box
from app.vision.resampling import resize
from app.vision.views import halves_of, joined, view_of, with_grey_surroundings

SIZE = 256

boxes = st.builds(
    Box, st.floats(-50, 250), st.floats(-50, 250), st.floats(1, 400), st.floats(1, 400)
)


def waves(rows: int, columns: int) -> NDArray[np.float32]:
    """A picture without edges, the same at every resolution."""
    y, x = ((np.arange(n) + 0.5) / n for n in (rows, columns))
    return (0.5 + 0.4 * np.sin(6 * y)[:, None] * np.cos(5 * x)[None]).astype(np.float32)


@pytest.mark.parametrize("box", [Box(60, 20, 90, 260), Box(20, 40, 200, 150), Box(90, 5, 30, 90)])
def test_what_is_seen_of_halves_is_put_where_they_were(box: Box) -> None:
    """Of a picture seen the same at both looks, the closer look makes the same picture."""
    frame = np.zeros((300, 280, 3), np.uint8)
    view = view_of(frame, box)
    rows, columns = view.image.shape[:2]
    picture = np.repeat((255 * waves(rows, columns)).astype(np.uint8)[..., None], 3, axis=2)
    whole, *halves = (
        resize(one, SIZE, SIZE)[..., 0].astype(np.float32) / np.float32(255)
        for one in (picture, *halves_of(view, picture))
    )
    both = joined(view, whole, np.stack(halves))
    assert both.shape == whole.shape
    assert np.abs(both - whole).max() < 0.03


def test_limbs_that_only_the_closer_look_shows_are_kept() -> None:
    view = view_of(np.zeros((300, 280, 3), np.uint8), Box(60, 20, 90, 260))
    nothing = np.zeros((SIZE, SIZE), np.float32)
    feet = np.zeros((2, SIZE, SIZE), np.float32)
    feet[1, 200:] = 1
    both = joined(view, nothing, feet)
    assert both[-10:, SIZE // 2].min() > 0.99 and not both[: SIZE // 2].any()


@given(boxes)
def test_odd_boxes_have_halves(box: Box) -> None:
    view = view_of(np.full((200, 200, 3), 90, np.uint8), box)
    image = with_grey_surroundings(view)
    halves = halves_of(view, image)
    assert all(0 not in half.shape for half in halves)
    answers = np.ones((3, SIZE, SIZE), np.float32)
    assert joined(view, answers[0], answers[1:]) == pytest.approx(1, abs=1e-5)
