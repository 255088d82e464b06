"""What the tests of vision share: a small street scene, and the network where it was fetched."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.vision.network import PersonNetwork
from app.vision.people import Box

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "models" / "selfie_segmentation.tflite"


@pytest.fixture(scope="session")
def street() -> NDArray[np.uint8]:
    """298x320 cut of a street scene with three walkers and two people far away."""
    return cv2.imread(str(ROOT / "tests" / "data" / "walkers.jpg"))


@pytest.fixture(scope="session")
def walkers() -> list[Box]:
    """The three walkers of `street`, marked by hand."""
    return [Box(28, 43, 32, 76), Box(135, 162, 40, 105), Box(227, 147, 40, 104)]


@pytest.fixture(scope="session")
def model_path() -> Path:
    if not MODEL.is_file():
        pytest.skip(f"{MODEL} is not there; scripts/fetch_model.py fetches it")
    return MODEL


@pytest.fixture(scope="session")
def network(model_path: Path) -> PersonNetwork:
    return PersonNetwork(model_path)
