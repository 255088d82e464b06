"""Upload mutated images to a server, which must neither crash, hang nor leak memory."""

from collections.abc import Iterator
from functools import partial

import cv2
import numpy as np

from index.store import PoseIndex
from scripts.load.client import Call, Client, Request, closed_loop
from scripts.load.expensive import expensive
from scripts.load.scenes import encode, street
from scripts.load.server import Criteria, Figures, ServerProcess, run, spread

CLIENTS = 2
SHAPES = (
    (1, 1), (1, 1000), (1000, 1), (3, 4000), (4000, 3), (1, 1_000_000), (1_000_000, 1),
    (12, 1_000_000), (1_000_000, 12), (200, 60_000), (60_000, 200), (3535, 3535), (7000, 1750),
)  # fmt: skip
"""Rows and columns of images that are thin, huge or odd; the service takes 12.5 megapixels."""

SHAPED = 0.002
"""Share of the uploads with these shapes."""

EXPENSIVE = 0.005
"""Share of the uploads that are valid, small and expensive, and not damaged."""

FORMS = ("none", "rle", "polygon")
"""Of the silhouettes in the answers."""

MAX_MS = 2000.0
MAX_MEMORY_MB = 600.0
MAX_DECODER_MEMORY_MB = 500.0
"""Of each process that decodes WebP, TIFF, GIF or BMP."""


def seeds(index: PoseIndex) -> tuple[list[bytes], list[bytes]]:
    """Return sound frames and masks to mutate: several formats, sizes and flavours."""
    frame, mask = street(index, width=128, height=160, person_px=128)
    frames = [
        encode(".jpg", frame),
        encode(".jpg", frame, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        encode(".png", frame),
        encode(".png", frame[:, :, 0]),
        encode(".webp", frame, cv2.IMWRITE_WEBP_QUALITY, 80),
        encode(".webp", frame, cv2.IMWRITE_WEBP_QUALITY, 101),
        _with_exif_orientation(encode(".jpg", frame)),
        *(encode(extension, frame) for extension in (".gif", ".tiff", ".bmp")),
        encode(
            ".tiff",
            frame,
            *(cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_JPEG),
            *(cv2.IMWRITE_TIFF_ROWSPERSTRIP, 16),
        ),
    ]
    rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
    masks = [
        encode(".png", mask),
        encode(".png", mask * (columns // 32 + 1).astype(np.uint8)),
        encode(".png", ((rows + columns) % 50 + 1).astype(np.uint8)),
        encode(".png", mask, cv2.IMWRITE_PNG_BILEVEL, 1),
        encode(".png", mask.astype(np.uint16) * 300),
        encode(".jpg", mask * 255),
        encode(".webp", mask * 255, cv2.IMWRITE_WEBP_QUALITY, 101),
        *(encode(extension, mask) for extension in (".tiff", ".bmp")),
    ]
    return frames, masks


def shaped(rng: np.random.Generator) -> list[dict[str, bytes]]:
    """Return images of each of :data:`SHAPES`: a frame of blotches, a mask of six people in it."""
    found = []
    for rows, columns in SHAPES:
        coarse = rng.integers(0, 256, (min(rows, 40), min(columns, 40), 3), np.uint8)
        frame = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_NEAREST)
        mask = cv2.resize(coarse[:, :, 0] % 7, (columns, rows), interpolation=cv2.INTER_NEAREST)
        # JPEG ends at 65,535 pixels each way.
        extension = ".jpg" if max(rows, columns) < 65_000 else ".png"
        found.append({"frame": encode(extension, frame), "mask": encode(".png", mask)})
    return found


def _with_exif_orientation(jpeg: bytes) -> bytes:
    tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    segment = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + jpeg[2:]


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage an image in random places, half of them in its header."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        if not out:
            break
        reach = min(len(out), 64) if rng.random() < 0.5 else len(out)
        at = int(rng.integers(reach))
        size = int(rng.integers(1, 9))
        match rng.integers(7):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at : at + size] = rng.bytes(size)
            case 2:
                out[at : at + size] = bytes([rng.choice([0, 0x7F, 0x80, 0xFF])]) * size
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = rng.bytes(size)
            case 5:
                out[at:at] = out[at : at + 16 * size]
            case 6:
                del out[len(out) - int(rng.integers(len(out))) :]
    return bytes(out)


class Uploads:
    """Makes the uploads of all clients, until a number of them is sent or the server is gone."""

    def __init__(self, server: ServerProcess, index: PoseIndex, count: int) -> None:
        self._server = server
        self._frames, self._masks = seeds(index)
        self._shaped = shaped(np.random.default_rng(0))
        self._expensive = [*expensive().values()]
        self._numbers = iter(range(count))

    def requests(self, client: int) -> Iterator[Request]:
        """Yield the uploads of one client."""
        rng = np.random.default_rng(1000 + client)
        for number in self._numbers:
            if not self._server.alive():
                return
            form, parts = rng.choice(FORMS), self._parts(rng)
            path = f"/pose?silhouettes={form}" + "&n=1" * ("mask" in parts)
            if rng.random() < EXPENSIVE:
                path, parts = self._expensive_call(rng)
            yield Request(Call("POST", path, parts), number=number)

    def _expensive_call(self, rng: np.random.Generator) -> tuple[str, dict[str, bytes]]:
        """An expensive image wherever images are decoded; without a box no people are searched."""
        image, sound = self._expensive[rng.integers(len(self._expensive))], self._frames[2]
        calls = (
            ("/pose", {"frame": image, "boxes": b"[]"}),
            ("/pose/overlay", {"frame": image, "boxes": b"[]"}),
            ("/cameras/expensive/frames", {"frame": image, "boxes": b"[]"}),
            ("/pose?n=1", {"mask": image}),
            ("/pose?n=1", {"frame": sound, "background": image}),
            ("/v1/vision/detection", {"image": image}),
        )
        return calls[rng.integers(len(calls))]

    def _parts(self, rng: np.random.Generator) -> dict[str, bytes]:
        def one_of(images: list[bytes]) -> bytes:
            return images[rng.integers(len(images))]

        if rng.random() < SHAPED:
            frame, mask = self._shaped[rng.integers(len(self._shaped))].values()
            boxes = b"[[0, 0, 1000000, 1000000], [0, 0, 1, 1]]"
            forms = (
                {"frame": frame},
                {"mask": mask},
                {"frame": frame, "mask": mask},
                {"frame": frame, "background": frame},
                {"frame": frame, "boxes": boxes},
            )
            return forms[rng.integers(len(forms))]
        if rng.random() < 0.7:
            # Without a box the decoder is tried, not the search for people.
            return {"frame": mutate(one_of(self._frames), rng), "boxes": b"[]"}
        return {"frame": self._frames[2], "mask": mutate(one_of(self._masks), rng)}


def measure(server: ServerProcess, index: PoseIndex, count: int) -> tuple[Figures, Criteria]:
    """Fuzz a server."""
    uploads = Uploads(server, index, count)
    clients = [(Client(server.url), uploads.requests(number)) for number in range(CLIENTS)]
    tally = closed_loop(clients)
    if not server.alive():
        raise ValueError("the server has died")
    slowest = max((answer.ms for answer in tally.answers), default=0.0)
    faults = {status: n for status, n in tally.statuses().items() if int(status) >= 500}
    memory_mb = server.memory_mb("VmHWM")
    decoder_mb = max(server.memory_of_children_mb("VmHWM"), default=0.0)
    found = {
        "clients": CLIENTS,
        "seconds": tally.seconds,
        "uploads": count,
        "shaped_percent": 100 * SHAPED,
        "expensive_percent": 100 * EXPENSIVE,
        "answers": tally.statuses(),
        "broken": len(tally.broken),
        "latency_ms": spread([answer.ms for answer in tally.answers]),
        "max_memory_mb": memory_mb,
        "max_memory_wanted_mb": MAX_MEMORY_MB,
        "max_decoder_memory_mb": decoder_mb,
        "exit_status": server.stop(),
    }
    return found, {
        f"5xx: {faults}": not faults,
        f"broken connections: {tally.broken}": not tally.broken,
        f"the slowest answer took {slowest:.0f} ms": slowest <= MAX_MS,
        f"memory reached {memory_mb:.0f} MB": memory_mb <= MAX_MEMORY_MB,
        f"a decoder's memory reached {decoder_mb:.0f} MB": decoder_mb <= MAX_DECODER_MEMORY_MB,
    }


main = partial(run, measure, "fuzz", "uploads", 100_000)
