"""Take MediaPipe's two pose networks out of its wheel, as the service ships them.

The detector is taken as it is. The landmark network's heatmaps are dropped, an output that the
service does not read; mask, landmarks, presence and world coordinates stay.

    pip download --no-deps --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21
    python -m scripts.convert_pose_landmarks mediapipe-0.10.21-*.whl
"""

from __future__ import annotations

import argparse
import hashlib
import zipfile
from pathlib import Path
from typing import Any

import flatbuffers
from ai_edge_litert import schema_py_generated as schema

from app.vision.models import FOLDER

DETECTION = "mediapipe/modules/pose_detection/pose_detection.tflite"
LANDMARKS = "mediapipe/modules/pose_landmark/pose_landmark_full.tflite"
"""The networks in the wheel."""

KEPT = ("Identity", "Identity_1", "Identity_2", "Identity_4")
"""Outputs of the landmark network: landmarks, presence, mask, world coordinates."""

_FILE_IDENTIFIER = b"TFL3"


def keep_outputs(model: bytes, kept: tuple[str, ...] = KEPT) -> bytes:
    """Reduce a network to what some of its outputs need.

    Parameters
    ----------
    model : bytes
        TFLite.
    kept : tuple of str
        Names of outputs, in their new order.

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
    graph = network.subgraphs[0]
    names = [tensor.name.decode() for tensor in graph.tensors]
    missing = [name for name in kept if name not in names]
    if missing:
        raise ValueError(f"expected a network with the outputs {', '.join(missing)}")
    graph.outputs = [names.index(name) for name in kept]
    needed = set(graph.outputs)
    operators = []
    for operator in reversed(graph.operators):
        if needed.intersection(operator.outputs):
            needed.update(number for number in operator.inputs if number >= 0)
            operators.append(operator)
    graph.operators = operators[::-1]
    used = {graph.tensors[number].buffer for number in needed}
    for number, buffer in enumerate(network.buffers):
        if number not in used:
            buffer.data = None
    network.signatureDefs = None
    builder = flatbuffers.Builder(len(model))
    builder.Finish(network.Pack(builder), _FILE_IDENTIFIER)
    return bytes(builder.Output())


def main() -> None:
    """Convert as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("wheel", type=Path, help="mediapipe 0.10.21; later wheels hold no networks")
    parser.add_argument("--out", type=Path, default=FOLDER)
    options = parser.parse_args()
    with zipfile.ZipFile(options.wheel) as wheel:
        networks = {
            "pose_detection.tflite": wheel.read(DETECTION),
            "pose_landmarks.tflite": keep_outputs(wheel.read(LANDMARKS)),
        }
    for name, content in networks.items():
        (options.out / name).write_bytes(content)
        print(f"{name}: {len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()}")


if __name__ == "__main__":
    main()
