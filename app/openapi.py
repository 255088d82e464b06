"""The OpenAPI document: FastAPI's, with what it does not write by itself."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.schemas import DeepstackUpload, FrameUpload, Problem

_FORMS = (FrameUpload, DeepstackUpload)


def add_openapi(app: FastAPI) -> None:
    """Have ``app`` describe its errors, and its uploads so that generated clients work.

    Every route refers to :class:`Problem`. Naming the model in each would do, but FastAPI
    would then promise ``application/json`` besides ``application/problem+json``. So do the routes
    that take images to the forms that they read by themselves.
    """

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(
                title=app.title,
                version=app.version,
                description=app.description,
                license_info=app.license_info,
                routes=app.routes,
            )
            schemas = document["components"]["schemas"]
            for model in (Problem, *_FORMS):
                schemas[model.__name__] = model.model_json_schema()
            for name, schema in schemas.items():
                # The models here allow no others, but a later version may add fields: clients
                # that refuse what they do not know would break. (And openapi-generator warns.)
                schema.pop("additionalProperties", None)
                if name in {form.__name__ for form in _FORMS}:
                    properties = schema["properties"]
                    schema["properties"] = {k: _form_field(v) for k, v in properties.items()}
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _form_field(schema: dict[str, Any]) -> dict[str, Any]:
    """Write a field of a form as generators understand it.

    A form has no null: an optional field is one that may be missing. One with a default is taken
    by some for one that is always there.
    """
    kind: dict[str, Any] = next(
        (part for part in schema.get("anyOf", ()) if part != {"type": "null"}), {}
    )
    return {**kind, **{k: v for k, v in schema.items() if k not in ("anyOf", "default")}}
