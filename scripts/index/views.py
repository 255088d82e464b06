"""Virtual cameras on a hemisphere, and the bodies that they see."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, is_wide, pack, principal_axis_deg
from index.posture import POSTURES, classify_postures
from index.skeleton import BODY_UP, JOINT_NAMES, POINTS, camera_rotation, wrap_degrees
from index.store import ENTRY_DTYPE
from scripts.index.body import Avatar, posed_points
from scripts.index.render import render, skin

VIEW_DTYPE = np.dtype(
    [("azimuth_deg", "<f4"), ("elevation_deg", "<f4"), ("roll_deg", "<f4"), ("distance", "<f4")]
)

ELEVATIONS_DEG, GROUND_ELEVATIONS_DEG = (-5.0, 60.0), (5.0, 70.0)
"""From a little below the height of the pelvis to a steep surveillance view; and the same of bodies
that lie or crawl."""

DISTANCES_M = (3.0, 20.0)
"""From a room to a car park."""

MAX_OWN_ROLL_DEG = 30.0
"""Roll above which a camera was rolled for a silhouette wider than high."""

# Cameras are rolled a little.
_ROLL_STD_DEG = 2.0
# Cameras sampled for each one kept of a pose laid down: a body that lies across the picture looks
# like one that stands.
_FORESHORTENED_OF = 2


def sample_views(
    count: int, generator: np.random.Generator, elevations_deg: tuple[float, float] = ELEVATIONS_DEG
) -> NDArray[np.void]:
    """Cameras spread over the hemisphere, with jitter.

    Azimuths are stratified, so that ``count`` views of one pose surround it. Elevations crowd
    towards eye level, where most cameras are, with a third above 25 degrees. Distances are
    uniform in their logarithm.

    Returns
    -------
    (count,) array of VIEW_DTYPE
    """
    views = np.zeros(count, VIEW_DTYPE)
    strata = (np.arange(count) + generator.random(count)) / count
    views["azimuth_deg"] = (360.0 * (strata + generator.random())) % 360.0
    low, high = elevations_deg
    # Stratified as well, in another order; the power crowds them towards eye level.
    heights = generator.permutation((np.arange(count) + generator.random(count)) / count)
    views["elevation_deg"] = low + (high - low) * heights**1.8
    views["roll_deg"] = generator.normal(0.0, _ROLL_STD_DEG, count)
    nearest, farthest = np.log(DISTANCES_M)
    views["distance"] = np.exp(generator.uniform(nearest, farthest, count))
    return views


_NEAR_GROUND = [POSTURES.index(posture) for posture in ("crawling", "lying")]


class PosedBodies(NamedTuple):
    """Bodies of one avatar.

    Parameters
    ----------
    numbers : (N,) int64 array
        Their numbers in the simulation, which decide the cameras.
    transforms : (N, B, 3, 4) float64 array
        Transforms of the bones; see :func:`scripts.index.body.pose_transforms`.
    foreshortened : (N,) bool array
        Bodies seen along the trunk only.
    """

    numbers: NDArray[np.int64]
    transforms: NDArray[np.float64]
    foreshortened: NDArray[np.bool_]


class RenderedBodies(NamedTuple):
    """Bodies as their cameras see them.

    Parameters
    ----------
    bits : (N, V, 768) uint8 array
        Bit-packed normalised silhouettes.
    entries : (N, V) array of ENTRY_DTYPE
    skeletons : (N, 24, 3) float16 array
    """

    bits: NDArray[np.uint8]
    entries: NDArray[np.void]
    skeletons: NDArray[np.float16]


def render_bodies(avatar: Avatar, posed: PosedBodies, views: int, seed: int) -> RenderedBodies:
    """Render bodies from ``views`` views each; the same bytes in any process."""
    count = len(posed.numbers)
    bits = np.empty((count, views, HEIGHT * WIDTH // 8), np.uint8)
    entries = np.zeros((count, views), ENTRY_DTYPE)
    skeletons = np.empty((count, POINTS, 3), np.float16)
    silhouettes = np.empty((views, HEIGHT, WIDTH), np.uint8)
    for row, (number, transforms) in enumerate(zip(posed.numbers, posed.transforms, strict=True)):
        points = posed_points(avatar, transforms[None])
        skeletons[row] = points[0]
        vertices = skin(
            avatar.vertices, avatar.influences, avatar.weights, transforms.astype(np.float32)
        )
        near_ground = classify_postures(points, BODY_UP)[0] in _NEAR_GROUND
        foreshortened = bool(posed.foreshortened[row])
        # As SeedSequence.spawn would give the body, in whatever order they are rendered.
        own_seed = np.random.SeedSequence(seed, spawn_key=(int(number),))
        cameras = sample_views(
            (_FORESHORTENED_OF if foreshortened else 1) * views,
            np.random.default_rng(own_seed),
            GROUND_ELEVATIONS_DEG if near_ground else ELEVATIONS_DEG,
        )
        if foreshortened:
            cameras = most_foreshortened(cameras, points[0], views)
        for view, camera in enumerate(cameras):
            entries[row, view] = (
                number, *_draw_view(avatar, vertices, points[0], camera, silhouettes[view])
            )  # fmt: skip
        bits[row] = pack(silhouettes)
    return RenderedBodies(bits, entries, skeletons)


def most_foreshortened(
    cameras: NDArray[np.void], points: NDArray[np.float64], count: int
) -> NDArray[np.void]:
    """The ``count`` cameras that look most along the trunk of a body ``(24, 3)``."""
    trunk = points[JOINT_NAMES.index("neck")] - points[JOINT_NAMES.index("pelvis")]
    rotations = camera_rotation(cameras["azimuth_deg"], cameras["elevation_deg"])
    along = np.abs(rotations[:, 2] @ trunk)
    return cameras[np.sort(np.argsort(-along, kind="stable")[:count])]


def _draw_view(
    avatar: Avatar,
    vertices: NDArray[np.float32],
    points: NDArray[np.float64],
    camera: np.void,
    silhouette: NDArray[np.uint8],
) -> tuple[float, ...]:
    """Draw one view; return its camera, rolled where the body is wide, and the placement."""
    azimuth_deg, elevation_deg, roll_deg, distance = camera.tolist()

    def placed() -> tuple[float, ...]:
        rotation = camera_rotation(azimuth_deg, elevation_deg, roll_deg).astype(np.float32)
        return tuple(
            render(vertices, avatar.triangles, avatar.closed, rotation, distance, silhouette)
        )

    placement = placed()
    if is_wide(silhouette):
        axis_deg = principal_axis_deg(silhouette)
        body = points[[JOINT_NAMES.index("head"), JOINT_NAMES.index("pelvis")]]
        rolls = [roll_deg - axis_deg, roll_deg - axis_deg + 180.0]
        upright = camera_rotation(azimuth_deg, elevation_deg, np.array(rolls))
        head_down, pelvis_down = (body @ upright.swapaxes(1, 2))[..., 1].T
        roll_deg = float(wrap_degrees(rolls[int((head_down - pelvis_down).argmin())]))
        placement = placed()
    return azimuth_deg, elevation_deg, roll_deg, distance, *placement
