"""A network stored as TFLite, run by LiteRT."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter
from numpy.typing import NDArray

from app.vision.runtime.copies import Copies

Shape = tuple[int | None, ...]


class NetworkError(RuntimeError):
    """A network's file is missing, altered or not the expected network."""


class TfliteNetwork:
    """An image in, images out; safe under several threads.

    Parameters
    ----------
    path : Path
    entering : (int or None, int or None, int)
        Rows, columns and channels of the input; None where it takes any.
    leaving : sequence of the same
        Of each output.
    threads : int
        That share the work of one call.
    copies : int
        How many calls it serves at a time; the others wait.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(
        self,
        path: Path,
        entering: Shape,
        leaving: Sequence[Shape],
        *,
        threads: int = 1,
        copies: int = 1,
    ) -> None:
        self._path = path
        self._threads = threads
        # An interpreter keeps what its layers give inside, so each serves one call at a time.
        self._copies = Copies(self._read, copies)
        with self._copies.one() as interpreter:
            inputs = [_shape(end) for end in interpreter.get_input_details()]
            outputs = [_shape(end) for end in interpreter.get_output_details()]
        if inputs != [(1, *entering)] or outputs != [(1, *shape) for shape in leaving]:
            raise NetworkError(
                f"expected {path} to have one input {entering} and outputs {list(leaving)}, "
                f"got {inputs} and {outputs}"
            )

    def _read(self) -> Interpreter:
        if not self._path.is_file():
            raise NetworkError(f"cannot read a network: {self._path} is missing")
        try:
            interpreter = Interpreter(model_path=str(self._path), num_threads=self._threads)
            interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise NetworkError(f"{self._path} is not a network LiteRT can run") from error
        return interpreter

    def run(self, image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Show it one input ``(H, W, C)`` and return each of its outputs."""
        with self._copies.one() as interpreter:
            entry = interpreter.get_input_details()[0]
            if tuple(entry["shape"]) != (1, *image.shape):
                interpreter.resize_tensor_input(entry["index"], (1, *image.shape))
                interpreter.allocate_tensors()
            interpreter.set_tensor(entry["index"], image[None])
            interpreter.invoke()
            return [
                interpreter.get_tensor(end["index"])[0] for end in interpreter.get_output_details()
            ]


def _shape(end: dict[str, NDArray[np.int32]]) -> Shape:
    """Shape of an input or output, None where the network leaves a size open."""
    pairs = zip(end["shape"].tolist(), end["shape_signature"].tolist(), strict=True)
    return tuple(None if signed < 0 else size for size, signed in pairs)
