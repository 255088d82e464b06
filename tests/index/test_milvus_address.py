"""Addresses of indexes in Milvus."""

from __future__ import annotations

import pytest

from index.milvus_address import MilvusAddress


@pytest.mark.parametrize(
    ("text", "server", "alias"),
    [
        ("milvus://vectors:19531/poses", "vectors:19531", "poses"),
        ("milvus://vectors/poses", "vectors:19530", "poses"),
        ("milvus://[::1]:19531/_p2", "[::1]:19531", "_p2"),
    ],
)
def test_an_address_is_read(text: str, server: str, alias: str) -> None:
    address = MilvusAddress.parse(text)
    assert (address.server, address.alias) == (server, alias)
    assert MilvusAddress.parse(str(address)) == address


@pytest.mark.parametrize(
    "text",
    [
        "milvus:",
        "milvus://",
        "milvus:///poses",
        "milvus://vectors",
        "milvus://vectors:port/poses",
        "milvus://vectors:99999/poses",
        "milvus://vectors/poses/2",
        "milvus://vectors/2poses",
        "milvus://root:secret@vectors/poses",
        "milvus://vectors/poses?version=2",
    ],
)
def test_what_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^expected a folder or milvus://host:port/alias, got "):
        MilvusAddress.parse(text)
