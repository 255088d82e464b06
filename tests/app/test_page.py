"""The debug page in a real browser: headless Chromium, driven by Playwright."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from tests.conftest import Photo, Server, png

FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-fake-device-for-media-stream",
    "--use-fake-ui-for-media-stream",
]


def test_the_page_and_its_files_are_served_and_ask_nobody_else(client: TestClient) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    files = re.findall(r'(?:src|href)="(static/[^"]+)"', page.text)
    assert len(files) == 3
    for file in [*files, "static/service.js", "static/drawing.js"]:
        content = client.get(f"/{file}")
        assert content.status_code == 200
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", content.text)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(params=[1280, 390], ids=["desktop", "phone"])
def page(browser: Any, server: Server, request: pytest.FixtureRequest) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": request.param, "height": 844})
    page = context.new_page()
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("console", lambda m: troubles.append(m.text) if is_trouble(m) else None)
    page.goto(server.url)
    page.get_by_text("silhouettes,").wait_for()
    yield page
    context.close()
    assert troubles == []


@pytest.fixture
def pictures(photo: Photo, tmp_path: Path) -> list[str]:
    paths = {"street.png": photo.frame_png, "street_mask.png": photo.mask_png}
    for name, data in paths.items():
        (tmp_path / name).write_bytes(data)
    return [str(tmp_path / name) for name in paths]


def is_trouble(message: Any) -> bool:
    # Of an answer with an error status the browser complains by itself.
    return message.type == "error" and "Failed to load resource" not in message.text


def overflows(page: Any) -> bool:
    return bool(page.evaluate("document.documentElement.scrollWidth > innerWidth"))


def test_a_photograph_shows_its_pose(page: Any, pictures: list[str], photo: Photo) -> None:
    assert not overflows(page)
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").nth(6).wait_for()
    assert not overflows(page)
    assert page.locator("#hypotheses .card").count() == 7
    assert str(photo.entry) in page.locator("#hypotheses .card").first.inner_text()
    assert page.locator("#stage").evaluate("c => [c.width, c.height]") == [320, 240]
    command = page.locator("#curl").inner_text()
    assert "-F 'frame=@street.png' -F 'mask=@street_mask.png'" in command
    assert command.endswith("/pose?n=7&keypoints=native'")


def test_the_keyboard_chooses_and_turns(page: Any, pictures: list[str]) -> None:
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").first.wait_for()
    before = page.locator("#facts").inner_text()
    page.locator("#hypotheses input").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#hypotheses input").nth(1).is_checked()
    assert page.locator("#facts").inner_text() != before
    page.locator("#spin").set_checked(False)
    solid = page.locator("#solid")
    solid.focus()
    still = solid.evaluate("c => c.toDataURL()")
    page.keyboard.press("ArrowLeft")
    assert solid.evaluate("c => c.toDataURL()") != still


def test_the_tallest_person_is_shown_first_and_close_up(page: Any, tmp_path: Path) -> None:
    labels = np.zeros((240, 320), np.uint8)
    labels[100:160, 30:60], labels[60:200, 200:260] = 1, 2
    paths = [tmp_path / "two.png", tmp_path / "two_mask.png"]
    paths[0].write_bytes(png(np.full((240, 320, 3), 90, np.uint8)))
    paths[1].write_bytes(png(labels))
    page.set_input_files("#file", [str(path) for path in paths])
    page.locator("#hypotheses .card").first.wait_for()
    assert page.locator("#persons input").nth(1).is_checked()
    close_up = page.locator("#close-up")
    second = close_up.evaluate("c => c.toDataURL()")
    page.locator("#persons input").first.check()
    assert close_up.evaluate("c => c.toDataURL()") != second


def test_a_background_goes_with_the_frame(page: Any, photo: Photo, tmp_path: Path) -> None:
    paths = [tmp_path / "yard.png", tmp_path / "yard_background.png"]
    paths[0].write_bytes(photo.frame_png)
    paths[1].write_bytes(png(np.full(photo.frame.shape, 200, np.uint8)))
    page.set_input_files("#file", [str(path) for path in paths])
    page.get_by_text("-F 'background=@yard_background.png'").wait_for()
    assert page.locator("#facts").get_by_text("background").count() > 0


def test_a_drop_a_paste_and_a_mistake(page: Any, photo: Photo) -> None:
    send = """([kind, bytes, name]) => {
        const data = new DataTransfer();
        data.items.add(new File([new Uint8Array(bytes)], name, {type: 'image/png'}));
        const event = kind === 'drop' ? new DragEvent('drop', {dataTransfer: data, bubbles: true})
          : new ClipboardEvent('paste', {clipboardData: data, bubbles: true});
        document.getElementById('drop').dispatchEvent(event);
    }"""
    page.evaluate(send, ["drop", list(photo.frame_png), "a.png"])
    page.get_by_text("frame=@a.png").wait_for()
    page.evaluate(send, ["paste", list(photo.frame_png), "b.png"])
    page.get_by_text("frame=@b.png").wait_for()
    with page.expect_response("**/pose?*") as answer:
        page.evaluate(send, ["drop", [1, 2, 3], "broken.png"])
    assert answer.value.status == 400
    page.get_by_text("frame:").wait_for()
