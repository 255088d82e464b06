"""What the service counts and times, for Prometheus."""

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

from app.estimates import Person

# A frame with a mask takes milliseconds, one to be searched for people a tenth of a second.
_MILLISECONDS = (0.25, 0.5, 1, 2.5, 5, 7.5, 10, 15, 25, 50, 75, 100, 150, 250, 500, 1000, 5000)
_SECONDS = tuple(milliseconds / 1000 for milliseconds in _MILLISECONDS)


class Metrics:
    """The metrics of one application, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
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
            buckets=_SECONDS,
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
            buckets=_SECONDS,
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
        self._index = Gauge(
            "pose_index_info",
            "Always 1; the labels say which index is loaded.",
            ["name", "version"],
            registry=self.registry,
        )

    def watch_in_flight(self, count: Callable[[], float]) -> None:
        """Ask ``count`` for the frames in flight whenever metrics are read."""
        self._in_flight.set_function(count)

    def observe_index(self, name: str, version: str) -> None:
        """Say which index is loaded."""
        self._index.labels(name, version).set(1)

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
