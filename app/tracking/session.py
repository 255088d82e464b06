"""A camera session. A stand-in, until the branch with background model and tracks is merged."""

from __future__ import annotations

import time

from app.estimates import Evidence
from app.estimator import Estimator
from app.finder import Check
from app.tracking.results import SmoothedPose, TrackedFrame, TrackedPerson
from app.upload import Upload


class LateFrameError(ValueError):
    """A frame is not later than the last one of its camera; the message is one sentence."""


class CameraSession:
    """The frames of one camera: here every person of a frame is a new track.

    Parameters
    ----------
    estimator : Estimator
    """

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator
        self._frames = self._tracks = 0
        self._last: float | None = None
        self._started = time.monotonic()

    @property
    def memory_bytes(self) -> int:
        """What the session holds."""
        return 1000

    def process(
        self,
        upload: Upload,
        timestamp: float | None,
        n: int,
        check: Check,
        evidence: Evidence = "photograph",
    ) -> TrackedFrame:
        """Track the people of the next frame.

        Raises
        ------
        UploadError
            If the images or boxes cannot be used.
        LateFrameError
        """
        now = time.monotonic() - self._started if timestamp is None else timestamp
        if self._last is not None and now <= self._last:
            raise LateFrameError(
                f"timestamp: expected more than {self._last:g} seconds, that of the last frame, "
                f"got {now:g}"
            )
        estimate = self._estimator.estimate(upload, n, check, evidence)
        persons = []
        for person in estimate.persons:
            self._tracks += 1
            best = person.hypotheses[0] if person.hypotheses else None
            pose = best.hypothesis if best else None
            smoothed = (
                SmoothedPose(pose.points_3d, best.points_2d, best.confidence, pose.entry)
                if best and pose
                else None
            )
            persons.append(TrackedPerson(person, self._tracks, 1, smoothed, None))
        self._frames, self._last = self._frames + 1, now
        return TrackedFrame(
            frame=estimate.frame,
            frame_index=self._frames - 1,
            timestamp=now,
            session="new" if self._frames == 1 else "warm",
            reset=None,
            persons=tuple(persons),
            events=(),
            timings_ms=estimate.timings_ms,
        )
