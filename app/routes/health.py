"""Probes for orchestrators and load balancers, and metrics."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import Response
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4

from app.api.schemas import Health
from app.http.openapi import documented
from app.serving.runtime import EstimatorDep, runtime_of

router = APIRouter(tags=["health"])


@router.get("/healthz", operation_id="liveness", summary="Whether the process answers")
async def liveness() -> Health:
    """Report that the process answers; nothing else is checked."""
    return Health()


@router.get(
    "/readyz",
    operation_id="readiness",
    summary="Whether frames can be answered",
    responses=documented(503),
)
async def readiness(estimator: EstimatorDep) -> Health:
    """Report whether frames can be answered and, if not, why."""
    return Health()


@router.get("/metrics", include_in_schema=False)
async def metrics(request: Request) -> Response:
    """Write the metrics in Prometheus' text format."""
    return Response(runtime_of(request).metrics.text(), media_type=CONTENT_TYPE_PLAIN_0_0_4)
