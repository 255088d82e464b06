"""Refused requests: how routes read forms, queries and JSON; every error is a problem.

What makes an image, mask or video unusable is tested beside its decoder, and whole sentences are
golden answers.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.configuration import MAX_CORNERS, MAX_ZONES
from tests.conftest import Photo, Serving, png
from tests.support.service import check_problem

Request = dict[str, Any]
FRAME = png(np.full((240, 320, 3), 200, np.uint8))
MASK = png(np.pad(np.ones((100, 30), np.uint8), ((70, 70), (145, 145))))
MULTIPART = "multipart/form-data; boundary=b"
PART = b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n' + FRAME
YARD, DEEPSTACK = "/cameras/yard/frames", "/v1/vision/detection"
ZONE = {"name": "door", "kind": "watch", "polygon": [[0, 0], [100, 0], [100, 240], [0, 240]]}
DIGITS = "9" * 5000


def form(*more: tuple[str, bytes], **parts: bytes | str) -> Request:
    """A form of files (bytes) and fields (text)."""
    every = [*parts.items(), *more]
    return {"files": [(n, (None, v) if isinstance(v, str) else ("f", v)) for n, v in every]}


def zones(*zones: Any, **changed: Any) -> Request:
    """A configuration of these zones, or of one zone with changed fields."""
    return {"json": {"zones": zones or [ZONE | changed]}}


def body(content: Any, media_type: str = MULTIPART, **headers: str) -> Request:
    return {"content": content, "headers": {"content-type": media_type, **headers}}


def track(text: str) -> Request:
    return form(frame=FRAME, boxes="[[1, 2, 30, 40], [5, 6, 30, 40]]", track_ids=text)


def polygon(*last: Any) -> Request:
    return zones(polygon=[[0, 0], [9, 9], *last])


REFUSED: dict[tuple[int, str], list[tuple[str, Request, str | None, str]]] = {
    (400, "undecodable"): [
        ("/pose/overlay", form(frame=FRAME, mask=b""), "mask", ""),
        ("/silhouette", body(b"", "image/jpeg"), "frame", ""),
        (DEEPSTACK, form(image=b"?"), "image", "image: "),
        ("/pose", body(PART, "multipart/form-data"), None, "boundary=x, got none"),
        ("/pose", body(b"--a\r\nnonsense"), None, "well-formed multipart"),
        *(("/pose", body(cut), None, "ends with its boundary") for cut in (b"--b\r\nX", PART)),
    ],
    (404, "not_found"): [
        ("GET /nothing", {}, None, ""),
        ("GET /health", {}, None, "; did you mean /healthz?"),
        ("DELETE /cameras/yard", {}, None, "yard"),
    ],
    (405, "method_not_allowed"): [
        ("PROPFIND /pose", {}, None, "expected POST, got PROPFIND"),
        ("POST /index", {}, None, "expected GET or HEAD, got POST"),
        ("DELETE /static/page.js", {}, None, "expected GET or HEAD, got DELETE"),
    ],
    (413, "too_many_bytes"): [
        ("PUT /cameras/yard", {"content": b" " * 256_001}, None, "at most 256000 bytes"),
    ],
    (415, "unsupported_media_type"): [
        ("/pose", body(b"{}", "video/mp4"), None, "multipart/form-data or image/*"),
        ("/pose", body(b"x", "image/jpeg", **{"content-encoding": "gzip"}), None, "got gzip"),
        (DEEPSTACK, body(b"{}", "image/jpeg"), None, "expected a body of type multipart"),
        ("/sequence", {"content": b"?"}, None, "multipart/form-data, video/* or image/gif"),
    ],
    (422, "misfit"): [
        *(("/pose", form(frame=FRAME, boxes=boxes), "boxes", said) for boxes, said in (
            ("[[1, 2, 0, 4]]", "got box 0: [1.0, 2.0, 0.0, 4.0]"),
            ("[[0.1, 0.2, 0.3, 0.9]]", "in pixels, not fractions of the frame, got box 0"),
            # Counted, not parsed: a parser would say that the end is missing.
            ("[" + "[1, 2, 3, 4]," * 60_000, "at most 50 persons, got 60000"),
            ("[[1, 2, 3, 4" + "0" * 900_000, "at most 12800 characters"),
        )),
        (YARD, track('["17", 17]'), "track_ids", "each once, got '17' twice"),
        (YARD, track("[1," + " " * 900_000), "track_ids", "at most 12800 characters"),
        ("/pose", form(mask=MASK, boxes="[[1, 2, 30, 40]]"), "boxes", ""),
    ],
    (422, "invalid"): [
        *(("/pose", form(frame=FRAME, boxes=boxes), "boxes", said) for boxes, said in (
            ("no", "boxes: expected valid JSON: "), ("{}", "boxes: expected a list, got {}; boxes"),
            (f"[[{DIGITS}]]", "expected valid JSON: number out of range"),
            ("[[1, 2, 30, null]]", "boxes[0][3]: expected a number, got null; boxes are a JSON"),
            ("[[NaN, 2, 3, 4]]", ""), ("[[true, 2, 3, 4]]", ""), ('[["1", 2, 3, 4]]', ""),
        )),
        ("/pose", form(frame="frame.jpg"), "frame", "expected a file, got text: 'frame.jpg'"),
        ("/pose", form(frame=FRAME, boxes=b"[]"), "boxes", "expected text, got a file"),
        ("/silhouette", form(frame=FRAME, masc=MASK), "masc", "one of the fields frame, mask, "
         "background, boxes; did you mean mask?"),
        ("/pose", form(("mask", MASK), frame=FRAME, mask=MASK), "mask", "one part, got 2"),
        *((f"/pose?{query}", form(frame=FRAME), query.split("=")[0], said) for query, said in (
            ("n=x", ""), (f"n={DIGITS}", "n: expected a whole number of at most 18 digits, got"),
            ("silhouettes=png", "'none', 'rle' or 'polygon'"),
            ("N=3", "N: expected one of the query parameters evidence, fov_deg, joints, keypoints"),
            ("n=3&n=5", "n: expected one value, got 2"), ("fov_deg=nan", "fov_deg: expected"),
            ("pixel_aspect=wide", "pixel_aspect: expected a number, got 'wide'"),
            ("roll_deg=450", "roll_deg: expected at most 360"),
            ("roll_deg=20", "roll_deg: expected a multiple of 90, got '20'"),
            ("roll_deg=left", "a number, got 'left'"),
        )),
        ("/silhouette?n=3", form(frame=FRAME), "n", "one of the query parameters method, segm"),
        ("GET /index/entries/3?keypoint=coco17", {}, "keypoint", ""),
        ("GET /index/entries/1.0", {}, "entry", "whole number"),
        (DEEPSTACK, form(api_key="any"), "image", "image: expected an image file, got none"),
        (DEEPSTACK, form(image=b"?", min_confidence="1.5"), "min_confidence", "at most 1"),
        *((f"/cameras/{name}/frames", form(frame=FRAME), "camera_id", "A-Za-z0-9")
          for name in ("a b", "x" * 65, "a\u00e9", "yard%0A")),
        *(("/pose", form(frame=FRAME) | {"headers": {"X-Camera-ID": name}}, "X-Camera-ID",
           "A-Za-z0-9") for name in ("", 'a"b', "..")),
        *((f"{YARD}?timestamp={text}", form(frame=FRAME), "timestamp", said) for text, said in (
            ("inf", ""), ("-1", ""),
            ("1764000000000", "expected seconds, at most 100000000000, got 1764000000000; divide"),
        )),
        (YARD, form(frame=FRAME, timestamp="noon"), "timestamp", "a number, got 'noon'"),
        (YARD, form(frame=FRAME, timestamp=""), "timestamp", "a number, got ''"),
        (f"{YARD}?timestamp=1", form(frame=FRAME, timestamp="1"), "timestamp", "got both"),
        *((YARD, track(text), "track_ids", "1 to 64 characters") for text in (
            '["17", ""]', '["17", true]', '["17", 1.5]', '{"17": 1}', f'["17", {DIGITS}]', "[")),
        ("/pose", form(frame=FRAME, track_ids='["17"]'), "track_ids", ""),
        *(("PUT /cameras/yard", request, field, said) for request, field, said in (
            (zones(name=""), "zones[0].name", "some text"),
            (zones(name="x" * 65), "zones[0].name", "64"),
            (zones(name="bed\n"), "zones[0].name", "expected a name of printable characters"),
            (polygon(), "zones[0].polygon", "expected at least 3 values"),
            (polygon([100, 100]), "zones[0].polygon", "got a line"),
            (zones(polygon=[[0.1, 0.1], [0.9, 0.1], [0.5, 0.9]]), "zones[0].polygon", "a pixel"),
            (zones(polygon=[[0, 0]] * (MAX_CORNERS + 1)), "zones[0].polygon", "64"),
            (polygon([1]), "zones[0].polygon[2]", "2 values"),
            (polygon(["1", 2]), "zones[0].polygon[2][0]", "number"),
            (zones(colour="red"), "zones[0]", "fields name, kind, polygon, got 'colour'"),
            ({"json": {"zone": []}}, None, "got 'zone'; did you mean zones?"),
            (zones(ZONE, ZONE), "zones", "'door' twice"),
            (zones(*[ZONE] * (MAX_ZONES + 1)), "zones", "expected at most 32 values, got 33"),
            (zones(*[{}] * 60_000), "zones", "at most 32 zones of 64 corners"),
            ({"json": {"zones": [{}]}}, "zones[0].name", "a value"),
            ({"json": {"pixel_aspect": "2"}}, "pixel_aspect", ""),
            ({"json": {"roll_deg": -450}}, "roll_deg", "at least -360"),
            ({"json": {"roll_deg": 45}}, "roll_deg", "expected a multiple of 90, got 45"),
            ({"content": json.dumps({"zones": [ZONE]}).replace("240", "1e999")},
             "zones[0].polygon[2][1]", "finite"),
            ({"content": b"null"}, None, "JSON object"),
            *(({"content": content}, None, "valid JSON: ") for content in (
                b"", b"\xff", b"[" * 9999, DIGITS.encode())),
        )),
        ("/sequence", form(frame=FRAME), "frame", ""),
        ("/sequence", form(video="x"), "video", ""),
        ("/sequence?stride=0", form(video=FRAME), "stride", ""),
        ("/sequence?max_frames=0", form(video=FRAME), "max_frames", ""),
    ],
}  # fmt: skip
"""Refused requests by status and reason, each with the field and a part of the sentence.

The method is POST unless the path names another one.
"""


@pytest.fixture(scope="module")
def client(serving: Serving) -> Iterator[TestClient]:
    """One client for all tests: refused requests change nothing."""
    with serving() as client:
        yield client
        assert client.get("/cameras").json() == {"cameras": []}


def ask(client: TestClient, path: str, request: Request) -> Any:
    *method, path = path.split(" ", 1) if path[0] != "/" else [path]
    return client.request(*(method or ["POST"]), path, **request)


ROWS = [(*kind, *row) for kind, rows in REFUSED.items() for row in rows]


@pytest.mark.parametrize(
    ("status", "reason", "path", "request_", "field", "said"),
    ROWS,
    ids=[f"{status} {path[:40]} {said[:40]}" for status, _, path, *_, said in ROWS],
)
def test_a_refusal_says_why(
    client: TestClient,
    status: int,
    reason: str,
    path: str,
    request_: Request,
    field: str | None,
    said: str,
) -> None:
    response = ask(client, path, request_)
    assert said in check_problem(response, status, field)
    assert response.json()["reason"] == reason


@pytest.mark.parametrize(
    ("changed", "request_", "status", "said"),
    [
        ({"max_cameras": 0}, (YARD, form(frame=FRAME)), 404, "no camera sessions"),
        ({"max_cameras": 0}, ("PUT /cameras/yard", {"json": {}}), 404, "no camera sessions"),
        ({"max_upload_bytes": 100}, ("/pose", form(frame=FRAME)), 413, ""),
        ({"max_upload_bytes": 1024}, ("/pose", body(iter([PART, *[b"x" * 100] * 100]))), 413, ""),
    ],
)
def test_settings_set_the_limits(
    serving: Serving, changed: dict[str, Any], request_: tuple[str, Request], status: int, said: str
) -> None:
    with serving(**changed) as client:
        assert said in check_problem(ask(client, *request_), status)


def test_empty_fields_of_a_browser_count_as_missing(client: TestClient, photo: Photo) -> None:
    # requests and httpx leave the empty file name out, so the form is written out here.
    head = "--b\r\nContent-Disposition: form-data; name="
    empty = [f'{head}"{field}"; filename=""\r\n\r\n\r\n' for field in ("mask", "background")]
    frame = f'{head}"frame"; filename="f.png"\r\n\r\n'.encode() + photo.frame_png + b"\r\n"
    boxes = f'{head}"boxes"\r\n\r\n\r\n--b--\r\n'
    # Media types may be in upper case.
    upper_case = MULTIPART.replace("multipart", "MULTIPART")
    request = body("".join(empty).encode() + frame + boxes.encode(), upper_case)
    response = client.post("/pose", **request)
    assert response.status_code == 200, response.text
    request = body("".join([*empty, "--b--\r\n"]).encode())
    check_problem(client.post("/pose", **request), 422, "frame")


@pytest.mark.parametrize("filename", [b"", b'; filename=""', b"; filename*=UTF-8''f.png"])
def test_files_need_no_filename(client: TestClient, photo: Photo, filename: bytes) -> None:
    part = PART.replace(b'; filename="f"', filename).removesuffix(FRAME) + photo.frame_png
    response = client.post("/pose", **body(part + b"\r\n--b--\r\n"))
    assert response.status_code == 200, response.text
    assert response.json()["image"]["width"] == photo.frame.shape[1]


def test_byte_order_marks_are_ignored(client: TestClient, photo: Photo) -> None:
    configured = client.put("/cameras/marked", content=b'\xef\xbb\xbf{"fov_deg": 70}')
    assert configured.status_code == 200, configured.text
    response = client.post("/pose", **form(frame=photo.frame_png, boxes="\ufeff[[9, 9, 40, 90]]"))
    assert response.status_code == 200, response.text
    client.delete("/cameras/marked")


def test_a_photograph_may_have_no_media_type_of_its_own(client: TestClient, photo: Photo) -> None:
    # Generated clients send every file as this.
    for kind in ("application/octet-stream", "image/png"):
        response = client.post("/pose", content=photo.frame_png, headers={"content-type": kind})
        assert response.status_code == 200, response.text


def test_a_405_lists_the_allowed_methods(client: TestClient) -> None:
    for method, path, allow in (("PUT", "/pose", "POST"), ("POST", "/index", "GET, HEAD")):
        assert client.request(method, path).headers["allow"] == allow
