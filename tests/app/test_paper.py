"""The paper's method: figure 1 from a photograph to poses, without a network."""

import cv2
import numpy as np
import pytest

from app.camera import CameraSession
from app.estimation.upload import Upload
from app.paper import likely_shape
from app.photograph import Estimator, MethodError, load_estimator
from app.settings import Settings
from app.vision.geometry import Box
from index.store import PoseIndex
from tests.conftest import ROOT, WALKERS

DATA = ROOT / "tests" / "data"
STREET = WALKERS.read_bytes()


@pytest.fixture(scope="module")
def paper(settings: Settings) -> Estimator:
    """An estimator by the paper's method over the tiny index."""
    return load_estimator(settings.model_copy(update={"method": "paper"}))


def test_every_walker_has_entries_in_the_order_of_their_distances(
    paper: Estimator, walkers: list[Box]
) -> None:
    persons = paper.estimate(Upload(STREET), 7).persons
    for walker in walkers:
        person = max(persons, key=lambda one: one.box.iou(walker))
        assert person.box.iou(walker) > 0.4
        assert person.source == "detector"
        assert person.silhouette is not None and person.silhouette.segmenter == "grabcut"
        assert person.landmarks is None
        distances = [one.distance for one in person.hypotheses]
        assert len(distances) == 7
        assert distances == sorted(distances)
        assert all(0 < one.confidence < 1 for one in person.hypotheses)


def test_a_background_cuts_out_whom_hog_detects(paper: Estimator) -> None:
    yard, empty = ((DATA / name).read_bytes() for name in ("yard.jpg", "yard-empty.jpg"))
    persons = paper.estimate(Upload(yard, background=empty)).persons
    assert persons
    for person in persons:
        assert person.silhouette is not None and person.silhouette.segmenter == "background"


def test_without_networks_there_is_no_other_method(paper: Estimator) -> None:
    assert paper.by() is paper is paper.by("paper")
    with pytest.raises(MethodError, match="no network"):
        paper.by("networks")
    with pytest.raises(MethodError, match="no network"):
        paper.by("paper", "network")
    with pytest.raises(AttributeError, match="no network"):
        _ = paper.models.detector


def test_a_network_cuts_people_out_if_it_is_asked_to(estimator: Estimator) -> None:
    persons = estimator.by("paper", "network").estimate(Upload(STREET)).persons
    segmenters = {one.silhouette.segmenter for one in persons if one.silhouette}
    assert segmenters == {"network"}
    assert len(persons) >= 3
    assert all(one.landmarks is None and one.hypotheses for one in persons)
    with pytest.raises(MethodError, match="expected network"):
        estimator.by("networks", "grabcut")


def test_a_camera_keeps_identities(paper: Estimator) -> None:
    frame = cv2.imread(str(WALKERS))
    session = CameraSession(paper)
    for step in range(3):
        result = session.process(Upload(np.roll(frame, step, axis=1)), step / 10)
    tracked = [one for one in result.persons if one.hypotheses]
    assert len({one.track_id for one in tracked}) == len(tracked) >= 2
    assert all(one.pose is not None for one in tracked)


def test_the_likely_shape_is_a_symmetric_person(tiny_index: PoseIndex) -> None:
    shape = likely_shape(tiny_index)
    assert shape.shape == (128, 48)
    assert np.array_equal(shape, shape[:, ::-1])
    assert 0 <= shape.min() <= shape.max() <= 1
    assert shape[:, 16:32].mean() > 2 * shape[:, [*range(8), *range(40, 48)]].mean()
