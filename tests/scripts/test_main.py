"""Commands: all are listed, and what one lacks is said in one sentence."""

import argparse
import importlib
import inspect
import re
import sys
from functools import partial
from pathlib import Path

import pytest

from scripts.__main__ import COMMANDS, main
from scripts.evaluate import EXPERIMENTS
from tests.conftest import ROOT
from tests.support.programs import run

RUN = partial(run, sys.executable, "-m", "scripts")


def test_all_commands_are_listed_with_a_line() -> None:
    listed = RUN()
    assert listed.returncode == 0
    assert re.findall(r"^  ([\w-]+) +\S", listed.stdout, re.MULTILINE) == list(COMMANDS)
    unknown = RUN("evalute")
    assert unknown.returncode == 2
    assert unknown.stderr.startswith("scripts: expected a command, got 'evalute'\n")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_there(name: str) -> None:
    module, _ = COMMANDS[name]
    assert (ROOT / f"{module.replace('.', '/')}.py").is_file()
    try:
        imported = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] in ("app", "descriptor", "index", "scripts"):
            raise
        pytest.skip(f"needs {error.name}, of an extra")
    inspect.signature(imported.main).bind([])


def test_without_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [*sys.argv])
    assert main(["evaluate", "people", "--shared", str(tmp_path)]) == 1
    assert capsys.readouterr().err.startswith("evaluate: ")


def test_the_options_of_all_experiments_get_along() -> None:
    pytest.importorskip("sklearn")
    parser = argparse.ArgumentParser()
    for name in EXPERIMENTS:
        module = importlib.import_module(f"scripts.experiments.{name}")
        if hasattr(module, "add_arguments"):
            module.add_arguments(parser.add_argument_group(name))
    assert parser.parse_args([])
