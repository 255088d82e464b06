"""What a photograph tells of the azimuth: a density, symmetric, and silent where it is blank."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.vision.facing_evidence import (
    CHANNELS,
    SIZE,
    AzimuthBelief,
    FacingReader,
    FacingView,
    facing_input,
    head_window,
)
from app.vision.joints import WEIGHTS_PATH as JOINTS_PATH
from app.vision.onnx import OnnxError
from app.vision.people import Silhouette

strengths = st.floats(-200, 200)
faces = st.sampled_from([None, True, False])


def street() -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 255, (300, 200, 3))
    return noise.astype(np.uint8)


def some_silhouette(height: int = 150) -> Silhouette:
    return Silhouette(np.ones((height, height // 3), bool), 60, 40, "mask", False)


class TestAzimuthBelief:
    @given(front=strengths, left=strengths, face=faces)
    def test_is_a_density_relative_to_knowing_nothing(
        self, front: float, left: float, face: bool | None
    ) -> None:
        density = AzimuthBelief(front, left, face).likelihood(np.arange(0, 360, 0.5))
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

    @given(front=st.floats(-20, 20), left=st.floats(-20, 20))
    def test_a_face_speaks_for_the_front_and_its_absence_against(
        self, front: float, left: float
    ) -> None:
        seen, unseen, unknown = (
            AzimuthBelief(front, left, face).front_probability() for face in (True, False, None)
        )
        assert unseen <= unknown <= seen

    def test_a_face_says_nothing_of_the_side(self) -> None:
        belief = AzimuthBelief(0.0, 0.0, True)
        assert belief.likelihood(30.0) == pytest.approx(belief.likelihood(-30.0))
        assert belief.azimuth_deg() == pytest.approx(0, abs=1)

    def test_peaks_where_it_points(self) -> None:
        azimuths = np.arange(-180, 180)
        belief = AzimuthBelief(3 * np.cos(np.deg2rad(40)), 3 * np.sin(np.deg2rad(40)))
        assert azimuths[belief.likelihood(azimuths).argmax()] == 40
        assert belief.azimuth_deg() == pytest.approx(40, abs=1)


class TestFacingReader:
    reader = FacingReader()

    def test_says_nothing_where_nothing_is_to_be_seen(self) -> None:
        blank = np.full((300, 200, 3), 90, np.uint8)
        assert self.reader.read(blank, some_silhouette()) is None

    def test_says_nothing_of_thumbnails(self) -> None:
        assert self.reader.read(street(), some_silhouette(height=39)) is None

    def test_says_nothing_of_bodies_whose_head_the_frame_cuts(self) -> None:
        cut = replace(some_silhouette(), top=0, truncated=True)
        assert self.reader.read(street(), cut) is None
        assert self.reader.read(street(), replace(cut, truncated=False)) is not None

    def test_the_same_picture_gives_the_same_belief(self) -> None:
        first, second = (self.reader.read(street(), some_silhouette()) for _ in range(2))
        assert first is not None
        assert first == second

    @pytest.mark.parametrize("content", [b"", b"no network"])
    def test_a_broken_file_is_refused(self, tmp_path: Path, content: bytes) -> None:
        broken = tmp_path / "facing.onnx"
        broken.write_bytes(content)
        with pytest.raises(OnnxError):
            FacingReader(broken)

    def test_another_network_is_refused(self) -> None:
        with pytest.raises(OnnxError):
            FacingReader(JOINTS_PATH)


def test_the_network_sees_the_head_and_the_whole_person() -> None:
    view = FacingView.of(some_silhouette())
    assert view is not None
    planes = facing_input(street(), view)
    assert planes.shape == (CHANNELS, SIZE, SIZE)
    head, body = planes[3] > 127, planes[7] > 127
    # Head and shoulders fill the columns of their window, to its lower edge.
    assert head[-1].any()
    assert not head[0].any()
    # All of the person lies inside the other, with room about it.
    assert not body[[0, -1]].any()
    assert body.any(axis=1).sum() == pytest.approx(SIZE / 1.3, abs=2)


@given(left=st.integers(0, 500), top=st.integers(0, 500), height=st.integers(40, 300))
def test_the_head_is_looked_for_about_the_top_of_the_silhouette(
    left: int, top: int, height: int
) -> None:
    crop = np.ones((height, height // 3), bool)
    x, y, width, side = head_window(Silhouette(crop, left, top, "mask", False))
    assert width == side == round(height / 2)
    assert abs(x + width / 2 - (left + height // 3 / 2)) <= 1.5
    assert y < top < y + side
