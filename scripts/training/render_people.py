"""Render people as photographs and let the landmark network read them: see ``docs/training.md``.

Writes ``rows-NNNN.npz``, 500 photographs each, with the truth about them (see
:mod:`scripts.training.photograph_data`); the pictures themselves are not kept. One photograph in
seven shows nobody. The same bytes come out for the same seed; files that are there are not made
again. ``--sheet FILE`` draws a contact sheet to look at instead.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from app.networks.shipped import file_of
from app.vision.blazepose import LandmarkNetwork, PoseReading
from app.vision.geometry import PersonWindow
from app.vision.judgement import FRAME_POSTURES
from scripts.results import ROOT
from scripts.training.photograph_data import Rows, WindowRows
from scripts.training.render.cut_outs import read_cut_outs
from scripts.training.render.scene import EMPTY, Photograph, Studio

PER_FILE = 500
PEOPLE, HELD_OUT_PEOPLE = 60, 16
"""Bodies in the training and in the held-out part."""

EMPTY_SHARE = 1 / 7
"""Share of the pictures without people, unless another is given."""

BARE_SHARE = 0.5
"""Share of the pictures without people whose window lies anywhere, not about the thing in it."""

HEAD_FIRST = 0.35
"""Share of the people who lie whose head points to the camera: few landmarks are read right then.
"""

UNRECORDED, FALLEN = 0.3, 0.3
"""Shares: of people in poses that no clip shows; of those who lie, of simulated falls."""


def first_window(photograph: Photograph, generator: np.random.Generator) -> PersonWindow:
    """A window like the service's first one: roughly about the body, the trunk upright."""
    box = photograph.box
    middle, longest = box[:2] + box[2:] / 2, max(box[2:])
    if photograph.posture == EMPTY and generator.random() < BARE_SHARE:
        # Anywhere: bare walls, floors and parts of things.
        picture = np.array(photograph.image.shape[1::-1])
        middle = picture * generator.random(2)
        longest = picture.min() * np.exp(generator.uniform(np.log(0.15), np.log(0.8)))
    if photograph.posture == EMPTY or generator.random() < 0.1:
        quarter = generator.choice([0.0, 0.0, 0.0, 90.0, -90.0, generator.uniform(-180, 180)])
        roll, size = float(quarter), 1.3
    else:
        shoulders, hips = (photograph.places[rows].mean(axis=0) for rows in ([11, 12], [23, 24]))
        right, down = shoulders - hips
        scatter = 8 if generator.random() < 0.9 else 30
        roll = float(np.rad2deg(np.arctan2(right, -down)) + generator.normal(0, scatter))
        size = 1.35
        if photograph.covered < 0.25 or generator.random() < 0.5:
            # About the hips, as detectors of whole bodies place it.
            extents = np.ptp(photograph.places, axis=0)
            middle, longest, size = hips, float(extents.max()), 1.43
    x, y = middle + generator.normal(0, 0.03, 2) * longest
    side = size * longest * np.exp(generator.normal(0.0, 0.08))
    return PersonWindow(float(x), float(y), float(max(side, 4.0)), roll)


def row_of(number: int, photograph: Photograph, reading: PoseReading) -> WindowRows:
    """The training data of one reading, as a single row."""
    given, window = reading.network_pass, reading.window
    return WindowRows(
        np.array([number]),
        given.points[None],
        given.world[None],
        np.array([given.presence], np.float32),
        given.last[None].astype(np.float16),
        given.sampled[None].astype(np.float16),
        np.array([[window.x, window.y, window.side, window.roll_deg]]),
        photograph.focal[None],
        photograph.centre[None],
        photograph.frame_px[None],
        np.array([photograph.posture]),
        photograph.landmarks[None].astype(np.float32),
        photograph.places[None].astype(np.float32),
        photograph.shown[None],
        np.array([photograph.elevation_deg]),
    )


def photograph_of(studio: Studio, seed: int, number: int) -> tuple[Photograph, np.random.Generator]:
    """The photograph of a number, which does not depend on those made before it."""
    generator = np.random.default_rng([seed, number])
    empty = bool(generator.random() < studio.empty)
    return studio.take(generator, empty=empty), generator


def contact_sheet(
    pictures: Sequence[tuple[str, NDArray[np.uint8]]], side: int, columns: int
) -> NDArray[np.uint8]:
    """Pictures to look at, each with a word."""
    sheet = np.zeros((-(-len(pictures) // columns) * side, columns * side, 3), np.uint8)
    for number, (name, image) in enumerate(pictures):
        scale = side / max(image.shape[:2])
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        row, column = divmod(number, columns)
        cell = sheet[row * side : (row + 1) * side, column * side : (column + 1) * side]
        cell[: small.shape[0], : small.shape[1]] = small[:side, :side]
        place = (column * side + 3, row * side + 12)
        cv2.putText(sheet, name, place, 0, 0.4, (0, 255, 255), 1)
    return sheet


LOOKS, CHAIN = 4, 3
"""First windows in a picture without people, and how far their next ones are followed: the network
seldom takes a thing for a person, and it is these windows that trust has to reject."""


def read_windows(
    network: LandmarkNetwork, number: int, photograph: Photograph, generator: np.random.Generator
) -> WindowRows:
    """The network's readings in first windows, and in those to which they point."""
    looks, chain = (LOOKS, CHAIN) if photograph.posture == EMPTY else (1, 2)
    rows = []
    for _ in range(looks):
        window = first_window(photograph, generator)
        for _ in range(chain):
            reading = network.read(photograph.image, window)
            rows.append(row_of(number, photograph, reading))
            window = reading.next_window
    return WindowRows.joined(rows)


def rendering_parser(description: str | None, count: int, seed: int) -> argparse.ArgumentParser:
    """The options of commands that render photographs."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--out", type=Path, help="folder to write to")
    parser.add_argument("--count", type=int, default=count, help="photographs")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--held-out", action="store_true", help="held-out clips and garments")
    parser.add_argument("--cut-outs", type=Path, help="folder of pictures of things, cut out")
    parser.add_argument("--empty", type=float, default=EMPTY_SHARE, help="share without people")
    return parser


def open_studio(options: argparse.Namespace) -> Studio:
    """The studio of these options."""
    count = HELD_OUT_PEOPLE if options.held_out else PEOPLE
    studio = studio_of(options.shared, count, options.seed, held_out=options.held_out)
    studio.empty = options.empty
    if options.cut_outs is not None:
        studio.cut_outs = read_cut_outs(options.cut_outs, held_out=options.held_out)
    return studio


def studio_of(shared: Path, count: int, seed: int, *, held_out: bool) -> Studio:
    """A studio with ``count`` people; pictures are made on one core."""
    cv2.setNumThreads(1)
    studio = Studio.open(shared / "mocap", shared / "garments", count, seed, held_out=held_out)
    studio.head_first = HEAD_FIRST
    studio.source.unrecorded, studio.source.fallen = UNRECORDED, FALLEN
    return studio


def write_rows(
    options: argparse.Namespace,
    studio: Studio,
    rows_of: Callable[[int, Photograph, np.random.Generator], Rows],
) -> None:
    """Write the rows of photographs, 500 to a file; files that exist are kept."""
    options.out.mkdir(parents=True, exist_ok=True)
    for first in tqdm(range(0, options.count, PER_FILE), unit="file"):
        file = options.out / f"rows-{first // PER_FILE:04d}.npz"
        if file.exists():
            continue
        rows = [
            rows_of(number, *photograph_of(studio, options.seed, number))
            for number in range(first, min(first + PER_FILE, options.count))
        ]
        type(rows[0]).joined(rows).save(file)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = rendering_parser(__doc__, count=10_000, seed=1)
    parser.add_argument("--sheet", type=Path, help="draw pictures to look at into this file")
    options = parser.parse_args(arguments)
    if options.out is None and options.sheet is None:
        parser.error("expected --out or --sheet")
    studio = open_studio(options)
    if options.sheet is not None:
        shown = [photograph_of(studio, options.seed, number)[0] for number in range(40)]
        named = [(("nobody", *FRAME_POSTURES)[one.posture - EMPTY], one.image) for one in shown]
        cv2.imwrite(str(options.sheet), contact_sheet(named, 240, 8))
        return
    network = LandmarkNetwork(file_of("pose_landmarks"))
    write_rows(options, studio, partial(read_windows, network))
