"""The paper's figure 11: joints followed over a climb and a jump, every frame by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from descriptor.descriptor import DiagonalDescriptor
from index.build.avatars import PAPER_AVATARS, make_avatars
from index.build.body import Avatar
from index.build.learn import view_joints
from index.build.motion import Segment
from index.build.poses import Poses, read_poses
from index.build.simulate import Simulation
from index.skeleton import JOINT_NAMES, JOINTS
from index.store import PoseIndex
from scripts.experiments.answers import SEED, Choice, all_candidates, make_index, ranked_modes
from scripts.experiments.paper_pictures import Track, plot_tracks
from scripts.experiments.protocol import (
    FRAMES,
    STEP,
    STRETCHES,
    PaperData,
    film,
    nearest,
    rig,
)
from scripts.experiments.report import table, write

PUBLISHED_PX = {"climb": 1.98, "jump": 1.99}
"""The paper's mean errors."""

SHOWN_AVATAR, SHOWN_CAMERA = 0, 1
SHOWN_JOINTS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
KNOWN_BODY, OTHER_BODY = "known body", "other body"
PAPER, PLAIN, OURS = "paper's descriptor", "ours, nearest", "ours"


def run(data: PaperData, motion: Path, choice: Choice, out: Path, command: str) -> None:
    """Follow both clips and write ``paper-motion.*``."""
    avatars = make_avatars(PAPER_AVATARS, None)
    errors: dict[str, dict[str, dict[str, float]]] = {}
    tracks = {}
    for action in PUBLISHED_PX:
        filmed = film(every_frame(motion, action), avatars, rig())
        errors[action] = {
            KNOWN_BODY: _mean(ask(data.known, frames_between(filmed), choice)),
            OTHER_BODY: _mean(np.concatenate([
                ask(without(data.known, avatar), only(filmed, avatar), choice)
                for avatar in tqdm(avatars, desc=f"{action}, other bodies", unit="body")
            ], axis=1)),
        }  # fmt: skip
        tracks[action] = follow(data.known, filmed, avatars[SHOWN_AVATAR], choice)
    out.mkdir(parents=True, exist_ok=True)
    plot_tracks(tracks, SHOWN_JOINTS, out / "paper-motion.png")
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
        f"the known silhouettes do not show ({avatars[SHOWN_AVATAR].name}), before the camera at "
        f"{camera['azimuth_deg']:.0f} degrees of azimuth and {camera['elevation_deg']:.0f} "
        "degrees of elevation; the titles say the mean error over all 19 joints.",
    ], {
        "published_px": PUBLISHED_PX,
        "mean_error_px": errors,
        "seed": SEED,
        "tracks": {
            action: {
                "frames": track.frames.tolist(),
                **{name: {
                    "truth": track.truth[:, row].round(2).tolist(),
                    "answer": track.answer[:, row].round(2).tolist(),
                } for row, name in enumerate(JOINT_NAMES) if name in SHOWN_JOINTS},
            }
            for action, track in tracks.items()
        },
    })  # fmt: skip


def every_frame(motion: Path, action: str) -> Poses:
    """All frames of an action's stretch, not every other one only."""
    clip, start = STRETCHES[action]
    poses, _ = read_poses(motion, [Segment(clip, "", action, start, start + STEP * FRAMES[action])])
    return poses


def frames_between(filmed: Simulation) -> Simulation:
    """The frames that no sample of the stretch holds."""
    frames = filmed.skeleton_labels["frame"][filmed.entries["skeleton"]].astype(int)
    return filmed.take(np.flatnonzero((frames - frames.min()) % STEP != 0))


def only(simulation: Simulation, avatar: Avatar) -> Simulation:
    """The entries of one avatar."""
    subjects = simulation.skeleton_labels["subject"][simulation.entries["skeleton"]]
    return simulation.take(np.flatnonzero(subjects == simulation.subjects.index(avatar.name)))


def without(simulation: Simulation, avatar: Avatar) -> Simulation:
    """The entries of all other avatars."""
    subjects = simulation.skeleton_labels["subject"][simulation.entries["skeleton"]]
    return simulation.take(np.flatnonzero(subjects != simulation.subjects.index(avatar.name)))


def ask(known: Simulation, asked: Simulation, choice: Choice) -> NDArray[np.float64]:
    """Joint errors ``(3, Q)`` in px of the first answers: the paper's, ours nearest, and ours."""
    learned, truth = choice.learn(known), view_joints(asked)[1]
    joints = view_joints(known)[1]
    answers: list[NDArray[np.floating]] = []
    for descriptor in (DiagonalDescriptor(), learned):
        numbers = nearest(known.describe(descriptor), asked.describe(descriptor), 1)
        answers.append(joints[numbers[:, 0]])
    index = make_index(known, learned)
    answers.append(first_answers(index, asked, choice))
    return np.stack([np.linalg.norm(a - truth, axis=-1).mean(axis=-1) for a in answers])


def first_answers(index: PoseIndex, asked: Simulation, choice: Choice) -> NDArray[np.float64]:
    """Joints ``(Q, 19, 2)`` of the first distinct pose for every silhouette."""
    found = all_candidates(index, asked.silhouettes(slice(None)), choice.matching.candidates)
    return np.stack(
        [ranked_modes(c, choice.matching, 1).points_normalised[0, :JOINTS] for c in found]
    )


def follow(known: Simulation, filmed: Simulation, avatar: Avatar, choice: Choice) -> Track:
    """One avatar before one camera over all frames, asked of the other avatars."""
    rest, shown = without(known, avatar), only(filmed, avatar)
    azimuth = rig()["azimuth_deg"][SHOWN_CAMERA]
    shown = shown.take(np.flatnonzero(shown.entries["azimuth_deg"] == azimuth))
    index = make_index(rest, choice.learn(rest))
    return Track(
        shown.skeleton_labels["frame"][shown.entries["skeleton"]].astype(int),
        view_joints(shown)[1],
        first_answers(index, shown, choice),
    )


def _mean(errors: NDArray[np.floating]) -> dict[str, float]:
    return dict(zip((PAPER, PLAIN, OURS), errors.mean(axis=1).tolist(), strict=True))
