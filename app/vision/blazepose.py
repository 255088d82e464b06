"""BlazePose [1]_: the landmark network and its mask.

The landmark network reads landmarks and depth of the person in a window in one pass. A second pass
draws the mask from feature maps of the first.

References
----------
.. [1] V. Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking", 2020.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import sigmoid
from app.networks.tflite import TfliteNetwork
from app.vision.geometry import PersonWindow, sample_window, transform_points
from app.vision.halved import Frame
from app.vision.people import LANDMARK_NAMES, Landmarks, ObservedKeypoints

LANDMARKS = len(LANDMARK_NAMES)

LANDMARK_PX = 256
"""Side of the landmark network's input and mask."""


@dataclass(frozen=True)
class PoseReading:
    """What the landmark network finds in a window."""

    window: PersonWindow
    landmarks: Landmarks  # in pixels of the frame, and metres
    presence: float  # the network's probability that a person is in the window
    next_window: PersonWindow  # the window that the landmarks point to
    network_pass: NetworkPass  # the raw output of the network
    # (256, 256): probability that each pixel of the window shows the person; None before
    # :meth:`MaskNetwork.read`.
    probability: NDArray[np.float32] | None = None
    # (S, S, C): feature maps for the mask, 2 MB; empty once it is drawn, or if none is wanted.
    mask_inputs: tuple[NDArray[np.float32], ...] = ()
    # MoveNet's keypoints of the same person, in pixels of the frame.
    keypoints: ObservedKeypoints | None = None

    @property
    def body_px(self) -> float:
        """Size of the body, the radius of its circle, in pixels of the frame."""
        return self.next_window.body_px


MAP_SHAPES = ((8, 8, 144), (2, 2, 288))
"""Rows, columns and channels of the feature maps: middle and last."""

# Feature maps that the mask is drawn from, each half the size of the one before.
_MASK_CHANNELS = (16, 24, 32, 88, 864)
_MASK_SHAPES = [
    (LANDMARK_PX >> halved, LANDMARK_PX >> halved, channels)
    for halved, channels in enumerate(_MASK_CHANNELS, start=1)
]

# Points of the landmark network: the landmarks, the centre of the circle about the body, its point
# in the direction of the head, and others. Each has x, y, z, visibility and presence.
_POINTS, _POINT_VALUES = 39, 5
_CIRCLE_CENTRE, _CIRCLE_TOP = 33, 34


@dataclass(frozen=True)
class NetworkPass:
    """The raw output of one pass of the landmark network."""

    # (39, 5): x and y in pixels of the window from the corner of its first pixel, depth in the same
    # pixels, log odds of visibility and of presence.
    points: NDArray[np.float32]
    # (39, 3): metres about the middle of the hips: x and y along the window's sides, z along its
    # line of sight.
    world: NDArray[np.float32]
    presence: float  # the network's probability that a person is in the window
    middle: NDArray[np.float32]  # (8, 8, 144): feature map
    last: NDArray[np.float32]  # (2, 2, 288): feature map

    def __post_init__(self) -> None:
        shapes = (self.points.shape, self.world.shape)
        maps = (self.middle.shape, self.last.shape)
        if shapes != ((_POINTS, 5), (_POINTS, 3)) or maps != MAP_SHAPES:
            raise ValueError(
                f"expected points (39, 5), world (39, 3) and maps {MAP_SHAPES}, "
                f"got {shapes} and {maps}"
            )

    @cached_property
    def sampled(self) -> NDArray[np.float32]:
        """The middle map at the landmarks ``(33, 144)``."""
        return sample_map(self.middle[None], self.points[None])[0]


def sample_map(maps: NDArray[np.float32], points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Interpolate feature maps ``(N, S, S, C)`` linearly at the landmarks: ``(N, 33, C)``.

    Points are those of :class:`NetworkPass`. Beyond the outermost cells, their values are repeated.
    """
    count, size = maps.shape[:2]
    places = points[:, :LANDMARKS, :2].astype(np.float64) * (size / LANDMARK_PX) - 0.5
    places = np.clip(places, 0.0, size - 1.0)
    first = np.minimum(places.astype(int), size - 2)
    share = (places - first).astype(np.float32)
    rows = np.arange(count)[:, None]
    x, y = first[..., 0], first[..., 1]
    across, down = share[..., :1], share[..., 1:]
    top = (1 - across) * maps[rows, y, x] + across * maps[rows, y, x + 1]
    bottom = (1 - across) * maps[rows, y + 1, x] + across * maps[rows, y + 1, x + 1]
    return np.asarray((1 - down) * top + down * bottom, np.float32)


class LandmarkNetwork(TfliteNetwork):
    """BlazePose's landmark network."""

    def __init__(self, path: Path, **share: int) -> None:
        outputs = [(_POINT_VALUES * _POINTS,), (1,), (3 * _POINTS,), *MAP_SHAPES, *_MASK_SHAPES]
        super().__init__(path, [(LANDMARK_PX, LANDMARK_PX, 3)], outputs, **share)

    def read(self, frame: Frame, window: PersonWindow) -> PoseReading:
        """Read the person in a window of a frame ``(H, W, 3)``, BGR; without the mask."""
        window = window.on_grid()
        image = cv2.cvtColor(sample_window(frame, window, LANDMARK_PX), cv2.COLOR_BGR2RGB)
        outputs = self.run(image * np.float32(1 / 255))
        values, presence, world, middle, last, *mask_inputs = outputs
        raw_points, raw_world = values.reshape(_POINTS, _POINT_VALUES), world.reshape(_POINTS, 3)
        points = raw_points.astype(np.float64)
        to_frame = window.to_frame(LANDMARK_PX)
        # The network counts pixels from the corner of the first one.
        positions = transform_points(to_frame, points[:, :2] - 0.5)
        visibility = sigmoid(points[:LANDMARKS, 3])
        metres = raw_world[:LANDMARKS].astype(np.float64)
        rotation = to_frame[:, :2] / (window.side / LANDMARK_PX)
        metres = np.hstack([metres[:, :2] @ rotation.T, metres[:, 2:]])
        return PoseReading(
            window,
            Landmarks(positions[:LANDMARKS], visibility, metres),
            float(presence[0]),
            PersonWindow.about_circle(positions[_CIRCLE_CENTRE], positions[_CIRCLE_TOP]),
            NetworkPass(raw_points, raw_world, float(presence[0]), middle, last),
            mask_inputs=tuple(mask_inputs),
        )


_Reading = TypeVar("_Reading", bound=PoseReading)


class MaskNetwork(TfliteNetwork):
    """The part of BlazePose's landmark network that draws the mask."""

    def __init__(self, path: Path, **share: int) -> None:
        super().__init__(path, _MASK_SHAPES, [(LANDMARK_PX, LANDMARK_PX, 1)], **share)

    def read(self, reading: _Reading) -> _Reading:
        (log_odds,) = self.run(*reading.mask_inputs)
        return replace(reading, probability=sigmoid(log_odds[..., 0]), mask_inputs=())
