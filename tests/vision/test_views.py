"""Windows about people, as the network that looks for them sees them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.people import Box
from app.vision.views import view_of, with_grey_surroundings

boxes = st.builds(
    Box, st.floats(-50, 250), st.floats(-50, 250), st.floats(1, 400), st.floats(1, 400)
)


@given(boxes)
def test_odd_boxes_have_views(box: Box) -> None:
    view = view_of(np.full((200, 200, 3), 90, np.uint8), box)
    assert 0 not in view.image.shape
    assert with_grey_surroundings(view).shape == view.image.shape


def test_what_is_about_the_person_is_hidden() -> None:
    view = view_of(np.full((300, 280, 3), 90, np.uint8), Box(100, 100, 40, 100))
    shown = with_grey_surroundings(view)
    rows, columns = shown.shape[:2]
    assert (shown[rows // 2, columns // 2] == 90).all()
    assert shown[rows // 2, 0].tolist() == pytest.approx([127] * 3, abs=1)
