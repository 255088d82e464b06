"""The bodies and query parameters that all routes on poses take."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from fastapi import Depends, Query, Request
from pydantic import ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

from app.api.schemas import (
    Evidence,
    FrameUpload,
    JointForm,
    KeypointSetName,
    ObservedSetName,
    SilhouetteForm,
)
from app.api.tracking_schemas import LATEST_TIMESTAMP_S, MOST_TRACK_ID_CHARACTERS, TrackUpload
from app.estimation.upload import Upload, UploadError
from app.http.problems import ProblemError
from app.messages import NUMBER, WHOLE_NUMBER, expected_and_got, shortened
from app.routes.forms import check_fields, file_of, text_of
from app.serving.runtime import runtime_of
from app.settings import Settings
from app.vision.geometry import Box

_MULTIPART = "multipart/form-data"


def is_multipart(request: Request) -> bool:
    """Whether the content type says that the body is a form with files, in any case."""
    return request.headers.get("content-type", "").lower().startswith(_MULTIPART)


def is_image(request: Request) -> bool:
    """Whether the content type says that the body is an image."""
    return request.headers.get("content-type", "").lower().startswith("image/")


def is_video(request: Request) -> bool:
    """Whether the content type says that the body is a video."""
    return request.headers.get("content-type", "").lower().startswith("video/")


def unsupported_body(request: Request, expected: str = _MULTIPART) -> ProblemError:
    """Make a 415 for any other body."""
    got = request.headers.get("content-type", "")[:100] or "none"
    return ProblemError(415, f"expected a body of type {expected}, got {got}")


# Strict: true and "12" are no numbers.
_BOXES = TypeAdapter(
    list[Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]],
    config=ConfigDict(strict=True),
)
_TRACK_IDS = TypeAdapter(
    list[
        Annotated[str, Field(min_length=1, max_length=MOST_TRACK_ID_CHARACTERS)]
        | Annotated[int, Field(ge=-(2**63), lt=2**63)]
    ],
    config=ConfigDict(strict=True),
)
Timestamp = Annotated[FiniteFloat, Field(ge=0, le=LATEST_TIMESTAMP_S), NUMBER]
_TIMESTAMP = TypeAdapter[float](Timestamp)

_LONGEST_BOX = 256  # In characters, spaces and line breaks included.

HypothesisCount = Annotated[
    int,
    Query(ge=1, le=50, description="Hypotheses per person, 1 to 50.", examples=[7]),
    WHOLE_NUMBER,
]

KeypointSetQuery = Annotated[
    KeypointSetName,
    Query(
        description="`native` or `cmu19`: the 19 joints of the index; `coco17`: the 17 COCO "
        "keypoints; `h36m17`: the 17 of Human3.6M.",
        examples=["native"],
    ),
]

ObservedSetQuery = Annotated[
    ObservedSetName,
    Query(
        description="Which keypoints `observed_keypoints` lists: `coco17`, or `blazepose33`, all "
        "33 landmarks that are read.",
        examples=["coco17"],
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

TimestampQuery = Annotated[
    Timestamp | None,
    Query(
        description="As the form field of this name, for a photograph that is the body itself.",
        examples=[12.4],
    ),
]


def _documented(form: type[FrameUpload]) -> dict[str, Any]:
    return {
        "requestBody": {
            "required": True,
            "description": "A photograph alone may also be the body itself, as `image/jpeg` or any "
            "other type of image.",
            "content": {
                "multipart/form-data": {"schema": {"$ref": f"#/components/schemas/{form.__name__}"}}
            },
        }
    }


DOCUMENTED_UPLOAD = _documented(FrameUpload)
"""What FastAPI would write if it parsed the form itself."""

DOCUMENTED_TRACK_UPLOAD = _documented(TrackUpload)


# FastAPI parses the form that a route declares before it asks for the key, and its validation of
# four fields takes nearly as long as all its other work on a request.
async def _read(request: Request, model: type[FrameUpload]) -> tuple[Upload, float | None]:
    if is_image(request):
        return Upload(await request.body()), None
    if not is_multipart(request):
        raise unsupported_body(request, "multipart/form-data or image/*")
    async with request.form() as form:
        check_fields(form, model.model_fields)
        boxes, timestamp = text_of(form, "boxes"), text_of(form, "timestamp")
        track_ids = text_of(form, "track_ids")
        upload = Upload(
            await file_of(form, "frame"),
            mask=await file_of(form, "mask"),
            background=await file_of(form, "background"),
            boxes=_parse_boxes(boxes, runtime_of(request).settings) if boxes else None,
            track_ids=_parse_track_ids(track_ids) if track_ids else None,
        )
        return upload, _parse_timestamp(timestamp) if timestamp else None


async def _read_upload(request: Request) -> Upload:
    return (await _read(request, FrameUpload))[0]


UploadForm = Annotated[Upload, Depends(_read_upload)]


class TrackedUpload(NamedTuple):
    """A frame of a camera, and when it was taken, in seconds, if the caller says so."""

    upload: Upload
    timestamp: float | None


async def _read_track_upload(request: Request, timestamp: TimestampQuery = None) -> TrackedUpload:
    upload, field = await _read(request, TrackUpload)
    if timestamp is not None and field is not None:
        raise ProblemError(
            422,
            "timestamp: expected a form field or a query parameter, got both",
            field="timestamp",
        )
    return TrackedUpload(upload, timestamp if field is None else field)


TrackUploadForm = Annotated[TrackedUpload, Depends(_read_track_upload)]


def _parse_timestamp(text: str) -> float:
    try:
        return _TIMESTAMP.validate_python(text)
    except ValidationError as error:
        raise ProblemError(
            422, f"timestamp: {expected_and_got(error.errors()[0])}", field="timestamp"
        ) from None


def _parse_boxes(text: str, settings: Settings) -> list[Box]:
    # Counted before they are parsed: hundreds of thousands would keep all other callers waiting.
    count, most = text.count("[") - 1, settings.max_persons
    if count > most:
        raise UploadError("boxes", "misfit", f"expected at most {most} persons, got {count}")
    if len(text) > most * _LONGEST_BOX:
        longest = f"expected a list of at most {most * _LONGEST_BOX} characters, got {len(text)}"
        raise UploadError("boxes", "misfit", f"boxes: {longest}")
    try:
        boxes = _BOXES.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"[{part}]" for part in first["loc"])
        raise ProblemError(
            422,
            "boxes: expected a JSON list of [x, y, width, height], "
            f"got a mistake at boxes{place}: {expected_and_got(first)}",
            field="boxes",
        ) from None
    for position, (_, _, width, height) in enumerate(boxes):
        if not (width > 0 and height > 0):
            got = f"box {position}: {boxes[position]}"
            raise UploadError(
                "boxes", "misfit", f"boxes: expected a positive width and height, got {got}"
            )
    return [Box(*numbers) for numbers in boxes]


def _parse_track_ids(text: str) -> list[str]:
    try:
        return [str(track_id) for track_id in _TRACK_IDS.validate_json(text)]
    except ValidationError:
        raise ProblemError(
            422,
            "track_ids: expected a JSON list of texts of 1 to "
            f"{MOST_TRACK_ID_CHARACTERS} characters or whole numbers, got {shortened(text)}",
            field="track_ids",
        ) from None
