"""The OpenAPI document: FastAPI's, with what it does not write by itself."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.schemas import FrameUpload, Problem


def add_openapi(app: FastAPI) -> None:
    """Have ``app`` describe its errors, and its uploads so that generated clients work.

    Every route refers to :class:`Problem`. Naming the model in each would do, but FastAPI
    would then promise ``application/json`` besides ``application/problem+json``. So do the routes
    on poses to the form that they read by themselves.
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
            for model in (Problem, FrameUpload):
                schemas[model.__name__] = model.model_json_schema()
            for name, schema in schemas.items():
                # The models here allow no others, but a later version may add fields: clients
                # that refuse what they do not know would break. (And openapi-generator warns.)
                schema.pop("additionalProperties", None)
                if name == FrameUpload.__name__ or name.startswith("Body_"):
                    properties = schema["properties"]
                    schema["properties"] = {k: _form_field(v) for k, v in properties.items()}
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _form_field(schema: dict[str, Any]) -> dict[str, Any]:
    """Write a field of a form as generators understand it.

    A form has no null: an optional field is one that may be missing. And without the format,
    which FastAPI leaves out, generated clients send files as text.
    """
    kind: dict[str, Any] = next(
        (part for part in schema.get("anyOf", ()) if part != {"type": "null"}), {}
    )
    rest = {k: v for k, v in schema.items() if k != "anyOf" and (k, v) != ("default", None)}
    schema = {**kind, **rest}
    if schema.get("contentMediaType") == "application/octet-stream":
        schema["format"] = "binary"
    return schema
