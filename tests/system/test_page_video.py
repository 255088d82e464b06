"""Videos and the webcam on the debug page: a camera session, played and shown over time."""

import re
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2
import httpx
import numpy as np
import pytest

from index.skeleton import NATIVE
from tests.conftest import WALKERS, Server
from tests.support.programs import run
from tests.support.videos import numbered_frames, write_video
from tests.system.test_page import overflows

Answer = dict[str, Any]
BONES = [{"parent": parent, "child": child} for parent, child in NATIVE.bones]


def skeleton(shift: float) -> Answer:
    joints = range(len(NATIVE.names))
    return {
        "joints_2d": [{"x": 20 + j + shift, "y": 5 + 2 * j} for j in joints],
        "joints_3d": [{"x": j / 20, "y": shift, "z": 0.0} for j in joints],
    }


def person(track_id: int, **changed: object) -> Answer:
    return {
        "track_id": track_id,
        "box": {"x": 10.0, "y": 4.0, "width": 20.0, "height": 40.0},
        "posture": {"label": "walking", "probability": 0.93},
        "action": {"label": "walk", "probability": 0.81},
        "facing": {"front_probability": 0.04, "evidence": "motion"},
        "pose": skeleton(0),
        "hypotheses": [skeleton(8)],
    } | changed


def answer(number: int, timestamp: float) -> Answer:
    """A possible answer to a frame: person 7 falls on the third one."""
    fall = {"event": "fell", "state": "instant", "track_id": 7, "probability": 0.9}
    return {
        "image": {"width": 64, "height": 48},
        "keypoints": {"set": "native", "names": NATIVE.names, "bones": BONES},
        "frame_index": number,
        "timestamp": timestamp,
        "reset": None,
        "persons": [person(7, action=None), person(3)],
        "events": [fall | {"timestamp": timestamp}] if number == 2 else [],
        "timings_ms": {"total": 12.0},
    }


class Cameras:
    """Camera sessions."""

    def __init__(self, page: Any) -> None:
        self.requests: list[Any] = []
        self.forgotten: list[str] = []
        self._frames = 0
        page.route("**/cameras/**", self._handle)

    def _handle(self, route: Any) -> None:
        request = route.request
        if request.method == "DELETE":
            self.forgotten.append(request.url)
            route.fulfill(status=204)
            return
        self.requests.append(request)
        session = "warm" if self._frames else "new"
        content = answer(self._frames, self.timestamps()[-1])
        self._frames += 1
        route.fulfill(json=content, headers={"X-Session": session})

    def timestamps(self) -> list[float]:
        queries = [parse_qs(urlsplit(request.url).query) for request in self.requests]
        return [float(query["timestamp"][0]) for query in queries]


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script of axe-core, which finds what people with disabilities cannot use."""
    folder = tmp_path_factory.mktemp("axe")
    installed = run("npm", "install", "--no-audit", "--no-fund", "axe-core@4", cwd=folder)
    if installed.returncode != 0:
        pytest.skip(f"npm install failed: {installed.stderr.strip()[-200:]}")
    return (folder / "node_modules/axe-core/axe.min.js").read_text()


@pytest.fixture
def clip(tmp_path: Path) -> str:
    """A video of two seconds, which browsers play."""
    write_video(tmp_path / "clip.webm", numbered_frames(20), codec="libvpx")
    return str(tmp_path / "clip.webm")


def play(page: Any, file: str) -> None:
    page.set_input_files("#file", file)
    page.get_by_text("The end, after").wait_for()


def test_a_video_is_played_as_a_separate_session(page: Any, clip: str) -> None:
    cameras = Cameras(page)
    play(page, clip)
    times = cameras.timestamps()
    assert len(times) > 5
    assert times == sorted(set(times))
    assert times[-1] <= 2
    (camera,) = {urlsplit(request.url).path.split("/")[2] for request in cameras.requests}
    assert re.fullmatch("page-[0-9a-f]{12}", camera)
    assert {request.headers["content-type"] for request in cameras.requests} == {"image/jpeg"}
    assert [url.split("/")[-1] for url in cameras.forgotten] == [camera]


def test_people_events_and_postures_are_shown(page: Any, clip: str) -> None:
    Cameras(page)
    play(page, clip)
    assert not overflows(page)
    rows = [re.split(r"\s{2,}|[\t\n]+", row) for row in page.locator("#crowd tr").all_inner_texts()]
    shown = [[cell.replace("\xa0", " ") for cell in row] for row in rows]
    assert shown == [
        ["3", "walking 93 %", "walk 81 %", "away 96 %"],
        ["7", "walking 93 %", "\u2013", "away 96 %"],
    ]
    events = page.locator("#events li")
    assert events.count() == 1
    assert "7 fell" in events.inner_text()
    legend = page.locator("#timeline-legend").inner_text()
    assert "walking" in legend
    assert "fell" in legend
    assert "sitting" not in legend


def test_what_the_browser_cannot_play_the_service_reads(page: Any, tmp_path: Path) -> None:
    walkers(tmp_path, "clip.avi", codec="mjpeg")
    with page.expect_response("**/sequence?*") as sent:
        page.set_input_files("#file", str(tmp_path / "clip.avi"))
    page.get_by_text("The end, after 20 frames").wait_for()
    assert sent.value.status == 200
    assert page.locator("#message").is_hidden()
    assert "the service reads it" in page.locator("#note").inner_text()
    assert "The video ended after 20 frames" in page.locator("#note").inner_text()
    assert page.locator("#crowd tr").count() >= 3
    assert page.locator("#zones-panel").is_hidden()
    assert not overflows(page)


def draw_zone(page: Any, corners: list[tuple[float, float]], name: str) -> None:
    """Click the corners, given as shares of the picture, then the first one again."""
    page.get_by_role("button", name="Draw a zone").click()
    live = page.locator("#live")
    live.scroll_into_view_if_needed()
    left, top, width, height = live.evaluate(
        """async (canvas) => {
            const {fitted} = await import('/static/stage.js');
            const {scale, left, top} = fitted(canvas, canvas);
            return [left, top, scale * canvas.width, scale * canvas.height];
        }"""
    )
    for x, y in [*corners, corners[0]]:
        live.click(position={"x": left + x * width, "y": top + y * height})
    page.locator("#zone-name").fill(name)


def draw_zone_by_keys(page: Any, steps: int, name: str) -> None:
    """Set the corners of a square about the middle of the picture, then the first one again."""
    page.get_by_role("button", name="Draw a zone").press("Enter")
    moves = ["Left Up", "Right Right", "Down Down", "Left Left", "Up Up"]
    for corner in moves:
        for direction in corner.split():
            for _ in range(steps):
                page.keyboard.press(f"Arrow{direction}")
        page.keyboard.press("Enter")
    page.keyboard.type(name)


CORNERS = [(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9)]


def test_a_zone_is_drawn_with_the_mouse_and_set_for_the_camera(
    page: Any, server: Server, tmp_path: Path
) -> None:
    page.set_input_files("#file", walkers(tmp_path))
    page.locator("#crowd tr").first.wait_for()
    with page.expect_request(lambda request: request.method == "PUT") as sent:
        draw_zone(page, CORNERS, "yard")
        page.get_by_role("button", name="Save the zone").click()
    page.locator("#zones li").get_by_text("yard").wait_for()
    (zone,) = sent.value.post_data_json["zones"]
    assert (zone["name"], zone["kind"]) == ("yard", "watch")
    height, width = cv2.imread(str(WALKERS)).shape[:2]
    expected = [[x * width, y * height] for x, y in CORNERS]
    assert np.allclose(zone["polygon"], expected, atol=3)
    (camera,) = httpx.get(f"{server.url}/cameras").json()["cameras"]
    assert camera["zones"] == [zone]
    # People are said to be in it.
    page.locator("#crowd td.zone").get_by_text("yard").first.wait_for()
    assert not overflows(page)
    assert "curl -X PUT" in page.locator("#zones-command").text_content()
    page.get_by_role("button", name="Remove the zone yard").click()
    page.locator("#zones li").wait_for(state="detached")


def test_a_zone_is_drawn_without_a_mouse(page: Any, tmp_path: Path) -> None:
    page.set_input_files("#file", walkers(tmp_path))
    page.locator("#crowd tr").first.wait_for()
    with page.expect_request(lambda request: request.method == "PUT") as sent:
        draw_zone_by_keys(page, 4, "yard")
        page.keyboard.press("Enter")
    page.locator("#zones li").get_by_text("yard").wait_for()
    (zone,) = sent.value.post_data_json["zones"]
    corners, (height, width) = np.array(zone["polygon"]), cv2.imread(str(WALKERS)).shape[:2]
    assert np.allclose(corners.mean(axis=0), [width / 2, height / 2], atol=1)
    side = np.ptp(corners, axis=0)
    assert len(corners) == 4 and side[0] == pytest.approx(side[1], abs=1) and side[0] > 20


def test_axe_finds_nothing(page: Any, clip: str, axe: str) -> None:
    Cameras(page)
    play(page, clip)
    page.get_by_role("button", name="Draw a zone").click()
    page.locator("#events li").wait_for()
    page.evaluate(axe)
    violations = page.evaluate("axe.run()")["violations"]
    assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in violations] == []


def test_the_webcam_is_a_session_until_it_is_stopped(page: Any) -> None:
    cameras = Cameras(page)
    page.get_by_role("button", name="Use the webcam").click()
    page.locator("#events li").wait_for()
    page.get_by_role("button", name="Stop the webcam").click()
    page.get_by_role("button", name="Use the webcam").wait_for()
    assert len(cameras.forgotten) == 1
    times = cameras.timestamps()
    assert times == sorted(set(times))


def walkers(tmp_path: Path, name: str = "walkers.webm", codec: str = "libvpx") -> str:
    frame = cv2.imread(str(WALKERS))
    write_video(tmp_path / name, [frame] * 20, codec=codec)
    return str(tmp_path / name)
