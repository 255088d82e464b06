"""Screenshots of the debug page with a real result, on a desktop and on a phone.

    python -m scripts.screenshot_page [--shared ../shared] [--frame 540] [--output docs]

Needs the extra ``browser`` and Debian's Chromium. The frame shown is one of the PETS 2009 scene
``vtest.avi`` that OpenCV ships (Apache-2.0); the pictures may be passed on.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import cv2
from playwright.sync_api import Browser, sync_playwright

from index.store import DEFAULT_PATH
from scripts.load.server import ServerProcess

SCREENS = {"desktop": (1280, 900), "phone": (390, 844)}
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
SLOWEST_MS = 120_000


def save_frame(video: Path, number: int, path: Path) -> None:
    """Write one frame of a video as JPEG."""
    capture = cv2.VideoCapture(str(video))
    capture.set(cv2.CAP_PROP_POS_FRAMES, number)
    found, frame = capture.read()
    if not found:
        raise SystemExit(f"screenshot_page: {video} has no frame {number}")
    cv2.imwrite(str(path), frame)


def photograph(browser: Browser, url: str, frame: Path, screen: tuple[int, int], out: Path) -> None:
    """Give the page a frame, wait for the result and save a screenshot."""
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
    page.set_input_files("#file", str(frame))
    page.locator("#hypotheses .card").first.wait_for(timeout=SLOWEST_MS)
    page.wait_for_load_state("networkidle")
    # Seen a little from the side, a skeleton shows that it has depth.
    page.locator("#solid").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.evaluate("document.activeElement.blur()")
    page.screenshot(path=out, full_page=True)
    context.close()


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
        frame = Path(folder) / f"street-{options.frame}.jpg"
        save_frame(options.shared / "real" / "vtest" / "vtest.avi", options.frame, frame)
        server.wait_until_ready()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            for name, screen in SCREENS.items():
                out = options.output / f"page-{name}.png"
                photograph(browser, server.url, frame, screen, out)
                print(out)
            browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
