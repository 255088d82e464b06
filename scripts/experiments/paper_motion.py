"""The paper's figure 11: joints followed over a climb and a jump, every frame by itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import DiagonalDescriptor
from index.build.avatars import PAPER_AVATARS, make_avatars
from index.build.learn import view_joints
from index.build.motion import Segment
from index.build.poses import Poses, read_poses
from index.build.simulate import Simulation
from index.skeleton import JOINT_NAMES, JOINTS
from scripts.experiments.paper_answers import OURS, PAPER, PLAIN, SEED, first_poses, learn
from scripts.experiments.protocol import FRAMES, STEP, STRETCHES, PaperData, film, nearest, rig
from scripts.experiments.report import table, write

PUBLISHED_PX = {"climb": 1.98, "jump": 1.99}
"""The paper's mean errors."""

SHOWN_CAMERA = 1
SHOWN_JOINTS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
KNOWN_BODY, OTHER_BODY = "known body", "other body"
REACH_PX = 10.0
"""Every track is drawn over at least twice this."""


@dataclass(frozen=True)
class Track:
    """Joints over the frames of a clip: ``(F,)`` and twice ``(F, 19, 2)``, normalised pixels."""

    frames: NDArray[np.integer]
    truth: NDArray[np.floating]
    answer: NDArray[np.floating]


def run(data: PaperData, motion: Path, out: Path, command: str) -> None:
    """Follow both clips and write ``paper-motion.*``."""
    avatars = make_avatars(PAPER_AVATARS, None)
    names = [avatar.name for avatar in avatars]
    errors: dict[str, dict[str, dict[str, float]]] = {}
    tracks = {}
    for action in PUBLISHED_PX:
        filmed = film(every_frame(motion, action), avatars, rig())
        others = [
            ask(of_body(data.known, name, others=True), of_body(filmed, name))
            for name in tqdm(names, desc=f"{action}, other bodies", unit="body")
        ]
        errors[action] = {
            KNOWN_BODY: means(ask(data.known, frames_between(filmed))),
            OTHER_BODY: means(np.concatenate(others, axis=1)),
        }
        tracks[action] = follow(data.known, filmed, names[0])
    plot(tracks, out / "paper-motion.png")
    camera = rig()[SHOWN_CAMERA]
    write(out, "paper-motion", command, [
        "Joints followed over a climb and a jump",
        "Mean joint reprojection error of the first answer, in px of the 128x48 frame. Every "
        "frame is answered by itself; nothing is smoothed. Each stretch is asked for frame by "
        "frame, 30 a second, on four avatars before eight cameras; data and columns as in "
        "[paper-noise.md](paper-noise.md).",
        table(
            ["clip", "asked", "published", PAPER, PLAIN, OURS],
            [[f"{action} ({STRETCHES[action][0]})", case, f"{PUBLISHED_PX[action]:.2f}",
              *(f"{value:.2f}" for value in values.values())]
             for action, cases in errors.items() for case, values in cases.items()],
        ),
        f"- *{KNOWN_BODY}*: every other frame, which no avatar shows among the known "
        "silhouettes.\n"
        f"- *{OTHER_BODY}*: all frames, each avatar asked of the known silhouettes of the other "
        "three alone.\n"
        "- *published*: the mean errors of Atrevi et al. on clips of their own; the paper does not "
        "say which of the two its figures are for.\n\n"
        "The known silhouettes hold the same motion, two frames apart. How well motions are "
        "followed that an index never saw is another experiment: `python -m scripts.evaluate "
        "simulation`.",
        "![joint tracks](paper-motion.png)",
        f"Four joints over all frames, truth and first answer of *{OURS}*, on one avatar that "
        f"the known silhouettes do not show ({names[0]}), before the camera at "
        f"{camera['azimuth_deg']:.0f} degrees of azimuth and {camera['elevation_deg']:.0f} "
        "degrees of elevation; the titles say the mean error over all 19 joints.",
    ], {"published_px": PUBLISHED_PX, "mean_error_px": errors, "seed": SEED})  # fmt: skip


def every_frame(motion: Path, action: str) -> Poses:
    """All frames of an action's stretch, not every other one only."""
    clip, start = STRETCHES[action]
    poses, _ = read_poses(motion, [Segment(clip, "", action, start, start + STEP * FRAMES[action])])
    return poses


def frames_between(filmed: Simulation) -> Simulation:
    """The frames that no sample of the stretch holds."""
    frames = filmed.skeleton_labels["frame"][filmed.entries["skeleton"]].astype(int)
    return filmed.take(np.flatnonzero((frames - frames.min()) % STEP != 0))


def of_body(simulation: Simulation, name: str, *, others: bool = False) -> Simulation:
    """The entries of one avatar, or of all others."""
    subjects = simulation.skeleton_labels["subject"][simulation.entries["skeleton"]]
    own = subjects == simulation.subjects.index(name)
    return simulation.take(np.flatnonzero(own != others))


def ask(known: Simulation, asked: Simulation) -> NDArray[np.float64]:
    """Joint errors ``(3, Q)`` in px of the first answers: the paper's, ours nearest, and ours."""
    learned, truth = learn(known), view_joints(asked)[1]
    joints = view_joints(known)[1]
    answers: list[NDArray[np.floating]] = []
    for descriptor in (DiagonalDescriptor(), learned):
        numbers = nearest(known.describe(descriptor), asked.describe(descriptor), 1)
        answers.append(joints[numbers[:, 0]])
    answers.append(first_poses(known, learned, asked.silhouettes(slice(None)), 1)[:, 0, :JOINTS])
    return np.stack([np.linalg.norm(a - truth, axis=-1).mean(axis=-1) for a in answers])


def follow(known: Simulation, filmed: Simulation, name: str) -> Track:
    """One avatar before one camera over all frames, asked of the other avatars."""
    rest, shown = of_body(known, name, others=True), of_body(filmed, name)
    azimuth = rig()["azimuth_deg"][SHOWN_CAMERA]
    shown = shown.take(np.flatnonzero(shown.entries["azimuth_deg"] == azimuth))
    return Track(
        shown.skeleton_labels["frame"][shown.entries["skeleton"]].astype(int),
        view_joints(shown)[1],
        first_poses(rest, learn(rest), shown.silhouettes(slice(None)), 1)[:, 0, :JOINTS],
    )


def means(errors: NDArray[np.floating]) -> dict[str, float]:
    """Mean of each column."""
    return dict(zip((PAPER, PLAIN, OURS), errors.mean(axis=1).tolist(), strict=True))


def plot(clips: Mapping[str, Track], file: Path) -> None:
    """Draw two columns for each clip, across and down, and a row for each joint."""
    rows, columns = len(SHOWN_JOINTS), 2 * len(clips)
    figure, grid = plt.subplots(rows, columns, figsize=(12, 8), sharex="col", layout="constrained")
    for column, ((action, track), axis) in enumerate(product(clips.items(), range(2))):
        error_px = np.linalg.norm(track.answer - track.truth, axis=-1).mean()
        grid[0, column].set_title(f"{action} ({error_px:.2f} px): {'xy'[axis]}")
        for axes, joint in zip(grid[:, column], SHOWN_JOINTS, strict=True):
            row = JOINT_NAMES.index(joint)
            truth, answer = track.truth[:, row, axis], track.answer[:, row, axis]
            axes.plot(track.frames, truth, color="0.3", label="truth")
            axes.plot(track.frames, answer, "o", markersize=3, color="C0", label="answer")
            middle = (truth.min() + truth.max()) / 2
            reach = max(REACH_PX, np.abs([*truth, *answer] - middle).max() + 1)
            # Down is down in the picture, too.
            ends = (middle - reach, middle + reach)
            axes.set(ylim=ends[::-1] if axis else ends)
            axes.grid(alpha=0.3)
            if column == 0:
                axes.set_ylabel(joint.replace("_", " ") + " (px)")
        grid[-1, column].set_xlabel("frame (30 a second)")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.savefig(file, dpi=120)
    plt.close(figure)
