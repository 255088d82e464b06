"""The debug page in a real browser: headless Chromium, driven by Playwright."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import pytest
from fastapi.testclient import TestClient

from tests.conftest import ROOT, WALKERS, Photo, png

STATIC = ROOT / "app" / "static"


def test_the_page_loads_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    named = re.findall(r'(?:src|href)="(static/[^"]+)"', page.text)
    files = [f"static/{path.name}" for path in STATIC.iterdir()]
    assert len(named) == 3
    assert set(named) < set(files)
    for file in files:
        content = client.get(f"/{file}")
        assert content.status_code == 200
        if content.headers["content-type"] != "image/jpeg":
            assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", content.text), file


@pytest.fixture
def pictures(photo: Photo, tmp_path: Path) -> list[str]:
    paths = {"street.png": photo.frame_png, "street_mask.png": photo.mask_png}
    for name, data in paths.items():
        (tmp_path / name).write_bytes(data)
    return [str(tmp_path / name) for name in paths]


def overflows(page: Any) -> bool:
    return bool(page.evaluate("document.documentElement.scrollWidth > innerWidth"))


def test_a_photograph_shows_its_pose(page: Any, pictures: list[str], photo: Photo) -> None:
    assert not overflows(page)
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").nth(6).wait_for()
    assert not overflows(page)
    assert page.locator("#hypotheses .card").count() == 7
    assert str(photo.entry) in page.locator("#supposed").inner_text()
    assert page.locator("#stage").evaluate("c => [c.width, c.height]") == [320, 240]
    command = page.locator("#curl").inner_text()
    assert "-F 'frame=@street.png' -F 'mask=@street_mask.png'" in command
    assert command.endswith("/pose?n=7&keypoints=native'")


def test_the_keyboard_selects_and_rotates(page: Any, pictures: list[str]) -> None:
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").first.wait_for()
    before = page.locator("#supposed").inner_text()
    page.locator("#hypotheses input").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#hypotheses input").nth(1).is_checked()
    assert page.locator("#supposed").inner_text() != before
    page.locator("#spin").set_checked(False)
    solid = page.locator("#solid")
    solid.focus()
    still = solid.evaluate("c => c.toDataURL()")
    page.keyboard.press("ArrowLeft")
    assert solid.evaluate("c => c.toDataURL()") != still


def test_after_an_error_the_old_answer_is_dimmed(
    page: Any, pictures: list[str], tmp_path: Path
) -> None:
    (tmp_path / "broken.png").write_bytes(b"?")
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").first.wait_for()
    page.set_input_files("#file", str(tmp_path / "broken.png"))
    page.locator("#message").wait_for()
    result = page.locator("#result")
    assert float(result.evaluate("r => getComputedStyle(r).opacity")) <= 0.3
    assert result.evaluate("r => r.inert")
    assert "the answer before this" in page.locator("#note").inner_text()
    page.set_input_files("#file", pictures)
    page.locator("#result:not(.stale):not(.busy)").wait_for()
    assert not result.evaluate("r => r.inert")
    assert page.locator("#message").is_hidden()
    assert page.locator("#note").is_hidden()


def test_a_large_photograph_is_sent_small_and_shown_large(page: Any, tmp_path: Path) -> None:
    walkers = cv2.imread(str(WALKERS))
    height, width = walkers.shape[:2]
    large = tmp_path / "large.png"
    large.write_bytes(png(cv2.resize(walkers, (10 * width, 10 * height))))
    with page.expect_response("**/pose?*") as answer:
        page.set_input_files("#file", str(large))
    page.locator("#hypotheses .card").first.wait_for()
    sent = answer.value.json()
    assert max(sent["image"]["width"], sent["image"]["height"]) == 2560
    assert re.search("sent at 2384 . 2560", page.locator("#timings").inner_text())
    tallest = max((person["box"] for person in sent["persons"]), key=lambda box: box["height"])
    size = page.locator("#facts dt:text('Size') + dd").inner_text()
    shown = [int(number) for number in re.findall(r"\d+", size)[:2]]
    factor = 10 * height / 2560
    assert shown == pytest.approx([tallest["width"] * factor, tallest["height"] * factor], abs=1)


def test_the_answer_can_be_downloaded(page: Any, pictures: list[str]) -> None:
    with page.expect_response("**/pose?*") as sent:
        page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").first.wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the answer").click()
    assert download.value.suggested_filename == "street.pose.json"
    saved = json.loads(Path(download.value.path()).read_text())
    assert saved["persons"][0]["hypotheses"] == sent.value.json()["persons"][0]["hypotheses"]
