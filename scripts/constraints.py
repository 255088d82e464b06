"""Write the versions that pip has chosen, as constraints for the next time.

    pip install --dry-run --ignore-installed --report - -e . | python -m scripts.constraints

``make constraints`` calls it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

HEAD = """\
# The versions that all tests have passed with, by `make constraints`. What is installed by make and
# by the Dockerfile is held to them; pyproject.toml says which others may do.
"""


def constraints(report: Mapping[str, Any]) -> str:
    """Return the text of a constraints file.

    Parameters
    ----------
    report : mapping
        A report of ``pip install`` [1]_.

    References
    ----------
    .. [1] https://pip.pypa.io/en/stable/reference/installation-report/
    """
    packages = [item["metadata"] for item in report["install"] if "dir_info" not in _source(item)]
    names = sorted((f"{p['name']}=={p['version']}" for p in packages), key=str.lower)
    return HEAD + "\n".join(names) + "\n"


def _source(item: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return where a package comes from; a folder is this one's own."""
    source: Mapping[str, Any] = item.get("download_info", {})
    return source


if __name__ == "__main__":
    sys.stdout.write(constraints(json.load(sys.stdin)))
