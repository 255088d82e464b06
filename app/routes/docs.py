"""The API's documentation page, served from local files so that it works offline."""

from __future__ import annotations

from importlib.resources import files

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import HTMLResponse
from starlette.staticfiles import StaticFiles

# Relative, so that the page also works behind a proxy that serves it under a path.
_ASSETS = "docs/assets"


def add_docs(app: FastAPI) -> None:
    """Serve Swagger UI under ``/docs`` from the files of the package fastapi-offline."""

    @app.get("/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return get_swagger_ui_html(
            openapi_url="openapi.json",
            title=f"{app.title}: API",
            swagger_js_url=f"{_ASSETS}/swagger-ui-bundle.js",
            swagger_css_url=f"{_ASSETS}/swagger-ui.css",
            swagger_favicon_url=f"{_ASSETS}/favicon.png",
            # By default, the page sends the document's address to a validator on the Internet.
            swagger_ui_parameters={"validatorUrl": None},
        )

    app.mount(f"/{_ASSETS}", StaticFiles(directory=str(files("fastapi_offline") / "static")))
