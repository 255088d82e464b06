"""Measure the index in Milvus against the one in this process, and the service around it.

python -m scripts.load.milvus agreement latency outage switch --write
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pymilvus import DataType, MilvusClient
from tqdm import tqdm

from index.artefact import load_index, save_index
from index.build.noise import degrade
from index.milvus import Contents, Milvus, MilvusNeighbours
from index.milvus_publication import BATCH, publish
from index.neighbours import STEPS, ExactNeighbours, Neighbours, UnavailableError
from index.store import PoseIndex
from scripts.load.loops import BackgroundLoop
from scripts.load.milvus_server import MilvusProcess
from scripts.load.overload import calls
from scripts.load.server import ServerProcess
from scripts.results import ROOT, conclude, machine, measurement_parser, revision

PAGE = ROOT / "docs" / "results" / "milvus.md"

QUERIES = 1000
K = 150
NEAR_TIE = 1e-4
"""Relative difference of distances below which two entries may change places."""

SIZES = (10_000, 100_000, 1_000_000)
SHAPES = {
    "a silhouette": (2, 160),
    "a person with keypoints": (10, 150),
}
"""Queries and neighbours of each in one call: a silhouette and its mirror image, and five
rotations of it."""

REPEATS = 40
PAYLOAD_ROWS = 100_000
PAYLOAD = "x" * 200
"""About what a silhouette takes, compressed."""

SWITCHED_ENTRIES = 20_000

ALIAS = "measured"
CLIENTS = 2
TIMEOUT_S = 120.0


@contextmanager
def milvus_server() -> Iterator[MilvusProcess]:
    """A Milvus server in a folder that is removed afterwards."""
    with tempfile.TemporaryDirectory() as folder, MilvusProcess(Path(folder)) as server:
        server.wait_until_healthy()
        yield server


def queries_of(index: PoseIndex, count: int) -> NDArray[np.float32]:
    """Descriptors ``(count, D)`` of silhouettes of entries, degraded as in photographs."""
    rng = np.random.default_rng(0)
    numbers = rng.choice(len(index), count, replace=False)
    _, joints = index.points(numbers, slice(19))
    silhouettes = index.silhouettes(numbers)
    degraded = np.stack([degrade(*pair, rng)[0] for pair in zip(silhouettes, joints, strict=True)])
    return index.descriptor.describe(degraded)


def agreement(index: PoseIndex) -> str:
    """Ask FAISS and Milvus the same queries."""
    queries = queries_of(index, QUERIES)
    expected, entries = index.neighbours.search(queries, K + 1)
    with milvus_server() as server:
        milvus = Milvus(server.address, TIMEOUT_S)
        collection = publish(milvus, index, ALIAS, progress=tqdm)
        found = [
            milvus.search(collection.name, queries[start : start + 10], K)
            for start in range(0, QUERIES, 10)
        ]
    squared = np.concatenate([part for part, _ in found])
    numbers = np.concatenate([part for _, part in found])
    exact = np.sqrt(expected)
    # The last one may have a tie beyond the end.
    close = np.diff(exact, axis=1) <= NEAR_TIE * exact[:, 1:]
    tied = close.copy()
    tied[:, 1:] |= close[:, :-1]
    same = numbers == entries[:, :K]
    error = np.abs(np.sqrt(squared) - exact[:, :K]) / exact[:, :K]
    return f"""{QUERIES:,} silhouettes of entries, degraded as in photographs, {K} neighbours
of each among {len(index):,}: {np.mean(same | tied):.4%} of the places hold FAISS's entry or one
of a near tie (distances within {NEAR_TIE:g} of each other), {same.mean():.2%} the same entry.
{(same | tied).all(axis=1).sum():,} of {QUERIES:,} queries agree throughout. Distances differ by at
most {error.max():.1e} of their size."""


def grown(vectors: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """The first vectors, and behind all of them copies moved by a step."""
    rng = np.random.default_rng(1)
    parts: list[NDArray[np.float32]] = []
    left = size
    while left > 0:
        part = vectors[:left].copy()
        if parts:
            part += rng.integers(-1, 2, part.shape).astype(np.float32) / STEPS
        parts.append(part)
        left -= len(part)
    return np.concatenate(parts)


def milliseconds(*works: Callable[[int], object]) -> list[str]:
    """Time pieces of work in turn; return the fastest and (the median) of each.

    In turn, because other programs take the cores for seconds at a time.
    """
    times = np.empty((REPEATS, len(works)))
    for repeat in range(REPEATS):
        for column, work in enumerate(works):
            started = time.perf_counter()
            work(repeat)
            times[repeat, column] = (time.perf_counter() - started) * 1000
    return [
        f"{fastest:.1f} ({median:.1f})"
        for fastest, median in zip(times.min(axis=0), np.median(times, axis=0), strict=True)
    ]


def latency(index: PoseIndex) -> str:
    """Time searches by the number of entries, and what fetching a payload adds."""
    queries = queries_of(index, REPEATS * 10).reshape(REPEATS, 10, -1)
    rows = []
    with milvus_server() as server:
        milvus = Milvus(server.address, TIMEOUT_S)
        for size in SIZES:
            vectors = grown(index.vectors.astype(np.float32), size)
            contents = Contents("measured", f"sha256:{size:012d}", size, vectors.shape[1])
            milvus.create(contents, shards=1, replicas=1)
            started = time.perf_counter()
            for start in tqdm(range(0, size, BATCH), desc=f"{size}", unit="batch"):
                milvus.write(
                    contents.collection, start, vectors[start : start + BATCH], replace=False
                )
            milvus.finish(contents.collection, replicas=1)
            loaded_s = time.perf_counter() - started
            remote = MilvusNeighbours(milvus, contents.collection, size)
            wait_until_steady(remote, vectors)
            exact = ExactNeighbours(vectors)
            for shape, (count, k) in SHAPES.items():
                here, there = milliseconds(
                    partial(search, exact, queries[:, :count], k),
                    partial(search, remote, queries[:, :count], k),
                )
                rows.append(
                    f"| {size:,} | {shape} ({count} x {k}) | {here} | {there} | {loaded_s:.0f} s |"
                )
            del exact
            milvus.drop(contents.collection)
        payload = payload_rows(server, index, queries)
    return f"""Milliseconds of a search, the fastest and (the median) of {REPEATS}, FAISS and Milvus
in turn: where other programs keep the cores busy, the fastest are nearest to what a quiet machine
takes. Entries beyond {len(index):,} are copies of entries, moved by a step.
Loading: writing and storing all rows.

| entries | a call | FAISS, in process | Milvus, same machine | loading |
|---|---|---|---|---|
{chr(10).join(rows)}

What a call takes that fetches more than the numbers, of {PAYLOAD_ROWS:,} rows with a payload of
{len(PAYLOAD)} bytes, about what a silhouette takes:

| a call | numbers alone | with payload | with vector and payload |
|---|---|---|---|
{chr(10).join(payload)}"""


def wait_until_steady(remote: MilvusNeighbours, vectors: NDArray[np.float32]) -> None:
    """Wait until searches become no faster: Milvus takes stored rows over little by little."""
    best, since = np.inf, time.perf_counter()
    while time.perf_counter() - since < 5:
        started = time.perf_counter()
        remote.search(vectors[:2], 10)
        took = time.perf_counter() - started
        if took < 0.9 * best:
            best, since = took, time.perf_counter()


def payload_rows(
    server: MilvusProcess, index: PoseIndex, queries: NDArray[np.float32]
) -> list[str]:
    """Time calls that fetch more than numbers."""
    client = MilvusClient(f"http://{server.address}")
    schema = client.create_schema(auto_id=False)
    schema.add_field("number", DataType.INT64, is_primary=True)
    schema.add_field("vector", DataType.FLOAT_VECTOR, dim=queries.shape[2])
    schema.add_field("payload", DataType.VARCHAR, max_length=len(PAYLOAD))
    parameters = client.prepare_index_params()
    parameters.add_index("vector", index_type="FLAT", metric_type="L2")
    client.create_collection("payload", schema=schema)
    vectors = index.vectors[:PAYLOAD_ROWS].astype(np.float32)
    for start in tqdm(range(0, len(vectors), BATCH), desc="payload", unit="batch"):
        batch = vectors[start : start + BATCH].tolist()
        client.insert(
            "payload",
            [
                {"number": start + row, "vector": vector, "payload": PAYLOAD}
                for row, vector in enumerate(batch)
            ],
        )
    client.flush("payload")
    client.create_index("payload", parameters)
    client.load_collection("payload")
    rows = []
    for shape, (count, k) in SHAPES.items():
        cells = milliseconds(
            *(
                partial(fetch, client, queries[:, :count], k, fields)
                for fields in ([], ["payload"], ["vector", "payload"])
            )
        )
        rows.append(f"| {shape} ({count} x {k}) | {' | '.join(cells)} |")
    return rows


def search(neighbours: Neighbours, queries: NDArray[np.float32], k: int, repeat: int) -> None:
    """Search for the queries ``(REPEATS, Q, D)`` of a repetition."""
    neighbours.search(queries[repeat], k)


def fetch(
    client: MilvusClient, queries: NDArray[np.float32], k: int, fields: list[str], repeat: int
) -> None:
    """The same with further fields, by pymilvus alone."""
    client.search(
        "payload",
        queries[repeat].tolist(),
        limit=k,
        output_fields=fields,
        search_params={"metric_type": "L2"},
        consistency_level="Eventually",
    )


def service(server: MilvusProcess, artefacts: Path) -> ServerProcess:
    """The service with its index in Milvus."""
    return ServerProcess(
        artefacts,
        POSE_INDEX=f"milvus://{server.address}/{ALIAS}",
        POSE_ARTEFACTS=str(artefacts.resolve()),
    )


def outage(index: PoseIndex, path: Path) -> str:
    """Kill Milvus under load and start it again; then freeze it and let it go on."""
    requests = calls(index)["`/pose` with a mask"]
    events: dict[str, float] = {}
    with milvus_server() as server:
        milvus = Milvus(server.address, TIMEOUT_S)
        publish(milvus, index, ALIAS, progress=tqdm)
        probe = Milvus(server.address, 1.0)
        with service(server, path) as running:
            running.wait_until_ready()
            with BackgroundLoop(running.url, requests, CLIENTS) as load:

                def note(event: str) -> float:
                    events[event] = time.monotonic()
                    print(f"{events[event] - load.started:.1f} s: {event}", file=sys.stderr)
                    return events[event]

                time.sleep(5)
                killed = note("killed (SIGKILL)")
                server.kill()
                refused_s = load.first(503, killed) - killed
                time.sleep(5)
                note("started again")
                server.start()
                while not answers(probe, queries_of(index, 1)):
                    time.sleep(0.1)
                back = note("searches its collection again")
                recovered_s = load.first(200, back - 0.5) - back
                time.sleep(5)
                frozen = note("frozen (SIGSTOP)")
                server.freeze()
                silent_s = load.first(503, frozen) - frozen
                # Frozen for longer than its sessions live, it ends by itself.
                time.sleep(3)
                thawed = note("goes on (SIGCONT)")
                server.thaw()
                thawed_s = load.first(200, thawed) - thawed
                time.sleep(5)
    bad = [r for r in load.replies if r.status != 200 and not (r.status == 503 and r.retry_after)]
    rows = []
    bounds = [("", load.started), *events.items(), ("", time.monotonic())]
    for (event, start), (_, stop) in pairwise(bounds):
        counts = Counter(r.status for r in load.replies if start <= r.at < stop)
        rows.append(
            f"| {start - load.started:.1f} s | {event or 'load begins'} "
            f"| {counts[200]} | {counts[503]} |"
        )
    return f"""{CLIENTS} clients send frames with a mask to the service with
`POSE_SEARCH_TIMEOUT_S` at its default; refused, they wait 0.1 s.

| at | Milvus | 200 from then on | 503 from then on |
|---|---|---|---|
{chr(10).join(rows)}

Of {len(load.replies):,} answers, {len(bad)} are neither 200 nor 503 with `Retry-After`;
{load.broken} connections broke. Killed, the first 503 came after {refused_s:.2f} s; frozen, after
{silent_s:.2f} s. The first 200 came {recovered_s:.1f} s after Milvus could search its collection
again, and {thawed_s:.1f} s after it was let go on."""


def answers(milvus: Milvus, query: NDArray[np.float32]) -> bool:
    """Whether Milvus searches what the alias names."""
    try:
        name = milvus.resolve(ALIAS)
        milvus.search(name, query, 1)
    except UnavailableError:
        milvus.reconnect()
        return False
    return True


def switch(index: PoseIndex) -> str:
    """Publish another version under load."""
    requests = calls(index)["`/pose` with a mask"]
    index = first_entries(index, SWITCHED_ENTRIES)
    subjects = tuple(f"other-{subject}" for subject in index.subjects)
    other = replace(index, name="other", subjects=subjects)
    with tempfile.TemporaryDirectory() as folder, milvus_server() as server:
        versions = [load_saved(each, Path(folder) / each.name) for each in (index, other)]
        milvus = Milvus(server.address, TIMEOUT_S)
        publish(milvus, versions[0], ALIAS, progress=tqdm)
        with service(server, Path(folder)) as running:
            running.wait_until_ready()
            with BackgroundLoop(running.url, requests, CLIENTS) as load:
                time.sleep(3)
                publish(milvus, versions[1], ALIAS, progress=tqdm)
                switched = time.monotonic()
                while versions[1].version.encode() not in load.replies[-1].body:
                    time.sleep(0.01)
                moved_s = time.monotonic() - switched
                time.sleep(3)
    marks = [version.version.encode() for version in versions]
    served: Counter[bool] = Counter()
    mixed = 0
    for reply in load.replies:
        is_other = marks[1] in reply.body
        served[is_other] += reply.status == 200
        mixed += (marks[0] in reply.body) == is_other
        mixed += is_other != (b'"subject":"other-' in reply.body)
        mixed += reply.body.count(b'"subject":"other-') not in (0, reply.body.count(b'"subject":'))
    failed = sum(reply.status != 200 for reply in load.replies)
    before, after = served[False], served[True]
    return f"""{CLIENTS} clients send frames with a mask while another version of {len(other):,}
entries is published, whose subjects have other names. Of {len(load.replies):,} answers {before:,}
were of the version before and {after:,} of the one after; {mixed} mixed the two, {failed} failed,
{load.broken} connections broke. The service moved over {moved_s:.1f} s after the alias was
switched."""


def first_entries(index: PoseIndex, count: int) -> PoseIndex:
    """A smaller index, which takes seconds to save."""
    store = index.silhouette_store
    ends = store.ends[:count]
    return replace(
        index,
        vectors=index.vectors[:count],
        entries=index.entries[:count],
        silhouette_store=replace(store, data=store.data[: ends[-1]], ends=ends),
    )


def load_saved(index: PoseIndex, path: Path) -> PoseIndex:
    """Save an index and load it again, so that it has a version."""
    save_index(index, path)
    return load_index(path)


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure the index in Milvus.", PAGE)
    parser.add_argument("parts", nargs="+", choices=("agreement", "latency", "outage", "switch"))
    options = parser.parse_args()
    index = load_index(options.index)
    titles: dict[str, tuple[str, Callable[[], str]]] = {
        "agreement": ("The same answers", lambda: agreement(index)),
        "latency": ("Latency", lambda: latency(index)),
        "outage": ("Milvus away under load", lambda: outage(index, options.index)),
        "switch": ("Another version under load", lambda: switch(index)),
    }
    for part in options.parts:
        title, measure = titles[part]
        head = (
            f"`python -m scripts.load.milvus {part}`, revision {revision()}. {machine()}, "
            f"load average {os.getloadavg()[0]:.0f}."
        )
        conclude(title, f"{head}\n\n{measure()}", write=options.write, page=PAGE)


if __name__ == "__main__":
    main()
