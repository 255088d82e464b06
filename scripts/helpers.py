"""What experiments, training, pictures and other commands share."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.camera import CameraSession
from app.estimation.poses import NormalisedPerson
from app.estimation.results import Person
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.results import TrackedFrame
from app.vision.geometry import Box
from index.candidates import RotatedQuery
from index.matching import DEFAULT_HYPOTHESES, PoseHypothesis
from index.store import PoseIndex


def estimate(
    estimator: Estimator, photograph: bytes | NDArray[np.uint8], *boxes: Box
) -> tuple[Person, ...]:
    """Estimate the people of a photograph, encoded or as BGR pixels, or those in some boxes."""
    upload = Upload(photograph, boxes=boxes or None)
    return estimator.estimate(upload, DEFAULT_HYPOTHESES, Job()).persons


def track(
    session: CameraSession, frame: NDArray[np.uint8], timestamp: float, n: int = DEFAULT_HYPOTHESES
) -> TrackedFrame:
    """Send a frame to a camera session as a caller does, encoded."""
    return session.process(Upload(encoded(frame)), timestamp, n, Job(), drawn=False)


def encoded(frame: NDArray[np.uint8]) -> bytes:
    """Encode a frame as JPEG of quality 95."""
    return bytes(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())


def place_entry(
    index: PoseIndex, person: NormalisedPerson, hypothesis: PoseHypothesis
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the silhouette of a hypothesis's entry and the transform that puts it on the person.

    The silhouette ``(128, 48)`` is mirrored where its hypothesis is; the affine transform
    ``(2, 3)`` leads from its pixels to pixels of the frame, rotated as the hypothesis is.
    """
    silhouette = index.silhouette(hypothesis.entry_id)
    if hypothesis.mirrored:
        silhouette = np.ascontiguousarray(silhouette[:, ::-1])
    query = RotatedQuery.of(person.silhouette, hypothesis.rotation_deg + person.roll_deg)
    to_frame = person.to_frame @ np.vstack([query.to_query, [0, 0, 1]])
    return silhouette, np.asarray(to_frame, np.float64)


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise a ``ValueError`` if an output would overwrite an input."""
    read = {file.resolve() for file in inputs if file is not None}
    for file in outputs:
        if file is not None and file.resolve() in read:
            raise ValueError(f"expected another place to write to than the input {file}")
