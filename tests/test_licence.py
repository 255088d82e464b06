"""Whoever gets the project gets its terms, and those of what others made."""

from __future__ import annotations

import tomllib

from app.main import create_app
from app.settings import Settings
from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NOTICE = (ROOT / "NOTICE").read_text()


def test_the_licence_is_apache_2_everywhere() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text.splitlines()[0]
    assert "END OF TERMS AND CONDITIONS" in text
    assert PROJECT["license"] == "Apache-2.0"
    assert create_app(Settings()).openapi()["info"]["license"]["identifier"] == "Apache-2.0"
    assert 'image.licenses="Apache-2.0"' in (ROOT / "Dockerfile").read_text()
    assert "(LICENSE)" in (ROOT / "README.md").read_text()


def test_every_network_that_ships_is_in_the_notice() -> None:
    shipped = [
        path.name for path in (ROOT / "app").rglob("*") if path.suffix in (".onnx", ".tflite")
    ]
    assert shipped
    assert [name for name in shipped if name not in NOTICE] == []
