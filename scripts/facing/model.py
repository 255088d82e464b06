"""The facing reader as torch trains it."""

from __future__ import annotations

from torch import Tensor, nn

from app.vision.facing_evidence import CHANNELS, SIZE
from scripts.refinement.model import Layer, Residual

WIDTHS = (24, 40, 64, 96)
"""Channels at a half, a quarter, an eighth and a sixteenth of the resolution."""

SURENESS = 4.0
"""The last layer's answers are multiplied by this: weights of usual size then make sure answers."""


class FacingReader(nn.Module):  # type: ignore[misc]
    """``(N, 8, 64, 64)`` in 0..1 to the von Mises distribution's parameters ``(N, 2)``."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.layers = nn.Sequential(
            Layer(CHANNELS, a, 2),
            Layer(a, b, 2),
            Residual(b),
            Layer(b, c, 2),
            Residual(c),
            Layer(c, d, 2),
            Residual(d),
        )
        self.dropout = nn.Dropout(0.3)
        self.last = nn.Linear(d * (SIZE // 16) ** 2, 2)

    def forward(self, x: Tensor) -> Tensor:
        """Apply it."""
        return SURENESS * self.last(self.dropout(self.layers(x).flatten(1)))
