"""What the trainings of all networks share: their options, and the descent."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import torch
from torch import Tensor, nn
from tqdm import tqdm

from app.settings import DEFAULT_MODELS

ROOT = Path(__file__).resolve().parents[2]
BATCH = 16


def read_options(description: str | None, *, samples: int, out: Path) -> argparse.Namespace:
    """Read the command line of a training, and hold the libraries to the threads it may use."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--backgrounds", type=Path, required=True, help="of .backgrounds")
    parser.add_argument("--models", type=Path, default=DEFAULT_MODELS, help="of fetch_models")
    parser.add_argument("--samples", type=int, default=samples)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=out)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    return options


def descend(
    model: nn.Module,
    loss_of_batch: Callable[[], Tensor],
    *,
    steps: int,
    rate: float,
    weight_decay: float,
    warm_up: float,
) -> None:
    """Give a network one lesson.

    Parameters
    ----------
    model : torch.nn.Module
    loss_of_batch : callable
        Shows the network another batch and gives the loss.
    steps : int
        Batches.
    rate : float
        Largest learning rate; it rises and falls once.
    weight_decay : float
    warm_up : float
        Share of the steps over which the rate rises.
    """
    optimiser = torch.optim.AdamW(model.parameters(), rate, weight_decay=weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, steps, pct_start=warm_up)
    running: float | None = None
    with tqdm(range(steps), desc="training", unit="batch", mininterval=5) as progress:
        for _ in progress:
            loss = loss_of_batch()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            value = loss.item()
            running = value if running is None else running + 0.01 * (value - running)
            progress.set_postfix(loss=f"{running:.3f}", refresh=False)
