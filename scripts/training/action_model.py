"""Learn the actions of tracks from motion clips, shown as cameras and hypotheses would see them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.tracking.actions import WINDOW_S, ActionModel, PoseSample, window_features
from app.vision.odds import softmax
from index.skeleton import JOINT_NAMES, POINT_NAMES, camera_rotation
from scripts.filming import CLIP_FPS, ELEVATIONS_DEG, on_ground, unbroken_stretches
from scripts.index.body import Avatar, pose_transforms, posed_points, retarget
from scripts.index.motion import Segment
from scripts.index.poses import read_poses

ACTIONS = (
    "arm-circle", "jump", "jumping-jack", "knee-raise", "lie", "punch",
    "run", "sit", "squat", "stand", "twist", "walk",
)  # fmt: skip
"""The recognised actions: those that at least two subjects do, each in the same sense.

Left out are bend, duck and kick, which mean another motion for each subject (reaching down or
sideways; creeping or a leap from a run; football or karate); sit-down and roll, since the second
subject shows less than two seconds of each; and actions of a single subject, which no other subject
could test.
"""

SEVERAL_ACTIONS = ("127_25", "127_27", "127_33", "127_35")
"""Clips with one label that show two actions: people run, jump once and run on."""

SHORTEST_S, LONGEST_S = 1.2, 20.0
"""Shorter stretches are left out, longer ones cut."""

IDLE_BELOW = 0.3
"""Mean speed of limbs and pelvis, metres a second, below which a person only stands.

Many clips begin and end with a waiting person; these parts are learned as standing.
"""

STILL_ACTIONS = ("lie", "sit", "stand")

FRAME_RATES = (5, 6, 10, 15, 30)
TEMPO = (0.8, 1.25)
PACE_M_S, FASTEST_TEMPO = (0.7, 1.9), 2.0
"""Walking speeds, and the fastest tempo used to reach them: half of the clips' walkers are
deliberately slower than 0.65 m/s."""
ON_THE_SPOT_M_S = 0.25
ELEVATION_ERROR_DEG = (-4.0, 9.0)
"""Mean and deviation of the error of a camera's estimated elevation."""

NOISE_M = (0.02, 0.07)
"""Deviation of a joint's position: half of it stays, half changes within a second."""

NOISE_OF_AXIS = (0.6, 0.6, 1.3)
"""Relative deviation along x, y and depth, which is the least certain."""

SHRINKAGE = 0.4
"""Shrinkage of the covariance towards a multiple of the identity: with a handful of subjects, more
than half of the features' dimensions are noise."""

VOTE_WEIGHT = 0.15
HOP_S = 0.5
TEMPERATURES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
COPIES, SEED = 4, 20

_PIXELS_PER_METRE = 100.0
_LIMBS = [
    JOINT_NAMES.index(f"{side}_{name}")
    for side in ("left", "right")
    for name in ("elbow", "wrist", "knee", "ankle")
] + [0]
_NOISE_OF_POINT = np.array([
    1.5 if name.endswith(("wrist", "ankle", "toe"))
    else 0.5 if name.endswith(("pelvis", "spine", "chest", "hip", "shoulder"))
    else 1.0
    for name in POINT_NAMES
])[:, None]  # fmt: skip


@dataclass(frozen=True)
class Motion:
    """One action of one subject, from a frame of a clip on: ``(F, 24, 3)`` m, y up, 30 fps."""

    clip: str
    subject: str
    action: str
    start: int
    world: NDArray[np.float64]


def read_motions(
    folder: Path, segments: Sequence[Segment], avatars: Sequence[Avatar]
) -> list[Motion]:
    """Read every unbroken stretch of one of :data:`ACTIONS`, on avatars in turn.

    Waiting before and after is split off as standing; standing is added a second time, laid down.
    """
    wanted = [s for s in segments if s.action in ACTIONS and s.clip not in SEVERAL_ACTIONS]
    subjects = {segment.clip: segment.subject for segment in wanted}
    poses, _ = read_poses(folder, wanted)
    motions: list[Motion] = []
    for number, rows in enumerate(unbroken_stretches(poses)):
        clip, frames = poses.clips[poses.clip[rows[0]]], poses.frame[rows]
        avatar = avatars[number % len(avatars)]
        transforms = pose_transforms(avatar, retarget(clip, avatar), clip.rotations[frames])
        points = posed_points(avatar, transforms)
        world = points + on_ground(clip, frames, points)[:, None]
        action = poses.actions[poses.action[rows[0]]]
        whole = Motion(clip.name, subjects[clip.name], action, int(frames[0]), world)
        motions += _without_waiting(whole)
    motions += [laid_down(m, turn) for m in motions if m.action == "stand" for turn in (0, 1)]
    return [
        piece
        for motion in motions
        for piece in _pieces(motion, round(LONGEST_S * CLIP_FPS))
        if len(piece.world) >= SHORTEST_S * CLIP_FPS
    ]


def laid_down(motion: Motion, quarter_turns: int) -> Motion:
    """Lay a motion on its back, turned about the body's long axis by quarters."""
    pelvis = motion.world[:, :1]
    angle = np.pi / 2 * quarter_turns
    about_axis = np.array([
        [np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)],
    ])  # fmt: skip
    onto_back = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    lying = (motion.world - pelvis) @ (onto_back @ about_axis).T
    lying += pelvis * (1.0, 0.0, 1.0)
    lying[..., 1] -= lying[..., 1].min(axis=1, keepdims=True)
    return replace(motion, action="lie", world=lying)


def _without_waiting(motion: Motion) -> list[Motion]:
    """Split off the waiting at the start and at the end as standing."""
    if motion.action in STILL_ACTIONS or len(motion.world) < CLIP_FPS:
        return [motion]
    steps = np.linalg.norm(np.diff(motion.world[:, _LIMBS], axis=0), axis=-1).mean(axis=1)
    half = CLIP_FPS // 4
    speeds = np.convolve(np.pad(steps, half, mode="edge"), np.ones(2 * half + 1), "valid")
    busy = np.flatnonzero(speeds * CLIP_FPS / (2 * half + 1) > IDLE_BELOW)
    if len(busy) == 0:
        return [replace(motion, action="stand")]
    first, end = int(busy[0]), int(busy[-1]) + 2
    return [
        replace(motion, action="stand", world=motion.world[:first]),
        replace(motion, start=motion.start + first, world=motion.world[first:end]),
        replace(motion, action="stand", start=motion.start + end, world=motion.world[end:]),
    ]


def _pieces(motion: Motion, most: int) -> list[Motion]:
    return [
        replace(motion, start=motion.start + first, world=motion.world[first : first + most])
        for first in range(0, len(motion.world), most)
    ]


def seen(motion: Motion, generator: np.random.Generator) -> list[PoseSample]:
    """Show a motion as a random camera and its hypotheses would."""
    tempo = _tempo(motion, generator) * CLIP_FPS
    rate = float(generator.choice(FRAME_RATES))
    frames = np.arange(0, len(motion.world) - 1, tempo / rate)
    before = frames.astype(int)
    share = (frames - before)[:, None, None]
    world = (1 - share) * motion.world[before] + share * motion.world[before + 1]
    elevation_deg = generator.uniform(*ELEVATIONS_DEG)
    rotation = camera_rotation(generator.uniform(0, 360), elevation_deg)
    in_camera = world @ rotation.T
    noise_m = generator.uniform(*NOISE_M)
    noise = noise_m * _wandering(len(world), rate, generator)
    points = in_camera - in_camera[:, :1] + noise * _NOISE_OF_POINT * NOISE_OF_AXIS
    jitter = generator.normal(0, 0.3 * noise_m, (len(world), 2))
    taken_for = max(elevation_deg + generator.normal(*ELEVATION_ERROR_DEG), 0.0)
    return [
        PoseSample(
            number / rate,
            points[number] - points[number, :1],
            _PIXELS_PER_METRE * (in_camera[number, 0, :2] + jitter[number]),
            _PIXELS_PER_METRE,
            taken_for,
        )
        for number in range(len(world))
    ]


def _tempo(motion: Motion, generator: np.random.Generator) -> float:
    """Draw how much faster than recorded a motion is shown; walkers get a usual walking speed."""
    path = motion.world[:, 0][:, [0, 2]]
    speed = float(np.linalg.norm(path[-1] - path[0])) * CLIP_FPS / len(path)
    if motion.action != "walk" or speed < ON_THE_SPOT_M_S:
        return float(generator.uniform(*TEMPO))
    return float(np.clip(generator.uniform(*PACE_M_S) / speed, TEMPO[0], FASTEST_TEMPO))


def _wandering(count: int, rate: float, generator: np.random.Generator) -> NDArray[np.float64]:
    """Draw errors ``(count, 24, 3)`` of deviation 1.4: half constant, half gone in a second."""
    kept = 0.1 ** (1 / rate)
    errors = np.empty((count, len(POINT_NAMES), 3))
    errors[0] = generator.normal(size=errors.shape[1:])
    for number in range(1, count):
        fresh = generator.normal(size=errors.shape[1:])
        errors[number] = kept * errors[number - 1] + np.sqrt(1 - kept**2) * fresh
    return np.asarray(errors + generator.normal(size=errors.shape[1:]))


@dataclass(frozen=True)
class Windows:
    """Features ``(W, D)`` of windows, and the motion ``(W,)`` that each belongs to."""

    features: NDArray[np.float64]
    motion: NDArray[np.int64]
    actions: tuple[str, ...]
    subjects: tuple[str, ...]

    @property
    def labels(self) -> NDArray[np.str_]:
        """Action ``(W,)`` of each window."""
        return np.array(self.actions)[self.motion]

    def of_subject(self, subject: str) -> NDArray[np.bool_]:
        """Whether each window ``(W,)`` shows a subject."""
        return np.asarray((np.array(self.subjects) == subject)[self.motion])


def joined_windows(parts: Sequence[Windows]) -> Windows:
    """Concatenate windows of several sources."""
    firsts = np.cumsum([0, *(len(part.actions) for part in parts[:-1])])
    return Windows(
        np.concatenate([part.features for part in parts]),
        np.concatenate([part.motion + first for part, first in zip(parts, firsts, strict=True)]),
        tuple(action for part in parts for action in part.actions),
        tuple(subject for part in parts for subject in part.subjects),
    )


def make_windows(motions: Sequence[Motion], copies: int, seed: int) -> Windows:
    """Show every motion ``copies`` times and take windows from it, ``HOP_S`` apart."""
    generator = np.random.default_rng(seed)
    shown = [motion for motion in motions for _ in range(copies)]
    parts = [windows_of(seen(motion, generator)) for motion in shown]
    return Windows(
        np.concatenate(parts),
        np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        tuple(motion.action for motion in shown),
        tuple(motion.subject for motion in shown),
    )


def windows_of(measured: Sequence[PoseSample]) -> NDArray[np.float64]:
    """Return features ``(W, D)`` of windows that end ``HOP_S`` apart, back from the last pose."""
    times = np.array([m.timestamp for m in measured])
    ends = np.arange(times[-1], min(WINDOW_S, times[-1]) - 1e-9, -HOP_S)
    return np.stack([
        window_features([m for m in measured if end - WINDOW_S <= m.timestamp <= end + 1e-9])
        for end in ends
    ])  # fmt: skip


def fit(windows: Windows, rows: NDArray[np.bool_], vote_weight: float = VOTE_WEIGHT) -> ActionModel:
    """Learn linear discriminants from some windows."""
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    features, labels = windows.features[rows], windows.labels[rows]
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-6
    names, counts = np.unique(labels, return_counts=True)
    # Between the clips' shares and equal ones: people walk more than they squat.
    priors = np.sqrt(counts) / np.sqrt(counts).sum()
    model = LinearDiscriminantAnalysis(solver="lsqr", shrinkage=SHRINKAGE, priors=priors)
    model.fit((features - mean) / spread, labels)
    weights = model.coef_ / spread
    return ActionModel(
        tuple(names.tolist()), weights, model.intercept_ - weights @ mean, vote_weight
    )


def at_temperature(model: ActionModel, temperature: float) -> ActionModel:
    """Divide a model's log odds by a temperature: above 1 it is less certain."""
    return replace(model, weights=model.weights / temperature, offsets=model.offsets / temperature)


@dataclass(frozen=True)
class Unseen:
    """Predictions for subjects that a model was not trained on.

    ``rows`` are the windows whose action another subject does as well, ``odds`` their log odds over
    :data:`ACTIONS`, -inf for actions that the model was not taught, ``truth`` positions in them.
    """

    rows: NDArray[np.int64]
    odds: NDArray[np.float64]
    truth: NDArray[np.int64]

    def probabilities(self, temperature: float) -> NDArray[np.float64]:
        """Return probabilities ``(U, A)``."""
        return softmax(self.odds / temperature)


def leave_subjects_out(windows: Windows) -> Unseen:
    """Predict the windows of each subject by a model trained on all others."""
    rows, odds = [], []
    for subject in sorted(set(windows.subjects)):
        held = windows.of_subject(subject)
        model = fit(windows, ~held)
        shown = np.flatnonzero(held & np.isin(windows.labels, model.actions))
        answers = np.full((len(shown), len(ACTIONS)), -np.inf)
        columns = [ACTIONS.index(action) for action in model.actions]
        answers[:, columns] = windows.features[shown] @ model.weights.T + model.offsets
        rows.append(shown)
        odds.append(answers)
    together = np.concatenate(rows)
    truth = np.array([ACTIONS.index(label) for label in windows.labels[together]])
    return Unseen(together, np.concatenate(odds), truth)


def best_temperature(unseen: Unseen, candidates: Iterable[float]) -> float:
    """Return the temperature at which the actions of unseen subjects are likeliest."""

    def loss(temperature: float) -> float:
        given = unseen.probabilities(temperature)[np.arange(len(unseen.truth)), unseen.truth]
        return -float(np.log(given + 1e-9).mean())

    return min(candidates, key=loss)
