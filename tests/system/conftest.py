"""The debug page in headless Chromium."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from tests.conftest import Server

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


# The example that the page begins with would take a second of each test. A route of Playwright's
# would hold up what the page sends while it is left.
WITHOUT_EXAMPLE = """
const sent = fetch;
const never = new Promise(() => {});
fetch = (path, ...rest) => path === 'static/example.jpg' ? never : sent(path, ...rest);
"""


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


@pytest.fixture(params=[1280, 320], ids=["desktop", "phone"])
def page(browser: Any, server: Server, request: pytest.FixtureRequest) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": request.param, "height": 844})
    page = context.new_page()
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("console", lambda m: troubles.append(m.text) if is_trouble(m) else None)
    page.add_init_script(WITHOUT_EXAMPLE)
    page.goto(server.url)
    page.get_by_text("silhouettes,").wait_for()
    yield page
    context.close()
    assert troubles == []


def is_trouble(message: Any) -> bool:
    # The browser logs an error for each answer with an error status.
    return message.type == "error" and "Failed to load resource" not in message.text
