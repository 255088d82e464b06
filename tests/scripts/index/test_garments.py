"""Garments: the documented fit, and every fault named with its file and line."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from scripts.index.body import Avatar, BaseMesh
from scripts.index.garments import GarmentError, dress, fit, read_garment

MHCLO = """\
# a patch on a base mesh of eight vertices
name patch
obj_file patch.obj
x_scale 0 1 10.0
y_scale 0 2 10.0
z_scale 0 4 10.0
verts 0
material patch.mhmat
0 1 2 0.5 0.25 0.25 0.0 0.0 1.0
3
4 5 6 1.0 0.0 0.0 2.0 0.0 0.0
7 7 7 1.0 0.0 0.0 0.0 -1.0 0.0

delete_verts
0 - 2 5
"""
OBJ = "v 0 0 0\nv 0 0 0\nv 0 0 0\nv 0 0 0\nf 1/1 2/2 3/3 4/4\n"


@pytest.fixture
def patch(tmp_path: Path) -> Path:
    folder = tmp_path / "clothes" / "patch"
    folder.mkdir(parents=True)
    (folder / "patch.obj").write_text(OBJ)
    (folder / "patch.mhclo").write_text(MHCLO)
    return folder / "patch.mhclo"


@pytest.fixture
def base() -> BaseMesh:
    """A cube of 1 m (10 dm): the reference body of the patch; four bones hold two corners each."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float64)
    triangles = np.array([[0, 1, 2], [1, 3, 2], [4, 6, 5], [5, 6, 7]], np.int32)
    weights = np.zeros((8, 10), np.float32)
    weights[np.arange(8), np.arange(8) // 2] = 1
    return BaseMesh(corners, weights, triangles)


def test_fit_on_the_reference_body(patch: Path, base: BaseMesh) -> None:
    vertices, weights = fit(read_garment(patch), base)
    # Weighted anchors plus the offset in decimetres.
    assert_allclose(vertices, [[0.25, 0.25, 0.1], [1, 1, 0], [0.2, 0, 1], [1, 0.9, 1]], atol=1e-12)
    # 0.5 of corner 0 and 0.25 of corner 1 hang on bone 0, 0.25 of corner 2 on bone 1.
    assert_allclose(weights[0, :3], [0.75, 0.25, 0])
    assert_allclose(weights.sum(axis=1), 1)


def test_dress_hides_the_skin_below_and_adds_the_garment(
    patch: Path, base: BaseMesh, avatars: list[Avatar]
) -> None:
    dressed = dress(avatars[0], base, [read_garment(patch)])
    # Triangle 0-1-2 is hidden whole; the others keep at least one visible corner.
    assert dressed.closed == 3
    assert len(dressed.triangles) == 3 + 2
    assert dressed.triangles.max() == len(dressed.vertices) - 1
    assert_allclose(dressed.weights.sum(axis=1), 1)
    assert_allclose(dressed.vertices[dressed.triangles[-1, -1]], [1, 0.9, 1], atol=1e-6)


class TestMalformed:
    def fails(self, file: Path) -> str:
        with pytest.raises(GarmentError) as caught:
            read_garment(file)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    @pytest.mark.parametrize(
        ("line", "text"),
        [(9, "0 1 2 0.5 0.25"), (9, "0 1 x 0.5 0.25 0.25 0 0 0"), (4, "x_scale 0 1"),
         (4, "x_scale a b c"), (15, "0 - y")],
    )  # fmt: skip
    def test_bad_line_is_named(self, patch: Path, line: int, text: str) -> None:
        lines = patch.read_text().splitlines()
        lines[line - 1] = text
        patch.write_text("\n".join(lines))
        message = self.fails(patch)
        assert f"line {line} of {patch}" in message
        assert text in message
