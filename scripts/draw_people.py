"""Draw sheets of real people: photograph, silhouette, nearest simulated one, skeleton.

    python -m scripts.draw_people                     docs/people.png, docs/results/real-people.png
    python -m scripts.draw_people --sheet FILE        24 people of the Penn-Fudan photographs

People are chosen evenly, never by how well they came out. The Penn-Fudan photographs may not be
passed on: their sheet belongs outside the repository.
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

from app.drawing import draw_skeleton
from app.estimates import Person
from app.estimator import Estimator
from app.settings import Settings
from app.vision.people import Box, Silhouette
from descriptor.silhouette import normalise
from index.leans import Leaning
from index.skeleton import NATIVE
from scripts.experiments.real import CAMERAS
from scripts.experiments.real_data import read_pennfudan, read_pose2sim, read_vtest
from scripts.experiments.real_poses import estimate

ROOT = Path(__file__).resolve().parent.parent
CELL_PX = 320
"""Height at which a person's pictures are drawn."""

VTEST_PEOPLE, VIDEO_PEOPLE = 16, 8
VTEST_FRAMES = 20
SHOWN_FROM_PX = 100
"""People of the small sheet are at least this tall, so that a reader sees something."""


@dataclass(frozen=True)
class Pictures:
    """What is shown of one person: BGR cells of equal height, and a line of text."""

    photograph: NDArray[np.uint8]
    silhouette: NDArray[np.uint8]
    nearest: NDArray[np.uint8]
    skeleton: NDArray[np.uint8]
    caption: str
    height_px: float


def pictures(
    estimator: Estimator, frame: NDArray[np.uint8], silhouette: Silhouette | None, name: str
) -> Pictures | None:
    """Draw one person; None without a silhouette."""
    if silhouette is None:
        return None
    person = estimate(estimator, frame, silhouette)
    box = silhouette.box
    window, scale = _window(box), CELL_PX / _window(box).height
    photograph = _cut(frame, window, scale, (127, 127, 127))
    own = np.where(silhouette.mask(frame.shape)[..., None], 30, 245).astype(np.uint8)
    own = _cut(np.repeat(own, 3, axis=2), window, scale, (245, 245, 245))
    overlay = photograph.copy()
    first = person.hypotheses[0]
    points = (
        first.points_2d[list(NATIVE.indices)] + 0.5 - (window.x + 0.5, window.y + 0.5)
    ) * scale
    draw_skeleton(overlay, points - 0.5, NATIVE, 3)
    confidence = first.confidence
    return Pictures(
        photograph,
        own,
        _nearest(estimator, person, window, scale),
        overlay,
        f"{name}\n{first.label.action}, confidence {confidence:.2f}",
        box.height,
    )


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


def _nearest(estimator: Estimator, person: Person, window: Box, scale: float) -> NDArray[np.uint8]:
    """Silhouette of the first hypothesis's entry, leaning as it does, placed on the person's."""
    first, found = person.hypotheses[0].hypothesis, person.found.silhouette
    assert found is not None
    entry = estimator.index.silhouette(first.entry)
    entry = np.ascontiguousarray(entry[:, ::-1]) if first.mirrored else entry
    normalised, placement = normalise(found.crop)
    back = Leaning.of(normalised, first.lean_deg).back
    shift = np.array([found.left - window.x, found.top - window.y])
    corner = placement.to_image(np.zeros(2)) + shift
    factor = scale / placement.scale
    matrix = factor * back + np.array([[0, 0, corner[0] * scale], [0, 0, corner[1] * scale]])
    size = round(window.width * scale), round(window.height * scale)
    covered = cv2.warpAffine(entry.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR)
    return np.where(covered[..., None] >= 0.5, 30, 245).astype(np.uint8).repeat(3, axis=2)


def evenly(people: Sequence[Pictures], count: int) -> list[Pictures]:
    """Choose ``count`` of them, at equal steps."""
    steps = np.linspace(0, len(people) - 1, min(count, len(people))).round().astype(int)
    return [people[step] for step in steps.tolist()]


def vtest_people(estimator: Estimator, folder: Path) -> list[Pictures]:
    """Everybody whom the service finds in evenly chosen frames of the street video."""
    found = []
    for number, frame in read_vtest(folder / "vtest", VTEST_FRAMES):
        boxes = sorted((d.box for d in estimator.detector.detect(frame)), key=lambda box: box.x)
        for silhouette in estimator.segmenter.segment(frame, boxes):
            found.append(pictures(estimator, frame, silhouette, f"vtest {number}"))
    return [one for one in found if one is not None]


def video_people(estimator: Estimator, folder: Path, step: int = 10) -> list[Pictures]:
    """The balancing person of both cameras, in the reference's box."""
    found = []
    for camera in CAMERAS:
        for one in read_pose2sim(folder / "pose2sim", camera, step):
            silhouette = estimator.segmenter.segment(one.frame, [one.box])[0]
            found.append(pictures(estimator, one.frame, silhouette, one.name))
    return [one for one in found if one is not None]


def street_people(estimator: Estimator, folder: Path) -> list[Pictures]:
    """The labelled people of the street photographs, in their true boxes."""
    found = []
    for photograph in read_pennfudan(folder / "pennfudan"):
        silhouettes = estimator.segmenter.segment(photograph.frame, photograph.boxes)
        for label, silhouette in enumerate(silhouettes, start=1):
            name = f"{Path(photograph.name).stem[-5:]}-{label}"
            found.append(pictures(estimator, photograph.frame, silhouette, name))
    return [one for one in found if one is not None]


def draw_strip(people: Sequence[Pictures], file: Path) -> None:
    """A column for each person, a row for each stage."""
    stages = ("photograph", "silhouette", "nearest\nsimulated", "skeleton")
    figure, axes = plt.subplots(
        4, len(people), figsize=(1.55 * len(people) + 0.9, 8.9), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for column, person in enumerate(people):
        cells = (person.photograph, person.silhouette, person.nearest, person.skeleton)
        for row, cell in enumerate(cells):
            _show(axes[row, column], cell)
        axes[3, column].set_xlabel(person.caption.split("\n")[1].replace(", ", "\n"), fontsize=9)
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
        cells = (person.photograph, person.silhouette, person.nearest, person.skeleton)
        place.set_axis_on()
        _show(place, np.hstack(cells))
        place.set_title(f"{number}. " + person.caption.replace("\n", ": "), fontsize=9)
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
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="the Penn-Fudan sheet instead")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    folder = options.shared / "real"
    estimator = Estimator.load(Settings())
    if options.sheet is not None:
        draw_sheet(evenly(street_people(estimator, folder), 24), options.sheet)
        return
    street, video = vtest_people(estimator, folder), video_people(estimator, folder)
    tall = [one for one in street if one.height_px >= SHOWN_FROM_PX]
    (options.docs / "results").mkdir(parents=True, exist_ok=True)
    draw_strip(evenly(tall, 4) + evenly(video, 4)[1:3], options.docs / "people.png")
    sheet = evenly(street, VTEST_PEOPLE) + evenly(video, VIDEO_PEOPLE)
    draw_sheet(sheet, options.docs / "results" / "real-people.png")


if __name__ == "__main__":
    main()
