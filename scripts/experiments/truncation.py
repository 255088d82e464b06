"""Who is flagged ``truncated``: street photographs cropped so that an edge cuts somebody.

The settings in ``app/vision/segmentation/truncation.py`` were chosen on even-numbered photographs.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from tqdm import tqdm

from app.estimation.estimates import Evidence
from app.estimation.estimator import Estimator
from app.estimation.stopwatch import Stopwatch
from app.estimation.upload import Upload
from app.settings import Settings
from app.vision.people import Box
from index.store import DEFAULT_PATH
from scripts.experiments.real_data import Photograph, encode_png, read_pennfudan, tight_box
from scripts.results import machine

COMMAND = "python -m scripts.evaluate truncation"
EDGES = ("left", "top", "right", "bottom")
WHOLE = ("photograph", "loose crop")
EVIDENCE: tuple[Evidence, ...] = ("photograph", "silhouette")
HIDDEN = (0.1, 0.7)
"""Least and largest share of the person's height or width that an edge cuts off."""

MARGINS = (0.05, 0.5)
"""Room that a loose crop leaves on each side, in shares of the person's height."""

FOUND_FROM = 0.5
"""Overlap (IoU) with what is visible from which a detection is the person."""

_LEAST_HEIGHT_PX = 50  # The service looks for people from here on.
_LEAST_OVERLAP = 0.05
_SEED = 1


@dataclass(frozen=True)
class View:
    """A crop of a photograph, and somebody in it.

    Parameters
    ----------
    photograph : Photograph
    crop : (left, top, right, bottom)
        Whole pixels; first column and row, then one past the last.
    box : Box
        Of what is visible of the person, in the crop.
    kind : str
        The edge that cuts the person, or one of :data:`WHOLE`.
    """

    photograph: Photograph
    crop: tuple[int, int, int, int]
    box: Box
    kind: str


@dataclass(frozen=True)
class Answer:
    """Whether a person was found, and flagged by the silhouette alone or with landmarks."""

    view: View
    found: bool
    by_silhouette: bool
    flagged: bool


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """Add nothing: there is nothing to choose."""


def run(options: argparse.Namespace) -> None:
    """Crop, ask, and write a table."""
    cv2.setNumThreads(1)
    estimator = Estimator.load(Settings(index=DEFAULT_PATH))
    photographs = read_pennfudan(options.shared / "real" / "pennfudan")
    lines = [
        "# People cut by the edge of the picture\n",
        f"`{COMMAND}` on {machine()}.\n",
        "Penn-Fudan photographs, cropped so that one edge cuts off "
        f"{100 * HIDDEN[0]:.0f} to {100 * HIDDEN[1]:.0f} % of the height or width of one labelled "
        "person, once for each edge. Whole people: the same in the photographs as they are, and in "
        f"crops that leave {100 * MARGINS[0]:.0f} to {100 * MARGINS[1]:.0f} % of their height as "
        "room on each side, where the photograph has so much. Left out: who touches the "
        "photograph's border, and whose box another one overlaps. A third of the size: the same "
        "photographs made smaller, as surveillance shows people. Of the people found, the share "
        "flagged `truncated`; the settings were chosen on even-numbered photographs.\n",
        "| people | boxes from | evidence | photographs | cut: found | flagged "
        f"| {' | '.join(EDGES)} | whole: found | flagged | {' | '.join(WHOLE)} |",
        "|---" * (8 + len(EDGES) + len(WHOLE)) + "|",
    ]
    for size, name in ((1, "as they are"), (1 / 3, "a third of the size")):
        cases = list(views([scaled(one, size) for one in photographs]))
        heights = [view.box.height for view in cases if view.kind == WHOLE[0]]
        title = f"{name}, {min(heights):.0f} to {max(heights):.0f} px tall"
        for boxes, given in (("detector", False), ("caller", True)):
            answers = [ask(estimator, view, given=given) for view in tqdm(cases, desc=title)]
            lines += rows(answers, f"{title} | {boxes}")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "truncation.md").write_text("\n".join(lines) + "\n")


def scaled(photograph: Photograph, factor: float) -> Photograph:
    """The same photograph and labels at another size."""
    height, width = photograph.labels.shape
    size = round(factor * width), round(factor * height)
    frame = cv2.resize(photograph.frame, size, interpolation=cv2.INTER_AREA)
    labels = cv2.resize(photograph.labels, size, interpolation=cv2.INTER_NEAREST)
    return replace(
        photograph, frame=np.asarray(frame, np.uint8), labels=np.asarray(labels, np.uint16)
    )


def views(photographs: Sequence[Photograph]) -> Iterator[View]:
    """Views of all people who are whole and by themselves."""
    rng = np.random.default_rng(_SEED)
    for photograph in photographs:
        height, width = photograph.labels.shape
        whole = (0, 0, width, height)
        for box in whole_people(photograph):
            yield View(photograph, whole, box, WHOLE[0])
            room = np.ceil(rng.uniform(*MARGINS, 4) * box.height).astype(int) * (-1, -1, 1, 1)
            left, top, right, bottom = (np.array(box.pixels()) + room).tolist()
            loose = max(0, left), max(0, top), min(width, right), min(height, bottom)
            yield View(photograph, loose, visible(box, loose), WHOLE[1])
            for edge, hidden in zip(EDGES, rng.uniform(*HIDDEN, 4).tolist(), strict=True):
                crop = cut_at(box, whole, edge, hidden)
                yield View(photograph, crop, visible(box, crop), edge)


def whole_people(photograph: Photograph) -> list[Box]:
    """Boxes of people who are not too small, touch no border and whom no other box overlaps."""
    height, width = photograph.labels.shape
    labels = np.unique(photograph.labels)[1:]
    boxes = [tight_box(photograph.labels == label) for label in labels]
    inner = Box(0.5, 0.5, width - 2, height - 2)
    return [
        box
        for box in boxes
        if box.height >= _LEAST_HEIGHT_PX
        and inner.intersection(box) == box.area
        and all(box.intersection(o) < _LEAST_OVERLAP * box.area for o in boxes if o is not box)
    ]


def cut_at(
    box: Box, whole: tuple[int, int, int, int], edge: str, hidden: float
) -> tuple[int, int, int, int]:
    """The part of a photograph whose named edge cuts off a share of a box."""
    crop, place = list(whole), EDGES.index(edge)
    near, far = box.pixels()[place], box.pixels()[(place + 2) % 4]
    crop[place] = near + round(hidden * (far - near))
    return crop[0], crop[1], crop[2], crop[3]


def visible(box: Box, crop: tuple[int, int, int, int]) -> Box:
    """The part of a box inside a crop, in the crop's pixels."""
    left, top, right, bottom = crop
    inside = Box(box.x - left, box.y - top, box.width, box.height).clip(right - left, bottom - top)
    assert inside is not None
    return inside


def ask(estimator: Estimator, view: View, *, given: bool) -> Answer:
    """Look for the person of a view, in their box where it is given."""
    left, top, right, bottom = view.crop
    frame = encode_png(np.ascontiguousarray(view.photograph.frame[top:bottom, left:right]))
    upload = Upload(frame, boxes=[view.box] if given else None)
    flags = []
    for evidence in EVIDENCE:
        people = estimator.find_people(upload, lambda: None, Stopwatch(), evidence).people
        overlap, flag = max(
            (
                (view.box.iou(one.box), one.silhouette.truncated)
                for one in people
                if one.silhouette is not None
            ),
            default=(0.0, False),
        )
        flags.append(flag)
    by_landmarks, by_silhouette = flags
    # The same people are found with either evidence.
    return Answer(view, overlap >= FOUND_FROM, by_silhouette, by_landmarks)


def rows(answers: Sequence[Answer], title: str) -> list[str]:
    """Rows of the table for one size and source of boxes."""
    found = []
    for evidence in EVIDENCE:
        for half in ("all", "odd"):
            part = [one for one in answers if half == "all" or one.view.photograph.odd]
            cells = [title, evidence, half]
            for kinds in (EDGES, WHOLE):
                cells.append(_found([one for one in part if one.view.kind in kinds]))
                for chosen in (kinds, *((kind,) for kind in kinds)):
                    cells.append(_share([one for one in part if one.view.kind in chosen], evidence))
            found.append("| " + " | ".join(cells) + " |")
    return found


def _found(answers: Sequence[Answer]) -> str:
    return f"{sum(one.found for one in answers)} of {len(answers)}"


def _share(answers: Sequence[Answer], evidence: str) -> str:
    flags = [
        one.flagged if evidence == "photograph" else one.by_silhouette
        for one in answers
        if one.found
    ]
    return f"{100 * np.mean(flags):.1f} %"
