"""Draw the pictures of the documents.

    python -m scripts pictures people    sheets of real people: docs/people.png, real-people.png
    python -m scripts pictures page      screenshots of the debug page, on a desktop and on a phone

People are chosen evenly, never by how well they came out. The screenshots need the extra
``browser`` and Debian's Chromium; they show a frame of the PETS 2009 scene ``vtest.avi`` that
OpenCV ships (Apache-2.0), and the seconds after it as a video, which may be passed on.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api.overlay import draw_skeleton
from app.estimation.poses import NormalisedPerson
from app.estimation.results import ObservedPerson, Scene
from app.photograph import Estimator
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from app.vision.geometry import Box
from app.vision.optics import PinholeCamera
from index import DEFAULT_PATH
from index.skeleton import NATIVE
from scripts.datasets import POSE2SIM_CAMERAS, read_frames, read_pose2sim, read_vtest, rotate_box
from scripts.helpers import find_people, place_entry
from scripts.load.server import ServerProcess
from scripts.results import ROOT, SHARED

CELL_PX = 320
"""Height at which a person's pictures are drawn."""

VTEST_PEOPLE, VIDEO_PEOPLE, LYING_PEOPLE = 12, 8, 4
MIN_SHOWN_PX = 100
"""Minimum height of a person on the small sheet."""

SCREENS = {"desktop": (1280, 900), "phone": (390, 844)}
PAGE_FRAME, PAGE_FRAMES, TIMEOUT_MS = 540, 80, 120_000

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Drawn:
    """One person's photograph, silhouette, nearest entry and skeleton, side by side."""

    cells: tuple[Picture, ...]
    caption: str
    confidence: float
    height_px: float


def draw_people(
    estimator: Estimator, frame: Picture, name: str, turns: int, *boxes: Box
) -> list[Drawn]:
    """Draw the people of a frame, or in its boxes, after some quarter turns: then they lie."""
    turned = np.ascontiguousarray(np.rot90(frame, turns))
    name += ", turned" if turns else ""
    places = (rotate_box(box, frame.shape, turns) for box in boxes)
    people = [one for one in find_people(estimator, turned, *places) if one.silhouette]
    return [draw_person(estimator, turned, one, name) for one in people]


def draw_person(estimator: Estimator, frame: Picture, found: ObservedPerson, name: str) -> Drawn:
    """Draw one person."""
    silhouette = found.silhouette
    assert silhouette is not None
    (person,) = estimator.with_hypotheses(
        Scene(frame, (found,), PinholeCamera.of_frame(frame.shape)), 1, Job()
    )
    first, normalised = person.hypotheses[0], NormalisedPerson.of(silhouette, None)
    box = silhouette.box
    height = 1.12 * max(box.height, box.width / 0.62)
    scale = CELL_PX / round(height)
    size = round(0.7 * height) * scale, CELL_PX
    left = round(box.x + box.width / 2 - 0.35 * height)
    top = round(box.y + box.height / 2 - height / 2)

    def cut(picture: Picture, beyond: int) -> Picture:
        matrix = np.array([[scale, 0, -left * scale], [0, scale, -top * scale]])
        flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        where = (round(size[0]), size[1])
        moved = cv2.warpAffine(picture, matrix, where, flags=flags, borderValue=3 * (beyond,))
        return np.asarray(moved, np.uint8)

    def drawn(mask: NDArray[np.bool_]) -> Picture:
        return cut(np.where(mask[..., None], 30, 245).astype(np.uint8).repeat(3, axis=2), 245)

    entry, to_frame = place_entry(estimator.index, normalised, first)
    nearest = cv2.warpAffine(entry.astype(np.float32), to_frame, frame.shape[1::-1]) >= 0.5
    photograph = cut(frame, 127)
    overlay = photograph.copy()
    points = (first.points_2d[list(NATIVE.indices)] - (left, top)) * scale
    draw_skeleton(overlay, points, NATIVE, 3)
    cells = (photograph, drawn(silhouette.mask(frame.shape)), drawn(nearest), overlay)
    return Drawn(cells, name, first.confidence, box.height)


def evenly(people: Sequence[Drawn], count: int) -> list[Drawn]:
    """Choose ``count`` of them, at equal steps."""
    steps = np.linspace(0, len(people) - 1, min(count, len(people))).round().astype(int)
    return [people[step] for step in steps.tolist()]


def street_people(estimator: Estimator, real: Path, turns: int = 0) -> list[Drawn]:
    """Draw all people found in evenly chosen frames of the street video."""
    frames = read_vtest(real / "vtest")
    drawn = (draw_people(estimator, frame, f"vtest {number}", turns) for number, frame in frames)
    return [one for people in drawn for one in people]


def video_people(estimator: Estimator, real: Path, step: int = 10, turns: int = 0) -> list[Drawn]:
    """Draw the balancing person of both cameras, in the reference's box."""
    videos = [v for name in POSE2SIM_CAMERAS for v in read_pose2sim(real / "pose2sim", name, step)]
    drawn = (draw_people(estimator, one.frame, one.name, turns, one.box) for one in videos)
    return [one for people in drawn for one in people]


def draw_sheets(shared: Path, docs: Path) -> None:
    """Draw the strip of the README, and the sheet of all chosen people."""
    cv2.setNumThreads(1)
    real, estimator = shared / "real", load_estimator(Settings())
    street, video = street_people(estimator, real), video_people(estimator, real)
    tall = [person for person in street if person.height_px >= MIN_SHOWN_PX]
    lying = (street_people(estimator, real, 1), video_people(estimator, real, 25, 3))
    sheet = evenly(street, VTEST_PEOPLE) + evenly(video, VIDEO_PEOPLE)
    sheet += [person for people in lying for person in evenly(people, LYING_PEOPLE)]
    chosen = evenly(tall, 4) + evenly(video, 4)[1:3]
    strip = [[one.cells[row] for one in chosen] for row in range(4)]
    stages = ("photograph", "silhouette", "nearest\nsimulated", "skeleton")
    confidences = [f"confidence {one.confidence:.2f}" for one in chosen]
    _save_grid(strip, docs / "people.png", (1.6, 2.2), rows=stages, columns=confidences)
    captions = [
        f"{number}. {one.caption}: confidence {one.confidence:.2f}"
        for number, one in enumerate(sheet, start=1)
    ]
    pictures = [np.hstack(one.cells) for one in sheet]
    lines = [pictures[first : first + 4] for first in range(0, len(pictures), 4)]
    _save_grid(lines, docs / "results" / "real-people.png", (4.3, 1.85), titles=captions)


def _save_grid(
    lines: Sequence[Sequence[Picture]], file: Path, size: tuple[float, float], *,
    rows: Sequence[str] = (), columns: Sequence[str] = (), titles: Sequence[str] = (),
) -> None:  # fmt: skip
    """Save pictures in rows, each ``size`` inches, with what is written beside or above them."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    width = len(lines[0])
    canvas, axes = plt.subplots(
        len(lines), width, figsize=(size[0] * width, size[1] * len(lines)), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for place in axes.ravel()[sum(map(len, lines)) :]:
        place.set_axis_off()
    for number, picture in enumerate(picture for line in lines for picture in line):
        place = axes.ravel()[number]
        place.imshow(picture[..., ::-1])
        place.set(xticks=[], yticks=[])
        if titles:
            place.set_title(titles[number], fontsize=9)
    for row, name in enumerate(rows):
        axes[row, 0].set_ylabel(name, fontsize=10)
    for column, name in enumerate(columns):
        axes[-1, column].set_xlabel(name, fontsize=9)
    file.parent.mkdir(parents=True, exist_ok=True)
    canvas.savefig(file, dpi=100)
    plt.close(canvas)


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
                    page.screenshot(path=docs / f"page{kind}-{screen}.png", full_page=True)
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
    page.set_input_files("#file", str(file))
    if video:
        page.get_by_text("The end, after").wait_for(timeout=TIMEOUT_MS)
    else:
        page.locator("#hypotheses .card").first.wait_for(timeout=TIMEOUT_MS)
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
