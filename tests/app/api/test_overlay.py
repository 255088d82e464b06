"""Placement of labels in the overlay."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from app.api.overlay import _below_others, _Label

HEIGHT = 15

wanted = st.builds(
    lambda left, width, bottom: _Label(left, left + width, bottom),
    st.integers(0, 200), st.integers(1, 80), st.integers(0, 100),
)  # fmt: skip


@given(st.lists(wanted, max_size=20))
def test_no_label_covers_another(labels: list[_Label]) -> None:
    placed: list[_Label] = []
    for label in labels:
        placed.append(_below_others(label, placed, HEIGHT))
        assert placed[-1].bottom >= label.bottom
    for one, other in combinations(placed, 2):
        apart = one.right <= other.left or other.right <= one.left
        assert apart or abs(one.bottom - other.bottom) >= HEIGHT
