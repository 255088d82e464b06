"""Which way a person faces, as the photograph shows it.

OpenCV's cascade looks for a face that is seen from the front (``app/vision/face.py``). A small
network sees head and shoulders, and all of the person, each beside its part of the
silhouette, and answers with the two natural parameters of a von Mises distribution of the azimuth:
von Mises regression [1]_, which says at once where a person faces and how sure that is. It was
trained on simulated people before photographs (``scripts/facing/train.py``).

References
----------
.. [1] B. Presnell, S. P. Morrison, R. C. Littell, "Projected Multivariate Linear Models for
   Directional Data", Journal of the American Statistical Association 93, 1998.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.vision.face import FaceFinder
from app.vision.joints import joints_window
from app.vision.onnx import OnnxNetwork
from app.vision.people import Silhouette
from app.vision.resampling import Window, cut, planes_of, resize
from app.vision.views import silhouette_in

SIZE = 64
CHANNELS = 8
WEIGHTS_PATH = Path(__file__).parent / "facing.onnx"
WINDOW_SHARE = 0.5
"""Side of the window about head and shoulders, in heights of the silhouette."""

# Rows of the silhouette, in shares of its height, whose middle is the head's; and how far below
# the crown the window's centre lies.
_HEAD = 0.13
_CENTRE = 0.17
# Side and centre of the square about the head alone, likewise.
_FACE_SHARE, _FACE_CENTRE = 0.25, 0.085
# Persons of less than this show too little of a head; so does a blank picture, whose grey levels
# spread by less than this; pixels so far apart tell.
_LEAST_PX = 40
_LEAST_CONTRAST = 6.0
_APART = 8
# The image says nothing of the azimuth in so many cases: a turned head, a hood, a wrong box.
_OUTLIERS = 0.05
# How often the cascade finds a face where there is none, how much oftener where somebody faces the
# camera, hidden and pixelated faces among them, and by how many degrees aside that has fallen to
# 1/e. Of the street people of even-numbered photographs 13 of 15 faces within 30 degrees are found,
# and nothing in 29 backs.
_FALSE_FACES, _FACES, _FACES_TO_DEG = 0.01, 0.5, 38.0
_CIRCLE_DEG = np.arange(-179.5, 180.0)


@dataclass(frozen=True)
class AzimuthBelief:
    """A von Mises distribution of the azimuth from which the camera sees a person.

    Its density is proportional to ``exp(front * cos(azimuth) + left * sin(azimuth))``, for the
    azimuths of :func:`index.skeleton.camera_rotation`.

    Parameters
    ----------
    front : float
        Positive where the camera sees the face, negative where it sees the back.
    left : float
        Positive where it sees the person's left side, who faces image left.
    face : bool, optional
        Whether a face is seen from the front, for which the density is corrected; None where that
        was not looked for.
    """

    front: float
    left: float
    face: bool | None = None

    def likelihood(self, azimuth_deg: ArrayLike) -> NDArray[np.float64]:
        """Density at azimuths in degrees, relative to knowing nothing: 1 on average."""
        azimuths = np.asarray(azimuth_deg, np.float64)
        weights = self._weight(np.append(_CIRCLE_DEG, azimuths))
        average = weights[: len(_CIRCLE_DEG)].mean()
        return np.asarray(weights[len(_CIRCLE_DEG) :] / average).reshape(azimuths.shape)

    def _weight(self, azimuth_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        # On a whole circle the mean of so smooth a function is its integral, to the last digits.
        density = self._von_mises(azimuth_deg) / self._von_mises(_CIRCLE_DEG).mean()
        density = (1 - _OUTLIERS) * density + _OUTLIERS
        if self.face is None:
            return np.asarray(density)
        aside = (azimuth_deg + 180) % 360 - 180
        found = _FALSE_FACES + _FACES * np.exp(-((aside / _FACES_TO_DEG) ** 2))
        return np.asarray(density * (found if self.face else 1 - found))

    def _von_mises(self, azimuth_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        azimuth = np.deg2rad(azimuth_deg)
        # Nobody is sure to a few degrees, and the exponential of more overflows.
        scale = min(1.0, 50.0 / max(float(np.hypot(self.front, self.left)), 1e-9))
        return np.asarray(
            np.exp(scale * (self.front * np.cos(azimuth) + self.left * np.sin(azimuth)))
        )

    def front_probability(self) -> float:
        """Probability that the azimuth lies within 90 degrees of the face."""
        density = self._weight(_CIRCLE_DEG)
        return float(density[np.abs(_CIRCLE_DEG) < 90].sum() / density.sum())

    def azimuth_deg(self) -> float:
        """The likeliest azimuth, to a degree."""
        return float(_CIRCLE_DEG[self._weight(_CIRCLE_DEG).argmax()])


@dataclass(frozen=True)
class FacingView:
    """Where a person is looked at, and what of the silhouette is there: no photograph yet.

    Parameters
    ----------
    head, person, face : Window
        About head and shoulders, all of the person, and the head alone.
    masks : pair of (64, 64) uint8 arrays
        255 on the person, in the first two.
    """

    head: Window
    person: Window
    face: Window
    masks: tuple[NDArray[np.uint8], NDArray[np.uint8]]

    @classmethod
    def of(cls, silhouette: Silhouette) -> FacingView | None:
        """Of a person who is upright; None where too little of the head is to be seen."""
        # A head that the frame's upper edge cuts is taken for a body's top wrongly.
        if len(silhouette.crop) < _LEAST_PX or (silhouette.truncated and silhouette.top == 0):
            return None
        head, person = head_window(silhouette), person_window(silhouette)
        face = _about_head(silhouette, _FACE_SHARE, _FACE_CENTRE)
        in_head, in_person = (silhouette_in(w, silhouette, SIZE, SIZE) for w in (head, person))
        return cls(head, person, face, (in_head, in_person))


class FacingReader:
    """Photograph and silhouette to a belief about the azimuth; safe under several threads.

    Parameters
    ----------
    path : Path
        ``facing.onnx``.

    Raises
    ------
    OnnxError
        If the file cannot be read or is another network.
    FaceError
        If OpenCV lacks its cascade.
    """

    def __init__(self, path: Path = WEIGHTS_PATH) -> None:
        self._network = OnnxNetwork(path, (CHANNELS, SIZE, SIZE), (2,), winograd=False)
        self._faces = FaceFinder()

    def read(self, frame: NDArray[np.uint8], silhouette: Silhouette) -> AzimuthBelief | None:
        """Look at a person; None where nothing is to be seen.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        silhouette : Silhouette
        """
        view = FacingView.of(silhouette)
        return None if view is None else self.look(frame, view)

    def look(self, frame: NDArray[np.uint8], view: FacingView) -> AzimuthBelief | None:
        """As :meth:`read`, of what can be told from the photograph alone.

        Whoever matches meanwhile is held up at each step that asks for Python's lock; so there are
        few.
        """
        planes = facing_input(frame, view)
        if planes[:3, ::_APART, ::_APART].std(axis=(1, 2)).max() < _LEAST_CONTRAST:
            return None
        front, left = self._network.run(planes)
        return AzimuthBelief(float(front), float(left), self._faces.finds(frame, view.face))


def facing_input(frame: NDArray[np.uint8], view: FacingView) -> NDArray[np.uint8]:
    """What the network looks at.

    Parameters
    ----------
    frame : (H, W, 3) uint8 array
        BGR.
    view : FacingView

    Returns
    -------
    (8, 64, 64) uint8 array
        Blue, green, red and silhouette of head and shoulders, then of all of the person.
    """
    head, person = (resize(cut(frame, window), SIZE, SIZE) for window in (view.head, view.person))
    return planes_of([head, view.masks[0], person, view.masks[1]])


def person_window(silhouette: Silhouette) -> Window:
    """Window about all of a person."""
    return joints_window(silhouette.box)


def head_window(silhouette: Silhouette) -> Window:
    """Square about head and shoulders of a person who is upright."""
    return _about_head(silhouette, WINDOW_SHARE, _CENTRE)


def _about_head(silhouette: Silhouette, share: float, centre: float) -> Window:
    """Square of a share of the silhouette's height, its centre that far below the crown."""
    rows = len(silhouette.crop)
    weights = silhouette.crop[: max(2, round(_HEAD * rows))].sum(axis=0)
    column = float(weights @ np.arange(len(weights)) / weights.sum())
    side = max(2, round(share * rows))
    left = round(silhouette.left + column - side / 2)
    return left, round(silhouette.top + centre * rows - side / 2), side, side
