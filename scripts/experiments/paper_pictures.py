"""Plots of the paper's experiments and of the choice of the descriptor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from index.skeleton import JOINT_NAMES

COLOURS = {
    "published": "0.45",
    "paper's descriptor": "C1",
    "paper's, our matching": "C5",
    "ours, nearest": "C2",
    "ours": "C0",
}

TRACK_REACH_PX = 10.0
"""Every track is drawn over at least twice this."""


@dataclass(frozen=True)
class Track:
    """Joints over the frames of a clip.

    Parameters
    ----------
    frames : (F,) int array
    truth, answer : (F, 19, 2) arrays
        Pixels of the normalised frame.
    """

    frames: NDArray[np.integer]
    truth: NDArray[np.floating]
    answer: NDArray[np.floating]

    @property
    def error_px(self) -> float:
        """Mean distance of the joints."""
        return float(np.linalg.norm(self.answer - self.truth, axis=-1).mean())


def plot_noise(
    stds_px: Sequence[float],
    rates: Mapping[str, Mapping[int, Sequence[float]]],
    published: Mapping[int, Sequence[float]],
    file: Path,
) -> None:
    """Recognition over noise, N = 1 and N = 7 side by side."""
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axes, n in zip(panels, published, strict=True):
        lines = {"published": published[n], **{name: rate[n] for name, rate in rates.items()}}
        for name, values in lines.items():
            dashed = "--" if name == "published" else "-"
            axes.plot(stds_px, values, dashed, marker="o", color=COLOURS[name], label=name)
        axes.set(title=f"N = {n}", xlabel="noise on the contour (px)", xticks=stds_px)
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="recognised (%)", ylim=(40, 101))
    panels[0].legend(loc="lower left")
    _save(figure, file)


def plot_order(
    curves: Mapping[str, Mapping[str, Mapping[int, Sequence[float]]]], file: Path
) -> None:
    """Recognition over the order, N = 1 and N = 7 side by side."""
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axes, (column, n) in zip(panels, enumerate((1, 7)), strict=True):
        for colour, (name, by_noise) in zip(("C1", "C0"), curves.items(), strict=True):
            for dashed, (std, curve) in zip(("-", "--"), by_noise.items(), strict=True):
                values = [rates[column] for rates in curve.values()]
                axes.plot(
                    list(curve), values, dashed, color=colour, label=f"{name}, {std} px of noise"
                )
        axes.axvline(24, color="0.7", linewidth=1)
        axes.annotate("the paper's n", (24, 60), rotation=90, color="0.4", ha="right")
        axes.set(title=f"N = {n}", xlabel="moments of orders below n", ylim=(0, 101))
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="recognised (%)")
    panels[1].legend(loc="lower right")
    _save(figure, file)


def plot_descriptors(
    figures: Mapping[str, tuple[Mapping[str, Mapping[int, float]], float]], file: Path
) -> None:
    """Recognition beside the time for a silhouette."""
    names = list(figures)
    place = np.arange(len(names))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10, 4.2), sharey=True, width_ratios=(2, 1), layout="constrained"
    )
    by_noise = figures[names[0]][0]
    for colour, std in zip(("C0", "C3"), by_noise, strict=True):
        for marker, n in zip(("o", "D"), by_noise[std], strict=True):
            values = [figures[name][0][std][n] for name in names]
            left.plot(
                values, place, marker, color=colour, fillstyle="full" if n == 1 else "none",
                label=f"{std} px of noise, N = {n}",
            )  # fmt: skip
    left.set(xlabel="recognised (%)", xlim=(None, 100.9), yticks=place, yticklabels=names)
    left.invert_yaxis()
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    times = [figures[name][1] for name in names]
    right.barh(place, times, 0.6, color="0.6")
    for row, value in zip(place, times, strict=True):
        right.annotate(f" {value:.0f}", (value, row), va="center")
    right.set(xscale="log", xlabel="time for a silhouette (us)", xlim=(1, 20 * max(times)))
    left.grid(alpha=0.3)
    right.grid(alpha=0.3, axis="x")
    _save(figure, file)


def plot_tracks(clips: Mapping[str, Track], joints: Sequence[str], file: Path) -> None:
    """Two columns for each clip, across and down; a row for each joint."""
    figure, grid = plt.subplots(
        len(joints), 2 * len(clips), figsize=(12, 8), sharex="col", layout="constrained"
    )
    for column, ((action, track), axis) in enumerate(product(clips.items(), range(2))):
        across = ("x", "y")[axis]
        grid[0, column].set_title(f"{action} ({track.error_px:.2f} px): {across}")
        for row, joint in enumerate(joints):
            truth, answer = (
                points[:, JOINT_NAMES.index(joint), axis] for points in (track.truth, track.answer)
            )
            axes = grid[row, column]
            axes.plot(track.frames, truth, color="0.3", label="truth")
            axes.plot(track.frames, answer, "o", markersize=3, color="C0", label="answer")
            middle = (truth.min() + truth.max()) / 2
            reach = max(TRACK_REACH_PX, np.abs([*truth, *answer] - middle).max() + 1)
            # Down is down in the picture, too.
            ends = (middle - reach, middle + reach)
            axes.set(ylim=ends[::-1] if across == "y" else ends)
            axes.grid(alpha=0.3)
            if column == 0:
                axes.set_ylabel(joint.replace("_", " ") + " (px)")
        grid[-1, column].set_xlabel("frame (30 a second)")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    _save(figure, file)


def plot_choice(
    curves: Mapping[str, Mapping[str, Mapping[str, float]]],
    shipped: Mapping[str, str],
    diagonal: Mapping[str, float],
    file: Path,
) -> None:
    """A panel for each choice: recognition at 1 and within 7, the paper's descriptor dashed."""
    figure, panels = plt.subplots(
        1, len(curves), figsize=(15, 4), sharey=True, layout="constrained"
    )
    for axes, (name, curve) in zip(panels, curves.items(), strict=True):
        labels = list(curve)
        place = np.arange(len(labels))
        for colour, (key, words) in zip(
            ("C0", "C2"), (("right_1", "at rank 1"), ("right_7", "within 7")), strict=True
        ):
            values = [curve[label][key] for label in labels]
            axes.plot(place, values, marker="o", color=colour, label=words)
            axes.axhline(
                diagonal[key], color=colour, linestyle="--", label=f"{words}, paper's descriptor"
            )
        axes.axvline(labels.index(shipped[name]), color="0.8", linewidth=6, zorder=0)
        axes.set(xlabel=name, xticks=place, ylim=(0, 100))
        axes.set_xticklabels(labels, rotation=30 if name in ("orders", "regions") else 0)
        axes.grid(alpha=0.3)
    panels[0].set(ylabel="right (%)")
    handles, words_shown = panels[0].get_legend_handles_labels()
    band = Line2D([], [], color="0.8", linewidth=6)
    figure.legend([*handles, band], [*words_shown, "shipped"], loc="outside upper center", ncols=5)
    _save(figure, file)


def _save(figure: Figure, file: Path) -> None:
    figure.savefig(file, dpi=120)
    plt.close(figure)
