"""Frames in: poses, pictures of them, silhouettes."""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from app.api.pictures import draw_labels, draw_overlay, draw_silhouettes, encode_png
from app.api.replies import pose_reply
from app.api.schemas import PoseResponse
from app.estimation.results import Evidence
from app.http.identity import NamesCamera, RequireKey
from app.routes.openapi import BINARY, documented
from app.routes.queries import (
    GivenOnce,
    OverlayQuery,
    PoseQuery,
    SilhouetteQuery,
    estimator_for,
)
from app.routes.uploads import DOCUMENTED_UPLOAD, UploadForm
from app.scheduling.job import Job
from app.serving import run_frame, runtime_of
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import KEYPOINT_SETS

router = APIRouter(
    tags=["pose"],
    dependencies=[RequireKey, GivenOnce, NamesCamera],
    responses=documented(400, 401, 403, 408, 413, 415, 422, 503),
)

PNG: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "A PNG image; its type is always `image/png`.",
        "content": {"image/png": BINARY["application/octet-stream"], **BINARY},
    }
}


@router.post(
    "/pose",
    operation_id="estimate_pose",
    summary="3D poses of the people in a frame",
    response_model=PoseResponse,
    openapi_extra=DOCUMENTED_UPLOAD,
)
async def estimate_pose(
    request: Request, upload: UploadForm, query: Annotated[PoseQuery, Query()]
) -> Response:
    """Estimate the 3D poses of the people in a frame.

    Each person has the nearest distinct poses of the index, the best first. A frame without people
    gives an empty list.
    """
    runtime = runtime_of(request)
    estimator = estimator_for(runtime.ready_estimator(), query)

    def work(job: Job) -> bytes:
        estimate = estimator.estimate(query.of(upload), query.n, job, query.evidence)
        runtime.metrics.observe_frame(estimate)
        reply = pose_reply(estimate, estimator.index, query.form, job.checkpoint)
        return reply.model_dump_json().encode()

    content = await run_frame(request, work, kind=(upload.given, estimator.method))
    return Response(content, media_type="application/json")


@router.post(
    "/pose/overlay",
    operation_id="draw_pose",
    summary="The frame with people's poses drawn on it",
    response_class=Response,
    responses=PNG,
    openapi_extra=DOCUMENTED_UPLOAD,
)
async def draw_pose(
    request: Request, upload: UploadForm, query: Annotated[OverlayQuery, Query()]
) -> Response:
    """Draw numbered boxes, silhouette outlines and the best skeletons over a frame.

    People are numbered from 1, in the order of `persons` in the reply of `/pose`. Limbs on the
    person's own left are orange, those on the right blue. A strip below the frame explains the
    colours; the pixels above it keep the frame's coordinates.
    """
    runtime = runtime_of(request)
    estimator = estimator_for(runtime.ready_estimator(), query)

    def work(job: Job) -> bytes:
        # The number of hypotheses is the default of `/pose`, so that both show the same posture.
        estimate = estimator.estimate(
            query.of(upload), DEFAULT_HYPOTHESES, job, query.evidence, shown=True
        )
        runtime.metrics.observe_stages(estimate.timings_ms)
        return encode_png(draw_overlay(estimate, KEYPOINT_SETS[query.keypoints]))

    content = await run_frame(request, work, kind=(upload.given, estimator.method))
    return Response(content, media_type="image/png")


@router.post(
    "/silhouette",
    operation_id="extract_silhouettes",
    summary="The silhouettes of the people in a frame",
    response_class=Response,
    responses=PNG,
    openapi_extra=DOCUMENTED_UPLOAD,
)
async def extract_silhouettes(
    request: Request, upload: UploadForm, query: Annotated[SilhouetteQuery, Query()]
) -> Response:
    """Segment the people of a frame: a label image, or with `view=1` a picture.

    In the label image, 0 is background, and k is the k-th of `persons` in the reply of `/pose`. It
    can be sent back as `mask`. Viewers show it nearly black, since labels are small numbers. It has
    no palette: OpenCV would read colours instead of labels. With `view=1`, the people have the
    colours of `/pose/overlay` on black.
    """
    runtime = runtime_of(request)
    estimator = estimator_for(runtime.ready_estimator(), query)

    def work(job: Job) -> bytes:
        # A background may cut one body into parts; landmarks show that they belong together.
        evidence: Evidence = "silhouette" if upload.background is None else "photograph"
        found = estimator.find_people(upload, job, evidence)
        runtime.metrics.observe_stages(job.stage_ms)
        return encode_png(draw_silhouettes(found) if query.view else draw_labels(found))

    content = await run_frame(request, work, kind=(upload.given, estimator.method))
    return Response(content, media_type="image/png")
