"""Actions, postures and falls of people whom neither index nor model knows."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.tracking.actions import LEAST_SHARE, ActionModel
from app.tracking.events import EventDetector, Trust
from app.tracking.postures import PostureFilter
from descriptor.descriptor import DiagonalDescriptor
from index.artefact import load_index
from index.build.avatars import INDEX_AVATARS, make_avatars
from index.build.motion import read_manifest
from index.build.poses import read_poses
from index.posture import POSTURES
from index.store import PoseIndex
from scripts.experiments.action_model import (
    ACTIONS,
    COPIES,
    LONGEST_S,
    SEVERAL_ACTIONS,
    SHORTEST_S,
    TEMPERATURES,
    VOTE_WEIGHT,
    Unseen,
    Windows,
    best_temperature,
    leave_subjects_out,
)
from scripts.experiments.action_tracks import (
    AFTER_S,
    FALL,
    Track,
    read_or_make_tracks,
    track_windows,
    training_windows,
)
from scripts.experiments.protocol import film, rig
from scripts.experiments.report import percent, table, write
from scripts.experiments.weizmann import (
    PUBLISHED,
    Recognition,
    Recording,
    leave_one_person_out,
    read_recordings,
)

COMMAND = "python -m scripts.evaluate actions"
ROOT = Path(__file__).resolve().parents[2]

ON_THE_GROUND = ("lie",)
"""Actions in which a fall is no false alarm."""

FRAME_STEP = 6
"""Clip frames between the silhouettes of the frame vote: 5 a second."""


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--tracks", type=Path, help="file that keeps the tracks for the next time")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks and write ``actions.md`` and ``actions.json``."""
    recordings = read_recordings(options.weizmann) if options.weizmann.is_file() else None
    index_folder = ROOT / "index" / "data"
    index = load_index(index_folder)
    votes = {} if recordings is None else frame_votes(recordings, index)
    simulated_votes = frame_votes(film_recordings(options.shared), index)
    tracks = read_or_make_tracks(options.shared, index_folder, options.tracks)
    windows = training_windows(options.shared, tracks)
    unseen = leave_subjects_out(windows)
    temperature = best_temperature(unseen, TEMPERATURES)
    answers = sequence_answers(windows, unseen, temperature, tracks)
    postures = told_postures(tracks)
    falls = told_falls(tracks)
    write(options.out, "actions", COMMAND, [
        "Actions, postures and falls",
        "## The paper's frame vote",
        "One person is left out; each of their frames takes the action of the nearest frame of all "
        "others (Euclidean distance), and the frames of a sequence vote. Percent of the sequences "
        "right. *Ours* is the descriptor of the shipped index, and known frames stand for their "
        "mirror images too.",
        vote_table(votes, simulated_votes),
        f"- *Weizmann*: {PUBLISHED} % are published by Atrevi et al. (2016). The data set's "
        f"authors distribute it; `{COMMAND} --weizmann classification_masks.mat` measures it. "
        "[Its page](weizmann.md) has the confusions, frames in order, and camera sessions.\n"
        f"- *Simulated clips*: {len(next(iter(simulated_votes.values())).truth)} sequences of the "
        f"{len(ACTIONS)} actions below, a different avatar for each subject, before eight cameras, "
        "5 silhouettes a second.",
        "## Actions over time",
        f"Told apart are {', '.join(ACTIONS)}: those that two subjects or more do in the same "
        "sense (scripts/experiments/action_model.py says which are not, and why). Each subject is "
        "asked of a model that was trained on all others. A sequence is a stretch of one action, "
        f"{SHORTEST_S:g} to {LONGEST_S:g} s (tracks: 6 s), without the waiting before and after; "
        f"not asked: {', '.join(SEVERAL_ACTIONS)}, which show two actions each. Its action is that "
        "of the highest mean probability over windows of the last three seconds. "
        "Actions, window, shrinkage and the thresholds of falls were chosen with a look at these "
        "sequences: expect less elsewhere.",
        table(
            ["sequences", "number", "plain vote of rank 1 (%)", "motion and votes (%)",
             "mean over actions (%)", "expected calibration error"],
            [[name, str(len(a.truth)), percent(a.vote_right), percent(100 * a.right),
              percent(100 * a.mean_right), percent(a.calibration_error)]
             for name, a in answers.items()],
        ),
        f"- *skeletons with noise*: the clips on avatars, {COPIES} cameras each, true joints with "
        "20 to 70 mm of noise an axis, 5 to 30 frames a second.\n"
        "- *tracks from silhouettes*: filmed, matched frame by frame by an index without the "
        "subject's clips, smoothed (PoseSmoother), no photograph.",
        *(f"### Confusions, {name}\n\n{confusion(a)}" for name, a in answers.items()),
        "## Postures",
        "Frames of the tracks from silhouettes whose posture (rules of docs/index.md, on the true "
        "skeleton, with its true speed) is told: by a frame's hypotheses, and by the smoother's "
        "states.",
        table(
            ["posture", "frames", "frame (%)", "smoothed (%)"],
            [[name, str(count), *(percent(value) for value in values)]
             for name, (count, values) in postures.items()],
        ),
        "## Falls",
        f"{falls.falls} simulated falls of unseen subjects, filmed and matched as above: people "
        "who stand, walk or exercise tipped over, one recorded fall and one get-up played "
        f"backwards, each by four cameras; all stay down {AFTER_S:g} s. Found: {falls.found} "
        f"({percent(100 * falls.found / max(falls.falls, 1))} %). False alarms: {falls.alarms} in "
        f"{falls.minutes:.1f} minutes of the other tracks (walking, sitting, exercising); so few "
        "minutes bound the rate an hour only loosely.",
        table(["missed", "subject"], [[clip, subject] for clip, subject in falls.missed]),
    ], {
        "frame_vote_percent": {
            "published": PUBLISHED,
            **{f"weizmann, {name}": 100 * r.right for name, r in votes.items()},
            **{f"simulated, {name}": 100 * r.right for name, r in simulated_votes.items()},
        },
        "temperature": temperature,
        "sequences": {name: {
            "vote_percent": a.vote_right, "percent": 100 * a.right,
            "mean_over_actions_percent": 100 * a.mean_right,
            "calibration_error": a.calibration_error,
        } for name, a in answers.items()},
        "postures": {name: [count, *values] for name, (count, values) in postures.items()},
        "falls": {"number": falls.falls, "found": falls.found, "alarms": falls.alarms,
                  "minutes": falls.minutes},
    })  # fmt: skip


def frame_votes(recordings: Sequence[Recording], index: PoseIndex) -> dict[str, Recognition]:
    """The paper's protocol with its descriptor and with ours."""
    return {
        "paper's descriptor": leave_one_person_out(
            recordings, DiagonalDescriptor(), mirrored=False
        ),
        "ours": leave_one_person_out(recordings, index.descriptor, mirrored=True),
    }


def vote_table(weizmann: Mapping[str, Recognition], simulated: Mapping[str, Recognition]) -> str:
    """A line for each data set."""

    def cells(votes: Mapping[str, Recognition]) -> list[str]:
        return [percent(100 * votes[n].right if n in votes else None) for n in simulated]

    return table(
        ["data", "published", *simulated],
        [["Weizmann", f"{PUBLISHED}", *cells(weizmann)],
         ["Simulated clips", "-", *cells(simulated)]],
    )  # fmt: skip


def film_recordings(shared: Path) -> list[Recording]:
    """The clips of :data:`ACTIONS` as silhouettes, an avatar for each subject, eight cameras."""
    segments = [
        s for s in read_manifest(shared / "mocap")
        if s.action in ACTIONS and s.clip not in SEVERAL_ACTIONS
    ]  # fmt: skip
    subjects = sorted({segment.subject for segment in segments})
    avatars = make_avatars(INDEX_AVATARS[: len(subjects)], None)
    recordings = []
    for segment in segments:
        poses, _ = read_poses(shared / "mocap", [segment])
        avatar = avatars[subjects.index(segment.subject)]
        filmed = film(poses.take(np.arange(0, len(poses), FRAME_STEP)), [avatar], rig())
        cameras = len(rig())
        recordings += [
            Recording(
                segment.subject, segment.action, filmed.silhouettes(slice(camera, None, cameras))
            )
            for camera in range(cameras)
        ]
    by_action: dict[str, set[str]] = {}
    for recording in recordings:
        by_action.setdefault(recording.action, set()).add(recording.person)
    return [r for r in recordings if len(by_action[r.action]) > 1]


@dataclass(frozen=True)
class Answers:
    """Actions told of sequences.

    Parameters
    ----------
    truth, told : (S,) int64 arrays
        Positions in :data:`ACTIONS`.
    vote_right : float or None
        Percent that the plain vote of the frames' first hypotheses tells.
    calibration_error : float
        Of the probabilities of windows, in ten bins.
    """

    truth: NDArray[np.int64]
    told: NDArray[np.int64]
    vote_right: float | None
    calibration_error: float

    @property
    def right(self) -> float:
        """Share of the sequences."""
        return float((self.truth == self.told).mean())

    @property
    def mean_right(self) -> float:
        """Mean over the actions of the share of each."""
        right = self.truth == self.told
        return float(np.mean([right[self.truth == row].mean() for row in np.unique(self.truth)]))


def sequence_answers(
    windows: Windows, unseen: Unseen, temperature: float, tracks: Sequence[Track]
) -> dict[str, Answers]:
    """What is told of simulated skeletons and of tracks.

    Parameters
    ----------
    windows : Windows
        As :func:`training_windows` puts them together.
    unseen : Unseen
        Of these windows.
    temperature : float
    tracks : sequence of Track
    """
    shown, of_tracks = track_windows(tracks)
    simulated = len(windows.actions) - 3 * len(of_tracks.actions)
    model = ActionModel(ACTIONS, np.zeros((len(ACTIONS), 1)), np.zeros(len(ACTIONS)), VOTE_WEIGHT)
    votes = np.ones((len(windows.actions), len(ACTIONS)))
    for number, track in enumerate(shown):
        of_frames = [model.votes(person.hypotheses) for person in track.people]
        votes[simulated + number] = np.mean(of_frames, axis=0)
    motion = windows.motion[unseen.rows]
    odds = unseen.odds / temperature + VOTE_WEIGHT * np.log(np.maximum(votes, LEAST_SHARE))[motion]
    odds = np.exp(odds - odds.max(axis=1, keepdims=True))
    probabilities = odds / odds.sum(axis=1, keepdims=True)
    plain = {
        simulated + number: Counter(
            person.hypotheses[0].label.action for person in track.people if person.hypotheses
        ).most_common(1)[0][0] == track.action
        for number, track in enumerate(shown)
    }  # fmt: skip
    sources = {
        "skeletons with noise": range(simulated),
        "tracks from silhouettes": range(simulated, simulated + len(shown)),
    }
    answers = {}
    for name, numbers in sources.items():
        rows = np.isin(motion, list(numbers))
        asked = np.unique(motion[rows])
        means = np.array([probabilities[motion == number].mean(axis=0) for number in asked])
        right = [plain[number] for number in asked.tolist() if number in plain]
        answers[name] = Answers(
            np.array([ACTIONS.index(windows.actions[number]) for number in asked]),
            means.argmax(axis=1),
            100 * float(np.mean(right)) if right else None,
            calibration_error(probabilities[rows], unseen.truth[rows]),
        )
    return answers


def calibration_error(probabilities: NDArray[np.float64], truth: NDArray[np.int64]) -> float:
    """Expected calibration error of the most probable answers, ten bins."""
    sure, right = probabilities.max(axis=1), probabilities.argmax(axis=1) == truth
    bins = np.minimum((sure * 10).astype(int), 9)
    return float(sum(
        abs(sure[bins == row].mean() - right[bins == row].mean()) * (bins == row).mean()
        for row in np.unique(bins)
    ))  # fmt: skip


def confusion(answers: Answers) -> str:
    """Counts: truth in rows, what was told in columns."""
    rows = []
    for row in np.unique(answers.truth):
        counts = np.bincount(answers.told[answers.truth == row], minlength=len(ACTIONS))
        rows.append([ACTIONS[row], *(str(count) if count else "" for count in counts)])
    return table(["", *ACTIONS], rows)


def told_postures(tracks: Sequence[Track]) -> dict[str, tuple[int, list[float]]]:
    """Frames of each posture, and percent right by frame and smoothed."""
    truth, told = [], []
    for track in tracks:
        postures = PostureFilter()
        for row, (person, smoothed) in enumerate(zip(track.people, track.smoothed, strict=True)):
            box = person.observed.box
            timestamp = float(track.timestamps[row])
            over_time, _ = postures.update(timestamp, smoothed.votes, None, 1.0, box)
            labels = [p.label if p else "unclear" for p in (person.posture, over_time)]
            truth.append(track.posture[row])
            told.append([-1 if p == "unclear" else POSTURES.index(p) for p in labels])
    true = np.array(truth)
    right = np.array(told) == true[:, None]
    groups = {"all": np.ones(len(true), bool)}
    groups |= {name: true == row for row, name in enumerate(POSTURES) if (true == row).any()}
    return {
        name: (int(rows.sum()), (100 * right[rows].mean(axis=0)).tolist())
        for name, rows in groups.items()
    }


@dataclass(frozen=True)
class Falls:
    """Falls found, and alarms where nobody fell."""

    falls: int
    found: int
    alarms: int
    minutes: float
    missed: tuple[tuple[str, str], ...]


def told_falls(tracks: Sequence[Track]) -> Falls:
    """Let a detector watch every track."""
    found, alarms, seconds = 0, 0, 0.0
    missed = []
    falls = [track for track in tracks if track.action == FALL]
    for track in tracks:
        detector = EventDetector()
        events = [
            event
            for timestamp, smoothed in zip(
                track.timestamps.tolist(), track.smoothed, strict=True
            )
            for event in detector.update(
                1, timestamp, smoothed.votes, Trust(*2 * [smoothed.pose.confidence])
            )
            if event.event == "fell"
        ]  # fmt: skip
        if track.action == FALL:
            found += bool(events)
            missed += [] if events else [(track.clip, track.subject)]
        elif track.action not in ON_THE_GROUND:
            alarms += len(events)
            seconds += float(track.timestamps[-1])
    return Falls(len(falls), found, alarms, seconds / 60, tuple(missed))
