"""The paper's comparison of descriptors: recognition, and time for a silhouette."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import DiagonalDescriptor
from index.build.simulate import Simulation
from scripts.experiments import baselines
from scripts.experiments.answers import SEED, Choice
from scripts.experiments.contour import disturb_all
from scripts.experiments.paper_pictures import plot_descriptors
from scripts.experiments.protocol import (
    PaperData,
    joint_errors,
    nearest,
    recognised,
    split_by_frame,
)
from scripts.experiments.report import percent, table, write
from scripts.results import machine

STDS_PX = (0.0, 2.0)
COUNTS = (1, 7)
ZERNIKE_DEGREE = 12
WORDS = 100
CODEBOOK_EVERY = 3
HAHN_CONCENTRATIONS = (2.0, 4.0, 8.0, 16.0, 32.0, 128.0, 512.0)
TIMED = 200

Describe = Callable[[NDArray[np.uint8]], NDArray[np.float32]]


@dataclass(frozen=True)
class Figures:
    """What is measured of a descriptor.

    Parameters
    ----------
    name : str
    values : int
        Length of a vector.
    recognised : dict
        Percent by noise and N.
    microseconds : float
        Median time for one silhouette.
    """

    name: str
    values: int
    recognised: dict[str, dict[int, float]]
    microseconds: float


def run(data: PaperData, choice: Choice, out: Path, command: str) -> None:
    """Measure all descriptors and write ``paper-descriptors.*``."""
    known = data.known.silhouettes(slice(None))
    concentration, trials = choose_hahn(data.known)
    silhouettes = {
        std: disturb_all(data.unseen.silhouettes(slice(None)), std, SEED) for std in STDS_PX
    }
    compared = descriptors(data.known, known, concentration, choice)
    figures = [
        measure(name, describe, data, known, silhouettes)
        for name, describe in tqdm(compared.items(), desc="descriptors", unit="descriptor")
    ]
    out.mkdir(parents=True, exist_ok=True)
    plot_descriptors(
        {f.name: (f.recognised, f.microseconds) for f in figures}, out / "paper-descriptors.png"
    )
    write(out, "paper-descriptors", command, [
        "Descriptors compared",
        "Share of the unseen silhouettes, in percent, of which one of the N nearest known ones "
        "(Euclidean distance, for all descriptors alike) has a mean joint reprojection error "
        "below 5 px, without noise and with 2 px of noise on the outline; and the time to "
        "describe one silhouette. Data as in [paper-noise.md](paper-noise.md).",
        descriptor_table(figures),
        sentences_on_better(figures),
        "![recognition and time](paper-descriptors.png)",
        f"Times are medians over {TIMED} silhouettes, one at a time, one thread, on {machine()}, "
        f"at a load of {os.getloadavg()[0]:.1f}.",
        "## The descriptors",
        "- *Hu*: the seven invariants (OpenCV) on a logarithmic scale, each divided by its "
        "standard deviation over the known silhouettes.\n"
        f"- *Zernike*: magnitudes through degree {ZERNIKE_DEGREE} (mahotas). Hu's and Zernike's "
        "do not change when a silhouette is turned, nor Zernike's when it is mirrored: what "
        "helps with letters hides the direction a person faces.\n"
        "- *Hahn*: 24 diagonal moments in the two regions of the paper's descriptor, own code "
        f"after Yap et al. (2007); concentration t = {concentration:g}, the best of "
        f"{', '.join(f'{t:g}' for t in trials)} on known frames held out. t = 0 is Tchebichef, "
        "t without end is Krawtchouk.\n"
        f"- *Shape context*: histogram of {WORDS} typical shape contexts "
        f"({baselines.OUTLINE_POINTS} points, {baselines.ANGLES} x {baselines.RADII} bins), own "
        "code after Belongie et al. (2002) and Agarwal and Triggs (2006); the typical ones by "
        "k-means on the known silhouettes.\n"
        "- *HOG*: 8x8 cells, 2x2 blocks, 9 orientations (OpenCV).\n"
        "- *Pixels*: the silhouette itself.\n"
        "- *Krawtchouk, diagonal*: the paper's descriptor.\n"
        "- *Krawtchouk, discriminant*: the service's, learned on the known silhouettes.",
    ], {
        "machine": machine(),
        "seed": SEED,
        "hahn_concentrations_percent": trials,
        "descriptors": [vars(f) for f in figures],
    })  # fmt: skip


def descriptors(
    simulation: Simulation, known: NDArray[np.uint8], concentration: float, choice: Choice
) -> dict[str, Describe]:
    """All descriptors by name; what is learned is learned on the known silhouettes."""
    spread = baselines.hu_moments(known).std(axis=0)
    codebook = baselines.learn_codebook(known[::CODEBOOK_EVERY], WORDS, SEED)
    return {
        "Hu": lambda s: baselines.hu_moments(s) / spread,
        "Zernike": lambda s: baselines.zernike_moments(s, ZERNIKE_DEGREE),
        "Hahn": lambda s: baselines.hahn_moments(s, concentration),
        "Shape context": lambda s: baselines.context_histograms(s, codebook),
        "HOG": baselines.hog,
        "Pixels": baselines.pixels,
        "Krawtchouk, diagonal": DiagonalDescriptor().describe,
        "Krawtchouk, discriminant": choice.learn(simulation).describe,
    }


def measure(
    name: str,
    describe: Describe,
    data: PaperData,
    known: NDArray[np.uint8],
    silhouettes: dict[float, NDArray[np.uint8]],
) -> Figures:
    """Describe, search, count, and take the time."""
    vectors = in_blocks(describe, known)
    rates = {}
    for std, asked in silhouettes.items():
        numbers = nearest(vectors, in_blocks(describe, asked), max(COUNTS))
        errors = joint_errors(data.known, data.unseen, numbers)
        rates[f"{std:g}"] = {n: recognised(errors, n) for n in COUNTS}
    sample = known[:: len(known) // TIMED][:TIMED]
    return Figures(name, vectors.shape[1], rates, microseconds(describe, sample))


def in_blocks(describe: Describe, silhouettes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Describe many silhouettes in little memory."""
    starts = range(0, len(silhouettes), 512)
    return np.concatenate([describe(silhouettes[start : start + 512]) for start in starts])


def microseconds(describe: Describe, silhouettes: NDArray[np.uint8]) -> float:
    """Median time to describe one silhouette."""
    times = []
    for row in range(len(silhouettes)):
        start = time.perf_counter()
        describe(silhouettes[row : row + 1])
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))


def choose_hahn(known: Simulation) -> tuple[float, dict[float, float]]:
    """The concentration that recognises most known frames held out, and all that were tried."""
    rest, held = split_by_frame(known, position=3)
    there, asked = rest.silhouettes(slice(None)), held.silhouettes(slice(None))
    rates = {}
    for t in HAHN_CONCENTRATIONS:
        numbers = nearest(baselines.hahn_moments(there, t), baselines.hahn_moments(asked, t), 1)
        rates[t] = recognised(joint_errors(rest, held, numbers), 1)
    return max(rates, key=lambda t: rates[t]), rates


def sentences_on_better(figures: Sequence[Figures]) -> str:
    """Which descriptors recognise more than the last one, and what they cost."""
    own = figures[-1]
    sentences = []
    for std, rates in own.recognised.items():
        names = [
            f"{f.name} ({f.values} values)" for f in figures[:-1] if f.recognised[std][1] > rates[1]
        ]
        sentences.append(
            f"With {std} px of noise and N = 1, more is recognised than by {own.name} "
            f"({own.values} values) by {', '.join(names) or 'none'}."
        )
    return " ".join(sentences)


def descriptor_table(figures: Sequence[Figures]) -> str:
    """One line for each descriptor."""
    header = ["descriptor", "values"]
    header += [f"{std:g} px, N = {n}" for std in STDS_PX for n in COUNTS]
    rows = [
        [f.name, str(f.values)]
        + [percent(rate) for rates in f.recognised.values() for rate in rates.values()]
        + [f"{f.microseconds:.0f}"]
        for f in figures
    ]
    return table([*header, "time (us)"], rows)
