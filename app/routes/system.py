"""Probes, metrics, the debug page and the API's documentation page."""

from importlib.resources import files
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import FileResponse, HTMLResponse, Response
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from starlette.staticfiles import StaticFiles

from app.api.schemas import Health
from app.routes.openapi import documented
from app.serving import EstimatorDep, runtime_of

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


_FOLDER = Path(__file__).resolve().parent.parent / "static"

_HEADERS = {
    # The page shows photographs of people: no foreign script may run in it.
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; "
    "media-src 'self' blob:; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
}


# The paths are relative, so that the page also works behind a proxy that serves it under a path.
_ASSETS, _DOCUMENT = "docs/assets", "docs/openapi.json"


def add_pages(app: FastAPI) -> None:
    """Serve the debug page at ``/``, and Swagger UI at ``/docs`` from fastapi-offline's files."""

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(_FOLDER / "index.html", headers=_HEADERS)

    @app.get(f"/{_DOCUMENT}", include_in_schema=False)
    async def document() -> dict[str, Any]:
        # Generators of clients do not understand relative servers, so this is another document.
        return {**app.openapi(), "servers": [{"url": ".."}]}

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return get_swagger_ui_html(
            openapi_url=_DOCUMENT,
            title=f"{app.title}: API",
            swagger_js_url=f"{_ASSETS}/swagger-ui-bundle.js",
            swagger_css_url=f"{_ASSETS}/swagger-ui.css",
            swagger_favicon_url=f"{_ASSETS}/favicon.png",
            # By default, the page sends the document's URL to a validator on the Internet.
            swagger_ui_parameters={"validatorUrl": None},
        )

    app.mount("/static", StaticFiles(directory=_FOLDER))
    app.mount(f"/{_ASSETS}", StaticFiles(directory=str(files("fastapi_offline") / "static")))
