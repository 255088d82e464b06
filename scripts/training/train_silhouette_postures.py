"""Train the network that reads postures from silhouettes: see ``docs/training.md``.

Writes ``postures.npz`` beside the index. It learns from silhouettes of the index and of poses that
hardly any clip shows; the clips of ``python -m scripts evaluate simulation`` are left out of both.
The weight of the votes is fitted on answers of the index without the subject who is asked for, of a
network that does not know this subject either; these answers are reported as well.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import nn

from app.estimation.posture import LANDMARK_GROUPS
from app.networks.probabilities import softmax
from app.vision.judgement import FRAME_POSTURES
from index import DEFAULT_PATH
from index.artefact import load_index
from index.network import (
    INPUTS,
    MIN_VOTE,
    QUANT_MAX,
    UNITS,
    Array,
    JointNetwork,
    Layer,
    PostureNetwork,
    posture_inputs,
    quantised_relu,
)
from index.posture import SILHOUETTE_GROUPS, classify_postures
from index.skeleton import BODY_UP, POINTS
from index.store import SKELETON_DTYPE, PoseIndex
from scripts.index.body import Avatar, Retargeting, pose_transforms, retarget
from scripts.index.builder import INDEX_AVATARS, hold_out
from scripts.index.calibrate import Queries, run_trial
from scripts.index.garments import make_avatars
from scripts.index.motion import Segment, read_manifest
from scripts.index.poses import joints_of, read_poses
from scripts.index.simulate import Simulation
from scripts.index.views import PosedBodies, RenderedBodies, render_bodies
from scripts.index.writer import compress, save_postures
from scripts.metrics import percent
from scripts.results import SHARED
from scripts.training.held_out import part
from scripts.training.loop import begin, optimise
from scripts.training.render.pose import Pose
from scripts.training.render.posing import PoseSource, classes_of

PRIOR = np.array([0.5, 0.07, 0.07, 0.05, 0.12, 0.05, 0.14])
"""Assumed shares of ``SILHOUETTE_GROUPS`` among people."""

MADE = {"standing": 600, "bending": 1500, "crouching": 3600, "sitting": 1800, "all_fours": 1300,
        "lying": 1200}  # fmt: skip
"""Poses to make of each of :data:`FRAME_POSTURES`; others, by their joints, are left out."""

_MADE_SHARE, _MADE_UPRIGHT_SHARE = 0.5, 0.15
"""Shares of made poses in what is learned of a kind."""

_INDEX_SHARES = {"upright": 0.12, "lying": 0.15}
"""Shares of the entries of a kind that are learned; of others, seven in ten."""

_VIEWS, _FOLDS, _ASKED, _SEED = 2, 4, 400, 41
"""Views of a made pose; parts of the subjects; entries of each kind asked for; seed of all."""

_STEPS, _BATCH, _RATE, _DECAY, _DROPOUT, _NOISE = 1200, 512, 2e-3, 0.05, 0.3, 0.05
_INPUT_SCALE = 40.0


@dataclass(frozen=True)
class Examples:
    """Inputs of the network from silhouettes, and the postures that these show."""

    inputs: NDArray[np.uint8]  # (N, 514)
    kinds: NDArray[np.int64]  # (N,): positions in ``SILHOUETTE_GROUPS``
    subjects: NDArray[np.str_]  # (N,)
    made: NDArray[np.bool_]  # (N,)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All of them."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def take(self, rows: NDArray[np.bool_]) -> Self:
        """Some of them."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weight of each ``(N,)``: kinds by the prior, and made poses by their share."""
        weights = np.zeros(len(self.kinds))
        for kind, prior in enumerate(PRIOR):
            share = _MADE_UPRIGHT_SHARE if kind == 0 else _MADE_SHARE
            for rows, part_share in ((self.made, share), (~self.made, 1 - share)):
                chosen = rows & (self.kinds == kind)
                weights[chosen] = prior * part_share / max(chosen.sum(), 1)
        return weights / weights.sum()


def examples_of(
    network: JointNetwork,
    queries: Queries,
    kinds: NDArray[np.int64],
    subjects: NDArray[np.str_],
    *,
    made: bool,
) -> Examples:
    """Inputs from the joint network for silhouettes; a wide one may have its head at either end."""
    turned = np.random.default_rng(_SEED).random(len(queries)) < 0.5
    turned &= queries.roll_deg != 0
    hidden = np.empty((len(queries), INPUTS - 2), np.float32)
    for row, silhouette in enumerate(queries.silhouettes):
        shown = silhouette[::-1, ::-1] if turned[row] else silhouette
        hidden[row] = network.read(shown).hidden
    inputs = posture_inputs(hidden, queries.roll_deg).astype(np.uint8)
    return Examples(inputs, kinds, subjects, np.full(len(kinds), made))


def recorded(index: PoseIndex, rows: NDArray[np.int64]) -> Queries:
    """Silhouettes of entries, every second one degraded."""
    simulation = Simulation(
        index.silhouette_store.select(rows), index.entries[rows], index.skeletons,
        index.skeleton_labels, index.clips, index.subjects, index.actions,
    )  # fmt: skip
    return Queries.of(simulation).half_degraded(_SEED)


def made_poses(
    shared: Path, segments: Sequence[Segment]
) -> tuple[Queries, NDArray[np.int64], NDArray[np.str_]]:
    """Silhouettes of made poses, every second one degraded, their kinds, and the clips used."""
    poses, _ = read_poses(shared / "mocap", segments)
    poses = poses.take(np.arange(len(poses))[::3])
    avatars = make_avatars(INDEX_AVATARS, shared / "garments")
    source = PoseSource(poses, classes_of(joints_of(poses, avatars[0])))
    generator = np.random.default_rng(_SEED)
    names = [name for name, count in MADE.items() for _ in range(count)]
    drawn = [source.draw(name, generator) for name in names]
    of_avatar = generator.integers(len(avatars), size=len(drawn))
    rendered = [
        _rendered(avatar, drawn, np.flatnonzero(of_avatar == number))
        for number, avatar in enumerate(avatars)
    ]
    order = np.argsort(np.argsort(of_avatar, kind="stable"), kind="stable")
    bits, entries, skeletons = (np.concatenate(part)[order] for part in zip(*rendered, strict=True))
    postures = classify_postures(skeletons, BODY_UP)
    seated = np.array([pose.support != "ground" for pose in drawn])
    kinds = np.where(
        seated, SILHOUETTE_GROUPS.names.index("sitting"), SILHOUETTE_GROUPS.of[postures]
    )
    asked = np.array([FRAME_POSTURES.index(name) for name in names])
    wanted = np.zeros((len(LANDMARK_GROUPS), len(SILHOUETTE_GROUPS)), bool)
    wanted[LANDMARK_GROUPS.of, SILHOUETTE_GROUPS.of] = True
    right = np.repeat(wanted[asked, kinds], _VIEWS)
    simulation = Simulation(
        compress(bits.reshape(-1, bits.shape[-1])), entries.ravel(),
        skeletons.reshape(-1, POINTS, 3), np.zeros(len(drawn), SKELETON_DTYPE), (), (), (),
    ).take(right)  # fmt: skip
    clips = np.repeat(np.array([pose.clip.name for pose in drawn]), _VIEWS)[right]
    return Queries.of(simulation).half_degraded(_SEED), np.repeat(kinds, _VIEWS)[right], clips


def _rendered(avatar: Avatar, poses: Sequence[Pose], rows: NDArray[np.int64]) -> RenderedBodies:
    """Render some of the poses on an avatar."""
    retargeted: dict[str, Retargeting] = {}
    transforms = []
    for row in rows:
        clip = poses[row].clip
        if clip.name not in retargeted:
            retargeted[clip.name] = retarget(clip, avatar)
        posed = pose_transforms(avatar, retargeted[clip.name], poses[row].rotations[None])
        transforms.append(posed[0])
    bodies = PosedBodies(rows, np.stack(transforms), np.zeros(len(rows), bool))
    return render_bodies(avatar, bodies, _VIEWS, _SEED)


def train(examples: Examples) -> PostureNetwork:
    """Train the network without votes; the same one for the same examples."""
    begin(_SEED)
    layers = nn.Sequential(
        nn.Dropout(_DROPOUT), nn.Linear(INPUTS, UNITS), nn.ReLU(), nn.Dropout(_DROPOUT),
        nn.Linear(UNITS, len(SILHOUETTE_GROUPS)),
    )  # fmt: skip
    generator, chances = np.random.default_rng(_SEED), examples.weights
    batches = (generator.choice(len(chances), _BATCH, p=chances) for _ in range(_STEPS))

    def loss_of(rows: NDArray[np.int64]) -> torch.Tensor:
        seen = torch.from_numpy(examples.inputs[rows].astype(np.float32) / _INPUT_SCALE)
        seen = seen + _NOISE * torch.randn(seen.shape)
        return nn.functional.cross_entropy(layers(seen), torch.from_numpy(examples.kinds[rows]))

    optimise(layers, batches, loss_of, steps=_STEPS, rate=_RATE, decay=_DECAY)
    (first, first_bias), (last, last_bias) = (
        (one.weight.detach().numpy().T, one.bias.detach().numpy())
        for one in layers
        if isinstance(one, nn.Linear)
    )
    weights, scale = _whole(first / _INPUT_SCALE)
    sums = Layer(weights, scale, first_bias)
    step = np.float32(sums(examples.inputs[:2000].astype(np.float32)).max() / QUANT_MAX)
    between = Layer(weights, scale / step, first_bias / step)
    weights, scale = _whole(last)
    return PostureNetwork((between, Layer(weights, scale * step, last_bias)), 0.0)


def _whole(weights: Array) -> tuple[Array, Array]:
    """Weights ``(F, D)`` as whole numbers, and the factors ``(D,)`` that give them again."""
    scale = np.abs(weights).max(axis=0) / np.float32(QUANT_MAX)
    return np.rint(weights / scale), scale


def logits_of(network: PostureNetwork, inputs: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Logits ``(N, 7)`` without votes."""
    between, output = network.layers
    return output(quantised_relu(between(inputs.astype(np.float32)))).astype(np.float64)


def fit_votes(
    logits: NDArray[np.float64], votes: NDArray[np.float64], kinds: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Weights of logits and of log votes ``(N, 7)``, and offsets of the kinds: ``(9,)``.

    A conditional logit; kinds weigh as in the prior.
    """
    features = np.stack([logits, np.log(votes + MIN_VOTE)], axis=-1)
    weights = (PRIOR / np.maximum(np.bincount(kinds, minlength=len(SILHOUETTE_GROUPS)), 1))[kinds]
    weights /= weights.sum()
    every = np.arange(len(kinds))

    def loss(found: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        scores = features @ found[:2] + found[2:]
        scores -= scores.max(axis=1, keepdims=True)
        shares = np.exp(scores)
        shares /= shares.sum(axis=1, keepdims=True)
        value = -weights @ np.log(shares[every, kinds]) + 1e-3 * found @ found
        shares[every, kinds] -= 1
        apart = weights[:, None] * shares
        slopes = np.concatenate([np.einsum("nk,nkf->f", apart, features), apart.sum(axis=0)])
        return float(value), slopes + 2e-3 * found

    start = np.zeros(2 + len(SILHOUETTE_GROUPS))
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B").x)


def with_votes(network: PostureNetwork, fitted: NDArray[np.float64]) -> PostureNetwork:
    """The network with what :func:`fit_votes` returns."""
    between, output = network.layers
    last = Layer(
        output.weights,
        np.asarray(output.factors * fitted[0], np.float32),
        np.asarray(output.offsets * fitted[0] + fitted[2:], np.float32),
    )
    return PostureNetwork((between, last), float(fitted[1]))


def report(name: str, shares: NDArray[np.float64], kinds: NDArray[np.int64]) -> str:
    """How often kinds are right by shares ``(N, 7)``, each weighing as in the prior."""
    best, sure = shares.argmax(axis=1), shares.max(axis=1) >= 0.5
    each = [percent((best == kinds)[kinds == kind]) for kind in range(len(SILHOUETTE_GROUPS))]
    wrong = [
        percent(((best != kinds) & sure)[kinds == kind]) for kind in range(len(SILHOUETTE_GROUPS))
    ]
    shown = zip(SILHOUETTE_GROUPS.names, each, strict=True)
    named = ", ".join(f"{name} {value:.0f}" for name, value in shown)
    return (
        f"{name}: right {PRIOR @ each:.1f} % (mean {np.mean(each):.1f}), surely wrong "
        f"{PRIOR @ wrong:.1f} %; {named}"
    )


def folds_of(subjects: NDArray[np.str_]) -> dict[str, int]:
    """Part of each subject; parts have about as many examples."""
    names, counts = np.unique(subjects, return_counts=True)
    sizes, folds = np.zeros(_FOLDS), {}
    for row in np.argsort(-counts, kind="stable"):
        folds[str(names[row])] = fold = int(sizes.argmin())
        sizes[fold] += counts[row]
    return folds


def train_postures(index: PoseIndex, shared: Path) -> PostureNetwork:
    """Train the network, and print what it does for subjects whom it does not know."""
    if index.reranker is None:
        raise ValueError("expected an index with a network: `make reranker`")
    network = index.reranker.network
    segments, _ = hold_out(read_manifest(shared / "mocap"))
    subject_of = {segment.clip: segment.subject for segment in segments}
    labels = index.skeleton_labels
    kind_of = SILHOUETTE_GROUPS.of[classify_postures(index.skeletons, BODY_UP, labels["speed"])]
    subjects = np.array([subject_of.get(clip, "") for clip in index.clips])[labels["clip"]]
    known = np.flatnonzero((subjects != "")[index.entries["skeleton"]])
    skeletons = index.entries["skeleton"][known]
    generator = np.random.default_rng(_SEED)
    shares = np.array([_INDEX_SHARES.get(name, 0.7) for name in SILHOUETTE_GROUPS.names])
    chosen = generator.random(len(known)) < shares[kind_of[skeletons]]
    rows, skeletons = known[chosen], skeletons[chosen]
    shown = recorded(index, rows)
    learned = examples_of(network, shown, kind_of[skeletons], subjects[skeletons], made=False)
    queries, kinds, clips = made_poses(shared, segments)
    of_clips = np.array([subject_of[clip] for clip in clips])
    made = examples_of(network, queries, kinds, of_clips, made=True)
    examples = Examples.joined([learned, made])
    folds = folds_of(learned.subjects)
    fold = np.array([folds.get(str(subject), -1) for subject in examples.subjects])
    asked = np.concatenate([
        generator.permutation(np.flatnonzero(learned.kinds == kind))[:_ASKED]
        for kind in range(len(SILHOUETTE_GROUPS))
    ])  # fmt: skip
    votes, logits = (np.zeros((len(asked), len(SILHOUETTE_GROUPS))) for _ in range(2))
    fold_of_entry = np.array([folds.get(str(s), -1) for s in subjects])[index.entries["skeleton"]]
    for number in range(_FOLDS):
        own = np.flatnonzero(fold[asked] == number)
        others = known[fold_of_entry[known] != number]
        voted = run_trial(part(index, others), shown.take(asked[own])).votes
        votes[own] = SILHOUETTE_GROUPS.sums(voted)
        unknowing = train(examples.take(fold != number))
        logits[own] = logits_of(unknowing, learned.inputs[asked[own]])
    true = learned.kinds[asked]
    fitted = fit_votes(logits, votes, true)
    scores = fitted[0] * logits + fitted[1] * np.log(votes + MIN_VOTE) + fitted[2:]
    print(f"{len(examples.kinds)} silhouettes; weights of logits and votes {fitted[:2].round(2)}")
    print(report("votes alone", votes, true))
    print(report("network and votes", softmax(scores), true))
    return with_votes(train(examples), fitted)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    options = parser.parse_args(arguments)
    save_postures(train_postures(load_index(options.index), options.shared), options.index)
    print(f"Written to {options.index}")
