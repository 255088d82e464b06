"""Baseline descriptors: what each is invariant to, and what it must tell apart."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptor.descriptor import DiagonalDescriptor
from descriptor.krawtchouk import weighted_polynomials
from scripts.experiments import baselines


@pytest.fixture
def figure() -> NDArray[np.uint8]:
    """A lopsided person: one arm out, one leg forward."""
    frame = np.zeros((128, 48), np.uint8)
    cv2.ellipse(frame, (24, 50), (8, 22), 0, 0, 360, 1, cv2.FILLED)
    cv2.circle(frame, (24, 20), 8, 1, cv2.FILLED)
    for start, end in (((20, 40), (6, 30)), ((22, 66), (18, 112)), ((28, 66), (40, 105))):
        cv2.line(frame, start, end, 1, 5)
    return frame


def shifted(silhouette: NDArray[np.uint8], down: int, right: int) -> NDArray[np.uint8]:
    return np.roll(silhouette, (down, right), axis=(0, 1))


def test_hu_sees_neither_shift_nor_half_turn_nor_scale(figure: NDArray[np.uint8]) -> None:
    own = baselines.hu_moments(figure[None])
    assert own.shape == (1, 7)
    assert_allclose(baselines.hu_moments(shifted(figure, 6, 1)[None]), own, rtol=1e-4)
    assert_allclose(baselines.hu_moments(np.rot90(figure, 2)[None].copy()), own, rtol=1e-4)
    larger = np.kron(figure, np.ones((2, 2), np.uint8))
    assert_allclose(baselines.hu_moments(larger[None]), own, rtol=0.02)


def test_seventh_of_hu_changes_its_sign_with_mirroring(figure: NDArray[np.uint8]) -> None:
    own = baselines.hu_moments(figure[None])[0]
    mirrored = baselines.hu_moments(figure[None, :, ::-1].copy())[0]
    assert_allclose(mirrored[:6], own[:6], rtol=1e-4)
    assert mirrored[6] == pytest.approx(-own[6], rel=1e-3)


def test_zernike_sees_neither_half_turn_nor_mirroring(figure: NDArray[np.uint8]) -> None:
    pytest.importorskip("mahotas", reason="needs the evaluate extra: mahotas")
    own = baselines.zernike_moments(figure[None], 12)
    assert own.shape == (1, 49)
    assert_allclose(baselines.zernike_moments(np.rot90(figure, 2)[None].copy(), 12), own, atol=1e-5)
    assert_allclose(baselines.zernike_moments(figure[None, :, ::-1].copy(), 12), own, atol=1e-5)
    assert np.abs(baselines.zernike_moments(shifted(figure, 8, 0)[None], 12) - own).max() > 1e-3


@pytest.mark.parametrize(("alpha", "beta"), [(0.0, 0.0), (1.6, 14.4), (15.2, 0.8), (200.0, 200.0)])
def test_hahn_polynomials_are_those_of_their_weight(alpha: float, beta: float) -> None:
    # Independent of the recurrence: Gram-Schmidt (QR) on powers of x under the weight.
    size, orders = 48, 8
    own = baselines.weighted_hahn_polynomials(orders, size, alpha, beta)
    assert_allclose(own @ own.T, np.eye(orders), atol=1e-10)
    x = np.linspace(-1, 1, size)
    powers = own[0][:, None] * x[:, None] ** np.arange(orders)
    oracle = np.linalg.qr(powers)[0].T
    assert_allclose(np.abs(np.einsum("nx,nx->n", own, oracle)), 1, atol=1e-9)


def test_hahn_weight_is_flat_without_concentration() -> None:
    assert_allclose(baselines.weighted_hahn_polynomials(3, 48, 0, 0)[0], 1 / np.sqrt(48))


def test_hahn_becomes_krawtchouk_as_it_concentrates(figure: NDArray[np.uint8]) -> None:
    t, p = 1e7, 0.1
    hahn = baselines.weighted_hahn_polynomials(10, 128, p * t, (1 - p) * t)
    assert_allclose(hahn, weighted_polynomials(10, 128, p), atol=1e-3)
    krawtchouk = DiagonalDescriptor().describe(figure[None])
    assert_allclose(baselines.hahn_moments(figure[None], t), krawtchouk, atol=0.02)


def test_too_many_hahn_orders_are_refused() -> None:
    with pytest.raises(ValueError, match="float64 is too short"):
        baselines.weighted_hahn_polynomials(128, 128, 0.1, 500.0)


def test_shape_contexts_see_neither_shift_nor_scale(figure: NDArray[np.uint8]) -> None:
    points = baselines.outline_points(figure)
    own = baselines.shape_contexts(points)
    assert own.shape == (
        baselines.OUTLINE_POINTS,
        baselines.ANGLES * baselines.RADII,
    )
    assert_allclose(baselines.shape_contexts(points * 2 + 64), own, atol=1e-6)
    assert (own.sum(axis=1) <= 1 + 1e-6).all()
    # Few points lie beyond twice the mean distance.
    assert own.sum() > 0.9 * len(own)


def test_shape_contexts_see_mirroring(figure: NDArray[np.uint8]) -> None:
    points = baselines.outline_points(figure)
    mirrored = points * np.float32([-1, 1])
    assert (
        np.abs(baselines.shape_contexts(mirrored) - baselines.shape_contexts(points)).max() > 0.05
    )


def test_outline_points_lie_on_the_silhouette(figure: NDArray[np.uint8]) -> None:
    x, y = baselines.outline_points(figure, 40).astype(int).T
    assert len(x) == 40
    assert (figure[y, x] == 1).all()


def test_histograms_of_shape_contexts_are_shares(figure: NDArray[np.uint8]) -> None:
    both = np.stack([figure, np.ascontiguousarray(figure[:, ::-1])])
    codebook = baselines.learn_codebook(both, 12, 0)
    histograms = baselines.context_histograms(both, codebook)
    assert_allclose((histograms**2).sum(axis=1), 1, rtol=1e-5)
    assert np.abs(histograms[0] - histograms[1]).max() > 0.01
    assert_allclose(baselines.context_histograms(shifted(figure, 5, 0)[None], codebook)[0],
                    histograms[0], atol=1e-5)  # fmt: skip


def test_hog_and_pixels_have_their_size(figure: NDArray[np.uint8]) -> None:
    assert baselines.hog(figure[None]).shape == (1, 2700)
    assert baselines.pixels(figure[None]).shape == (1, 128 * 48)
    assert baselines.pixels(figure[None]).sum() == figure.sum()
