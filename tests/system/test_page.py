"""The debug page in a real browser: headless Chromium, driven by Playwright."""

import json
import re
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.api.replies import compressed, run_lengths
from app.vision.people import silhouette_from_mask
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


def test_the_tallest_person_is_selected_first(page: Any, tmp_path: Path) -> None:
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


def test_finding_nobody_is_no_error(page: Any, tmp_path: Path) -> None:
    (tmp_path / "wall.png").write_bytes(png(np.full((240, 320, 3), 200, np.uint8)))
    page.set_input_files("#file", str(tmp_path / "wall.png"))
    page.get_by_text("Nobody was found").wait_for()
    assert page.locator("#message").is_hidden()
    assert page.locator("[role=alert]:visible").count() == 0


def test_a_second_photograph_is_mentioned(
    page: Any, photo: Photo, pictures: list[str], tmp_path: Path
) -> None:
    (tmp_path / "yard.png").write_bytes(photo.frame_png)
    (tmp_path / "street_background.png").write_bytes(photo.frame_png)
    page.set_input_files("#file", [pictures[0], str(tmp_path / "yard.png")])
    page.get_by_text("street.png is shown, yard.png left out").wait_for()
    page.set_input_files("#file", [str(tmp_path / "street_background.png"), *pictures])
    page.get_by_text("street.png is shown, street_background.png left out").wait_for()


def test_99_hypotheses_become_50(page: Any, pictures: list[str]) -> None:
    page.get_by_text("Settings").click()
    page.locator("#count").fill("99")
    with page.expect_response("**/pose?*") as answer:
        page.set_input_files("#file", pictures)
    assert "n=50&" in answer.value.url
    page.get_by_text("50 instead of 99").wait_for()
    assert page.locator("#count").input_value() == "50"


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


def test_silhouettes_are_drawn_as_in_the_answer(page: Any) -> None:
    mask = np.zeros((240, 320), bool)
    mask[20:220, 100:180], mask[60:80, 120:140], mask[:, 300:] = True, False, True
    silhouette = silhouette_from_mask(mask, segmenter="mask", truncated=False)
    assert silhouette is not None
    counts = compressed(run_lengths(silhouette, mask.shape))
    alpha = page.evaluate(
        """async (counts) => {
            const {tint} = await import('/static/silhouettes.js');
            const rle = {counts, size: [240, 320]};
            const canvas = tint({image: {width: 320, height: 240}, persons: [{silhouette: {rle}}]});
            const pixels = canvas.getContext('2d').getImageData(0, 0, 320, 240).data;
            return Array.from({length: 320 * 240}, (_, i) => pixels[4 * i + 3]);
        }""",
        counts,
    )
    assert np.array_equal(np.reshape(alpha, (240, 320)) > 0, mask)


def test_observed_keypoints_are_shown_if_they_were_used(page: Any) -> None:
    page.set_input_files("#file", str(WALKERS))
    page.locator("#hypotheses .card").first.wait_for()
    assert re.search(r"\d+ of 17 seen", page.locator("#facts").inner_text())
    stage = page.locator("#stage")
    shown = stage.evaluate("c => c.toDataURL()")
    page.locator("#show-observed").set_checked(False)
    assert stage.evaluate("c => c.toDataURL()") != shown
    page.get_by_text("Settings").click()
    with page.expect_response("**/pose?*") as answer:
        page.locator("#evidence").select_option("silhouette")
    assert "evidence=silhouette" in answer.value.url
    page.get_by_text("not read").wait_for()
    assert "&evidence=silhouette'" in page.locator("#curl").inner_text()


def test_the_picture_comes_first_and_a_phone_page_is_short(page: Any) -> None:
    page.set_input_files("#file", str(WALKERS))
    page.locator("#hypotheses .card").nth(6).wait_for()
    stage = page.locator("#stage").bounding_box()
    assert stage["y"] + stage["height"] < page.viewport_size["height"]
    assert page.locator("#count").is_hidden()
    assert page.evaluate("document.documentElement.scrollHeight") < 2100
    assert not overflows(page)


def test_labels_stay_apart_and_inside_the_picture(page: Any) -> None:
    places = page.evaluate(
        """async () => {
            const {freePlace} = await import('/static/stage.js');
            const drawn = [];
            for (let n = 0; n < 40; n += 1) {
                const wanted = {x: 20 * (n % 8) - 10, y: 15 * (n % 5) - 20, width: 12, height: 10};
                drawn.push(freePlace(wanted, drawn, {width: 200, height: 150}));
            }
            return drawn.map(({x, y}) => [x, y]);
        }"""
    )
    for (x, y), (left, top) in combinations(places, 2):
        assert abs(x - left) >= 12 or abs(y - top) >= 10
    assert all(0 <= x <= 188 and 0 <= y <= 140 for x, y in places)


def test_files_may_be_dropped_or_pasted(page: Any, photo: Photo) -> None:
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
    page.locator("#message").get_by_text("“broken.png”: expected a PNG, JPEG").wait_for()


def test_hypotheses_are_seen_from_the_camera_and_from_the_side(
    page: Any, pictures: list[str]
) -> None:
    page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").nth(6).wait_for()
    page.get_by_role("button", name="As the camera sees it").click()
    views = page.locator("#hypotheses .card canvas[aria-label^=Skeleton]")
    drawn = views.evaluate_all("all => all.map(c => c.toDataURL())")
    assert len(set(drawn)) == 14
    assert "side view" in page.locator("#hypotheses").inner_text()
    assert re.search(
        r"differs by\s+\d+ cm \(.+ \d+ cm( nearer| farther)?\)",
        page.locator("#hypotheses").inner_text(),
    )
    # They turn while they are on the screen.
    views.first.scroll_into_view_if_needed()
    page.locator("#spin").set_checked(True)
    page.wait_for_function(
        "before => document.querySelector('#hypotheses canvas[aria-label^=Skeleton]')"
        ".toDataURL() !== before",
        arg=drawn[0],
    )


def test_the_answer_can_be_downloaded(page: Any, pictures: list[str]) -> None:
    with page.expect_response("**/pose?*") as sent:
        page.set_input_files("#file", pictures)
    page.locator("#hypotheses .card").first.wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the answer").click()
    assert download.value.suggested_filename == "street.pose.json"
    saved = json.loads(Path(download.value.path()).read_text())
    assert saved["persons"][0]["hypotheses"] == sent.value.json()["persons"][0]["hypotheses"]
