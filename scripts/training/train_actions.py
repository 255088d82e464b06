"""Train the model of actions: ``actions.npz``.

It learns from the motion clips of ``../shared/mocap``, as true skeletons with simulated noise and
as tracks of hypotheses. That takes ten minutes on two cores. ``evaluate actions`` measures how well
it recognises the actions of unseen subjects.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.networks.shipped import FOLDER
from index import DEFAULT_PATH
from scripts.results import SHARED
from scripts.training.action_model import (
    TEMPERATURES,
    at_temperature,
    best_temperature,
    fit,
    leave_subjects_out,
)
from scripts.training.action_tracks import read_or_make_tracks, training_windows
from scripts.training.shipping import record_hash


def main(arguments: Sequence[str] | None = None) -> None:
    """Train as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--out", type=Path, default=FOLDER / "actions.npz")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--tracks", type=Path, help="file that keeps the tracks for the next time")
    options = parser.parse_args(arguments)
    tracks = read_or_make_tracks(options.shared, options.index, options.tracks)
    windows = training_windows(options.shared, tracks)
    temperature = best_temperature(leave_subjects_out(windows), TEMPERATURES)
    model = at_temperature(fit(windows, np.ones(len(windows.motion), bool)), temperature)
    np.savez(
        options.out,
        actions=np.array(model.actions),
        weights=model.weights,
        offsets=model.offsets,
        vote_weight=np.array(model.vote_weight),
        temperature=np.array(temperature),
    )
    record_hash(options.out)
    print(f"{len(windows.motion)} windows, temperature {temperature:g}")
