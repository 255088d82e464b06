"""The OpenAPI document: FastAPI's with additions."""

from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel

from app.api import tracking_schemas as tracking
from app.api.schemas import DeepstackUpload, FrameUpload, Problem
from app.configuration import CameraConfiguration
from app.http.errors import MEDIA_TYPE

_FORMS = (FrameUpload, tracking.TrackUpload, tracking.VideoUpload, DeepstackUpload)

TAGS = [
    {"name": "pose", "description": "A frame in; its people, their silhouettes and poses out."},
    {"name": "cameras", "description": "Frames of fixed cameras, in order; people over time."},
    {"name": "index", "description": "The simulated silhouettes that people are compared with."},
    {"name": "compatibility", "description": "Other services' protocols, for their clients."},
    {"name": "health", "description": "Whether the service runs, and whether it takes frames."},
]

SERVERS = [
    {"url": "/", "description": "The service this document came from."},
    {"url": "http://127.0.0.1:8000", "description": "As `make run` serves it."},
]

HEADERS: dict[str, Any] = {
    "X-Request-ID": {
        "description": "The request's own `X-Request-ID` if it has 1 to 64 of the characters "
        "`A-Za-z0-9._-`, else a new one; the service's log contains it.",
        "schema": {"type": "string"},
    },
    "Retry-After": {
        "description": "Seconds until there is probably room for another frame, or the index is "
        "loaded. Missing if waiting does not help.",
        "schema": {"type": "integer", "minimum": 1},
    },
    "X-Session": {
        "description": "`new` if the camera starts afresh and nothing is known of earlier frames; "
        "else `warm`.",
        "schema": {"type": "string", "enum": ["new", "warm"]},
    },
}


def add_openapi(app: FastAPI) -> None:
    """Make ``app`` describe its errors, and its uploads so that generated clients work.

    Routes refer to these by name: of a declared error, FastAPI would also promise
    ``application/json``, and forms are parsed by the routes themselves.
    """
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = generate()
            components = document["components"]
            components["headers"] = HEADERS
            for model in (
                Problem,
                CameraConfiguration,
                tracking.EventReplay,
                tracking.SequenceResponse,
                *_FORMS,
            ):
                schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
                for name, part in (*schema.pop("$defs", {}).items(), (model.__name__, schema)):
                    components["schemas"].setdefault(name, part)
            for name, schema in components["schemas"].items():
                _mend_schema(name, schema)
            for path in document["paths"].values():
                for operation in path.values():
                    _mend_operation(operation)
            _name_precision(document)
        return generate()

    app.openapi = openapi  # type: ignore[method-assign]


def _mend_schema(name: str, schema: dict[str, Any]) -> None:
    # The models forbid additional fields, but a later version may add some, and clients that refuse
    # them would break. (And openapi-generator warns.)
    schema.pop("additionalProperties", None)
    properties = schema.get("properties", {})
    if name in {form.__name__ for form in _FORMS}:
        properties = {field: _form_field(value) for field, value in properties.items()}
        schema["properties"] = properties
    if name == CameraConfiguration.__name__:
        # openapi-typescript takes a field with a default for one that must be there.
        for value in properties.values():
            del value["default"]
    for value in properties.values():
        value.pop("title", None)  # Pydantic's titles only repeat the name, capitalised.


def _name_precision(part: Any) -> None:
    """Make every number of the document a double: in 32 bits, Unix time moves in steps of 128 s."""
    for child in part.values() if isinstance(part, dict) else part:
        if isinstance(child, dict | list):
            _name_precision(child)
    if isinstance(part, dict) and part.get("type") == "number":
        part["format"] = "double"


def _mend_operation(operation: dict[str, Any]) -> None:
    for parameter in operation.get("parameters", ()):
        parameter["schema"].pop("title", None)
    operation["responses"]["500"] = documented(500)[500]
    for status, response in operation["responses"].items():
        names = ["X-Request-ID"] + ["Retry-After"] * (status == "503")
        names += ["X-Session"] * (operation["operationId"] == "track_frame")
        contents = response.get("content", {})
        if "application/json" in contents:  # Generated clients take the first.
            json = {"application/json": contents["application/json"]}
            response["content"] = contents = json | contents
        for content in contents.values():
            if "anyOf" in content["schema"]:
                # FastAPI also describes lines of JSON as a string.
                content["schema"] = {"anyOf": content["schema"]["anyOf"]}
        response["headers"] = {name: {"$ref": f"#/components/headers/{name}"} for name in names}
    if "security" in operation:
        # A key is required only if the operator has set any.
        operation["security"].append({})


def _form_field(schema: dict[str, Any]) -> dict[str, Any]:
    """Write a field of a form in a way that client generators understand.

    A form has no null: an optional field is missing. Generators treat a field with a default as one
    that is always present. Swagger UI fills in an example, if only "string", and sends it.
    """
    kinds = [part for part in schema.get("anyOf", ()) if part != {"type": "null"}]
    kind = kinds[0] if kinds else {}
    kept = {k: v for k, v in schema.items() if k not in ("anyOf", "default", "examples")}
    return kind | kept | ({"examples": [""]} if "default" in schema else {})


# openapi-python-client knows files of this type only, and not those of `image/*` or lines of JSON.
BINARY = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}


def documented_form(form: type[BaseModel], or_a_file: str = "") -> dict[str, Any]:
    """Describe the body of a request as FastAPI would if it parsed the form itself.

    ``or_a_file`` describes the file that may be the whole body instead.
    """
    schema = {"$ref": f"#/components/schemas/{form.__name__}"}
    body: dict[str, Any] = {"content": {"multipart/form-data": {"schema": schema}}}
    if or_a_file:
        body["description"] = or_a_file
        body["content"].update(BINARY)
    return {"requestBody": {"required": True, **body}}


def documented_json(model: type[BaseModel]) -> dict[str, Any]:
    """Describe content of type JSON by the name of its model."""
    return {"application/json": {"schema": {"$ref": f"#/components/schemas/{model.__name__}"}}}


def documented(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Describe error responses of a route for the OpenAPI document."""
    return {
        status: {
            "description": _MEANINGS[status],
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
        for status in statuses
    }


_MEANINGS = {
    400: "An upload is not a decodable image or video.",
    401: "API keys are configured, and that of the request is missing or wrong.",
    404: "There is no such resource.",
    408: "The upload took too long.",
    403: "The request comes from a page of another site, which is not allowed to send any.",
    409: "The frame is not later than the last one of its camera, or too many cameras are "
    "configured.",
    413: "Too many bytes or pixels.",
    415: "The body is neither multipart/form-data nor, where that is accepted, an image or a "
    "video.",
    422: "A parameter is invalid, or a mask, background or boxes do not fit the frame.",
    500: "The service failed; its log has the reason under the reply's `X-Request-ID`.",
    503: "Overloaded or unable to search (with Retry-After), or the index is not loaded.",
}
