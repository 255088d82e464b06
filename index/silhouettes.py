"""Silhouettes in memory, each compressed separately and decompressed on demand."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptor.silhouette import HEIGHT, WIDTH, unpack

PACKED_BYTES = HEIGHT * WIDTH // 8

_DICTIONARY_SILHOUETTES = 42
"""As many as fit into the 32 KiB window of deflate."""

_LEVEL = 6
_RAW_DEFLATE = -15
"""No header and no checksum, since the artefact has its own."""


@dataclass(frozen=True)
class Silhouettes:
    """Normalised silhouettes, deflated separately with a shared dictionary.

    A sixth of the packed size; decompressing a silhouette takes microseconds.

    Parameters
    ----------
    data : (B,) uint8 array
        The deflated silhouettes, concatenated.
    ends : (E,) int64 array
        End of each in ``data``; ascending, the last is B.
    dictionary : (D,) uint8 array
    """

    data: NDArray[np.uint8]
    ends: NDArray[np.int64]
    dictionary: NDArray[np.uint8]

    def __post_init__(self) -> None:
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
        columns = _by_columns(bits)
        sample = np.linspace(0, len(bits) - 1, min(len(bits), _DICTIONARY_SILHOUETTES)).astype(int)
        dictionary = columns[sample].ravel()
        fresh = zlib.compressobj(_LEVEL, zlib.DEFLATED, _RAW_DEFLATE, 9, zdict=dictionary.tobytes())
        parts = []
        for row in columns:
            packer = fresh.copy()
            parts.append(packer.compress(row.tobytes()) + packer.flush())
        return cls(
            np.frombuffer(b"".join(parts), np.uint8),
            np.cumsum([len(part) for part in parts], dtype=np.int64),
            dictionary,
        )

    def __len__(self) -> int:
        return len(self.ends)

    def take(self, numbers: Sequence[int] | NDArray[np.integer]) -> NDArray[np.uint8]:
        """Decompress silhouettes: ``(B, 128, 48)`` uint8 of 0 and 1.

        Raises
        ------
        IndexError
            If there is no such silhouette.
        """
        dictionary = self.dictionary.tobytes()
        rows = np.empty((len(numbers), PACKED_BYTES), np.uint8)
        for row, number in zip(rows, numbers, strict=True):
            if not 0 <= number < len(self):
                raise IndexError(f"expected a silhouette below {len(self)}, got {number}")
            start = self.ends[number - 1] if number else 0
            unpacker = zlib.decompressobj(_RAW_DEFLATE, zdict=dictionary)
            row[:] = np.frombuffer(
                unpacker.decompress(self.data[start : self.ends[number]].tobytes(), PACKED_BYTES),
                np.uint8,
            )
        return unpack(_by_rows(rows))


def _by_columns(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reorder bytes column by column: most outlines are vertical, which compresses better."""
    return np.ascontiguousarray(bits.reshape(len(bits), HEIGHT, WIDTH // 8).swapaxes(1, 2)).reshape(
        bits.shape
    )


def _by_rows(columns: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo :func:`_by_columns`."""
    return np.ascontiguousarray(
        columns.reshape(len(columns), WIDTH // 8, HEIGHT).swapaxes(1, 2)
    ).reshape(columns.shape)
