"""Load an index into Milvus, and have services that run move over to it.

python -m scripts.publish_index milvus://host:19530/poses --index /srv/artefacts/large
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from index.artefact import load_index
from index.files import ArtefactError
from index.milvus import Milvus, publish, remove_older
from index.milvus_address import MilvusAddress
from index.search import UnavailableError
from index.store import DEFAULT_PATH

TIMEOUT_S = 120.0
"""Milvus stores and indexes what was written within one call."""


def main() -> int:
    """Parse the command line and publish; 1 with one sentence where that fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("address", help="milvus://host:port/alias")
    add("--index", type=Path, default=DEFAULT_PATH, help="folder of the artefact")
    add("--shards", type=int, default=1, help="of a new collection")
    add("--replicas", type=int, default=1, help="of a new collection in memory")
    add("--keep", type=int, help="remove older collections but these; by default all stay")
    arguments = parser.parse_args()
    try:
        address = MilvusAddress.parse(arguments.address)
        milvus = Milvus(address.server, TIMEOUT_S)
        collection = publish(
            milvus,
            load_index(arguments.index),
            address.alias,
            shards=arguments.shards,
            replicas=arguments.replicas,
            progress=lambda starts: tqdm(starts, unit="batch"),
        )
        print(f"{address} names {collection.name}: {collection.contents.entries} entries")
        if arguments.keep is not None:
            for name in remove_older(milvus, collection, arguments.keep):
                print(f"removed {name}")
    except (ArtefactError, UnavailableError, ValueError) as error:
        print(f"publish_index: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
