"""The bodies of requests: forms with images, or an image or a video alone.

Forms are parsed here rather than by FastAPI. It would read a whole form before it asks for the API
key, its validation of four fields takes nearly as long as all its other work on a request, and a
form model with an optional file is described as URL-encoded in the OpenAPI document.

Limits on size and time are enforced earlier, in :mod:`app.http.admission`.
"""

from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from typing import Annotated, NamedTuple

from fastapi import Depends, Request
from pydantic import ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from app.api.schemas import FrameUpload
from app.api.tracking_schemas import MAX_TRACK_ID_CHARACTERS, TrackUpload
from app.estimation.upload import Upload, UploadError
from app.http.errors import ProblemError, invalid
from app.messages import expected_and_got, located, shortened
from app.routes.openapi import documented_form
from app.routes.queries import Timestamp, check_given_once, check_names
from app.serving import runtime_of
from app.settings import Settings
from app.vision.geometry import Box

MULTIPART = "multipart/form-data"
BYTE_ORDER_MARK = "\ufeff"  # Before text and JSON of some Windows programs.


def has_type(request: Request, start: str) -> bool:
    """Whether the content type of a request, in any case, begins like this."""
    return request.headers.get("content-type", "").lower().startswith(start)


def unsupported_body(request: Request, expected: str = MULTIPART) -> ProblemError:
    got = request.headers.get("content-type", "")[:100] or "none"
    return ProblemError(415, f"expected a body of type {expected}, got {got}")


_FILES = ("frame", "mask", "background", "image")


class _FormParser(MultiPartParser):
    """Starlette's parser, which keeps all files in memory and notices where a form was cut off."""

    spool_max_size = 2**62  # Admission limits uploads: no photograph reaches a disk.
    is_complete = False

    def on_headers_finished(self) -> None:
        """Make a file of a part by its name alone: some clients send no filename."""
        part = self._current_part
        _, options = parse_options_header(part.content_disposition)
        if options.get(b"name", b"").decode("latin-1") in _FILES and b"filename" not in options:
            part.content_disposition = (part.content_disposition or b"") + b'; filename=""'
        super().on_headers_finished()

    def on_end(self) -> None:
        self.is_complete = True


@asynccontextmanager
async def form_of(request: Request) -> AsyncIterator[FormData]:
    """Parse the form of a request; raise a 400 if it is none. Its files are closed at the end."""
    parser = _FormParser(request.headers, request.stream())
    if "boundary=" not in request.headers["content-type"].lower():
        such = f"{MULTIPART}; boundary=x"
        raise _broken_form(f"expected a boundary in the content type, such as {such}, got none")
    try:
        form = await parser.parse()
    except MultiPartException:
        such = f"a well-formed {MULTIPART} body of at most 1000 parts"
        raise _broken_form(f"expected {such}") from None
    try:
        if not parser.is_complete:
            raise _broken_form("expected a form that ends with its boundary, got a part of one")
        yield form
    finally:
        await form.close()


def _broken_form(sentence: str) -> ProblemError:
    return ProblemError(400, sentence, reason="undecodable")


def check_fields(form: FormData, known: Collection[str]) -> None:
    """Raise a 422 if a form holds an unknown field, or a field twice."""
    names = [name for name, _ in form.multi_items()]
    check_names(names, known, "fields")
    check_given_once(names, "part")


async def file_of(form: FormData, field: str) -> bytes | None:
    """Return the content of a file; None if it is missing or, as browsers then send it, empty."""
    part = form.get(field)
    if not isinstance(part, UploadFile):
        return None
    content = await part.read()
    if part.filename:
        return content
    if content and content.isascii():  # `-F frame=frame.jpg`, without curl's @.
        raise invalid(field, f"expected a file, got text: {shortened(content.decode())}")
    return content or None


def text_of(form: FormData, field: str) -> str | None:
    """Return the text of a field, None if it is missing."""
    part = form.get(field)
    if isinstance(part, UploadFile):
        raise invalid(field, "expected text, got a file")
    return None if part is None else part.removeprefix(BYTE_ORDER_MARK)


# Parsing is strict: neither true nor "12" is a number.
_BOXES = TypeAdapter(
    list[Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]],
    config=ConfigDict(strict=True),
)
_TRACK_IDS = TypeAdapter(
    list[
        Annotated[str, Field(min_length=1, max_length=MAX_TRACK_ID_CHARACTERS)]
        | Annotated[int, Field(ge=-(2**63), lt=2**63)]
    ],
    config=ConfigDict(strict=True),
)
_TIMESTAMP = TypeAdapter[float](Timestamp)

_OR_A_PHOTOGRAPH = (
    "A form, or a photograph alone: as `application/octet-stream`, `image/jpeg` or any other type "
    "of image."
)
DOCUMENTED_UPLOAD = documented_form(FrameUpload, _OR_A_PHOTOGRAPH)
DOCUMENTED_TRACK_UPLOAD = documented_form(TrackUpload, _OR_A_PHOTOGRAPH)


class TrackedUpload(NamedTuple):
    """A frame of a camera, and the form's timestamp in seconds, if it has one."""

    upload: Upload
    timestamp: float | None = None


async def _read(request: Request, model: type[FrameUpload]) -> TrackedUpload:
    if has_type(request, "image/") or has_type(request, "application/octet-stream"):
        return TrackedUpload(Upload(await request.body()))
    if not has_type(request, MULTIPART):
        raise unsupported_body(request, f"{MULTIPART} or image/*")
    async with form_of(request) as form:
        check_fields(form, model.model_fields)
        boxes, timestamp = text_of(form, "boxes"), text_of(form, "timestamp")
        track_ids, settings = text_of(form, "track_ids"), runtime_of(request).settings
        upload = Upload(
            await file_of(form, "frame"),
            mask=await file_of(form, "mask"),
            background=await file_of(form, "background"),
            boxes=_parse_boxes(boxes, settings) if boxes else None,
            track_ids=_parse_track_ids(track_ids, settings) if track_ids else None,
        )
        try:
            seconds = None if timestamp is None else _TIMESTAMP.validate_python(timestamp)
            return TrackedUpload(upload, seconds)
        except ValidationError as error:
            raise invalid("timestamp", expected_and_got(error.errors()[0])) from None


async def _read_upload(request: Request) -> Upload:
    return (await _read(request, FrameUpload)).upload


async def _read_track_upload(request: Request) -> TrackedUpload:
    return await _read(request, TrackUpload)


UploadForm = Annotated[Upload, Depends(_read_upload)]
TrackUploadForm = Annotated[TrackedUpload, Depends(_read_track_upload)]


def _parse_boxes(text: str, settings: Settings) -> list[Box]:
    # They are counted before they are parsed, which would keep all other clients waiting.
    count, most = text.count("[") - 1, settings.max_persons
    if count > most:
        raise UploadError("boxes", f"expected at most {most} persons, got {count}")
    _check_length("boxes", text, settings)
    try:
        boxes = _BOXES.validate_json(text)
    except ValidationError as error:
        place, sentence = located(error)
        such = "boxes are a JSON list of [x, y, width, height]"
        raise ProblemError(422, f"boxes{place}: {sentence}; {such}", field="boxes") from None
    for position, (_, _, width, height) in enumerate(boxes):
        if not (width > 0 and height > 0):
            got = f"box {position}: {boxes[position]}"
            raise UploadError("boxes", f"boxes: expected a positive width and height, got {got}")
    return [Box(*numbers) for numbers in boxes]


def _check_length(field: str, text: str, settings: Settings) -> None:
    most = settings.max_persons * 256  # Spaces and line breaks included.
    if len(text) > most:
        longest = f"a list of at most {most} characters"
        raise UploadError(field, f"{field}: expected {longest}, got {len(text)}")


def _parse_track_ids(text: str, settings: Settings) -> list[str]:
    _check_length("track_ids", text, settings)
    try:
        return [str(track_id) for track_id in _TRACK_IDS.validate_json(text)]
    except ValidationError:
        such = f"texts of 1 to {MAX_TRACK_ID_CHARACTERS} characters or whole numbers of 64 bits"
        expected = f"expected a JSON list of {such}, got {shortened(text)}"
        raise invalid("track_ids", expected) from None
