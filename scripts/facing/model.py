"""The facing reader as torch trains it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from app.vision.facing_evidence import CHANNELS, SIZE
from app.vision.joints import READ
from scripts.refinement.model import Layer, Residual

WIDTHS = (24, 40, 64, 96)
"""Channels at a half, a quarter, an eighth and a sixteenth of the resolution."""

CELL = 4
"""Maps have one cell for so many pixels of the second window each way."""

SURENESS = 4.0
"""The last layer's answers are multiplied by this: weights of usual size then make sure answers."""


class FacingReader(nn.Module):  # type: ignore[misc]
    """``(N, 8, 64, 64)`` in 0..1 to the von Mises distribution's parameters ``(N, 2)``.

    On the way it looks for the joints, and where it finds them counts for the azimuth: to know a
    shoulder from the other one is to know front from back.
    """

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.to_quarter = nn.Sequential(Layer(CHANNELS, a, 2), Layer(a, b, 2), Residual(b))
        self.to_eighth = nn.Sequential(Layer(b, c, 2), Residual(c))
        self.to_sixteenth = nn.Sequential(Layer(c, d, 2), Residual(d))
        self.up = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False)
        self.narrow = nn.ModuleList((nn.Conv2d(d, c, 1), nn.Conv2d(c, b, 1)))
        self.join = Layer(c, c)
        self.maps = nn.Conv2d(b, len(READ), 1)
        self.dropout = nn.Dropout(0.3)
        self.by_look = nn.Linear(d * (SIZE // 16) ** 2, 2)
        self.by_places = nn.Sequential(nn.Linear(2 * len(READ), 48), nn.ReLU(), nn.Linear(48, 2))
        cells = SIZE // CELL
        steps = (torch.arange(cells) + 0.5) / cells * 2 - 1
        down, across = torch.meshgrid(steps, steps, indexing="ij")
        self.register_buffer("places", torch.stack([across, down], -1).reshape(-1, 2))

    def odds_and_belief(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Logarithms of the odds of each cell ``(N, 16, 16, 16)`` and the belief ``(N, 2)``."""
        quarter = self.to_quarter(x)
        eighth = self.to_eighth(quarter)
        deep = self.to_sixteenth(eighth)
        joined = self.join(torch.relu(self.up(self.narrow[0](deep)) + eighth))
        odds = self.maps(torch.relu(self.up(self.narrow[1](joined)) + quarter))
        middles = torch.softmax(odds.flatten(2), dim=2) @ self.places
        look = self.by_look(self.dropout(deep.flatten(1)))
        return odds, SURENESS * (look + self.by_places(middles.flatten(1)))

    def forward(self, x: Tensor) -> Tensor:
        """Apply it."""
        return self.odds_and_belief(x)[1]
