"""How the silhouettes of the paper's experiments are answered.

By the nearest entries, as in the paper, and as the service does (:mod:`index.matching`): the
nearest entries and their mirror images are gathered into distinct poses, each interpolated to the
query.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, DiscriminantDescriptor
from index.build.builder import assemble
from index.build.descriptor_learning import Recipe, learn_descriptor
from index.build.simulate import Simulation
from index.candidates import Candidates, find_candidates
from index.confidence import Calibration
from index.modes import Modes, find_modes
from index.parameters import MATCHING, MODES
from index.skeleton import POINTS
from scripts.experiments.contour import contour_faults

SEED = 2016
CANDIDATES, BANDWIDTH_M = 50, 0.05
"""Nearest entries that are looked at, and joint distance at which they still make one pose.

Chosen, with what the descriptor learns to overlook, on known silhouettes alone: of sixteen
settings tried at revision fde0768 the best.
"""

PAPER, PAPER_MODES, PLAIN, OURS = (
    "paper's descriptor",
    "paper's, our matching",
    "ours, nearest",
    "ours",
)
"""Columns: diagonal moments and discriminant ones, each with the nearest and with the service's
matching."""


def learn(known: Simulation) -> DiscriminantDescriptor:
    """The discriminant descriptor of known silhouettes, which overlooks noise on the contour."""
    return learn_descriptor(known, SEED, Recipe(), faults=contour_faults)


def first_poses(
    known: Simulation, descriptor: Descriptor, silhouettes: NDArray[np.uint8], count: int
) -> NDArray[np.float64]:
    """The first distinct poses of each silhouette, ``(Q, count, 24, 2)`` normalised pixels.

    Infinite where there are fewer.
    """
    index = assemble(known, descriptor, Calibration.none(), {}, "paper")
    points = np.full((len(silhouettes), count, POINTS, 2), np.inf)
    for row, silhouette in enumerate(silhouettes):
        modes = ranked_modes(find_candidates(index, silhouette, CANDIDATES), count)
        points[row, : len(modes)] = modes.points_normalised
    return points


def ranked_modes(candidates: Candidates, count: int) -> Modes:
    """Distinct poses, best first, as :func:`index.matching.match` ranks them."""
    parameters = replace(MODES, bandwidth_m=BANDWIDTH_M)
    found = find_modes(candidates, count + MATCHING.spare_modes, parameters=parameters)
    return found.nearest(count)
