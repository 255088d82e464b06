"""Every error is a problem, says which field it is about, and shows no inner workings."""

from __future__ import annotations

import json
import re
import resource
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.estimation.estimator import Estimator
from app.main import create_app
from app.settings import Settings
from tests.conftest import Photo, png


def check_problem(response: httpx.Response, status: int, field: str | None = None) -> str:
    """The answer is a problem with this status; return its detail."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert problem["status"] == status
    assert problem["type"] == "about:blank"
    assert problem["title"]
    assert problem["detail"]
    assert re.fullmatch("[a-z_]+", problem["reason"])
    assert problem.get("field") == field
    assert "Traceback" not in response.text
    return str(problem["detail"])


@pytest.mark.parametrize("data", [b"", b"\x00", b"GIF89a", b"\xff\xd8\xff\xe0" + b"x" * 99])
@pytest.mark.parametrize("field", ["frame", "mask", "background"])
def test_undecodable_images(client: TestClient, photo: Photo, field: str, data: bytes) -> None:
    files = {"frame": photo.frame_png, field: data}
    check_problem(client.post("/pose", files=files), 400, field)


@pytest.mark.parametrize("path", ["/pose", "/pose/overlay", "/silhouette"])
@pytest.mark.parametrize("crowd", [0, 1])
def test_a_broken_frame_beside_a_sound_mask(
    client: TestClient, photo: Photo, path: str, crowd: int
) -> None:
    files = {"frame": b"\xff\xd8\xff\xe0" + b"x" * 99, "mask": png(crowd * photo.mask)}
    check_problem(client.post(path, files=files), 400, "frame")


def test_where_frame_and_mask_are_broken_the_frame_is_named(client: TestClient) -> None:
    check_problem(client.post("/pose", files={"frame": b"x", "mask": b"y"}), 400, "frame")


def test_a_bomb_is_refused_by_its_header(client: TestClient) -> None:
    bomb = png(np.zeros((12_000, 12_000), np.uint8))
    assert len(bomb) < 1_000_000
    check_problem(client.post("/pose", files={"frame": bomb}), 413, "frame")


@pytest.mark.parametrize("field", ["frame", "mask", "background"])
def test_a_chunk_that_claims_gigabytes_costs_nothing(
    client: TestClient, photo: Photo, field: str
) -> None:
    sound = photo.mask_png
    at = sound.index(b"IDAT") - 4
    for length in (0x7FFFFFFF, 0x60000000, len(sound)):
        bomb = sound[:at] + length.to_bytes(4, "big") + sound[at + 4 :]
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        check_problem(client.post("/pose", files={"frame": sound, field: bomb}), 400, field)
        # Kilobytes, of which a chunk believed would take a million and more.
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000


@pytest.mark.parametrize("field", ["mask", "background"])
def test_sizes_must_agree(client: TestClient, photo: Photo, field: str) -> None:
    files = {"frame": photo.frame_png, field: png(np.ones((10, 20), np.uint8))}
    detail = check_problem(client.post("/pose", files=files), 422, field)
    assert "320x240" in detail
    assert "20x10" in detail


@pytest.mark.parametrize(
    "boxes",
    [
        "no",
        "{}",
        "[[1, 2, 3]]",
        "[[1, 2, 3, 4, 5]]",
        '[["a", 2, 3, 4]]',
        "[[NaN, 2, 3, 4]]",
        "[[true, 2, 3, 4]]",
        '[["1", 2, 3, 4]]',
        "[[1, 2, 30, null]]",
        "[[1e400, 2, 3, 4]]",
        "[[1, 2, 0, 4]]",
        "[[1, 2, -3, 4]]",
        "[[1000, 1000, 5, 5]]",
        "[[-50, -50, 5, 5]]",
        json.dumps([[1, 2, 30, 40]] * 51),
    ],
)
def test_bad_boxes(client: TestClient, photo: Photo, boxes: str) -> None:
    files = {"frame": photo.frame_png}
    check_problem(client.post("/pose", files=files, data={"boxes": boxes}), 422, "boxes")


def test_boxes_without_number_are_counted_not_parsed(client: TestClient, photo: Photo) -> None:
    files = {"frame": photo.frame_png}
    # Its end is missing, which a parser would say.
    response = client.post("/pose", files=files, data={"boxes": "[" + "[1, 2, 3, 4]," * 60_000})
    assert "at most 50 persons, got 60000" in check_problem(response, 422, "boxes")
    response = client.post("/pose", files=files, data={"boxes": "[[1, 2, 3, 4" + "0" * 900_000})
    assert "at most 12800 characters" in check_problem(response, 422, "boxes")


def test_one_way_to_say_where_people_are(client: TestClient, photo: Photo) -> None:
    files = {"frame": photo.frame_png, "mask": photo.mask_png}
    response = client.post("/pose", files=files, data={"boxes": "[[1, 2, 30, 40]]"})
    check_problem(response, 422, "boxes")
    files["background"] = photo.frame_png
    check_problem(client.post("/pose", files=files), 422, "background")


@pytest.mark.parametrize(
    ("params", "field"),
    [
        ({"n": 0}, "n"),
        ({"n": 51}, "n"),
        ({"n": "x"}, "n"),
        ({"keypoints": "body25"}, "keypoints"),
        ({"evidence": "video"}, "evidence"),
    ],
)
def test_bad_parameters(
    client: TestClient, photo: Photo, params: dict[str, Any], field: str
) -> None:
    response = client.post("/pose", files={"frame": photo.frame_png}, params=params)
    check_problem(response, 422, field)


@pytest.mark.parametrize("path", ["/pose", "/pose/overlay", "/silhouette"])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "masc",
            "masc: expected one of the fields frame, mask, background, boxes; did you mean mask?",
        ),
        ("frame", "frame: expected one part, got 2"),
        ("mask", "mask: expected one part, got 2"),
    ],
)
def test_no_part_is_left_out_silently(
    client: TestClient, photo: Photo, path: str, name: str, said: str
) -> None:
    parts = [("frame", photo.frame_png), ("mask", photo.mask_png), (name, photo.mask_png)]
    detail = check_problem(client.post(path, files=parts), 422, name)
    assert detail == said


@pytest.mark.parametrize(
    ("query", "field", "said"),
    [
        ("m=3", "m", "m: expected one of the query parameters evidence, joints, keypoints, n, "),
        ("keypoint=coco17", "keypoint", "; did you mean keypoints?"),
        ("evidences=photograph", "evidences", "; did you mean evidence?"),
        ("n=3&n=5", "n", "n: expected one value, got 2"),
        ("N=3", "N", "N: expected one of the query parameters evidence, joints, keypoints, n, "),
    ],
)
def test_no_query_parameter_is_left_out_silently(
    client: TestClient, photo: Photo, query: str, field: str, said: str
) -> None:
    response = client.post(f"/pose?{query}", files={"frame": photo.frame_png})
    assert said in check_problem(response, 422, field)


def test_query_parameters_where_there_are_none(client: TestClient, photo: Photo) -> None:
    response = client.post("/silhouette?n=3", files={"frame": photo.frame_png})
    assert check_problem(response, 422, "n") == "n: expected no query parameters"
    check_problem(client.get("/index?entry=3"), 422, "entry")
    assert client.get("/index/entries/3?keypoints=coco17").status_code == 200
    check_problem(client.get("/index/entries/3?keypoint=coco17"), 422, "keypoint")


def test_a_wrong_parameter_is_told_in_our_own_words(client: TestClient, photo: Photo) -> None:
    response = client.post("/pose?n=51", files={"frame": photo.frame_png})
    assert check_problem(response, 422, "n") == "n: expected at most 50, got '51'"


@pytest.mark.parametrize(
    ("parts", "status", "field"),
    [
        ([("image", b"?")], 400, "image"),
        ([], 422, "image"),
        ([("image", b"?"), ("image", b"?")], 422, "image"),
        ([("image", (None, b"text"))], 422, "image"),
        ([("frame", b"?")], 422, "frame"),
        ([("image", b"?"), ("min_confidence", (None, b"1.5"))], 422, "min_confidence"),
        ([("image", b"?"), ("min_confidence", (None, b"much"))], 422, "min_confidence"),
    ],
)
def test_errors_of_deepstack_name_what_its_clients_send(
    client: TestClient, parts: list[tuple[str, Any]], status: int, field: str
) -> None:
    # An empty list would be no form at all.
    parts = parts or [("api_key", (None, b"any"))]
    response = client.post("/v1/vision/detection", files=parts)
    assert check_problem(response, status, field).startswith(f"{field}: ")


@pytest.mark.parametrize("path", ["/pose", "/pose/overlay", "/silhouette"])
def test_a_missing_frame(client: TestClient, photo: Photo, path: str) -> None:
    for rest in (
        {"files": {"background": photo.frame_png}},
        {"files": {"frame": (None, b"")}, "data": {"boxes": "[[1, 2, 30, 40]]"}},
    ):
        check_problem(client.post(path, **rest), 422, "frame")
    # Where a mask tells all, none is needed.
    assert client.post(path, files={"mask": photo.mask_png}).status_code == 200
    check_problem(client.post(path, files={"mask": b"?"}), 400, "mask")


def test_a_mask_alone_goes_with_nothing_else(client: TestClient, photo: Photo) -> None:
    files = {"mask": photo.mask_png}
    response = client.post("/pose", files=files, data={"boxes": "[[1, 2, 30, 40]]"})
    check_problem(response, 422, "boxes")
    files["background"] = photo.frame_png
    check_problem(client.post("/pose", files=files), 422, "background")


@pytest.mark.parametrize("field", ["frame", "mask", "background"])
def test_text_where_a_file_belongs(client: TestClient, photo: Photo, field: str) -> None:
    parts = {"frame": ("f", photo.frame_png), field: (None, b"frame.jpg")}
    check_problem(client.post("/pose", files=parts), 422, field)


def test_a_file_where_text_belongs(client: TestClient, photo: Photo) -> None:
    parts = {"frame": ("f", photo.frame_png), "boxes": ("boxes.json", b"[[1, 2, 30, 40]]")}
    check_problem(client.post("/pose", files=parts), 422, "boxes")


def test_fields_left_empty_in_a_browser(client: TestClient, photo: Photo) -> None:
    # requests and httpx leave the empty file name out, so the form is written out here.
    head = "--b\r\nContent-Disposition: form-data; name="
    empty = [f'{head}"{field}"; filename=""\r\n\r\n\r\n' for field in ("mask", "background")]
    frame = f'{head}"frame"; filename="f.png"\r\n\r\n'.encode() + photo.frame_png + b"\r\n"
    boxes = f'{head}"boxes"\r\n\r\n\r\n--b--\r\n'
    headers = {"content-type": "multipart/form-data; boundary=b"}
    response = client.post(
        "/pose", content="".join(empty).encode() + frame + boxes.encode(), headers=headers
    )
    assert response.status_code == 200, response.text
    response = client.post("/pose", content=f"{''.join(empty)}--b--\r\n", headers=headers)
    check_problem(response, 422, "frame")


@pytest.mark.parametrize("content_type", ["application/json", "video/mp4", ""])
def test_other_media_types(client: TestClient, content_type: str) -> None:
    response = client.post("/pose", content=b"{}", headers={"content-type": content_type})
    assert "multipart/form-data or image/*" in check_problem(response, 415)
    response = client.post("/v1/vision/detection", content=b"{}", headers={"content-type": "a/b"})
    check_problem(response, 415)


@pytest.mark.parametrize("content", [b"", b"\xff\xd8\xff\xe0" + b"x" * 99])
def test_a_body_that_is_no_image(client: TestClient, content: bytes) -> None:
    headers = {"content-type": "image/jpeg"}
    check_problem(client.post("/pose", content=content, headers=headers), 400, "frame")


def test_media_types_may_be_in_upper_case(client: TestClient, photo: Photo) -> None:
    part = b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n'
    response = client.post(
        "/pose",
        content=part + photo.frame_png + b"\r\n--b--\r\n",
        headers={"content-type": "Multipart/Form-Data; boundary=b"},
    )
    assert response.status_code == 200, response.text


def test_a_broken_multipart_body(client: TestClient) -> None:
    headers = {"content-type": "multipart/form-data; boundary=b"}
    check_problem(client.post("/pose", content=b"--b\r\nnonsense", headers=headers), 422, "frame")
    headers = {"content-type": "multipart/form-data"}
    response = client.post("/pose", content=b"--b\r\nnonsense", headers=headers)
    assert "well-formed multipart/form-data" in check_problem(response, 400)


def test_an_encoded_body_is_named(client: TestClient) -> None:
    headers = {"content-type": "image/jpeg", "content-encoding": "gzip"}
    response = client.post("/pose", content=b"x", headers=headers)
    assert "without Content-Encoding, got gzip" in check_problem(response, 415)


@pytest.mark.parametrize("box", [[1, 2, 0, 4], [1, 2, -3, 4]])
def test_a_box_is_written_as_it_was_sent(client: TestClient, photo: Photo, box: list[int]) -> None:
    files = {"frame": photo.frame_png}
    response = client.post("/pose", files=files, data={"boxes": json.dumps([box])})
    detail = check_problem(response, 422, "boxes")
    assert detail.endswith(f"got box 0: {[float(number) for number in box]}")


def test_unknown_paths_and_methods(client: TestClient) -> None:
    check_problem(client.get("/nothing"), 404)
    check_problem(client.get("/index/entries/96"), 404)
    check_problem(client.get("/index/entries/-1"), 422, "entry")
    check_problem(client.get("/index/entries/one"), 422, "entry")
    assert "whole number" in check_problem(client.get("/index/entries/1.0"), 422, "entry")
    response = client.get("/pose")
    check_problem(response, 405)
    assert response.headers["allow"] == "POST"


def test_too_many_bytes_by_length_and_by_count(
    settings: Settings, estimator: Estimator, photo: Photo
) -> None:
    small = settings.model_copy(update={"max_upload_bytes": 1024})
    with TestClient(create_app(small, estimator)) as client:
        files = {"frame": photo.frame_png}
        check_problem(client.post("/pose", files=files), 413)

        def chunks() -> Any:
            yield b"--b\r\n"
            for _ in range(100):
                yield b"x" * 100

        headers = {"content-type": "multipart/form-data; boundary=b"}
        check_problem(client.post("/pose", content=chunks(), headers=headers), 413)
