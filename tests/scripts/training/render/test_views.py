"""What else a photograph may show: its truth follows what is hidden."""

import numpy as np
import pytest

pytest.importorskip("numba")

from app.vision.judgement import FRAME_POSTURES
from scripts.training.render.scene import Photograph
from scripts.training.render.views import hide
from scripts.training.render_postures import VIEWS, Reader

LYING = FRAME_POSTURES.index("lying")


def photograph(seed: int) -> Photograph:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(80, 200, 2)
    places = rng.uniform(0.1, 0.9, (33, 2)) * [columns, rows]
    low, size = places.min(axis=0), np.ptp(places, axis=0)
    return Photograph(
        rng.integers(0, 256, (rows, columns, 3), np.uint8), np.array([300.0, 300.0]),
        np.array([columns / 2, rows / 2]), np.array([600.0, 400.0]), np.concatenate([low, size]),
        LYING, rng.normal([0, 0, 4], 1, (33, 3)), places, np.ones(33, bool), 0.0, 0.0,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_what_is_hidden_is_not_shown(seed: int) -> None:
    whole = photograph(seed)
    hidden = hide(whole, np.random.default_rng(seed))
    if hidden is whole:
        return
    assert 5 <= hidden.shown.sum() < 33 and 0 < hidden.covered < 1
    # The line of sight of every landmark stays the same.
    np.testing.assert_allclose(hidden.places - hidden.centre, whole.places - whole.centre)
    rows, columns = hidden.image.shape[:2]
    assert hidden.image.dtype == np.uint8 and min(rows, columns) >= 12
    left, top, width, height = hidden.box
    inside = hidden.places[hidden.shown]
    assert (inside >= [left - 2, top - 2]).all()
    assert (inside <= [left + width + 2, top + height + 2]).all()
    assert left + width <= columns + 1 and top + height <= rows + 1
    if hidden.image.shape != whole.image.shape:
        beyond = hidden.places[~hidden.shown] + 0.5
        assert ((beyond < 1.5) | (beyond > np.array([columns, rows]) - 1.5)).any(axis=1).all()


def test_the_service_reads_every_view() -> None:
    rows = Reader.load().rows(3, photograph(1), np.random.default_rng(1))
    assert rows.view.tolist() == list(range(len(VIEWS)))
    assert set(rows.photograph) == {3} and set(rows.posture) == {LYING}
    assert np.isfinite(rows.body).all() and np.isfinite(rows.surroundings).all()
    assert ((rows.right >= 0) & (rows.right <= 1)).all()
