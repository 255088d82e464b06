"""Rendered people with their true joints, of bodies, clothes and clips that nothing was trained on.

They ship (``rendered_people.npz``), so that what a step adds can be measured without other data.

    python -m scripts render-held-out [--out FILE]

renders them; it needs the extra ``build``, motion capture and garments.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from app.vision.geometry import Box
from app.vision.people import landmark_rows
from scripts.datasets import Reference, VideoFrame, about_hips, padded_box
from scripts.results import SHARED

FILE = Path(__file__).with_name("rendered_people.npz")
PEOPLE, BODIES, SEED = 64, 12, 76
MIN_HEIGHT_PX, MAX_COVERED, JPEG_QUALITY = 80.0, 0.1, 88

_LIMBS = landmark_rows("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def read_rendered_people(file: Path = FILE) -> list[VideoFrame]:
    """Read the frames, with a person in each."""
    with np.load(file) as stored:
        encoded = np.split(stored["jpegs"], stored["ends"][:-1])
        return [
            VideoFrame(
                f"rendered/{number:03d}",
                np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8),
                Reference(joints_2d, joints_3d),
                Box(*box.tolist()),
            )
            for number, (jpeg, joints_2d, joints_3d, box) in enumerate(
                zip(encoded, stored["joints_2d"], stored["joints_3d"], stored["boxes"], strict=True)
            )
        ]


def render(motion: Path, garments: Path) -> Iterator[VideoFrame]:
    """Render people who are seen from head to feet."""
    from scripts.training.render.scene import Studio

    studio = Studio.open(motion, garments, BODIES, SEED, held_out=True)
    generator = np.random.default_rng(SEED)
    while True:
        taken = studio.take(generator)
        limbs_2d = taken.places[_LIMBS]
        box = padded_box(taken.places).clip(taken.image.shape[1], taken.image.shape[0])
        whole = taken.covered < MAX_COVERED and taken.box[2:].max() >= MIN_HEIGHT_PX
        inside = ((limbs_2d > 0) & (limbs_2d < np.array(taken.image.shape[1::-1]) - 1)).all()
        if whole and inside and box is not None:
            reference = Reference(limbs_2d, about_hips(taken.landmarks[_LIMBS]))
            yield VideoFrame("", taken.image, reference, box)


def write_rendered_people(frames: Sequence[VideoFrame], file: Path) -> None:
    """Write frames as JPEG, with boxes and joints."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    jpegs = [cv2.imencode(".jpg", one.frame, quality)[1].ravel() for one in frames]
    boxes = [(one.box.x, one.box.y, one.box.width, one.box.height) for one in frames]
    np.savez_compressed(
        file,
        jpegs=np.concatenate(jpegs),
        ends=np.cumsum([len(one) for one in jpegs]),
        boxes=np.array(boxes),
        joints_2d=np.array([one.reference.joints_2d for one in frames], np.float32),
        joints_3d=np.array([one.reference.joints_3d for one in frames], np.float32),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Render people of held-out bodies and clips.")
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--out", type=Path, default=FILE)
    options = parser.parse_args(arguments)
    rendered = render(options.shared / "mocap", options.shared / "garments")
    frames = [frame for _, frame in zip(tqdm(range(PEOPLE)), rendered, strict=False)]
    write_rendered_people(frames, options.out)
