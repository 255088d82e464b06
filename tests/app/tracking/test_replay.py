"""Replays: what is kept of a person around an event, how much, and how it is drawn."""

import io
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from app.api.pictures import encode_replay
from app.configuration import Zone
from app.estimation.results import Person
from app.tracking.replay import COCO, Moment, Recorder, Replay
from app.tracking.results import Event
from app.vision.people import silhouette_from_mask
from tests.app.tracking.people import person_of, seen_from
from tests.golden.pictures import falling

FRAME = (360, 400, 3)


def fallen(degrees: float) -> Person:
    """The drawn person, tilted about the feet, with the joints of one who stands."""
    silhouette = silhouette_from_mask(falling(degrees) > 0, segmenter="mask")
    assert silhouette is not None
    standing = person_of([seen_from(0)], [0.9])
    return replace(standing, box=silhouette.box, silhouette=silhouette)


def test_a_moment_holds_box_joints_and_outline_to_the_pixel() -> None:
    person = fallen(40)
    moment = Moment.of(person, 1.5)
    assert len(moment.packed) <= 172
    assert abs(moment.box.area / person.box.area - 1) < 0.02
    expected = person.hypotheses[0].points_2d[list(COCO.indices)]
    assert np.nanmax(np.abs(moment.joints - expected)) <= 0.5
    drawn = cv2.fillPoly(np.zeros(FRAME[:2], np.uint8), [moment.outline.astype(np.int32)], 1) > 0
    mask = person.silhouette and person.silhouette.mask(FRAME)
    assert (drawn & mask).sum() / (drawn | mask).sum() > 0.9


def test_a_person_without_silhouette_and_joints_is_a_box() -> None:
    moment = Moment.of(replace(fallen(0), silhouette=None, hypotheses=()), 0.0)
    assert len(moment.outline) == 0
    assert np.isnan(moment.joints).all()


def replayed(fps: float, event_at: int, frames: int, gone_from: int = 10**6) -> Replay:
    """The replay of an event at a frame, after so many frames; the person leaves at one of them."""
    recorder, person, replay = Recorder(), fallen(0), None
    for number in range(frames):
        recorder.add(number / fps, {3: person} if number < gone_from else {})
        if number == event_at:
            replay = recorder.begin(3, number / fps, FRAME)
    assert replay is not None
    assert max(len(one) for one in [*recorder._kept.values(), []]) <= 5.3 * 10 + 1
    return replay


@pytest.mark.parametrize("fps", [2, 10, 30])
def test_a_replay_is_of_three_seconds_before_and_after(fps: int) -> None:
    begun = replayed(fps, 20 * fps, 21 * fps)
    assert not begun.is_complete
    assert begun.moments[-1].timestamp == pytest.approx(21, abs=0.6)
    replay = replayed(fps, 20 * fps, 40 * fps)
    assert replay.is_complete
    times = [one.timestamp for one in replay.moments]
    assert times == sorted(set(times))
    assert [times[0], times[-1]] == pytest.approx([17, 23], abs=0.3)
    assert len(times) <= 32


def test_of_a_lost_person_it_begins_before_the_last_sighting() -> None:
    replay = replayed(10, event_at=100, frames=200, gone_from=80)
    assert [one.timestamp for one in replay.moments[:: len(replay.moments) - 1]] == pytest.approx(
        [4.9, 7.9], abs=0.2
    )


def test_nothing_is_kept_once_the_clock_is_set_back() -> None:
    recorder = Recorder()
    recorder.add(50.0, {3: fallen(0)})
    replay = recorder.begin(3, 50.0, FRAME)
    recorder.add(1.0, {4: fallen(0)})
    assert replay.is_complete
    assert recorder._kept.keys() == {4}


def pictures(event: Event) -> list[NDArray[np.uint8]]:
    zones = [Zone(name="bed", kind="rest", polygon=[[10.0, 10], [90, 10], [90, 90]])]
    content = encode_replay(event, zones)
    assert len(content) <= 60_000
    with Image.open(io.BytesIO(content)) as film:
        return [np.array(one.convert("RGB")) for one in ImageSequence.Iterator(film)]


def test_a_fall_is_drawn_in_less_than_sixty_kilobytes() -> None:
    recorder = Recorder()
    for step in range(16):
        recorder.add(step / 5, {3: fallen(0)})
    event = Event("fell", "instant", 3.0, 0.9, replay=recorder.begin(3, 3.0, FRAME))
    for step in range(16, 32):
        recorder.add(step / 5, {3: fallen(min(90, 18 * (step - 15)))})
    first, *drawn = pictures(event)
    assert event.replay is not None and len(drawn) == len(event.replay.moments)
    assert max(first.shape) <= 340
    lit = [np.argwhere((one[:-20] == 255).all(axis=2)) for one in drawn]
    width_over_height = [np.divide(*np.ptp(one, axis=0)[::-1]) for one in lit]
    assert width_over_height[0] < 0.8 and width_over_height[-1] > 1.4
    # The first picture shows where the person stood, too: its traces are not in the second one.
    assert np.count_nonzero(first != drawn[0]) > 500


def test_a_single_moment_is_a_picture() -> None:
    recorder = Recorder()
    recorder.add(0.0, {3: replace(fallen(0), silhouette=None)})
    event = Event("entered", "instant", 0.0, 0.9, replay=recorder.begin(3, 0.0, FRAME))
    assert 1 <= len(pictures(event)) <= 2
