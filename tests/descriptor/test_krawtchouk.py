"""Krawtchouk polynomials against their definition and each other, and moments by them."""

from fractions import Fraction
from math import comb, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptor.krawtchouk import diagonal_moments, moments, weighted_polynomials

# The regions of the descriptors: whole body, upper body, lower body, and the width.
SIZES = [(128, 0.5), (128, 0.1), (128, 0.95), (48, 0.5)]


@pytest.mark.parametrize("p", [Fraction(1, 2), Fraction(1, 10), Fraction(19, 20)])
@pytest.mark.parametrize(("size", "orders"), [(9, 9), (128, 5)])
def test_agree_with_hypergeometric_definition(p: Fraction, size: int, orders: int) -> None:
    expected = [[_by_definition(n, x, p, size - 1) for x in range(size)] for n in range(orders)]
    # The recurrence loses some digits towards the last orders, more the nearer p is to 0 or 1.
    assert_allclose(weighted_polynomials(orders, size, float(p)), expected, atol=1e-10)


def _by_definition(n: int, x: int, p: Fraction, last: int) -> float:
    """``2F1(-n, -x; -N; 1/p) sqrt(w / rho)`` in exact fractions up to the root."""
    value = sum(
        Fraction(comb(n, k) * comb(x, k) * (-1) ** k, comb(last, k)) / p**k
        for k in range(min(n, x) + 1)
    )
    weight = comb(last, x) * p**x * (1 - p) ** (last - x)
    norm = ((1 - p) / p) ** n / comb(last, n)
    return float(value) * sqrt(weight / norm)


def test_halves_are_symmetric_or_antisymmetric() -> None:
    polynomials = weighted_polynomials(14, 48, 0.5)
    parity = (-1.0) ** np.arange(14)
    assert_allclose(polynomials[:, ::-1], polynomials * parity[:, None], atol=1e-12)


@pytest.mark.parametrize("orders", [0, 17])
def test_refuses_orders_beyond_the_samples(orders: int) -> None:
    with pytest.raises(ValueError, match=f"expected 1 to 16 orders for 16 samples, got {orders}"):
        weighted_polynomials(orders, 16, 0.5)


@pytest.mark.parametrize("p", [0.0, 1.0, -0.1, float("nan")])
def test_refuses_p_outside_the_open_unit_interval(p: float) -> None:
    with pytest.raises(ValueError, match="expected p between 0 and 1"):
        weighted_polynomials(4, 16, p)


@pytest.mark.parametrize(("size", "p"), SIZES)
def test_never_returns_rows_that_are_not_orthonormal(size: int, p: float) -> None:
    refused = 0
    for orders in range(1, size + 1):
        try:
            polynomials = weighted_polynomials(orders, size, p)
        except ValueError as error:
            assert "float64 is too short" in str(error)
            refused += 1
        else:
            assert_allclose(polynomials @ polynomials.T, np.eye(orders), atol=1e-6)
    assert size - refused >= 28


def _images(count: int, height: int, width: int) -> NDArray[np.uint8]:
    return np.random.default_rng(3).integers(0, 2, (count, height, width)).astype(np.uint8)


def test_moments_equal_the_double_sum() -> None:
    images = _images(2, 12, 7)
    vertical, horizontal = weighted_polynomials(5, 12, 0.3), weighted_polynomials(4, 7, 0.5)
    expected = np.zeros((2, 5, 4))
    for b, n, m, y, x in np.ndindex(2, 5, 4, 12, 7):
        expected[b, n, m] += vertical[n, y] * horizontal[m, x] * images[b, y, x]
    # Rounded to float32 once, at the end.
    assert_allclose(moments(images, vertical, horizontal), expected, rtol=1e-7, atol=1e-12)


def test_diagonal_moments_are_the_diagonal_of_moments() -> None:
    images = _images(3, 128, 48)
    vertical, horizontal = weighted_polynomials(24, 128, 0.1), weighted_polynomials(24, 48, 0.5)
    full = moments(images, vertical, horizontal)
    assert_allclose(
        diagonal_moments(images, vertical, horizontal), np.einsum("bnn->bn", full), atol=1e-4
    )


def test_all_moments_give_the_image_back() -> None:
    images = _images(2, 64, 48)
    vertical, horizontal = weighted_polynomials(64, 64, 0.5), weighted_polynomials(48, 48, 0.5)
    back = vertical.T @ moments(images, vertical, horizontal) @ horizontal
    assert_allclose(back, images, atol=1e-4)
