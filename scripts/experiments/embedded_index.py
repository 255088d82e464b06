"""Searches in the process of the service, by size: exact, inverted lists, HNSW."""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import json
import multiprocessing
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from index.approximate import METHODS, ApproximateNeighbours, method_of
from index.artefact import load_index
from index.build.calibrate import HYPOTHESES, OWN_ROLL_DEG, Queries
from index.keypoints import Keypoints
from index.landmark_search import (
    DIMENSION,
    SEARCHED,
    LandmarkSearch,
    pose_vectors,
    rotate_clockwise,
)
from index.matching import CANDIDATES, Match, match
from index.neighbours import STEPS, ExactNeighbours, Neighbours
from index.skeleton import JOINTS, POINT_NAMES
from index.store import DEFAULT_PATH, PoseIndex
from index.verified_files import read_bytes
from scripts.experiments.embedded_index_report import report

COMMAND = "python -m scripts.evaluate embedded"
SHIPPED = 198_000
SIZES = (10_000, 100_000, SHIPPED, 1_000_000, 3_000_000, 10_000_000)
LARGEST_GRAPH = 1_000_000
"""HNSW links a few thousand vectors a second."""

SETTINGS: dict[str, tuple[dict[str, int], ...]] = {
    "ivf": ({"nprobe": 16}, {"nprobe": 64}, {"nprobe": 256}),
    "hnsw": ({"ef_search": 160}, {"ef_search": 256}, {"ef_search": 640}),
}
JITTER_STEPS = 3.0
"""Standard deviation of each value of a copy, in steps: two copies of a vector are then about 29
steps apart, less than neighbours in the shipped index."""

QUERIES, SEED = 200, 21
TRUE_FIRST, TRUE_FOUND = 1, 150
WITHIN_S = 8.0
"""Searches are repeated for about this long, 5 to 200 times."""

KEYPOINT_NOISE_PX, LANDMARK_NOISE_M = 3.0, 0.05
HIPS = [POINT_NAMES.index("left_hip"), POINT_NAMES.index("right_hip")]
_BLOCK = 100_000

Figures = dict[str, Any]


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Where searches are kept between runs, and how large they become."""
    parser.add_argument("--work", type=Path, default=Path("/tmp/embedded-index"))
    parser.add_argument("--largest", type=int, default=SIZES[-1])


def run(options: argparse.Namespace) -> None:
    """Measure all cases not yet measured in ``--work`` and write ``embedded-index.md``."""
    work: Path = options.work
    work.mkdir(parents=True, exist_ok=True)
    sizes = [size for size in SIZES if size <= options.largest]
    cases: list[tuple[str, Callable[..., Figures], tuple[Any, ...]]] = [
        ("vectors", make_vectors, (work, sizes[-1])),
        ("memory", memory_of_the_rest, ()),
    ]
    cases += [(f"flat-{size}", measure_flat, (work, size)) for size in sizes]
    cases += [(f"landmarks-{size}", measure_landmarks, (size,)) for size in sizes]
    cases += [
        (f"{kind}-{size}{part}", measure, (work, kind, size))
        for size in sizes
        for kind in METHODS
        for part, measure in (("-build", build), ("", measure_approximate))
        if kind != "hnsw" or size <= LARGEST_GRAPH
    ]
    cases.append(("answers", answers, ()))
    figures = {name: in_process(work, name, case, given) for name, case, given in tqdm(cases)}
    report(figures, sizes, COMMAND, options.out)


def in_process(
    work: Path, name: str, case: Callable[..., Figures], given: Sequence[Any]
) -> Figures:
    """Measure a case in a fresh process, unless ``work`` has its figures."""
    file = work / f"{name}.json"
    if not file.exists():
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            file.write_text(json.dumps(pool.apply(case, given)))
    figures: Figures = json.loads(file.read_text())
    return figures


def make_vectors(work: Path, count: int) -> Figures:
    """Write ``count`` vectors, those of the shipped index and jittered copies, and queries.

    Queries are degraded silhouettes of entries and their mirror images.
    """
    index = load_index(DEFAULT_PATH)
    real = index.vectors.astype(np.float32) * STEPS
    generator = np.random.default_rng(SEED)
    vectors = np.lib.format.open_memmap(
        work / "vectors.npy", "w+", np.float16, (count, real.shape[1])
    )
    for start in range(0, count, _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, count))
        jitter = generator.standard_normal((len(rows), real.shape[1]), np.float32) * JITTER_STEPS
        jitter[rows < len(real)] = 0
        vectors[rows] = np.rint(real[rows % len(real)] + jitter).clip(-127, 127) / STEPS
    queries = index.descriptor.describe(degraded_queries(index).silhouettes)
    pairs = np.stack([queries, index.descriptor.mirror(queries)], axis=1)
    np.save(work / "queries.npy", pairs.astype(np.float32))
    return {
        "queries": len(pairs),
        "shipped": len(real),
        "neighbour_steps": neighbour_steps(index),
    }


def neighbour_steps(index: PoseIndex) -> float:
    """Median distance of an entry's vector to the nearest other one, in steps."""
    numbers = np.random.default_rng(SEED).choice(len(index), QUERIES, replace=False)
    vectors = index.vectors[numbers].astype(np.float32)
    distances, _, _ = index.search(vectors[:, None], 2)
    return float(np.median(distances[:, 1]) * STEPS)


def degraded_queries(index: PoseIndex) -> Queries:
    """Silhouettes of entries as if they had been cut out of photographs.

    All are of the smallest size's entries, so that each index holds the poses asked for.
    """
    numbers = np.sort(np.random.default_rng(SEED).choice(SIZES[0], QUERIES, replace=False))
    points_3d, points = index.points(numbers)
    roll_deg = index.roll_deg(numbers, np.zeros(QUERIES, bool))
    roll_deg = np.where(np.abs(roll_deg) > OWN_ROLL_DEG, roll_deg, 0.0)
    joints_3d = [
        rotate_clockwise(joints, -angle)
        for joints, angle in zip(points_3d[:, :JOINTS], roll_deg, strict=True)
    ]
    silhouettes = index.silhouettes(numbers)
    return Queries(silhouettes, points[:, :JOINTS], np.array(joints_3d), roll_deg).degraded(SEED)


def read_vectors(work: Path, size: int) -> NDArray[np.float16]:
    """The first vectors, mapped from the file."""
    vectors: NDArray[np.float16] = np.load(work / "vectors.npy", mmap_mode="r")[:size]
    return vectors


def measure_flat(work: Path, size: int) -> Figures:
    """Measure the exact search, and keep what it finds as the truth."""
    vectors, queries = read_vectors(work, size), np.load(work / "queries.npy")
    before, started = anonymous_mib(), time.process_time()
    search = ExactNeighbours(vectors)
    load_s = time.process_time() - started
    figures = {"load_s": load_s, "mib": anonymous_mib() - before}
    figures |= timed_search(search, queries)
    _, numbers = search.search(queries.reshape(-1, queries.shape[2]), TRUE_FOUND)
    np.save(work / f"truth-{size}.npy", numbers)
    return figures


def build(work: Path, kind: str, size: int) -> Figures:
    """Train or link a search and write its file."""
    vectors = read_vectors(work, size)
    started = time.process_time()
    built = ApproximateNeighbours.build(vectors, METHODS[kind].suited(size))
    build_s = time.process_time() - started
    content = built.to_bytes()
    (work / f"{kind}-{size}.faiss").write_bytes(content)
    sha256 = hashlib.sha256(content).hexdigest()
    return {"build_s": build_s, "bytes": len(content), "sha256": sha256, **built.parameters()}


def measure_approximate(work: Path, kind: str, size: int) -> Figures:
    """Load a search and measure it at each of :data:`SETTINGS`."""
    vectors, queries = read_vectors(work, size), np.load(work / "queries.npy")
    truth = np.load(work / f"truth-{size}.npy")
    built = json.loads((work / f"{kind}-{size}-build.json").read_text())
    file = work / f"{kind}-{size}.faiss"
    before, started = anonymous_mib(), time.process_time()
    method = method_of({name: built[name] for name in ("kind", *vars(METHODS[kind].suited(size)))})
    search = restored(file, built["sha256"], method, vectors)
    figures: Figures = {"load_s": time.process_time() - started, "mib": anonymous_mib() - before}
    settings = []
    for setting in SETTINGS[kind]:
        if setting.get("nprobe", 0) > built.get("nlist", 0):
            continue
        del search
        search = restored(file, built["sha256"], replace(method, **setting), vectors)  # type: ignore[arg-type]
        _, found = search.search(queries.reshape(-1, queries.shape[2]), TRUE_FOUND)
        settings.append(
            {
                **setting,
                **timed_search(search, queries),
                "recall_first": recall(truth[:, :TRUE_FIRST], found),
                "recall_150": recall(truth, found),
            }
        )
    return {**figures, "settings": settings}


def restored(
    file: Path, sha256: str, method: Any, vectors: NDArray[np.floating]
) -> ApproximateNeighbours:
    """Read a search as the artefact does."""
    parameters = {"kind": method.kind, **vars(method)}
    return ApproximateNeighbours.restore(parameters, read_bytes(file, sha256), vectors)


def recall(true: NDArray[np.int64], found: NDArray[np.int64]) -> float:
    """Share of the true neighbours ``(Q, T)`` among those found ``(Q, k)``."""
    return float(np.mean([np.isin(a, b).mean() for a, b in zip(true, found, strict=True)]))


def timed_search(search: Neighbours, queries: NDArray[np.float32]) -> Figures:
    """Time searches as the service asks: for a silhouette and its mirror image."""
    return timed(lambda number: search.search(queries[number % len(queries)], CANDIDATES))


def timed(ask: Callable[[int], object]) -> Figures:
    """Milliseconds of calls, after one that is not counted: fastest tenth and median.

    Of processor time, as everywhere here, because the machine has other work.
    """
    ask(0)
    times: list[float] = []
    while len(times) < 200 and (sum(times) < WITHIN_S or len(times) < 5):
        started = time.process_time()
        ask(len(times))
        times.append(1e3 * (time.process_time() - started))
    return {"ms": float(np.percentile(times, 10)), "median_ms": float(np.median(times))}


def measure_landmarks(size: int) -> Figures:
    """Measure the search by landmarks among copies of the shipped index's skeletons."""
    index = load_index(DEFAULT_PATH)
    numbers = np.arange(len(index))
    limbs = np.concatenate(
        [index.points(part, SEARCHED)[0] for part in np.array_split(numbers, 20)]
    )
    asked = noisy_limbs(limbs)
    vectors = pose_vectors(limbs)
    search = LandmarkSearch(np.resize(vectors, (size, vectors.shape[1])))
    del index, limbs, vectors
    return timed(lambda number: search.nearest(asked[number % len(asked)], (0.0,), TRUE_FOUND))


def noisy_limbs(limbs: NDArray[np.floating]) -> NDArray[np.float64]:
    """Landmarks near the limbs of some of the entries."""
    rng = np.random.default_rng(SEED)
    chosen = limbs[rng.choice(len(limbs), QUERIES, replace=False)]
    return np.asarray(chosen + rng.normal(0, LANDMARK_NOISE_M, chosen.shape), np.float64)


def noisy_keypoints(queries: Queries) -> list[Keypoints]:
    """Keypoints near the limbs of each query, in the picture and in depth."""
    rng = np.random.default_rng(SEED)
    rows = list(SEARCHED)
    sure = np.ones(len(rows))
    places = queries.joints_2d[:, rows]
    places = places + rng.normal(0, KEYPOINT_NOISE_PX, places.shape)
    limbs = queries.joints_3d[:, rows] - queries.joints_3d[:, HIPS].mean(axis=1, keepdims=True)
    limbs = limbs + rng.normal(0, LANDMARK_NOISE_M, limbs.shape)
    return [
        Keypoints(SEARCHED, place, sure, rotate_clockwise(limb, roll_deg), sure)
        for place, limb, roll_deg in zip(places, limbs, queries.roll_deg.tolist(), strict=True)
    ]


def memory_of_the_rest(size: int = 1_000_000) -> Figures:
    """Bytes an entry of everything in a PoseIndex but the search; resident memory at ``size``."""
    index = load_index(DEFAULT_PATH)
    store = index.silhouette_store
    parts = {
        "vectors": index.vectors.nbytes,
        "entries": index.entries.nbytes,
        "skeletons": index.skeletons.nbytes + index.skeleton_labels.nbytes,
        "silhouettes": store.data.nbytes + store.ends.nbytes,
        "landmark search": len(index.landmark_search) * DIMENSION,
    }
    times = -(-size // len(index))
    before = anonymous_mib()
    # Each copy has skeletons of its own.
    entries = np.tile(index.entries, times)
    entries["skeleton"] += np.repeat(
        np.arange(times, dtype=np.uint32) * len(index.skeletons), len(index)
    )
    ends = np.concatenate([store.ends + i * len(store.data) for i in range(times)])
    grown = replace(
        index,
        vectors=np.tile(index.vectors, (times, 1)),
        entries=entries,
        skeletons=np.tile(index.skeletons, (times, 1, 1)),
        skeleton_labels=np.tile(index.skeleton_labels, times),
        silhouette_store=replace(store, data=np.tile(store.data, times), ends=ends),
    )
    del entries, ends
    resident = (anonymous_mib() - before) * 2**20 / len(grown)
    return {
        "entries": len(grown),
        "bytes": {name: size / len(index) for name, size in parts.items()},
        "resident_bytes_with_flat_search": resident,
    }


class Counted:
    """A search that counts the vectors it is asked for."""

    def __init__(self, search: Neighbours) -> None:
        self.search_of, self.asked = search, [0]

    def __len__(self) -> int:
        return len(self.search_of)

    def search(
        self, queries: NDArray[np.float32], k: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Count and search."""
        self.asked.append(len(queries))
        return self.search_of.search(queries, k)


def answers() -> Figures:
    """What approximation does to the answers of the shipped index, without and with keypoints."""
    index = load_index(DEFAULT_PATH)
    exact = Counted(index.neighbours)
    searches: dict[str, Neighbours] = {"flat": exact}
    for kind, settings in SETTINGS.items():
        method: Any = METHODS[kind].suited(len(index))
        built = ApproximateNeighbours.build(index.vectors, method)
        content = np.frombuffer(built.to_bytes(), np.uint8)
        for setting in settings:
            name = f"{kind} " + " ".join(f"{key}={value}" for key, value in setting.items())
            parameters = {**built.parameters(), **setting}
            searches[name] = ApproximateNeighbours.restore(parameters, content, index.vectors)
    queries = degraded_queries(index)
    figures: Figures = {"vectors_a_search": {}, "rows": []}
    for evidence in ("silhouette", "keypoints"):
        asked: Sequence[Keypoints | None] = [None] * len(queries)
        if evidence == "keypoints":
            asked = noisy_keypoints(queries)
        exact.asked.clear()
        first: dict[str, list[Match]] = {}
        for name, search in searches.items():
            searched = replace(index, searched_by=search)
            first[name] = [
                match(searched, silhouette, HYPOTHESES, keypoints, roll_deg=roll_deg)
                for silhouette, keypoints, roll_deg in zip(
                    queries.silhouettes, asked, queries.roll_deg.tolist(), strict=True
                )
            ]
            figures["rows"].append(
                {"evidence": evidence, "search": name,
                 **compared(first["flat"], first[name], queries.joints_3d)}
            )  # fmt: skip
        figures["vectors_a_search"][evidence] = float(np.mean(exact.asked))
    return figures


def compared(
    exact: list[Match], other: list[Match], joints_3d: NDArray[np.floating]
) -> dict[str, float]:
    """Compare the first hypotheses of two searches with each other and with the truth."""
    pairs = [(a.hypotheses[0], b.hypotheses[0]) for a, b in zip(exact, other, strict=True)]
    found = np.array([b.points_3d[:JOINTS] for _, b in pairs])
    best = np.array(
        [
            min(_apart_mm(h.points_3d[:JOINTS], truth) for h in m.hypotheses[:HYPOTHESES])
            for m, truth in zip(other, joints_3d, strict=True)
        ]
    )
    return {
        "same_first": float(
            np.mean([(a.entry, a.mirrored) == (b.entry, b.mirrored) for a, b in pairs])
        ),
        "apart_mm": float(np.mean([_apart_mm(a.points_3d, b.points_3d) for a, b in pairs])),
        "first_mm": _apart_mm(found, joints_3d),
        "best_mm": float(best.mean()),
    }


def _apart_mm(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    return float(1e3 * np.linalg.norm(a - b, axis=-1).mean())


def anonymous_mib() -> float:
    """Resident memory of this process that no file backs, MiB."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024
