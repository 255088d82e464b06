"""Where an index in Milvus is: ``milvus://host:port/alias``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import urlsplit

SCHEME = "milvus:"

_DEFAULT_PORT = 19530
_ALIAS = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}")


@dataclass(frozen=True)
class MilvusAddress:
    """A server and the alias of a collection.

    Parameters
    ----------
    host : str
    port : int
    alias : str
    """

    host: str
    port: int
    alias: str

    @classmethod
    def parse(cls, text: str) -> MilvusAddress:
        """Read ``milvus://host:port/alias``; the port may be left out.

        Raises
        ------
        ValueError
            If the text is not such an address.

        Examples
        --------
        >>> MilvusAddress.parse("milvus://vectors:19530/poses").server
        'vectors:19530'
        """
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port or _DEFAULT_PORT
        except ValueError:
            host = None
        alias = parts.path.removeprefix("/") if host else ""
        extra = not host or parts.username or parts.query or parts.fragment
        if extra or not _ALIAS.fullmatch(alias):
            raise ValueError(f"expected a folder or milvus://host:port/alias, got {text!r}")
        assert host is not None
        return cls(host, port, alias)

    @property
    def server(self) -> str:
        """Host and port, as gRPC takes them."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def __str__(self) -> str:
        return f"milvus://{self.server}/{self.alias}"
