"""The refiner as torch trains it, and its export to what OpenCV runs."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from app.vision.refine import CHANNELS

WIDTHS = (20, 32, 64, 112)
"""Channels at a half, a quarter, an eighth and a sixteenth of the resolution."""

FINE = 10
"""Channels at full resolution."""


class Layer(nn.Module):  # type: ignore[misc]
    """3x3 convolution, normalised, with a ramp."""

    def __init__(self, entering: int, leaving: int, stride: int = 1) -> None:
        super().__init__()
        self.convolution: nn.Module = nn.Conv2d(entering, leaving, 3, stride, 1, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(leaving)

    def forward(self, x: Tensor) -> Tensor:
        """Apply it to ``(N, C, H, W)``."""
        return torch.relu(self.norm(self.convolution(x)))


class Residual(nn.Module):  # type: ignore[misc]
    """Two layers whose answer is added to what they saw."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = Layer(width, width), Layer(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """Apply it to ``(N, C, H, W)``."""
        return x + self.second(self.first(x))


class Refiner(nn.Module):  # type: ignore[misc]
    """A U-Net: ``(N, 6, 192, 128)`` in 0..1 to probabilities ``(N, 1, 192, 128)``."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.halved = nn.Sequential(Layer(CHANNELS, a, 2), Layer(a, a))
        self.quartered = nn.Sequential(Layer(a, b, 2), Residual(b))
        self.to_eighth = nn.Sequential(Layer(b, c, 2), Residual(c))
        self.to_sixteenth = nn.Sequential(Layer(c, d, 2), Residual(d), Residual(d))
        self.up = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False)
        self.narrow = nn.ModuleList(
            nn.Conv2d(*pair, 1) for pair in ((d, c), (c, b), (b, a), (a, FINE))
        )
        self.join = nn.ModuleList((Layer(c, c), Layer(b, b), Layer(a, a)))
        self.fine = Layer(FINE + CHANNELS, FINE)
        self.last = nn.Conv2d(FINE, 1, 1)

    def odds(self, x: Tensor) -> Tensor:
        """Logarithms of the odds that a pixel shows the person."""
        half = self.halved(x)
        quarter = self.quartered(half)
        eighth = self.to_eighth(quarter)
        deep = self.to_sixteenth(eighth)
        for narrow, join, skipped in zip(
            self.narrow, self.join, (eighth, quarter, half), strict=False
        ):
            deep = join(self.up(narrow(deep)) + skipped)
        fine = torch.cat([self.up(self.narrow[3](deep)), x], dim=1)
        return self.last(self.fine(fine))

    def forward(self, x: Tensor) -> Tensor:
        """Probability that a pixel shows the person."""
        return torch.sigmoid(self.odds(x))


def export(model: nn.Module, path: Path, entering: tuple[int, int, int], answer: str) -> None:
    """Write a trained model as ONNX, its normalisations folded into the convolutions.

    Parameters
    ----------
    model : torch.nn.Module
        Made of :class:`Layer` and what has no state of its own.
    path : Path
    entering : (int, int, int)
        Planes, rows and columns of what it sees.
    answer : str
        Name of its output.
    """
    model.eval()
    for module in model.modules():
        if isinstance(module, Layer):
            module.convolution = fuse_conv_bn_eval(module.convolution, module.norm)
            module.norm = nn.Identity()
    torch.onnx.export(
        model, (torch.zeros((1, *entering)),), str(path), input_names=["seen"],
        output_names=[answer], opset_version=17, dynamo=False,
    )  # fmt: skip
