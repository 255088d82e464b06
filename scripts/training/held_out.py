"""The clips that experiments ask for: neither the shipped network nor their index knows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from index import DEFAULT_PATH
from index.artefact import load_index, save_index
from index.build.builder import Plan, build, split_by_clip
from index.build.motion import Segment, read_manifest
from index.reranker import RankingModel, load_reranker
from index.store import PoseIndex

ALSO_HELD_OUT = ("m2m_Crouch_Fwd_Loop", "m2m_Tired_Hunched")
"""Clips near the ground whose actions have too few clips for one to be held out of each."""


def hold_out(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment]]:
    """Return the segments that may be learned from, and those that are held out."""
    kept, _ = split_by_clip(segments)
    clips = {s.clip for s in kept}.difference(ALSO_HELD_OUT)
    return [s for s in segments if s.clip in clips], [s for s in segments if s.clip not in clips]


def strict_index(shared: Path, folder: Path | None) -> PoseIndex:
    """Return an index built as the shipped one is, without the held-out clips, and its network.

    Parameters
    ----------
    shared : Path
        Folder with ``mocap/`` and ``garments/``.
    folder : Path or None
        Keeps the index from one run to the next.
    """
    kept, held = hold_out(read_manifest(shared / "mocap"))
    if folder is not None and folder.exists():
        index = load_index(folder)
    else:
        index = build(
            shared / "mocap", shared / "garments", Plan(), name="strict", segments=kept,
            progress=True, say=print,
        )  # fmt: skip
        if folder is not None:
            save_index(index, folder)
    return replace(index, reranker=shipped_reranker(held))


def shipped_reranker(held: Sequence[Segment]) -> RankingModel | None:
    """Return the network beside the default index; a ValueError if it knows a held-out clip."""
    reranker = load_reranker(DEFAULT_PATH)
    if reranker is not None:
        known = {segment.clip for segment in held}.intersection(reranker.training["clips"])
        if known:
            raise ValueError(
                f"the network beside {DEFAULT_PATH} was trained on held-out clips: "
                f"{', '.join(sorted(known))}"
            )
    return reranker
