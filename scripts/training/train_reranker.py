"""Train the re-ranking network of an index: ``make reranker``.

It is written into the folder of the index, whose own files stay as they are. The held-out clips are
kept from it, so that ``evaluate simulation`` measures the network that ships. Training takes about
an hour on one core.
"""

from __future__ import annotations

import argparse
import copy
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from descriptor.silhouette import HEIGHT, WIDTH
from index import DEFAULT_PATH
from index.artefact import load_index
from index.confidence import RERANKING_FEATURES
from index.network import (
    AXES,
    CONVOLUTIONS,
    EXACT_BELOW,
    HIDDEN,
    JOINT_BINS,
    QUANT_MAX,
    JointNetwork,
    Layer,
    RankingModel,
    bin_positions,
    input_planes,
    largest_sums,
    layer_input,
    network_input,
    quantise,
    quantised_relu,
)
from index.skeleton import JOINTS, POINTS, exchange_sides
from index.store import PoseIndex
from scripts.index.builder import (
    CALIBRATION_AVATARS,
    NOT_HELD_OUT,
    IndexSpec,
    entries_of,
    hold_out,
    simulate_queries,
    split,
)
from scripts.index.calibrate import Queries, calibrate
from scripts.index.garments import make_avatars
from scripts.index.motion import read_manifest
from scripts.index.noise import degrade
from scripts.index.views import MAX_OWN_ROLL_DEG
from scripts.index.writer import save_reranker
from scripts.results import SHARED
from scripts.training.held_out import part
from scripts.training.loop import begin, optimise

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainingConfig:
    """Hyperparameters of the training."""

    passes: float = 20.0  # epochs over the silhouettes, including degraded ones
    batch: int = 128  # silhouettes per step
    # Highest learning rate; it rises over the first twentieth, then falls to nothing.
    rate: float = 2e-3
    decay: float = 0.02  # weight decay
    seed: int = 20161


# Passes over all silhouettes, as a share of those without the clips kept for the confidence.
_FINISHING_SHARE = 0.2


def train_reranker(index: PoseIndex, spec: IndexSpec, config: TrainingConfig) -> RankingModel:
    """Train the network on an index's silhouettes and fit the confidence of what it re-ranks.

    At first the network does not see some clips; the confidence is fitted on what the index,
    without their entries, answers to silhouettes of these clips on bodies of their own. Then the
    network learns from them as well, as the index has their entries.

    Parameters
    ----------
    spec : IndexSpec
        What the index was built from. Its ``segments`` may be used: an experiment leaves out those
        that it asks for. The confidence is fitted on ``plan.calibration`` silhouettes.

    Raises
    ------
    ValueError
        If the index has no entry of the segments.
    """
    segments = read_manifest(spec.motion) if spec.segments is None else spec.segments
    kept, held, by_clip = split(segments)
    if not by_clip:
        log.info(NOT_HELD_OUT)
    rows = entries_of(index, kept)
    if not len(rows):
        raise ValueError("expected an index with entries of the given motion, got none")
    log.info(f"Training on {len(rows):,} of {len(index):,} silhouettes of {index.name}.")
    layers = train(index, rows, config)
    network = _whole(layers, index, rows)
    simulated = simulate_queries(
        spec.motion,
        held,
        make_avatars(CALIBRATION_AVATARS, spec.garments),
        spec.plan.calibration,
        config.seed + 1,
    )
    queries = Queries.of(simulated).half_degraded(config.seed + 1)
    reranker = calibrated(part(index, rows), network, queries)
    everything = entries_of(index, segments)
    log.info(f"Going on with {len(everything):,} silhouettes.")
    finish = replace(config, passes=_FINISHING_SHARE * config.passes, rate=config.rate / 2)
    layers = train(index, everything, finish, start=layers)
    training: dict[str, Any] = {
        "index": index.version,
        "entries": len(everything),
        "clips": sorted({segment.clip for segment in segments}),
        "passes": config.passes,
        "seed": config.seed,
        "confidence_fitted_on": len(queries),
        "of_clips_held_out": by_clip,
    }
    return replace(reranker, network=_whole(layers, index, everything), training=training)


# Silhouettes that show how large values become within the network.
_SCALE_SAMPLE = 400


def _whole(layers: nn.Sequential, index: PoseIndex, rows: NDArray[np.int64]) -> JointNetwork:
    """The trained network in whole numbers, scaled to the values of some of the entries."""
    some = rows[:: max(1, len(rows) // _SCALE_SAMPLE)]
    return in_whole_numbers(layers, network_input(index.silhouettes(some)))


def calibrated(index: PoseIndex, network: JointNetwork, queries: Queries) -> RankingModel:
    """A network with the confidence that is fitted to its ranking of an index's answers."""
    asked = replace(index, reranker=RankingModel.of(network))
    calibration = calibrate(asked, queries, RERANKING_FEATURES)
    return RankingModel(network, calibration)


_LOG_EVERY = 500  # Steps.


def train(
    index: PoseIndex,
    rows: NDArray[np.integer],
    config: TrainingConfig,
    *,
    start: nn.Sequential | None = None,
) -> nn.Sequential:
    """Train on entries ``(R,)`` of an index, their mirror images and degraded versions.

    It starts from a trained network, or from random weights; the result is for
    :func:`in_whole_numbers`.
    """
    begin(config.seed)
    generator = np.random.default_rng(config.seed)
    examples = Examples.of(index, rows, generator)
    layers = _layers() if start is None else copy.deepcopy(start)
    layers = layers.to(memory_format=torch.channels_last)
    steps = max(1, round(config.passes * len(examples) / config.batch))

    def batches() -> Iterator[NDArray[np.int64]]:
        order = np.empty(0, np.int64)
        for _ in range(steps):
            if len(order) < config.batch:
                order = np.concatenate([order, generator.permutation(len(examples))])
            batch, order = order[: config.batch], order[config.batch :]
            yield batch

    def loss_of(batch: NDArray[np.int64]) -> torch.Tensor:
        planes, truth = examples.take(batch, generator)
        # 32 bits take 1.5 times as long, but so would 16 if the processor had to emulate them.
        with torch.autocast("cpu", torch.bfloat16, torch.cpu._is_avx512_bf16_supported()):
            logits = layers(_channels_first(planes))
        return _loss(logits.float(), torch.from_numpy(truth))

    def each(step: int, loss: float) -> None:
        if step % _LOG_EVERY == 0 or step == steps:
            log.info(f"step {step:,} of {steps:,}: loss {loss:.4f}")

    optimise(
        layers, batches(), loss_of, steps=steps, rate=config.rate, decay=config.decay, rise=0.05,
        most=2.0, each=each,
    )  # fmt: skip
    return layers


_BLOCK = 4096

# Share of the silhouettes that are also shown degraded.
_DEGRADED_SHARE = 0.5

# Share of the silhouettes whose border pixels are flipped at random, and the largest share of the
# border pixels that are flipped.
_FLIPPED_SHARE, _MAX_FLIPS = 0.25, 0.2


@dataclass(frozen=True)
class Examples:
    """Training examples."""

    bits: NDArray[np.uint8]  # (N, 192): silhouettes at half the resolution, bit-packed
    # (N, 24, 3): column and row in pixels of the normalised frame, and depth in metres.
    points: NDArray[np.float16]
    stood_up: NDArray[np.bool_]  # (N,): silhouettes that were wider than high and rotated upright

    def __len__(self) -> int:
        return len(self.bits)

    @classmethod
    def of(
        cls, index: PoseIndex, rows: NDArray[np.integer], generator: np.random.Generator
    ) -> Examples:
        """Examples of some entries of an index, and of a degraded share of them."""
        worse = generator.random(len(rows)) < _DEGRADED_SHARE
        numbers = np.concatenate([rows, rows[worse]])
        degraded = np.arange(len(numbers)) >= len(rows)
        bits = np.empty((len(numbers), HEIGHT * WIDTH // 32), np.uint8)
        points = np.empty((len(numbers), POINTS, 3), np.float16)
        for start in range(0, len(numbers), _BLOCK):
            block = slice(start, start + _BLOCK)
            silhouettes = index.silhouettes(numbers[block])
            points_3d, points_2d = index.points(numbers[block])
            for row in np.flatnonzero(degraded[block]):
                joints = points_2d[row, :JOINTS]
                silhouettes[row], placement = degrade(silhouettes[row], joints, generator)
                points_2d[row] = placement.to_normalised(points_2d[row])
            pictures = network_input(silhouettes)[..., 0].astype(np.uint8)
            bits[block] = np.packbits(pictures.reshape(len(pictures), -1), axis=1)
            points[block, :, :2], points[block, :, 2] = points_2d, points_3d[..., 2]
        rolls_deg = np.abs(index.entries["roll_deg"][numbers])
        return cls(bits, points, rolls_deg > MAX_OWN_ROLL_DEG)

    def take(
        self, rows: NDArray[np.integer], generator: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Augmented network inputs of some examples, and the positions of their joints.

        Each is mirrored at random. Those rotated upright are also turned upside down at random,
        since a silhouette alone does not show at which end the head is.

        Returns
        -------
        planes : (B, 64, 24, 3) float32 array
        truth : (B, 19, 3) float32 array
            Fractional bins of columns, rows and depths.
        """
        pictures = np.unpackbits(self.bits[rows], axis=1).reshape(-1, HEIGHT // 2, WIDTH // 2)
        points = self.points[rows].astype(np.float64)
        mirrored = generator.random(len(rows)) < 0.5
        pictures[mirrored] = pictures[mirrored, :, ::-1]
        points[mirrored] = exchange_sides(points[mirrored])
        points[mirrored, :, 0] = WIDTH - 1 - points[mirrored, :, 0]
        turned = self.stood_up[rows] & (generator.random(len(rows)) < 0.5)
        pictures[turned] = pictures[turned, ::-1, ::-1]
        points[turned, :, :2] = (WIDTH - 1, HEIGHT - 1) - points[turned, :, :2]
        noisy = generator.random(len(rows)) < _FLIPPED_SHARE
        pictures[noisy] = _flipped(pictures[noisy], generator)
        return input_planes(pictures), bin_positions(points[:, :JOINTS])


def _flipped(pictures: NDArray[np.uint8], generator: np.random.Generator) -> NDArray[np.uint8]:
    """Pictures ``(B, H, W)`` with some pixels beside the outline flipped."""
    around = np.pad(pictures, ((0, 0), (1, 1), (1, 1)))
    shifted = [
        around[:, 1 + y : 1 + y + pictures.shape[1], 1 + x : 1 + x + pictures.shape[2]]
        for y, x in ((-1, 0), (1, 0), (0, -1), (0, 1))
    ]
    border = np.any([neighbour != pictures for neighbour in shifted], axis=0)
    share = _MAX_FLIPS * generator.random((len(pictures), 1, 1))
    flips = border & (generator.random(pictures.shape, np.float32) < share)
    return np.where(flips, 1 - pictures, pictures)


def _layers() -> nn.Sequential:
    """The network, with a normalisation after each convolution that its export takes up."""
    layers: list[nn.Module] = []
    channels, rows, columns = 3, HEIGHT // 2, WIDTH // 2
    for size, stride, features in CONVOLUTIONS:
        layers += [
            nn.Conv2d(channels, features, size, stride, size // 2, bias=False),
            nn.BatchNorm2d(features),
            nn.ReLU(),
        ]
        channels, rows, columns = features, -(-rows // stride), -(-columns // stride)
    layers += [
        nn.Flatten(),
        nn.Linear(channels * rows * columns, HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, JOINTS * JOINT_BINS),
    ]
    return nn.Sequential(*layers)


def _channels_first(planes: NDArray[np.float32]) -> torch.Tensor:
    return torch.from_numpy(planes).permute(0, 3, 1, 2)


def _loss(logits: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Mean cross-entropy with targets softened by a bin, over joints and axes."""
    loss = torch.zeros(())
    parts = logits.reshape(len(logits), JOINTS, JOINT_BINS).split(
        [axis.bins for axis in AXES], dim=-1
    )
    for position, scores in enumerate(parts):
        apart = torch.arange(scores.shape[-1]) - truth[..., position, None]
        target = torch.softmax(-(apart**2) / 2, dim=-1)
        loss = loss - (target * scores.log_softmax(dim=-1)).sum(dim=-1).mean()
    return loss / len(AXES)


def in_whole_numbers(layers: nn.Sequential, planes: NDArray[np.float32]) -> JointNetwork:
    """The network as it is run: normalisations taken up, channels last, in whole numbers.

    Sample input ``(B, 64, 24, 3)`` shows how large the values between the trained layers become.
    """
    weighted = _weights_and_biases(layers)
    values, step = [quantise(picture) for picture in planes], 1 / QUANT_MAX
    found = []
    for number, (weights, bias) in enumerate(weighted):
        scale = np.abs(weights).max(axis=0) / QUANT_MAX + 1e-12
        # A little coarser where sums might not be exact; rounding adds to them.
        scale *= np.maximum(1, largest_sums(weights / scale) / (0.98 * EXACT_BELOW))
        whole = np.rint(weights / scale).astype(np.float32)
        if number == len(weighted) - 1:
            found.append(Layer(whole, _array(scale * step), bias))
            break
        sums = Layer(whole, _array(scale * step), bias)
        inputs = [layer_input(number, picture) for picture in values]
        next_step = max(float(sums(one).max()) for one in inputs) / QUANT_MAX + 1e-12
        found.append(Layer(whole, _array(scale * step / next_step), _array(bias / next_step)))
        values, step = [quantised_relu(found[-1](one)) for one in inputs], next_step
    return JointNetwork(tuple(found))


def _weights_and_biases(
    layers: nn.Sequential,
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Of each layer, inputs first and outputs last."""
    modules, found = list(layers), []
    for convolution, norm in pairwise(modules):
        if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
            assert norm.running_mean is not None and norm.running_var is not None
            scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            kernel = convolution.weight * scale[:, None, None, None]
            bias = norm.bias - norm.running_mean * scale
            found.append((_numpy(kernel.permute(2, 3, 1, 0).flatten(0, 2)), _numpy(bias)))
    hidden, output = (module for module in modules if isinstance(module, nn.Linear))
    # From channel, place to place, channel.
    weights = hidden.weight.reshape(HIDDEN, CONVOLUTIONS[-1][-1], -1).permute(2, 1, 0)
    found.append((_numpy(weights.flatten(0, 1)), _numpy(hidden.bias)))
    found.append((_numpy(output.weight.T), _numpy(output.bias)))
    return found


def _numpy(tensor: torch.Tensor) -> NDArray[np.float32]:
    return np.ascontiguousarray(tensor.detach().numpy(), np.float32)


def _array(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--mocap", type=Path, default=SHARED / "mocap", help="what the index was built from")
    add("--garments", type=Path, help="MakeHuman garments; without them bodies are unclothed")
    add("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    add("--passes", type=float, default=TrainingConfig.passes, help="over the silhouettes")
    add("--seed", type=int, default=TrainingConfig.seed)
    options = parser.parse_args(arguments)
    kept, _ = hold_out(read_manifest(options.mocap))
    reranker = train_reranker(
        load_index(options.index, reranked=False),
        IndexSpec("", options.mocap, options.garments, segments=tuple(kept)),
        TrainingConfig(passes=options.passes, seed=options.seed),
    )
    save_reranker(reranker, options.index)
    print(f"Written to {options.index}")
