"""Silhouettes in memory, each compressed separately and decompressed on demand."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH

PACKED_BYTES = HEIGHT * WIDTH // 8

RAW_DEFLATE = -15
"""Selects neither header nor checksum, since the artefact has its own."""


@dataclass(frozen=True)
class Silhouettes:
    """Normalised silhouettes, deflated separately with a shared dictionary.

    They take a sixth of their packed size; decompressing one takes microseconds.
    """

    data: NDArray[np.uint8]  # (B,): the deflated silhouettes, concatenated
    ends: NDArray[np.int64]  # (E,): end of each silhouette in ``data``; ascending, the last is B
    dictionary: NDArray[np.uint8]  # (D,)
    step: int = 1  # pixels of the normalised frame for each stored pixel, along both axes: 1 or 2

    def __post_init__(self) -> None:
        if self.step not in (1, 2):
            raise ValueError(
                f"expected silhouettes stored at every or every second pixel, "
                f"got a step of {self.step!r}"
            )
        for name, kind in (("data", np.uint8), ("ends", np.int64), ("dictionary", np.uint8)):
            array = getattr(self, name)
            if array.ndim != 1 or array.dtype != kind:
                raise ValueError(
                    f"expected {name} of silhouettes as a row of {np.dtype(kind)}, "
                    f"got {array.dtype} of shape {array.shape}"
                )
        if len(self.ends) == 0 or (np.diff(self.ends, prepend=0) <= 0).any():
            raise ValueError("expected ascending ends of silhouettes")
        if self.ends[-1] != len(self.data):
            raise ValueError(f"expected {self.ends[-1]} bytes of silhouettes, got {len(self.data)}")

    def select(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Silhouettes:
        starts = np.concatenate([[0], self.ends[:-1]])[rows]
        ends = self.ends[rows]
        spans = zip(starts.tolist(), ends.tolist(), strict=True)
        data = np.concatenate([self.data[:0], *(self.data[start:end] for start, end in spans)])
        return replace(self, data=data, ends=np.cumsum(ends - starts, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.ends)

    def take(self, numbers: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Decompress silhouettes: ``(B, 128, 48)`` uint8 of 0 and 1.

        Raises
        ------
        IndexError
            If there is no such silhouette.
        """
        dictionary, size = self.dictionary.tobytes(), PACKED_BYTES // self.step**2
        columns = np.empty((len(numbers), size), np.uint8)
        for row, number in zip(columns, numbers, strict=True):
            if not 0 <= number < len(self):
                raise IndexError(f"expected a silhouette below {len(self)}, got {number}")
            start = self.ends[number - 1] if number else 0
            unpacker = zlib.decompressobj(RAW_DEFLATE, zdict=dictionary)
            row[:] = np.frombuffer(
                unpacker.decompress(self.data[start : self.ends[number]].tobytes(), size), np.uint8
            )
        return _from_columns(columns, self.step)


def _from_columns(columns: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Unpack silhouettes stored by columns of bytes, and enlarge to ``(B, 128, 48)``."""
    packed = columns.reshape(len(columns), WIDTH // 8 // step, HEIGHT // step).swapaxes(1, 2)
    silhouettes = np.unpackbits(packed, axis=2)
    return silhouettes if step == 1 else _double(silhouettes)


def _double(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Enlarge silhouettes ``(B, H, W)`` to twice the size by Scale2x [1]_, which smooths stairs.

    Each quarter of a pixel takes the value of its two neighbours if they agree and differ from the
    opposite two.

    References
    ----------
    .. [1] A. Mazzoleni, "Scale2x", 2001; https://www.scale2x.it/algorithm
    """
    around = np.pad(silhouettes, ((0, 0), (1, 1), (1, 1)), mode="edge")
    above, below = around[:, :-2, 1:-1], around[:, 2:, 1:-1]
    left, right = around[:, 1:-1, :-2], around[:, 1:-1, 2:]
    count, height, width = silhouettes.shape
    doubled = np.empty((count, 2 * height, 2 * width), np.uint8)
    for row, near, far in ((0, above, below), (1, below, above)):
        for column, beside, opposite in ((0, left, right), (1, right, left)):
            corner = (near == beside) & (near != far) & (beside != opposite)
            doubled[:, row::2, column::2] = np.where(corner, near, silhouettes)
    return doubled
