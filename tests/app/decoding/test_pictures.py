"""Pictures decoded in processes of their own: the same as in this one, within limits."""

import io
import os
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from app.decoding.pictures import Allowance, Workers
from app.vision.images import ImageError, ImageTooLargeError, decode_image, is_expensive
from app.vision.masks import decode_mask
from tests.app.vision.encoded import encode, quadrants, tiff
from tests.support.expensive import gif, tiff_circle, tiff_tags, tiff_tile, webp_animation

MAX_PIXELS = 12_500_000


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    made = Workers(1, 2**24, MAX_PIXELS)
    yield made
    made.close()


def decode(
    workers: Workers, data: bytes, *, is_mask: bool = False, seconds: float = 20.0,
    max_pixels: int = MAX_PIXELS, checkpoint: Callable[[], None] = lambda: None,
) -> tuple[np.ndarray, tuple[str, ...]]:  # fmt: skip
    allowance = Allowance()
    allowance.seconds = seconds
    return workers.decode(
        data, is_mask=is_mask, max_pixels=max_pixels, allowance=allowance, checkpoint=checkpoint
    )


def process_of(workers: Workers) -> int:
    (worker,) = workers._idle
    return worker._program.pid


def saved(form: str, image: np.ndarray, **options: Any) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, form, **options)
    return buffer.getvalue()


@cache
def sound() -> dict[str, bytes]:
    """Files of all kinds, since what a confined process imports too late makes it fail."""
    rgb = quadrants()[..., ::-1]
    rgba = np.dstack([rgb, np.full(rgb.shape[:2], 200, np.uint8)])
    deep = (quadrants().astype(np.uint16) * 3)[..., 0]
    labels = np.zeros((80, 120), np.uint8)
    labels[20:60, 20:40], labels[20:60, 70:90] = 1, 2
    forms = {"GIF": {}, "BMP": {}, "TIFF": {}, "WEBP": {"lossless": True}}
    found = {form: saved(form, rgb, **options) for form, options in forms.items()}
    found |= {f"{form}, labels": saved(form, labels, **forms[form]) for form in forms}
    found |= {f"{form}, alpha": saved(form, rgba, **forms[form]) for form in ("TIFF", "WEBP")}
    for packed in ("tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg", "lzma", "zstd"):
        found[packed] = saved("TIFF", rgb, compression=packed)
    return found | {
        "lossy": saved("WEBP", rgb, quality=80),
        "bits": saved("TIFF", labels > 0, compression="group4"),
        "few bits": tiff(bytes(range(256)) * 5, 64, 40, bits=4),
        "16 bits": encode(deep, ".tiff"),
        "colours": saved("TIFF", np.dstack([rgba]), compression="tiff_lzw"),
        "animation": saved("WEBP", rgb, save_all=True, append_images=[Image.fromarray(rgb[::-1])]),
        "pictures": gif(3),
        "a circle": tiff_circle(),
        "broken": saved("TIFF", rgb)[:100],
        "cut off": saved("TIFF", rgb)[:-2000],
    }


@pytest.mark.parametrize("kind", sound())
def test_files_give_what_they_give_in_this_process(workers: Workers, kind: str) -> None:
    data = sound()[kind]
    assert is_expensive(data)
    for is_mask in (False, True):
        try:
            expected: Any = (decode_mask if is_mask else decode_image)(data, max_pixels=MAX_PIXELS)
        except ImageError as error:
            with pytest.raises(type(error)) as caught:
                decode(workers, data, is_mask=is_mask)
            assert str(caught.value) == str(error)
            continue
        values, warnings = decode(workers, data, is_mask=is_mask)
        assert_array_equal(values, expected.labels if is_mask else expected.pixels)
        assert values.dtype == (expected.labels if is_mask else expected.pixels).dtype
        assert warnings == (() if is_mask else expected.warnings)


def test_sizes_are_checked(workers: Workers) -> None:
    for data in (saved("WEBP", quadrants()), saved("BMP", quadrants()), webp_animation(1)):
        with pytest.raises(ImageTooLargeError, match="at most 2399 pixels"):
            decode(workers, data, max_pixels=2399)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="needs Linux")
@pytest.mark.parametrize(
    "make",
    [lambda: tiff_tile(6000), tiff_tags, lambda: gif(1, (65_000, 65_000))],
    ids=["tile", "tags", "picture"],
)
def test_memory_is_bounded_by_the_pixels(workers: Workers, make: Callable[[], bytes]) -> None:
    data = make()
    decode(workers, saved("BMP", quadrants()))
    process = process_of(workers)
    status = Path(f"/proc/{process}/status")

    def memory_mb(what: str) -> int:
        lines = status.read_text().splitlines()
        return next(int(line.split()[1]) // 1024 for line in lines if line.startswith(what))

    before = memory_mb("VmRSS")
    Path(f"/proc/{process}/clear_refs").write_text("5")
    with pytest.raises(ImageError):
        decode(workers, data)
    assert process_of(workers) == process
    assert memory_mb("VmHWM") - before < 60


def test_time_is_bounded_and_the_next_picture_decoded(workers: Workers) -> None:
    large = saved("WEBP", np.zeros((3500, 3500, 3), np.uint8), lossless=True, method=0)
    with pytest.raises(
        ImageError, match=r"takes at most 2.0 s to decode, got one that takes longer"
    ):
        decode(workers, large, seconds=0.02)
    assert decode(workers, saved("BMP", quadrants()))[0].shape == (40, 60, 3)


class GoneError(Exception):
    pass


def test_a_late_process_is_ended(workers: Workers) -> None:
    decode(workers, saved("BMP", quadrants()))
    process = process_of(workers)
    large = saved("WEBP", np.zeros((3500, 3500, 3), np.uint8), lossless=True, method=0)
    os.kill(process, 19)  # It hangs.
    until = time.monotonic() + 0.2

    def checkpoint() -> None:
        if time.monotonic() > until:
            raise GoneError

    with pytest.raises(GoneError):
        decode(workers, large, checkpoint=checkpoint)
    assert not Path(f"/proc/{process}").exists()
    assert decode(workers, saved("BMP", quadrants()))[0].shape == (40, 60, 3)


def test_a_process_that_starts_late_is_there_for_the_next_picture() -> None:
    workers, data = Workers(1, 2**24, MAX_PIXELS), saved("BMP", quadrants())

    def checkpoint() -> None:
        raise GoneError

    with pytest.raises(GoneError):
        decode(workers, data, checkpoint=checkpoint)
    process = process_of(workers)
    assert decode(workers, data)[0].shape == (40, 60, 3)
    assert process_of(workers) == process
    workers.close()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_the_process_is_confined(workers: Workers) -> None:
    decode(workers, saved("BMP", quadrants()))
    process = Path(f"/proc/{process_of(workers)}")
    status = (process / "status").read_text()
    assert "\nSeccomp:\t2\n" in status and "\nNoNewPrivs:\t1\n" in status
    assert "\nThreads:\t1\n" in status
    limits = {line[:26].strip(): line[26:].split()[:2] for line in (process / "limits").open()}
    assert limits["Max open files"] == limits["Max file size"] == ["0", "0"]
    assert int(limits["Max data size"][0]) < 150 * 2**20


def test_a_program_that_does_not_start_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    workers = Workers(1, 2**24, MAX_PIXELS)
    with pytest.raises(RuntimeError, match="does not start"):
        decode(workers, saved("BMP", quadrants()))
