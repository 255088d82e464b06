"""The multipart form that all routes on poses take."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Query, Request
from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError
from starlette.datastructures import FormData, UploadFile

from app.errors import ProblemError, is_multipart, not_multipart
from app.estimates import Upload
from app.schemas import KeypointSetName
from app.vision.people import Box

_BOXES = TypeAdapter(list[Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]])

HypothesisCount = Annotated[
    int, Query(ge=1, le=50, description="Hypotheses per person, 1 to 50.", examples=[7])
]

KeypointSetQuery = Annotated[
    KeypointSetName,
    Query(
        description="`native`: the 19 joints of the index; `coco17`: the 17 COCO keypoints.",
        examples=["native"],
    ),
]


DOCUMENTED_UPLOAD: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {"schema": {"$ref": "#/components/schemas/FrameUpload"}}
        },
    }
}
"""What FastAPI would write of the form, had it read it itself."""


# FastAPI reads the form that a route declares before it asks for the key, and telling four fields
# apart takes it nearly as long as all else that it does with a request.
async def _read_upload(request: Request) -> Upload:
    if not is_multipart(request):
        raise not_multipart(request)
    async with request.form() as form:
        frame = await _file(form, "frame")
        if frame is None:
            raise ProblemError(422, "frame: expected an image file, got none", field="frame")
        boxes = _text(form, "boxes")
        return Upload(
            frame,
            mask=await _file(form, "mask"),
            background=await _file(form, "background"),
            boxes=_parse_boxes(boxes) if boxes else None,
        )


UploadForm = Annotated[Upload, Depends(_read_upload)]


async def _file(form: FormData, field: str) -> bytes | None:
    """Content of a file; none is an empty field as well, which browsers send for no file."""
    part = form.get(field)
    if isinstance(part, UploadFile):
        return None if not part.filename and not part.size else await part.read()
    if part:
        raise ProblemError(422, f"{field}: expected a file, got text", field=field)
    return None


def _text(form: FormData, field: str) -> str | None:
    part = form.get(field)
    if isinstance(part, UploadFile):
        raise ProblemError(422, f"{field}: expected text, got a file", field=field)
    return part


def _parse_boxes(text: str) -> list[Box]:
    try:
        return [Box(*numbers) for numbers in _BOXES.validate_json(text)]
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"[{part}]" for part in first["loc"])
        raise ProblemError(
            422,
            "boxes: expected a JSON list of [x, y, width, height], "
            f"got a mistake at boxes{place}: {first['msg']}",
            field="boxes",
        ) from None
    except ValueError as error:
        raise ProblemError(422, f"boxes: {error}", field="boxes") from None
