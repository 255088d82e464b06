"""Draw the pictures of the documents.

    python -m scripts pictures people    sheets of real people: docs/people.png, real-people.png
    python -m scripts pictures page      screenshots of the debug page, on a desktop and on a phone

People are chosen evenly, never by how well they came out. The screenshots need the extra
``browser`` and Debian's Chromium; they show a frame of the PETS 2009 scene ``vtest.avi`` that
OpenCV ships (Apache-2.0), and the seconds after it as a video, which may be passed on.
"""

import argparse
import io
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from app.photograph import Estimator, load_estimator
from app.settings import Settings
from app.vision.geometry import Box
from index import DEFAULT_PATH
from scripts.datasets import POSE2SIM_CAMERAS, read_frames, read_pose2sim, read_vtest
from scripts.debug_frame import Cell, Picture, draw_poses, draw_steps, titled
from scripts.helpers import estimate
from scripts.load.server import ServerProcess
from scripts.results import ROOT, SHARED

VTEST_PEOPLE, VIDEO_PEOPLE = 12, 8
MIN_SHOWN_PX = 100
"""Minimum height of a person on the small sheet."""

SCREENS = {"desktop": (1280, 900), "phone": (390, 844)}
PAGE_FRAME, PAGE_FRAMES, TIMEOUT_MS = 540, 80, 120_000

Drawn = tuple[float, list[Cell]]
"""A person's height in pixels; photograph, silhouette, nearest entry and skeleton."""


def draw_people(estimator: Estimator, frame: Picture, name: str, *boxes: Box) -> list[Drawn]:
    """Draw the people of a frame, or in its boxes."""
    drawn: list[Drawn] = []
    for person in estimate(estimator, frame, *boxes):
        if person.silhouette is not None and person.hypotheses:
            (_, window), _, (_, silhouette), _ = draw_steps(frame, person)
            (_, entry), (confidence, skeleton) = draw_poses(frame, estimator.index, person)[:2]
            cells = [(name, window), ("", silhouette), ("", entry), (confidence, skeleton)]
            drawn.append((person.box.height, cells))
    return drawn


def evenly(people: Sequence[Drawn], count: int) -> list[Picture]:
    """Choose ``count`` people at equal steps, each as a row of pictures."""
    steps = np.linspace(0, len(people) - 1, min(count, len(people))).round().astype(int)
    return [titled(people[step][1]) for step in steps.tolist()]


def draw_sheets(shared: Path, docs: Path) -> None:
    """Draw the strip of the README, and the sheet of all chosen people."""
    real, estimator = shared / "real", load_estimator(Settings())
    street = [
        one
        for number, frame in read_vtest(real / "vtest")
        for one in draw_people(estimator, frame, f"vtest {number}")
    ]
    video = [
        one
        for camera in POSE2SIM_CAMERAS
        for found in read_pose2sim(real / "pose2sim", camera, 10)
        for one in draw_people(estimator, found.frame, found.name, found.box)
    ]
    tall = [one for one in street if one[0] >= MIN_SHOWN_PX]
    _save(evenly(tall, 4) + evenly(video, 4)[1:3], 2, docs / "people.png")
    sheet = evenly(street, VTEST_PEOPLE) + evenly(video, VIDEO_PEOPLE)
    _save(sheet, 4, docs / "results" / "real-people.png")


def _save(rows: Sequence[Picture], columns: int, file: Path) -> None:
    """Save rows of pictures in columns, at half their size."""
    lines = [np.hstack(rows[first : first + columns]) for first in range(0, len(rows), columns)]
    small = cv2.resize(np.vstack(lines), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def save_page(shared: Path, docs: Path) -> None:
    """Save the debug page with the results of a photograph and of a video."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("pictures: needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder, ServerProcess(DEFAULT_PATH) as server:
        files = _write_film(shared / "real" / "vtest" / "vtest.avi", Path(folder))
        server.wait_until_ready()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
            )
            for screen, (width, height) in SCREENS.items():
                phone = width < 600
                context = browser.new_context(
                    viewport={"width": width, "height": height},
                    is_mobile=phone, has_touch=phone, reduced_motion="reduce",
                )  # fmt: skip
                for kind, file in files.items():
                    page = context.new_page()
                    page.goto(server.url)
                    _show(page, file, kind == "-video")
                    picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))
                    # 256 colours: a quarter of the bytes.
                    picture.convert("RGB").quantize(
                        method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE
                    ).save(docs / f"page{kind}-{screen}.png", optimize=True)
            browser.close()


def _write_film(video: Path, folder: Path) -> dict[str, Path]:
    """Write a frame of a video as JPEG, and the frames after it in a format that browsers play."""
    frames = [frame for _, frame in read_frames(video)][PAGE_FRAME : PAGE_FRAME + PAGE_FRAMES]
    picture, film = folder / f"street-{PAGE_FRAME}.jpg", folder / "street.webm"
    cv2.imwrite(str(picture), frames[0])
    fps = cv2.VideoCapture(str(video)).get(cv2.CAP_PROP_FPS)
    size = (frames[0].shape[1], frames[0].shape[0])
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"VP80"), fps, size)
    for frame in frames:
        writer.write(frame)
    writer.release()
    return {"": picture, "-video": film}


def _show(page: Any, file: Path, video: bool) -> None:
    """Give the page a file, wait for the result and turn the skeleton a little, to show depth."""
    # After the example, which would slow the file down.
    page.locator("#hypotheses .card").first.wait_for(timeout=TIMEOUT_MS)
    page.set_input_files("#file", str(file))
    if video:
        page.get_by_text("The end, after").wait_for(timeout=TIMEOUT_MS)
    else:
        page.get_by_text(f"frame=@{file.name}").wait_for(timeout=TIMEOUT_MS)
        page.wait_for_load_state("networkidle")
    page.locator("#live-solid" if video else "#solid").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.evaluate("document.activeElement.blur()")


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the pictures named on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("people", "page"))
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    options = parser.parse_args(arguments)
    draw = {"people": draw_sheets, "page": save_page}[options.what]
    draw(options.shared, options.docs)
