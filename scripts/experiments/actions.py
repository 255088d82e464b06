"""The actions experiment: actions and postures of subjects unknown to index and model."""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.estimation.posture import PostureFilter
from app.tracking.actions import MIN_VOTE, ActionModel
from app.vision.odds import softmax
from index import DEFAULT_PATH
from index.posture import POSTURES
from scripts.index.calibrate import expected_calibration_error
from scripts.metrics import confusion, percent
from scripts.training.action_model import (
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
from scripts.training.action_tracks import (
    Track,
    read_or_make_tracks,
    track_windows,
    training_windows,
)


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add this experiment's options to the command line."""
    parser.add_argument("--tracks", type=Path, help="file that keeps the tracks for the next time")


def run(options: argparse.Namespace) -> dict[str, object]:
    """Run the experiment."""
    tracks = read_or_make_tracks(options.shared, DEFAULT_PATH, options.tracks)
    windows = training_windows(options.shared, tracks)
    return measure(tracks, windows)


def measure(tracks: Sequence[Track], windows: Windows) -> dict[str, object]:
    """Return all figures; ``windows`` are those of training."""
    unseen = leave_subjects_out(windows)
    temperature = best_temperature(unseen, TEMPERATURES)
    return {
        "actions": list(ACTIONS),
        "left_out_clips": list(SEVERAL_ACTIONS),
        "shortest_s": SHORTEST_S,
        "longest_s": LONGEST_S,
        "cameras": COPIES,
        "temperature": temperature,
        "sequences": {
            name: answers.figures()
            for name, answers in sequence_answers(windows, unseen, temperature, tracks).items()
        },
        "postures": posture_figures(tracks),
    }


@dataclass(frozen=True)
class Answers:
    """Recognised actions of sequences, as positions ``(S,)`` in :data:`ACTIONS`.

    ``vote_right`` is the percentage that the plain vote of the frames' first hypotheses recognises;
    ``calibration_error`` is that of the probabilities of windows, in ten bins.
    """

    truth: NDArray[np.int64]
    answer: NDArray[np.int64]
    vote_right: float | None
    calibration_error: float

    def figures(self) -> dict[str, object]:
        """Return the figures: percentages over sequences, and the mean over actions."""
        right = self.truth == self.answer
        by_action = [right[self.truth == row].mean() for row in np.unique(self.truth)]
        return {
            "number": len(right),
            "vote_percent": self.vote_right,
            "percent": percent(right),
            "mean_over_actions_percent": percent(by_action),
            "calibration_error": self.calibration_error,
            "confusion": confusion(len(ACTIONS), self.truth, self.answer).tolist(),
        }


def sequence_answers(
    windows: Windows, unseen: Unseen, temperature: float, tracks: Sequence[Track]
) -> dict[str, Answers]:
    """Recognise the actions of simulated skeletons and of tracks."""
    shown, of_tracks = track_windows(tracks)
    simulated = len(windows.actions) - 3 * len(of_tracks.actions)
    motion = windows.motion[unseen.rows]
    votes = np.ones((len(windows.actions), len(ACTIONS)))
    votes[simulated : simulated + len(shown)] = [hypothesis_votes(track) for track in shown]
    odds = unseen.odds / temperature + VOTE_WEIGHT * np.log(np.maximum(votes, MIN_VOTE))[motion]
    probabilities = softmax(odds)
    plain = {simulated + number: plain_vote(track) for number, track in enumerate(shown)}
    sources = {
        "skeletons_with_noise": range(simulated),
        "tracks_from_silhouettes": range(simulated, simulated + len(shown)),
    }
    answers = {}
    for name, numbers in sources.items():
        rows = np.isin(motion, list(numbers))
        asked, given, truth = np.unique(motion[rows]), probabilities[rows], unseen.truth[rows]
        means = np.array([probabilities[motion == number].mean(axis=0) for number in asked])
        right = [
            plain[number] == windows.actions[number] for number in asked.tolist() if number in plain
        ]
        answers[name] = Answers(
            np.array([ACTIONS.index(windows.actions[number]) for number in asked]),
            means.argmax(axis=1),
            percent(right) if right else None,
            expected_calibration_error(given.max(axis=1), given.argmax(axis=1) == truth),
        )
    return answers


def hypothesis_votes(track: Track) -> NDArray[np.float64]:
    """Return the mean votes ``(A,)`` of the hypotheses of a track."""
    model = ActionModel(ACTIONS, np.zeros((len(ACTIONS), 1)), np.zeros(len(ACTIONS)), VOTE_WEIGHT)
    return np.asarray(np.mean([model.votes(person.hypotheses) for person in track.people], axis=0))


def plain_vote(track: Track) -> str:
    """Return the action of most frames' first hypotheses."""
    votes = Counter(
        person.hypotheses[0].label.action for person in track.people if person.hypotheses
    )
    return votes.most_common(1)[0][0]


def posture_figures(tracks: Sequence[Track]) -> dict[str, dict[str, float]]:
    """Return how often the posture is right, by a frame's hypotheses and over time."""
    truth, answers = [], []
    for track in tracks:
        postures = PostureFilter()
        for row, (person, (_, smoothed)) in enumerate(
            zip(track.people, track.smoothed, strict=True)
        ):
            box, timestamp = person.box, float(track.timestamps[row])
            over_time, _ = postures.update(timestamp, smoothed.votes, None, 1.0, box)
            labels = [p.label if p else "unclear" for p in (person.posture, over_time)]
            truth.append(track.posture[row])
            answers.append([-1 if p == "unclear" else POSTURES.index(p) for p in labels])
    true = np.array(truth)
    right = np.array(answers) == true[:, None]
    groups = {"all": np.ones(len(true), bool)}
    groups |= {name: true == row for row, name in enumerate(POSTURES) if (true == row).any()}
    return {
        name: {
            "frames": int(rows.sum()),
            "frame_percent": percent(right[rows, 0]),
            "smoothed_percent": percent(right[rows, 1]),
        }
        for name, rows in groups.items()
    }
