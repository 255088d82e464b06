"""Actions, postures and falls of people whom neither index nor model knows."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.tracking.actions import ActionModel
from app.tracking.events import EventDetector, Reliability
from app.tracking.parameters import DEFAULTS
from app.tracking.posture_filter import PostureFilter
from app.tracking.smoothing import PoseSmoother
from index.artefact import load_index
from index.posture import POSTURES
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
    ACROBATICS,
    AFTER_S,
    FALL,
    OTHER_FPS,
    Track,
    make_others,
    read_or_make_tracks,
    track_windows,
    training_windows,
)
from scripts.experiments.report import percent, table, write
from scripts.experiments.sequences import FPS

COMMAND = "python -m scripts.evaluate actions"
ROOT = Path(__file__).resolve().parents[2]

RATES = (2, 5, 10, 30)
"""Frames a second at which falls are watched."""


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--tracks", type=Path, help="file that keeps the tracks for the next time")


def run(options: argparse.Namespace) -> None:
    """Run the experiment as the command line asks and write ``actions.md`` and ``actions.json``."""
    tracks = read_or_make_tracks(options.shared, ROOT / "index" / "data", options.tracks)
    windows = training_windows(options.shared, tracks)
    unseen = leave_subjects_out(windows)
    temperature = best_temperature(unseen, TEMPERATURES)
    answers = sequence_answers(windows, unseen, temperature, tracks)
    postures = told_postures(tracks)
    others = make_others(options.shared, load_index(ROOT / "index" / "data"))
    falls = {rate: told_falls([t for t in tracks if t.action == FALL], rate) for rate in RATES}
    minutes = sum(float(track.timestamps[-1]) for track in others) / 60
    alarms = {rate: told_falls(others, rate) for rate in RATES if rate <= OTHER_FPS}
    write(options.out, "actions", COMMAND, [
        "Actions, postures and falls",
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
        f"{len(falls[FPS])} simulated falls of unseen subjects, filmed and matched as above: "
        "people who stand, walk or exercise tipped over, one recorded fall and one get-up played "
        f"backwards, each by four cameras; all stay down {AFTER_S:g} s. They are smoothed and "
        "watched as in a camera session. False alarms are those of all other motion, filmed once "
        f"(without {', '.join(ACROBATICS)}): people who walk, climb, sit down, work, exercise, "
        "crouch, kneel, crawl and lie.",
        table(
            ["frames a second", "falls", "found", "%", "false alarms", "in minutes"],
            [[str(rate), str(len(told)), str(np.count_nonzero(told)),
              percent(100 * float(np.mean(np.array(told) > 0))),
              *([str(sum(alarms[rate])), f"{minutes:.1f}"] if rate in alarms else ["-", "-"])]
             for rate, told in falls.items()],
        ),
        table(
            ["told wrongly", "subject", "frames a second"],
            [[f"{track.action} ({track.clip})", track.subject, str(rate)]
             for rate, told in alarms.items()
             for track, times in zip(others, told, strict=True) if times],
        ),
    ], {
        "temperature": temperature,
        "sequences": {name: {
            "vote_percent": a.vote_right, "percent": 100 * a.right,
            "mean_over_actions_percent": 100 * a.mean_right,
            "calibration_error": a.calibration_error,
        } for name, a in answers.items()},
        "postures": {name: [count, *values] for name, (count, values) in postures.items()},
        "falls": {str(rate): {"number": len(told), "found": int(np.count_nonzero(told))}
                  for rate, told in falls.items()},
        "false_alarms": {str(rate): {"number": sum(told), "minutes": minutes}
                         for rate, told in alarms.items()},
    })  # fmt: skip


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
    log_votes = np.log(np.maximum(votes, DEFAULTS.actions.min_vote))
    odds = unseen.odds / temperature + VOTE_WEIGHT * log_votes[motion]
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


def told_falls(tracks: Sequence[Track], rate: int) -> list[int]:
    """How often each person is told to have fallen, at some frames a second."""
    return [fell(track, round(1 / (rate * track.timestamps[1]))) for track in tracks]


def fell(track: Track, step: int) -> int:
    """How often somebody is told to have fallen, of every ``step``-th frame."""
    smoother, postures, detector = PoseSmoother(), PostureFilter(), EventDetector()
    told = 0
    for timestamp, person in zip(
        track.timestamps[::step].tolist(), track.people[::step], strict=True
    ):
        smoothed = smoother.update(person, timestamp)
        if smoothed is None:
            continue
        box = person.observed.box
        _, shares = postures.update(timestamp, smoothed.votes, None, 1.0, box)
        reliability = Reliability(*2 * [smoothed.pose.confidence])
        events = detector.update(1, timestamp, shares, reliability, box.height)
        told += sum(event.event == "fell" for event in events)
    return told
