"""Any input gets an answer that keeps the contract, or a problem; never a 5xx."""

import json
import math
from typing import Any

import numpy as np
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from app.api.schemas import PoseResponse, Problem
from tests.conftest import Photo, png

relaxed = settings(
    max_examples=20,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def check_answer(response: Any) -> PoseResponse | None:
    """The answer is a valid PoseResponse or a valid Problem of a 4xx."""
    if response.status_code == 200:
        answer = PoseResponse.model_validate_json(response.content)
        assert [p.box.x for p in answer.persons] == sorted(p.box.x for p in answer.persons)
        return answer
    assert 400 <= response.status_code < 500, response.text
    problem = Problem.model_validate_json(response.content)
    assert problem.status == response.status_code
    return None


@relaxed
@given(data=st.binary(max_size=2000))
def test_any_file_gets_a_valid_answer(client: TestClient, photo: Photo, data: bytes) -> None:
    assert check_answer(client.post("/pose", files={"frame": data})) is None
    check_answer(client.post("/pose", files={"frame": photo.frame_png, "mask": data}))


@relaxed
@given(
    mask=arrays(
        st.sampled_from([np.uint8, np.uint16]),
        array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=40),
        elements=st.integers(0, 5),
    ),
    size=st.sampled_from([1, 13]),
)
def test_any_mask_gets_a_valid_answer(client: TestClient, mask: np.ndarray, size: int) -> None:
    """Values of a pixel are specks or noise; those of 13 pixels count."""
    if size > 1:
        mask = np.pad(np.kron(mask[:9, :9], np.ones((size, size), mask.dtype)), size)
    frame = png(np.zeros((*mask.shape, 3), np.uint8))
    answer = check_answer(client.post("/pose", files={"frame": frame, "mask": png(mask)}))
    if answer is None or size == 1:
        return
    labels = set(np.unique(mask)) - {0}
    assert len(answer.persons) == len(labels)
    areas = sorted(p.silhouette.area_px for p in answer.persons if p.silhouette)
    assert areas == sorted(int((mask == label).sum()) for label in labels)
    for person in answer.persons:
        for hypothesis in person.hypotheses:
            joints = (joint for joint in hypothesis.joints_2d or () if joint)
            assert all(math.isfinite(joint["x"] + joint["y"]) for joint in joints)


numbers = st.one_of(
    st.integers(-1000, 1000),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from(["1", None, True, [], {}]),
)
BOXES = st.tuples(
    st.integers(-20, 300), st.integers(-20, 220), st.integers(1, 90), st.integers(1, 120)
).map(list)


@settings(relaxed, max_examples=10)
@given(
    boxes=st.one_of(
        st.lists(BOXES, max_size=3),
        st.lists(st.one_of(BOXES, st.lists(numbers, max_size=6)), max_size=5),
    )
)
def test_any_boxes_get_a_valid_answer(client: TestClient, photo: Photo, boxes: list[Any]) -> None:
    response = client.post(
        "/pose", files={"frame": photo.frame_png}, data={"boxes": json.dumps(boxes)}
    )
    answer = check_answer(response)
    if answer is not None:
        assert len(answer.persons) == len(boxes)
