"""What a head tells of the azimuth: a density, symmetric, and silent on strange heads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.facing_evidence import WEIGHTS_PATH, AzimuthBelief, FacingModel, head_window
from app.vision.people import Silhouette

strengths = st.floats(-200, 200)
FEATURES = 12


def some_model(seed: int = 0) -> FacingModel:
    rng = np.random.default_rng(seed)
    return FacingModel(
        weights=rng.normal(size=(2, FEATURES)),
        bias=rng.normal(size=2),
        mean=rng.normal(size=FEATURES),
        spread=rng.uniform(0.5, 2, FEATURES),
        usual=np.array([1.0, 1.2]),
    )


def features_at(model: FacingModel, strangeness: float, seed: int = 1) -> np.ndarray:
    direction = np.random.default_rng(seed).normal(size=FEATURES)
    direction *= strangeness / np.sqrt((direction**2).mean())
    return np.asarray(model.mean + model.spread * direction)


class TestAzimuthBelief:
    @given(front=strengths, left=strengths)
    def test_is_a_density_relative_to_knowing_nothing(self, front: float, left: float) -> None:
        density = AzimuthBelief(front, left).likelihood(np.arange(0, 360, 0.5))
        assert (density > 0).all()
        assert density.mean() == pytest.approx(1, abs=1e-3)

    @given(front=strengths, left=strengths)
    def test_opposite_evidence_swaps_front_and_back(self, front: float, left: float) -> None:
        there = AzimuthBelief(front, left).front_probability()
        assert there + AzimuthBelief(-front, -left).front_probability() == pytest.approx(1)
        assert AzimuthBelief(front, -left).front_probability() == pytest.approx(there)

    def test_no_evidence_is_no_preference(self) -> None:
        belief = AzimuthBelief(0.0, 0.0)
        assert belief.likelihood([0.0, 77.0, -180.0]) == pytest.approx(1)
        assert belief.front_probability() == pytest.approx(0.5)

    def test_peaks_where_it_points(self) -> None:
        azimuths = np.arange(-180, 180)
        belief = AzimuthBelief(3 * np.cos(np.deg2rad(40)), 3 * np.sin(np.deg2rad(40)))
        assert azimuths[belief.likelihood(azimuths).argmax()] == 40


class TestFacingModel:
    @pytest.mark.parametrize("strangeness", [0.0, 0.6, 1.0, 1.2])
    def test_reads_usual_heads_in_full(self, strangeness: float) -> None:
        model = some_model()
        features = features_at(model, strangeness)
        assert model.strangeness(features) == pytest.approx(strangeness)
        belief = model.belief(features)
        assert belief is not None
        assert (belief.front, belief.left) == pytest.approx(
            tuple(model.weights @ features + model.bias)
        )

    def test_fades_as_heads_get_strange(self) -> None:
        model = some_model()
        full = model.weights @ features_at(model, 1.3) + model.bias
        half = model.belief(features_at(model, 1.3))
        assert half is not None
        assert (half.front, half.left) == pytest.approx(tuple(full / 2))

    @given(strangeness=st.floats(1.4001, 1e3), seed=st.integers(0, 99))
    def test_says_nothing_of_heads_unlike_any(self, strangeness: float, seed: int) -> None:
        model = some_model()
        assert model.belief(features_at(model, strangeness, seed)) is None

    @pytest.mark.parametrize("name", ["bias", "mean", "spread", "usual"])
    def test_refuses_arrays_that_do_not_fit(self, name: str) -> None:
        arrays = dict(vars(some_model()))
        arrays[name] = np.ones(5)
        with pytest.raises(ValueError, match=f"expected {name} of shape"):
            FacingModel(**arrays)

    def test_the_shipped_one_is_sound(self) -> None:
        with np.load(WEIGHTS_PATH, allow_pickle=False) as stored:
            model = FacingModel(**stored)
        assert (model.spread > 0).all()
        assert 0 < model.usual[0] < model.usual[1]
        assert model.strangeness(model.mean) == 0


@given(left=st.integers(0, 500), top=st.integers(0, 500), height=st.integers(40, 300))
def test_the_head_is_looked_for_about_the_top_of_the_silhouette(
    left: int, top: int, height: int
) -> None:
    crop = np.ones((height, height // 3), bool)
    x, y, width, side = head_window(Silhouette(crop, left, top, "mask", False))
    assert width == side == round(height / 2)
    assert abs(x + width / 2 - (left + height // 3 / 2)) <= 1.5
    assert y < top < y + side
