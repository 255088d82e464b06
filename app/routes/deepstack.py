"""DeepStack's detection protocol, which Frigate, Blue Iris and Home Assistant speak."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, File, Form, Request, UploadFile

from app.auth import check_key
from app.errors import documented
from app.pool import Watch
from app.runtime import run_in_pool, runtime_of
from app.schemas import FRAME, DeepstackPrediction, DeepstackResponse

router = APIRouter(
    prefix="/v1/vision",
    tags=["compatibility"],
    responses=documented(400, 401, 408, 413, 415, 422, 503),
)


@router.post("/detection", operation_id="detect_deepstack")
async def detect_deepstack(
    request: Request,
    image: Annotated[UploadFile, File(description=FRAME)],
    min_confidence: Annotated[
        float,
        Form(ge=0, le=1, description="Detections below this score are left out.", examples=[0.4]),
    ] = 0.4,
    api_key: Annotated[
        str | None, Form(description="Where the operator has set keys; a header does as well.")
    ] = None,
) -> DeepstackResponse:
    """Find people, as DeepStack's clients ask for it.

    Whole people by their boxes, without silhouettes or poses; only the label `person` occurs.
    """
    runtime = runtime_of(request)
    estimator = runtime.ready_estimator()
    bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
    check_key(runtime.settings, (api_key, request.headers.get("x-api-key"), bearer))
    started = time.perf_counter()
    data = await image.read()

    def work(watch: Watch) -> list[DeepstackPrediction]:
        return [
            DeepstackPrediction(
                label="person",
                confidence=found.detection_score or 0.0,
                x_min=max(0, round(found.box.x)),
                y_min=max(0, round(found.box.y)),
                x_max=round(found.box.right),
                y_max=round(found.box.bottom),
            )
            for found in estimator.detect(data, watch.check)
            if (found.detection_score or 0.0) >= min_confidence
        ]

    predictions = await run_in_pool(request, work)
    return DeepstackResponse(
        success=True, predictions=predictions, duration=time.perf_counter() - started
    )
