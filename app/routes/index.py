"""The index: its content, and single entries."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from app import VERSION
from app.api.pictures import encode_png
from app.api.replies import entry_reply, index_reply
from app.api.schemas import EntryResponse, IndexResponse
from app.http.errors import ProblemError
from app.http.identity import RequireKey
from app.messages import WHOLE_NUMBER
from app.photograph import Estimator
from app.routes.openapi import documented
from app.routes.pose import PNG
from app.routes.queries import EntryQuery, GivenOnce, NoQuery
from app.serving import EstimatorDep, runtime_of

router = APIRouter(prefix="/index", tags=["index"], dependencies=[RequireKey, GivenOnce])

EntryNumber = Annotated[
    int,
    Path(ge=0, description="Number of the entry, as hypotheses name it.", examples=[20117]),
    WHOLE_NUMBER,
]


@router.get(
    "",
    operation_id="describe_index",
    summary="The content of the index",
    dependencies=[NoQuery],
    responses=documented(401, 503),
)
async def describe_index(request: Request, estimator: EstimatorDep) -> IndexResponse:
    """Describe the index: its content, how it was built, and the source of its data."""
    revision = runtime_of(request).settings.revision
    return index_reply(estimator.index, VERSION, revision, estimator.method)


@router.get(
    "/entries/{entry}",
    operation_id="get_entry",
    summary="One entry of the index",
    responses=documented(401, 404, 422, 503),
)
async def get_entry(
    entry: EntryNumber, estimator: EstimatorDep, query: Annotated[EntryQuery, Query()]
) -> EntryResponse:
    """Get one entry: skeleton, action, clip, frame, subject and camera."""
    _check_number(entry, estimator)
    return entry_reply(estimator.index.entry(entry), query.keypoints)


@router.get(
    "/entries/{entry}/silhouette.png",
    operation_id="get_entry_silhouette",
    summary="The silhouette of an entry",
    dependencies=[NoQuery],
    response_class=Response,
    responses={**PNG, **documented(401, 404, 422, 503)},
)
async def get_entry_silhouette(entry: EntryNumber, estimator: EstimatorDep) -> Response:
    """Get the normalised silhouette of an entry: 48x128 pixels, white on black."""
    _check_number(entry, estimator)
    picture = estimator.index.silhouette(entry) * 255
    return Response(encode_png(picture), media_type="image/png")


def _check_number(entry: int, estimator: Estimator) -> None:
    if entry >= len(estimator.index):
        last = len(estimator.index) - 1
        raise ProblemError(404, f"expected an entry from 0 to {last}, got {entry}")
