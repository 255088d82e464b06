"""Photographs to put simulated people before: freely licensed ones out of Debian's packages.

No photograph of people is among them, and none of ``../shared/real/pennfudan``.

    python -m scripts.refinement.backgrounds FOLDER     fetches and unpacks the packages
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scripts.experiments.real_data import read_vtest

_STARS = "usr/share/stellarium/landscapes"
_SAMPLES = "usr/share/doc/opencv-doc/examples/data"
PACKAGES: dict[str, tuple[str, ...]] = {
    "lomiri-wallpapers-16.04": ("usr/share/backgrounds/*.jpg",),
    "lomiri-wallpapers-20.04": ("usr/share/backgrounds/*.jpg",),
    "mate-backgrounds": ("usr/share/backgrounds/mate/nature/*.jpg",),
    "opencv-doc": tuple(
        f"{_SAMPLES}/{name}"
        for name in (
            "aloeL.jpg", "baboon.jpg", "board.jpg", "box_in_scene.png", "building.jpg",
            "butterfly.jpg", "cards.png", "ela_original.jpg", "fruits.jpg", "graf1.png",
            "home.jpg", "leuvenA.jpg", "licenseplate_motion.jpg", "rubberwhale1.png", "stuff.jpg",
        )
    ),
    "plasma-workspace-wallpapers": tuple(
        f"usr/share/wallpapers/{name}/contents/images/2560x1600.jpg"
        for name in (
            "Autumn", "BytheWater", "ColdRipple", "ColorfulCups", "DarkestHour", "EveningGlow",
            "FallenLeaf", "Grey", "Kite", "OneStandsOut", "Path",
        )
    ),
    "stellarium-data": tuple(
        f"{_STARS}/{name}" for name in ("garching/*gl?.png", "guereins/*[1-8].png",
                                        "hurricane/*[1-8].png", "grossmugl/*_crop*.png")
    ),
}  # fmt: skip
"""Debian package to the pictures wanted of it."""

STREETS = ("building.jpg", "graf1.png", "home.jpg", "leuvenA.jpg", "licenseplate_motion.jpg")
STREET_TIMES = 5
"""Streets are shown so many times as often as other pictures: that is where people are."""

LONGEST_PX = 1600


def fetch(folder: Path) -> None:
    """Download and unpack the packages below a folder, those that are not there yet."""
    for package in PACKAGES:
        place = folder / package
        if place.is_dir():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["apt-get", "download", package], cwd=folder, check=True)
        archive = next(folder.glob(f"{package}_*.deb"))
        subprocess.run(["dpkg", "-x", str(archive), str(place)], check=True)
        archive.unlink()


def read_backgrounds(folder: Path, real: Path | None) -> list[NDArray[np.uint8]]:
    """Read all photographs, none larger than :data:`LONGEST_PX`.

    Parameters
    ----------
    folder : Path
        Where :func:`fetch` put them.
    real : Path or None
        ``../shared/real``: the street of ``vtest`` is taken as well, without its people.

    Returns
    -------
    list of (H, W, 3) uint8 arrays
        BGR.

    Raises
    ------
    FileNotFoundError
        If no photograph is there.
    """
    found = []
    for package, patterns in PACKAGES.items():
        for pattern in patterns:
            for file in sorted((folder / package).glob(pattern)):
                picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
                if picture is not None and picture.ndim == 3:
                    times = STREET_TIMES if file.name in STREETS else 1
                    found += [_bounded(_before_a_sky(picture))] * times
    if not found:
        raise FileNotFoundError(f"expected photographs in {folder}, found none")
    if real is not None:
        frames = np.stack([frame for _, frame in read_vtest(real / "vtest", 25)])
        found += [np.median(frames, axis=0).astype(np.uint8)] * STREET_TIMES
    return found


def _before_a_sky(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """Put a panorama that was cut out at its horizon before a bright, plain sky."""
    if picture.dtype == np.uint16:
        picture = (picture / 257).astype(np.uint8)
    colour = picture[..., :3].astype(np.float32)
    if picture.shape[2] == 4:
        share = picture[..., 3:].astype(np.float32) / 255
        sky = np.linspace(200, 245, len(picture))[:, None, None] * np.array([1.0, 0.96, 0.92])
        colour = colour * share + sky * (1 - share)
    return colour.astype(np.uint8)


def _bounded(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = LONGEST_PX / max(picture.shape[:2])
    if scale >= 1:
        return picture
    return np.asarray(
        cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    fetch(parser.parse_args().folder)


if __name__ == "__main__":
    main()
