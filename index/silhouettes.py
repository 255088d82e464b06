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
    def compress(
        cls, bits: NDArray[np.uint8], sample: NDArray[np.uint8] | None = None
    ) -> Silhouettes:
        """Compress silhouettes packed by :func:`descriptor.silhouette.pack`, ``(E, 768)``.

        Parameters
        ----------
        bits : (E, 768) uint8 array
        sample : (S, 768) uint8 array, optional
            Silhouettes that make the dictionary; by default :func:`sampled` ones of ``bits``.
        """
        if bits.ndim != 2 or bits.shape[1] != PACKED_BYTES or len(bits) == 0:
            raise ValueError(f"expected silhouettes of shape (E, {PACKED_BYTES}), got {bits.shape}")
        columns = _by_columns(bits)
        dictionary = _by_columns(bits[sampled(len(bits))] if sample is None else sample).ravel()
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

    @classmethod
    def joined(cls, parts: Sequence[Silhouettes]) -> Silhouettes:
        """Put silhouettes of the same dictionary one after another."""
        first = parts[0]
        if any(not np.array_equal(part.dictionary, first.dictionary) for part in parts):
            raise ValueError("expected silhouettes of the same dictionary")
        lengths = np.concatenate([np.diff(part.ends, prepend=0) for part in parts])
        data = np.concatenate([part.data for part in parts])
        return cls(data, np.cumsum(lengths, dtype=np.int64), first.dictionary)

    def select(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Silhouettes:
        """Some silhouettes, still compressed."""
        starts = np.concatenate([[0], self.ends[:-1]])[rows]
        ends = self.ends[rows]
        spans = zip(starts.tolist(), ends.tolist(), strict=True)
        data = np.concatenate([self.data[:0], *(self.data[start:end] for start, end in spans)])
        return Silhouettes(data, np.cumsum(ends - starts, dtype=np.int64), self.dictionary)

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


def sampled(count: int) -> NDArray[np.int64]:
    """Rows of ``count`` silhouettes that make their dictionary: spread evenly."""
    return np.linspace(0, count - 1, min(count, _DICTIONARY_SILHOUETTES)).astype(np.int64)


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
