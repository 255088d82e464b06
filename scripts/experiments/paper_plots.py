"""Plots of the paper's experiments."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from index.skeleton import JOINT_NAMES
from scripts.experiments.outline_noise import disturb_all
from scripts.index.simulate import Simulation

COLUMNS = {
    "paper": ("the paper's descriptor", "C1"),
    "pixels": ("raw pixels", "C7"),
    "ours_nearest": ("ours, nearest", "C2"),
    "ours": ("ours", "C0"),
}
READINGS = {"queries": "noise on the queries", "database": "noise on the database"}
SHOWN_JOINTS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
REACH_PX = 10.0
"""Every track is drawn over at least twice this."""


@dataclass(frozen=True)
class Track:
    """Joints over the frames of a clip: ``(F,)`` and three times ``(F, 19, 2)``, normalised px."""

    frames: NDArray[np.integer]
    truth: NDArray[np.floating]
    paper: NDArray[np.floating]
    ours: NDArray[np.floating]


def plot_orders(curves: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draw recognition over the orders of the paper's moments."""
    figure, axes = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
    orders = [one["order"] for one in curves.values()]
    for n, style in ((7, "s-"), (1, "o-")):
        for std, colour in ((0, "C1"), (3, "C3")):
            rates = [one[f"n_{n}_noise_{std}"] for one in curves.values()]
            label = f"N = {n}, {std} px of noise" if std else f"N = {n}, no noise"
            filled = "full" if n == 1 else "none"
            axes.plot(orders, rates, style, color=colour, label=label, fillstyle=filled)
    axes.axvline(24, color="0.7", linewidth=1, zorder=0)
    axes.annotate("the paper's 24", (23.6, 22), rotation=90, color="0.4", ha="right")
    axes.set(xlabel="orders of each region's moments", ylabel="recognised (%)", ylim=(0, 102))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    _save(figure, file)


def plot_noise(
    stds_px: Sequence[int],
    rates: Mapping[str, Mapping[int, Mapping[str, Sequence[float]]]],
    published: Mapping[int, Sequence[float]],
    file: Path,
) -> None:
    """Draw recognition over noise: a panel for each reading and N."""
    figure, grid = plt.subplots(
        len(published), len(rates), figsize=(10, 7), sharex=True, sharey=True, layout="constrained"
    )
    for (row, n), (column, reading) in product(enumerate(published), enumerate(rates)):
        axes = grid[row, column]
        known = published[n]
        axes.plot(stds_px[: len(known)], known, "k--", marker="x", label="published")
        for name, (label, colour) in COLUMNS.items():
            axes.plot(stds_px, rates[reading][n][name], color=colour, marker="o", ms=4, label=label)
        axes.set_title(f"N = {n}, {READINGS[reading]}")
        axes.grid(alpha=0.3)
    for axes in grid[:, 0]:
        axes.set(ylabel="recognised (%)", ylim=(0, 102))
    for axes in grid[-1]:
        axes.set(xlabel="standard deviation of the noise (px of 128x48)", xticks=stds_px)
    grid[0, 0].legend(loc="lower left")
    _save(figure, file)


def plot_noisy_silhouettes(
    simulation: Simulation, stds_px: Sequence[int], seed: int, file: Path
) -> None:
    """Draw three silhouettes with growing noise."""
    some = np.linspace(0, len(simulation) - 1, 3).round().astype(int) // 8 * 8
    rows = simulation.silhouettes(some)
    figure, grid = plt.subplots(len(rows), len(stds_px), figsize=(7.5, 7), layout="constrained")
    for column, std in enumerate(stds_px):
        for axes, silhouette in zip(grid[:, column], disturb_all(rows, std, seed), strict=True):
            axes.imshow(silhouette, cmap="gray_r", interpolation="nearest")
            axes.set(xticks=[], yticks=[])
        grid[0, column].set_title(f"{std} px", fontsize=10)
    _save(figure, file)


def plot_tracks(clips: Mapping[str, Track], file: Path) -> None:
    """Draw two columns for each clip, across and down, and a row for each joint."""
    figure, grid = plt.subplots(
        len(SHOWN_JOINTS), 2 * len(clips), figsize=(12, 8), sharex="col", layout="constrained"
    )
    for column, ((action, track), axis) in enumerate(product(clips.items(), range(2))):
        grid[0, column].set_title(f"{action}, {('across', 'down')[axis]}")
        for axes, joint in zip(grid[:, column], SHOWN_JOINTS, strict=True):
            row = JOINT_NAMES.index(joint)
            truth, paper, ours = (
                points[:, row, axis] for points in (track.truth, track.paper, track.ours)
            )
            axes.plot(track.frames, truth, color="0.3", label="truth")
            axes.plot(track.frames, paper, "x", color="C1", label="the paper's descriptor")
            axes.plot(track.frames, ours, "o", ms=3, color="C0", label="ours")
            middle = (truth.min() + truth.max()) / 2
            reach = max(REACH_PX, np.abs([*truth, *paper, *ours] - middle).max() + 1)
            # Down is down in the picture, too.
            ends = (middle - reach, middle + reach)
            axes.set(ylim=ends[::-1] if axis else ends)
            axes.grid(alpha=0.3)
            if column == 0:
                axes.set_ylabel(joint.replace("_", " ") + " (px)")
        grid[-1, column].set_xlabel("frame of the clip (30 a second)")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    _save(figure, file)


def _save(figure: Figure, file: Path) -> None:
    """Save a figure in 64 colours: a third of the bytes."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=100)
    plt.close(figure)
    Image.open(drawn).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(
        file, optimize=True
    )
