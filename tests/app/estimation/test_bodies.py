"""Labels of a mask that touch: people beside one another, or the parts of one body."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.estimation.upload import UploadError, check_bodies
from app.photograph import Estimator
from app.vision.masks import LabelImage
from index.store import PoseIndex
from tests.conftest import ROOT

STANDING = 57850


@pytest.fixture(scope="module")
def index(shipped: Estimator) -> PoseIndex:
    """The one that ships: it judges what looks like a body."""
    return shipped.index


def body(index: PoseIndex, entry: int) -> NDArray[np.uint8]:
    return np.pad(index.silhouette(entry).astype(np.uint8), 20)


@pytest.mark.parametrize("parts", [3, 6, 12])
@pytest.mark.parametrize("lies", [False, True])
def test_parts_of_a_body_are_refused(index: PoseIndex, parts: int, lies: bool) -> None:
    """As in datasets of human parsing (LIP) and of surfaces (DensePose)."""
    whole = body(index, STANDING)
    bands = whole * (1 + np.arange(len(whole)) * parts // len(whole))[:, None].astype(np.uint8)
    labels = np.rot90(bands).copy() if lies else bands
    with pytest.raises(UploadError, match="labels that together look like one body") as error:
        check_bodies(LabelImage.of(labels), index)
    assert error.value.field == "mask"


def test_people_who_touch_are_kept(index: PoseIndex) -> None:
    one, other = body(index, STANDING), body(index, 99100)
    both = np.zeros((len(one), 240), np.uint8)
    both[:, : one.shape[1]] = one
    both[:, 60 : 60 + one.shape[1]][one > 0] = 3
    beside = both[:, 24 : 24 + other.shape[1]]
    beside[other > 0] = 2
    check_bodies(LabelImage.of(both), index)


def test_people_apart_are_not_compared(index: PoseIndex) -> None:
    mask = cv2.imread(str(ROOT / "tests/data/walkers-mask.png"), cv2.IMREAD_UNCHANGED)
    check_bodies(LabelImage.of(np.asarray(mask, np.uint8)), index)
