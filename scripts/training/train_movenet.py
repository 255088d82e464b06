"""Train MoveNet's backbone to compute in 8 bits, on rendered people: see ``docs/training.md``.

The network in floating point teaches a copy whose backbone rounds weights and activations as
LiteRT's kernels do. The feature pyramid and the heads stay as they are. No truth about the pictures
takes part. Run it on a GPU; ``scripts/convert.py`` says what comes before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional
from tqdm import tqdm

from scripts.convert import INPUT_RANGE, is_in_8_bits, layer_name
from scripts.training.render_people import open_studio, photograph_of, rendering_parser

PICTURE_PX, PATCH_PX, BATCH = 448, 288, 32
WEIGHT_RATE, RANGE_RATE = 2.5e-5, 5e-4
"""Learning rates of Adam. Four times the first is too much: the copy ends 30 % further off."""

EQUALISED = 0.75
"""Power of a channel's size by which it is divided: one range then suits all channels."""

PROBES = ("conv2d_3/BiasAdd", "conv2d_2/BiasAdd", "conv2d_1/BiasAdd", "conv2d/BiasAdd",
          "re_lu/Relu", "re_lu_1/Relu", "re_lu_2/Relu")  # fmt: skip
"""Feature maps that the copy is taught beside the heads: what the pyramid is given, and its own."""

Tensors = dict[str, Any]


@dataclass(frozen=True)
class Layer:
    """An operator of the network, named by its output; kernels are (out, in, rows, columns)."""

    name: str
    kind: str
    inputs: tuple[str, ...]
    stride: int
    activation: int


@dataclass(frozen=True)
class Network:
    """Layers in their order, weights by layer, and names of the heads, before their sigmoids."""

    layers: list[Layer]
    kernels: Tensors
    biases: Tensors
    heads: list[str]

    def copy(self, device: str) -> Network:
        """The same, with weights of its own."""
        kernels, biases = (
            {name: values.to(device, copy=True) for name, values in part.items()}
            for part in (self.kernels, self.biases)
        )
        return Network(self.layers, kernels, biases, self.heads)


def read_network(path: Path) -> Network:
    """Read a TFLite file."""
    from ai_edge_litert import schema_py_generated as schema

    network: Any = schema.ModelT.InitFromPackedBuf(path.read_bytes(), 0)
    graph = network.subgraphs[0]
    kinds = {value: name for name, value in vars(schema.BuiltinOperator).items()}
    names = [layer_name(tensor.name) for tensor in graph.tensors]
    source: dict[int, int] = {}
    layers = []
    kernels, biases = {}, {}
    for operator in graph.operators:
        code = network.operatorCodes[operator.opcodeIndex]
        kind = kinds[max(code.builtinCode, code.deprecatedBuiltinCode)]
        name, options = names[operator.outputs[0]], operator.builtinOptions
        inputs = [source.get(number, number) for number in operator.inputs]
        if kind in ("DEQUANTIZE", "LOGISTIC"):
            source[operator.outputs[0]] = inputs[0]
        if kind not in ("CONV_2D", "DEPTHWISE_CONV_2D", "ADD", "RESIZE_BILINEAR"):
            continue
        if kind.endswith("CONV_2D"):
            kernel, bias = (_constant(network, number) for number in inputs[1:3])
            axes = (0, 3, 1, 2) if kind == "CONV_2D" else (3, 0, 1, 2)
            kernels[name] = torch.from_numpy(kernel.transpose(axes).copy())
            biases[name] = torch.from_numpy(bias)
        of = tuple(names[number] for number in inputs[: 2 if kind == "ADD" else 1])
        stride, activation = (
            getattr(options, key, 0) for key in ("strideW", "fusedActivationFunction")
        )
        layers.append(Layer(name, kind, of, stride, activation))
    heads = [names[source.get(number, number)] for number in graph.outputs]
    return Network(layers, kernels, biases, heads)


def _constant(network: Any, number: int) -> NDArray[np.float32]:
    tensor = network.subgraphs[0].tensors[number]
    values = bytes(network.buffers[tensor.buffer].data)
    kind = np.float16 if 2 * np.prod(tensor.shape) == len(values) else np.float32
    return np.frombuffer(values, kind).reshape(tensor.shape).astype(np.float32)


def rounded(values: Any) -> Any:
    """Whole numbers; gradients pass as they are."""
    return values + (values.round() - values).detach()


def in_steps(values: Any, low: Any, high: Any) -> Any:
    """Values as 256 steps from ``low`` to ``high``, of which one is 0, hold them."""
    step = (high - low) / 255
    zero = rounded(-128 - low / step)
    return ((rounded(values / step) + zero).clamp(-128, 127) - zero) * step


def run(network: Network, pictures: Any, ranges: Tensors | None = None) -> Tensors:
    """Output of each layer for pictures ``(N, 3, H, W)``, RGB 0 to 255; in 8 bits with ranges."""
    frame = pictures / 127.5 - 1
    found = {
        network.layers[0].inputs[0]: in_steps(frame, *torch.tensor(INPUT_RANGE))
        if ranges
        else frame
    }
    for layer in network.layers:
        values, *others = (found[name] for name in layer.inputs)
        is_rounded = ranges is not None and is_in_8_bits(layer.name)
        if layer.kind == "ADD":
            values = values + others[0]
        elif layer.kind == "RESIZE_BILINEAR":
            values = functional.interpolate(values, scale_factor=2, mode="bilinear")
        else:
            kernel = network.kernels[layer.name]
            if is_rounded:
                step = kernel.detach().abs().amax((1, 2, 3), keepdim=True).clamp_min(1e-9) / 127
                kernel = rounded(kernel / step) * step
            # As TensorFlow pads: what is odd goes to the right and below.
            sides = [max(kernel.shape[2] - layer.stride, 0)] * 2
            padded = functional.pad(values, [k for s in sides for k in (s // 2, s - s // 2)])
            groups = values.shape[1] if layer.kind != "CONV_2D" else 1
            values = functional.conv2d(
                padded, kernel, network.biases[layer.name], layer.stride, groups=groups
            )
            limits = {0: (None, None), 1: (0, None), 3: (0, 6)}[layer.activation]
            values = values if layer.activation == 0 else values.clamp(*limits)
        if ranges is not None and is_rounded:
            low, high = ranges[layer.name]
            values = in_steps(values, low, high)
        found[layer.name] = values
    return found


def equalise(network: Network, found: Tensors) -> None:
    """Bring the channels of each residual stream to similar sizes; the outputs stay the same."""
    stream: dict[str, int] = {}
    for layer in network.layers:
        if is_in_8_bits(layer.name) and layer.activation == 0:
            joined = [stream[name] for name in layer.inputs if layer.kind == "ADD"]
            stream[layer.name] = joined[0] if joined else len(stream)
            stream = {name: joined[0] if one in joined else one for name, one in stream.items()}
    for number in set(stream.values()) - {stream[_named("conv2d/BiasAdd", network)]}:
        own = [name for name, one in stream.items() if one == number]
        size = torch.stack([found[name].square().mean((0, 2, 3)).sqrt() for name in own]).amax(0)
        size = size.clamp_min(1e-6)
        scale = ((size / size.log().mean().exp()) ** EQUALISED).clamp(0.05, 20)
        for layer in network.layers:
            if layer.name in own and layer.kind == "CONV_2D":
                network.kernels[layer.name] /= scale[:, None, None, None]
                network.biases[layer.name] /= scale
            elif layer.kind == "CONV_2D" and layer.inputs[0] in own:
                network.kernels[layer.name] *= scale[:, None, None]


def _named(end: str, network: Network) -> str:
    return next(layer.name for layer in network.layers if layer.name.endswith("model_1/" + end))


def best_range(values: Any) -> tuple[float, float]:
    """The part of the range of some values in which 256 steps hold them best."""
    lowest, highest = min(float(values.min()), 0.0), float(values.max())
    some = values.flatten()[torch.randint(values.numel(), (200_000,), device=values.device)]
    parts = np.linspace(0.25, 1, 20)
    errors = [
        float((in_steps(some, torch.tensor(lowest * part), torch.tensor(highest * part)) - some)
              .square().mean()) for part in parts
    ]  # fmt: skip
    part = parts[int(np.argmin(errors))]
    return lowest * part, highest * part


def collage(pictures: Any, sizes: Any, count: int) -> Any:
    """Patches ``(count, 3, P, P)`` of up to three turned pictures each, in other light."""
    device = pictures.device

    def between(low: float, high: float) -> Any:
        return low + (high - low) * torch.rand(count, 1, 1, device=device)

    at = torch.arange(PATCH_PX, device=device) + 0.5
    patch = (between(-100, 255).clamp_min(0))[..., None].expand(-1, 3, PATCH_PX, PATCH_PX)
    for sizes_of, spread, share in (((0.6, 2.2), 0.18, 1), ((0.25, 0.9), 0.45, 0.6),
                                    ((0.2, 0.7), 0.45, 0.35)):  # fmt: skip
        chosen = torch.randint(len(pictures), (count,), device=device)
        extent = sizes[chosen][..., None, None]
        zoom = PATCH_PX * between(*np.log(sizes_of).tolist()).exp() / extent.amax(1)
        zoom = zoom.clamp(0.4, 3)
        turn = torch.where(between(0, 1) < 0.6, between(-0.2, 0.2), between(-np.pi, np.pi))
        middle = [PATCH_PX * (0.5 + between(-spread, spread)) for _ in range(2)]
        across, down = at[None, None] - middle[0], at[None, :, None] - middle[1]
        x = (turn.cos() * across + turn.sin() * down) / zoom * between(-1, 1).sign()
        y = (turn.cos() * down - turn.sin() * across) / zoom
        x, y = x + extent[:, 0] / 2, y + extent[:, 1] / 2
        is_seen = (x >= 0) & (y >= 0) & (x < extent[:, 0]) & (y < extent[:, 1])
        place = 2 * torch.stack([x, y], -1) / PICTURE_PX - 1
        seen = functional.grid_sample(pictures[chosen].float(), place, align_corners=False)
        patch = torch.where((is_seen & (between(0, 1) < share))[:, None], seen, patch)
    light = (patch / 255) ** between(-0.5, 0.5).exp()[..., None]
    light = (light - 0.5) * between(-0.5, 0.4).exp()[..., None] + 0.5
    light = light + between(-0.15, 0.15)[..., None]
    light = light * (0.12 * torch.randn(count, 3, 1, 1, device=device)).exp()
    grey = light.mean(1, keepdim=True).expand_as(light)
    light = torch.where(between(0, 1)[..., None] < 0.12, grey, light)
    noise = between(-0.04, 0.04).clamp_min(0)[..., None]
    return ((light + noise * torch.randn_like(light)).clamp(0, 1) * 255).round()


def distance(taught: Tensors, found: Tensors, heads: list[str], sizes: Tensors) -> Any:
    """How far a copy's feature maps and heads are from the teacher's."""
    maps = [
        functional.smooth_l1_loss(found[name] / size, taught[name] / size, beta=0.5)
        for name, size in sizes.items()
    ]
    total = 2 * sum(maps) / len(maps)
    centres, extents, offsets, guesses, heatmaps, refinements = (
        (taught[name], found[name]) for name in heads
    )
    for true, own in (centres, heatmaps):
        share = true.sigmoid()
        weight = 0.02 + share.sqrt()
        gaps = (true.clamp(-7, 6) - own.clamp(-7, 6)).abs()
        total += (weight * gaps).sum() / weight.sum()
        total += 30 * (share - own.sigmoid()).abs().mean()
    people = centres[0].sigmoid()
    people = functional.max_pool2d(people, 3, 1, 1) * (people > 0.02)
    joints = heatmaps[0].sigmoid() * (heatmaps[0] > -3.5)
    joints = joints.repeat_interleave(2, dim=1)
    for factor, (true, own), seen in (
        (0.3, extents, people),
        (1, offsets, people),
        (0.3, guesses, people),
        (1, refinements, joints),
    ):
        weight = seen.expand_as(true)
        total += factor * ((true - own).abs() * weight).sum() / (weight.sum() + 1)
    return total


def train(teacher: Network, pictures: Any, sizes: Any, steps: int) -> dict[str, Any]:
    """Kernels, biases and ranges of a copy, by the layer's name and what they are."""
    device = pictures.device
    copy = teacher.copy(device)
    names = [layer.name for layer in teacher.layers if is_in_8_bits(layer.name)]
    with torch.no_grad():
        found = run(teacher, collage(pictures, sizes, BATCH))
        equalise(copy, found)
        probes = (_named(end, teacher) for end in PROBES)
        spread = {name: found[name].std((0, 2, 3), keepdim=True).clamp_min(1e-3) for name in probes}
        found = run(copy, collage(pictures, sizes, BATCH))
        first = {name: torch.tensor(best_range(found[name]), device=device) for name in names}
    grown = {name: torch.zeros(2, device=device, requires_grad=True) for name in names}
    parts = {"kernel": copy.kernels, "bias": copy.biases}
    weights = [
        part[name].requires_grad_() for part in parts.values() for name in names if name in part
    ]
    optimiser = torch.optim.Adam(
        [
            {"params": weights, "lr": WEIGHT_RATE},
            {"params": list(grown.values()), "lr": RANGE_RATE},
        ]
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser, lambda step: min(1, step / 150) * (0.5 + 0.5 * np.cos(np.pi * step / steps))
    )
    progress = tqdm(range(steps), unit="step")
    for _ in progress:
        patches = collage(pictures, sizes, BATCH)
        with torch.no_grad():
            taught = run(teacher, patches)
        ranges = {name: first[name] * grown[name].exp() for name in names}
        loss = distance(taught, run(copy, patches, ranges), teacher.heads, spread)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 5.0)
        optimiser.step()
        schedule.step()
        progress.set_postfix(distance=round(float(loss.detach()), 3))
    result = {f"{name} range": first[name] * grown[name].exp() for name in names}
    for what, part in parts.items():
        result |= {f"{name} {what}": values for name, values in part.items()}
    return {name: values.detach().cpu().numpy() for name, values in result.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = rendering_parser(__doc__, count=1500, seed=777)
    parser.add_argument("--network", type=Path, required=True, help="MoveNet in floating point")
    parser.add_argument("--steps", type=int, default=3100)
    options = parser.parse_args(arguments)
    if options.out is None:
        parser.error("expected --out, the file to write")
    torch.manual_seed(options.seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    studio = open_studio(options)
    pictures = torch.zeros(options.count, 3, PICTURE_PX, PICTURE_PX, dtype=torch.uint8)
    sizes = torch.zeros(options.count, 2)
    for number in tqdm(range(options.count), unit="picture"):
        image = photograph_of(studio, options.seed, number)[0].image
        scale = min(1.0, PICTURE_PX / max(image.shape[:2]))
        rows, columns = (max(1, int(scale * side)) for side in image.shape[:2])
        small = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
        rgb = torch.from_numpy(small[..., ::-1].copy())
        pictures[number, :, :rows, :columns] = rgb.permute(2, 0, 1)
        sizes[number] = torch.tensor([columns, rows])
    teacher = read_network(options.network).copy(device)
    trained = train(teacher, pictures.to(device), sizes.to(device), options.steps)
    np.savez_compressed(options.out, **trained)
