"""Draw sheets of real people: photograph, silhouette, nearest simulated one, skeleton.

    python -m scripts.draw_people                     docs/people.png, docs/results/real-people.png

People are chosen evenly, never by how well they came out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from app.api.overlay import draw_skeleton
from app.estimation.estimator import Estimator
from app.estimation.normalise import NormalisedPerson
from app.estimation.results import ObservedPerson, Person, Scene
from app.scheduling.job import Job
from app.serving.loading import load_estimator
from app.settings import Settings
from app.vision.geometry import Box
from index.skeleton import NATIVE
from scripts.entry_pictures import placed_entry
from scripts.experiments.asking import found_in
from scripts.experiments.real import CAMERAS
from scripts.experiments.real_data import read_pose2sim, read_vtest
from scripts.experiments.rotation import rotate_box
from scripts.results import ROOT

CELL_PX = 320
"""Height at which a person's pictures are drawn."""

VTEST_PEOPLE, VIDEO_PEOPLE, LYING_PEOPLE = 12, 8, 4
VTEST_FRAMES = 20
SHOWN_FROM_PX = 100
"""People of the small sheet are at least this tall, so that a reader sees something."""


@dataclass(frozen=True)
class Pictures:
    """What is shown of one person: photograph, silhouette, nearest entry and skeleton."""

    cells: tuple[NDArray[np.uint8], ...]
    name: str
    confidence: float
    height_px: float


def draw_all(
    estimator: Estimator, frame: NDArray[np.uint8], name: str, turns: int, *boxes: Box
) -> list[Pictures]:
    """Draw the people of a frame, or in its boxes, after some quarter turns: then they lie."""
    turned = np.ascontiguousarray(np.rot90(frame, turns))
    name += ", turned" if turns else ""
    places = (rotate_box(box, frame.shape, turns) for box in boxes)
    people = [one for one in found_in(estimator, turned, *places) if one.silhouette]
    return [_draw(estimator, turned, one, name) for one in people]


def _draw(
    estimator: Estimator, frame: NDArray[np.uint8], found: ObservedPerson, name: str
) -> Pictures:
    silhouette = found.silhouette
    assert silhouette is not None
    (person,) = estimator.with_hypotheses(Scene(frame, (found,)), 1, Job())
    box, first = silhouette.box, person.hypotheses[0]
    window, scale = _window(box), CELL_PX / _window(box).height
    photograph = _cut(frame, window, scale, (127, 127, 127))
    overlay = photograph.copy()
    corner = (window.x + 0.5, window.y + 0.5)
    points = (first.points_2d[list(NATIVE.indices)] + 0.5 - corner) * scale
    draw_skeleton(overlay, points - 0.5, NATIVE, 3)
    own = _drawn(silhouette.mask(frame.shape), window, scale)
    nearest = _drawn(_nearest(estimator, person, frame.shape), window, scale)
    cells = (photograph, own, nearest, overlay)
    return Pictures(cells, name, first.confidence, box.height)


def _window(box: Box) -> Box:
    """Upright window of fixed shape around a person."""
    height = 1.12 * max(box.height, box.width / 0.62)
    width = 0.7 * height
    return Box(
        round(box.x + box.width / 2 - width / 2), round(box.y + box.height / 2 - height / 2),
        round(width), round(height),
    )  # fmt: skip


def _cut(
    image: NDArray[np.uint8], window: Box, scale: float, beyond: tuple[int, int, int]
) -> NDArray[np.uint8]:
    size = round(window.width * scale), round(window.height * scale)
    matrix = np.array([[scale, 0, -window.x * scale], [0, scale, -window.y * scale]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    moved = cv2.warpAffine(image, matrix, size, flags=flags, borderValue=beyond)
    return np.asarray(moved, np.uint8)


def _drawn(mask: NDArray[np.bool_], window: Box, scale: float) -> NDArray[np.uint8]:
    """A mask of the frame, dark on light, cut to a window."""
    picture = np.where(mask[..., None], 30, 245).astype(np.uint8).repeat(3, axis=2)
    return _cut(picture, window, scale, (245, 245, 245))


def _nearest(
    estimator: Estimator, person: Person, frame_shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Silhouette of the first hypothesis's entry, rotated as it is, placed on the person's."""
    hypothesis, silhouette = person.hypotheses[0], person.observed.silhouette
    assert silhouette is not None
    normalised = NormalisedPerson.of(silhouette, None)
    entry, matrix = placed_entry(estimator.index, normalised, hypothesis)
    rows, columns = frame_shape[:2]
    return np.asarray(cv2.warpAffine(entry.astype(np.float32), matrix, (columns, rows)) >= 0.5)


def evenly(people: Sequence[Pictures], count: int) -> list[Pictures]:
    """Choose ``count`` of them, at equal steps."""
    steps = np.linspace(0, len(people) - 1, min(count, len(people))).round().astype(int)
    return [people[step] for step in steps.tolist()]


def vtest_people(estimator: Estimator, folder: Path, turns: int = 0) -> list[Pictures]:
    """All people found in evenly chosen frames of the street video."""
    frames = read_vtest(folder / "vtest", VTEST_FRAMES)
    drawn = (draw_all(estimator, frame, f"vtest {number}", turns) for number, frame in frames)
    return [one for people in drawn for one in people]


def video_people(
    estimator: Estimator, folder: Path, step: int = 10, turns: int = 0
) -> list[Pictures]:
    """The balancing person of both cameras, in the reference's box."""
    videos = [v for camera in CAMERAS for v in read_pose2sim(folder / "pose2sim", camera, step)]
    drawn = (draw_all(estimator, video.frame, video.name, turns, video.box) for video in videos)
    return [one for people in drawn for one in people]


def draw_strip(people: Sequence[Pictures], file: Path) -> None:
    """A column for each person, a row for each stage."""
    stages = ("photograph", "silhouette", "nearest\nsimulated", "skeleton")
    figure, axes = plt.subplots(
        4, len(people), figsize=(1.55 * len(people) + 0.9, 8.9), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for column, person in enumerate(people):
        for row, cell in enumerate(person.cells):
            _show(axes[row, column], cell)
        axes[3, column].set_xlabel(f"confidence {person.confidence:.2f}", fontsize=9)
    for row, stage in enumerate(stages):
        axes[row, 0].set_ylabel(stage, fontsize=10)
    figure.savefig(file, dpi=90)
    plt.close(figure)


def draw_sheet(people: Sequence[Pictures], file: Path, columns: int = 4) -> None:
    """Photograph, silhouette and skeleton of every person, with number and caption."""
    rows = -(-len(people) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.3 * columns, 1.85 * rows), squeeze=False, layout="constrained"
    )
    for place in axes.ravel():
        place.set_axis_off()
    for number, (person, place) in enumerate(zip(people, axes.ravel(), strict=False), start=1):
        place.set_axis_on()
        _show(place, np.hstack(person.cells))
        title = f"{number}. {person.name}: confidence {person.confidence:.2f}"
        place.set_title(title, fontsize=9)
    figure.savefig(file, dpi=100)
    plt.close(figure)


def _show(axes: Axes, picture: NDArray[np.uint8]) -> None:
    axes.imshow(picture[..., ::-1])
    axes.set(xticks=[], yticks=[])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    folder = options.shared / "real"
    estimator = load_estimator(Settings())
    street, video = vtest_people(estimator, folder), video_people(estimator, folder)
    tall = [person for person in street if person.height_px >= SHOWN_FROM_PX]
    (options.docs / "results").mkdir(parents=True, exist_ok=True)
    draw_strip(evenly(tall, 4) + evenly(video, 4)[1:3], options.docs / "people.png")
    lying = (vtest_people(estimator, folder, 1), video_people(estimator, folder, 25, 3))
    sheet = evenly(street, VTEST_PEOPLE) + evenly(video, VIDEO_PEOPLE)
    sheet += [person for people in lying for person in evenly(people, LYING_PEOPLE)]
    draw_sheet(sheet, options.docs / "results" / "real-people.png")


if __name__ == "__main__":
    main()
