"""Counters and histograms of the service, for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
)

from app.estimation.results import Person
from app.settings import Settings

# A frame with a mask takes milliseconds, one to be searched for people a tenth of a second.
_MILLISECONDS = (0.25, 0.5, 1, 2.5, 5, 7.5, 10, 15, 25, 50, 75, 100, 150, 250, 350, 500, 750)
_SECONDS = (*(milliseconds / 1000 for milliseconds in _MILLISECONDS), 1, 1.5, 2, 3, 5, 7.5, 10)


def buckets_until(deadline_s: float) -> tuple[float, ...]:
    """Bounds of a histogram of times; the last is the deadline.

    Examples
    --------
    >>> buckets_until(0.002)
    (0.00025, 0.0005, 0.001, 0.002)
    """
    return (*(bound for bound in _SECONDS if bound < deadline_s), deadline_s)


class Metrics:
    """The metrics of an application, in a registry of its own.

    Parameters
    ----------
    deadline_s : float
        Time after which a frame is given up.
    """

    def __init__(self, deadline_s: float = 10.0) -> None:
        self.registry = CollectorRegistry()
        buckets = buckets_until(deadline_s)
        ProcessCollector(registry=self.registry)
        self.requests = Counter(
            "pose_requests",
            "Requests answered, by route and status.",
            ["route", "status"],
            registry=self.registry,
        )
        self.seconds = Histogram(
            "pose_request_seconds",
            "From the first byte of a request to the last of its answer.",
            ["route"],
            buckets=buckets,
            registry=self.registry,
        )
        self.rejected = Counter(
            "pose_rejected",
            "Requests refused, by reason.",
            ["reason"],
            registry=self.registry,
        )
        self._stages = Histogram(
            "pose_stage_seconds",
            "Time of one frame in one stage.",
            ["stage"],
            buckets=buckets,
            registry=self.registry,
        )
        self._persons = Histogram(
            "pose_persons",
            "Persons in one frame.",
            buckets=(0, 1, 2, 3, 5, 8, 13, 21, 34, 50),
            registry=self.registry,
        )
        self._confidence = Histogram(
            "pose_confidence",
            "Confidence of the best hypothesis of one person.",
            buckets=tuple(tenth / 10 for tenth in range(1, 11)),
            registry=self.registry,
        )
        self._in_flight = Gauge(
            "pose_in_flight", "Frames worked on or waiting.", registry=self.registry
        )
        self._capacity_used = Gauge(
            "pose_capacity_used_ratio",
            "Expected wait of the next frame, as a share of that from which frames are refused.",
            registry=self.registry,
        )
        self._build = Gauge(
            "pose_build_info",
            "Always 1; the labels say which build serves, and how it is set.",
            ["version", "revision", "concurrency", "max_wait_s", "request_timeout_s"],
            registry=self.registry,
        )
        self.search_failures = Counter(
            "pose_search_failures",
            "Searches in Milvus that failed, by reason.",
            ["reason"],
            registry=self.registry,
        )
        self._breaker_open = Gauge(
            "pose_search_breaker_open",
            "1 while searches are refused because Milvus does not answer.",
            registry=self.registry,
        )
        self._index = Gauge(
            "pose_index_info",
            "Always 1; the labels say which index is loaded.",
            ["name", "version"],
            registry=self.registry,
        )

        self.sessions_started = Counter(
            "pose_camera_sessions_started", "Camera sessions begun.", registry=self.registry
        )
        self.sessions_ended = Counter(
            "pose_camera_sessions_ended",
            "Camera sessions ended, by reason.",
            ["reason"],
            registry=self.registry,
        )
        self.camera_frames = Counter(
            "pose_camera_frames",
            "Frames of cameras tracked, by whether their session was new.",
            ["session"],
            registry=self.registry,
        )
        self._sessions = Gauge(
            "pose_camera_sessions", "Camera sessions held.", registry=self.registry
        )
        self._sequences = Gauge(
            "pose_sequences", "Videos received or worked on.", registry=self.registry
        )

    def observe_sessions(self, sessions: Callable[[], int], sequences: Callable[[], int]) -> None:
        """Report the camera sessions and the videos at hand whenever metrics are read."""
        self._sessions.set_function(sessions)
        self._sequences.set_function(sequences)

    def observe_load(self, in_flight: Callable[[], int], load: Callable[[], float]) -> None:
        """Report the frames in flight whenever metrics are read.

        Parameters
        ----------
        in_flight : callable
            Frames worked on or waiting.
        load : callable
            Expected wait of the next frame, as a share of that from which frames are refused.
        """
        self._in_flight.set_function(in_flight)
        self._capacity_used.set_function(load)

    def observe_build(self, version: str, settings: Settings) -> None:
        """Report which build serves, and with which settings."""
        self._build.labels(
            version=version,
            revision=settings.revision,
            concurrency=settings.concurrency,
            max_wait_s=f"{settings.max_wait_s:g}",
            request_timeout_s=f"{settings.request_timeout_s:g}",
        ).set(1)

    def observe_index(self, name: str, version: str) -> None:
        """Report which index is loaded, in place of the one before."""
        self._index.clear()
        self._index.labels(name, version).set(1)

    def observe_breaker(self, is_open: Callable[[], bool]) -> None:
        """Report whether searches are refused whenever metrics are read."""
        self._breaker_open.set_function(is_open)

    def observe_stages(self, milliseconds: Mapping[str, float]) -> None:
        """Count the time one frame took in each stage; a stage it skipped is not counted."""
        for stage, duration in milliseconds.items():
            if duration > 0:
                self._stages.labels(stage).observe(duration / 1000)

    def observe_persons(self, persons: Iterable[Person]) -> None:
        """Count the persons of one frame and how sure their best poses are."""
        persons = tuple(persons)
        self._persons.observe(len(persons))
        for person in persons:
            if person.hypotheses:
                self._confidence.observe(person.hypotheses[0].confidence)

    def text(self) -> bytes:
        """Write all metrics in Prometheus' text format."""
        return generate_latest(self.registry)
