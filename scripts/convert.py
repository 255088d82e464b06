"""Convert the published networks to the TFLite files of the service.

    pip download --no-deps --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21
    python -m scripts convert blazepose mediapipe-0.10.21-*.whl

    npm pack @mediapipe/objectron@0.4.1675468480 && tar xzf mediapipe-objectron-*.tgz
    python -m scripts convert objects package/objectron_solution_packed_assets.data

MediaPipe's pose detector is taken as it is. Its landmark network is cut in two: landmarks, presence
and world coordinates, and the mask, which not every reading needs. Its heatmaps are dropped.
Of MediaPipe's detector of objects, the classes in its two finest grids are taken. MoveNet was
converted, and its rounding trained, by revision 28ea9a5: docs/training.md.
"""

import argparse
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from app.networks.shipped import FOLDER
from scripts.training.shipping import record_hash

DETECTION = "mediapipe/modules/pose_detection/pose_detection.tflite"
LANDMARKS = "mediapipe/modules/pose_landmark/pose_landmark_full.tflite"
"""The networks in the wheel."""

BODY = (
    "Identity",
    "Identity_1",
    "Identity_4",
    "model_1/model/add_8/add",
    "model_1/model/re_lu_63/Relu6;model_1/model/add_22/add",
)
"""Outputs of the landmark network: landmarks, presence, world coordinates; then two feature maps
that it computes on the way, 8x8x144 and 2x2x288."""

MASK_INPUTS = (
    "model_1/model/batch_normalization_2/FusedBatchNormV3;"
    "model_1/model/depthwise_conv2d_32/depthwise;model_1/model/conv2d_1/Conv2D1",
    "model_1/model/add/add",
    "model_1/model/add_1/add",
    "model_1/model/add_5/add",
    "model_1/model/re_lu_31/Relu6;model_1/model/batch_normalization_46/FusedBatchNormV3;"
    "model_1/model/depthwise_conv2d_15/depthwise;model_1/model/depthwise_conv2d_20/depthwise",
)
"""What the mask is made of: feature maps of 128, 64, 32, 16 and 8 rows."""

MASK = ("Identity_2",)

OBJECTS = (
    "BoxPredictor_0/ClassPredictor/BiasAdd;BoxPredictor_0/ClassPredictor/Conv2D;"
    "BoxPredictor_0/ClassPredictor/biases1",
    "BoxPredictor_1/ClassPredictor/BiasAdd;BoxPredictor_5/ClassPredictor/Conv2D;"
    "BoxPredictor_1/ClassPredictor/Conv2D;BoxPredictor_1/ClassPredictor/biases1",
)
"""Classes of the anchors in two grids of the detector of objects."""

OBJECTS_PX = 192
"""Side of its input: as published, 300, it takes three times as long."""

_FILE_IDENTIFIER = b"TFL3"


def part_of(
    model: bytes, outputs: tuple[str, ...], inputs: tuple[str, ...] = (), side: int | None = None
) -> bytes:
    """Cut the part out of a TFLite network that leads from tensors of some names to others.

    By default, it begins with the network's own inputs; ``ValueError`` if there is no such tensor.
    The inputs become squares of ``side`` pixels, if given.
    """
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    network: Any = schema.ModelT.InitFromPackedBuf(model, 0)
    graph = network.subgraphs[0]
    names = [tensor.name.decode() for tensor in graph.tensors]
    missing = [name for name in (*inputs, *outputs) if name not in names]
    if missing:
        raise ValueError(f"expected a network with the tensors {', '.join(missing)}")
    if inputs:
        graph.inputs = [names.index(name) for name in inputs]
    graph.outputs = [names.index(name) for name in outputs]
    for number in graph.inputs if side else ():
        graph.tensors[number].shape = [1, side, side, graph.tensors[number].shape[3]]
    given, needed, operators = set(graph.inputs), set(graph.outputs), []
    for operator in reversed(graph.operators):
        if (needed - given).intersection(operator.outputs):
            needed.update(number for number in operator.inputs if number >= 0)
            operators.append(operator)
    graph.operators = operators[::-1]
    _renumber(network, sorted(needed | given))
    network.signatureDefs = None
    builder = flatbuffers.Builder(len(model))
    builder.Finish(network.Pack(builder), _FILE_IDENTIFIER)
    return bytes(builder.Output())


def _renumber(network: Any, kept: list[int]) -> None:
    """Keep some tensors of a network and their buffers only; names of inputs and outputs alone."""
    graph = network.subgraphs[0]
    place = {number: row for row, number in enumerate(kept)}
    graph.tensors = [graph.tensors[number] for number in kept]
    graph.inputs, graph.outputs = (
        [place[number] for number in numbers] for numbers in (graph.inputs, graph.outputs)
    )
    for operator in graph.operators:
        operator.inputs = [place.get(number, -1) for number in operator.inputs]
        operator.outputs = [place[number] for number in operator.outputs]
    # The first buffer is empty by definition.
    buffers = [0, *sorted({tensor.buffer for tensor in graph.tensors} - {0})]
    network.buffers = [network.buffers[number] for number in buffers]
    ends = {*graph.inputs, *graph.outputs}
    for number, tensor in enumerate(graph.tensors):
        tensor.buffer = buffers.index(tensor.buffer)
        tensor.name = tensor.name if number in ends else None
    network.metadata, network.metadataBuffer = None, None


def convert_blazepose(wheel: Path) -> dict[str, bytes]:
    """Take the networks out of mediapipe 0.10.21; later wheels hold none."""
    with zipfile.ZipFile(wheel) as content:
        return {
            "pose_detection.tflite": content.read(DETECTION),
            "pose_landmarks.tflite": part_of(content.read(LANDMARKS), BODY + MASK_INPUTS),
            "pose_mask.tflite": part_of(content.read(LANDMARKS), MASK, MASK_INPUTS),
        }


def convert_objects(assets: Path) -> dict[str, bytes]:
    """Take the network out of the assets of MediaPipe's objectron, which hold its labels too."""
    content = assets.read_bytes()
    network = content[content.index(_FILE_IDENTIFIER) - 4 :]
    return {"objects.tflite": part_of(network, OBJECTS, side=OBJECTS_PX)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Convert as the command line asks."""
    converters = {"blazepose": convert_blazepose, "objects": convert_objects}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("network", choices=converters)
    parser.add_argument("source", type=Path, help="the published network, as above")
    parser.add_argument("--out", type=Path, default=FOLDER)
    options = parser.parse_args(arguments)
    if options.source.resolve().parent == options.out.resolve():
        parser.error(f"--out: expected another folder than that of {options.source}")
    options.out.mkdir(parents=True, exist_ok=True)
    for name, content in converters[options.network](options.source).items():
        (options.out / name).write_bytes(content)
        record_hash(options.out / name)
