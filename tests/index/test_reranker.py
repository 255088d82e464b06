"""The files of a network beside an index."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from numpy.testing import assert_allclose, assert_array_equal

from index.artefact import load_index
from index.build.writer import save_index, save_reranker
from index.files import ArtefactError
from index.reranker import RERANKING_JSON, RERANKING_NPZ, RankingModel, load_reranker
from index.store import PoseIndex
from tests.support.programs import output_of


@pytest.fixture
def saved(toy_index: PoseIndex, reranker: RankingModel, tmp_path: Path) -> Path:
    folder = tmp_path / "artefact"
    save_index(toy_index, folder)
    save_reranker(reranker, folder)
    return folder


def test_saved_network_is_loaded(saved: Path, reranker: RankingModel) -> None:
    back = load_index(saved).reranker
    assert back is not None
    assert back.calibration == reranker.calibration
    assert back.training == reranker.training
    assert_array_equal(back.network.layers[-1].offsets, reranker.network.layers[-1].offsets)


def test_saving_a_network_does_not_change_the_index(
    toy_index: PoseIndex, reranker: RankingModel, tmp_path: Path
) -> None:
    version = save_index(toy_index, tmp_path / "index")
    before = {file: file.read_bytes() for file in (tmp_path / "index").iterdir()}
    save_reranker(reranker, tmp_path / "index")
    assert load_index(tmp_path / "index").version == version
    assert all(file.read_bytes() == content for file, content in before.items())


def test_index_is_saved_with_its_network(reranked: PoseIndex, saved: Path, tmp_path: Path) -> None:
    save_index(reranked, tmp_path / "again")
    assert all(
        (tmp_path / "again" / name).read_bytes() == (saved / name).read_bytes()
        for name in (RERANKING_JSON, RERANKING_NPZ)
    )


def test_index_without_a_network(toy_index: PoseIndex, tmp_path: Path) -> None:
    save_index(toy_index, tmp_path / "plain")
    assert load_reranker(tmp_path / "plain") is None
    assert load_index(tmp_path / "plain").reranker is None


def altered(content: bytes) -> bytes:
    return content[:1000] + bytes([content[1000] ^ 1]) + content[1001:]


def manifest_with(**changed: object) -> Callable[[bytes], bytes]:
    return lambda content: json.dumps({**json.loads(content), **changed}).encode()


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        (RERANKING_NPZ, altered, "reranking.npz was altered: its SHA-256 does not fit"),
        (RERANKING_NPZ, None, "reranking.npz cannot be read: No such file"),
        (RERANKING_JSON, None, "lacks its manifest reranking.json"),
        *((RERANKING_JSON, lambda _, text=text: text, "reranking.json")
          for text in (b"", b"[]", b"{}", b'{"format_version": 2}')),
        (RERANKING_JSON, manifest_with(format_version=9), "this service reads format 2"),
        (RERANKING_JSON,
         manifest_with(confidence={"features": ["shoe_size"], "weights": [1], "bias": 0}),
         "expected a calibration over"),
    ],
)  # fmt: skip
def test_damaged_network_is_refused_in_one_sentence(
    saved: Path, file: str, change: Callable[[bytes], bytes] | None, said: str
) -> None:
    if change is None:
        (saved / file).unlink()
    else:
        (saved / file).write_bytes(change((saved / file).read_bytes()))
    with pytest.raises(ArtefactError, match=said) as error:
        load_index(saved)
    assert "\n" not in str(error.value)


def test_number_of_threads_does_not_matter(reranked: PoseIndex, tmp_path: Path) -> None:
    """Log-likelihoods on one thread and on two are the same but for their own sums."""
    save_index(reranked, tmp_path / "index")
    code = (
        "import sys, numpy as np\n"
        "from pathlib import Path\n"
        "from index.artefact import load_index\n"
        "from index.network import joint_positions\n"
        "index = load_index(Path(sys.argv[1]))\n"
        "seen = index.reranker.network.distributions(index.silhouette(3))\n"
        "positions = joint_positions(*index.points(np.arange(50)))\n"
        "print(*seen.log_likelihood(positions).tolist())\n"
    )
    answers = []
    for threads in ("1", "2"):
        limits = {"OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        said = output_of(sys.executable, "-c", code, tmp_path / "index", **limits)
        answers.append([float(word) for word in said.split()])
    assert_allclose(*answers, rtol=1e-12)
