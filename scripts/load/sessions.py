"""Cameras at once, each with a session of its own: identities, order, memory, the limit.

python -m scripts.load.sessions --video ../shared/real/vtest/vtest.avi [--cameras 8] [--write]

Each camera shows another part of the video. It is followed alone first, then beside the others:
the people must be the same, each with one identity. A few boxes may differ, since OpenCV's
background model samples at random.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from app.vision.people import Box
from scripts.load.client import Call, Client
from scripts.load.scenes import encode
from scripts.load.server import ServerProcess
from scripts.results import conclude, machine, measurement_parser, percentile, revision

FRAMES_PER_S = 10.0
MOST_GROWTH = 0.03
"""Of resident memory, from the second round to the last."""

SAME_PERSON_IOU = 0.5
LEAST_FOUND = 0.8
"""Share of the people found alone that have to be found beside others as well: with itself, a
camera that is followed alone again shares 90 to 100 %."""


@dataclass
class Followed:
    """What the service told of a camera's frames."""

    frames: list[dict[str, Any]] = field(default_factory=list)
    sessions: list[str] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    milliseconds: list[float] = field(default_factory=list)


def encoded_frames(video: Path) -> list[bytes]:
    """Frames as a camera sends them, JPEG at quality 90."""
    capture, frames = cv2.VideoCapture(str(video)), []
    while (read := capture.read())[0]:
        frames.append(encode(".jpg", read[1], cv2.IMWRITE_JPEG_QUALITY, 90))
    return frames


def follow(url: str, camera: str, frames: Sequence[bytes]) -> Followed:
    """Send a camera's frames one after the other; who is refused asks again a little later."""
    client, told = Client(url), Followed()
    for number, frame in enumerate(frames):
        status, later = 503, 0.0
        while status == 503:
            # A frame that was begun and not finished in time counts: sent again, it is a later one.
            timestamp = f"{number / FRAMES_PER_S + later:.4f}".encode()
            parts = {"frame": frame, "timestamp": timestamp}
            call = Call("POST", f"/cameras/{camera}/frames", parts)
            later = min(later + 1e-4, 0.5 / FRAMES_PER_S)
            started = time.perf_counter()
            status, headers, body = client.exchange(call)
            told.answers["200" if status == 200 else _problem(status, body)] += 1
            if status == 503:
                time.sleep(0.05)
        told.milliseconds.append((time.perf_counter() - started) * 1000)
        told.sessions.append(headers["X-Session"])
        told.frames.append(json.loads(body) if status == 200 else {})
    client.close()
    return told


def _problem(status: int, body: bytes) -> str:
    beginning = " ".join(json.loads(body)["detail"].split()[:5])
    return f"{status} ({beginning} ...)"


def follow_all(url: str, parts: Sequence[Sequence[bytes]], name: str) -> list[Followed]:
    """Follow all cameras at once."""
    with ThreadPoolExecutor(len(parts)) as threads:
        return list(threads.map(lambda k: follow(url, f"{name}-{k}", parts[k]), range(len(parts))))


def differences(told: Followed, alone: Followed) -> list[str]:
    """What a camera beside others was told that it was not told alone."""
    failed = []
    identities: Counter[tuple[int, int]] = Counter()
    people, last = 0, -1
    for number, (frame, expected) in enumerate(zip(told.frames, alone.frames, strict=True)):
        if not frame or frame["frame_index"] <= last:
            failed.append(f"frame {number} was not answered, or not after the one before")
            continue
        last = frame["frame_index"]
        people += len(expected["persons"])
        identities.update(
            (person["track_id"], other["track_id"])
            for person in frame["persons"]
            for other in expected["persons"]
            if _box(person).iou(_box(other)) >= SAME_PERSON_IOU
        )
    # Each identity with the one it shares most frames with; what is left over was mixed up.
    kept: dict[int, int] = {}
    for (own, other), _ in identities.most_common():
        if own not in kept and other not in kept.values():
            kept[own] = other
    found = sum(identities[pair] for pair in kept.items())
    if found < LEAST_FOUND * people:
        failed.append(f"only {found} of {people} people are those found alone")
    return failed


def _box(person: dict[str, Any]) -> Box:
    box = person["box"]
    return Box(box["x"], box["y"], box["width"], box["height"])


def past_the_limit(url: str, frames: Sequence[bytes], cameras: int) -> list[str]:
    """One camera more than there is room for: the least recently used starts afresh."""
    failed = []
    again = follow(url, f"round0-{cameras}", frames[:1])
    if again.sessions != ["new"]:
        failed.append(f"a new camera was told {again.sessions}")
    # round0-0 was the first of those that are held to be used.
    dropped = follow(url, "round0-0", frames[:1])
    if dropped.sessions != ["new"] or dropped.frames[0]["frame_index"] != 0:
        failed.append(f"the dropped camera was told {dropped.sessions}")
    return failed


def main() -> int:
    """Command line; 1 where a criterion fails."""
    parser = measurement_parser("Follow several cameras at once on a real server.")
    parser.add_argument("--video", type=Path, required=True)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--frames", type=int, default=60, help="of each camera, in a round")
    parser.add_argument("--rounds", type=int, default=3, help="each on sessions of its own")
    options = parser.parse_args()
    count, length = options.cameras, options.frames
    frames = encoded_frames(options.video)
    apart = (len(frames) - length) // count
    parts = [frames[k * apart : k * apart + length] for k in range(count)]
    limits = {"POSE_MAX_CAMERAS": str(count), "POSE_CAMERA_MEMORY_MB": "1024"}
    with ServerProcess(options.index, log=Path("/tmp/sessions-server.log"), **limits) as server:
        server.wait_until_ready()
        client = Client(server.url)
        alone = [follow(server.url, f"alone-{k}", part) for k, part in enumerate(parts)]
        failed, memory, together = [], [], []
        for number in reversed(range(options.rounds)):
            for camera in json.loads(client.send(Call("GET", "/cameras"))[1])["cameras"]:
                client.send(Call("DELETE", f"/cameras/{camera['camera_id']}"))
            round_told = follow_all(server.url, parts, f"round{number}")
            together += round_told
            memory.append(server.memory_mb())
            for k, told in enumerate(round_told):
                failed += [f"camera {k}: {what}" for what in differences(told, alone[k])]
                if told.sessions != ["new"] + ["warm"] * (length - 1):
                    failed.append(f"camera {k}: sessions {Counter(told.sessions)}")
        # Makes round0-0 the least recently used.
        for k in range(count):
            client.send(Call("POST", f"/cameras/round0-{k}/frames", {"frame": parts[k][-1]}))
        failed += past_the_limit(server.url, parts[0], count)
    asked = f"--frames {length} --rounds {options.rounds}"
    return _conclude(asked, failed, alone, together, memory, options.write)


def _conclude(
    asked: str,
    failed: list[str],
    alone: Sequence[Followed],
    together: Sequence[Followed],
    memory: Sequence[float],
    write: bool,
) -> int:
    answers = sum((told.answers for told in together), Counter[str]())
    if odd := [answer for answer in answers if answer[:3] not in ("200", "503")]:
        failed.append(f"answers: {odd}")
    if (growth := memory[-1] / memory[min(1, len(memory) - 1)] - 1) > MOST_GROWTH:
        failed.append(f"memory grew by {100 * growth:.1f} %")
    refusals = ", ".join(f"{n} x {what}" for what, n in answers.items() if what != "200")
    people = sum(len(frame.get("persons", ())) for told in together for frame in told.frames)
    alone_ms = [ms for told in alone for ms in told.milliseconds]
    together_ms = [ms for told in together for ms in told.milliseconds]
    told = f"{answers['200']} frames, {people} people; in between {refusals or 'no refusals'}"
    body = f"""`python -m scripts.load.sessions --video ../shared/real/vtest/vtest.avi {asked}`,
revision {revision()}. {machine()}; a client a camera on the same machine.
{len(alone)} cameras, each another part of the video, first alone, then \
{len(together) // len(alone)} rounds of all at once. Who is refused (503) sends the frame again.

| answered together | {told} |
|---|---|
| cameras with other people or identities than alone, or frames out of order | \
{len({what.split(":")[0] for what in failed if what.startswith("camera")})} |
| a frame alone, median | {percentile(alone_ms, 50):.0f} ms |
| a frame beside the others, once admitted, median | {percentile(together_ms, 50):.0f} ms |
| resident memory after each round | {", ".join(f"{mb:.0f}" for mb in memory)} MB |
| one camera more than `POSE_MAX_CAMERAS` | the least recently used started afresh and said so |

{"Failed: " + "; ".join(failed[:10]) if failed else "Passed."}"""
    conclude("Cameras at once", body, write=write)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
