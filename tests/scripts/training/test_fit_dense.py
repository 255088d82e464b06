"""Small networks: averages, scaled and moved outputs; training is the same for the same seed."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from app.networks.dense import DenseNetwork
from scripts.training.fit_dense import fit_dense


def network(seed: int, hidden: int) -> DenseNetwork:
    generator = np.random.default_rng(seed)
    sizes = (4, hidden, 2)
    return DenseNetwork(
        np.ones(4, np.float32),
        np.full(4, 2.0, np.float32),
        tuple(generator.normal(size=sizes[k : k + 2]).astype(np.float32) for k in (0, 1)),
        tuple(generator.normal(size=sizes[k + 1]).astype(np.float32) for k in (0, 1)),
    )


FEATURES = np.random.default_rng(9).normal(size=(10, 4))


@pytest.mark.slow
def test_training_fits_and_repeats_itself() -> None:
    torch = pytest.importorskip("torch")
    generator = np.random.default_rng(0)
    features = generator.normal(size=(600, 4))
    truth = np.stack([features[:, 0] * features[:, 1], features[:, 2]], axis=1)

    def loss(outputs: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        return ((outputs - targets) ** 2).mean()

    one, other = (
        fit_dense(features, truth, 2, loss, hidden=(32,), epochs=60, seed=3, batch=32, rate=5e-3,
                  dropout=0.0, noise=0.0)
        for _ in range(2)
    )  # fmt: skip
    assert_array_equal(one(features), other(features))
    assert ((one(features) - truth) ** 2).mean() < 0.1 * truth.var()


@pytest.mark.slow
def test_training_goes_on_from_a_network() -> None:
    torch = pytest.importorskip("torch")
    first = network(4, 6)

    def loss(outputs: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        return ((outputs - targets) ** 2).mean()

    on = fit_dense(
        FEATURES, first(FEATURES), 2, loss, hidden=(6,), epochs=2, seed=1, batch=5, dropout=0.0,
        noise=0.0, decay=0.0, initial=first,
    )  # fmt: skip
    assert_allclose(on(FEATURES), first(FEATURES), atol=0.02)
