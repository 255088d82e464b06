"""Tidying masks: what is small goes, what is large stays."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from app.vision.silhouettes import fill_small_holes, keep_components

masks = arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def test_small_holes_are_filled_and_large_ones_kept() -> None:
    mask = np.ones((40, 40), bool)
    mask[5, 5] = False
    mask[10:30, 10:30] = False
    filled = fill_small_holes(mask, 0.02)
    assert filled[5, 5] and not filled[20, 20]
    assert fill_small_holes(mask, 1.0).all()
    assert (fill_small_holes(mask, 0) == mask).all()


def test_islands_are_dropped() -> None:
    mask = np.zeros((30, 30), bool)
    mask[2:20, 2:10] = True
    mask[25:27, 25:27] = True
    mask[2:20, 15:20] = True
    assert not keep_components(mask, 0.2)[25, 25] and keep_components(mask, 0.2)[3, 16]
    assert np.count_nonzero(keep_components(mask, 1)) == 18 * 8
    assert not keep_components(mask & False, 0.2).any()


@given(mask=masks, share=st.floats(0, 1))
def test_filling_only_adds_and_dropping_only_takes(mask: NDArray[np.bool_], share: float) -> None:
    filled, kept = fill_small_holes(mask, share), keep_components(mask, share)
    assert (filled >= mask).all()
    assert (kept <= mask).all()
    assert kept.any() == mask.any()
    # What reaches the border is no hole.
    edge = np.ones_like(mask)
    edge[1:-1, 1:-1] = False
    assert (filled[edge] == mask[edge]).all()
