"""Camera sessions: begun, kept, and ended by their limits."""

from collections.abc import Callable
from typing import cast

import pytest

from app.cameras import (
    CameraKey,
    CameraSessions,
    CameraTraffic,
    NoSessionsError,
    SessionLimits,
    Wanted,
)
from app.configuration import CameraConfiguration
from app.estimation.upload import Upload, UploadError
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking.results import Event, TrackedFrame
from tests.app.tracking.people import result_of

UPLOAD = Upload(b"frame")


class FakeSession:
    """Counts its frames; holds a thousand bytes a pixel."""

    def __init__(self, while_working: Callable[[], None] = lambda: None) -> None:
        self.frames = 0
        self.memory_bytes = 0
        self.while_working = while_working

    def process(
        self,
        upload: Upload,
        timestamp: float | None,
        n: int,
        job: Job,
        evidence: str,
        *,
        drawn: bool,
    ) -> TrackedFrame:
        job.checkpoint()
        self.while_working()
        if upload.frame == b"broken":
            raise UploadError("frame", "frame: expected an image", "undecodable")
        self.memory_bytes = n * 1000
        self.frames += 1
        at = float(self.frames if timestamp is None else timestamp)
        session = "new" if self.frames == 1 else "warm"
        entered = Event("entered", "instant", at, 1.0, 1)
        return result_of(self.frames - 1, at, width=n, session=session, events=(entered,))


class Registry(CameraSessions):
    """A registry of fakes, with a clock that is set by hand."""

    def __init__(
        self, max_sessions: int = 3, max_memory_bytes: int = 1_000_000, *configured: str
    ) -> None:
        self.now = 0.0
        self.began = 0
        self.ended: list[str] = []
        self.estimator = cast(Estimator, object())
        self.while_working: Callable[[], None] = lambda: None
        super().__init__(
            lambda _: FakeSession(lambda: self.while_working()),  # type: ignore[arg-type,return-value]
            SessionLimits(max_sessions, 60, max_memory_bytes),
            dict.fromkeys(configured, CameraConfiguration()),
            self._note,
            lambda: self.now,
        )

    def _note(self, reason: str | None) -> None:
        if reason is None:
            self.began += 1
        else:
            self.ended.append(reason)

    def send(self, camera: str, caller: int = 0, upload: Upload = UPLOAD, n: int = 1) -> str:
        """Process a frame a second after the last one; return the session's state."""
        self.now += 1
        key = CameraKey(caller, camera)
        return self.process(key, self.estimator, upload, None, Job(), Wanted(n)).session

    def cameras(self, caller: int = 0) -> list[str]:
        return [summary.camera_id for summary in self.summaries(caller)]


def test_a_summary_describes_the_last_frame() -> None:
    registry = Registry()
    registry.send("yard")
    registry.send("yard", n=7)
    registry.now += 5
    summary = registry.summary(CameraKey(0, "yard")).session
    assert summary is not None
    assert (summary.frames, summary.timestamp) == (2, 2.0)
    assert summary.image == (7, 2)
    assert (summary.age_s, summary.idle_s) == (6.0, 5.0)


def test_the_least_recently_used_goes_first() -> None:
    registry = Registry(max_sessions=2)
    for camera in ("yard", "gate", "yard", "roof"):
        registry.send(camera)
    assert registry.cameras() == ["roof", "yard"]
    assert registry.ended == ["number"]
    assert registry.send("gate") == "new"


def test_memory_is_bounded_but_the_newest_stays() -> None:
    registry = Registry(max_memory_bytes=10_000)
    registry.send("yard", n=4)
    registry.send("gate", n=4)
    registry.send("roof", n=4)
    assert registry.cameras() == ["gate", "roof"]
    registry.send("roof", n=6)  # Just within the limit.
    assert registry.cameras() == ["gate", "roof"]
    registry.send("yard", n=9)  # Two must make room.
    assert registry.cameras() == ["yard"]
    for camera in ("yard", "gate"):  # Of a camera that was there, and of a new one.
        registry.send(camera, n=50)
        assert registry.cameras() == [camera]
    assert registry.ended == ["memory"] * 4


def test_idle_sessions_end() -> None:
    registry = Registry()
    registry.send("yard")
    registry.now += 30
    registry.send("gate")
    registry.now += 31
    registry.end_idle()
    assert registry.cameras() == ["gate"]
    assert registry.ended == ["idle"]
    registry.now += 60.5
    assert CameraKey(0, "gate") not in registry
    assert registry.send("gate") == "new"


def test_traffic_is_known_as_long_as_a_session() -> None:
    registry = Registry()
    yard = CameraKey(0, "yard")
    registry.count_dropped(yard, "undecodable")
    registry.send("yard")
    registry.count_dropped(yard, "late_frame")
    registry.now += 5
    assert registry.traffic() == [CameraTraffic(yard, 5.0, {"late_frame": 1})]
    registry.now += 60
    assert registry.traffic() == []


def test_the_caller_with_the_most_sessions_makes_room() -> None:
    registry = Registry(max_sessions=3)
    registry.send("yard", caller=1)
    for number in range(5):
        registry.send(f"camera-{number}", caller=0)
    assert registry.send("yard", caller=1) == "warm"
    assert registry.cameras(0) == ["camera-3", "camera-4"]


def test_a_busy_session_stays() -> None:
    registry = Registry(max_sessions=1)
    registry.send("yard")

    def meanwhile() -> None:
        registry.while_working = lambda: None
        registry.now += 100
        registry.end_idle()
        registry.send("gate")

    registry.while_working = meanwhile
    assert registry.send("yard") == "warm"
    assert registry.cameras() == ["yard"]
    assert registry.ended == ["number"]


def test_an_unusable_frame_displaces_no_session() -> None:
    registry = Registry(max_sessions=1)
    registry.send("yard")
    with pytest.raises(UploadError):
        registry.send("gate", upload=Upload(b"broken"))
    assert registry.cameras() == ["yard"]
    assert registry.began == 1


def test_a_forgotten_camera_starts_afresh_even_if_busy() -> None:
    registry = Registry()
    registry.send("yard")
    registry.while_working = lambda: registry.forget(CameraKey(0, "yard"))
    assert registry.send("yard") == "warm"
    registry.while_working = lambda: None
    assert registry.cameras() == []
    assert registry.send("yard") == "new"
    assert registry.ended == ["forgotten"]


def test_events_of_a_frame_do_not_outlive_its_forgotten_camera() -> None:
    registry = Registry(3, 1_000_000, "yard")
    yard = CameraKey(0, "yard")
    registry.send("yard")
    registry.while_working = lambda: registry.forget(yard)
    registry.send("yard")
    registry.while_working = lambda: None
    assert registry.events(yard) == ()
    registry.send("yard")
    assert len(registry.events(yard)) == 1


def test_cameras_are_known_by_a_session_or_settings_or_the_file() -> None:
    registry = Registry(3, 1_000_000, "hall")
    yard, hall = CameraKey(0, "yard"), CameraKey(0, "hall")
    assert registry.cameras() == ["hall"]
    registry.configure(yard, CameraConfiguration(fov_deg=60.0))
    registry.send("roof")
    assert registry.cameras() == ["hall", "roof", "yard"]
    assert registry.summary(hall).session is None and registry.events(yard) == ()
    registry.now += 100
    assert registry.cameras() == ["hall", "yard"]
    registry.forget(yard)
    registry.forget(hall)  # That of the file stays.
    assert registry.cameras() == ["hall"]
    for unknown in (yard, CameraKey(1, "yard"), CameraKey(0, "roof")):
        with pytest.raises(KeyError):
            registry.summary(unknown)


def test_a_service_without_sessions_configures_no_camera() -> None:
    for settings in (CameraConfiguration(), CameraConfiguration(fov_deg=60.0)):
        with pytest.raises(NoSessionsError, match="keeps no camera sessions"):
            Registry(max_sessions=0).configure(CameraKey(0, "yard"), settings)


def test_another_index_ends_the_sessions_of_the_one_before() -> None:
    registry = Registry()
    registry.send("yard")
    registry.end_others(registry.estimator)
    assert registry.cameras() == ["yard"]
    registry.estimator = cast(Estimator, object())
    registry.end_others(registry.estimator)
    assert registry.cameras() == []
    registry.send("gate")
    registry.estimator = cast(Estimator, object())
    assert registry.send("gate") == "new"
    assert registry.ended == ["index", "index"]
