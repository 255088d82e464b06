"""Train the model of falls on simulated tracks and rendered films: see ``docs/training.md``.

Needs films that ``render-films`` read, of training and of held-out clips. Motions are made once and
kept beside the films. Prints the falls found and the false ones, by the probability from which they
are reported, on held-out motions, errors and scenes, and on the tracks of held-out films.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.networks.shipped import FOLDER, read_arrays
from app.tracking.falls import COLUMNS, MEMORIES, WINDOW_S, FallModel, FallReport, window_features
from scripts.index.builder import HELD_OUT_AVATARS
from scripts.index.garments import make_avatars
from scripts.metrics import reliability
from scripts.results import ROOT
from scripts.training.fall_tracks import Eyes, Track, crowd, home, tracks_of
from scripts.training.film_tracks import film_tracks
from scripts.training.fit_dense import midway
from scripts.training.loop import begin, optimise
from scripts.training.motion_library import Library
from scripts.training.shipping import record_hash

HOMES, CROWDS = 14000, 1200
"""Scenes of training."""

SHOWN_S = 0.2
"""Time on the ground from which a fall is to be recognised; before, it counts neither way."""

FILM_WEIGHT = 4.0
"""Weight of windows of rendered films, whose errors are the session's own."""

LEAST_FRAMES = 8
"""Of a part of a track in which somebody lies."""

STEP_S = 0.2
"""Least time between two windows of a track."""

NETWORKS = 3
"""Networks whose mean is the model: in crowds, it has a quarter fewer false falls than one."""

HIDDEN = (48, 48, 48)
DROPOUT, WEIGHT_DECAY, NOISE = 0.1, 0.01, 0.01
_BATCH = 1024
EPOCHS, RATE = 12, 4e-3
"""Passes over the windows, and the highest learning rate."""
EPOCHS_TRAINED_ON, RATE_TRAINED_ON = 4, 1e-3
"""The same of networks that are trained on."""

THRESHOLDS = ((0.5, 0.7), (0.55, 0.7), (0.6, 0.7), (0.7, 0.8))
"""Pairs of probabilities from which a fall is reported: of a person in view, and of a lost one."""


@dataclass(frozen=True)
class Windows:
    """Inputs ``(N, D)``; targets ``(N, 2)``: fell and down, trunk up; weights ``(N, 2)``."""

    inputs: NDArray[np.float32]
    targets: NDArray[np.float32]
    weights: NDArray[np.float32]


def simulated(
    library: Library, eyes: Eyes, seed: int, homes: int, crowds: int, falls: float = 0.4
) -> Iterator[Track]:
    """Tracks of homes and crowds; a scene does not depend on those before it."""
    for number in tqdm(range(homes + crowds), unit="scene"):
        generator = np.random.default_rng([seed, number])
        at_home = number < homes
        scene = home(library, generator, falls) if at_home else crowd(library, generator)
        yield from tracks_of(scene, library, eyes, generator)


def window_at(
    track: Track, row: int, now: float, grid_s: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Inputs of a network at a time, of a track up to a row."""
    first = max(0, int(np.searchsorted(track.times, now - WINDOW_S)) - 1)
    shown = slice(first, row + 1)
    return window_features(track.times[shown], track.rows[shown], now, grid_s, track.watched_from)


def with_lying(tracks: Iterator[Track], seed: int) -> Iterator[Track]:
    """The same tracks, and parts of them that begin when somebody lies: nobody saw a fall there."""
    generator = np.random.default_rng(seed)
    for track in tracks:
        yield track
        begins = track.down + generator.uniform(-0.3, 3.0)
        kept = track.times >= begins
        if np.isfinite(track.falls) and kept.sum() >= LEAST_FRAMES:
            times, rows, up = track.times[kept], track.rows[kept], track.up[kept]
            yield Track(times, rows, np.inf, np.inf, up, None, True, float(times[0]))


def windows_of(
    tracks: Iterator[Track], grid_s: NDArray[np.float64], weight: float = 1.0
) -> Windows:
    """Windows of all moments of tracks, at least :data:`STEP_S` apart, and when they were lost."""
    inputs, targets, weights = [], [], []
    for track in tracks:
        moments, last = [], -np.inf
        for row, time in enumerate(track.times.tolist()):
            if time - last > STEP_S - 0.05:
                moments.append((time, row, False))
                last = time
        if track.lost_at is not None and track.alone:
            moments.append((track.lost_at, len(track.times) - 1, True))
        for now, row, lost in moments:
            fell, counts = _label(track, now, lost, float(grid_s[0]))
            if not counts and lost:
                continue
            inputs.append(window_at(track, row, now, grid_s))
            targets.append((fell, track.up[row]))
            weights.append((weight * counts, 0.0 if lost else weight))
    return Windows(*(np.array(part, np.float32) for part in (inputs, targets, weights)))


def together(parts: Sequence[Windows]) -> Windows:
    """All windows of some."""
    return Windows(
        *(np.concatenate([getattr(part, name) for part in parts])
          for name in ("inputs", "targets", "weights"))
    )  # fmt: skip


def _label(track: Track, now: float, lost: bool, memory_s: float) -> tuple[bool, float]:
    """Whether the person fell within the memory and is down, and whether it counts."""
    if now < track.falls:
        return False, 1.0
    if lost:
        return True, float(track.times[0] < track.falls)
    begun = track.watched_from < track.falls
    return True, float(begun and track.down + SHOWN_S <= now <= track.falls + memory_s)


def trained(
    windows: Windows, grid_s: NDArray[np.float64], seed: int = 0, start: FallModel | None = None
) -> FallModel:
    """Train a network, or train on the one of this number of a model."""
    import torch

    begin(seed)
    network = untrained_network(len(grid_s))
    epochs, rate = EPOCHS, RATE
    if start is not None:
        restore_weights(network, start, seed)
        epochs, rate = EPOCHS_TRAINED_ON, RATE_TRAINED_ON
    inputs = torch.from_numpy(windows.inputs).view(-1, len(grid_s), COLUMNS).transpose(1, 2)
    targets, weights = torch.from_numpy(windows.targets), torch.from_numpy(windows.weights)

    def loss_of(rows: Any) -> Any:
        given = inputs[rows] + NOISE * torch.randn_like(inputs[rows])
        losses = torch.nn.functional.binary_cross_entropy_with_logits(
            network(given), targets[rows], reduction="none"
        )
        return (losses * weights[rows]).mean()

    batches = (rows for _ in range(epochs) for rows in torch.randperm(len(inputs)).split(_BATCH))
    steps = epochs * (len(inputs) // _BATCH + 1)
    optimise(network, batches, loss_of, steps=steps, rate=rate, decay=WEIGHT_DECAY)
    return model_of(network, grid_s)


def untrained_network(points: int) -> Any:
    """An untrained network for a grid; :class:`FallModel` says what it computes."""
    from torch import nn

    first, second, third = HIDDEN
    return nn.Sequential(
        nn.Conv1d(COLUMNS, first, 3, padding=1), nn.ReLU(),
        nn.Conv1d(first, second, 3, padding=1, stride=2), nn.ReLU(),
        nn.Flatten(), nn.Dropout(DROPOUT),
        nn.Linear(second * ((points + 1) // 2), third), nn.ReLU(),
        nn.Dropout(DROPOUT), nn.Linear(third, 2),
    )  # fmt: skip


def model_of(network: Any, grid_s: NDArray[np.float64]) -> FallModel:
    """The weights of a network as :class:`FallModel` takes them."""
    layers = [layer for layer in network if hasattr(layer, "weight")]
    weights = [layer.weight.detach().numpy() for layer in layers]
    # Of convolutions (out, in, 3), and of what follows them, whose inputs are channels by points.
    matrices = [np.concatenate(list(weight.transpose(2, 1, 0))) for weight in weights[:2]]
    third, channels = weights[2], len(weights[1])
    by_point = third.reshape(len(third), channels, -1).transpose(2, 1, 0)
    matrices += [np.concatenate(list(by_point)), weights[3].T.copy()]
    offsets = (layer.bias.detach().numpy().copy() for layer in layers)
    parts = (tuple(one[None] for one in some) for some in (matrices, offsets))
    return FallModel(grid_s, *parts)


def restore_weights(network: Any, model: FallModel, number: int) -> None:
    """Give a network the weights of one of a model's: the inverse of :func:`model_of`."""
    import torch

    layers = [layer for layer in network if hasattr(layer, "weight")]
    parts = zip(layers, model.weights, model.offsets, strict=True)
    with torch.no_grad():
        for layer, weight, offset in parts:
            # What follows the convolutions sees their channels at each point.
            inputs = len(layers[1].weight) if layer is layers[2] else layer.weight.shape[1]
            by_point = weight[number].reshape(-1, inputs, weight.shape[-1]).transpose(2, 1, 0)
            layer.weight.copy_(torch.tensor(by_point.reshape(layer.weight.shape)))
            layer.bias.copy_(torch.tensor(offset[number]))


def mean_of(models: Sequence[FallModel]) -> FallModel:
    """The model that gives the mean of several models."""
    return FallModel(
        models[0].grid_s,
        tuple(np.concatenate(parts) for parts in zip(*(m.weights for m in models), strict=True)),
        tuple(np.concatenate(parts) for parts in zip(*(m.offsets for m in models), strict=True)),
    )


def half_way(before: FallModel, after: FallModel) -> FallModel:
    """The mean of the weights of a model and of the one that it was trained on to become [1]_.

    It knows the new windows, and forgets less of those before.

    References
    ----------
    .. [1] M. Wortsman et al., "Robust Fine-Tuning of Zero-Shot Models", CVPR 2022.
    """
    weights, offsets = midway(before.weights, after.weights), midway(before.offsets, after.offsets)
    return FallModel(before.grid_s, weights, offsets)


def save(model: FallModel, memory: str, file: Path) -> None:
    """Write the networks of a memory in half precision, beside those of the other."""
    kept = read_arrays(file) if file.exists() else {}
    arrays = {name: value for name, value in kept.items() if not name.startswith(memory)}
    for name, values in (("weights", model.weights), ("offsets", model.offsets)):
        for layer, value in enumerate(values):
            arrays[f"{memory}_{name}{layer}"] = value.astype(np.float16)
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    record_hash(file)


@dataclass(frozen=True)
class Record:
    """The network's probabilities along a track ``(T, 2)``, and when it is lost alone ``(2,)``."""

    track: Track
    said: NDArray[np.float64]
    lost: NDArray[np.float64] | None


def recorded(model: FallModel, tracks: Iterator[Track]) -> list[Record]:
    """The network's probabilities along tracks."""
    records = []
    for track in tracks:
        times = track.times.tolist()
        grid_s = model.grid_s
        windows = [window_at(track, row, time, grid_s) for row, time in enumerate(times)]
        lost = None
        if track.lost_at is not None and track.alone:
            last = window_at(track, len(times) - 1, track.lost_at, grid_s)
            lost = model.probabilities(last)
        records.append(Record(track, model.probabilities(np.array(windows)), lost))
    return records


def judged(records: Sequence[Record], reported_from: float, lost_from: float) -> dict[str, float]:
    """Falls that are reported from these probabilities on, how late, and false ones."""
    falls = found = alarms = 0
    seconds, delays = 0.0, []
    for record in records:
        track, reported = record.track, list[float]()
        report = FallReport(reported_from, lost_from)
        for time, (fell, up) in zip(track.times.tolist(), record.said.tolist(), strict=True):
            if report.update(time, fell, up):
                reported.append(time)
        if record.lost is not None and track.lost_at is not None:
            fell, up = record.lost.tolist()
            if report.update(track.lost_at, fell, up, lost=True):
                reported.append(track.lost_at)
        seconds += float(track.times[-1] - track.times[0])
        shown = track.times[0] < track.falls - 0.5 and track.times[-1] > track.falls
        true = [time - track.falls for time in reported if time >= track.falls]
        falls += shown
        found += shown and bool(true)
        delays += true[:1] if shown else []
        alarms += sum(time < track.falls for time in reported)
    hours = seconds / 3600
    return {
        "falls": falls, "found_percent": 100 * found / max(falls, 1),
        "delay_s": float(np.median(delays)) if delays else np.nan,
        "hours_of_people": hours, "false": alarms, "false_an_hour": alarms / hours,
    }  # fmt: skip


def write_examples(tracks: Iterator[Track], file: Path, of_each: int = 24) -> None:
    """Write some whole tracks for the tests, as many with falls as without."""
    kept: dict[bool, list[Track]] = {True: [], False: []}
    for track in tracks:
        begun = track.times[0] < track.falls - 2 and track.times[-1] > track.falls + 2
        falls = np.isfinite(track.falls)
        often = np.median(np.diff(track.times)) < 0.1
        if often and len(track.times) > 60 and (begun or not falls) and len(kept[falls]) < of_each:
            kept[falls].append(track)
    shown = [*kept[True], *kept[False]]
    np.savez_compressed(
        file,
        times=np.concatenate([track.times for track in shown]),
        rows=np.concatenate([track.rows for track in shown]).astype(np.float16),
        lengths=[len(track.times) for track in shown],
        falls=[track.falls for track in shown],
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--train", type=Path, required=True, help="rendered films")
    parser.add_argument("--held-out", type=Path, required=True, help="those of held-out clips")
    parser.add_argument("--homes", type=int, default=HOMES, help="scenes of training")
    parser.add_argument("--crowds", type=int, default=CROWDS, help="crowds of training")
    parser.add_argument("--memory", choices=[*MEMORIES], default="long", help="what to train")
    parser.add_argument(
        "--start", type=Path, help="a model to train on; the result is half-way between both"
    )
    parser.add_argument("--out", type=Path, default=FOLDER / "falls.npz")
    parser.add_argument("--examples", type=Path, help="write held-out tracks for the tests here")
    options = parser.parse_args(arguments)
    avatar = make_avatars(HELD_OUT_AVATARS[:1], None)[0]
    parts = []
    for seed, folder in enumerate((options.train, options.held_out)):
        file = folder / "motions.npz"
        if not file.exists():
            Library.made(options.shared / "mocap", avatar, seed, held_out=bool(seed)).save(file)
        parts.append((Library.load(file), Eyes.read(folder)))
    train, held = parts
    if options.examples is not None:
        write_examples(simulated(*held, 9, 1600, 0), options.examples)
        return
    grid_s = MEMORIES[options.memory]
    windows = together(
        [
            windows_of(with_lying(simulated(*train, 1, options.homes, options.crowds), 1), grid_s),
            windows_of(film_tracks(options.train), grid_s, FILM_WEIGHT),
        ]
    )
    start = None
    if options.start is not None:
        start = FallModel.of(read_arrays(options.start), options.memory)
    taught = mean_of([trained(windows, grid_s, seed, start) for seed in range(NETWORKS)])
    save(taught if start is None else half_way(start, taught), options.memory, options.out)
    model = FallModel.of(read_arrays(options.out), options.memory)
    print("windows", len(windows.inputs), "with a fall", int(windows.targets[:, 0].sum()))
    for name, tracks in (
        ("homes", simulated(*held, 2, options.homes // 4, 0)),
        ("crowds", simulated(*held, 3, 0, options.crowds // 2)),
        ("films", film_tracks(options.held_out)),
    ):
        records = recorded(model, tracks)
        for pair in THRESHOLDS:
            figures = judged(records, *pair)
            print(name, *pair, {key: round(float(value), 2) for key, value in figures.items()})
    for name, tracks in (
        ("homes", simulated(*held, 4, options.homes // 8, options.crowds // 8)),
        ("films", film_tracks(options.held_out)),
    ):
        shown = windows_of(tracks, grid_s)
        counts = shown.weights[:, 0] > 0
        stated, fell = model.probabilities(shown.inputs[counts])[:, 0], shown.targets[counts, 0] > 0
        for tenth in reliability(stated, fell, 10):
            print(name, {key: round(value, 2) for key, value in tenth.items()})
