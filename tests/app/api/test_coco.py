"""Silhouettes in COCO's forms: read back, they are the same pixels."""

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from app.api.replies import compressed, polygon, run_lengths
from app.vision.people import Silhouette, silhouette_from_mask

masks = arrays(
    np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=24), elements=st.booleans()
).filter(lambda mask: bool(mask.any()))


def silhouette_of(mask: NDArray[np.bool_]) -> Silhouette:
    found = silhouette_from_mask(mask, segmenter="mask", truncated=False)
    assert found is not None
    return found


def drawn(rows: str) -> NDArray[np.bool_]:
    """A mask drawn in characters, # on the person."""
    return np.array([[character == "#" for character in row] for row in rows.split()])


def decompressed(text: str) -> list[int]:
    """Read run lengths as pycocotools' ``rleFrString`` does."""
    counts: list[int] = []
    groups = [ord(character) - 48 for character in text]
    while groups:
        number = shift = 0
        more = True
        while more:
            group = groups.pop(0)
            number |= (group & 31) << shift
            shift += 5
            more = bool(group & 32)
        if group & 16:
            number -= 1 << shift
        counts.append(number + (counts[-2] if len(counts) > 2 else 0))
    return counts


def mask_of(rle: dict[str, Any]) -> NDArray[np.bool_]:
    counts = decompressed(rle["counts"])
    inside = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    height, width = rle["size"]
    return inside.reshape(width, height).T


def filled(polygon: list[list[float]], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    canvas = np.zeros(shape, np.uint8)
    for part in polygon:
        cv2.fillPoly(canvas, [np.array(part).reshape(-1, 2).astype(int)], 1)
    return canvas.astype(bool)


@pytest.mark.parametrize(
    ("rows", "counts", "text"),
    [
        ("#", [0, 1], "01"),
        (".#. .#. ...", [3, 2, 4], "324"),
        (".## .## .##", [3, 6], "36"),
        ("#.. ..# ###", [0, 1, 1, 1, 2, 1, 1, 2], "011010O1"),
    ],
)
def test_run_lengths_match_pycocotools(rows: str, counts: list[int], text: str) -> None:
    mask = drawn(rows)
    found = run_lengths(silhouette_of(mask), mask.shape)
    assert found.tolist() == counts
    assert compressed(found) == text


@given(mask=masks)
def test_decoded_run_lengths_are_the_silhouette(mask: NDArray[np.bool_]) -> None:
    counts = compressed(run_lengths(silhouette_of(mask), mask.shape))
    assert np.array_equal(mask_of({"counts": counts, "size": mask.shape}), mask)


@given(mask=masks)
def test_a_filled_polygon_is_the_silhouette_without_its_holes(mask: NDArray[np.bool_]) -> None:
    parts = polygon(silhouette_of(mask))
    assert all(len(part) >= 6 and len(part) % 2 == 0 for part in parts)
    _, labels = cv2.connectedComponents(
        np.pad(~mask, 1, constant_values=True).astype(np.uint8), connectivity=4
    )
    outside = (labels == labels[0, 0])[1:-1, 1:-1]
    assert np.array_equal(filled(parts, mask.shape), ~outside)
