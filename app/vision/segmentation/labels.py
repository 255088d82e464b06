"""Silhouettes of a caller's own mask."""

from __future__ import annotations

from app.vision.decoding.decode import LabelImage
from app.vision.people import Silhouette, silhouette_from_mask
from app.vision.segmentation.truncation import with_truncation


def silhouettes_from_labels(image: LabelImage) -> list[Silhouette]:
    """Silhouettes of a caller's mask, ordered left to right by the centre of their boxes."""
    place = {"left": image.left, "top": image.top}
    people = [
        silhouette_from_mask(image.part == label, **place, segmenter="mask", truncated=False)
        for label in image.present
    ]
    found = [person for person in people if person is not None]
    flagged = with_truncation(found, [person.box for person in found], image.labels.shape)
    return sorted(
        (person for person in flagged if person is not None),
        key=lambda person: person.box.x + person.box.width / 2,
    )
