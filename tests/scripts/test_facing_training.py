"""How the facing reader is trained and judged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.facing_evidence import CHANNELS, SIZE, AzimuthBelief
from app.vision.joints import READ
from app.vision.people import Box, Silhouette
from index.skeleton import POINT_NAMES, POINTS
from scripts.facing.measure import facing_figures, pixelated

AZIMUTHS = np.array([10.0, 170.0, -60.0, -140.0])


def pointing_at(azimuth_deg: float, kappa: float = 8.0) -> AzimuthBelief:
    angle = np.deg2rad(azimuth_deg)
    return AzimuthBelief(kappa * np.cos(angle), kappa * np.sin(angle))


class TestFigures:
    def test_of_beliefs_that_are_right(self) -> None:
        found = facing_figures([pointing_at(azimuth) for azimuth in AZIMUTHS], AZIMUTHS)
        assert found["right"] == found["right_clear"] == found["within_90_deg"] == 1
        assert found["median_error_deg"] == pytest.approx(0, abs=1e-6)
        assert found["log_likelihood"] > 1

    def test_of_beliefs_that_are_turned_round(self) -> None:
        found = facing_figures([pointing_at(azimuth + 180) for azimuth in AZIMUTHS], AZIMUTHS)
        assert found["right"] == found["within_90_deg"] == 0
        assert found["median_error_deg"] == pytest.approx(180)

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

    def test_varied_people_keep_their_side_and_their_points(self) -> None:
        train = pytest.importorskip("scripts.facing.train")
        samples = pytest.importorskip("scripts.facing.samples")
        seen: NDArray[np.uint8] = np.zeros((1, CHANNELS, SIZE, SIZE), np.uint8)
        # A white person on the left, whose left hand is at the top and right hand at the bottom.
        seen[0, :, 10:50, 5:25] = 255
        points = np.full((1, len(READ), 2), 15.0, np.float32)
        left, right = READ.index("left_wrist"), READ.index("right_wrist")
        points[0, left], points[0, right] = (15, 10), (15, 50)
        known = samples.Samples(seen, seen[:, [3, 7]], points, np.array([70.0], np.float32))
        generator = np.random.default_rng(1)
        azimuths = set()
        for _ in range(20):
            planes, places, azimuth = train.vary(known, 0, generator)
            assert planes.shape == (CHANNELS, SIZE, SIZE) and planes.dtype == np.float32
            assert planes.min() >= 0 and planes.max() <= 1
            for first in (0, 4):
                on_left = planes[first + 3].sum(axis=0).argmax() < SIZE / 2
                assert on_left == (azimuth > 0)
            assert ((places[:, 0] < SIZE / 2) == (azimuth > 0)).all()
            assert (places[left, 1] < places[right, 1]) == (azimuth > 0)
            azimuths.add(azimuth)
        assert azimuths == {-70.0, 70.0}

    def test_samples_show_the_person_and_where_its_points_are(self) -> None:
        samples = pytest.importorskip("scripts.facing.samples")
        scenes = pytest.importorskip("scripts.refinement.scenes")
        cover = np.zeros((1, 200, 120), np.float32)
        cover[0, 20:180, 40:80] = 1
        points = np.full((1, POINTS, 2), (59.5, 99.5))
        points[0, POINT_NAMES.index("left_ankle")] = (79.5, 179.5)
        frame = np.full((200, 120, 3), 90, np.uint8)
        scene = scenes.Scene(frame, cover, [Box(39.5, 19.5, 40, 160)], points, np.array([25.0]))

        class Seer:
            """Sees the person as they are."""

            name = "mask"

            def segment(
                self, frame: NDArray[np.uint8], boxes: list[Box]
            ) -> list[Silhouette | None]:
                return [Silhouette(cover[0, 20:180, 40:80] > 0, 40, 20, "mask", False)]

        ((seen, covers, places, azimuth),) = samples.samples_of(scene, Seer())
        assert azimuth == 25.0
        assert (seen[7] > 127).any(axis=1).sum() == pytest.approx(SIZE / 1.3, abs=2)
        assert np.abs(seen[[3, 7]].astype(int) - covers).max() <= 1
        assert places[READ.index("head")] == pytest.approx([31.5, 31.5], abs=1)
        rows, columns = np.nonzero(covers[1] > 127)
        ankle = places[READ.index("left_ankle")]
        assert ankle == pytest.approx([columns.max(), rows.max()], abs=1)


def test_the_joints_found_on_the_way_count_for_the_belief() -> None:
    torch = pytest.importorskip("torch")
    model = pytest.importorskip("scripts.facing.model").FacingReader().eval()
    seen = torch.rand(2, CHANNELS, SIZE, SIZE)
    odds, belief = model.odds_and_belief(seen)
    assert odds.shape == (2, len(READ), 16, 16) and belief.shape == (2, 2)
    assert torch.equal(model(seen), belief)
    with torch.no_grad():
        model.maps.bias += torch.linspace(-1, 1, len(READ))  # Of a map, all cells alike:
        assert torch.allclose(model(seen), belief, atol=1e-4)  # no other place.
        model.maps.weight += 1
        assert not torch.allclose(model(seen), belief, atol=1e-4)
