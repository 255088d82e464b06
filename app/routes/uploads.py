"""The multipart form that all routes on frames take."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, File, Form, Query, UploadFile
from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError

from app.errors import ProblemError
from app.estimates import Upload
from app.schemas import KeypointSetName
from app.vision.people import Box

_BOXES = TypeAdapter(list[Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]])

FrameFile = Annotated[
    UploadFile,
    File(
        description="The photograph: JPEG, PNG, WebP, BMP, TIFF or GIF. Its EXIF orientation is "
        "applied; all pixels of the answer refer to the turned image.",
    ),
]

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


async def _read_upload(
    frame: FrameFile,
    mask: Annotated[
        UploadFile | None,
        File(
            description="Where the people are: an image of the frame's size, 0 background, "
            "k = person k; a two-valued mask is one person. PNG keeps the labels, JPEG does not.",
        ),
    ] = None,
    background: Annotated[
        UploadFile | None,
        File(
            description="The empty scene, of the frame's size and from the same fixed camera: "
            "people are what differs.",
        ),
    ] = None,
    boxes: Annotated[
        str | None,
        Form(
            description="Where the people are: a JSON list of `[x, y, width, height]` in pixels "
            "of the frame. With a background, what differs from it is cut out inside them; a mask "
            "excludes both.",
            examples=["[[401, 120, 61, 148]]"],
        ),
    ] = None,
) -> Upload:
    return Upload(
        frame=await frame.read(),
        mask=await mask.read() if mask is not None else None,
        background=await background.read() if background is not None else None,
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
            f"got a mistake at boxes{place}: {first['msg']}",
            field="boxes",
        ) from None
    except ValueError as error:
        raise ProblemError(422, f"boxes: {error}", field="boxes") from None
