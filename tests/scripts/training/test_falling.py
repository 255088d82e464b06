"""What carries and stops the bodies of simulated falls."""

import numpy as np
import pytest

from scripts.training import falling

mujoco = pytest.importorskip("mujoco")


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.25), (3.0, -2.0, 0.25)])
def test_a_bed_carries_a_body_wherever_it_stands(
    place: tuple[float, float, float], yaw: float
) -> None:
    bed = falling._Support((1.0, 1.0, place[2]), place, yaw)
    model = falling._model(bed)
    data = mujoco.MjData(model)
    data.qpos[:3] = [*place[:2], bed.top + 1.2]
    for _ in range(1500):
        mujoco.mj_step(model, data)
    assert bed.top - 0.05 < data.qpos[2] < bed.top + 0.4
    assert np.linalg.norm(data.qpos[:2] - place[:2]) < 1.5
