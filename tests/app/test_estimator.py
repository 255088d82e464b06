"""What an estimator asks of the photograph, and when."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from app.estimates import Found, Person, Scene, Stopwatch, Upload
from app.estimator import Estimator
from app.vision.joints import JointReader
from app.vision.people import Box, silhouette_from_mask
from app.vision.turning import turned_box, turned_points, turned_silhouette
from tests.conftest import ROOT, Photo, png

BOXES = (Box(145, 35, 60, 140),)
WALKERS = ROOT / "tests" / "data" / "walkers.jpg"


@pytest.fixture(scope="module")
def pair(estimator: Estimator) -> tuple[Estimator, Estimator]:
    """One that reads joints, and one that does not."""
    return tuple(
        Estimator(
            estimator.index, estimator.detector, estimator.segmenter,
            min_person_px=50, max_pixels=10**6, max_persons=5, joint_reader=one,
        )
        for one in (JointReader(), None)
    )  # type: ignore[return-value] # fmt: skip


def persons(estimator: Estimator, upload: Upload) -> Sequence[Person]:
    return estimator.estimate(upload, 5, lambda: None).persons


def test_joints_are_read_of_people_whom_the_service_cuts_out(
    pair: tuple[Estimator, Estimator], photo: Photo
) -> None:
    reading, plain = (persons(one, Upload(photo.frame_png, boxes=BOXES))[0] for one in pair)
    assert reading.facing is not None and plain.facing is not None
    assert reading.facing.evidence == "image"
    assert plain.facing.evidence == "none"
    assert any(one.hypothesis.log_likelihood < 0 for one in reading.hypotheses)
    assert all(one.hypothesis.log_likelihood == 0 for one in plain.hypotheses)
    confidences = [one.confidence for one in reading.hypotheses]
    assert confidences == sorted(confidences, reverse=True)


def test_a_callers_mask_is_taken_at_its_word(
    pair: tuple[Estimator, Estimator], photo: Photo
) -> None:
    upload = Upload(photo.frame_png, mask=photo.mask_png)
    reading, plain = (persons(one, upload)[0] for one in pair)
    assert [one.hypothesis.entry for one in reading.hypotheses] == [
        one.hypothesis.entry for one in plain.hypotheses
    ]
    assert all(one.hypothesis.lean_deg == 0 for one in reading.hypotheses)


def test_the_camera_of_somebody_who_leans_is_turned(
    pair: tuple[Estimator, Estimator], photo: Photo
) -> None:
    for placed in persons(pair[0], Upload(photo.frame_png, boxes=BOXES))[0].hypotheses:
        one = placed.hypothesis
        label = pair[0].index.label(one.entry, mirrored=one.mirrored)
        assert placed.label.roll_deg == pytest.approx(label.roll_deg + one.lean_deg)


@pytest.mark.parametrize("turns", [1, 3])
def test_somebody_who_lies_has_the_poses_of_the_same_person_upright(
    pair: tuple[Estimator, Estimator], photo: Photo, turns: int
) -> None:
    estimator, shape = pair[0], photo.frame.shape
    silhouette = silhouette_from_mask(photo.mask > 0, segmenter="network", truncated=False)
    assert silhouette is not None
    standing = Found(silhouette.box, "hog", 0.9, silhouette)
    lies = turned_silhouette(silhouette, shape, -turns)
    lying = Found(lies.box, "hog", 0.9, lies, turns)
    upright, turned = (
        estimator.with_hypotheses(
            Scene(lambda frame=frame: frame, (found,)), 5, lambda: None, Stopwatch()
        )[0]
        for frame, found in ((photo.frame, standing), (np.rot90(photo.frame, -turns), lying))
    )
    assert upright.facing == turned.facing
    for one, other in zip(upright.hypotheses, turned.hypotheses, strict=True):
        assert one.hypothesis.entry == other.hypothesis.entry
        assert other.hypothesis.lean_deg - one.hypothesis.lean_deg == (90 if turns == 1 else -90)
        assert_allclose(turned_points(one.points_2d, shape, -turns), other.points_2d, atol=1e-6)
        # The bodies turn as their pictures do; depth stays.
        x, y, z = one.hypothesis.points_3d.T
        sign = 1 if turns == 1 else -1
        assert_allclose(other.hypothesis.points_3d.T, [-sign * y, sign * x, z], atol=1e-9)


def test_wide_boxes_and_masks_are_looked_at_either_way(
    pair: tuple[Estimator, Estimator],
) -> None:
    street = cv2.imread(str(WALKERS))
    walker = Box(135, 162, 40, 105)
    lying, box = np.rot90(street), turned_box(walker, street.shape, 1)
    by_box = [persons(one, Upload(png(lying), boxes=(box,)))[0].found for one in pair]
    assert [one.turns for one in by_box] == [3, 0], "only joints tell which way up somebody is"
    silhouette = by_box[0].silhouette
    assert silhouette is not None
    upload = Upload(png(lying), mask=png(silhouette.mask(lying.shape).astype(np.uint8)))
    by_mask = [persons(one, upload)[0].found for one in pair]
    assert [one.turns for one in by_mask] == [3, 0]
    (upright,) = persons(pair[0], Upload(png(street), boxes=(walker,)))
    assert upright.found.turns == 0
