"""DeepStack's detection protocol, which Frigate, Blue Iris and Home Assistant speak."""

import time
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from pydantic import ValidationError

from app.api.schemas import MAX_PREDICTIONS, DeepstackPrediction, DeepstackResponse, DeepstackUpload
from app.estimation.upload import Upload, UploadError
from app.http.errors import invalid
from app.http.identity import NamesCamera, identity_of, position_of_key, unauthorised
from app.messages import expected_and_got
from app.routes.openapi import documented, documented_form
from app.routes.queries import NoQuery
from app.routes.uploads import (
    MULTIPART,
    check_fields,
    file_of,
    form_of,
    has_type,
    text_of,
    unsupported_body,
)
from app.scheduling.job import Job
from app.serving import run_frame, runtime_of

router = APIRouter(
    prefix="/v1/vision",
    tags=["compatibility"],
    dependencies=[NoQuery, NamesCamera],
    responses=documented(400, 401, 403, 408, 413, 415, 422, 503),
)


async def _read_upload(request: Request) -> DeepstackUpload:
    # A wrong key in a header is refused before the body is read.
    identity = identity_of(request.scope)
    if identity.has_key and not identity.is_authorised:
        raise unauthorised(has_key=True)
    if not has_type(request, MULTIPART):
        raise unsupported_body(request)
    async with form_of(request) as form:
        api_keys = runtime_of(request).settings.api_keys
        key = text_of(form, "api_key")
        is_open = identity.has_key or not api_keys
        if not is_open and position_of_key(api_keys, [key]) is None:
            raise unauthorised(has_key=bool(key))
        check_fields(form, DeepstackUpload.model_fields)
        image = await file_of(form, "image")
        if image is None:
            raise invalid("image", "expected an image file, got none")
        given = {name: text_of(form, name) for name in ("min_confidence", "api_key")}
    try:
        given_texts = {name: text for name, text in given.items() if text}
        return DeepstackUpload.model_validate({"image": image, **given_texts})
    except ValidationError as error:
        first = error.errors()[0]
        raise invalid(str(first["loc"][0]), expected_and_got(first)) from None


@router.post(
    "/detection",
    operation_id="detect_deepstack",
    summary="The boxes of people, in DeepStack's form",
    openapi_extra=documented_form(DeepstackUpload),
)
async def detect_deepstack(
    request: Request, upload: Annotated[DeepstackUpload, Depends(_read_upload)]
) -> DeepstackResponse:
    """Find people for DeepStack's clients.

    The reply has the boxes of whole people, without silhouettes or poses; the only label is
    `person`. At most 20 people are returned, those with the highest scores.
    """
    runtime = runtime_of(request)
    estimator = runtime.ready_estimator()
    started = time.perf_counter()

    def work(job: Job) -> list[DeepstackPrediction]:
        try:
            people = estimator.find_people(Upload(upload.image), job, "silhouette").persons
        except UploadError as error:
            # The field is called frame in the estimator, image by DeepStack's clients.
            detail = f"image{str(error).removeprefix(error.field)}"
            raise UploadError("image", detail, error.reason) from None
        return [
            DeepstackPrediction(
                label="person",
                confidence=found.detection_score or 0.0,
                x_min=max(0, round(found.box.x)),
                y_min=max(0, round(found.box.y)),
                x_max=round(found.box.right),
                y_max=round(found.box.bottom),
            )
            for found in sorted(people, key=lambda one: -(one.detection_score or 0.0))
            if (found.detection_score or 0.0) >= upload.min_confidence
        ][:MAX_PREDICTIONS]

    predictions = await run_frame(request, work, kind=None)
    return DeepstackResponse(
        success=True, predictions=predictions, duration=time.perf_counter() - started
    )
