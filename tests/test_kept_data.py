"""A camera session keeps in memory what the model card lists, and forgets it as the card says."""

import gc
import re
import weakref
from collections import deque
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from app.camera import CameraSession
from app.cameras import CameraKey, CameraSessions, SessionLimits, Wanted
from app.estimation.upload import Upload
from app.photograph import Estimator
from app.scheduling.job import Job
from app.tracking import actions, falls
from index.store import PoseIndex
from tests.app.drawn import draw, drawn_estimator, send
from tests.conftest import ROOT, WALKERS

_SECTION = (
    (ROOT / "docs" / "model-card.md").read_text().split("### What a camera session keeps\n")[1]
)
LISTED = {
    name
    for row in re.findall(r"^\|(?:[^|]*\|){2}([^|]*)\|", _SECTION.split("\n## ")[0], re.MULTILINE)
    for name in re.findall(r"`([^`]+)`", row)
}
"""Classes, or their attributes, whose arrays the table lists."""

# Of these, an attribute is listed, since they show pixels or colours.
_PICTURES = (
    "Scene.now",
    "Scene._searched",
    "View._usual",
    "View._lasting",
    "Patch.grey",
    "Track.colours",
)
# These hold no data: what is reached through them is code, or the same for all sessions.
_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType, MethodType)
_CONTAINERS = (list, tuple, dict, set, frozenset, deque)


def kept_arrays(session: CameraSession) -> dict[str, list[NDArray[np.generic]]]:
    """All arrays that a session reaches, by the class that holds them, pictures by attribute.

    A view counts as the array that it shows a part of, since it keeps that in memory.
    """
    estimator = session._estimator
    models = (actions.shipped_model(), *falls.shipped_models())
    shared = (estimator, estimator.finder, estimator.models, *models)
    seen = {id(one) for one in shared}
    found: dict[str, list[NDArray[np.generic]]] = {}
    unvisited: list[tuple[str, str, object]] = [("CameraSession", "", session)]
    while unvisited:
        owner, name, value = unvisited.pop()
        if id(value) in seen or isinstance(value, _CODE):
            continue
        seen.add(id(value))
        if isinstance(value, bytes | bytearray | memoryview):
            value = np.frombuffer(value, np.uint8)
        if isinstance(value, np.ndarray):
            while isinstance(value.base, np.ndarray):
                value = value.base
            attribute = f"{owner}.{name}"
            found.setdefault(attribute if attribute in _PICTURES else owner, []).append(value)
        elif isinstance(value, _CONTAINERS):
            unvisited += [(owner, name, part) for part in gc.get_referents(value)]
        else:
            slots = [
                slot for kind in type(value).__mro__ for slot in getattr(kind, "__slots__", ())
            ]
            named = {slot: getattr(value, slot, None) for slot in slots}
            named |= getattr(value, "__dict__", {})
            unvisited += [(type(value).__name__, key, part) for key, part in named.items()]
    return found


@pytest.fixture(scope="module")
def street(estimator: Estimator) -> CameraSession:
    """A session that has read five people in a photograph of a street."""
    session = CameraSession(estimator)
    for step in range(3):
        result = session.process(Upload(WALKERS.read_bytes()), step / 10, 7, Job())
    assert len(result.persons) == 5
    return session


def test_the_model_card_lists_all_that_a_session_keeps(street: CameraSession) -> None:
    assert kept_arrays(street).keys() == LISTED


def test_pictures_are_as_small_as_the_model_card_says(street: CameraSession) -> None:
    kept = kept_arrays(street)
    shapes = {name: [array.shape for array in kept.pop(name)] for name in _PICTURES}
    # No smaller person is wanted than a twelfth of the photograph's 576 rows.
    of_camera = ("Scene.now", "Scene._searched", "View._usual", "View._lasting")
    assert [shapes[name] for name in of_camera] == [[(12 * 8, 89)]] * 4
    assert set(shapes["Patch.grey"]) == {(16, 16)} and len(shapes["Patch.grey"]) <= 2 * 5
    assert shapes["Track.colours"] == [(80,)] * 5
    assert {array.dtype for array in kept.pop("Silhouette")} == {np.dtype(bool)}
    assert all(one.size <= 128 * 48 for one in kept.pop("NormalisedPerson"))
    # A hypothesis is a view of those that were found with it.
    assert all(one.size <= 20 * 24 * 3 for one in kept.pop("PoseHypothesis"))
    # The rest are hypotheses of a frame, at most twelve skeletons, and covariances of 33 depths.
    assert all(
        array.size <= max(12 * 24 * 3, 33**2) for arrays in kept.values() for array in arrays
    )


def test_a_person_who_has_left_is_forgotten(tiny_index: PoseIndex) -> None:
    session = CameraSession(drawn_estimator(tiny_index))
    for step in range(4):
        send(session, step / 10, (0, 100), (1, 200))
    assert 2 <= len(kept_arrays(session)["Patch.grey"]) <= 2 * 2
    for step in range(4, 30):
        send(session, step / 10, (1, 200))
    kept = kept_arrays(session)
    assert len(kept["Patch.grey"]) <= 2 * len(kept["Track.colours"]) == 2


@pytest.mark.parametrize("ends", ["forget", "idle", "number"])
def test_nothing_holds_a_session_that_has_ended(tiny_index: PoseIndex, ends: str) -> None:
    estimator, now, begun = drawn_estimator(tiny_index), [0.0], []

    def begin(estimator: Estimator) -> CameraSession:
        session = CameraSession(estimator)
        begun.append(weakref.ref(session))
        return session

    limits = SessionLimits(1, 300, 10**9)
    sessions = CameraSessions(begin, limits, {}, clock=lambda: now[0])
    yard, hall = CameraKey(0, "yard"), CameraKey(0, "hall")
    sessions.process(yard, estimator, Upload(draw((0, 100))), 0.0, Job(), Wanted(3))
    if ends == "forget":
        sessions.forget(yard)
    elif ends == "idle":
        now[0] = 301.0
        sessions.end_idle()
    else:
        sessions.process(hall, estimator, Upload(draw()), 0.0, Job(), Wanted(3))
    gc.collect()
    assert begun[0]() is None
