"""Doubtful detections: kept where joints show."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.detect import CascadeDetector, HogDetector
from app.vision.grabcut import GrabCutSegmenter
from app.vision.joints import JointReader
from app.vision.networks import Networks
from app.vision.people import Box, Detection
from app.vision.people_detector import PeopleDetector, make_detector
from app.vision.second_look import DOUBTED, MOST, believed
from app.vision.segment import NetworkSegmenter
from scripts.experiments.real_data import read_pose2sim

ROOT = Path(__file__).resolve().parents[2]
BALANCING = Path(os.environ.get("SHARED", ROOT / ".." / "shared")) / "real" / "pose2sim"


@pytest.fixture(scope="module")
def reader() -> JointReader:
    return JointReader()


DOUBT = (DOUBTED[0] + DOUBTED[1]) / 2


def test_a_person_is_believed_and_what_is_none_is_not(
    segmenter: NetworkSegmenter,
    reader: JointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
) -> None:
    empty = Box(5.0, 200.0, 40.0, 100.0)
    told = [Detection(walkers[0], DOUBT), Detection(empty, DOUBT)]
    assert all(walkers[0].iou(other) == 0 for other in [empty, *walkers[1:]])
    found = believed(segmenter, reader, street, told, 0.3)
    assert [one.box for one in found] == [walkers[0]]
    assert found[0].score > DOUBT


def test_the_sure_ones_are_left_alone(
    segmenter: NetworkSegmenter, reader: JointReader, street: NDArray[np.uint8]
) -> None:
    sure = [Detection(Box(5.0, 5.0, 20.0, 50.0), score) for score in (0.9, DOUBTED[1] + 0.01)]
    assert believed(segmenter, reader, street, sure, 0.3) == sure
    assert believed(segmenter, reader, street, sure, 0.5) == sure[:1]


def test_few_are_looked_at(
    segmenter: NetworkSegmenter,
    reader: JointReader,
    street: NDArray[np.uint8],
    walkers: list[Box],
) -> None:
    told = [Detection(walkers[0], DOUBT)] * (MOST + 3)
    assert len(believed(segmenter, reader, street, told, 0.0)) == MOST


def test_the_detector_fits_what_there_is(
    networks: Networks, segmenter: NetworkSegmenter, reader: JointReader
) -> None:
    assert isinstance(make_detector(networks, segmenter, reader), PeopleDetector)
    assert isinstance(make_detector(None, GrabCutSegmenter(), reader), HogDetector)


@pytest.mark.skipif(not BALANCING.is_dir(), reason=f"no {BALANCING}")
def test_people_who_bend_are_found(
    networks: Networks, segmenter: NetworkSegmenter, reader: JointReader
) -> None:
    detectors = (CascadeDetector(networks.person), make_detector(networks, segmenter, reader))
    found = [0, 0]
    for frame in read_pose2sim(BALANCING, "cam03", 14):
        for number, detector in enumerate(detectors):
            boxes = [one.box for one in detector.detect(frame.frame)]
            found[number] += any(frame.box.iou(box) >= 0.5 for box in boxes)
    assert found[1] >= found[0] + 2, f"expected two frames more, got {found} of 8"
