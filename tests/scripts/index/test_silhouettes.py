import numpy as np
import pytest
from numpy.testing import assert_array_equal

from descriptor.silhouette import pack, unpack
from scripts.index.writer import compress


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    return pack(np.random.default_rng(0).integers(0, 2, (100, 128, 48), np.uint8))


@pytest.mark.parametrize("count", [1, 2, 100])
def test_returns_what_it_was_given(noise: np.ndarray, count: int) -> None:
    stored = compress(noise[:count])
    assert len(stored) == count
    # In any order, and twice.
    for rows in (np.arange(count), np.arange(7, 0, -1) % count, np.arange(count) % 3 == 0):
        numbers = np.arange(count)[rows]
        assert_array_equal(stored.take(numbers), unpack(noise[numbers]))
        selected = stored.select(rows)
        assert_array_equal(selected.take(np.arange(len(selected))), unpack(noise[numbers]))
    assert stored.take([]).shape == (0, 128, 48)


@pytest.mark.parametrize("number", [-1, 100])
def test_refuses_what_is_not_there(noise: np.ndarray, number: int) -> None:
    with pytest.raises(IndexError, match=f"below 100, got {number}"):
        compress(noise).take([number])
