"""Silhouettes in memory, each compressed separately and decompressed on demand."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, unpack

PACKED_BYTES = HEIGHT * WIDTH // 8

_WINDOW_BYTES = 32 * 1024
"""Distance over which deflate looks back; a longer dictionary would be useless."""

_BLOCK = 4096
"""Silhouettes decompressed at a time."""

_LEVEL = 6
_RAW_DEFLATE = -15
"""Selects neither header nor checksum, since the artefact has its own."""


@dataclass(frozen=True)
class Silhouettes:
    """Normalised silhouettes, deflated separately with a shared dictionary.

    They take a sixth of their packed size; decompressing one takes microseconds.

    Parameters
    ----------
    data : (B,) uint8 array
        The deflated silhouettes, concatenated.
    ends : (E,) int64 array
        End of each silhouette in ``data``; ascending, the last is B.
    dictionary : (D,) uint8 array
    step : int
        Pixels of the normalised frame for each stored pixel, along both axes: 1, or 2 after
        :meth:`halved`.
    """

    data: NDArray[np.uint8]
    ends: NDArray[np.int64]
    dictionary: NDArray[np.uint8]
    step: int = 1

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

    @classmethod
    def compress(cls, bits: NDArray[np.uint8]) -> Silhouettes:
        """Compress silhouettes packed by :func:`descriptor.silhouette.pack`, ``(E, 768)``."""
        if bits.ndim != 2 or bits.shape[1] != PACKED_BYTES or len(bits) == 0:
            raise ValueError(f"expected silhouettes of shape (E, {PACKED_BYTES}), got {bits.shape}")
        dictionary = _by_columns(unpack(bits[sampled(len(bits))])).ravel()
        blocks = (
            _by_columns(unpack(bits[start : start + _BLOCK]))
            for start in range(0, len(bits), _BLOCK)
        )
        return cls(*_deflate(blocks, dictionary))

    def halved(self) -> Silhouettes:
        """The same at half the resolution, in half the bytes: outlines move by 0.3 px."""
        if self.step != 1:
            raise ValueError("expected silhouettes at full resolution, got halved ones")
        blocks = [
            _by_columns(_halve(self.take(np.arange(start, min(start + _BLOCK, len(self))))))
            for start in range(0, len(self), _BLOCK)
        ]
        dictionary = np.concatenate(blocks)[sampled(len(self), step=2)].ravel()
        return Silhouettes(*_deflate(blocks, dictionary), step=2)

    def select(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Silhouettes:
        """Some silhouettes, still compressed."""
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
            unpacker = zlib.decompressobj(_RAW_DEFLATE, zdict=dictionary)
            row[:] = np.frombuffer(
                unpacker.decompress(self.data[start : self.ends[number]].tobytes(), size), np.uint8
            )
        return _from_columns(columns, self.step)


def sampled(count: int, *, step: int = 1) -> NDArray[np.int64]:
    """Evenly spaced rows of ``count`` silhouettes, which make up their dictionary."""
    fitting = _WINDOW_BYTES * step**2 // PACKED_BYTES
    return np.linspace(0, count - 1, min(count, fitting)).astype(np.int64)


def _deflate(
    blocks: Iterable[NDArray[np.uint8]], dictionary: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8]]:
    """Compress each row of each block; returns data, ends and dictionary."""
    fresh = zlib.compressobj(_LEVEL, zlib.DEFLATED, _RAW_DEFLATE, 9, zdict=dictionary.tobytes())
    parts = []
    for block in blocks:
        for row in block:
            packer = fresh.copy()
            parts.append(packer.compress(row.tobytes()) + packer.flush())
    ends = np.cumsum([len(part) for part in parts], dtype=np.int64)
    return np.frombuffer(b"".join(parts), np.uint8), ends, dictionary


def _halve(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Silhouettes ``(B, 64, 24)``: the majority of four pixels, or the first pixel in a tie."""
    blocks = silhouettes.reshape(len(silhouettes), HEIGHT // 2, 2, WIDTH // 2, 2)
    return np.asarray(2 * blocks.sum(axis=(2, 4)) + blocks[:, :, 0, :, 0] > 4, np.uint8)


def _by_columns(silhouettes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pack silhouettes ``(B, H, W)``, one column of bytes after the other.

    Outlines are mostly vertical and compress better in this order.
    """
    packed = np.packbits(silhouettes, axis=2).swapaxes(1, 2)
    return np.ascontiguousarray(packed).reshape(len(silhouettes), -1)


def _from_columns(columns: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Undo :func:`_by_columns`, and enlarge to ``(B, 128, 48)``."""
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
