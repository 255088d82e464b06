"""The summary of a whole video."""

from __future__ import annotations

import numpy as np
import pytest

from app.estimation.posture import EstimatedPosture
from app.film import MAX_GAP_S, VideoSummary
from app.tracking.results import Event, RecognisedAction, TrackedFrame, TrackedPerson
from app.vision.geometry import Box
from app.vision.optics import PinholeCamera
from index.posture import PostureName


def person(
    track_id: int, posture: PostureName | None, action: RecognisedAction | None = None
) -> TrackedPerson:
    return TrackedPerson(
        Box(0, 0, 10, 20), "detector", 0.9, None,
        posture=EstimatedPosture(posture, 0.9) if posture else None,
        track_id=track_id, age_frames=1, pose=None, action=action,
    )  # fmt: skip


def summarised(*frames: tuple[float, list[TrackedPerson]]) -> VideoSummary:
    summary = VideoSummary()
    for index, (timestamp, persons) in enumerate(frames):
        event = Event("entered", index + 1, "instant", timestamp, 1.0)
        summary.add(
            TrackedFrame(
                frame=np.zeros((2, 2, 3), np.uint8),
                camera=PinholeCamera.of_frame((2, 2)),
                warnings=(),
                frame_index=index,
                timestamp=timestamp,
                session="warm",
                reset=None,
                persons=tuple(persons),
                events=(event,),
                timings_ms={},
            )
        )
    return summary


def test_each_person_has_a_track() -> None:
    summary = summarised(
        (1.0, [person(7, "walking")]),
        (1.5, [person(7, "walking"), person(9, "standing")]),
        (2.0, [person(9, "standing")]),
    )
    assert summary.frames == 3
    assert [event.track_id for event in summary.events] == [1, 2, 3]
    found = {
        number: (track.first_timestamp, track.last_timestamp, track.frames)
        for number, track in summary.tracks.items()
    }
    assert found == {7: (1.0, 1.5, 2), 9: (1.5, 2.0, 2)}


def test_a_posture_lasts_until_the_next_frame() -> None:
    summary = summarised(
        (0.0, [person(1, "walking")]),
        (0.5, [person(1, "walking")]),
        (1.0, [person(1, "lying")]),
        (3.0, [person(1, "lying")]),
        (3.5, [person(1, None)]),
        (4.0, [person(1, "standing")]),
    )
    assert summary.tracks[1].postures() == [("lying", 2.5), ("walking", 1.0), ("standing", 0.0)]


def test_no_posture_is_kept_while_unseen_for_long() -> None:
    summary = summarised((0.0, [person(1, "walking")]), (MAX_GAP_S + 0.1, [person(1, "walking")]))
    assert summary.tracks[1].postures() == [("walking", 0.0)]


def test_the_action_with_the_largest_sum_wins() -> None:
    walk, jump = RecognisedAction("walk", 0.4), RecognisedAction("jump", 0.9)
    summary = summarised(
        (0.0, [person(1, None)]),
        (0.1, [person(1, None, walk)]),
        (0.2, [person(1, None, walk)]),
        (0.3, [person(1, None, jump)]),
    )
    action = summary.tracks[1].action()
    assert action is not None
    assert (action.label, action.probability) == ("jump", pytest.approx(0.3))
