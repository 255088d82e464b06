"""A rough idea of a standing body in its box: the prior of every segmenter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Half the body's width over its height, at heights from crown (0) to sole (1): head, neck,
# shoulders with arms, hips, and the space that striding legs sweep.
_HEIGHTS = (0.0, 0.06, 0.13, 0.16, 0.20, 0.45, 0.55, 0.75, 1.0)
_HALF_WIDTHS = (0.03, 0.065, 0.06, 0.10, 0.135, 0.145, 0.12, 0.12, 0.13)
_SOFTNESS = 0.035


def body_prior(height: int, width: int) -> NDArray[np.float32]:
    """Probability that a pixel of a person's tight box is on the person.

    Parameters
    ----------
    height, width : int
        Size of the box in pixels.

    Returns
    -------
    (height, width) float32 array
        Between 0.02 and 0.98, mirror-symmetric.
    """
    y = (np.arange(height) + 0.5) / height
    # In body heights from the box's vertical axis.
    x = np.abs((np.arange(width) + 0.5) - width / 2) / height
    half = np.interp(y, _HEIGHTS, _HALF_WIDTHS)
    # A wide box means spread arms or legs: below the head the body reaches further out.
    spread = max(0.0, width / height / 2 - 0.16) * np.interp(y, (0.13, 0.25), (0.0, 0.5))
    soft = _SOFTNESS + 0.5 * spread
    odds = ((half + spread)[:, None] - x[None, :]) / soft[:, None]
    prior = 1 / (1 + np.exp(-np.clip(odds, -20, 20)))
    return np.asarray(np.clip(prior, 0.02, 0.98), np.float32)
