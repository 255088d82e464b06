"""Both descriptors: linear in the silhouette, and rebuilt exactly from what a manifest holds."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, DiagonalDescriptor, DiscriminantDescriptor, restore


def discriminant(p2: tuple[float, ...] = (0.5,)) -> DiscriminantDescriptor:
    """Random rows; the first three even, the others odd."""
    projection = np.random.default_rng(1).normal(size=(5, len(p2) * 6, 4)).astype(np.float32)
    projection[:3, :, 1::2] = 0
    projection[3:, :, 0::2] = 0
    return DiscriminantDescriptor(projection.reshape(5, -1), 6, 4, p2=p2)


DESCRIPTORS = [
    DiagonalDescriptor(),
    DiagonalDescriptor(7, 0.5, (0.2,)),
    discriminant(),
    discriminant((0.1, 0.9)),
]


def blobs(count: int) -> NDArray[np.uint8]:
    return np.random.default_rng(2).integers(0, 2, (count, 128, 48)).astype(np.uint8)


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_is_linear(descriptor: Descriptor) -> None:
    one, other = blobs(2).astype(np.float32)
    mixed = descriptor.describe((2 * one - 3 * other)[None])
    apart = descriptor.describe(np.stack([one, other]))
    # float32 over 6,144 pixels with values up to 3.
    assert_allclose(mixed[0], 2 * apart[0] - 3 * apart[1], atol=1e-3)


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_restore_round_trip_through_json(descriptor: Descriptor) -> None:
    back = restore(json.loads(json.dumps(descriptor.parameters())), descriptor.arrays())
    assert back.parameters() == descriptor.parameters()
    assert_array_equal(back.describe(blobs(2)), descriptor.describe(blobs(2)))


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
class TestMirror:
    def test_mirrored_silhouettes_have_mirrored_vectors(self, descriptor: Descriptor) -> None:
        images = blobs(4)
        mirrored = descriptor.describe(images[:, :, ::-1])
        # float32 sums over 6,144 pixels, in another order.
        assert_allclose(mirrored, descriptor.mirror(descriptor.describe(images)), atol=1e-4)


@pytest.mark.parametrize("p1", [0.4, 0.500001, 0.9])
def test_refuses_polynomials_that_are_not_symmetric(p1: float) -> None:
    with pytest.raises(ValueError, match=r"expected p1 = 0\.5"):
        DiagonalDescriptor(p1=p1)
    with pytest.raises(ValueError, match=r"expected p1 = 0\.5"):
        DiscriminantDescriptor(np.zeros((1, 24), np.float32), 6, 4, p1)


def test_refuses_rows_that_mix_even_and_odd_orders() -> None:
    projection = discriminant().projection.copy()
    projection[2, 5] = 1e-3
    with pytest.raises(ValueError, match="row 2 uses both"):
        DiscriminantDescriptor(projection, 6, 4)


def test_diagonal_takes_upper_body_first() -> None:
    # A head moves the first 24 values (p2 = 0.1), feet the last 24 (p2 = 0.95).
    images = np.zeros((2, 128, 48), np.uint8)
    images[0, :16, 18:30] = 1
    images[1, -12:, 18:30] = 1
    energy = DiagonalDescriptor().describe(images) ** 2
    assert energy[0, :24].sum() > 100 * energy[0, 24:].sum()
    assert energy[1, 24:].sum() > 100 * energy[1, :24].sum()


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({**DiagonalDescriptor().parameters(), "name": "fourier"}, "got 'fourier'"),
        (discriminant().parameters(), "projection"),
        *(({k: v for k, v in DiagonalDescriptor().parameters().items() if k != name}, name)
          for name in ("p1", "p2", "orders")),
    ],
)  # fmt: skip
def test_restore_names_what_is_missing_or_unknown(parameters: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        restore(parameters, {})
