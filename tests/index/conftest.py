"""Indexes of stick figures that move, and of some that lie as well."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from index.artefact import load_index
from index.network import RankingModel
from index.store import PoseIndex
from tests.conftest import INDEXES
from tests.index.helpers import random_reranker


@pytest.fixture(scope="session")
def toy_index() -> PoseIndex:
    """576 silhouettes of moving figures."""
    return load_index(INDEXES / "toy")


@pytest.fixture(scope="session")
def ground_index() -> PoseIndex:
    """Silhouettes of figures, most of them lying on the back, the belly or a side."""
    return load_index(INDEXES / "ground")


@pytest.fixture(scope="session")
def reranker() -> RankingModel:
    return random_reranker()


@pytest.fixture(scope="session")
def reranked(toy_index: PoseIndex, reranker: RankingModel) -> PoseIndex:
    """The index of moving figures with such a network."""
    return replace(toy_index, reranker=reranker)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A copy of the folder of the index of moving figures, to spoil."""
    return shutil.copytree(INDEXES / "toy", tmp_path / "artefact")
