"""Faces seen from the front."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from app.vision.face import FaceError, FaceFinder
from app.vision.resampling import Window

WHOLE: Window = (0, 0, 200, 200)


@pytest.fixture(scope="module")
def finder() -> FaceFinder:
    return FaceFinder()


def painted_face() -> NDArray[np.uint8]:
    """Hair, brows, eyes, nose and mouth on an oval, out of focus."""
    picture = np.full((200, 200, 3), 120, np.uint8)

    def oval(x: int, y: int, width: int, height: int, colour: tuple[int, int, int]) -> None:
        cv2.ellipse(picture, (x, y), (width, height), 0, 0, 360, colour, -1)

    oval(100, 100, 42, 56, (150, 175, 220))
    cv2.ellipse(picture, (100, 62), (46, 30), 0, 180, 360, (30, 35, 45), -1)
    for x in (82, 118):
        oval(x, 90, 11, 6, (60, 70, 90))
        oval(x, 78, 13, 4, (50, 55, 70))
    oval(100, 112, 7, 5, (110, 135, 180))
    oval(100, 132, 16, 5, (90, 90, 160))
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 3), np.uint8)


def test_a_painted_face_is_found_and_not_upside_down(finder: FaceFinder) -> None:
    face = painted_face()
    assert finder.finds(face, WHOLE)
    assert finder.finds(face, (-20, -20, 240, 240))
    assert not finder.finds(np.ascontiguousarray(face[::-1]), WHOLE)


@pytest.mark.parametrize("level", [0, 127, 255])
def test_a_blank_wall_is_no_face(finder: FaceFinder, level: int) -> None:
    assert not finder.finds(np.full((200, 200, 3), level, np.uint8), WHOLE)


@given(st.integers(-300, 300), st.integers(-300, 300), st.integers(1, 400))
def test_odd_windows_are_survived(left: int, top: int, side: int) -> None:
    assert FaceFinder().finds(painted_face(), (left, top, side, side)) in (True, False)


def test_threads_agree(finder: FaceFinder) -> None:
    pictures = [painted_face(), np.ascontiguousarray(painted_face()[::-1])] * 20
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda one: finder.finds(one, WHOLE), pictures)) == [True, False] * 20


@pytest.mark.parametrize("content", [None, b"", b"<opencv_storage></opencv_storage>"])
def test_a_missing_or_broken_cascade_is_told(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "cascade.xml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FaceError, match=r"cascade\.xml"):
        FaceFinder(path)
