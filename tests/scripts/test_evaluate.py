import argparse
import importlib

import pytest

from scripts.evaluate import EXPERIMENTS


def test_the_options_of_all_experiments_get_along() -> None:
    pytest.importorskip("sklearn")
    pytest.importorskip("matplotlib")
    parser = argparse.ArgumentParser()
    for name, module in EXPERIMENTS.items():
        importlib.import_module(module).add_arguments(parser.add_argument_group(name))
    assert parser.parse_args([])
