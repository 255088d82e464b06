"""Swagger UI in headless Chromium: its requests are answered as they are filled in."""

from typing import Any

import pytest

from tests.conftest import Photo, Server


@pytest.mark.parametrize("prefix", ["", "/yard"])
def test_a_frame_can_be_tried_out(browser: Any, server: Server, photo: Photo, prefix: str) -> None:
    """Also behind a proxy that serves everything under a path, and strips it."""
    page = browser.new_page()
    page.route(
        f"{server.url}{prefix}/**",
        lambda route: route.continue_(url=route.request.url.replace(prefix, "", 1)),
    )
    page.goto(f"{server.url}{prefix}/docs")
    operation = page.locator("#operations-pose-estimate_pose")
    operation.locator(".opblock-summary").click()
    operation.get_by_role("button", name="Try it out").click()
    operation.locator("input[type=file]").first.set_input_files(
        {"name": "frame.png", "mimeType": "image/png", "buffer": photo.frame_png}
    )
    operation.get_by_role("button", name="Execute").click()
    status = operation.locator(".live-responses-table .response .response-col_status")
    assert status.inner_text().split()[0] == "200", operation.inner_text()
    page.close()
