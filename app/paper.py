"""The paper's method [1]_ without a network: its figure 1, step by step.

1. :func:`detect_people`: people, by HOG over many scales.
2. :func:`extract_silhouettes`: by the caller's mask, by the background, or by GrabCut.
3. :func:`app.photograph.normalise_person`: silhouettes to 128x48.
4. :meth:`descriptor.descriptor.Descriptor.describe`: Krawtchouk moments (equation 9).
5. :func:`index.nearest.nearest_entries`: the N nearest of all entries (equation 1), exactly.
6. :func:`app.estimation.poses.place_skeletons`: their skeletons, scaled to the silhouette.
7. :func:`index.nearest.reprojection_confidence`: a confidence from the reprojection.

:class:`PaperFinder` takes the first two steps, :func:`index.nearest.match_nearest` the fourth,
fifth and seventh; :class:`app.photograph.Estimator` puts them together.

References
----------
.. [1] D. F. Atrevi, D. Vivet, F. Duculty, B. Emile, "3D Human Poses Estimation from a
   Single 2D Silhouette", VISAPP 2016.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from app.estimation.finder import Found, Models, PeopleFinder, Target
from app.estimation.results import Evidence, Person, Source
from app.estimation.upload import DecodedUpload
from app.scheduling.job import Job
from app.settings import Segmenter
from app.vision.detector import MIN_DETECTION_SCORE
from app.vision.detectors.hog import HogDetector
from app.vision.detectors.tiles import Picture
from app.vision.geometry import Box
from app.vision.halved import Frame, whole
from app.vision.people import Detection, Silhouette
from app.vision.silhouettes import cut_out_by_colour, cut_out_changed, foreground
from index.skeleton import rows
from index.store import PoseIndex


def detect_people(frame: NDArray[np.uint8], min_person_px: float | None = None) -> list[Detection]:
    """Detect the people of a frame ``(H, W, 3)``, BGR, by HOG; best first.

    The smallest person wanted is ``min_person_px`` high; by default, that of :class:`HogDetector`.
    """
    found = HogDetector(min_person_px).detect(Picture(frame, ()))
    return [one for one in found if one.score >= MIN_DETECTION_SCORE]


def extract_silhouettes(
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    *,
    background: NDArray[np.uint8] | None,
    shape: NDArray[np.float64],
    checkpoint: Callable[[], None] = lambda: None,
) -> list[Silhouette | None]:
    """Cut the people in boxes out of a frame: what differs from a background, else by GrabCut.

    GrabCut begins with the likely ``shape`` of a person, see :func:`likely_shape`. None stands for
    boxes in which nobody is found.
    """
    if background is None:
        return cut_out_by_colour(frame, boxes, shape, checkpoint)
    return cut_out_changed(foreground(frame, background), boxes, checkpoint)


_SHAPES = 512  # Entries whose mean is the likely shape of a person.
_HEAD, _PELVIS, *_ANKLES = rows("head", "pelvis", "left_ankle", "right_ankle")


def likely_shape(index: PoseIndex) -> NDArray[np.float64]:
    """Mean of silhouettes of upright people: ``(128, 48)``, symmetric, 0 to 1."""
    some = np.unique(np.linspace(0, len(index) - 1, 16 * _SHAPES).astype(int))
    points = index.points(some)[1]
    # The head is in the uppermost rows above the pelvis, and both ankles are in the lowest.
    upright = (
        (points[:, _HEAD, 1] < 20)
        & (points[:, _ANKLES, 1] > 108).all(axis=1)
        & (np.abs(points[:, _HEAD, 0] - points[:, _PELVIS, 0]) < 8)
    )
    chosen = some[upright] if upright.any() else some
    mean = index.silhouettes(chosen[:_SHAPES]).mean(axis=0)
    return np.asarray((mean + mean[:, ::-1]) / 2)


class NoNetworks(Models):
    """Stands for networks that were not loaded."""

    def __init__(self) -> None:
        pass

    def __getattr__(self, name: str) -> object:
        raise AttributeError(f"no network was loaded, there is no {name}: POSE_METHOD is paper")


@dataclass(frozen=True, kw_only=True)
class PaperFinder(PeopleFinder):
    """Finds the people of a frame, with their silhouettes, as in the paper.

    With the segmenter ``network``, the masks of the landmark network cut out whom HOG detects.
    """

    index: PoseIndex
    models: Models = field(default_factory=NoNetworks)
    segmenter: Segmenter = "grabcut"

    @cached_property
    def _shape(self) -> NDArray[np.float64]:
        return likely_shape(self.index)

    def find(self, upload: DecodedUpload, evidence: Evidence, job: Job) -> list[Person]:
        """Find the people of a frame with their silhouettes; the evidence is always these."""
        return super().find(upload, "silhouette", job)

    def search(
        self,
        frame: Frame,
        job: Job,
        lost: Sequence[Box] = (),
        known: Sequence[Box] = (),
    ) -> tuple[list[Detection], list[Detection]]:
        """Detect the people of a whole frame; nobody is perhaps beside them."""
        with job.stage("detect"):
            people = detect_people(whole(frame), self.min_person_px)
        job.checkpoint()
        return self._most(people, job), []

    def _found(self, upload: DecodedUpload, job: Job) -> Found:
        if upload.mask is not None:
            return super()._found(upload, job)
        source: Source = "detector" if upload.boxes is None else "boxes"
        marked = [Detection(box, 1.0) for box in upload.boxes or ()]
        people = marked if source == "boxes" else self.search(upload.frame, job)[0]
        found = Found([*map(Target, people)], source)
        if self.segmenter == "network" and upload.background is None:
            return found
        cut = partial(
            extract_silhouettes,
            whole(upload.frame),
            background=upload.background,
            shape=self._shape,
            checkpoint=job.checkpoint,
        )
        return replace(found, cut=cut)
