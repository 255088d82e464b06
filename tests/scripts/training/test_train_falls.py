"""Networks of falls: torch's and NumPy's agree, and training may go on from either."""

import numpy as np
import pytest

from app.tracking.falls import COLUMNS, MEMORIES, FallModel
from scripts.training.train_falls import (
    Windows,
    mean_of,
    model_of,
    restore_weights,
    trained,
    untrained_network,
)

pytest.importorskip("torch")
pytestmark = pytest.mark.slow

GRID_S = MEMORIES["long"]


def windows(count: int = 64) -> Windows:
    generator = np.random.default_rng(3)
    return Windows(
        generator.normal(size=(count, len(GRID_S) * COLUMNS)).astype(np.float32),
        (generator.random((count, 2)) < 0.5).astype(np.float32),
        np.ones((count, 2), np.float32),
    )


@pytest.fixture(scope="module")
def model() -> FallModel:
    return mean_of([trained(windows(), GRID_S, seed) for seed in range(2)])


def test_numpy_computes_what_torch_does(model: FallModel) -> None:
    import torch

    network, given = untrained_network(len(GRID_S)).eval(), windows().inputs
    restore_weights(network, model, 1)
    one = model_of(network, GRID_S)
    for stored, restored in zip((*model.weights, *model.offsets), (*one.weights, *one.offsets),
                                strict=True):  # fmt: skip
        np.testing.assert_array_equal(stored[1:], restored)
    with torch.no_grad():
        shaped = torch.from_numpy(given).view(-1, len(GRID_S), COLUMNS).transpose(1, 2)
        expected = torch.sigmoid(network(shaped)).numpy()
    np.testing.assert_allclose(one.probabilities(given), expected, atol=1e-5)


def test_training_goes_on_from_a_model(model: FallModel) -> None:
    on = trained(windows(), GRID_S, 1, start=model)
    near = max(np.abs(a[0] - b[1]).max() for a, b in zip(on.weights, model.weights, strict=True))
    assert 0 < near < 0.05
