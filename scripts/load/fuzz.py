"""Upload mutated images to a server, which must neither crash, hang nor leak memory.

python -m scripts.load.fuzz [--index index/data] [--uploads 100000] [--write]
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from index.artefact import load_index
from index.store import PoseIndex
from scripts.load.client import Call, Client
from scripts.load.scenes import encode, street
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

CLIENTS = 2
SHAPES = (
    (1, 1), (1, 1000), (1000, 1), (3, 4000), (4000, 3), (1, 1_000_000), (1_000_000, 1),
    (12, 1_000_000), (1_000_000, 12), (200, 60_000), (60_000, 200), (3535, 3535), (7000, 1750),
)  # fmt: skip
"""Rows and columns of images that are thin, huge or odd; the service takes 12.5 megapixels."""

SHAPED = 0.002
"""Share of the uploads that are of these shapes."""

SLOWEST_MS = 2000.0
MOST_MB = 600.0


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
    ]
    masks = [
        encode(".png", mask),
        encode(".png", mask, cv2.IMWRITE_PNG_BILEVEL, 1),
        encode(".png", mask.astype(np.uint16) * 300),
        encode(".jpg", mask * 255),
        encode(".webp", mask * 255, cv2.IMWRITE_WEBP_QUALITY, 101),
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


class Fuzz:
    """Clients in threads that share a count of uploads."""

    def __init__(self, server: ServerProcess, index: PoseIndex, uploads: int) -> None:
        self._server = server
        self._frames, self._masks = seeds(index)
        self._shaped = shaped(np.random.default_rng(0))
        self._numbers = iter(range(uploads))
        self._lock = threading.Lock()
        self.statuses: Counter[int] = Counter()
        self.broken: Counter[str] = Counter()
        self.latencies: list[float] = []

    def run(self) -> None:
        """Send everything, or stop when the server is gone."""
        with ThreadPoolExecutor(CLIENTS) as threads:
            list(threads.map(self._client, range(CLIENTS)))

    def _call(self, rng: np.random.Generator) -> Call:
        if rng.random() < SHAPED:
            return self._shaped_call(rng)
        frame = self._frames[rng.integers(len(self._frames))]
        if rng.random() < 0.7:
            # Boxes that name nobody: what is tried is the decoder, not the search for people.
            return Call("POST", "/pose", {"frame": mutate(frame, rng), "boxes": b"[]"})
        mask = mutate(self._masks[rng.integers(len(self._masks))], rng)
        return Call("POST", "/pose?n=1", {"frame": self._frames[2], "mask": mask})

    def _shaped_call(self, rng: np.random.Generator) -> Call:
        parts = self._shaped[rng.integers(len(self._shaped))]
        if rng.random() < 0.2:
            parts = {name: mutate(data, rng) for name, data in parts.items()}
        frame, mask = parts["frame"], parts["mask"]
        forms = (
            {"frame": frame},
            {"mask": mask},
            {"frame": frame, "mask": mask},
            {"frame": frame, "background": frame},
            {"frame": frame, "boxes": b"[[0, 0, 1000000, 1000000], [0, 0, 1, 1]]"},
        )
        return Call("POST", "/pose", forms[rng.integers(len(forms))])

    def _client(self, number: int) -> None:
        rng = np.random.default_rng(1000 + number)
        client = Client(self._server.url, timeout_s=30)
        for _ in self._numbers:
            if not self._server.alive():
                return
            call = self._call(rng)
            started = time.perf_counter()
            try:
                status, _ = client.send(call)
            except Exception as error:  # Whatever it is, it is counted and shown.
                with self._lock:
                    self.broken[type(error).__name__] += 1
                continue
            with self._lock:
                self.latencies.append((time.perf_counter() - started) * 1000)
                self.statuses[status] += 1


def report(fuzz: Fuzz, server: ServerProcess, seconds: float) -> tuple[str, list[str]]:
    """Return the section in Markdown and what has failed."""
    peak = server.memory_mb("VmHWM")
    slowest = max(fuzz.latencies)
    faults = {status: n for status, n in fuzz.statuses.items() if status >= 500}
    criteria = {
        f"5xx: {faults}": not faults,
        f"broken connections: {dict(fuzz.broken)}": not fuzz.broken,
        f"the slowest answer took {slowest:.0f} ms": slowest <= SLOWEST_MS,
        f"memory reached {peak:.0f} MB": peak <= MOST_MB,
    }
    failed = [what for what, met in criteria.items() if not met]
    answers = ", ".join(f"{n} x {status}" for status, n in sorted(fuzz.statuses.items()))
    uploads = sum(fuzz.statuses.values())
    body = f"""`python -m scripts.load.fuzz --uploads {uploads}`, revision {revision()}.
{machine()}; {CLIENTS} clients on the same machine, {seconds:.0f} s.
Mutated JPEG, PNG and WebP: as `frame` (70 %) and as `mask` (30 %). {100 * SHAPED:g} % are images of
1x1 to 1,000,000x12 and 3535x3535 pixels, most of them sound, in every kind of upload.

| answers | {answers} |
|---|---|
| broken connections | {sum(fuzz.broken.values())} |
| latency, median / p99 / slowest | {percentile(fuzz.latencies, 50):.1f} / \
{percentile(fuzz.latencies, 99):.1f} / {slowest:.0f} ms |
| resident memory at the most | {peak:.0f} MB |

The server ended with status {server.stop()}."""
    return body, failed


def main() -> int:
    """Command line; 1 where a criterion fails."""
    parser = measurement_parser("Fuzz the uploads of a real server.")
    parser.add_argument("--uploads", type=int, default=100_000)
    options = parser.parse_args()
    with ServerProcess(options.index, log=Path("/tmp/fuzz-server.log")) as server:
        server.wait_until_ready()
        fuzz = Fuzz(server, load_index(options.index), options.uploads)
        started = time.perf_counter()
        fuzz.run()
        seconds = time.perf_counter() - started
        if not server.alive():
            print("fuzz: the server has died", file=sys.stderr)
            return 1
        body, failed = report(fuzz, server, seconds)
    return conclude("Fuzzed uploads", body, failed, write=options.write)


if __name__ == "__main__":
    sys.exit(main())
