"""Reduce MediaPipe's pose network to its mask and to narrower windows, as the service ships it.

The whole network takes a square and finds a person's joints as well. The service needs silhouettes
of people, who are higher than wide: layers that only lead to joints are dropped, and a window of
256x192 shows less of the neighbours in three quarters of the time.

    pip download --no-deps --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21
    python -m scripts.convert_body_mask mediapipe-0.10.21-*.whl
"""

from __future__ import annotations

import argparse
import hashlib
import zipfile
from pathlib import Path
from typing import Any

import flatbuffers
import numpy as np
from ai_edge_litert import schema_py_generated as schema

from app.vision.weights import FOLDER

MEMBER = "mediapipe/modules/pose_landmark/pose_landmark_full.tflite"
"""The pose network in the wheel."""

MASK = "Identity_2"
"""Name of the mask among the network's outputs."""

_FILE_IDENTIFIER = b"TFL3"


def mask_network(model: bytes, columns: int = 192, mask: str = MASK) -> bytes:
    """Reduce a fully convolutional network to what its mask needs, for windows of another width.

    Parameters
    ----------
    model : bytes
        TFLite, of one input ``(1, H, W, C)``.
    columns : int
        New width of input and mask; a multiple of 32 for a network that halves it five times.
    mask : str
        Name of the output kept.

    Returns
    -------
    bytes
        TFLite; the same bytes for the same arguments.

    Raises
    ------
    ValueError
        If the network has no such output.
    """
    network: Any = schema.ModelT.InitFromPackedBuf(model, 0)
    names = [tensor.name.decode() for tensor in network.subgraphs[0].tensors]
    if mask not in names:
        raise ValueError(f"expected a network with an output {mask}")
    _keep(network, names.index(mask))
    _narrow(network, columns)
    network.signatureDefs = None
    builder = flatbuffers.Builder(len(model))
    builder.Finish(network.Pack(builder), _FILE_IDENTIFIER)
    return bytes(builder.Output())


def _keep(network: Any, output: int) -> None:
    """Keep only the operators that one of the tensors depends on, in place."""
    graph = network.subgraphs[0]
    graph.outputs = [output]
    needed = {output}
    kept = []
    for operator in reversed(graph.operators):
        if needed.intersection(operator.outputs):
            needed.update(number for number in operator.inputs if number >= 0)
            kept.append(operator)
    graph.operators = kept[::-1]
    used = {graph.tensors[number].buffer for number in needed}
    for number, buffer in enumerate(network.buffers):
        if number not in used:
            buffer.data = None


def _narrow(network: Any, columns: int) -> None:
    """Set the width of the input, and of all that is resized inside, in place."""
    graph = network.subgraphs[0]
    entry = graph.tensors[graph.inputs[0]]
    share = columns / entry.shape[2]
    entry.shape = [*entry.shape[:2], columns, *entry.shape[3:]]
    # Resizing to the same size, several operators may share the buffer that names it.
    sizes = {
        graph.tensors[operator.inputs[1]].buffer
        for operator in graph.operators
        if network.operatorCodes[operator.opcodeIndex].builtinCode
        == schema.BuiltinOperator.RESIZE_BILINEAR
    }
    for number in sizes:
        buffer = network.buffers[number]
        height, width = np.frombuffer(bytes(buffer.data), np.int32).tolist()
        size = np.array([height, round(width * share)], np.int32)
        buffer.data = np.frombuffer(size.tobytes(), np.uint8)


def main() -> None:
    """Convert as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("wheel", type=Path, help="mediapipe 0.10.21; later wheels hold no networks")
    parser.add_argument("--out", type=Path, default=FOLDER / "body_mask.tflite")
    options = parser.parse_args()
    with zipfile.ZipFile(options.wheel) as wheel:
        content = mask_network(wheel.read(MEMBER))
    options.out.write_bytes(content)
    print(f"{options.out}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}")


if __name__ == "__main__":
    main()
