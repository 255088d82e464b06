"""Motion capture: BVH clips to poses, and which frames to leave out.

Where BVH files are not CMU's, their own folder or the motion folder holds a ``rig.json``::

    {"metres_per_unit": 0.01, "joints": {"Hips": "mixamorig:Hips", "LowerBack": "mixamorig:Spine"}}

``joints`` maps our joints to those of the files that drive them; one of theirs may drive several of
ours. Joints left out have our names in the files. In the zero pose, all angles 0, the person has to
stand: y is up. If the bones lie along an axis instead, as in Rokoko's and Xsens' files,
``"rest_frame"`` is the number of a frame of every clip in which the person stands, arms out.
"""

import csv
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pybvh
from numpy.typing import NDArray
from pybvh.rotations import euler_to_rotmat
from pydantic import BaseModel, ConfigDict, Field, ValidationError

RIG_FILE = "rig.json"

METRES_PER_UNIT = 0.05644
"""CMU's unit of length."""

# Mean joint angle from the zero pose (arms out, legs straight) below which a frame is one: the
# calibration poses at the start of some clips stay below 5.8, living ones above 6.1.
_T_POSE_BELOW_DEG = 6.0
# A bone is broken if it turns by more than this in 1/30 s, and so many times as far as just before
# and after.
_JUMP_ABOVE_DEG, _JUMP_RATIO = 45.0, 4.0
# Frames between two jumps that are as broken as the jumps: a bone flipped and flipped back.
_SHORT_RUN = 8
# Frames before and after over which speed is measured: half a second at 30 fps.
_SPEED_WINDOW = 7


class MotionError(ValueError):
    """Motion data that cannot be used; the message names the file and what is wrong."""


class Rig(BaseModel):
    """How the joints of some BVH files correspond to ours, and their unit of length.

    ``joints`` has joints of the files by the names of ours; those left out have the same name.
    ``rest_frame`` is a frame that replaces the zero pose.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    joints: dict[str, str] = {}
    metres_per_unit: float = Field(default=METRES_PER_UNIT, gt=0, allow_inf_nan=False)
    rest_frame: int | None = Field(default=None, ge=0)


CMU = Rig()


def read_rig(*folders: Path) -> Rig:
    """Read the rig of the first folder that names one, else CMU's; raise :class:`MotionError`."""
    file = next((one / RIG_FILE for one in folders if (one / RIG_FILE).exists()), None)
    if file is None:
        return CMU
    try:
        return Rig.model_validate_json(file.read_text("utf-8-sig", "replace"))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise MotionError(f"{file} does not describe a rig: {place}: {first['msg']}") from error


MANIFESTS = ("manifest.csv", "manifest-ground.csv")
"""The second one, of people near the ground, may be missing."""

RENAMED = {"get-up": "get-up-or-fall"}
"""A single frame shows no direction: getting up played backwards is a fall."""


_UNRELIABLE = re.compile("Thumb|Finger|Hand.*[0-9]|Index|ToeBase")
"""CMU's hands and toes carry too few markers for their rotations to mean much."""


@dataclass(frozen=True)
class Segment:
    """A labelled piece of a clip, as a manifest cuts it; ``end`` is exclusive."""

    clip: str
    subject: str
    action: str
    start: int
    end: int
    manifest: str = MANIFESTS[0]


@dataclass(frozen=True)
class Clip:
    """One BVH file as rotations."""

    name: str
    bones: tuple[str, ...]  # the BVH joints, parents first
    parents: tuple[int, ...]  # of each bone; -1 for the root
    # (B, 3): from the parent's start to the bone's, in the zero pose; file units, y up.
    offsets: NDArray[np.float64]
    # (B, 3): from the bone's start to its end in the zero pose: its first child with an offset of
    # its own, or its end site.
    tips: NDArray[np.float64]
    # (F, B, 3, 3): world rotation of each bone against the zero pose.
    rotations: NDArray[np.float64]
    positions: NDArray[np.float64]  # (F, 3): path of the root, metres, y up
    speeds: NDArray[np.float64]  # (F,): horizontal speed of the pelvis, metres per second
    broken: NDArray[np.bool_]  # (F,): frames that hold a T-pose or a jump
    # Frames marked for each reason.
    t_poses: int
    jumps: int

    def bone(self, name: str) -> int:
        """Row of a bone; :class:`MotionError` if there is none."""
        if name not in self.bones:
            raise MotionError(
                f"the clip {self.name} has no joint {name!r}, which the body needs; "
                f"{RIG_FILE} may say what it is called there"
            )
        return self.bones.index(name)


def read_manifest(folder: Path) -> list[Segment]:
    """Read the segments that the manifests of a motion folder list.

    Raises
    ------
    MotionError
        If the folder or its first manifest is missing, or a manifest is empty or a line of it
        malformed.
    """
    first, *others = (Path(folder) / name for name in MANIFESTS)
    files = [first, *(file for file in others if file.exists())]
    return [segment for file in files for segment in _read_segments(file)]


def _read_segments(file: Path) -> list[Segment]:
    try:
        with file.open(newline="", encoding="utf-8-sig") as lines:
            table = csv.DictReader(lines)
            rows = [(table.line_num, row) for row in table]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MotionError(f"the motion manifest {file} cannot be read: {error}") from error
    if not rows:
        raise MotionError(f"the motion manifest {file} lists no segment")
    segments = []
    for number, row in rows:
        try:
            segment = Segment(
                row["clip"],
                row["subject"],
                RENAMED.get(row["action"], row["action"]),
                int(row["start_frame"]),
                int(row["end_frame"]),
                file.name,
            )
            if not (segment.clip and segment.action and 0 <= segment.start < segment.end):
                raise ValueError("empty clip or action, or start_frame not before end_frame")
        except (KeyError, TypeError, ValueError) as error:
            raise MotionError(
                f"line {number} of {file} is not a segment "
                f"(clip,subject,action,start_frame,end_frame,...): {error}"
            ) from error
        segments.append(segment)
    return segments


def read_clip(file: Path, rig: Rig = CMU) -> Clip:
    """Read one BVH file; its joints, which the rig names, get our names.

    Raises
    ------
    MotionError
        If it is missing or malformed; the message names the file and, where one line is at
        fault, the line.
    """
    bvh = _parse(file)
    nodes = [node for node in bvh.nodes if not node.is_end_site()]
    names = tuple(bvh.joint_names)
    parents = tuple(-1 if node.parent is None else names.index(node.parent.name) for node in nodes)
    local = np.empty((*bvh.joint_angles.shape, 3))
    for bone, order in enumerate(bvh.euler_orders):
        local[:, bone] = euler_to_rotmat(bvh.joint_angles[:, bone], order)
    rotations = _chained(local, parents)
    reliable = [b for b, name in enumerate(names) if b and not _UNRELIABLE.search(name)]
    angles_deg = np.rad2deg(np.abs(bvh.joint_angles[:, reliable])).mean(axis=(1, 2))
    t_pose = angles_deg < _T_POSE_BELOW_DEG
    jump = _jumps(local[:, [0, *reliable]]) & ~t_pose
    bones, rows = _named(names, rig, file)
    positions = rig.metres_per_unit * np.asarray(bvh.root_pos, np.float64)
    clip = Clip(
        name=Path(file).stem,
        bones=bones,
        parents=tuple(parents[row] for row in rows),
        offsets=np.array([nodes[row].offset for row in rows], np.float64),
        tips=np.array([_tip(nodes[row]) for row in rows], np.float64),
        rotations=rotations[:, rows],
        positions=positions,
        speeds=_speeds(positions, bvh.frame_time),
        broken=t_pose | jump,
        t_poses=int(t_pose.sum()),
        jumps=int(jump.sum()),
    )
    if not all(name in bones for name in (*_FEET, *_HIPS, "Head")):
        return clip  # What needs them says what they are called.
    if rig.rest_frame is not None:
        clip = _at_rest(clip, rig.rest_frame)
    _check_zero_pose(clip, rig)
    return clip


_FEET, _HIPS = ("LeftFoot", "RightFoot"), ("LeftUpLeg", "RightUpLeg")


def _starts(clip: Clip) -> NDArray[np.float64]:
    """Where bones start in the zero pose: ``(B, 3)``, file units, from the root."""
    starts = np.zeros_like(clip.offsets)
    for bone, parent in enumerate(clip.parents):
        if parent >= 0:
            starts[bone] = starts[parent] + clip.offsets[bone]
    return starts


def _at_rest(clip: Clip, frame: int) -> Clip:
    """The clip with this frame, turned to face +z, as its zero pose."""
    if frame >= len(clip.rotations):
        raise MotionError(
            f"the clip {clip.name} has {len(clip.rotations)} frames: none is the rest_frame "
            f"{frame} of {RIG_FILE}"
        )
    rest = clip.rotations[frame]
    turned = np.where(np.array(clip.parents)[:, None, None] < 0, np.eye(3), rest[[*clip.parents]])
    posed = replace(clip, offsets=np.einsum("bij,bj->bi", turned, clip.offsets))
    left, right = (_starts(posed)[posed.bone(name)] for name in _HIPS)
    cos, _, sin = (left - right) / max(np.linalg.norm((left - right)[[0, 2]]), 1e-9)
    to_front = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    return replace(
        posed,
        offsets=posed.offsets @ to_front.T,
        tips=np.einsum("ij,bjk,bk->bi", to_front, rest, clip.tips),
        rotations=clip.rotations @ np.swapaxes(rest, 1, 2) @ to_front.T,
    )


def _check_zero_pose(clip: Clip, rig: Rig) -> None:
    """Refuse a zero pose that does not stand, or whose height is no person's."""
    starts = _starts(clip)
    feet = np.mean([starts[clip.bone(name)] for name in _FEET], axis=0)
    along = starts[clip.bone("Head")] - feet
    axis = int(np.abs(along).argmax())
    if axis != 1 or along[1] <= 0:
        sign = "-" if along[axis] < 0 else "+"
        raise MotionError(
            f"the clip {clip.name} does not stand in its zero pose: feet to head point along "
            f"{sign}{'xyz'[axis]}, expected +y, which is up; if the motion itself has y up, write "
            f'"rest_frame": N into {RIG_FILE}, the number of a frame in which the person stands, '
            "arms out"
        )
    height = float(along[1]) * rig.metres_per_unit
    if not _HEIGHTS_M[0] <= height <= _HEIGHTS_M[1]:
        raise MotionError(
            f"the clip {clip.name} is of a person of {height:.3g} m from feet to head, expected "
            f"{_HEIGHTS_M[0]} to {_HEIGHTS_M[1]}: write the file's unit into {RIG_FILE}, such as "
            '"metres_per_unit": 0.01'
        )


_HEIGHTS_M = 0.5, 2.5
_MAX_FRAME_TIME_S = 1.0


def _parse(file: Path) -> pybvh.Bvh:
    try:
        bvh = pybvh.read_bvh_file(file, world_up="+y")
    except OSError as error:
        raise MotionError(f"the clip {file} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # pybvh raises IndexError and others on malformed text
        raise MotionError(f"the clip {file} is malformed: {_at_line(file, error)}") from error
    if not (np.isfinite(bvh.joint_angles).all() and np.isfinite(bvh.root_pos).all()):
        raise MotionError(
            f"the clip {file} is malformed: a channel holds a value that is not finite"
        )
    if not 0 < bvh.frame_time <= _MAX_FRAME_TIME_S:
        raise MotionError(
            f"the clip {file} is malformed: Frame Time: expected seconds, at most "
            f"{_MAX_FRAME_TIME_S:g}, got {bvh.frame_time:g}"
        )
    return bvh


def _named(names: tuple[str, ...], rig: Rig, file: Path) -> tuple[tuple[str, ...], list[int]]:
    """Names of the bones of a clip, first those of the file in its order, and the row of each."""
    missing = [(ours, theirs) for ours, theirs in rig.joints.items() if theirs not in names]
    if missing:
        ours, theirs = missing[0]
        raise MotionError(
            f"the clip {file} has no joint {theirs!r}, which {RIG_FILE} names for {ours!r}"
        )
    # A joint of theirs may have the name of another one of ours.
    kept = tuple(f"{name} of the file" if name in rig.joints else name for name in names)
    return kept + tuple(rig.joints), [*range(len(names)), *map(names.index, rig.joints.values())]


def _chained(local: NDArray[np.float64], parents: tuple[int, ...]) -> NDArray[np.float64]:
    """World rotations ``(F, B, 3, 3)`` of bones that turn against their parents."""
    rotations = local.copy()
    for bone, parent in enumerate(parents):
        if parent >= 0:
            rotations[:, bone] = rotations[:, parent] @ local[:, bone]
    return rotations


def _speeds(positions: NDArray[np.float64], frame_time_s: float) -> NDArray[np.float64]:
    """Horizontal speed ``(F,)`` of a path ``(F, 3)`` in metres, y up."""
    frames = np.arange(len(positions))
    start = np.maximum(frames - _SPEED_WINDOW, 0)
    end = np.minimum(frames + _SPEED_WINDOW, len(positions) - 1)
    path = positions[:, (0, 2)]
    lengths = np.linalg.norm(path[end] - path[start], axis=1)
    return lengths / (np.maximum(end - start, 1) * frame_time_s)


def _tip(node: pybvh.bvhnode.BvhNode) -> NDArray[np.float64]:
    while getattr(node, "children", None):
        node = node.children[0]
        if np.linalg.norm(node.offset) > 0:
            return np.asarray(node.offset, np.float64)
    return np.zeros(3)


def _jumps(local: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Frames next to a sudden turn of a bone, and short runs between two such turns."""
    marked = np.zeros(len(local), bool)
    if len(local) < 2:
        return marked
    trace = np.einsum("fbij,fbij->fb", local[1:], local[:-1])
    steps = np.rad2deg(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    padded = np.pad(steps, ((2, 2), (0, 0)), mode="edge")
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    broke = np.flatnonzero(((steps > _JUMP_ABOVE_DEG) & (steps > _JUMP_RATIO * around)).any(axis=1))
    for step in broke:
        marked[step : step + 2] = True
    for step, following in pairwise(broke):
        if following - step <= _SHORT_RUN:
            marked[step : following + 2] = True
    return marked


def _at_line(file: Path, error: Exception) -> str:
    """First malformed line of the motion part; else the parser's message."""
    lines = Path(file).read_text(errors="replace").splitlines()
    start = next((n for n, line in enumerate(lines) if line.strip().startswith("Frame Time")), None)
    if start is None:
        return str(error) or type(error).__name__
    width = None
    for number, line in enumerate(lines[start + 1 :], start=start + 2):
        values = line.split()
        if not values:
            continue
        try:
            [float(value) for value in values]
        except ValueError:
            return f"line {number} holds something that is not a number"
        width = width or len(values)
        if len(values) != width:
            return f"line {number} has {len(values)} values, the lines before have {width}"
    return str(error) or type(error).__name__
