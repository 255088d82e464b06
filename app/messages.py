"""Wording of validation errors: what was expected, and what was given instead."""

import re
from collections.abc import Collection, Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import BeforeValidator, ValidationError

# A SearchUnavailableError's own message names a server that does not concern clients.
SEARCH_FAILED = "the index cannot be searched at present; try again shortly"

_MAX_DIGITS = 18  # Python refuses to convert thousands of digits.
_WHOLE = re.compile("[+-]?[0-9]+")

_EXPECTED = {
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_parsing": "true or false",
    "greater_than_equal": "at least {ge}",
    "greater_than": "more than {gt}",
    "less_than_equal": "at most {le}",
    "less_than": "less than {lt}",
    "multiple_of": "a multiple of {multiple_of:g}",
    "literal_error": "{expected}",
    "string_too_short": "some text",
    "string_too_long": "at most {max_length} characters",
    "string_type": "text",
    "string_pattern_mismatch": "text of the form {pattern}",
    "list_type": "a list",
    "dict_type": "a JSON object",
    "model_type": "a JSON object",
}


def _refuse_underscores(value: object) -> object:
    if isinstance(value, str) and "_" in value:
        raise ValueError(f"expected a number, got {shortened(value)}")
    return value


def _refuse_all_but_digits(value: object) -> object:
    if isinstance(value, str) and not _WHOLE.fullmatch(value):
        raise ValueError(f"expected a whole number, got {shortened(value)}")
    if isinstance(value, str) and len(value) > _MAX_DIGITS:
        most = f"at most {_MAX_DIGITS} digits"
        raise ValueError(f"expected a whole number of {most}, got {shortened(value)}")
    return value


NUMBER = BeforeValidator(_refuse_underscores)
"""Validator of numbers in text; pydantic alone accepts ``1_000``, as Python does."""

WHOLE_NUMBER = BeforeValidator(_refuse_all_but_digits)
"""Validator of whole numbers in text; pydantic alone accepts ``1_000`` and ``1.0``."""


def expected_and_got(error: Mapping[str, Any]) -> str:
    """Word an error of pydantic, an item of :meth:`pydantic.ValidationError.errors`.

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
    if kind == "json_invalid":
        return f"expected valid JSON: {context['error']}"
    if kind in ("too_short", "too_long"):
        short = kind == "too_short"
        bound = f"at least {context['min_length']}" if short else f"at most {context['max_length']}"
        return f"expected {bound} values, got {context['actual_length']}"
    if kind not in _EXPECTED:
        message = str(error["msg"])
        return message[:1].lower() + message[1:]
    return f"expected {_EXPECTED[kind].format(**context)}, got {shortened(error['input'])}"


def located(error: ValidationError) -> tuple[str, str]:
    """Word the first error that pydantic found in JSON: the place, and what is wrong there.

    Examples
    --------
    >>> found = [{"type": "list_type", "loc": ("zones", 0, "polygon"), "input": 1}]
    >>> located(ValidationError.from_exception_data("camera", found))
    ('zones[0].polygon', 'expected a list, got 1')
    """
    first = error.errors()[0]
    # Before "[key]", a name is at fault, not its value.
    return dotted([step for step in first["loc"] if step != "[key]"]), expected_and_got(first)


def dotted(steps: Iterable[int | str]) -> str:
    """Write the names and numbers that lead to a value as a program would.

    Examples
    --------
    >>> dotted(("zones", 0, "polygon"))
    'zones[0].polygon'
    """
    named = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return "".join(named).removeprefix(".")


def shortened(value: object) -> str:
    text, most = "null" if value is None else repr(value), 60
    return text if len(text) <= most else f"{text[:most]}..."


def expected_name(name: str, known: Collection[str], kind: str, got: str = "") -> str:
    """Word the error that a name is not known; ``got`` is added before the suggestion.

    Examples
    --------
    >>> expected_name("masc", ("mask", "frame"), "fields")
    'expected one of the fields mask, frame; did you mean mask?'
    """
    expected = f"one of the {kind} {', '.join(known)}" if known else f"no {kind}"
    return f"expected {expected}{got}{suggestion(name, {name: name for name in known})}"


def suggestion(name: str, known: Mapping[str, str]) -> str:
    """Suggest a known name as a half-sentence, ``""`` if none is similar to an unknown one.

    ``known`` has what is suggested for each known name.

    Examples
    --------
    >>> suggestion("masc", {"mask": "mask", "frame": "frame"})
    '; did you mean mask?'
    """
    similar = get_close_matches(name, known, n=1)
    return f"; did you mean {known[similar[0]]}?" if similar else ""
