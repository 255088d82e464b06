"""Train the network that recognises one person in two frames: ``identity.npz``.

It learns from the pairs that camera sessions compared in films (``render-films``). Prints how often
it is wrong on held-out ones.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.networks.probabilities import sigmoid
from app.networks.shipped import FOLDER
from app.tracking.place import BoxFilter
from app.vision.geometry import Box
from app.vision.same_person import FEATURES, KnownPerson
from scripts.training.fit_dense import fit_dense
from scripts.training.render.film import RATE
from scripts.training.shipping import record_hash

LATER_S = 0.5
"""Time unseen from which a pair counts as one of a person who was lost."""

STEPS, LONGEST_S = (1, 2, 3, 5), 2.0
"""Numbers of frames from one to the next, since films are read at lower rates as well; and the
longest time between the two of a pair."""

UNKNOWN = 0.2
"""Share of pairs whose colours, and of others whose windows, are left out."""

_ELAPSED, _COLOURS, _IN_WINDOW = 9, 10, 12  # Columns of the features.
_BOX = slice(82, 86)  # Columns of the rows of films.


def pairs_of(folders: Sequence[Path]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether both are one person ``(N,)``, and features ``(N, 13)``, of the pairs of films."""
    parts = [np.empty((0, 1 + FEATURES))]
    for file in sorted(file for folder in folders for file in folder.glob("film-????.npz")):
        with np.load(file) as arrays:
            parts += [arrays["pairs"]] if "pairs" in arrays and len(arrays["pairs"]) else []
            if len(arrays["rows"]):
                parts += [pairs_at(arrays["rows"], step) for step in STEPS]
    rows = np.concatenate([part for part in parts if len(part)])
    return rows[:, 0] > 0, rows[:, 1:]


def pairs_at(rows: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Pairs ``(N, 14)`` of a film at a lower rate, of unknown colours and without windows."""
    found: dict[int, dict[int, Box]] = {}
    for number, person, box in zip(rows[:, 0], rows[:, 1], rows[:, _BOX], strict=True):
        if number % step == 0 and np.isfinite(box).all():
            found.setdefault(int(number), {})[int(person)] = Box(*box.tolist())
    known: dict[int, BoxFilter] = {}
    seen_at: dict[int, float] = {}
    pairs = []
    for number, boxes in sorted(found.items()):
        time = number / RATE
        for one, track in known.items():
            elapsed = time - seen_at[one]
            if elapsed <= LONGEST_S:
                person = KnownPerson(track.predict(time), track.seen, elapsed, None)
                pairs += [
                    [one == other, *person.features(box, None, in_window=False)]
                    for other, box in boxes.items()
                ]
        for one, box in boxes.items():
            if one in known:
                known[one].update(box, time, whole=True)
            else:
                known[one] = BoxFilter(box, time)
            seen_at[one] = time
    return np.array(pairs)


def with_unknown(
    features: NDArray[np.float64], generator: np.random.Generator
) -> NDArray[np.float64]:
    """The same pairs, of some of which colours or windows are unknown."""
    changed = features.copy()
    without = generator.random((2, len(features))) < UNKNOWN
    changed[without[0], _COLOURS], changed[without[0], _COLOURS + 1] = 0, 1
    changed[without[1], _IN_WINDOW] = 0
    return changed


def report(name: str, same: NDArray[np.bool_], said: NDArray[np.float64]) -> str:
    """Shares of one person taken for two and of two taken for one, and the log loss."""
    right = np.where(same, said, 1 - said)
    loss = -np.log(np.maximum(right, 1e-6)).mean()
    two, one = 100 * (said[same] < 0.5).mean(), 100 * (said[~same] >= 0.5).mean()
    return (
        f"{name}: {same.sum()} of one person, {two:.2f} % taken for two; "
        f"{(~same).sum()} of two, {one:.2f} % taken for one; log loss {loss:.3f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Train as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--train", type=Path, nargs="+", required=True, help="films")
    parser.add_argument("--held-out", type=Path, nargs="+", required=True, help="others")
    parser.add_argument("--out", type=Path, default=FOLDER / "identity.npz")
    options = parser.parse_args(arguments)
    import torch

    same, features = pairs_of(options.train)
    features = with_unknown(features, np.random.default_rng(0))
    network = fit_dense(
        features, same[:, None].astype(np.float64), 1,
        torch.nn.functional.binary_cross_entropy_with_logits,
        hidden=(24,), epochs=40, seed=0, rate=4e-3, dropout=0.05, noise=0.05,
    )  # fmt: skip
    arrays: dict[str, Any] = {**network.arrays("identity")}
    np.savez(options.out, **arrays)
    record_hash(options.out)
    same, features = pairs_of(options.held_out)
    said = sigmoid(network(features)[:, 0].astype(np.float64))
    colours = features[:, _COLOURS + 1] == 0
    later = colours & (features[:, _ELAPSED] > LATER_S)
    print(report("all", same, said))
    print(report("as a session compares them", same[colours], said[colours]))
    print(report("unseen for a while", same[later], said[later]))
