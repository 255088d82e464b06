"""Load an index into Milvus, and move running services over to it.

python -m scripts publish milvus://host:19530/poses --index /srv/artefacts/large
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from index import DEFAULT_PATH
from index.artefact import load_index
from index.milvus import Milvus, publish, remove_older
from index.milvus_address import MilvusAddress
from index.search import UnavailableError

TIMEOUT_S = 120.0
"""Milvus stores and indexes what was written within one call."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Publish as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("address", help="milvus://host:port/alias")
    add("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    add("--shards", type=int, default=1, help="of a new collection")
    add("--replicas", type=int, default=1, help="of a new collection in memory")
    add("--keep", type=int, help="remove older collections but these; by default all stay")
    options = parser.parse_args(arguments)
    address = MilvusAddress.parse(options.address)
    milvus = Milvus(address.server, TIMEOUT_S)
    try:
        collection = publish(
            milvus,
            load_index(options.index),
            address.alias,
            shards=options.shards,
            replicas=options.replicas,
            progress=lambda starts: tqdm(starts, unit="batch"),
        )
        print(f"{address} names {collection.name}: {collection.contents.entries} entries")
        if options.keep is not None:
            for name in remove_older(milvus, collection, options.keep):
                print(f"removed {name}")
    except UnavailableError as error:
        raise SystemExit(f"publish: {error}") from None
