"""A blocked view is told from darkness, other light, and people."""

from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.scene import View
from app.vision.geometry import Box
from tests.golden.pictures import EMPTY_YARD, decode

Grey = NDArray[np.uint8]
Change = Callable[[Grey], Grey]
ROWS, COLUMNS = 96, 116


def drawn_room(seed: int) -> Grey:
    """A wall, a floor and twelve pieces of furniture."""
    rng = np.random.default_rng(seed)
    room: Grey = np.full((ROWS, COLUMNS), 170, np.uint8)
    room[66:] = 110
    for left, top, width, height, level in rng.integers(0, [100, 80, 30, 30, 200], (12, 5)):
        room[top : top + height + 6, left : left + width + 6] = 30 + level
    return room


def photographed_yard() -> Grey:
    yard = cv2.cvtColor(decode(EMPTY_YARD), cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(yard, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA), np.uint8)


SCENES = {"yard": photographed_yard(), "room": drawn_room(0), "other room": drawn_room(3)}


def even(level: float) -> Change:
    return lambda scene: np.full_like(scene, level)


def blurred(scene: Grey) -> Grey:
    return np.asarray(cv2.GaussianBlur(scene, (0, 0), 0.07 * ROWS), np.uint8)


def behind_blinds(scene: Grey) -> Grey:
    slats = np.arange(ROWS) % 6 < 5
    return np.where(slats[:, None], np.uint8(190), scene)


def covered_but_for_a_strip(scene: Grey) -> Grey:
    cover = np.clip((np.arange(ROWS)[:, None] - 0.88 * ROWS) / 5, 0, 1)
    return np.asarray(cover * scene + (1 - cover) * 60, np.uint8)


def in_light_from_the_right(scene: Grey) -> Grey:
    return np.asarray(np.clip(scene * np.linspace(0.2, 1.2, COLUMNS), 0, 255), np.uint8)


def in_infrared(scene: Grey) -> Grey:
    """Bright in the middle, dark towards the border."""
    y, x = np.mgrid[-1 : 1 : ROWS * 1j, -1 : 1 : COLUMNS * 1j]  # type: ignore[misc]
    return np.asarray(np.clip(scene * 1.6 * np.exp(-1.5 * (x**2 + y**2)), 0, 255), np.uint8)


def in_light(gain: float, more: float = 0.0) -> Change:
    return lambda scene: np.asarray(np.clip(gain * scene.astype(float) + more, 0, 255), np.uint8)


def watch(
    view: View, pictures: Iterable[tuple[float, Grey]], begin: float = 0.0, fps: float = 2.0
) -> list[tuple[str, float]]:
    """Changes of a view that shows pictures for some seconds each, with a sensor's noise."""
    noises = np.random.default_rng(1).normal(0, 1, (8, ROWS, COLUMNS))
    changes, time = [], begin
    for seconds, picture in pictures:
        rows, columns = picture.shape
        for number in range(round(seconds * fps)):
            noisy = np.clip(picture + noises[number % 8, :rows, :columns], 0, 255)
            if change := view.update(time, noisy.astype(np.uint8)):
                changes.append((change, time))
            time += 1 / fps
    return changes


BLOCKED = {
    "covered": even(90), "covered brightly": even(220), "out of focus": blurred,
    "behind blinds": behind_blinds, "covered in part": covered_but_for_a_strip,
    "turned away": lambda _: drawn_room(9), "upside down": lambda scene: scene[::-1].copy(),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("block", BLOCKED.values(), ids=BLOCKED)
def test_a_blocked_view_is_reported_until_it_is_free(scene: Grey, block: Change) -> None:
    view = View()
    (begun,) = watch(view, [(20, scene), (15, block(scene))])
    assert view.blocked.holds and view.blocked.level >= 0.5
    (ended,) = watch(view, [(15, scene)], begin=35)
    assert not view.blocked.holds
    assert begun[0] == "begin" and 23 <= begun[1] <= 25
    assert ended[0] == "end" and 40 <= ended[1] <= 45


ORDINARY = {
    "dimmed": in_light(0.3), "overexposed": in_light(1.5, 40), "hazy": in_light(0.3, 120),
    "in infrared": in_infrared, "lit from the side": in_light_from_the_right,
    "negative": lambda scene: 255 - scene, "without light": even(3), "dim": in_light(0.06),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("change", ORDINARY.values(), ids=ORDINARY)
def test_other_light_is_no_blocked_view(scene: Grey, change: Change) -> None:
    view = View()
    assert watch(view, [(20, scene), (30, change(scene)), (20, scene)]) == []
    assert not view.blocked.is_unconfirmed


@pytest.mark.parametrize("block", BLOCKED.values(), ids=BLOCKED)
def test_of_an_even_wall_nothing_is_said(block: Change) -> None:
    wall = np.linspace(150, 180, COLUMNS).astype(np.uint8)[None].repeat(ROWS, 0)
    assert watch(View(), [(20, wall), (30, block(wall))]) == []


def test_people_on_a_plain_floor_are_no_view() -> None:
    view = View()
    for frame in range(120):
        floor: Grey = np.full((ROWS, COLUMNS), 200, np.uint8)
        for number in range(12):
            left = (7 * number + (1 + number % 3) * frame) % COLUMNS
            floor[8 * number : 8 * number + 8, left : left + 4] = 40
        assert view.update(frame / 4, floor) is None


def test_who_stands_before_the_camera_does_not_block_it() -> None:
    scene = SCENES["room"]
    near = scene.copy()
    near[4:, 6:110] = 60
    person = Box(6, 4, 104, ROWS - 4)
    for places, states in (([person], []), ([], ["begin"])):
        view, changes = View(), []
        for second in range(40):
            hidden = second >= 20
            changes.append(view.update(second, near if hidden else scene, places * hidden))
        assert [*filter(None, changes)] == states


def test_a_single_frame_decides_nothing() -> None:
    view, room = View(), SCENES["room"]
    watch(view, [(20, room)])
    assert view.update(29, even(90)(room)) is None
    assert view.blocked.is_unconfirmed and view.last_at == 29
    assert view.update(29, even(90)(room)) is None  # It is sent again.
    assert not view.blocked.holds


def test_a_new_place_becomes_the_usual_view_but_a_cover_does_not() -> None:
    for blocked, states in (
        (drawn_room(9), ["begin", "end"]),
        (even(90)(drawn_room(0)), ["begin"]),
    ):
        view = View()
        shown = [(1200.0, SCENES["room"]), (1800.0, blocked)]
        assert [change for change, _ in watch(view, shown, fps=0.25)] == states


def test_another_size_is_another_view() -> None:
    view, room = View(), SCENES["room"]
    watch(view, [(20, room), (10, even(90)(room))])
    assert view.blocked.holds
    smaller = [(30.0, room[::2, ::2].copy())]
    assert [change for change, _ in watch(view, smaller, begin=30)] == ["end"]


def test_times_that_go_back_count_for_nothing() -> None:
    view, room = View(), SCENES["room"]
    watch(view, [(20, room)], begin=1000)
    assert watch(view, [(10, room)]) == []
    assert [change for change, _ in watch(view, [(5, even(90)(room))], begin=10)] == ["begin"]
