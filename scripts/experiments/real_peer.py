"""MediaPipe Pose beside the service: the same images, by an interpreter of its own."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from app.vision.people import Box

SCRIPT = Path(__file__).resolve().parent.parent / "mediapipe_peer.py"
ROOM = 0.25
"""Room left about a true box, in shares of its height: MediaPipe looks for a person first."""


@dataclass(frozen=True)
class PeerAnswer:
    """What MediaPipe says of one image.

    Parameters
    ----------
    milliseconds : float
    mask : (h, w) bool array or None
        None, as are the others, where it finds nobody.
    points_2d : (12, 2) float64 array or None
        Pixels of the image; rows are :data:`index.skeleton.LIMBS`.
    points_3d : (12, 3) float64 array or None
        Camera axes, metres, origin between the hips.
    """

    milliseconds: float
    mask: NDArray[np.bool_] | None
    points_2d: NDArray[np.float64] | None
    points_3d: NDArray[np.float64] | None


def why_absent(python: Path | None) -> str:
    """One sentence on why there is no peer to compare with; empty where there is one."""
    if python is None:
        return "no interpreter was named (`--mediapipe PYTHON`)"
    command = [str(python), "-c", "import mediapipe; print(mediapipe.__version__)"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        return f"{python} cannot be run ({error.strerror})"
    version = result.stdout.strip().rsplit("\n", 1)[-1]
    if result.returncode or version != "0.10.21":
        return f"{python} has no mediapipe 0.10.21"
    return ""


def ask(python: Path, images: Mapping[str, NDArray[np.uint8]]) -> dict[str, PeerAnswer]:
    """Ask MediaPipe about images ``(h, w, 3)``, BGR, by name."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "images.npz"), Path(folder, "answers.npz")
        np.savez(source, **dict(images))  # type: ignore[arg-type]
        command = [str(python), str(SCRIPT), str(source), str(target)]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            raise ValueError(f"MediaPipe failed: {result.stderr.strip()[-500:]}")
        with np.load(target, allow_pickle=False) as answers:
            return {name: _answer(answers, name) for name in images}


class LivePeer:
    """MediaPipe in a process that looks at one image as often as it is asked.

    Parameters
    ----------
    python : Path
    image : (h, w, 3) uint8 array
        BGR.
    """

    def __init__(self, python: Path, image: NDArray[np.uint8]) -> None:
        self._python = python
        self._image = image

    def __enter__(self) -> LivePeer:
        """Start it, and wait until it has set its networks up."""
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, "image.npy")
            np.save(source, self._image)
            self._process = subprocess.Popen(
                [str(self._python), str(SCRIPT), "--again", str(source)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                text=True, bufsize=1,
            )  # fmt: skip
            try:
                self._expect("ready")
            except RuntimeError:
                self._stop()
                raise
        return self

    def ask(self) -> bool:
        """Return whether somebody is found, once the image was looked at again."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        return self._expect("0", "1") == "1"

    def _expect(self, *answers: str) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline().strip()
        if line not in answers:
            raise RuntimeError(f"expected MediaPipe to say {' or '.join(answers)}, got {line!r}")
        return line

    def _stop(self) -> None:
        # Its input ends here, which ends it.
        self._process.communicate()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it."""
        self._stop()


def _answer(answers: Mapping[str, NDArray[np.generic]], name: str) -> PeerAnswer:
    milliseconds = float(answers[f"{name}/milliseconds"])
    if not bool(answers[f"{name}/found"]):
        return PeerAnswer(milliseconds, None, None, None)
    return PeerAnswer(
        milliseconds,
        np.asarray(answers[f"{name}/mask"], bool),
        np.asarray(answers[f"{name}/points_2d"], np.float64),
        np.asarray(answers[f"{name}/points_3d"], np.float64),
    )


def room_about(box: Box, frame_shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Columns and rows ``(left, top, right, bottom)`` of a box with room, inside the frame."""
    room = ROOM * box.height
    roomy = Box(box.x - room, box.y - room, box.width + 2 * room, box.height + 2 * room)
    left, top, right, bottom = roomy.pixels()
    return max(0, left), max(0, top), min(frame_shape[1], right), min(frame_shape[0], bottom)
