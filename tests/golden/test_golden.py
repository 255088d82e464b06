"""Every request of the table has its golden answer."""

import copy
from collections.abc import Iterator
from typing import Any

import pytest

from app.photograph import Estimator
from tests.golden.answers import FOLDER, Conversation, differences, read, services
from tests.golden.requests import Request, kept_requests

SHOWN = 20


@pytest.fixture(scope="module")
def conversation(shipped: Estimator) -> Iterator[Conversation]:
    with services(shipped) as clients:
        yield Conversation(clients)


@pytest.mark.parametrize("request_", kept_requests(), ids=lambda request: request.name)
def test_the_answer_is_the_golden_one(conversation: Conversation, request_: Request) -> None:
    answer = conversation.answer(request_)
    found = list(differences(read(request_.name), answer, request_.exact))
    assert not found, "\n".join([f"{len(found)} differences", *found[:SHOWN]])


def test_every_answer_has_its_request() -> None:
    names = [request.name for request in kept_requests()]
    assert sorted(names) == sorted(file.stem for file in FOLDER.glob("*.json"))


def test_a_changed_answer_is_noticed() -> None:
    stored = read("street")
    assert list(differences(stored, stored, exact=True)) == []
    changed = copy.deepcopy(stored)
    person = changed["body"]["persons"][1]
    person["box"]["x"] += 1
    person["hypotheses"][0]["entry"] += 1
    del person["silhouette"]["truncated"]
    person["observed_keypoints"].pop()
    found = list(differences(stored, changed, exact=False))
    assert len(found) == 4
    assert all(difference.startswith("body.persons[1].") for difference in found)


def test_to_the_last_digit_or_within_the_tolerance() -> None:
    def found(one: Any, other: Any, exact: bool) -> list[str]:
        return list(differences({"x": one}, {"x": other}, exact))

    assert found(100.0, 100.1, exact=True) == ["x: 100.0 -> 100.1"]
    for one, other in ((100.0, 100.1), (5.0, 5.01), (0.0102, 0.0109), (48.0, 47.9)):
        assert found(one, other, exact=False) == found(other, one, exact=False) == []
    for one, other in ((100.0, 100.21), (5.0, 5.02), (0.0102, 0.0123), (1, 1.0), (1, 2)):
        assert found(one, other, exact=False)
