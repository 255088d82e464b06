"""Commands: what they lack is told in one sentence, and their options get along."""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.evaluate import EXPERIMENTS
from tests.conftest import ROOT


@pytest.mark.parametrize(
    "command",
    ["draw_people", "evaluate real", "evaluate paper", "evaluate actions"],
)
def test_without_data(command: str, tmp_path: Path) -> None:
    module, *names = command.split()
    ended = subprocess.run(
        [sys.executable, "-m", f"scripts.{module}", *names, "--shared", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    last = ended.stderr.splitlines()[-1]
    assert last.startswith((f"scripts.{module}: ", f"{module}: "))
    assert "Traceback" not in ended.stderr


def test_the_options_of_all_experiments_get_along() -> None:
    pytest.importorskip("sklearn")
    pytest.importorskip("matplotlib")
    parser = argparse.ArgumentParser()
    for name, module in EXPERIMENTS.items():
        importlib.import_module(module).add_arguments(parser.add_argument_group(name))
    assert parser.parse_args([])
