"""How well joints are read: share of the limb joints of real people within a tenth of their height.

    python -m scripts.joints.measure [--odd] [--network FILE]

A joint is taken to be at the peak of its map. Settings may be looked at on even-numbered
photographs; the odd ones, and the balancing person, are for the final figure.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.joints import OTHER_SIDE, WEIGHTS_PATH, JointReader
from app.vision.networks import Networks
from app.vision.people import Silhouette
from app.vision.segment import Segmenter, make_segmenter
from descriptor.silhouette import normalise
from index.skeleton import LIMBS
from scripts.experiments.real_data import (
    Reference,
    read_pennfudan,
    read_pose2sim,
    read_street_people,
)
from scripts.experiments.real_options import read_options
from scripts.experiments.real_poses import NEAR, segmented

CAMERAS = ("cam01", "cam03")


def peaks(
    reader: JointReader, frame: NDArray[np.uint8], silhouette: Silhouette
) -> NDArray[np.float64]:
    """Where the limb joints are likeliest, ``(12, 2)`` in pixels of the frame."""
    placement = normalise(silhouette.crop)[1]
    maps = reader.read(frame, silhouette, placement)
    limbs = maps.maps[: len(LIMBS)]
    row, column = np.unravel_index(limbs.reshape(len(limbs), -1).argmax(axis=1), limbs.shape[1:])
    cells = np.stack([column, row], axis=-1)
    found = placement.to_image((cells - maps.offset) / maps.scale)
    return np.asarray(found + np.array([silhouette.left, silhouette.top]))


def shares(
    found: NDArray[np.float64], reference: Reference, height_px: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which joints ``(12,)`` are near, and which would be if sides did not count."""
    near, crossed = (
        np.linalg.norm(points - reference.joints_2d, axis=1) < NEAR * height_px
        for points in (found, found[OTHER_SIDE[: len(LIMBS)]])
    )
    return near, near | crossed


def people(
    shared: Path, segmenter: Segmenter, *, odd: bool, step: int
) -> Iterator[tuple[str, NDArray[np.uint8], Silhouette, Reference, float]]:
    """Yield group, frame, silhouette, reference and height of real people."""
    photographs = read_pennfudan(shared / "pennfudan")
    silhouette_of = segmented(segmenter)
    for person in read_street_people(shared / "pennfudan", photographs):
        one = person.photograph
        silhouette = silhouette_of(person) if one.odd == odd else None
        if silhouette is not None:
            height = one.boxes[person.label - 1].height
            group = "street, odd" if odd else "street, even"
            yield group, one.frame, silhouette, person.reference, height
    if odd:
        for camera in CAMERAS:
            for frame in read_pose2sim(shared / "pose2sim", camera, step):
                silhouette = segmenter.segment(frame.frame, [frame.box])[0]
                if silhouette is not None:
                    yield camera, frame.frame, silhouette, frame.reference, frame.box.height


def main() -> None:
    """Command line."""
    options = read_options(__doc__, WEIGHTS_PATH)
    cv2.setNumThreads(1)
    segmenter = make_segmenter(Networks.load(options.models))
    reader = JointReader(options.network)
    found: dict[str, list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]] = {}
    everyone = people(options.shared / "real", segmenter, odd=options.odd, step=options.step)
    for group, frame, silhouette, reference, height in everyone:
        places = peaks(reader, frame, silhouette)
        found.setdefault(group, []).append(shares(places, reference, height))
    for group, pairs in found.items():
        near, either = (100 * np.mean([pair[k] for pair in pairs], axis=0) for k in (0, 1))
        print(f"{group}, {len(pairs)} people: {near.mean():.1f} %, sides aside {either.mean():.1f}")
        print("  " + ", ".join(f"{n} {x:.0f}" for n, x in zip(LIMBS, near, strict=True)))


if __name__ == "__main__":
    main()
