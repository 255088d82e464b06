"""Which way a person faces, as head and shoulders in the photograph show it.

The segmentation network was trained on faces and shoulders, and half-way through it still knows
which of its pixels are skin, hair and cloth. A linear model over those features gives the two
natural parameters of a von Mises distribution of the person's azimuth: von Mises regression
[1]_, which says at once where a person faces and how sure that is.

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

from app.vision.network import PersonNetwork
from app.vision.people import Silhouette
from app.vision.resampling import Window, cut, resize

WEIGHTS_PATH = Path(__file__).parent / "facing_weights.npz"
WINDOW_SHARE = 0.5
"""Side of the window about head and shoulders, in heights of the silhouette."""

CELLS = 8
"""Features are averaged over so many cells each way."""

# Rows of the silhouette, in shares of its height, whose middle is the head's; and how far below
# the crown the window's centre lies.
_HEAD = 0.13
_CENTRE = 0.17
# Persons of less than this show too little of a head; so does a blank picture, whose grey levels
# spread by less than this.
_LEAST_PX = 40
_LEAST_CONTRAST = 6.0
# The image says nothing of the azimuth in so many cases: a turned head, a hood, a wrong box.
_OUTLIERS = 0.05


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
    """

    front: float
    left: float

    def likelihood(self, azimuth_deg: ArrayLike) -> NDArray[np.float64]:
        """Density at azimuths in degrees, relative to knowing nothing: 1 on average."""
        azimuth = np.deg2rad(np.asarray(azimuth_deg, np.float64))
        # Of the density's logarithm; i0 overflows beyond 700.
        scale = min(1.0, 50.0 / max(float(np.hypot(self.front, self.left)), 1e-9))
        front, left = scale * self.front, scale * self.left
        density = np.exp(front * np.cos(azimuth) + left * np.sin(azimuth))
        density /= np.i0(np.hypot(front, left))
        return np.asarray((1 - _OUTLIERS) * density + _OUTLIERS)

    def front_probability(self) -> float:
        """Probability that the azimuth lies within 90 degrees of the face."""
        azimuths = np.arange(-179.5, 180.0)
        density = self.likelihood(azimuths)
        return float(density[np.abs(azimuths) < 90].sum() / density.sum())


@dataclass(frozen=True)
class FacingModel:
    """A linear model of the azimuth, and the heads it knows.

    A head unlike all it was fitted to (blurred, helmeted, bent) must not be read with
    certainty, so the belief fades as the features leave what is usual.

    Parameters
    ----------
    weights : (2, F) float array
        Of ``front`` and ``left``, over the features of :func:`head_features`.
    bias : (2,) float array
    mean, spread : (F,) float array
        Of the features of the heads it was fitted to.
    usual : (2,) float array
        Median and 95th percentile of those heads' :meth:`strangeness`.
    """

    weights: NDArray[np.floating]
    bias: NDArray[np.floating]
    mean: NDArray[np.floating]
    spread: NDArray[np.floating]
    usual: NDArray[np.floating]

    def __post_init__(self) -> None:
        count = self.weights.shape[-1]
        for name, shape in (
            ("weights", (2, count)),
            ("bias", (2,)),
            ("mean", (count,)),
            ("spread", (count,)),
            ("usual", (2,)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"expected {name} of shape {shape}, got {getattr(self, name).shape}"
                )

    def strangeness(self, features: NDArray[np.floating]) -> NDArray[np.float64]:
        """How far features ``(..., F)`` lie from the usual: root mean square, in spreads."""
        squares = ((features - self.mean) / self.spread) ** 2
        return np.asarray(np.sqrt(squares.mean(axis=-1)), np.float64)

    def belief(self, features: NDArray[np.floating]) -> AzimuthBelief | None:
        """What features ``(F,)`` tell of the azimuth; None where they are too strange.

        Believed in full up to the 95th percentile of strangeness, and not at all as far beyond it
        as the median is before it.
        """
        median, unusual = self.usual
        beyond = float((self.strangeness(features) - unusual) / (unusual - median))
        if beyond >= 1:
            return None
        front, left = (self.weights @ features + self.bias) * min(1.0, 1 - beyond)
        return AzimuthBelief(float(front), float(left))


class FacingReader:
    """Photograph and silhouette to a belief about the azimuth; safe under several threads.

    Parameters
    ----------
    network : PersonNetwork
    model : FacingModel
    """

    def __init__(self, network: PersonNetwork, model: FacingModel) -> None:
        self._network = network
        self._model = model

    def read(self, frame: NDArray[np.uint8], silhouette: Silhouette) -> AzimuthBelief | None:
        """Look at a person's head; None where it tells nothing.

        Parameters
        ----------
        frame : (H, W, 3) uint8 array
            BGR.
        silhouette : Silhouette
        """
        window = head_window(silhouette)
        height = len(silhouette.crop)
        # A head that the frame's upper edge cuts is taken for a body's top wrongly.
        if height < _LEAST_PX or (silhouette.truncated and silhouette.top == 0):
            return None
        if resize(cut(frame, window), 16, 16).std(axis=(0, 1)).max() < _LEAST_CONTRAST:
            return None
        return self._model.belief(head_features(self._network, frame, window))


def load_facing_reader(
    network: PersonNetwork | None, weights_path: Path = WEIGHTS_PATH
) -> FacingReader | None:
    """Load the model; None without the network."""
    if network is None:
        return None
    with np.load(weights_path, allow_pickle=False) as stored:
        return FacingReader(network, FacingModel(**stored))


def head_window(silhouette: Silhouette) -> Window:
    """Square about head and shoulders of a person who is upright."""
    rows = len(silhouette.crop)
    weights = silhouette.crop[: max(2, round(_HEAD * rows))].sum(axis=0)
    column = float(weights @ np.arange(len(weights)) / weights.sum())
    side = max(2, round(WINDOW_SHARE * rows))
    left = round(silhouette.left + column - side / 2)
    return left, round(silhouette.top + _CENTRE * rows - side / 2), side, side


def head_features(
    network: PersonNetwork, frame: NDArray[np.uint8], window: Window
) -> NDArray[np.float64]:
    """Averages of the network's inner features over a grid of the window, ``(32 * 64,)``."""
    inner = network.features(frame, window)
    channels, rows, _ = inner.shape
    cell = rows // CELLS
    grid = inner.reshape(channels, CELLS, cell, CELLS, cell).mean(axis=(2, 4))
    return np.asarray(grid.ravel(), np.float64)
