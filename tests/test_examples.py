"""Examples in docstrings run, as written, from the checkout."""

import doctest
import importlib

import pytest

import app
from app.photograph import Estimator, load_estimator
from app.settings import Settings
from tests.conftest import ROOT

PUBLIC = ("Upload", "Estimator", "CameraSession", "load_estimator")
MODULES = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts)
    for package in ("app", "index", "descriptor")
    for file in sorted((ROOT / package).rglob("*.py"))
    if " >>> " in file.read_text()
]


@pytest.mark.parametrize("name", PUBLIC)
def test_what_programs_begin_with_has_examples(
    name: str, estimator: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(settings: Settings | None = None) -> Estimator:
        """The tiny index, and networks that are loaded already, stand in for those that ship."""
        return estimator if settings is None else load_estimator(settings)

    shown = doctest.DocTestFinder(recurse=False).find(getattr(app, name), name, module=False)
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(app, "load_estimator", load, raising=False)
    assert shown[0].examples
    assert doctest.DocTestRunner().run(shown[0]).failed == 0


@pytest.mark.parametrize("name", MODULES)
def test_examples_show_what_happens(name: str) -> None:
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_tracebacks_name_what_programs_import() -> None:
    assert app.load_estimator.__module__ == app.Upload.__module__ == "app"
    assert str(app.UploadError) == "<class 'app.UploadError'>"
