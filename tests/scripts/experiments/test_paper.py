"""The paper's experiments: their data, what is counted, and the descriptors that are compared."""

import importlib
from types import ModuleType

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from descriptor.descriptor import DiagonalDescriptor
from descriptor.silhouette import HEIGHT, WIDTH
from scripts.experiments.paper_data import DATA, errors_px, nearest, read_paper_data, recognised
from scripts.index.descriptor_learning import view_joints
from scripts.index.simulate import Simulation
from tests.conftest import SHARED

Data = tuple[Simulation, Simulation]


@pytest.fixture(scope="module")
def data() -> Data:
    return read_paper_data()


@pytest.fixture(scope="module")
def paper() -> ModuleType:
    """The experiments: imported here, since every process that collects tests would wait for it."""
    return importlib.import_module("scripts.experiments.paper")


def test_there_are_as_many_silhouettes_as_in_the_paper(data: Data) -> None:
    assert [len(part) for part in data] == [2925, 608]
    assert DATA.stat().st_size < 550_000
    for part in data:
        silhouettes = part.silhouettes(slice(None))
        assert silhouettes.shape[1:] == (HEIGHT, WIDTH)
        # Normalised: each touches the frame above and below, or left and right.
        tall = silhouettes[:, [0, -1]].any(axis=2).all(axis=1)
        wide = silhouettes[:, :, [0, -1]].any(axis=1).all(axis=1)
        assert (tall | wide).all()


def test_unseen_frames_are_known_of_no_body_and_from_no_view(data: Data) -> None:
    known, unseen = (
        {tuple(row) for row in part.skeleton_labels[["clip", "frame"]]} for part in data
    )
    assert len(unseen) == 19 and not known & unseen


def test_the_papers_descriptor_recognises_what_the_page_says(data: Data) -> None:
    known, unseen = data
    describe = DiagonalDescriptor().describe
    vectors = [describe(part.silhouettes(slice(None))) for part in data]
    joints = view_joints(known)[1][nearest(*vectors, 7)]
    errors = errors_px(joints, view_joints(unseen)[1])
    assert recognised(errors, 1) == pytest.approx(93.42, abs=0.2)
    assert recognised(errors, 7) == pytest.approx(97.37, abs=0.2)


def test_published_rates_are_shares_of_252_and_not_of_608(paper: ModuleType) -> None:
    for rate in {rate for n in paper.COUNTS for rate in paper.PUBLISHED[n]} - {100.0}:
        shares = [round(100 * round(rate * of / 100) / of, 2) for of in (paper.PUBLISHED_OF, 608)]
        assert shares[0] == rate != shares[1]


@pytest.mark.parametrize("scale", [1, 2])
def test_the_amplitude_that_meets_the_published_fall_is_interpolated(
    paper: ModuleType, scale: int
) -> None:
    stds_px = scale * np.array(paper.PUBLISHED_STDS_PX)
    rates = np.interp(paper.STDS_PX, stds_px, paper.PUBLISHED[1])
    met = paper.met_at_px({1: {"paper": rates.tolist()}})
    assert met == {"published_at_2": pytest.approx(2 * scale), "published_at_3": 3 * scale}
    level = paper.met_at_px({1: {"paper": [90.0] * len(paper.STDS_PX)}})
    assert level["published_at_3"] is None


@pytest.mark.slow
def test_the_data_that_ships_is_what_the_command_renders(data: Data) -> None:
    pytest.importorskip("anny", reason="needs the extra build")
    if not (SHARED / "mocap").is_dir():
        pytest.skip(f"no motion capture in {SHARED}")
    from scripts.experiments.paper_simulation import simulate

    for ships, rendered in zip(data, simulate(SHARED / "mocap"), strict=True):
        assert_array_equal(ships.silhouettes(slice(None)), rendered.silhouettes(slice(None)))
        assert_array_equal(ships.skeletons, rendered.skeletons)
