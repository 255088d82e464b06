"""What moves before a fixed camera, on drawn scenes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from app.tracking.moving import BackgroundModel, MovingRegions, reduction
from app.vision.people import Box

ROWS, COLUMNS = 120, 160


def scene(seed: int, light: float = 1.0) -> NDArray[np.uint8]:
    """The empty scene, with noise."""
    rng = np.random.default_rng(seed)
    across = 100 + 60 * np.sin(np.arange(COLUMNS) / 9)[None, :, None]
    noise = rng.normal(0, 2, (ROWS, COLUMNS, 3))
    return np.clip(light * (across + noise), 0, 255).astype(np.uint8)


def learnt() -> BackgroundModel:
    """A model that has seen the empty scene for two seconds."""
    model = BackgroundModel()
    for number in range(20):
        model.update(scene(number), number / 10)
    return model


def with_person(frame: NDArray[np.uint8], left: int) -> NDArray[np.uint8]:
    frame = frame.copy()
    frame[30:100, left : left + 24] = (20, 200, 30)
    return frame


def regions(*rectangles: tuple[int, int, int, int], factor: int = 1) -> MovingRegions:
    """Regions of rectangles given as left, top, width and height in the reduced frame."""
    mask = np.zeros((ROWS, COLUMNS), bool)
    for left, top, width, height in rectangles:
        mask[top : top + height, left : left + width] = True
    return MovingRegions.of(mask, factor, (factor * ROWS, factor * COLUMNS))


class TestBackgroundModel:
    def test_knows_nothing_at_first(self) -> None:
        model = BackgroundModel()
        results = [model.update(scene(number), number / 10) for number in range(20)]
        assert results[:10] == [None] * 10
        assert all(moving is not None for moving in results[11:])

    def test_an_empty_scene_does_not_move(self) -> None:
        moving = learnt().update(scene(99), 2.0)
        assert moving is not None
        assert moving.moving_share(Box(-0.5, -0.5, COLUMNS, ROWS)) < 0.01

    def test_cuts_out_who_enters(self) -> None:
        moving = learnt().update(with_person(scene(99), 50), 2.0)
        assert moving is not None
        (silhouette,) = moving.silhouettes([Box(48, 28, 28, 74)])
        assert silhouette is not None and silhouette.segmenter == "background"
        truth = np.zeros((ROWS, COLUMNS), bool)
        truth[30:100, 50:74] = True
        mask = silhouette.mask(truth.shape)
        assert (mask & truth).sum() / (mask | truth).sum() > 0.95

    @pytest.mark.parametrize("change", ["light", "shake"])
    def test_begins_anew_where_most_of_the_frame_changes(self, change: str) -> None:
        model = learnt()
        changed = scene(99, 1.8) if change == "light" else np.roll(scene(99), 20, axis=1)
        assert model.update(changed, 2.0) is None
        later = [
            model.update(
                scene(number, 1.8) if change == "light" else np.roll(scene(number), 20, axis=1),
                2.1 + number / 10,
            )
            for number in range(20)
        ]
        assert later[0] is None
        assert later[-1] is not None
        assert later[-1].moving_share(Box(0, 0, COLUMNS - 1, ROWS - 1)) < 0.01

    def test_what_stays_becomes_background(self) -> None:
        model = learnt()
        there = Box(50, 30, 24, 70)
        shares = []
        for second in range(100):
            moving = model.update(with_person(scene(second), 50), 3.0 + second)
            assert moving is not None
            shares.append(moving.moving_share(there))
        assert shares[0] > 0.95
        assert shares[-1] < 0.05

    def test_memory_follows_the_reduced_size(self) -> None:
        model = BackgroundModel()
        assert model.memory_bytes == 0
        model.update(scene(0), 0.0)
        assert model.memory_bytes >= 48 * ROWS * COLUMNS


@pytest.mark.parametrize(
    ("rows", "columns", "factor"), [(576, 768, 1), (720, 1280, 2), (1080, 1920, 3), (1, 1, 1)]
)
def test_large_frames_are_reduced(rows: int, columns: int, factor: int) -> None:
    assert reduction((rows, columns, 3)) == factor


class TestMovingRegions:
    def test_somebody_alone_is_clear(self) -> None:
        (silhouette,) = regions((40, 20, 20, 60)).silhouettes([Box(42, 22, 20, 60)])
        assert silhouette is not None
        assert (silhouette.left, silhouette.top) == (40, 20)
        assert silhouette.crop.shape == (60, 20)

    def test_pieces_of_one_person_belong_together(self) -> None:
        (silhouette,) = regions((40, 20, 20, 25), (40, 47, 20, 33)).silhouettes(
            [Box(40, 20, 20, 60)]
        )
        assert silhouette is not None
        assert silhouette.crop.shape == (60, 20)
        assert not silhouette.crop[25:27].any()

    def test_two_who_touch_are_not_clear(self) -> None:
        both = [Box(40, 20, 20, 60), Box(60, 20, 20, 60)]
        assert regions((40, 20, 40, 60)).silhouettes(both) == [None, None]

    def test_somebody_who_touches_a_stranger_is_not_clear(self) -> None:
        assert regions((40, 20, 60, 60)).silhouettes([Box(40, 20, 20, 60)]) == [None]

    def test_half_a_person_is_not_clear(self) -> None:
        assert regions((40, 20, 20, 30)).silhouettes([Box(40, 20, 20, 60)]) == [None]

    def test_neighbours_apart_are_both_clear(self) -> None:
        moving = regions((40, 20, 20, 60), (70, 20, 20, 60))
        found = moving.silhouettes([Box(40, 20, 20, 60), Box(70, 20, 20, 60)])
        assert [silhouette and silhouette.left for silhouette in found] == [40, 70]

    def test_neighbours_in_each_other_s_room_are_both_clear(self) -> None:
        moving = regions((40, 20, 20, 60), (63, 20, 20, 60))
        found = moving.silhouettes([Box(39, 20, 22, 60), Box(62, 20, 22, 60)])
        assert [silhouette and silhouette.crop.shape for silhouette in found] == [(60, 20)] * 2

    def test_one_behind_another_is_not_clear(self) -> None:
        both = [Box(40, 20, 20, 60), Box(46, 18, 20, 58)]
        assert regions((40, 18, 26, 62)).silhouettes(both) == [None, None]

    def test_nothing_moves(self) -> None:
        assert regions().silhouettes([Box(40, 20, 20, 60)]) == [None]
        assert regions().silhouettes([]) == []
        assert regions().unexplained([], 20) == []

    def test_reduced_frames_give_silhouettes_in_the_frame(self) -> None:
        (silhouette,) = regions((40, 20, 20, 60), factor=3).silhouettes([Box(120, 60, 60, 180)])
        assert silhouette is not None
        assert_array_equal(
            [silhouette.left, silhouette.top, *silhouette.crop.shape], [120, 60, 180, 60]
        )

    def test_a_person_at_the_corner_stays_inside(self) -> None:
        moving = regions((COLUMNS - 20, ROWS - 60, 20, 60), factor=2)
        (silhouette,) = moving.silhouettes([Box(2 * (COLUMNS - 20), 2 * (ROWS - 60), 40, 120)])
        assert silhouette is not None
        assert silhouette.mask((2 * ROWS, 2 * COLUMNS)).sum() == 2 * 60 * 2 * 20

    def test_what_nobody_explains_is_told(self) -> None:
        moving = regions((10, 20, 20, 60), (100, 30, 20, 50), (60, 60, 10, 10))
        assert [box.x for box in moving.unexplained([], 40)] == [9.5, 99.5]
        (left,) = moving.unexplained([Box(10, 20, 20, 60)], 40)
        assert (left.x, left.y, left.width, left.height) == (99.5, 29.5, 20, 50)
