"""The joint reader as torch trains it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from app.vision.joints import CHANNELS, READ
from scripts.refinement.model import Layer, Residual

WIDTHS = (24, 40, 72, 112)
"""Channels at a half, a quarter, an eighth and a sixteenth of the resolution."""


class JointReader(nn.Module):  # type: ignore[misc]
    """``(N, 4, 144, 96)`` in 0..1 to maps ``(N, 16, 36, 24)``, each of which sums to 1."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.to_quarter = nn.Sequential(
            Layer(CHANNELS, a, 2), Layer(a, a), Layer(a, b, 2), Residual(b)
        )
        self.to_eighth = nn.Sequential(Layer(b, c, 2), *(Residual(c) for _ in range(2)))
        self.to_sixteenth = nn.Sequential(Layer(c, d, 2), *(Residual(d) for _ in range(5)))
        self.up = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False)
        self.narrow = nn.ModuleList((nn.Conv2d(d, c, 1), nn.Conv2d(c, b, 1)))
        self.join = nn.ModuleList((Residual(c), Residual(b)))
        self.last = nn.Conv2d(b, len(READ), 1)

    def odds(self, x: Tensor) -> Tensor:
        """Unnormalised logarithms of the probability of each cell."""
        quarter = self.to_quarter(x)
        eighth = self.to_eighth(quarter)
        deep = self.to_sixteenth(eighth)
        for narrow, join, skipped in zip(self.narrow, self.join, (eighth, quarter), strict=True):
            deep = join(torch.relu(self.up(narrow(deep)) + skipped))
        return self.last(deep)

    def forward(self, x: Tensor) -> Tensor:
        """Probability that a point lies in a cell of the window."""
        odds = self.odds(x)
        return torch.softmax(odds.flatten(2), dim=2).reshape(odds.shape)
