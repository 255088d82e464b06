"""Uploads: what is refused, and what the rest is decoded to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from PIL import Image

from app.estimation.upload import Upload, UploadDecoder, UploadError
from app.scheduling.job import Job
from app.vision.geometry import Box
from app.vision.optics import Optics
from tests.conftest import png

DECODER = UploadDecoder(max_pixels=40_000, max_persons=2)


def frame(height: int = 120, width: int = 160) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)


def mask_of(*boxes: tuple[slice, slice], labels: bool = False) -> bytes:
    mask = np.zeros((120, 160), np.uint8)
    for label, box in enumerate(boxes, start=1):
        mask[box] = label if labels else 1
    return png(mask)


TALL = np.s_[20:100, 10:40], np.s_[20:100, 90:120]
"""Two figures apart from one another."""


@pytest.mark.parametrize(
    ("fields", "field", "said"),
    [
        ({}, "frame", "expected an image file"),
        ({"mask": b"m", "boxes": []}, "boxes", "expected a mask or boxes, got both"),
        ({"mask": b"m", "background": b"b"}, "background", "expected a mask or background"),
        ({"frame": b"f", "boxes": [(1, 2, 30, 40)]}, "boxes", "expected a list of app.Box"),
        ({"frame": b"f", "boxes": Box(0, 0, 9, 9)}, "boxes", "expected a list of app.Box"),
        ({"frame": b"f", "boxes": [Box(0, 0, 9, 9)], "track_ids": "a"}, "track_ids", "a list of"),
        ({"frame": b"f", "optics": {"fov_deg": 60}}, "optics", "app.Optics, got a dict"),
        ({"frame": b"f", "track_ids": ["a"]}, "track_ids", "got 1 and no boxes"),
        ({"frame": b"f", "boxes": [Box(0, 0, 9, 9)] * 2, "track_ids": ["a", "a"]},
         "track_ids", "'a' twice"),
    ],
)  # fmt: skip
def test_contradicting_fields_are_refused(fields: dict[str, Any], field: str, said: str) -> None:
    with pytest.raises(UploadError, match=said) as error:
        Upload(**fields)
    assert (error.value.field, error.value.reason) == (field, "misfit")


BGR = frame()
TWO = np.zeros((120, 160), np.uint8)
TWO[TALL[0]], TWO[TALL[1]] = 1, 2


@pytest.mark.parametrize("given", [TWO / 2, TWO[None], BGR, "mask.png", TWO.tolist()])
def test_masks_of_other_kinds_are_refused(given: Any) -> None:
    with pytest.raises(UploadError, match=r"mask: .* shape \(H, W\) and dtype uint8, uint16 or"):
        Upload(png(BGR), mask=given)


def test_arrays_answer_as_files() -> None:
    written = DECODER.decode(Upload(png(BGR), background=png(BGR[::-1].copy())), Job())
    given = DECODER.decode(Upload(np.asfortranarray(BGR), background=BGR[::-1]), Job())
    assert_array_equal(given.frame, written.frame)
    assert_array_equal(given.background, written.background)
    for labels in (TWO, TWO.astype(np.int64), TWO.astype(np.uint32)):
        decoded = DECODER.decode(Upload(BGR, mask=labels), Job()).mask
        assert decoded is not None and decoded.present == [1, 2]
        assert_array_equal(decoded.labels, TWO)
    one = DECODER.decode(Upload(mask=TWO == 1), Job()).mask
    assert one is not None and one.present == [1]


@pytest.mark.parametrize(
    ("fields", "reason", "said"),
    [
        ({"mask": -TWO.astype(np.int32)}, "undecodable", "from 0 to 65535, got -2 to 0"),
        ({"frame": BGR, "mask": TWO[:60]}, "misfit", "160x120 pixels like the frame"),
    ],
)
def test_arrays_are_checked_like_files(fields: dict[str, Any], reason: str, said: str) -> None:
    with pytest.raises(UploadError, match=said) as error:
        DECODER.decode(Upload(**fields), Job())
    assert error.value.reason == reason


@pytest.mark.parametrize(
    ("fields", "field", "reason"),
    [
        ({"frame": b"no image"}, "frame", "undecodable"),
        ({"frame": png(frame(400, 400))}, "frame", "too_large"),
        ({"frame": png(frame(60, 60)), "mask": mask_of(TALL[0])}, "mask", "misfit"),
        ({"frame": png(frame()), "background": png(frame(60, 60))}, "background", "misfit"),
        ({"frame": png(frame()), "boxes": [Box(500, 0, 9, 9)]}, "boxes", "misfit"),
        ({"frame": png(frame()), "boxes": [Box(0, 0, 9, 9)] * 3}, "boxes", "misfit"),
        ({"frame": png(frame()), "boxes": [Box(9, 9, 9, 0.004)]}, "boxes", "misfit"),
        ({"frame": png(frame()), "boxes": [Box(159.495, 9, 9, 9)]}, "boxes", "misfit"),
        ({"mask": mask_of(*TALL)}, "mask", "misfit"),
        ({"mask": mask_of(*TALL, np.s_[0:13, 0:9], labels=True)}, "mask", "misfit"),
    ],
)
def test_unusable_images_and_boxes_are_refused(
    fields: dict[str, Any], field: str, reason: str
) -> None:
    with pytest.raises(UploadError) as error:
        DECODER.decode(Upload(**fields), Job())
    assert (error.value.field, error.value.reason) == (field, reason)


def test_images_are_decoded_and_boxes_clipped() -> None:
    picture = frame()
    boxes, background = [Box(-20, -20, 60, 60)], png(picture[::-1])
    upload = Upload(png(picture), background=background, boxes=boxes)
    assert upload.given == ("frame", "background", "boxes")
    decoded = DECODER.decode(upload, Job())
    assert_array_equal(decoded.frame, picture)
    assert_array_equal(decoded.background, picture[::-1])
    assert decoded.boxes is not None and decoded.boxes[0].x == -0.5
    assert_array_equal(DECODER.decode(Upload(picture), Job()).frame, picture)


def test_people_may_cover_the_largest_frame_four_times() -> None:
    many = UploadDecoder(max_pixels=160 * 120, max_persons=9)
    picture, whole = png(frame()), Box(-0.5, -0.5, 160, 120)
    assert many.decode(Upload(picture, boxes=[whole] * 4), Job()).boxes == [whole] * 4
    # Each label reaches every border.
    steps = np.add.outer(np.arange(120) // 8, np.arange(160) // 8) % 10
    crossing = png(np.where(steps % 2, steps // 2 + 1, 0).astype(np.uint8))
    for fields in ({"frame": picture, "boxes": [whole] * 5}, {"mask": crossing}):
        with pytest.raises(UploadError, match="at most 76800 pixels, got 96000"):
            many.decode(Upload(**fields), Job())


@pytest.mark.parametrize("quarters", [0, 1, 2, 3, 4])
def test_quarter_turns_are_exact(quarters: int) -> None:
    picture, box = frame(), Box(9.5, 19.5, 30, 50)
    labels = np.zeros(picture.shape[:2], np.uint8)
    labels[20:70, 10:40] = 1
    optics = Optics(roll_deg=-90 * quarters)
    decoded = DECODER.decode(Upload(picture, boxes=[box], optics=optics), Job())
    assert_array_equal(decoded.frame, np.rot90(picture, quarters))
    assert_array_equal(decoded.sent, picture)
    mask = DECODER.decode(Upload(mask=png(labels), optics=optics), Job()).mask
    assert mask is not None and decoded.boxes is not None
    assert_array_equal(mask.labels, np.rot90(labels, quarters))
    assert vars(decoded.boxes[0]) == pytest.approx(vars(mask.boxes[0]))


def test_rectified_frames_and_boxes_stay_within_the_limits() -> None:
    """Pixels of a quarter of their height make four of each."""
    with pytest.raises(UploadError, match="square and upright, got 400x480") as error:
        DECODER.decode(Upload(frame(120, 400), optics=Optics(pixel_aspect=0.25)), Job())
    assert (error.value.field, error.value.reason) == ("frame", "too_large")
    boxes = [Box(-0.5, -0.5, 160, 120)] * 3
    many = UploadDecoder(max_pixels=80_000, max_persons=15)
    with pytest.raises(UploadError, match="boxes: expected people whose boxes"):
        many.decode(Upload(frame(), boxes=boxes * 2, optics=Optics(pixel_aspect=0.25)), Job())


@pytest.mark.parametrize(
    "given",
    [
        str(__file__), Path(__file__), bytearray(b"x"), Image.fromarray(BGR), BGR.tolist(),
        BGR / 255, BGR.astype(np.float32), BGR[..., 0], BGR[..., :1], np.dstack([BGR, BGR[..., 0]]),
        BGR.transpose(2, 0, 1), BGR[None], BGR > 99, BGR.astype(np.int64), BGR.astype(np.uint16),
        BGR[:0], np.array(None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("field", ["frame", "background"])
def test_what_other_libraries_give_is_refused(field: str, given: Any) -> None:
    expected = f"{field}: expected the bytes of an image file or a NumPy array of shape .H, W, 3."
    with pytest.raises(UploadError, match=expected) as error:
        Upload(**{"frame": png(BGR), field: given})
    kind = f"a {type(given).__name__}"
    if isinstance(given, np.ndarray):
        kind += f" of shape {given.shape} and dtype {given.dtype}"
    assert str(error.value).endswith(f"got {kind}")
