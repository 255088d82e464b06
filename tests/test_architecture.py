"""``docs/architecture.md`` names what there is, and imports lead only downward."""

import ast
import re
import sys
from functools import cache
from pathlib import Path

from tests.conftest import ROOT
from tests.support.programs import output_of

PAGE = (ROOT / "docs" / "architecture.md").read_text()
PACKAGES = ("app", "index", "descriptor")


def table() -> dict[str, int]:
    """Paths of the table, each with the number of its layer, counted from the top."""
    rows = [
        (cells[1].strip(), cells[2])
        for line in PAGE.splitlines()
        if line.startswith("| ") and (cells := line.split("|"))[1].strip() != "layer"
    ]
    names = list(dict.fromkeys(name for name, _ in rows))
    return {path: names.index(name) for name, files in rows for path in named_paths(files)}


def named_paths(text: str) -> list[str]:
    return re.findall(r"`((?:app|index|descriptor)/[\w/.]*)`", text)


def layer_of(path: str, layers: dict[str, int]) -> int | None:
    """The layer of a file: its own, or that of the innermost folder that has one."""
    folders = [f"{folder}/" for folder in Path(path).parents]
    return next((layers[name] for name in (path, *folders) if name in layers), None)


@cache
def imported_files(path: str) -> set[str]:
    """Files of the packages that a file imports."""
    names = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: expected absolute imports"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    found = set()
    for name in names:
        parts = name.split(".")
        if parts[0] not in PACKAGES:
            continue
        while parts and not (ROOT / (known := "/".join(parts) + ".py")).is_file():
            known = "/".join(parts) + "/__init__.py"
            if (ROOT / known).is_file():
                break
            parts.pop()
        found.add(known)
    return found


MODULES = [
    str(file.relative_to(ROOT))
    for package in PACKAGES
    for file in sorted((ROOT / package).rglob("*.py"))
]


def test_every_file_that_the_page_names_exists() -> None:
    paths = re.findall(r"\b((?:app|index|descriptor|tests)/[\w/]+(?:\.py)?)", PAGE)
    assert len(paths) > 40
    for path in paths:
        assert (ROOT / path).exists(), path


def test_every_module_of_the_service_has_a_layer() -> None:
    layers = table()
    assert [path for path in MODULES if layer_of(path, layers) is None] == ["app/__init__.py"]


def test_imports_lead_downward() -> None:
    layers = table()
    # app/__init__.py only names what programs may import, and imports it when it is asked for.
    for path in {*MODULES} - {"app/__init__.py"}:
        layer = layer_of(path, layers)
        for other in imported_files(path) - {"app/__init__.py"}:
            below = layer_of(other, layers)
            assert layer is not None and below is not None
            assert layer <= below, f"{path} imports {other}, which is in a layer above"


def test_the_bridge_is_a_client() -> None:
    for path in MODULES:
        others = imported_files(path) - {"app/__init__.py"}
        if path.startswith("app/bridge/"):
            known = ("app/bridge/", "app/decoding/", "app/configuration.py", "app/messages.py")
            assert all(other.startswith(known) for other in others), path
        else:
            assert not any(other.startswith("app/bridge/") for other in others), path


def test_the_bridge_loads_nothing_of_the_service() -> None:
    loaded = output_of(
        sys.executable, "-c", "import sys, app.bridge.__main__; print(*sys.modules)"
    ).split()
    assert {"faiss", "fastapi", "ai_edge_litert", "index"}.isdisjoint(loaded)


def test_the_page_on_vision_names_every_module_of_it() -> None:
    named = set(re.findall(r"`(\w+\.py)`", (ROOT / "docs" / "vision.md").read_text()))
    ours = {file.name for file in (ROOT / "app" / "vision").glob("*.py")} - {"__init__.py"}
    assert ours <= named


def test_vision_knows_nothing_but_images() -> None:
    vision = [path for path in MODULES if path.startswith("app/vision/")]
    for path in vision:
        for other in imported_files(path):
            below = ("app/vision/", "app/networks/")
            assert other.startswith(below), f"{path} imports {other}"
