"""What the tests of vision share: a small street scene, and the network where it was fetched."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.networks import BODY_FILE, PERSON_FILE, Networks, PersonNetwork
from app.vision.people import Box
from app.vision.refine import Refiner
from app.vision.segment import NetworkSegmenter

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "models"


@pytest.fixture(scope="session")
def street() -> NDArray[np.uint8]:
    """298x320 cut of a street scene with three walkers and two people far away."""
    return cv2.imread(str(ROOT / "tests" / "data" / "walkers.jpg"))


@pytest.fixture(scope="session")
def walkers() -> list[Box]:
    """The three walkers of `street`, marked by hand."""
    return [Box(28, 43, 32, 76), Box(135, 162, 40, 105), Box(227, 147, 40, 104)]


@pytest.fixture(scope="session")
def models() -> Path:
    if not all((MODELS / file).is_file() for file in (PERSON_FILE, BODY_FILE)):
        pytest.skip(f"{MODELS} lacks a network; python -m scripts.fetch_models fetches it")
    return MODELS


@pytest.fixture(scope="session")
def person_model(models: Path) -> Path:
    return models / PERSON_FILE


@pytest.fixture(scope="session")
def networks(models: Path) -> Networks:
    return Networks.load(models)


@pytest.fixture(scope="session")
def network(networks: Networks) -> PersonNetwork:
    return networks.person


@pytest.fixture(scope="session")
def segmenter(networks: Networks) -> NetworkSegmenter:
    return NetworkSegmenter(networks, Refiner())
