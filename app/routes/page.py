"""The debug page: plain files that ship with the service and need no other host."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

_FOLDER = Path(__file__).resolve().parent.parent / "static"

_HEADERS = {
    # Photographs of people pass through this page: no foreign script may run in it.
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; "
    "media-src 'self' blob:; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
}


def add_page(app: FastAPI) -> None:
    """Serve the debug page at ``/`` and its files under ``/static``."""

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(_FOLDER / "index.html", headers=_HEADERS)

    app.mount("/static", StaticFiles(directory=_FOLDER))
