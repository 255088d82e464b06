"""A network stored as TFLite, run by LiteRT, which is imported when a network is loaded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import PriorityQueue
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.networks.shipped import NetworkError

if TYPE_CHECKING:
    from ai_edge_litert.interpreter import Interpreter

Shape = tuple[int | None, ...]


class TfliteNetwork:
    """A network from some arrays to others; thread-safe.

    Shapes are rows, columns and channels of each array, None for a size that may vary. ``copies``
    calls run at once, others wait. ``threads`` share the work of a call while it is the only one. A
    call that runs beside others has one thread, since threads wait for each other after every
    layer.

    Raises
    ------
    NetworkError
        If the file cannot be read or is another network.
    """

    def __init__(
        self,
        path: Path,
        input_shapes: Sequence[Shape],
        output_shapes: Sequence[Shape],
        *,
        threads: int = 1,
        copies: int = 1,
    ) -> None:
        self._path = path
        self._threads = threads
        self._varies = any(None in shape for shape in input_shapes)
        # An interpreter holds the activations of its layers, so each serves one call at a time.
        # None stands for an interpreter that has not been made yet. The first is taken first.
        self._idle: PriorityQueue[tuple[int, Interpreter | None]] = PriorityQueue()
        for number in range(copies):
            self._idle.put((number, None))
        with self._interpreter() as interpreter:
            inputs = [_shape(tensor) for tensor in interpreter.get_input_details()]
            outputs = [_shape(tensor) for tensor in interpreter.get_output_details()]
        expected = [[(1, *shape) for shape in shapes] for shapes in (input_shapes, output_shapes)]
        if [inputs, outputs] != expected:
            raise NetworkError(
                f"expected {path} to have the inputs {expected[0]} and the outputs "
                f"{expected[1]}, got {inputs} and {outputs}"
            )

    @contextmanager
    def _interpreter(self) -> Iterator[Interpreter]:
        """Borrow an idle interpreter; one whose call fails is replaced."""
        number, interpreter = self._idle.get()
        usable = None
        try:
            interpreter = interpreter or self._load(1 if number else self._threads)
            yield interpreter
            usable = interpreter
        finally:
            self._idle.put((number, usable))

    def _load(self, threads: int) -> Interpreter:
        if not self._path.is_file():
            raise NetworkError(f"cannot read a network: {self._path} is missing")
        from ai_edge_litert.interpreter import Interpreter

        try:
            interpreter = Interpreter(model_path=str(self._path), num_threads=threads)
            # Until a size that varies is known, memory for it would be wasted: 10 MB for MoveNet.
            if not self._varies:
                interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise NetworkError(f"{self._path} is not a network LiteRT can run") from error
        return interpreter

    def run(self, *images: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Run the network on its inputs ``(H, W, C)`` and return each output."""
        with self._interpreter() as interpreter:
            for source, image in zip(interpreter.get_input_details(), images, strict=True):
                if tuple(source["shape"]) != (1, *image.shape):
                    interpreter.resize_tensor_input(source["index"], (1, *image.shape))
                    interpreter.allocate_tensors()
                interpreter.set_tensor(source["index"], image[None])
            interpreter.invoke()
            outputs = interpreter.get_output_details()
            return [interpreter.get_tensor(output["index"])[0] for output in outputs]


def _shape(tensor: dict[str, NDArray[np.int32]]) -> Shape:
    """Shape of an input or output, None where the network leaves a size open."""
    pairs = zip(tensor["shape"].tolist(), tensor["shape_signature"].tolist(), strict=True)
    return tuple(None if signed < 0 else size for size, signed in pairs)
