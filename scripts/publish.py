"""Load an index into Milvus, and move running services over to it.

python -m scripts publish http://milvus:19530 --index /srv/artefacts/large
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from pymilvus import DataType, MilvusClient
from tqdm import tqdm

from index import DEFAULT_PATH
from index.artefact import load_index
from index.milvus import ALIAS, METRIC, NAME_PREFIX, ROW, VECTOR, MilvusNeighbours, milvus_errors
from index.search import SearchUnavailableError
from index.store import PoseIndex

BATCH = 10_000
"""Rows written in one call: 2 MB."""

ONCE = {"timeout": 120.0}
"""Milvus stores and indexes what was written within one call."""


def publish(uri: str, index: PoseIndex) -> None:
    """Write an index into a collection of its own, then have the alias name that.

    If anything fails, the alias names what it named before, and publishing can be repeated.
    """
    name = NAME_PREFIX + index.version.removeprefix("sha256:")
    with milvus_errors():
        client = MilvusClient(uri, **ONCE)
        names = client.list_collections(**ONCE)
        is_named = any(ALIAS in client.list_aliases(one, **ONCE)["aliases"] for one in names)
        if name in names and client.get_collection_stats(name, **ONCE)["row_count"] != len(index):
            client.drop_collection(name, **ONCE)
            names.remove(name)
        if name not in names:
            _write(client, name, index)
        client.load_collection(name, **ONCE)
        MilvusNeighbours(client, name).check(index)
        (client.alter_alias if is_named else client.create_alias)(name, ALIAS, **ONCE)


def _write(client: MilvusClient, name: str, index: PoseIndex) -> None:
    schema = client.create_schema(auto_id=False)
    schema.add_field(ROW, DataType.INT64, is_primary=True)
    schema.add_field(VECTOR, DataType.FLOAT_VECTOR, dim=index.descriptor.dimension)
    client.create_collection(name, schema=schema, **ONCE)
    exact = client.prepare_index_params(VECTOR, index_type="FLAT", **METRIC)
    client.create_index(name, exact, **ONCE)
    for start in tqdm(range(0, len(index), BATCH), unit="batch"):
        rows = enumerate(index.vectors[start : start + BATCH], start)
        client.insert(name, [{ROW: number, VECTOR: row} for number, row in rows], **ONCE)
    client.flush(name, **ONCE)


def main(arguments: Sequence[str] | None = None) -> None:
    """Publish as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("uri", help="as POSE_MILVUS")
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    options = parser.parse_args(arguments)
    index = load_index(options.index)
    try:
        publish(options.uri, index)
    except SearchUnavailableError as error:
        raise SystemExit(f"publish: {error}") from None
    print(f"{index.version} is published: {len(index)} entries")
