"""Train the model of falls on simulated tracks: see ``docs/training.md``.

Needs films that ``render-films`` read, of training and of held-out clips. Motions are made once and
kept beside the films. Prints what falls and alarms come to on held-out motions, errors and scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.tracking.falls import COLUMNS, MODEL, WINDOW_S, FallModel, FallWatch, window_features
from index.build.builder import HELD_OUT_AVATARS
from index.build.garments import make_avatars
from scripts.results import ROOT
from scripts.training.fall_tracks import Eyes, Track, crowd, home, tracks_of
from scripts.training.motion_library import Library

HOMES, CROWDS = 7000, 800
"""Scenes of training."""

SHOWN_S = 0.2
"""Time on the ground from which a fall is to be recognised; before, it counts neither way."""

NEGATIVE_WEIGHT = 1.0
"""Of windows without a fall, as falls are rarer in the world than among the scenes."""

HIDDEN = (48, 16)
DROPOUT, WEIGHT_DECAY, NOISE = 0.15, 0.02, 0.03
_EPOCHS, _BATCH = 15, 512


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


def windows_of(tracks: Iterator[Track], seed: int, per_track: int = 5) -> Windows:
    """Windows of some moments of each track: any, some after a fall, and when it was lost."""
    generator = np.random.default_rng(seed)
    inputs, targets, weights = [], [], []
    for track in tracks:
        count = len(track.times)
        rows = set(generator.integers(count, size=per_track).tolist())
        after = np.flatnonzero((track.times > track.falls) & (track.times < track.falls + WINDOW_S))
        if len(after):
            rows |= set(generator.choice(after, per_track).tolist())
        moments = [(float(track.times[row]), row, False) for row in rows]
        if track.lost_at is not None and track.alone:
            moments.append((track.lost_at, count - 1, True))
        for now, row, lost in moments:
            first = max(0, int(np.searchsorted(track.times, now - WINDOW_S)) - 1)
            inputs.append(
                window_features(track.times[first : row + 1], track.rows[first : row + 1], now)
            )
            fell, counts = _label(track, now, lost)
            targets.append((fell, track.up[row]))
            weight = counts * (1.0 if fell else NEGATIVE_WEIGHT)
            weights.append((weight, 0.0 if lost else 1.0))
    return Windows(*(np.array(part, np.float32) for part in (inputs, targets, weights)))


def _label(track: Track, now: float, lost: bool) -> tuple[bool, float]:
    """Whether the person fell within the window and is down, and whether it counts."""
    if now < track.falls:
        return False, 1.0
    if now > track.falls + WINDOW_S + 1.0:
        return False, 0.0
    begun = track.times[0] < track.falls
    if lost:
        return True, float(begun)
    return True, float(begun and track.down + SHOWN_S <= now <= track.falls + WINDOW_S)


def trained(windows: Windows, seed: int = 0, drop: Sequence[int] = ()) -> FallModel:
    """Train the network; ``drop`` are columns of the inputs that it does not see."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    kept = np.ones(COLUMNS, np.float32)
    kept[list(drop)] = 0
    inputs = torch.from_numpy(windows.inputs * np.tile(kept, windows.inputs.shape[1] // COLUMNS))
    targets, weights = torch.from_numpy(windows.targets), torch.from_numpy(windows.weights)
    sizes = [inputs.shape[1], *HIDDEN, 2]
    layers: list[Any] = []
    for a, b in pairwise(sizes):
        layers += [torch.nn.Linear(a, b), torch.nn.ReLU(), torch.nn.Dropout(DROPOUT)]
    network = torch.nn.Sequential(*layers[:-2])
    optimiser = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=WEIGHT_DECAY)
    steps = _EPOCHS * (len(inputs) // _BATCH + 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 4e-3, total_steps=steps)
    loss_of = torch.nn.functional.binary_cross_entropy_with_logits
    for _ in range(_EPOCHS):
        order = torch.randperm(len(inputs))
        for rows in order.split(_BATCH):
            loss = (
                loss_of(
                    network(inputs[rows] + NOISE * torch.randn(len(rows), sizes[0])),
                    targets[rows],
                    reduction="none",
                )
                * weights[rows]
            ).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    matrices = [layer.weight.detach().numpy().T.copy() for layer in linear]
    matrices[0] *= np.tile(kept, len(matrices[0]) // COLUMNS)[:, None]
    return FallModel(tuple(matrices), tuple(layer.bias.detach().numpy().copy() for layer in linear))


def save(model: FallModel, file: Path) -> None:
    """Write a model in half precision."""
    arrays = {
        f"{name}{layer}": value.astype(np.float16)
        for name, values in (("weights", model.weights), ("offsets", model.offsets))
        for layer, value in enumerate(values)
    }
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def judged(model: FallModel, tracks: Iterator[Track]) -> dict[str, float]:
    """Falls that are reported, how late, and alarms, of tracks that are watched whole."""
    falls = found = alarms = 0
    seconds, delays = 0.0, []
    for track in tracks:
        watch, reported = FallWatch(model), []
        for time, row in zip(track.times, track.rows, strict=True):
            watch.add(float(time), row)
            if watch.decide(float(time)):
                reported.append(float(time))
        if track.lost_at is not None and track.alone and watch.lost(track.lost_at):
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
        "hours_of_people": hours, "alarms": alarms,
    }  # fmt: skip


def reliability(model: FallModel, windows: Windows) -> list[tuple[float, float, int]]:
    """Stated and true shares of falls by tenths of the probability, with the number of windows."""
    counts = windows.weights[:, 0] > 0
    stated, true = model.probabilities(windows.inputs[counts])[:, 0], windows.targets[counts, 0]
    bins = np.minimum((10 * stated).astype(int), 9)
    return [(float(stated[bins == b].mean()), float(true[bins == b].mean()), int((bins == b).sum()))
            for b in range(10) if (bins == b).any()]  # fmt: skip


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
    parser.add_argument("--out", type=Path, default=MODEL)
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
        write_examples(simulated(*held, 9, 400, 0), options.examples)
        return
    windows = windows_of(simulated(*train, 1, options.homes, options.crowds), 1)
    model = trained(windows)
    save(model, options.out)
    model = FallModel.load(options.out)
    print("windows", len(windows.inputs), "with a fall", int(windows.targets[:, 0].sum()))
    print("homes", judged(model, simulated(*held, 2, options.homes // 4, 0)))
    print("crowds", judged(model, simulated(*held, 3, 0, options.crowds)))
    for stated, true, count in reliability(
        model, windows_of(simulated(*held, 4, options.homes // 4, options.crowds // 8), 4)
    ):
        print(f"said {stated:.2f}, fell {true:.2f} of {count}")
