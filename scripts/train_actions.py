"""Train the model that tells actions of tracks: ``app/tracking/weights/actions.json``.

    python -m scripts.train_actions

Reads the motion clips of ``../shared/mocap``. How well unseen subjects' actions are told is
measured by ``python -m scripts.evaluate actions``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.tracking.actions import MODEL
from index.build.avatars import CALIBRATION_AVATARS, make_avatars
from index.build.motion import read_manifest
from scripts.experiments.action_model import (
    at_temperature,
    best_temperature,
    fit,
    leave_subjects_out,
    make_windows,
    read_motions,
)

ROOT = Path(__file__).resolve().parent.parent
COPIES, SEED = 8, 20
TEMPERATURES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, default=MODEL)
    options = parser.parse_args(arguments)
    motion = options.shared / "mocap"
    motions = read_motions(motion, read_manifest(motion), make_avatars(CALIBRATION_AVATARS, None))
    windows = make_windows(motions, COPIES, SEED)
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
