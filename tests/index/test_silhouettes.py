import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from descriptor.silhouette import outline_distances, pack, unpack
from index.silhouettes import Silhouettes
from index.store import PoseIndex


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    return pack(np.random.default_rng(0).integers(0, 2, (100, 128, 48), np.uint8))


@pytest.mark.parametrize("count", [1, 2, 100])
def test_returns_what_it_was_given(noise: np.ndarray, count: int) -> None:
    stored = Silhouettes.compress(noise[:count])
    assert len(stored) == count
    # In any order, and twice.
    for rows in (np.arange(count), np.arange(7, 0, -1) % count, np.arange(count) % 3 == 0):
        numbers = np.arange(count)[rows]
        assert_array_equal(stored.take(numbers), unpack(noise[numbers]))
        selected = stored.select(rows)
        assert_array_equal(selected.take(np.arange(len(selected))), unpack(noise[numbers]))
    assert stored.take([]).shape == (0, 128, 48)


def test_outlines_compress_several_times(toy_index: PoseIndex) -> None:
    stored = toy_index.silhouette_store
    assert len(stored.data) < len(stored) * 768 / 3


def test_silhouettes_compress_block_by_block(
    noise: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Silhouettes.compress(noise)
    monkeypatch.setattr("index.silhouettes._BLOCK", 30)
    blocks = Silhouettes.compress(noise)
    for field in ("data", "ends", "dictionary"):
        assert_array_equal(getattr(blocks, field), getattr(whole, field))


class TestHalved:
    def test_each_stored_pixel_shows_what_most_of_four_do(self) -> None:
        blocks = np.random.default_rng(0).integers(0, 2, (100, 64, 24), np.uint8)
        whole = blocks.repeat(2, axis=1).repeat(2, axis=2)
        one_off = whole.copy()
        one_off[:, 1::2, 1::2] ^= 1
        for silhouettes in (whole, one_off):
            halved = Silhouettes.compress(pack(silhouettes)).halved().take(np.arange(100))
            # Enlarging changes at most one of four pixels.
            shown = halved.reshape(100, 64, 2, 24, 2).sum(axis=(2, 4))
            assert not (shown == 2).any()
            assert_array_equal(shown > 2, blocks)

    def test_outlines_hardly_move_and_take_half_the_bytes(self, toy_index: PoseIndex) -> None:
        stored = toy_index.silhouette_store
        rows = np.arange(len(stored))
        pairs = zip(stored.take(rows), stored.halved().take(rows), strict=True)
        moved = [outline_distances(whole, halved[None])[0] for whole, halved in pairs]
        assert np.mean(moved) < 0.4
        assert len(stored.halved().data) < 0.6 * len(stored.data)

    def test_selects_as_before(self, noise: np.ndarray) -> None:
        halved, rows = Silhouettes.compress(noise).halved(), np.arange(60, 100)
        assert_array_equal(halved.select(rows).take(np.arange(40)), halved.take(rows))

    def test_is_not_halved_twice(self, noise: np.ndarray) -> None:
        with pytest.raises(ValueError, match="at full resolution"):
            Silhouettes.compress(noise).halved().halved()


@pytest.mark.parametrize("number", [-1, 100])
def test_refuses_what_is_not_there(noise: np.ndarray, number: int) -> None:
    with pytest.raises(IndexError, match=f"below 100, got {number}"):
        Silhouettes.compress(noise).take([number])


@pytest.mark.parametrize("shape", [(0, 768), (3, 767), (768,)])
def test_compresses_packed_silhouettes_only(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected silhouettes of shape"):
        Silhouettes.compress(np.zeros(shape, np.uint8))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("data", np.zeros(5, np.uint8), "bytes of silhouettes, got 5"),
        ("data", np.zeros((2, 2), np.uint8), "expected data of silhouettes as a row"),
        ("ends", np.zeros(3, np.int64), "ascending ends"),
        ("ends", np.zeros(0, np.int64), "ascending ends"),
        ("step", 3, "every or every second pixel"),
        ("dictionary", np.zeros(3, np.int64), "expected dictionary of silhouettes as a row"),
    ],
)
def test_parts_must_fit(noise: np.ndarray, field: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(Silhouettes.compress(noise), **{field: value})
