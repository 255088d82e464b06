"""Draw every step of one photograph, to see where an answer comes from.

    python -m scripts debug-frame photo.jpg --out /tmp/steps

Writes ``detections.png`` (boxes with scores, and the windows in which people are read) and, for
each person from left to right, ``person-1.png``: the window as the landmark network saw it, the
landmarks (bright where visible), the silhouette, and normalised; below, for each hypothesis, the
silhouette of its entry and its skeleton on the photograph. Prints what was decided on the way.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.api.pictures import OUTLINE, PEOPLE, draw_skeleton, write_text
from app.estimation.poses import NormalisedPerson
from app.estimation.results import Person
from app.estimation.upload import Upload
from app.photograph import load_estimator
from app.scheduling.job import Job
from app.settings import Settings
from app.vision.blazepose import LANDMARK_PX
from app.vision.geometry import PersonWindow, sample_window
from app.vision.people import Detection
from index.skeleton import NATIVE
from index.store import PoseIndex
from scripts.helpers import check_outputs, place_entry

CELL_PX = 360
"""Height of the pictures of a person."""

Picture = NDArray[np.uint8]
Cell = tuple[str, Picture]
"""A picture with its title."""


def draw_detections(frame: Picture, found: list[Detection]) -> Picture:
    """Draw boxes with their scores, and windows as squares, thicker at the head."""
    picture = frame.copy()
    line = max(1, round(max(frame.shape) / 600))
    for number, one in enumerate(found):
        colour = PEOPLE[number % len(PEOPLE)]
        box = one.box
        corners = np.round([box.x, box.y, box.right, box.bottom]).astype(int)
        cv2.rectangle(picture, corners[:2].tolist(), corners[2:].tolist(), colour, 2 * line)
        write_text(picture, f"{one.score:.2f}", (corners[0], corners[1] - 3), 10 * line, colour)
        for window in one.windows:
            corners = np.round(window.corners()).astype(np.int32)
            cv2.polylines(picture, [corners], True, colour, line)
            cv2.line(picture, corners[0].tolist(), corners[1].tolist(), colour, 3 * line)
    return picture


def draw_person(frame: Picture, index: PoseIndex, person: Person) -> Picture:
    """Draw the steps of one person, and below them the hypotheses."""
    rows = [
        titled(cells) for cells in (draw_steps(frame, person), draw_poses(frame, index, person))
    ]
    widest = max(row.shape[1] for row in rows)
    return np.vstack([np.pad(row, ((0, 0), (0, widest - row.shape[1]), (0, 0))) for row in rows])


def draw_steps(frame: Picture, person: Person) -> list[Cell]:
    """Draw what is read of a person: window, landmarks, silhouette, normalised silhouette."""
    window, to_cell = _window(person)
    photograph = sample_window(frame, window, CELL_PX)
    cells = [("window", sample_window(frame, window, LANDMARK_PX))]
    cells.append(("landmarks", _landmarks(photograph, to_cell, person)))
    if person.silhouette is not None:
        cells.append(("silhouette", _warped(person.silhouette.mask(frame.shape), to_cell)))
        normalised = NormalisedPerson.of(person.silhouette, person.landmarks)
        enlarged = 255 * normalised.silhouette.repeat(3, axis=0).repeat(3, axis=1)
        title = f"128x48, roll {normalised.roll_deg:.0f} deg"
        cells.append((title, np.repeat(enlarged[..., None], 3, axis=2)))
    return cells


def draw_poses(frame: Picture, index: PoseIndex, person: Person) -> list[Cell]:
    """Draw for each hypothesis the silhouette of its entry, and its skeleton on the photograph."""
    silhouette, (window, to_cell) = person.silhouette, _window(person)
    cells: list[Cell] = []
    for rank, hypothesis in enumerate(person.hypotheses, start=1):
        if silhouette is not None:
            normalised = NormalisedPerson.of(silhouette, person.landmarks)
            entry, to_frame = place_entry(index, normalised, hypothesis)
            drawn = _warped(entry, np.asarray(to_cell @ np.vstack([to_frame, [0, 0, 1]])))
            cells.append((f"{rank}: entry {hypothesis.entry_id}", drawn))
        skeleton = sample_window(frame, window, CELL_PX)
        points = hypothesis.points_2d[list(NATIVE.indices)]
        draw_skeleton(skeleton, points @ to_cell[:, :2].T + to_cell[:, 2], NATIVE, 3)
        cells.append((f"confidence {hypothesis.confidence:.2f}", skeleton))
    return cells


def _window(person: Person) -> tuple[PersonWindow, NDArray[np.float64]]:
    """Return the window about a person, and the transform from the frame to a cell of it."""
    window = person.next_window or PersonWindow.about_box(person.whole_box)
    return window, np.asarray(cv2.invertAffineTransform(window.to_frame(CELL_PX)), np.float64)


def describe(number: int, person: Person) -> str:
    """Return what was decided about a person, in lines of text."""
    posture = person.posture
    presence = "-" if person.next_window is None else f"{person.presence:.2f}"
    reported = "-" if posture is None else f"{posture.label} ({posture.probability:.2f})"
    lines = [
        f"person {number}: box {person.box.x:.0f} {person.box.y:.0f} {person.box.width:.0f} "
        f"{person.box.height:.0f}, detection score {person.detection_score or 1:.2f}, "
        f"presence {presence}, posture {reported}",
        "  rank  entry    distance  fused  outline px  moved mm  confidence  clip",
    ]
    for rank, one in enumerate(person.hypotheses, start=1):
        lines.append(
            f"  {rank:4d}  {one.entry_id:6d}  {one.silhouette_distance:8.2f}  {one.distance:5.2f}  "
            f"{one.reprojection_error_px:10.1f}  {1000 * one.adjusted_m:8.0f}  "
            f"{one.confidence:10.2f}  {one.label.clip}, frame {one.label.frame}"
        )
    return "\n".join(lines)


def _landmarks(photograph: Picture, to_cell: NDArray[np.float64], person: Person) -> Picture:
    picture = photograph // 2
    if person.landmarks is None:
        return picture
    places = person.landmarks.positions @ to_cell[:, :2].T + to_cell[:, 2]
    for place, visibility in zip(places, person.landmarks.visibility, strict=True):
        colour = (0, round(255 * visibility), round(255 * (1 - visibility)))
        cv2.circle(picture, np.round(place).astype(int).tolist(), 4, colour, -1)
    return picture


def _warped(mask: NDArray[np.generic], matrix: NDArray[np.float64]) -> Picture:
    drawn = cv2.warpAffine(mask.astype(np.float32), matrix, (CELL_PX, CELL_PX))
    return np.where(drawn[..., None] >= 0.5, OUTLINE, (30, 30, 30)).astype(np.uint8)


def titled(cells: Sequence[Cell]) -> Picture:
    """Put pictures of one height side by side, each with a line of text above."""
    framed = [np.zeros((CELL_PX + 22, 0, 3), np.uint8)]
    for title, picture in cells:
        width = round(CELL_PX * picture.shape[1] / picture.shape[0])
        cell = cv2.resize(picture, (width, CELL_PX), interpolation=cv2.INTER_AREA)
        framed.append(np.pad(np.asarray(cell, np.uint8), ((22, 0), (0, 8), (0, 0))))
        write_text(framed[-1], title, (2, 16), 11, OUTLINE)
    return np.hstack(framed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw as the command line asks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photograph", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder, made if missing")
    parser.add_argument("-n", type=int, default=3, help="hypotheses a person")
    options = parser.parse_args(arguments)
    upload = Upload(options.photograph.read_bytes())
    estimator = load_estimator(Settings())
    estimate = estimator.estimate(upload, options.n, Job())
    options.out.mkdir(parents=True, exist_ok=True)
    people, perhaps_beside = estimator.finder.search(estimate.frame, Job())
    drawn = draw_detections(estimate.frame, [*people, *perhaps_beside])
    pictures = {"detections.png": drawn}
    for number, person in enumerate(estimate.persons, start=1):
        pictures[f"person-{number}.png"] = draw_person(estimate.frame, estimator.index, person)
        print(describe(number, person))
    files = {options.out / name: picture for name, picture in pictures.items()}
    check_outputs(files, (options.photograph,))
    for file, picture in files.items():
        cv2.imwrite(str(file), picture)
    print(", ".join(f"{stage} {spent:.0f} ms" for stage, spent in estimate.timings_ms.items()))
    print(f"Written to {options.out}: {', '.join(pictures)}")
