"""Photographs, masks, empty scenes and keys given to the debug page, and the errors it shows."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import Photo, Server, running_server
from tests.system.test_page import overflows, pictures

__all__ = ["pictures"]


@pytest.fixture(scope="module")
def key_server(index_path: Path) -> Iterator[Server]:
    """A server process that asks for a key."""
    with running_server(index_path, POSE_API_KEYS="first,second") as running:
        yield running


def test_the_page_begins_with_an_example(browser: Any, server: Server) -> None:
    page = browser.new_page()
    page.goto(server.url)
    page.locator("#hypotheses .card").first.wait_for()
    assert "PETS 2009" in page.locator("#note").inner_text()
    assert page.locator("#persons input").count() >= 3
    download, request = page.locator("#curl").inner_text().splitlines()
    assert download.startswith("curl -O 'http") and download.endswith("/static/example.jpg'")
    assert request.startswith("curl -F 'frame=@example.jpg' 'http")
    page.close()


def test_what_may_pass_can_be_tried_again(page: Any, pictures: list[str]) -> None:
    page.route("**/pose?*", lambda route: route.abort())
    page.set_input_files("#file", pictures)
    page.get_by_text("The service does not answer.").wait_for()
    page.unroute("**/pose?*")
    page.get_by_role("button", name="Try again").click()
    page.locator("#hypotheses .card").first.wait_for()
    assert page.locator("#message").is_hidden()


def test_a_mask_alone_is_a_mask(page: Any, photo: Photo, tmp_path: Path) -> None:
    name = "people.png"
    (tmp_path / name).write_bytes(photo.mask_png)
    page.set_input_files("#file", str(tmp_path / name))
    page.locator("#hypotheses .card").first.wait_for()
    assert page.locator("#curl").inner_text().startswith(f"curl -F 'mask=@{name}' 'http")
    assert f"{name} is read as a mask" in page.locator("#note").inner_text()
    assert "your mask" in page.locator("#facts").inner_text()
    page.get_by_role("button", name="Read it as a photograph").click()
    page.get_by_text("Nobody was found").wait_for()


def test_the_key_is_asked_for_in_words(browser: Any, key_server: Server) -> None:
    page = browser.new_page(viewport={"width": 320, "height": 844})
    try:
        page.goto(key_server.url)
        page.get_by_text("This service is protected by a key.").wait_for()
        assert not overflows(page)
        page.get_by_role("button", name="Try an example").click()
        page.get_by_text("This service is protected by a key.").wait_for()
        assert page.locator("#key-wrong").is_hidden()
        page.locator("#key").fill("wrong")
        page.get_by_role("button", name="Use this key").click()
        page.get_by_text("The service does not know this key.").wait_for()
        page.locator("#key").fill("first")
        page.locator("#key").press("Enter")
        page.get_by_text("silhouettes,").wait_for()
        assert page.locator("#key-form").is_hidden()
        page.locator("#hypotheses .card").first.wait_for()
        assert 'curl -H "X-API-Key: $KEY" -F' in page.locator("#curl").inner_text()
    finally:
        page.close()
