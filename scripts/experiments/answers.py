"""How the silhouettes of the paper's experiments are answered, and how far off the answers are.

Two ways: the nearest entries, as the paper answers, and the service's way
(:mod:`index.matching`): the nearest entries and their mirror images are gathered into distinct
poses, each interpolated to the query.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptor.descriptor import Descriptor, DiscriminantDescriptor
from index.build.builder import assemble
from index.build.learn import Faults, Recipe, learn_descriptor, view_joints
from index.build.noise import degrade_all
from index.build.simulate import Simulation
from index.candidates import Candidates, find_candidates
from index.confidence import Calibration
from index.matching import SPARE_MODES
from index.modes import Modes, find_modes
from index.skeleton import JOINTS
from index.store import PoseIndex
from scripts.experiments.contour import contour_faults
from scripts.experiments.protocol import joint_errors, nearest

HYPOTHESES = 7
SEED = 2016

FAULTS: dict[str, Faults] = {"photographs": degrade_all, "contour noise": contour_faults}
"""What the discriminant descriptor learns to overlook: the faults of silhouettes cut out of
photographs, as the shipped one does, or contour noise as in the paper's experiment."""


@dataclass(frozen=True)
class Matching:
    """How nearest entries are gathered into distinct poses.

    Parameters
    ----------
    candidates : int
        Nearest entries that are looked at.
    bandwidth_m : float
        Joint distance at which they still belong together.
    """

    candidates: int
    bandwidth_m: float


@dataclass(frozen=True)
class Choice:
    """How a set of known silhouettes is made searchable.

    Parameters
    ----------
    faults : str
        Of :data:`FAULTS`.
    matching : Matching
    """

    faults: str
    matching: Matching

    def learn(self, known: Simulation) -> DiscriminantDescriptor:
        """The discriminant descriptor of known silhouettes."""
        return learn_descriptor(known, SEED, Recipe(), faults=FAULTS[self.faults])


def make_index(known: Simulation, descriptor: Descriptor) -> PoseIndex:
    """An index of known silhouettes; its confidence knows nothing."""
    return assemble(known, descriptor, Calibration.none(), {}, "paper")


def nearest_errors(
    known: Simulation,
    descriptor: Descriptor,
    unseen: Simulation,
    silhouettes: NDArray[np.uint8],
    count: int = HYPOTHESES,
) -> NDArray[np.float32]:
    """Joint errors ``(Q, count)`` in px of the nearest entries."""
    numbers = nearest(known.describe(descriptor), descriptor.describe(silhouettes), count)
    return joint_errors(known, unseen, numbers)


def all_candidates(
    index: PoseIndex, silhouettes: Iterable[NDArray[np.uint8]], count: int
) -> list[Candidates]:
    """The nearest entries to each silhouette."""
    return [find_candidates(index, silhouette, count) for silhouette in silhouettes]


def ranked_modes(candidates: Candidates, matching: Matching, count: int) -> Modes:
    """Distinct poses, best first, as :func:`index.matching.match` ranks them."""
    modes = find_modes(
        candidates.take(slice(matching.candidates)),
        count + SPARE_MODES,
        bandwidth_m=matching.bandwidth_m,
    )
    return modes.nearest(count)


def mode_errors(
    found: Sequence[Candidates],
    unseen: Simulation,
    matching: Matching,
    count: int = HYPOTHESES,
) -> NDArray[np.float64]:
    """Joint errors ``(Q, count)`` in px of distinct poses; infinite where there are fewer."""
    errors = np.full((len(found), count), np.inf)
    truth = view_joints(unseen)[1]
    for row, candidates in enumerate(found):
        modes = ranked_modes(candidates, matching, count)
        apart = modes.points_normalised[:, :JOINTS] - truth[row]
        errors[row, : len(modes)] = np.linalg.norm(apart, axis=-1).mean(axis=-1)
    return errors
