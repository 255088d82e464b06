"""DeepStack's protocol."""

from types import SimpleNamespace

import pytest
from fastapi.testclient import TestClient

from app.photograph import Estimator
from app.vision.geometry import Box


def test_the_twenty_most_certain_people_are_returned(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    people = [
        SimpleNamespace(detection_score=0.5 + number / 100, box=Box(number, 0.0, 5.0, 9.0))
        for number in range(30)
    ]
    monkeypatch.setattr(Estimator, "find_people", lambda *_, **__: SimpleNamespace(persons=people))
    answer = client.post("/v1/vision/detection", files={"image": b"?"}).json()
    found = [prediction["x_min"] for prediction in answer["predictions"]]
    assert found == list(range(29, 9, -1))
