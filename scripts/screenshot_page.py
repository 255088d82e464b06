"""Screenshots of the debug page with real results, on a desktop and on a phone.

    python -m scripts.screenshot_page [--shared ../shared] [--frame 540] [--output docs]

Needs the extra ``browser`` and Debian's Chromium. Shown are a frame of the PETS 2009 scene
``vtest.avi`` that OpenCV ships (Apache-2.0), and the seconds after it as a video; the pictures may
be passed on.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
from playwright.sync_api import Browser, Page, sync_playwright

from index import DEFAULT_PATH
from scripts.load.server import ServerProcess

SCREENS = {"desktop": (1280, 900), "phone": (390, 844)}
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
SLOWEST_MS = 120_000
VIDEO_FRAMES = 80


def save(video: Path, number: int, picture: Path, film: Path) -> None:
    """Write a frame of a video as JPEG, and what follows in a format that browsers play."""
    capture = cv2.VideoCapture(str(video))
    capture.set(cv2.CAP_PROP_POS_FRAMES, number)
    frames = [capture.read() for _ in range(VIDEO_FRAMES)]
    if not all(found for found, _ in frames):
        raise SystemExit(f"screenshot_page: {video} has no {VIDEO_FRAMES} frames from {number}")
    cv2.imwrite(str(picture), frames[0][1])
    height, width = frames[0][1].shape[:2]
    codec = cv2.VideoWriter.fourcc(*"VP80")
    writer = cv2.VideoWriter(str(film), codec, capture.get(cv2.CAP_PROP_FPS), (width, height))
    for _, frame in frames:
        writer.write(frame)
    writer.release()


@contextmanager
def open_page(browser: Browser, url: str, screen: tuple[int, int]) -> Iterator[Page]:
    """Open the page as a desktop or a phone shows it."""
    width, height = screen
    phone = width < 600
    context = browser.new_context(
        viewport={"width": width, "height": height},
        is_mobile=phone,
        has_touch=phone,
        reduced_motion="reduce",
    )
    page = context.new_page()
    page.goto(url)
    yield page
    context.close()


def turn_a_little(page: Page, skeleton: str) -> None:
    """Turn a skeleton: seen a little from the side, it shows that it has depth."""
    page.locator(skeleton).focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.evaluate("document.activeElement.blur()")


def show_photograph(page: Page, frame: Path) -> None:
    """Give the page a frame and wait for the result."""
    page.set_input_files("#file", str(frame))
    page.locator("#hypotheses .card").first.wait_for(timeout=SLOWEST_MS)
    page.wait_for_load_state("networkidle")
    turn_a_little(page, "#solid")


def show_video(page: Page, video: Path) -> None:
    """Give the page a video and wait until it has been played."""
    page.set_input_files("#file", str(video))
    page.get_by_text("The end, after").wait_for(timeout=SLOWEST_MS)
    turn_a_little(page, "#live-solid")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Save screenshots of the debug page.")
    parser.add_argument("--shared", type=Path, default=Path("../shared"))
    parser.add_argument("--frame", type=int, default=540)
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--output", type=Path, default=Path("docs"))
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("screenshot_page: needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder, ServerProcess(options.index) as server:
        source = options.shared / "real" / "vtest" / "vtest.avi"
        frame = Path(folder) / f"street-{options.frame}.jpg"
        video = Path(folder) / "street.webm"
        save(source, options.frame, frame, video)
        server.wait_until_ready()
        shows = (("", show_photograph, frame), ("-video", show_video, video))
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            for name, screen in SCREENS.items():
                for kind, show, file in shows:
                    out = options.output / f"page{kind}-{name}.png"
                    with open_page(browser, server.url, screen) as page:
                        show(page, file)
                        page.screenshot(path=out, full_page=True)
                    print(out)
            browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
