"""Counters, gauges and histograms of the service, for Prometheus."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Metric,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from app.cameras import CameraTraffic, EndReason
from app.estimation.results import Estimate
from app.settings import Settings
from app.tracking.results import Event

# A frame with a mask takes milliseconds; a search for people takes a tenth of a second.
_STEPS = (1, 1.5, 2.5, 5, 7.5)  # of every power of ten
_SECONDS = tuple(float(f"{step}e{power}") for power in range(-4, 2) for step in _STEPS)
_VIDEO_SECONDS = (1, 2.5, 5, 10, 30, 60, 120, 300, 600, 1200, 1800, 3600)

PROBES = ("/healthz", "/readyz", "/metrics")
"""Routes that are polled every few seconds; their durations are of no interest."""


class CameraCollector(Collector):
    """Metrics of the cameras that have a session when they are scraped, and of no others."""

    def __init__(self, traffic: Callable[[], Iterable[CameraTraffic]]) -> None:
        self._traffic = traffic

    def collect(self) -> Iterator[Metric]:
        labels = ("caller", "camera")
        age = GaugeMetricFamily(
            "pose_camera_frame_age_seconds",
            "Time since the last answered frame of a camera that has a session.",
            labels=labels,
        )
        dropped = CounterMetricFamily(
            "pose_camera_frames_dropped",
            "Frames of a camera that were refused while it had a session, by reason.",
            labels=(*labels, "reason"),
        )
        for camera in self._traffic():
            named = (str(camera.key.caller), camera.key.camera_id)
            age.add_metric(named, camera.idle_s)
            for reason, count in camera.dropped.items():
                dropped.add_metric((*named, reason), count)
        yield age
        yield dropped


class Metrics:
    """The metrics of an application; ``deadline_s`` is the longest duration."""

    def __init__(self, deadline_s: float = 10.0) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        counter = partial(Counter, registry=self.registry)
        gauge = partial(Gauge, registry=self.registry)
        histogram = partial(Histogram, registry=self.registry)
        durations = (*(bound for bound in _SECONDS if bound < deadline_s), deadline_s)
        # fmt: off
        self._requests = counter(
            "pose_requests", "Requests answered, by route and status.", ["route", "status"])
        self._seconds = histogram(
            "pose_request_seconds", "From the first byte of a request to the last of its reply.",
            ["route"], buckets=durations)
        self._sequence_seconds = histogram(
            "pose_sequence_seconds", "The same of a request with a video.", buckets=_VIDEO_SECONDS)
        self._rejected = counter(
            "pose_rejected", "Requests refused, by reason.", ["reason"])
        self._stages = histogram(
            "pose_stage_seconds", "Time of one frame in one stage.", ["stage"], buckets=durations)
        self._persons = histogram(
            "pose_persons", "Persons in one frame.",
            buckets=(0, 1, 2, 3, 5, 8, 13, 21, 34, 50))
        self._confidence = histogram(
            "pose_confidence", "Confidence of the best hypothesis of one person.",
            buckets=[tenth / 10 for tenth in range(1, 11)])
        self.in_flight = gauge(
            "pose_in_flight", "Frames being processed or waiting.")
        self.capacity_used = gauge(
            "pose_capacity_used_ratio",
            "Expected wait of the next frame, divided by the wait at which frames are refused.")
        self._build = gauge(
            "pose_build_info", "Always 1; the labels say which build serves, and how it is set.",
            ["version", "revision", "concurrency", "max_wait_s", "request_timeout_s"])
        self._index = gauge(
            "pose_index_info", "Always 1; the labels say which index is loaded.",
            ["name", "version"])
        self._sessions_started = counter(
            "pose_camera_sessions_started", "Camera sessions begun.")
        self._sessions_ended = counter(
            "pose_camera_sessions_ended", "Camera sessions ended, by reason.", ["reason"])
        self.camera_frames = counter(
            "pose_camera_frames", "Frames of cameras tracked, by whether their session was new.",
            ["session"])
        self.events = counter(
            "pose_events", "Events of cameras, by kind; of those that last, only `begin`.",
            ["event"])
        self.sessions = gauge(
            "pose_camera_sessions", "Camera sessions held.")
        self.sequences = gauge(
            "pose_sequences", "Videos being processed.")
        # fmt: on

    def observe_build(self, version: str, settings: Settings) -> None:
        self._build.labels(
            version=version,
            revision=settings.revision,
            concurrency=settings.concurrency,
            max_wait_s=f"{settings.max_wait_s:g}",
            request_timeout_s=f"{settings.request_timeout_s:g}",
        ).set(1)

    def observe_cameras(self, traffic: Callable[[], Iterable[CameraTraffic]]) -> None:
        self.registry.register(CameraCollector(traffic))

    def observe_request(self, route: str, status: int, seconds: float, rejected: str) -> None:
        """Count a request, its duration, and why it was refused, ``""`` if it was not."""
        self._requests.labels(route, str(status)).inc()
        if route == "/sequence":
            self._sequence_seconds.observe(seconds)
        elif route not in PROBES:
            self._seconds.labels(route).observe(seconds)
        if rejected:
            self._rejected.labels(rejected).inc()

    def observe_index(self, name: str, version: str) -> None:
        self._index.clear()
        self._index.labels(name, version).set(1)

    def observe_stages(self, milliseconds: Mapping[str, float]) -> None:
        """Count the time of one frame in each stage; skipped stages are not counted."""
        for stage, duration in milliseconds.items():
            if duration > 0:
                self._stages.labels(stage).observe(duration / 1000)

    def observe_frame(self, seen: Estimate) -> None:
        """Count the times of one frame, its people and the confidence of their best poses."""
        self.observe_stages(seen.timings_ms)
        self._persons.observe(len(seen.persons))
        for person in seen.persons:
            if person.hypotheses:
                self._confidence.observe(person.hypotheses[0].confidence)

    def observe_session(self, reason: EndReason | None) -> None:
        (self._sessions_ended.labels(reason) if reason else self._sessions_started).inc()

    def observe_events(self, events: Iterable[Event]) -> None:
        """Count the events of one frame; `end` states are not counted."""
        for event in events:
            if event.state != "end":
                self.events.labels(event.event).inc()

    def text(self) -> bytes:
        return generate_latest(self.registry)
