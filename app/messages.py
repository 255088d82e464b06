"""Pydantic's validation errors, and other errors, in the words that all of the service use."""

from __future__ import annotations

import re
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import BeforeValidator

SEARCH_FAILED = "the index cannot be searched at present; try again shortly"

_LONGEST_VALUE = 60
_WHOLE = re.compile("[+-]?[0-9]+")

_EXPECTED = {
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_parsing": "true or false",
    "greater_than_equal": "at least {ge}",
    "greater_than": "more than {gt}",
    "less_than_equal": "at most {le}",
    "less_than": "less than {lt}",
    "literal_error": "{expected}",
    "string_too_short": "some text",
    "string_too_long": "at most {max_length} characters",
    "string_type": "text",
    "string_pattern_mismatch": "text of the form {pattern}",
    "list_type": "a list",
    "json_invalid": "valid JSON",
}


def _refuse_underscores(value: object) -> object:
    if isinstance(value, str) and "_" in value:
        raise ValueError(f"expected a number, got {shortened(value)}")
    return value


def _refuse_all_but_digits(value: object) -> object:
    if isinstance(value, str) and not _WHOLE.fullmatch(value):
        raise ValueError(f"expected a whole number, got {shortened(value)}")
    return value


NUMBER = BeforeValidator(_refuse_underscores)
"""For numbers in text: pydantic takes Python's ``1_000`` for one."""

WHOLE_NUMBER = BeforeValidator(_refuse_all_but_digits)
"""For whole numbers in text: pydantic takes ``1_000`` and ``1.0`` for some."""


def expected_and_got(error: Mapping[str, Any]) -> str:
    """Say what was expected and what was found instead.

    Parameters
    ----------
    error : mapping
        An element of :meth:`pydantic.ValidationError.errors`.

    Examples
    --------
    >>> expected_and_got({"type": "greater_than_equal", "ctx": {"ge": 1}, "input": 0})
    'expected at least 1, got 0'
    """
    kind, context = error["type"], error.get("ctx", {})
    if kind == "missing":
        return "expected a value, got none"
    if kind == "value_error":  # A validator of our own, whose sentence is complete.
        return str(context["error"])
    if kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        return f"expected {wanted} values, got {context['actual_length']}"
    if kind not in _EXPECTED:
        message = str(error["msg"])
        return message[:1].lower() + message[1:]
    return f"expected {_EXPECTED[kind].format(**context)}, got {shortened(error['input'])}"


def shortened(value: object) -> str:
    """Quote a value, shortened if it is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def suggestion(name: str, known: Mapping[str, str]) -> str:
    """Ask whether another name was meant, ``""`` if none is similar.

    Parameters
    ----------
    name : str
        The unknown name.
    known : mapping of str to str
        Known names, and what to suggest for each.

    Examples
    --------
    >>> suggestion("masc", {"mask": "mask", "frame": "frame"})
    '; did you mean mask?'
    """
    similar = get_close_matches(name, known, n=1)
    return f"; did you mean {known[similar[0]]}?" if similar else ""
