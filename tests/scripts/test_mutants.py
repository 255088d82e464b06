"""What is changed in the code to see whether the tests notice."""

import ast
from pathlib import Path

import pytest

from scripts.mutants import MODULES, mutants_of
from tests.conftest import ROOT

CODE = '''
LIMIT = 3


def admitted(count: int, *, name: str = "camera 1") -> bool:
    """Whether 2 and more are admitted."""
    if not name or count >= LIMIT:
        raise ValueError(f"expected fewer than {LIMIT + 1} cameras, got one more")
    return dict(a=count, b="one word or three")["a"] + 1 > 0
'''


def test_each_operator_number_name_and_argument_is_changed() -> None:
    changes = [one.name.split(": ", 1)[1].rsplit(" #", 1)[0] for one in mutants_of("a.py", CODE)]
    assert sorted(changes) == sorted(
        [
            "not name or count >= LIMIT -> not name and count >= LIMIT",
            "not name -> name",
            "count >= LIMIT -> count > LIMIT",
            "dict(a=count, b='one word or three')['a'] + 1 > 0 -> "
            "dict(a=count, b='one word or three')['a'] + 1 >= 0",
            "dict(a=count, b='one word or three')['a'] + 1 -> "
            "dict(a=count, b='one word or three')['a'] - 1",
            "dict(a=count, b='one word or three') -> dict(b='one word or three')",
            "dict(a=count, b='one word or three') -> dict(a=count)",
            "'a' -> 'Xa'",
            "1 -> 2",
            "0 -> 1",
        ]
    )


@pytest.mark.parametrize("file", ["app/tracking/falls.py"])
def test_every_mutant_is_another_program_that_can_be_run(file: str) -> None:
    text = (ROOT / file).read_text()
    found = list(mutants_of(file, text))
    assert len({one.name for one in found}) == len(found) > 5
    assert all(one.source != text and ast.parse(one.source) for one in found[::10])


def test_all_modules_exist() -> None:
    for pattern in MODULES:
        assert list(Path(ROOT).glob(pattern)), pattern
