"""``docs/library.md`` shows programs that run, and importing the package changes nothing."""

import os
import re
import subprocess
import sys

import pytest

import app
from tests.conftest import ROOT

EXAMPLES = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/library.md").read_text(), re.M | re.S)

_SIDE_EFFECTS = """
import os, sys, warnings
import cv2, faiss, numpy
from PIL import Image
def settings():
    shared = sys.getswitchinterval(), Image.MAX_IMAGE_PIXELS, cv2.getNumThreads()
    return dict(os.environ), list(warnings.filters), *shared
before = settings()
faiss.omp_set_num_threads(3)
from app import *
import app.photograph
from app.main import create_app
from app.settings import Settings
assert create_app(Settings()).openapi()
assert settings() == before, (before, settings())
import numpy as np
from index.search import ExactNeighbours
ExactNeighbours(np.eye(48, dtype=np.float32)).search(np.eye(48, dtype=np.float32)[:1], 1)
assert faiss.omp_get_max_threads() == 3
"""


def run(program: str) -> str:
    environment = {name: value for name, value in os.environ.items() if "_NUM_THREADS" not in name}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_examples_run_one_after_the_other() -> None:
    assert len(EXAMPLES) == 3
    lines = run("\n".join(EXAMPLES)).splitlines()
    people = [line for line in lines if "probably right" in line]
    assert len(people) == lines.count("(24, 3)") == 5
    assert lines[10] == f"{5 * ['entered']} [1, 2, 3, 4, 5]"
    assert lines[11] == lines[12] == "[] [1, 2, 3, 4, 5]"
    assert lines[13].startswith("8 ")
    assert len(lines) == 13 + 7


def test_importing_the_package_changes_nothing_for_a_program() -> None:
    run(_SIDE_EFFECTS)


def test_what_the_page_imports_is_public() -> None:
    imported = re.findall(r"^from app import (.+)$", "\n".join(EXAMPLES), re.MULTILINE)
    assert {name for names in imported for name in names.split(", ")} <= set(app.__all__)
    assert not re.findall(r"^(?:from|import) (?:app\.|index|descriptor)", "\n".join(EXAMPLES), re.M)


@pytest.mark.parametrize("name", app.__all__)
def test_what_is_public_is_there(name: str) -> None:
    assert getattr(app, name) is not None


def test_the_package_loads_nothing_before_it_is_used() -> None:
    loaded = run("import app, sys; print({name.partition('.')[0] for name in sys.modules})")
    assert not {"'numpy'", "'cv2'", "'faiss'", "'fastapi'"} & set(re.findall(r"'\w+'", loaded))
