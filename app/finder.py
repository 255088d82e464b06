"""Finds the people of a frame: boxes, silhouettes and keypoints, also of people who lie."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.estimates import ObservedPerson, Source
from app.stopwatch import Stopwatch
from app.upload import DecodedUpload
from app.vision.decoding.decode import LabelImage
from app.vision.detection.detector import Detector
from app.vision.keypoints.reader import KeypointReader
from app.vision.people import Box, Silhouette
from app.vision.rotation import (
    find_quarter_turns,
    rotate_box,
    rotate_keypoints,
    rotate_shape,
    rotate_silhouette,
)
from app.vision.segmentation.background import BackgroundSegmenter
from app.vision.segmentation.segment import Segmenter, silhouettes_from_labels
from app.vision.segmentation.truncation import end_beyond_border

Check = Callable[[], None]
"""Called between steps; raises where the work is no longer wanted."""


@dataclass(frozen=True)
class PeopleFinder:
    """Finds people by detection, or where the caller says they are.

    Parameters
    ----------
    detector : Detector
    segmenter : Segmenter
    reader : KeypointReader
    min_person_px : float
        Height of the smallest person wanted, where a background is given.
    max_persons : int
        Detections beyond are dropped, the least sure first.
    """

    detector: Detector
    segmenter: Segmenter
    reader: KeypointReader
    min_person_px: float
    max_persons: int

    def find(
        self, upload: DecodedUpload, reads: bool, check: Check, stopwatch: Stopwatch
    ) -> list[ObservedPerson]:
        """Find the people of a frame with their silhouettes, in no particular order.

        Parameters
        ----------
        upload : DecodedUpload
        reads : bool
            Whether keypoints are read to find the quarter turns of wide boxes.
        check : callable
        stopwatch : Stopwatch
        """
        frame = upload.frame
        background = upload.background is not None and BackgroundSegmenter(
            upload.background, min_person_px=self.min_person_px
        )
        if upload.mask is not None:
            return self._in_mask(upload.mask, frame, reads, stopwatch)
        if upload.boxes is not None:
            segmenter = background or self.segmenter
            return self._in_boxes(upload.boxes, frame, segmenter, reads, stopwatch)
        if background:
            return self._detected(frame, "background", background, background, check, stopwatch)
        return self._detected(frame, "detector", self.detector, self.segmenter, check, stopwatch)

    def detect(self, frame: NDArray[np.uint8]) -> tuple[ObservedPerson, ...]:
        """Find people by their boxes alone, the surest first."""
        return tuple(
            ObservedPerson(
                found.box, "detector", found.score, None, quarter_turns=found.quarter_turns
            )
            for found in self.detector.detect(frame)[: self.max_persons]
        )

    def with_keypoints(self, frame: NDArray[np.uint8], person: ObservedPerson) -> ObservedPerson:
        """Read the keypoints of a person with a silhouette.

        They show truncation by the frame that the silhouette may not show.
        """
        silhouette = person.silhouette
        if silhouette is None:
            return person
        turned = np.rot90(frame, person.quarter_turns)
        box = rotate_box(person.box, frame.shape, person.quarter_turns)
        keypoints = self.reader.read(turned, box)
        if keypoints is None:
            return person
        if person.quarter_turns:
            shape = rotate_shape(frame.shape, person.quarter_turns)
            keypoints = rotate_keypoints(keypoints, shape, -person.quarter_turns)
        if end_beyond_border(person.box, keypoints, frame.shape, person.quarter_turns):
            silhouette = replace(silhouette, truncated=True)
        return replace(person, silhouette=silhouette, keypoints=keypoints)

    def _detected(
        self,
        frame: NDArray[np.uint8],
        source: Source,
        detector: Detector | BackgroundSegmenter,
        segmenter: Segmenter,
        check: Check,
        stopwatch: Stopwatch,
    ) -> list[ObservedPerson]:
        with stopwatch.stage("detect"):
            detections = detector.detect(frame)[: self.max_persons]
        check()
        with stopwatch.stage("segment"):
            silhouettes = segment_turned(
                segmenter,
                frame,
                [detection.box for detection in detections],
                [detection.quarter_turns for detection in detections],
            )
        # A detection without a silhouette was hardly a person.
        return [
            ObservedPerson(
                found.box, source, found.score, silhouette, quarter_turns=found.quarter_turns
            )
            for found, silhouette in zip(detections, silhouettes, strict=True)
            if silhouette is not None
        ]

    def _in_boxes(
        self,
        boxes: Sequence[Box],
        frame: NDArray[np.uint8],
        segmenter: Segmenter,
        reads: bool,
        stopwatch: Stopwatch,
    ) -> list[ObservedPerson]:
        with stopwatch.stage("keypoints"):
            quarter_turns = [self._quarter_turns(frame, box) if reads else 0 for box in boxes]
        with stopwatch.stage("segment"):
            # The difference from a background does not depend on the orientation.
            up = quarter_turns if segmenter is self.segmenter else [0] * len(quarter_turns)
            silhouettes = segment_turned(segmenter, frame, boxes, up)
        return [
            ObservedPerson(box, "boxes", None, silhouette, quarter_turns=turn)
            for box, silhouette, turn in zip(boxes, silhouettes, quarter_turns, strict=True)
        ]

    def _in_mask(
        self, mask: LabelImage, frame: NDArray[np.uint8], reads: bool, stopwatch: Stopwatch
    ) -> list[ObservedPerson]:
        with stopwatch.stage("segment"):
            silhouettes = silhouettes_from_labels(mask)
        with stopwatch.stage("keypoints"):
            quarter_turns = [
                self._quarter_turns(frame, person.box) if reads else 0 for person in silhouettes
            ]
        return [
            ObservedPerson(silhouette.box, "mask", None, silhouette, quarter_turns=turn)
            for silhouette, turn in zip(silhouettes, quarter_turns, strict=True)
        ]

    def _quarter_turns(self, frame: NDArray[np.uint8], box: Box) -> int:
        """Quarter turns that set the person in a caller's box upright, 0 unless the box is wide."""
        if box.width <= box.height:
            return 0
        return find_quarter_turns(self.reader.read(frame, box))


def segment_turned(
    segmenter: Segmenter,
    frame: NDArray[np.uint8],
    boxes: Sequence[Box],
    quarter_turns: Sequence[int],
) -> list[Silhouette | None]:
    """Segment people, each in the frame turned so that they are upright."""
    found: list[Silhouette | None] = [None] * len(boxes)
    for turn in sorted(set(quarter_turns)):
        rows = [i for i, other in enumerate(quarter_turns) if other == turn]
        upright = np.ascontiguousarray(np.rot90(frame, turn))
        silhouettes = segmenter.segment(
            upright, [rotate_box(boxes[i], frame.shape, turn) for i in rows]
        )
        for i, silhouette in zip(rows, silhouettes, strict=True):
            found[i] = silhouette and rotate_silhouette(silhouette, upright.shape, -turn)
    return found
