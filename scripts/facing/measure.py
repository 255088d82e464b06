"""How well the photograph alone tells which way real people face.

    python -m scripts.facing.measure [--odd] [--network FILE]

Settings may be looked at on even-numbered photographs; the odd ones, and the balancing person,
are for the final figure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.vision.facing_evidence import WEIGHTS_PATH, AzimuthBelief, FacingReader, head_window
from app.vision.networks import Networks
from app.vision.people import Silhouette
from app.vision.refine import Refiner
from app.vision.segment import NetworkSegmenter, Segmenter
from scripts.experiments.real_data import (
    StreetPerson,
    read_pennfudan,
    read_pose2sim,
    read_street_people,
)
from scripts.experiments.real_options import read_options
from scripts.experiments.real_poses import segmented

CAMERAS = ("cam01", "cam03")

FACE_CELLS = 3
"""Into how many squares each way faces are pixelated."""

# Where the face is, in shares of the silhouette's height: below the crown, and as wide.
_FACE_ROWS, _FACE_WIDTH = (0.035, 0.145), 0.11

Look = Callable[[NDArray[np.uint8], Silhouette], AzimuthBelief | None]


def pixelated(frame: NDArray[np.uint8], one: Silhouette, cells: int) -> NDArray[np.uint8]:
    """Make a face unrecognisable: ``cells`` plain squares each way are left of it."""
    left, _, side, _ = head_window(one)
    rows = len(one.crop)
    middle, half = left + side / 2, _FACE_WIDTH * rows / 2
    y0, y1 = (round(one.top + share * rows) for share in _FACE_ROWS)
    x0, x1 = round(middle - half), round(middle + half)
    changed = frame.copy()
    face = changed[max(0, y0) : max(0, y1), max(0, x0) : max(0, x1)]
    if face.size:
        small = cv2.resize(face, (cells, cells), interpolation=cv2.INTER_AREA)
        face[:] = cv2.resize(small, face.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return changed


def facing_figures(
    beliefs: Sequence[AzimuthBelief | None], azimuth_deg: NDArray[np.float64]
) -> dict[str, float]:
    """Compare beliefs about ``(N,)`` people with where they face.

    Where nothing is believed, any azimuth is as likely as any other.
    """
    known = [one or AzimuthBelief(0.0, 0.0) for one in beliefs]
    azimuth = np.deg2rad(azimuth_deg)
    front = np.cos(azimuth) > 0
    clear = np.abs(np.cos(azimuth)) > 0.5
    found = np.deg2rad([one.azimuth_deg() for one in known])
    error = np.abs(np.rad2deg((found - azimuth + np.pi) % (2 * np.pi) - np.pi))
    probability = np.array([one.front_probability() for one in known])
    density = np.array(
        [float(b.likelihood(deg)) for b, deg in zip(known, azimuth_deg, strict=True)]
    )
    right = (probability > 0.5) == front
    faces = np.array([bool(one.face) for one in known])
    shown, away = np.cos(azimuth) > np.cos(np.deg2rad(30)), np.cos(azimuth) < 0
    return {
        "people": len(front),
        "right": float(right.mean()),
        "right_clear": float(right[clear].mean()),
        "median_error_deg": float(np.median(error)),
        "within_90_deg": float((error < 90).mean()),
        "log_likelihood": float(np.log(density).mean()),
        "brier": float(((probability - front) ** 2).mean()),
        "faces_within_30_deg": int(shown.sum()),
        "faces_found_of_them": int((faces & shown).sum()),
        "backs": int(away.sum()),
        "faces_found_of_backs": int((faces & away).sum()),
    }


def street_figures(
    people: Sequence[StreetPerson], segmenter: Segmenter, look: Look
) -> dict[str, dict[str, float]]:
    """Figures of the street people, as they are and with their faces pixelated."""
    silhouette_of = segmented(segmenter)
    plain, hidden, azimuth = [], [], []
    for person in people:
        silhouette, frame = silhouette_of(person), person.photograph.frame
        if silhouette is not None:
            plain.append(look(frame, silhouette))
            hidden.append(look(pixelated(frame, silhouette, FACE_CELLS), silhouette))
            azimuth.append(person.reference.azimuth_deg)
    return {
        "as they are": facing_figures(plain, np.array(azimuth)),
        "faces pixelated": facing_figures(hidden, np.array(azimuth)),
    }


def camera_figures(
    folder: Path, camera: str, segmenter: Segmenter, look: Look, step: int
) -> dict[str, float]:
    """Figures of the balancing person, whose face is pixelated, in true boxes."""
    found, azimuth = [], []
    for one in read_pose2sim(folder, camera, step):
        silhouette = segmenter.segment(one.frame, [one.box])[0]
        if silhouette is not None:
            found.append(look(one.frame, silhouette))
            azimuth.append(one.reference.azimuth_deg)
    return facing_figures(found, np.array(azimuth))


def main() -> None:
    """Command line."""
    options = read_options(__doc__, WEIGHTS_PATH)
    cv2.setNumThreads(1)
    folder = options.shared / "real"
    segmenter = NetworkSegmenter(Networks.load(options.models), Refiner())
    look = FacingReader(options.network).read
    photographs = read_pennfudan(folder / "pennfudan")
    people = read_street_people(folder / "pennfudan", photographs)
    chosen = [person for person in people if person.photograph.odd == options.odd]
    found = {
        f"street, {name}": one for name, one in street_figures(chosen, segmenter, look).items()
    }
    if options.odd:
        for camera in CAMERAS:
            found[camera] = camera_figures(
                folder / "pose2sim", camera, segmenter, look, options.step
            )
    for name, one in found.items():
        print(f"{name}:", ", ".join(f"{key} {value:.3g}" for key, value in one.items()))


if __name__ == "__main__":
    main()
