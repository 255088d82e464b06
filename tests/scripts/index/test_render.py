"""The rasteriser against analytic silhouettes and against OpenCV's polygon filling."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, normalise
from index.skeleton import camera_rotation, project
from scripts.index.body import Avatar, pose_transforms, retarget
from scripts.index.poses import Poses
from scripts.index.render import render, skin

VIEWS = [(0, 0, 0), (35, 20, 5), (120, 55, -4), (250, -5, 0), (300, 80, 30)]

Placed = tuple[float, float, float]


def draw(
    vertices: NDArray[np.floating],
    triangles: NDArray[np.integer],
    view: tuple[float, float, float],
    distance: float = 5.0,
    culled: bool = True,
) -> tuple[NDArray[np.uint8], Placed]:
    silhouette = np.zeros((HEIGHT, WIDTH), np.uint8)
    placed = render(
        vertices.astype(np.float32), triangles.astype(np.int32), len(triangles) if culled else 0,
        camera_rotation(*view).astype(np.float32), distance, silhouette,
    )  # fmt: skip
    return silhouette, placed


@pytest.fixture(scope="module")
def person(poses: Poses, avatars: list[Avatar]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A posed box body."""
    avatar, clip = avatars[1], poses.clips[poses.clip[20]]
    transforms = pose_transforms(avatar, retarget(clip, avatar), poses.rotations(np.array([20])))[0]
    vertices = skin(
        avatar.vertices, avatar.influences, avatar.weights, transforms.astype(np.float32)
    )
    return vertices, avatar.triangles


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("distance", [3.0, 20.0])
def test_equals_polygons_filled_in_high_resolution(
    person: tuple[NDArray[np.float32], NDArray[np.int32]],
    view: tuple[float, float, float], distance: float,
) -> None:  # fmt: skip
    vertices, triangles = person
    silhouette, placed = draw(vertices, triangles, view, distance)
    plane = project(vertices @ camera_rotation(*view).T, distance)
    fine = 900.0  # pixels per metre; about eight to a normalised pixel
    corner = plane.min(axis=0) - 0.02
    pixels = (plane - corner) * fine
    canvas = np.zeros((np.ceil(pixels.max(axis=0)).astype(int) + 20)[::-1], np.uint8)
    for triangle in np.rint(pixels[triangles] * 16).astype(np.int32):
        cv2.fillConvexPoly(canvas, triangle, 1, shift=4)
    expected, placement = normalise(canvas)
    disagree = silhouette != expected
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(expected, kernel) != cv2.erode(expected, kernel)
    assert not (disagree & ~edge).any()
    assert disagree.sum() <= 0.15 * edge.sum()
    # Both say where a point in space lies in the frame.
    scale, offset_x, offset_y = placed
    assert_allclose(
        placement.to_normalised(pixels), plane * scale + (offset_x, offset_y), atol=0.35
    )
