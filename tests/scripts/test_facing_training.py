"""How the facing reader is trained and judged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.facing_evidence import CHANNELS, SIZE, AzimuthBelief
from app.vision.people import Silhouette
from index.skeleton import POINTS
from scripts.facing.measure import facing_figures, pixelated

AZIMUTHS = np.array([10.0, 170.0, -60.0, -140.0])


def pointing_at(azimuth_deg: float, kappa: float = 8.0) -> AzimuthBelief:
    angle = np.deg2rad(azimuth_deg)
    return AzimuthBelief(kappa * np.cos(angle), kappa * np.sin(angle))


class TestFigures:
    def test_of_beliefs_that_are_right(self) -> None:
        found = facing_figures([pointing_at(azimuth) for azimuth in AZIMUTHS], AZIMUTHS)
        assert found["right"] == found["right_clear"] == found["within_90_deg"] == 1
        assert found["median_error_deg"] <= 0.5
        assert found["log_likelihood"] > 1

    def test_of_beliefs_that_are_turned_round(self) -> None:
        found = facing_figures([pointing_at(azimuth + 180) for azimuth in AZIMUTHS], AZIMUTHS)
        assert found["right"] == found["within_90_deg"] == 0
        assert found["median_error_deg"] > 179

    def test_faces_are_counted_where_there_are_any(self) -> None:
        beliefs = [AzimuthBelief(0.0, 0.0, face) for face in (True, True, None, False)]
        found = facing_figures(beliefs, AZIMUTHS)
        assert (found["faces_within_30_deg"], found["faces_found_of_them"]) == (1, 1)
        assert (found["backs"], found["faces_found_of_backs"]) == (2, 1)

    def test_of_no_beliefs(self) -> None:
        found = facing_figures([None] * 4, AZIMUTHS)
        assert found["log_likelihood"] == pytest.approx(0)
        assert found["brier"] == pytest.approx(0.25)


def test_pixelated_faces_have_few_colours_and_the_rest_is_left_alone() -> None:
    frame = np.random.default_rng(0).integers(0, 255, (240, 160, 3)).astype(np.uint8)
    one = Silhouette(np.ones((200, 60), bool), 50, 20, "mask", False)
    changed = (pixelated(frame, one, 3) != frame).any(axis=2)
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    assert rows[0] > 20 and rows[-1] < 20 + 0.16 * 200
    assert columns[0] > 50 and columns[-1] < 110
    face = pixelated(frame, one, 3)[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    assert len(np.unique(face.reshape(-1, 3), axis=0)) == 9


class TestTraining:
    @pytest.fixture(autouse=True)
    def _needs_torch(self) -> None:
        # What is imported here takes no time of the examples.
        pytest.importorskip("torch")
        pytest.importorskip("scripts.facing.train")

    @given(front=st.floats(-20, 20), left=st.floats(-20, 20), azimuth=st.floats(-3.1, 3.1))
    def test_the_loss_is_the_density_of_a_belief(
        self, front: float, left: float, azimuth: float
    ) -> None:
        torch = pytest.importorskip("torch")
        train = pytest.importorskip("scripts.facing.train")
        answers = torch.tensor([[front, left]], dtype=torch.float64)
        loss = float(train.loss_of(answers, torch.tensor([azimuth], dtype=torch.float64)))
        kappa = np.hypot(front, left)
        density = np.exp(front * np.cos(azimuth) + left * np.sin(azimuth)) / np.i0(kappa)
        assert loss == pytest.approx(-np.log(density), rel=1e-5, abs=1e-5)

    def test_people_are_varied_alike_with_their_azimuth(self) -> None:
        train = pytest.importorskip("scripts.facing.train")
        samples = pytest.importorskip("scripts.facing.samples")
        views: NDArray[np.uint8] = np.zeros((1, 2, samples.PLANES, SIZE, SIZE), np.uint8)
        # A white person on the left, before black pictures.
        views[0, :, :, 10:50, 5:25] = 255
        known = samples.Samples(views, np.array([70.0], np.float32))
        black = [np.zeros((SIZE, SIZE, 3), np.uint8)]
        generator = np.random.default_rng(1)
        azimuths = set()
        for _ in range(20):
            seen, azimuth = train.vary(known, 0, black, generator)
            assert seen.shape == (CHANNELS, SIZE, SIZE) and seen.dtype == np.float32
            assert seen.min() >= 0 and seen.max() <= 1
            for first in (0, 4):
                on_left = seen[first + 3].sum(axis=0).argmax() < SIZE / 2
                assert on_left == (azimuth > 0)
            azimuths.add(azimuth)
        assert azimuths == {-70.0, 70.0}

    def test_both_windows_show_the_person(self) -> None:
        samples = pytest.importorskip("scripts.facing.samples")
        sprites = pytest.importorskip("scripts.refinement.sprites")
        cover = np.zeros((170, 80), np.float32)
        cover[5:165, 20:60] = 1
        points = np.full((POINTS, 2), 40.0)
        points[:, 1] = 20.0
        grey = np.full((170, 80, 3), 90, np.uint8)
        generator = np.random.default_rng(0)
        for head_row, shown in ((20.0, True), (90.0, False)):
            points[:, 1] = head_row
            found = samples.views_of(sprites.Sprite(grey, cover, cover, points, 0.0), generator)
            assert found is not None
            views, hit = found
            assert hit == shown
            # All of the person is in the second window, and half of it in the first.
            assert (views[1, 3] > 127).any(axis=1).sum() == pytest.approx(SIZE / 1.3, abs=2)
            assert views[0, 3, -1].max() == 255 and views[0, 3, 0].max() == 0
