"""What simulated people carry: a cushion on the back, or in a hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from index.build.body import Avatar

BAG_SHARES = (0.58, 0.18, 0.24)
"""How many carry nothing, something on the back, and something in a hand."""


def _ellipsoid(
    centre: NDArray[np.float64], axes: NDArray[np.float64], first: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Surface of a body like a cushion; ``axes`` are rows ``(3, 3)``, vertices count from first."""
    rings, points = 13, 20
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, points, endpoint=False),
        indexing="ij",
    )  # fmt: skip
    ball = np.stack(
        [np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], axis=-1
    ).reshape(-1, 3)
    # Powers below 1 make it squarer.
    vertices = centre + (np.sign(ball) * np.abs(ball) ** 0.6) @ axes
    at = np.arange(rings * points).reshape(rings, points)
    a, b = at[:-1], at[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    quads = np.stack([a, b, c, c, b, d], axis=-1).reshape(-1, 3)
    return vertices.astype(np.float32), (quads + first).astype(np.int32)


def with_bags(
    vertices: NDArray[np.float32],
    avatar: Avatar,
    moved: NDArray[np.float64],
    generator: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.int32], bool]:
    """Give a posed body something to carry, in some cases.

    Returns
    -------
    vertices, triangles
        With more rows.
    held : bool
        Whether a hand carries what the added triangles show.
    """
    kind = int(generator.choice(3, p=BAG_SHARES))
    if kind == 0:
        return vertices, avatar.triangles, False
    bone = avatar.bones.index(
        "Spine1" if kind == 1 else generator.choice(["LeftHand", "RightHand"])
    )
    place = moved[bone, :, :3] @ avatar.heads[bone] + moved[bone, :, 3]
    if kind == 1:
        turn = moved[bone, :, :3].T
        size = np.array([0.16, 0.22, 0.11]) * generator.uniform(0.7, 1.2, 3)
        centre = place + np.array([generator.normal(0, 0.03), 0.02, -0.15]) @ turn
    else:
        angle = generator.uniform(0, np.pi)
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        size = np.array([0.17, 0.17, 0.07]) * generator.uniform(0.5, 1.2, 3)
        centre = place + np.array([0, -0.1 - size[1], 0])
    more, triangles = _ellipsoid(centre, size[:, None] * turn, len(vertices))
    triangles = np.concatenate([avatar.triangles, triangles])
    return np.concatenate([vertices, more]), triangles, kind == 2
