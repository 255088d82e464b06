"""Every error is a problem, names the field at fault, and reveals no internals."""

from __future__ import annotations

import json
import resource
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.api.tracking_schemas import MAX_CORNERS, MAX_ZONES
from app.estimation.upload import Upload, UploadError
from app.main import create_app
from app.photograph import Estimator
from app.settings import Settings
from app.vision.geometry import Box
from tests.conftest import Photo, Serving, png
from tests.support.service import check_problem

Request = dict[str, Any]
FRAME = png(np.full((240, 320, 3), 200, np.uint8))
MASK = png(np.pad(np.ones((100, 30), np.uint8), ((70, 70), (145, 145))))
BROKEN = b"\xff\xd8\xff\xe0" + b"x" * 99
MULTIPART = "multipart/form-data; boundary=b"
PART = b'--b\r\nContent-Disposition: form-data; name="frame"; filename="f"\r\n\r\n' + FRAME
BOX = "[[1, 2, 30, 40]]"
YARD, DEEPSTACK = "/cameras/yard/frames", "/v1/vision/detection"
FRAMES = ("/pose", "/pose/overlay", "/silhouette")
ZONE = {"name": "door", "kind": "watch", "polygon": [[0, 0], [100, 0], [100, 240], [0, 240]]}


def form(*more: tuple[str, bytes], **parts: bytes | str) -> Request:
    """A form of files (bytes) and fields (text)."""
    every = [*parts.items(), *more]
    return {"files": [(n, (None, v) if isinstance(v, str) else ("f", v)) for n, v in every]}


def zones(*zones: Any, **changed: Any) -> Request:
    """A configuration of these zones, or of one zone with changed fields."""
    return {"json": {"zones": zones or [ZONE | changed]}}


def body(content: bytes, media_type: str = "image/jpeg", **headers: str) -> Request:
    return {"content": content, "headers": {"content-type": media_type, **headers}}


def corners(*last: Any) -> list[Any]:
    return [[0, 0], [9, 9], *last]


def figures(*lefts: int, height: int = 70, width: int = 20) -> bytes:
    """A mask of one label with figures side by side."""
    labels = np.zeros((90, 200), np.uint8)
    for left in lefts:
        labels[10 : 10 + height, left : left + width] = 255
    return png(labels)


def track(text: str) -> Request:
    return form(frame=FRAME, boxes="[[1, 2, 30, 40], [5, 6, 30, 40]]", track_ids=text)


REFUSED: dict[tuple[int, str], list[tuple[str, Request, str | None, str]]] = {
    (400, "undecodable"): [
        *(("/pose", form(**{"frame": FRAME, field: data}), field, "")
          for field in ("frame", "mask", "background")
          for data in (b"", b"\x00", b"GIF89a", BROKEN)),
        *((path, form(frame=BROKEN, mask=mask), "frame", "")
          for path in FRAMES for mask in (MASK, png(np.zeros((240, 320), np.uint8)), b"?")),
        *((path, form(mask=b"?"), "mask", "") for path in FRAMES),
        *(("/pose", body(content), "frame", "") for content in (b"", BROKEN)),
        ("/pose", body(b"--b\r\nnonsense", "multipart/form-data"), None, "boundary=x, got none"),
        ("/pose", body(b"--a\r\nnonsense", MULTIPART), None, "well-formed multipart"),
        ("/pose", body(b"--b\r\nnonsense", MULTIPART), None, "ends with its boundary"),
        ("/pose", body(PART, MULTIPART), None, "ends with its boundary"),
        (DEEPSTACK, form(image=b"?"), "image", "image: "),
        ("/sequence", form(video=b"#EXTM3U\n/etc/x\n"), "video", "something else or a broken"),
    ],
    (404, "not_found"): [
        ("GET /nothing", {}, None, ""),
        ("GET /poses", {}, None, "/poses'; did you mean /pose?"),
        ("GET /health", {}, None, "; did you mean /healthz?"),
        ("GET /silhouettes", {}, None, "; did you mean /silhouette?"),
        ("GET /index/entries/96", {}, None, ""),
        ("GET /cameras/yard", {}, None, "yard"),
        ("DELETE /cameras/yard", {}, None, "yard"),
    ],
    (405, "method_not_allowed"): [
        *((f"{method} /pose", {}, None, f"expected POST, got {method}")
          for method in ("GET", "PUT", "PROPFIND", "OPTIONS")),
        ("POST /index", {}, None, "expected GET or HEAD, got POST"),
        ("DELETE /static/page.js", {}, None, "expected GET or HEAD, got DELETE"),
        ("POST /cameras/yard", {}, None, ""),
    ],
    (413, "too_large"): [
        ("/pose", form(frame=png(np.zeros((12_000, 12_000), np.uint8))), "frame", ""),
    ],
    (413, "too_many_bytes"): [
        ("PUT /cameras/yard", {"content": b" " * 256_001}, None, "at most 256000 bytes"),
    ],
    (415, "unsupported_media_type"): [
        *(("/pose", body(b"{}", media_type), None, "multipart/form-data or image/*")
          for media_type in ("application/json", "video/mp4", "")),
        ("/pose", body(b"x", **{"content-encoding": "gzip"}), None,
         "without Content-Encoding, got gzip"),
        (DEEPSTACK, body(b"{}", "a/b"), None, ""),
        ("/sequence", {"content": b"?"}, None, ""),
    ],
    (422, "misfit"): [
        *(("/pose", form(**{"frame": FRAME, field: png(np.ones((10, 20), np.uint8))}), field,
           "320x240 pixels like the frame, got 20x10") for field in ("mask", "background")),
        *(("/pose", form(frame=FRAME, boxes=boxes), "boxes", said) for boxes, said in (
            ("[[1000, 1000, 5, 5]]", ""), ("[[-50, -50, 5, 5]]", ""),
            ("[[1, 2, 0, 4]]", "got box 0: [1.0, 2.0, 0.0, 4.0]"),
            ("[[1, 2, -3, 4]]", "got box 0: [1.0, 2.0, -3.0, 4.0]"),
            (json.dumps([[1, 2, 30, 40]] * 51), "at most 50 persons, got 51"),
            # Counted, not parsed: a parser would say that the end is missing.
            ("[" + "[1, 2, 3, 4]," * 60_000, "at most 50 persons, got 60000"),
            ("[[1, 2, 3, 4" + "0" * 900_000, "at most 12800 characters"),
        )),
        *((YARD, track(text), "track_ids", said) for text, said in (
            ('["17"]', "one for each box, got 1 and 2 boxes"),
            ('["17", "17"]', "each once, got '17' twice"),
            ('["17", 17]', "each once, got '17' twice"),
        )),
        (YARD, form(frame=FRAME, track_ids='["17"]'), "track_ids", "no boxes"),
        (YARD, track("[1," + " " * 900_000), "track_ids", "at most 12800 characters"),
        ("/pose", form(frame=FRAME, mask=MASK, boxes=BOX), "boxes", ""),
        ("/pose", form(frame=FRAME, mask=MASK, background=FRAME), "background", ""),
        ("/pose", form(mask=MASK, boxes=BOX), "boxes", ""),
        ("/pose", form(mask=MASK, background=FRAME), "background", ""),
        ("/pose", form(mask=figures(10, 60, 150)), "mask", "3 figures apart with the same label"),
        *((path, form(background=FRAME), "frame", "") for path in FRAMES),
        *((path, form(frame="", boxes=BOX), "frame", "") for path in FRAMES),
    ],
    (422, "invalid"): [
        *(("/pose", form(frame=FRAME, boxes=boxes), "boxes", said) for boxes, said in (
            ("no", "expected valid JSON: "), ("{}", "boxes: expected a list, got {}; boxes are"),
            ("[[1, 2, 3]]", "boxes[0]: expected at least 4 values, got 3; boxes are a JSON list"),
            (f"[[{'9' * 5000}]]", "expected valid JSON: number out of range"),
            ("[[1, 2, 30, null]]", "boxes[0][3]: expected a number, got null"),
            ("[[1, 2, 3, 4, 5]]", ""),
            ('[["a", 2, 3, 4]]', ""), ("[[NaN, 2, 3, 4]]", ""), ("[[true, 2, 3, 4]]", ""),
            ('[["1", 2, 3, 4]]', ""), ("[[1e400, 2, 3, 4]]", ""),
        )),
        *(("/pose", form(**{"frame": FRAME, field: "frame.jpg"}), field, "")
          for field in ("frame", "mask", "background")),
        ("/pose", body(PART.replace(b"filename", b"filename*") + b"\r\n--b--", MULTIPART),
         "frame", "a file, which has a filename, got text"),
        ("/pose", form(frame=FRAME, boxes=BOX.encode()), "boxes", ""),
        *((path, form((name, MASK), frame=FRAME, mask=MASK), name, said)
          for path in FRAMES for name, said in (
              ("masc", "masc: expected one of the fields frame, mask, background, boxes; "
                       "did you mean mask?"),
              ("frame", "frame: expected one part, got 2"),
              ("mask", "mask: expected one part, got 2"))),
        *((f"/pose?{query}", form(frame=FRAME), query.split("=")[0], said) for query, said in (
            ("n=0", ""), ("n=x", ""), ("n=51", "n: expected at most 50, got '51'"),
            (f"n={'9' * 5000}", "n: expected a whole number of at most 18 digits, got"),
            ("keypoints=body25", ""), ("evidence=video", ""),
            ("silhouettes=png", "'none', 'rle' or 'polygon'"),
            ("m=3", "m: expected one of the query parameters evidence, fov_deg, joints, keypoints"),
            ("N=3", "N: expected one of the query parameters evidence, fov_deg, joints, keypoints"),
            ("keypoint=coco17", "; did you mean keypoints?"),
            ("evidences=photograph", "; did you mean evidence?"),
            ("n=3&n=5", "n: expected one value, got 2"),
            ("fov_deg=5", "fov_deg: expected at least 10.0, got '5'"),
            ("fov_deg=180", "fov_deg: expected at most 170.0, got '180'"),
            ("fov_deg=nan", "fov_deg: expected"),
            ("pixel_aspect=9", "pixel_aspect: expected at most 4.0, got '9'"),
            ("pixel_aspect=wide", "pixel_aspect: expected a number, got 'wide'"),
        )),
        ("/silhouette?n=3", form(frame=FRAME), "n", "n: expected no query parameters"),
        ("GET /index?entry=3", {}, "entry", ""),
        ("GET /index/entries/3?keypoint=coco17", {}, "keypoint", ""),
        *((f"GET /index/entries/{entry}", {}, "entry", said)
          for entry, said in (("-1", ""), ("one", ""), ("1.0", "whole number"))),
        (DEEPSTACK, form(api_key="any"), "image", "image: "),
        (DEEPSTACK, form(("image", b"?"), image=b"?"), "image", "image: "),
        (DEEPSTACK, form(image="text"), "image", "image: "),
        (DEEPSTACK, form(frame=b"?"), "frame", "frame: "),
        *((DEEPSTACK, form(image=b"?", min_confidence=text), "min_confidence", "min_confidence: ")
          for text in ("1.5", "much")),
        *((f"/cameras/{name}/frames", form(frame=FRAME), "camera_id", "A-Za-z0-9")
          for name in ("a b", "x" * 65, "a\u00e9", "yard%0A")),
        *(("/pose", form(frame=FRAME) | {"headers": {"X-Camera-ID": name}}, "X-Camera-ID",
           "A-Za-z0-9") for name in ("", "a b", "x" * 65, 'a"b', ".", "..")),
        *(request for text, said in (
            ("nan", ""), ("inf", ""), ("-1", ""), ("noon", ""),
            ("1764000000000", "expected seconds, at most 100000000000, got 1764000000000; divide"),
        ) for request in (
            (YARD, form(frame=FRAME, timestamp=text), "timestamp", said),
            (f"{YARD}?timestamp={text}", form(frame=FRAME), "timestamp", said))),
        (f"{YARD}?timestamp=1", form(frame=FRAME, timestamp="1"), "timestamp", "got both"),
        *((YARD, track(text), "track_ids", "1 to 64 characters") for text in (
            '["17", ""]', '["17", true]', '["17", 1.5]', '{"17": 1}', f'["17", "{"x" * 65}"]',
            f'["17", {"9" * 99}]', "17", "[")),
        ("/pose", form(frame=FRAME, track_ids='["17"]'), "track_ids", ""),
        *(("PUT /cameras/yard", request, field, said) for request, field, said in (
            (zones(kind="bed"), "zones[0].kind", "'rest' or 'watch'"),
            (zones(name=""), "zones[0].name", "some text"),
            (zones(name="x" * 65), "zones[0].name", "64"),
            (zones(polygon=corners()), "zones[0].polygon", "expected at least 3 values"),
            (zones(polygon=[[0.1, 0.1], [0.9, 0.1], [0.5, 0.9]]), "zones[0].polygon", "pixels of"),
            (zones(polygon=corners([100, 100])), "zones[0].polygon", "got a line"),
            (zones(polygon=[[5, 5]] * 4), "zones[0].polygon", "within a pixel"),
            (zones(polygon=[[0, 0]] * (MAX_CORNERS + 1)), "zones[0].polygon", "64"),
            (zones(polygon=corners([1])), "zones[0].polygon[2]", "2 values"),
            (zones(polygon=corners(["1", 2])), "zones[0].polygon[2][0]", "number"),
            (zones(colour="red"), "zones[0]", "fields name, kind, polygon, got 'colour'"),
            ({"json": {"zone": []}}, None, "got 'zone'; did you mean zones?"),
            (zones(ZONE, ZONE), "zones", "'door' twice"),
            (zones(*[ZONE] * (MAX_ZONES + 1)), "zones", "expected at most 32 values, got 33"),
            (zones(*[{}] * 60_000), "zones", "at most 32 zones of 64 corners"),
            ({"json": {"zones": "door"}}, "zones", "a list"),
            ({"json": {"zones": [{}]}}, "zones[0].name", "a value"),
            ({"content": json.dumps({"zones": [ZONE]}).replace("240", "1e999")},
             "zones[0].polygon[2][1]", "finite"),
            *(({"content": content}, None, "JSON object") for content in (
                b"[]", b"null", b'"zones"')),
            *(({"content": content}, None, "valid JSON: ") for content in (
                b"", b"{", b"\xff", b'{"zones": [{]}', b"[" * 9999, b"9" * 5000)),
        )),
        ("PUT /cameras/a b", {"json": {"zones": []}}, "camera_id", ""),
        *(("PUT /cameras/lens", {"json": {"zones": [], field: value}}, field, "")
          for field, value in (("fov_deg", 200), ("pixel_aspect", "2"))),
        ("/sequence", form(frame=FRAME), "frame", ""),
        ("/sequence", form(video="x"), "video", ""),
        ("/sequence?stride=0", form(video=FRAME), "stride", ""),
        ("/sequence?fps=3", form(video=FRAME), "fps", ""),
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
    ("changed", "request_", "status", "field", "said"),
    [
        ({"max_cameras": 0}, (YARD, form(frame=FRAME)), 404, None, "no camera sessions"),
        ({"max_upload_bytes": 100}, ("/pose", form(frame=FRAME)), 413, None, ""),
        (
            {"max_upload_bytes": 1024},
            ("/pose", body(iter([b"--b\r\n", *[b"x" * 100] * 100]), MULTIPART)),
            413, None, "",
        ),
    ],
)  # fmt: skip
def test_settings_set_the_limits(
    serving: Serving,
    changed: dict[str, Any],
    request_: tuple[str, Request],
    status: int,
    field: str | None,
    said: str,
) -> None:
    with serving(**changed) as client:
        assert said in check_problem(ask(client, *request_), status, field)


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
        # In kilobytes; a decoder that believed the chunk would take a million or more.
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000


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
    request = body("".join([*empty, "--b--\r\n"]).encode(), MULTIPART)
    check_problem(client.post("/pose", **request), 422, "frame")


def test_a_405_lists_the_allowed_methods(client: TestClient) -> None:
    for method, path, allow in (("PUT", "/pose", "POST"), ("POST", "/index", "GET, HEAD")):
        assert client.request(method, path).headers["allow"] == allow


def test_too_many_people_are_refused(settings: Settings, estimator: Estimator) -> None:
    few = Estimator(
        estimator.index, estimator.models,
        min_person_px=50, max_pixels=10**6, max_persons=2,
    )  # fmt: skip
    labels = np.zeros((90, 90), np.uint8)
    labels[10:80] = np.repeat([0, 1, 2, 3, 0, 0], 15)
    with TestClient(create_app(settings, few)) as client:
        check_problem(client.post("/pose", files={"mask": png(labels)}), 422, "mask")


@pytest.mark.parametrize(
    "mask",
    [figures(60), figures(60, 85), figures(10, 150, height=30), figures(10, 40, 70, width=30)],
)
def test_parts_of_one_person_are_one_person(client: TestClient, mask: bytes) -> None:
    assert len(client.post("/pose", files={"mask": mask}).json()["persons"]) == 1


def test_a_request_without_frame_and_mask_is_refused() -> None:
    for rest in ({}, {"background": b"?"}, {"boxes": (Box(1, 2, 30, 40),)}):
        with pytest.raises(UploadError, match="frame: expected an image file, got none"):
            Upload(**rest)  # type: ignore[arg-type]
