"""Train the model that tells actions of tracks: ``app/tracking/models/actions.json``.

    python -m scripts.train_actions

Learns from the motion clips of ``../shared/mocap``, as true skeletons with simulated noise and as
tracks of hypotheses, which takes ten minutes on two cores. How well unseen subjects' actions are
told is measured by ``python -m scripts.evaluate actions``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.tracking.actions import MODEL
from scripts.experiments.action_model import (
    TEMPERATURES,
    at_temperature,
    best_temperature,
    fit,
    leave_subjects_out,
)
from scripts.experiments.action_tracks import read_or_make_tracks, training_windows

ROOT = Path(__file__).resolve().parent.parent


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, default=MODEL)
    parser.add_argument("--index", type=Path, default=ROOT / "index" / "data")
    parser.add_argument("--tracks", type=Path, help="file that keeps the tracks for the next time")
    options = parser.parse_args(arguments)
    tracks = read_or_make_tracks(options.shared, options.index, options.tracks)
    windows = training_windows(options.shared, tracks)
    temperature = best_temperature(leave_subjects_out(windows), TEMPERATURES)
    model = at_temperature(fit(windows, np.ones(len(windows.motion), bool)), temperature)
    values = {
        "made_by": "python -m scripts.train_actions",
        "temperature": temperature,
        "vote_weight": model.vote_weight,
        "actions": model.actions,
        "offsets": model.offsets.round(4).tolist(),
        "weights": [[float(f"{value:.4g}") for value in row] for row in model.weights],
    }
    options.out.write_text(json.dumps(values).replace("], [", "],\n [") + "\n")
    print(f"{options.out}: {len(windows.motion)} windows, temperature {temperature:g}")


if __name__ == "__main__":
    main()
