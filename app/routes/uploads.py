"""The multipart form that all routes on poses take."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Query, Request
from pydantic import ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

from app.errors import ProblemError, is_image, is_multipart, unsupported_body
from app.messages import expected_and_got
from app.routes.forms import check_fields, file_of, text_of
from app.schemas import Evidence, FrameUpload, JointForm, KeypointSetName, SilhouetteForm
from app.upload import Upload
from app.vision.people import Box

# Strict: true and "12" are no numbers.
_BOXES = TypeAdapter(
    list[Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]],
    config=ConfigDict(strict=True),
)

DEFAULT_HYPOTHESES = 7

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


EvidenceQuery = Annotated[
    Evidence,
    Query(
        description="`photograph`: the silhouette and the keypoints that the photograph shows, and "
        "with them which way a person faces; `silhouette`: the silhouette alone, as in the paper, "
        "which is fastest.",
        examples=["photograph"],
    ),
]

SilhouettesQuery = Annotated[
    SilhouetteForm,
    Query(
        description="Whether the answer includes silhouettes, and in which of COCO's forms: "
        "`rle`, every pixel; `polygon`, the outlines.",
        examples=["rle"],
    ),
]

JointsQuery = Annotated[
    JointForm,
    Query(
        description="How joints are written: `full`, an object for each; `compact`, plain "
        "numbers in `joints_3d_flat` and `joints_2d_flat`, which are shorter; `none`, not "
        "at all, if only boxes, silhouettes or entries are wanted.",
        examples=["full"],
    ),
]

DOCUMENTED_UPLOAD: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "A photograph alone may also be the body itself, as `image/jpeg` or any "
        "other type of image.",
        "content": {
            "multipart/form-data": {"schema": {"$ref": "#/components/schemas/FrameUpload"}}
        },
    }
}
"""What FastAPI would write if it parsed the form itself."""


# FastAPI parses the form that a route declares before it asks for the key, and its validation of
# four fields takes nearly as long as all its other work on a request.
async def _read_upload(request: Request) -> Upload:
    if is_image(request):
        return Upload(await request.body())
    if not is_multipart(request):
        raise unsupported_body(request, "multipart/form-data or image/*")
    async with request.form() as form:
        check_fields(form, FrameUpload.model_fields)
        boxes = text_of(form, "boxes")
        return Upload(
            await file_of(form, "frame"),
            mask=await file_of(form, "mask"),
            background=await file_of(form, "background"),
            boxes=_parse_boxes(boxes) if boxes else None,
        )


UploadForm = Annotated[Upload, Depends(_read_upload)]


def _parse_boxes(text: str) -> list[Box]:
    try:
        return [Box(*numbers) for numbers in _BOXES.validate_json(text)]
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"[{part}]" for part in first["loc"])
        raise ProblemError(
            422,
            "boxes: expected a JSON list of [x, y, width, height], "
            f"got a mistake at boxes{place}: {expected_and_got(first)}",
            field="boxes",
        ) from None
    except ValueError as error:
        raise ProblemError(422, f"boxes: {error}", field="boxes") from None
