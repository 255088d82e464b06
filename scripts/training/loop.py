"""The loop of every training: on one core, the same result for the same seed."""

from collections.abc import Callable, Iterable
from typing import Any


def begin(seed: int) -> None:
    """Seed PyTorch, and let it use one core and only what gives the same result twice."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)


def optimise(
    network: Any,
    batches: Iterable[Any],
    loss_of: Callable[[Any], Any],
    *,
    steps: int,
    rate: float,
    decay: float,
    rise: float = 0.3,
    most: float | None = None,
    each: Callable[[int, float], None] | None = None,
) -> None:
    """Train a network by AdamW on so many batches.

    The rate rises to ``rate`` over a share ``rise`` of the steps, then falls to nothing. Gradients
    are cut to a norm of ``most``; ``each`` is called with the number and the loss of every step.
    """
    import torch

    optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, steps, pct_start=rise)
    for step, batch in enumerate(batches, 1):
        loss = loss_of(batch)
        optimiser.zero_grad()
        loss.backward()
        if most is not None:
            torch.nn.utils.clip_grad_norm_(network.parameters(), most)
        optimiser.step()
        schedule.step()
        if each is not None:
            each(step, loss.item())
