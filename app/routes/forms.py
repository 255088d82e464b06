"""Forms and query parameters, read so that nothing a caller sends is silently ignored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator

from fastapi import Depends, Request
from starlette.datastructures import FormData, UploadFile

from app.http.problems import ProblemError
from app.messages import suggestion

_LONGEST_NAME = 60


def check_fields(form: FormData, known: Collection[str]) -> None:
    """Raise a 422 if a form holds an unknown field, or a field twice."""
    _check_names((name for name, _ in form.multi_items()), known, "fields", "part")


async def file_of(form: FormData, field: str) -> bytes | None:
    """Content of a file; None also for an empty field, which browsers send for no file."""
    part = form.get(field)
    if isinstance(part, UploadFile):
        return None if not part.filename and not part.size else await part.read()
    if part:
        raise ProblemError(422, f"{field}: expected a file, got text", field=field)
    return None


def text_of(form: FormData, field: str) -> str | None:
    """Return the text of a field, None if it is missing."""
    part = form.get(field)
    if isinstance(part, UploadFile):
        raise ProblemError(422, f"{field}: expected text, got a file", field=field)
    return part


async def _check_query(request: Request) -> None:
    given = [name for name, _ in request.query_params.multi_items()]
    if given:
        known = sorted(_query_names(request))
        _check_names(given, known, "query parameters", "value")


CheckQuery = Depends(_check_query)
"""Refuses query parameters that the route does not have, and those given twice."""


def _query_names(request: Request) -> Iterator[str]:
    """Yield the names of the route's query parameters, as the OpenAPI document has them."""
    operation = request.app.openapi()["paths"][request.scope["route"].path]
    for parameter in operation[request.method.lower()].get("parameters", ()):
        if parameter["in"] == "query":
            yield parameter["name"]


def _check_names(given: Iterable[str], known: Collection[str], kind: str, unit: str) -> None:
    for name, count in Counter(given).items():
        short = name[:_LONGEST_NAME]
        if name not in known:
            expected = f"one of the {kind} {', '.join(known)}" if known else f"no {kind}"
            meant = suggestion(short, {name: name for name in known})
            raise ProblemError(422, f"{short}: expected {expected}{meant}", field=short)
        if count > 1:
            raise ProblemError(422, f"{name}: expected one {unit}, got {count}", field=name)
