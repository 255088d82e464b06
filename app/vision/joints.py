"""Where a person's joints are, as the photograph shows it.

A silhouette hides what lies within it and which side is which. A small network sees the photograph
and the silhouette, and answers with a map of probability for each of some points of the skeleton.
It was trained on simulated people before photographs (``scripts/joints/train.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.vision.onnx import OnnxNetwork
from app.vision.people import Box, Silhouette
from app.vision.resampling import Window, cut, planes_of, resize
from app.vision.views import silhouette_in
from app.vision.workers import Workers
from descriptor.silhouette import Placement, normalise
from index.joint_maps import JointMaps
from index.skeleton import LIMBS, POINT_NAMES, POINTS, exchange_sides

ROWS, COLUMNS = 144, 96
CELL = 4
"""Maps have one cell for so many pixels each way."""

CHANNELS = 4
READ = (*LIMBS, "head", "nose", "left_toe", "right_toe")
"""The points that are read, in the order of the maps."""

READ_ROWS = tuple(POINT_NAMES.index(name) for name in READ)

OTHER_SIDE = [
    READ.index(POINT_NAMES[row])
    for row in exchange_sides(np.arange(float(POINTS))[:, None])[list(READ_ROWS), 0].astype(int)
]
"""For each point that is read, the number of the one on the body's other side."""

# The window leaves this much room about the silhouette, which may lack a limb.
WEIGHTS_PATH = Path(__file__).parent / "joints.onnx"
_ROOM = 1.3


def joints_window(box: Box) -> Window:
    """Window about a silhouette's box in whole pixels, three by two, as the network sees it."""
    unit = max(1, round(_ROOM * max(box.height / 3, box.width / 2)))
    width, height = 2 * unit, 3 * unit
    left = round(box.x + 0.5 + (box.width - width) / 2)
    top = round(box.y + 0.5 + (box.height - height) / 2)
    return left, top, width, height


def joints_input(
    frame: NDArray[np.uint8], silhouette: Silhouette, window: Window
) -> NDArray[np.uint8]:
    """What the network looks at.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    silhouette : Silhouette
    window : (left, top, width, height)
        Of :func:`joints_window`.

    Returns
    -------
    (4, 144, 96) uint8 array
        Blue, green, red, silhouette.
    """
    colour = resize(cut(frame, window), COLUMNS, ROWS)
    return planes_of([colour, silhouette_in(window, silhouette, COLUMNS, ROWS)])


class JointReader:
    """Photograph and silhouette to maps of the joints; safe under several threads.

    Parameters
    ----------
    path : Path
        ``joints.onnx``.
    workers : Workers, optional
        Who looks at the picture and at its mirror image; by default the caller's thread, at one
        after the other.

    Raises
    ------
    OnnxError
        If the file cannot be read or is another network.
    """

    def __init__(self, path: Path = WEIGHTS_PATH, workers: Workers | None = None) -> None:
        self._workers = workers or Workers()
        maps = (len(READ), ROWS // CELL, COLUMNS // CELL)
        # A million weights: 17 MB of memory count more than 3 ms for each person.
        self._network = OnnxNetwork(path, (CHANNELS, ROWS, COLUMNS), maps, winograd=False)

    def maps(self, planes: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Look at a picture and at its mirror image, and take what both agree on.

        Parameters
        ----------
        planes : (4, 144, 96) uint8 array
            Of :func:`joints_input`.

        Returns
        -------
        (16, 36, 24) float32 array
            Probability of each cell; each map sums to 1.
        """
        mirrored = np.ascontiguousarray(planes[..., ::-1])
        plain, other = self._workers.map(self._network.run, (planes, mirrored))
        both = np.sqrt(plain * other[OTHER_SIDE, :, ::-1])
        return np.asarray(both / np.maximum(both.sum(axis=(1, 2), keepdims=True), 1e-30))

    def read(
        self, frame: NDArray[np.uint8], silhouette: Silhouette, placement: Placement
    ) -> JointMaps:
        """Look for a person's joints.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        silhouette : Silhouette
        placement : Placement
            From pixels of the silhouette's crop to the normalised frame.
        """
        window = joints_window(silhouette.box)
        left, top, width, _ = window
        cells_per_px = COLUMNS / width / CELL
        # The centre of the frame's pixel p lies in the cell (p + 0.5 - left) * cells_per_px - 0.5.
        corner = np.array([silhouette.left - left, silhouette.top - top])
        origin = placement.to_image(np.zeros(2)) + corner
        return JointMaps(
            READ_ROWS,
            self.maps(joints_input(frame, silhouette, window)),
            cells_per_px / placement.scale,
            (origin + 0.5) * cells_per_px - 0.5,
        )

    def clarity(self, frame: NDArray[np.uint8], silhouette: Silhouette) -> float:
        """How clearly a person's joints show; see :meth:`index.joint_maps.JointMaps.clarity`."""
        _, placement = normalise(silhouette.crop)
        return self.read(frame, silhouette, placement).clarity()
