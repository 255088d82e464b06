"""What a frame, a session and an index cost, as measured; each number with its source."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from scripts.results import ROOT

PATH = ROOT / "docs" / "results" / "coefficients.json"


@dataclass(frozen=True)
class Coefficients:
    """Costs of the service.

    Parameters
    ----------
    pose_ms, pose_person_ms : float
        Milliseconds of one core for a photograph sent to ``/pose``: without people, and for each.
    searched_ms, searched_person_ms : float
        The same for a frame of a camera session that is searched as a whole.
    warm_ms, warm_person_ms : float
        The same for the other frames of a session.
    mask_ms : float
        For the mask of one person.
    spread : float
        Standard deviation of a frame's cost, as a share of it.
    resident_mb : float
        A process with the index that ships, without sessions.
    session_mb : float
        A camera session of six people.
    index_entry_bytes : float
    index_entries : int
        Of the index that ships.
    frame_kb : float
        A frame of 768x576 as JPEG, 1,000 bytes.
    search_ms : dict of str to tuple of (int, float)
        For each kind of index, the time of one search by number of entries; empty where nothing has
        been measured.
    """

    pose_ms: float
    pose_person_ms: float
    searched_ms: float
    searched_person_ms: float
    warm_ms: float
    warm_person_ms: float
    mask_ms: float
    spread: float
    resident_mb: float
    session_mb: float
    index_entry_bytes: float
    index_entries: int
    frame_kb: float
    search_ms: dict[str, tuple[tuple[int, float], ...]]

    def search(self, kind: str, entries: int) -> float:
        """Milliseconds of one search, interpolated between those measured (log-log).

        A flat index is searched exhaustively: beyond what was measured, in proportion.

        Raises
        ------
        ValueError
            If it would have to be guessed.
        """
        measured = self.search_ms.get(kind, ())
        if not measured:
            known = ", ".join(name for name, points in self.search_ms.items() if points)
            raise ValueError(
                f"expected a kind of index whose search was measured ({known}), got {kind}"
            )
        sizes, times = np.array(measured, float).T
        if kind == "flat" and entries > sizes[-1]:
            return float(times[-1] * entries / sizes[-1])
        if kind == "flat" and entries < sizes[0]:
            return float(times[0] * entries / sizes[0])
        if not sizes[0] <= entries <= sizes[-1]:
            raise ValueError(
                f"expected {sizes[0]:.0f} to {sizes[-1]:.0f} entries of {kind}, got {entries}"
            )
        return float(np.exp(np.interp(np.log(entries), np.log(sizes), np.log(times))))

    def larger_index_ms(self, kind: str, entries: int) -> float:
        """Milliseconds that a search of another index adds for each person."""
        return self.search(kind, entries) - self.search("flat", self.index_entries)

    def process_mb(self, entries: int) -> float:
        """Resident memory of a process with an index of this size."""
        return self.resident_mb + (entries - self.index_entries) * self.index_entry_bytes / 1e6


def read_coefficients(path: Path = PATH) -> Coefficients:
    """Read them from JSON: for each a ``value``, and the ``command`` and ``page`` it comes from.

    Raises
    ------
    ValueError
        If one is missing or unknown.
    """
    found = json.loads(path.read_text())
    expected = {field.name for field in fields(Coefficients)}
    if set(found) != expected:
        raise ValueError(
            f"{path}: expected {', '.join(sorted(expected))}; differs in "
            f"{', '.join(sorted(expected ^ set(found)))}"
        )
    values = {name: entry["value"] for name, entry in found.items()}
    values["search_ms"] = {
        kind: tuple((int(size), float(ms)) for size, ms in points)
        for kind, points in values["search_ms"].items()
    }
    return Coefficients(**values)
